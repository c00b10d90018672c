"""Linear benchmarks of co-simulation as parts x' = A x + B u, y = C x + D u."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cosim.system import System, Value
from tests.coupling_theory import LinearPart, Rows

SIZE = range(1, 5)


@dataclass(frozen=True)
class Benchmark:
    """Units by name, the time that a run lasts [s], the number of steps of its shortest run.

    A bond names two outputs that are wired there and back and multiply to a power.
    """

    units: Mapping[str, LinearPart]
    stop: float
    steps: int
    bond: tuple[str, str] | None = None

    @property
    def counts(self) -> list[int]:
        """The numbers of steps of four runs, each with half the steps' size of the one before."""
        return [self.steps * 2**halvings for halvings in range(4)]

    @property
    def feedthrough(self) -> bool:
        """Whether any part has direct feedthrough."""
        return any(unit.D is not None for unit in self.units.values())


PI2 = math.pi**2
SPRINGS: Rows = [[0, 1], [-20 * PI2, 0]]
# Two masses between three springs, of the preCICE tutorials, after Schüller.
OSCILLATOR = {
    "a": LinearPart(SPRINGS, [[0], [16 * PI2]], [[1, 0]], [1, 0], ["b.1"]),
    "b": LinearPart(SPRINGS, [[0], [16 * PI2]], [[1, 0]], [0, 0], ["a.1"]),
}
# Two masses with dampers, force against place and speed, of OMSimulator's tests.
DUAL_MASS = {
    "a": LinearPart([[0, 1], [-10, -0.2]], [[0], [1]], [[1, 0], [0, 1]], [0, 0], ["b.1"]),
    "b": LinearPart(
        [[0, 1], [-30, -0.8]], [[0, 0], [10, 0.5]], [[10, 0.5]], [0.5, 0], ["a.1", "a.2"],
        D=[[-10, -0.5]],
    ),
}  # fmt: skip
# A quarter car that drives onto a step of 0.1 m, after Schierz, Arnold and Clauß.
QUARTER_CAR = {
    "chassis": LinearPart(
        [[0, 1], [-37.5, -2.5]], [[0, 0], [37.5, 2.5]], [[1, 0], [0, 1]], [0, 0],
        ["wheel.1", "wheel.2"],
    ),
    "wheel": LinearPart(
        [[0, 1], [-4125, -25]], [[0, 0, 0], [375, 25, 3750]], [[1, 0], [0, 1]], [0, 0],
        ["chassis.1", "chassis.2", 0.1],
    ),
}  # fmt: skip
# A DC motor switched on under load, a stiff armature circuit against a slow shaft.
DC_MOTOR = {
    "electric": LinearPart([[-1000]], [[-10, 1000]], [[0.01]], [0], ["shaft.1", 12.0]),
    "shaft": LinearPart([[-0.5]], [[500, -500]], [[1]], [0], ["electric.1", 0.05]),
}


#: Inertia at one end of the shaft of the drive [kg.m2]: chosen, half of the other.
FIRST_INERTIA = 1.1
#: Inertia at the other end [kg.m2]: chosen, see FIRST_INERTIA.
SECOND_INERTIA = 2.2
#: Stiffness of the shaft [N.m/rad]: chosen, for a natural frequency of 117 rad/s.
SHAFT_STIFFNESS = 1e4


def drive(damping: float) -> dict[str, LinearPart]:
    """Two inertias on an elastic shaft [N.m.s/rad], torque against angle and speed."""
    J_1, J_2, c, d = FIRST_INERTIA, SECOND_INERTIA, SHAFT_STIFFNESS, damping
    return {
        "shaft": LinearPart(
            [[0, 1], [-c / J_1, -d / J_1]], [[0, 0], [c / J_1, d / J_1]],
            [[c, d]], [0, 1], ["load.1", "load.2"], D=[[-c, -d]],
        ),
        "load": LinearPart([[0, 1], [0, 0]], [[0], [1 / J_2]], [[1, 0], [0, 1]], [0, 0], ["shaft.1"]),
    }  # fmt: skip


