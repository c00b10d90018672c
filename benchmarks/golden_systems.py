"""The coupled systems of the golden dump: nine drives of the project's machines, three linear benchmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim import System

Matrix = Sequence[Sequence[float]]
Start = dict[str, float | int | str]
#: inputs, states and outputs of LinearSystem.fmu are vectors of four
SIZE = 4

#: how a system is stepped, by the name in the dump; arguments of `cosim.run`; with a tolerance, steps are adaptive
METHODS: dict[str, dict[str, Any]] = {
    "jacobi": {"algorithm": "jacobi"},
    "gauss-seidel": {"algorithm": "gauss-seidel"},
    "strang": {"algorithm": "strang"},
    "iterated": {"algorithm": "iterated"},
    "strang, adaptive": {"algorithm": "strang", "tolerance": 1e-4},
    "gauss-seidel, inputs of degree 2": {"algorithm": "gauss-seidel", "input_order": 2},
}


@dataclass(frozen=True)
class Coupling:
    """FMUs by part, wires and start values; stop time and communication step [s]; flavour for FMI 2.0."""

    parts: Mapping[str, str]
    wires: Sequence[str]
    start: Start = field(default_factory=dict)
    stop: float = 0.3
    step: float = 1e-3
    flavour: str = "native"

    def system(self, folder: Path) -> System:
        """The system of the FMUs in a folder."""
        from cosim import System

        parts = {part: folder / f"{fmu}.fmu" for part, fmu in self.parts.items()}
        return System(parts, list(self.wires), self.start)


@dataclass(frozen=True)
class Unit:
    """A linear part x' = A x + B u, y = C x + D u; `u` gives sources "part.number" or constants."""

    A: Matrix
    B: Matrix
    C: Matrix
    x: Sequence[float]
    u: Sequence[str | float]
    D: Matrix = ()


def linear(units: Mapping[str, Unit], stop: float, step: float) -> Coupling:
    """Linear parts, each an instance of LinearSystem.fmu; `stop` and `step` in seconds."""
    wires: list[str] = []
    start: Start = {}
    for part, unit in units.items():
        values = dict.fromkeys((f"{v}[{i + 1}]" for v in "xu" for i in range(SIZE)), 0.0)
        for name, matrix in zip("ABCD", (unit.A, unit.B, unit.C, unit.D)):
            for i in range(SIZE):
                for j in range(SIZE):
                    present = i < len(matrix) and j < len(matrix[i])
                    values[f"{name}[{i + 1},{j + 1}]"] = matrix[i][j] if present else 0.0
        values |= {f"x[{i}]": value for i, value in enumerate(unit.x, 1)}
        for i, source in enumerate(unit.u, 1):
            if isinstance(source, str):
                name, _, count = source.partition(".")
                output = "z" if units[name].D else "y"
                wires.append(f"{name}.{output}[{count}] -> {part}.u[{i}]")
                del values[f"u[{i}]"]
            else:
                values[f"u[{i}]"] = source
        start |= {f"{part}.{name}": value for name, value in values.items()}
    return Coupling(dict.fromkeys(units, "LinearSystem"), wires, start, stop, step, "python")


DRIVE = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
DRIVE_WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
INDUCTION: Start = {
    "motor.characteristic": "kloss",
    "motor.kloss.tau_b": 190.0,
    "motor.kloss.s_b": 0.16,
    "motor.kloss.w_s": 65.4,
    "motor.T": 0.02,
}
IRON = {"A": 4.0, "B": 0.025, "T": 0.012, "tau": 0.0}
OSCILLATOR = [[0.0, 1.0], [-197.4, 0.0]]

