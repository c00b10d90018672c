"""The master on linear benchmarks: equal to ideal algorithms, with errors known beforehand.

The parts integrate exactly, so that every error is the coupling's. The ideal algorithms use matrix
exponentials and know no FMU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from cosim import SetupError, System, run


@dataclass(frozen=True)
class Unit:
    """x' = A x + B u, outputs C x + D u; `u` names the source of each input or gives its value."""

    A: Any
    B: Any
    C: Any
    x: Any
    u: tuple[Any, ...]
    D: Any = None

    @property
    def feedthrough(self) -> Any:
        return np.zeros((len(self.C), len(self.u))) if self.D is None else np.array(self.D, float)


PI2 = math.pi**2
SPRINGS = [[0, 1], [-20 * PI2, 0]]
OSCILLATOR = {
    "a": Unit(SPRINGS, [[0], [16 * PI2]], [[1, 0]], [1, 0], ("b.1",)),
    "b": Unit(SPRINGS, [[0], [16 * PI2]], [[1, 0]], [0, 0], ("a.1",)),
}
DUAL_MASS = {
    "a": Unit([[0, 1], [-10, -0.2]], [[0], [1]], np.eye(2), [0, 0], ("b.1",)),
    "b": Unit(
        [[0, 1], [-30, -0.8]], [[0, 0], [10, 0.5]], [[10, 0.5]], [0.5, 0], ("a.1", "a.2"),
        D=[[-10, -0.5]],
    ),
}  # fmt: skip
QUARTER_CAR = {
    "chassis": Unit(
        [[0, 1], [-37.5, -2.5]], [[0, 0], [37.5, 2.5]], np.eye(2), [0, 0], ("wheel.1", "wheel.2")
    ),
    "wheel": Unit(
        [[0, 1], [-4125, -25]], [[0, 0, 0], [375, 25, 3750]], np.eye(2), [0, 0],
        ("chassis.1", "chassis.2", 0.1),
    ),
}  # fmt: skip
DC_MOTOR = {
    "electric": Unit([[-1000]], [[-10, 1000]], [[0.01]], [0], ("shaft.1", 12.0)),
    "shaft": Unit([[-0.5]], [[500, -500]], [[1]], [0], ("electric.1", 0.05)),
}
J_1, J_2, STIFF, DAMP = 1.1, 2.2, 1e4, 1.0
DRIVE = {
    "shaft": Unit(
        [[0, 1], [-STIFF / J_1, -DAMP / J_1]], [[0, 0], [STIFF / J_1, DAMP / J_1]],
        [[STIFF, DAMP]], [0, 1], ("load.1", "load.2"), D=[[-STIFF, -DAMP]],
    ),
    "load": Unit([[0, 1], [0, 0]], [[0], [1 / J_2]], np.eye(2), [0, 0], ("shaft.1",)),
}  # fmt: skip
PROBLEMS = {
    "oscillator": (OSCILLATOR, 1.0),
    "dual mass": (DUAL_MASS, 2.0),
    "quarter car": (QUARTER_CAR, 1.0),
    "DC motor": (DC_MOTOR, 0.2),
    "drive": (DRIVE, 0.05),
}
SCHEMES = {
    "jacobi": ("jacobi", 0),
    "jacobi extrapolating": ("jacobi", 1),
    "gauss-seidel": ("gauss-seidel", 0),
    "strang": ("strang", 0),
    "iterated": ("iterated", 0),
    "iterated interpolating": ("iterated", 2),
}


def entries(rows: Any) -> Any:
    """Places counted from 1 and values of a matrix."""
    return (((i + 1, j + 1), value) for (i, j), value in np.ndenumerate(np.array(rows)))


def master(fmus: Path, units: dict[str, Unit], scheme: str, stop: float, h: float) -> Any:
    """The states at every communication point from our master, shape (steps + 1, states)."""
    algorithm, hold = SCHEMES[scheme]
    states = [f"{name}.x[{i}]" for name, u in units.items() for i in range(1, len(u.x) + 1)]
    coupled = system(fmus, units, hold)
    return run(coupled, stop=stop, step=h, algorithm=algorithm, record=states).data[:, 1:]


def system(fmus: Path, units: dict[str, Unit], hold: int = 0) -> System:
    """The units as FMUs."""
    wires, start = [], {}
    for name, unit in units.items():
        zero = {f"{m}[{i},{j}]": 0.0 for m in "ABCD" for i in range(1, 5) for j in range(1, 5)}
        matrices = {"A": unit.A, "B": unit.B, "C": unit.C, "D": unit.feedthrough}
        for m, rows in matrices.items():
            zero |= {f"{m}[{i},{j}]": float(v) for (i, j), v in entries(rows)}
        zero |= {f"x[{i}]": 0.0 for i in range(1, 5)}
        zero |= {f"x[{i}]": float(v) for i, v in enumerate(unit.x, 1)}
        zero |= {f"u[{i}]": 0.0 for i in range(1, 5)}
        for i, source in enumerate(unit.u, 1):
            if isinstance(source, str):
                part, _, output = source.partition(".")
                kind = "y" if units[part].D is None else "z"
                wires.append(f"{part}.{kind}[{output}] -> {name}.u[{i}]")
                zero.pop(f"u[{i}]")
            else:
                zero[f"u[{i}]"] = source
        start |= {f"{name}.{key}": value for key, value in zero.items()}
        start[f"{name}.input_hold"] = hold
    return System(dict.fromkeys(units, fmus / "LinearSystem.fmu"), wires, start)