def lagging_motor(lag: float, inertia: float, slope: float) -> dict[str, LinearPart]:
    """A motor whose torque follows -slope * speed with a lag [s], and the inertia it drives."""
    return {
        "motor": LinearPart([[-1 / lag]], [[-slope / lag]], [[1]], [1.0], ["load.1"]),
        "load": LinearPart([[0]], [[1 / inertia]], [[1]], [0.3], ["motor.1"]),
    }


def twisting_drive(damping: float) -> dict[str, LinearPart]:
    """The two inertias, torque against speed: the shaft keeps its twist to itself."""
    J_1, J_2, c, d = FIRST_INERTIA, SECOND_INERTIA, SHAFT_STIFFNESS, damping
    return {
        "shaft": LinearPart(
            [[0, 1], [-c / J_1, -d / J_1]], [[-1], [d / J_1]], [[c, d]], [0, 1], ["load.1"],
            D=[[-d]] if d else None,
        ),
        "load": LinearPart([[0]], [[1 / J_2]], [[1]], [0], ["shaft.1"]),
    }  # fmt: skip


# Force of a spring against speed of a mass: each is linear in time while it hears a constant.
SPRING_AND_MASS = {
    "spring": LinearPart([[0]], [[1]], [[-50]], [0.1], ["mass.1"]),
    "mass": LinearPart([[0]], [[0.5]], [[1]], [1.0], ["spring.1"]),
}

BENCHMARKS = {
    "oscillator": Benchmark(OSCILLATOR, 0.2, 40),
    "dual mass": Benchmark(DUAL_MASS, 0.5, 80, bond=("a.2", "b.1")),
    "quarter car": Benchmark(QUARTER_CAR, 0.1, 25),
    "DC motor": Benchmark(DC_MOTOR, 0.005, 30),
    "drive": Benchmark(drive(1.0), 0.015, 40, bond=("shaft.1", "load.2")),
}


def couple(
    units: Mapping[str, LinearPart],
    fmu: Path,
    *,
    input_hold: int = 0,
    bond: tuple[str, str] | None = None,
) -> System:
    """The units as parts of a system, each an instance of LinearSystem.fmu.

    `input_hold` is what the FMUs themselves do between two settings of their inputs.
    """

    def output(name: str) -> str:
        part, _, number = name.partition(".")
        return f"{part}.{'y' if units[part].D is None else 'z'}[{number}]"

    wires: list[str] = []
    start: dict[str, Value] = {}
    for name, unit in units.items():
        values: dict[str, Value] = {
            f"{m}[{i},{j}]": 0.0 for m in "ABCD" for i in SIZE for j in SIZE
        }
        values |= {f"{v}[{i}]": 0.0 for v in "xu" for i in SIZE}
        values |= dict(_one_based_entries("A", unit.A)) | dict(_one_based_entries("B", unit.B))
        values |= dict(_one_based_entries("C", unit.C)) | dict(
            _one_based_entries("D", unit.feedthrough)
        )
        values |= dict(_one_based_entries("x", unit.x)) | {"input_hold": input_hold}
        for i, source in enumerate(unit.u, 1):
            if isinstance(source, str):
                wires.append(f"{output(source)} -> {name}.u[{i}]")
                del values[f"u[{i}]"]
            else:
                values[f"u[{i}]"] = source
        start |= {f"{name}.{key}": value for key, value in values.items()}
    bonds = [" * ".join(map(output, bond))] if bond else []
    return System(dict.fromkeys(units, fmu), wires, start, bonds)


def states(units: Mapping[str, LinearPart]) -> list[str]:
    """The names of the states, in the order of the units."""
    return [f"{name}.x[{i + 1}]" for name, unit in units.items() for i in range(len(unit.x))]


def _one_based_entries(name: str, values: ArrayLike) -> Iterator[tuple[str, float]]:
    """Names M[1,1], M[1,2] and values of a matrix, v[1], v[2] of a vector."""
    for indices, value in np.ndenumerate(np.array(values, float)):
        yield f"{name}[{','.join(str(i + 1) for i in indices)}]", float(value)