SYSTEMS = {
    "conveyor, stiff drive": Coupling(DRIVE, DRIVE_WIRES, {"motor.T": 0.0625}),
    "conveyor, induction motor": Coupling(DRIVE, ["motor.flange -- conveyor.flange"], INDUCTION),
    "conveyor, two motors": Coupling(
        {"first": "DriveMotor", "second": "DriveMotor", "conveyor": "CrankConveyor"},
        [
            "first.tau -> conveyor.tau", "second.tau +> conveyor.tau",
            "conveyor.w -> first.w", "conveyor.w -> second.w",
        ],
        {"second.T": 0.02},
    ),
    "unbalance exciter": Coupling(
        {"motor": "DCMotor", "exciter": "UnbalanceExciter"},
        ["motor.tau -> exciter.tau", "exciter.w -> motor.w"],
        {"motor.R": 5.0, "motor.v": 24.0},
    ),
    "slotted link": Coupling(
        {"motor": "DCMotor", "load": "SlottedLink"},
        ["motor.tau -> load.tau", "load.w -> motor.w"],
        {"motor.v": 24.0, "load.crank.r": 0.004, "load.w": 0.0},
    ),
    "controlled chain": Coupling(
        {
            "controller": "SpeedController", "motor": "DCMotor", "gear": "Gearbox",
            "shaft": "ShaftLink", "load": "SlottedLink",
        },
        [
            "controller.tau * 2.5 => motor.v", "gear.w_a -> motor.w", "gear.w_a -> controller.w",
            "motor.tau -> gear.tau_a", "shaft.tau_a -> gear.tau_b", "gear.w_b -> shaft.w_a",
            "load.w -> shaft.w_b", "shaft.tau_b -> load.tau",
        ],
        {
            "controller.T_i": 0.2, "controller.w_ref": 100.0, "gear.i": 5.0, "gear.w_a": 0.0,
            "shaft.b": 0.002, "shaft.twist": 0.0, "load.crank.r": 0.004, "load.w": 0.0,
        },
        stop=0.1,
        step=5e-4,
    ),
    "iron drive": Coupling(
        {"motor": "DriveMotor", "iron": "IronDrive"},
        ["motor.tau -> iron.tau", "iron.w -> motor.w"],
        {f"motor.{name}": value for name, value in IRON.items()},
        stop=0.8,
    ),
    "orientator": Coupling(
        {"orientator": "GravityOrientator"},
        [],
        {"orientator.w": 4.0, "orientator.release": 1, "orientator.chute.mu": 0.35},
        stop=1.2,
    ),
    "iron drive and orientator": Coupling(
        {"motor": "DriveMotor", "iron": "IronDrive", "orientator": "GravityOrientator"},
        [
            "motor.tau -> iron.tau", "iron.w -> motor.w", "iron.top_dwell -> orientator.release",
            "iron.w_cam * 1.25 -> orientator.w",
        ],
        {"motor.A": 5.4, "motor.B": 0.025, "motor.T": 0.012},
        stop=1.2,
    ),
    "linear oscillator": linear(
        {
            "a": Unit(OSCILLATOR, [[0.0], [157.9]], [[1.0, 0.0]], [1.0, 0.0], ["b.1"]),
            "b": Unit(OSCILLATOR, [[0.0], [157.9]], [[1.0, 0.0]], [0.0, 0.0], ["a.1"]),
        },
        0.2,
        5e-3,
    ),
    "linear masses with feedthrough": linear(
        {
            "a": Unit([[0, 1], [-10, -0.2]], [[0], [1]], [[1, 0], [0, 1]], [0, 0], ["b.1"]),
            "b": Unit(
                [[0, 1], [-30, -0.8]], [[0, 0], [10, 0.5]], [[10, 0.5]], [0.5, 0], ["a.1", "a.2"],
                [[-10, -0.5]],
            ),
        },
        0.5,
        6.25e-3,
    ),
    "linear DC motor": linear(
        {
            "electric": Unit([[-1000]], [[-10, 1000]], [[0.01]], [0], ["shaft.1", 12.0]),
            "shaft": Unit([[-0.5]], [[500, -500]], [[1]], [0], ["electric.1", 0.05]),
        },
        0.005,
        1.25e-4,
    ),
}  # fmt: skip