class Ideal:
    """The same system as plain linear algebra."""

    def __init__(self, units: dict[str, Unit]) -> None:
        self.units = list(units.values())
        self.names = list(units)
        self.B = block_diag(*(u.B for u in self.units))
        self.C = block_diag(*(u.C for u in self.units))
        self.D = block_diag(*(u.feedthrough for u in self.units))
        self.A = block_diag(*(u.A for u in self.units))
        self.x0 = np.concatenate([u.x for u in self.units]).astype(float)
        places = [(n, i + 1) for n, u in units.items() for i in range(len(u.C))]
        self.L = np.zeros((self.B.shape[1], self.C.shape[0]))
        self.given = np.zeros(self.B.shape[1])
        for row, source in enumerate(source for u in self.units for source in u.u):
            if isinstance(source, str):
                part, _, output = source.partition(".")
                self.L[row, places.index((part, int(output)))] = 1.0
            else:
                self.given[row] = source
        sizes = [(len(u.x), len(u.u)) for u in self.units]
        states, inputs = (np.cumsum([0, *s]) for s in zip(*sizes))
        self.states = [slice(*pair) for pair in pairwise(states)]
        self.inputs = [slice(*pair) for pair in pairwise(inputs)]

    def heard(self, x: Any, u: Any) -> Any:
        """The inputs that the outputs of states x with inputs u give."""
        return self.L @ (self.C @ x + self.D @ u) + self.given

    def agreed(self, x: Any) -> Any:
        """The inputs that agree with the outputs at once."""
        loop = np.eye(len(self.given)) - self.L @ self.D
        return np.linalg.solve(loop, self.L @ self.C @ x + self.given)

    def flow(self, h: float) -> tuple[Any, Any, Any]:
        """E, G_0, G_1 of all parts side by side: x <- E x + G_0 u(0) + G_1 u(h)."""
        n, m = self.B.shape
        big = np.zeros((n + 2 * m, n + 2 * m))
        big[:n, :n], big[:n, n : n + m] = self.A * h, self.B * h
        big[n : n + m, n + m :] = np.eye(m)
        whole = expm(big)[:n]
        G_1 = whole[:, n + m :]
        return whole[:, :n], whole[:, n : n + m] - G_1, G_1

    def exact(self, t: float) -> Any:
        """The states of the whole at t."""
        loop = np.linalg.inv(np.eye(len(self.given)) - self.L @ self.D)
        n = len(self.x0)
        big = np.zeros((n + 1, n + 1))
        big[:n, :n] = self.A + self.B @ loop @ self.L @ self.C
        big[:n, n] = self.B @ loop @ self.given
        return (expm(big * t) @ np.append(self.x0, 1.0))[:n]

    def run(self, scheme: str, steps: int, h: float) -> Any:
        """The states at every communication point, shape (steps + 1, states)."""
        E, G_0, G_1 = self.flow(h)
        half = self.flow(h / 2)
        x, u = self.x0, self.agreed(self.x0)
        past, rows = u, [x]
        for n in range(steps):
            now = self.heard(x, u) if n else u
            if scheme == "jacobi":
                x, u = E @ x + (G_0 + G_1) @ now, now
            elif scheme == "jacobi extrapolating":
                end = now + (now - past if n else 0.0)
                x, u, past = E @ x + G_0 @ now + G_1 @ end, end, now
            elif scheme == "gauss-seidel":
                for part in range(len(self.units)):
                    x, u = self.turn(part, x, u, (E, G_0 + G_1))
            elif scheme == "strang":
                last = len(self.units) - 1
                order = [*range(last), last, *reversed(range(last))]
                for part in order:
                    E_p, *G = (E, G_0, G_1) if part == last else half
                    x, u = self.turn(part, x, u, (E_p, sum(G)))
            else:
                held = G_1 if "interpolating" in scheme else G_0 + G_1
                begun = E @ x + (G_0 @ u if "interpolating" in scheme else 0.0)
                loop = np.eye(len(u)) - self.L @ (self.C @ held + self.D)
                u = np.linalg.solve(loop, self.L @ self.C @ begun + self.given)
                x = begun + held @ u
            rows.append(x)
        return np.array(rows)

    def turn(self, part: int, x: Any, u: Any, flow: Any) -> tuple[Any, Any]:
        """One part hears the others and steps with held inputs."""
        own, ports = self.states[part], self.inputs[part]
        x, u = x.copy(), u.copy()
        u[ports] = self.heard(x, u)[ports]
        x[own] = (flow[0] @ x + flow[1] @ u)[own]
        return x, u


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_master_equals_the_ideal_algorithm(fmus: Path, problem: str, scheme: str) -> None:
    units, stop = PROBLEMS[problem]
    h = 5e-5 if problem == "drive" else 1e-3
    got = master(fmus, units, scheme, stop, h)
    want = Ideal(units).run(scheme, len(got) - 1, h)
    scale = np.abs(want).max(axis=0)
    assert (np.abs(got - want) / scale).max() < 1e-10


PUBLISHED = [
    ("oscillator", 1.0, 0.01, "jacobi", 4.565),
    ("oscillator", 1.0, 0.005, "jacobi", 2.124),
    ("oscillator", 1.0, 0.005, "gauss-seidel", 0.3765),
    ("oscillator", 1.0, 0.0025, "jacobi extrapolating", 0.04046),
    ("oscillator", 1.0, 0.005, "iterated", 1.877),
    ("oscillator", 1.0, 0.005, "iterated interpolating", 0.03245),
    ("dual mass", 10.0, 1e-3, "jacobi", 1.0011e-2),
    ("dual mass", 10.0, 1e-3, "gauss-seidel", 5.384e-3),
    ("dual mass", 10.0, 1e-3, "jacobi extrapolating", 4.727e-5),
    ("dual mass", 10.0, 1e-3, "iterated", 6.309e-3),
    ("quarter car", 4.0, 1e-3, "jacobi", 6.835e-3),
    ("quarter car", 4.0, 1e-3, "gauss-seidel", 6.732e-3),
    ("quarter car", 4.0, 1e-3, "jacobi extrapolating", 4.667e-4),
    ("quarter car", 4.0, 1e-3, "iterated interpolating", 1.119e-4),
]


@pytest.mark.parametrize(("problem", "stop", "h", "scheme", "error"), PUBLISHED)
def test_errors_are_those_known_of_the_benchmarks(
    fmus: Path, problem: str, stop: float, h: float, scheme: str, error: float
) -> None:
    units = PROBLEMS[problem][0]
    got = master(fmus, units, scheme, stop, h)
    ideal = Ideal(units)
    exact = np.array([ideal.exact(n * h) for n in range(len(got))])
    assert np.abs(got - exact).max() == pytest.approx(error, rel=2e-3)


@pytest.mark.parametrize(
    ("scheme", "order"),
    [
        ("jacobi", 1),
        ("jacobi extrapolating", 2),
        ("gauss-seidel", 1),
        ("strang", 2),
        ("iterated", 1),
        ("iterated interpolating", 2),
    ],
)
def test_orders_of_the_algorithms(fmus: Path, scheme: str, order: int) -> None:
    errors = []
    exact = Ideal(QUARTER_CAR).exact(0.5)
    for h in (5e-4, 2.5e-4, 1.25e-4):
        got = master(fmus, QUARTER_CAR, scheme, 0.5, h)[-1]
        errors.append(np.abs(got - exact).max())
    slopes = [math.log2(a / b) for a, b in pairwise(errors)]
    assert slopes == pytest.approx([order, order], abs=0.1)


LOOP = {
    "a": Unit([[-1.0]], [[1.0]], [[1.0]], [1.0], ("b.1",), D=[[0.5]]),
    "b": Unit([[-2.0]], [[1.0]], [[1.0]], [0.0], ("a.1",), D=[[-3.0]]),
}


def test_direct_feedthrough_both_ways_is_refused_by_explicit_algorithms(fmus: Path) -> None:
    for scheme in ("jacobi", "gauss-seidel", "strang"):
        with pytest.raises(SetupError) as caught:
            master(fmus, LOOP, scheme, 1.0, 0.01)
        assert "algebraic loop: b.z[1] -> a.u[1], a.z[1] -> b.u[1]" in str(caught.value)
        assert "iterated can" in str(caught.value)


def test_direct_feedthrough_both_ways_is_solved_by_iteration(fmus: Path) -> None:
    """Also at the start, where the inputs must agree with the outputs that they make."""
    errors = []
    for h in (0.02, 0.01, 0.005):
        got = master(fmus, LOOP, "iterated interpolating", 1.0, h)
        want = Ideal(LOOP).run("iterated interpolating", len(got) - 1, h)
        assert got == pytest.approx(want, abs=1e-9)
        errors.append(np.abs(got[-1] - Ideal(LOOP).exact(1.0)).max())
    assert [math.log2(a / b) for a, b in pairwise(errors)] == pytest.approx([2, 2], abs=0.1)


def test_a_loop_without_solution_is_an_error_with_its_signals(fmus: Path) -> None:
    hopeless = LOOP | {"b": Unit([[-2.0]], [[1.0]], [[1.0]], [5.0], ("a.1",), D=[[2.0]])}
    with pytest.raises(
        SetupError, match=r"start values of an algebraic loop were not found: .*u\[1\]"
    ):
        master(fmus, hopeless, "iterated", 1.0, 0.01)
