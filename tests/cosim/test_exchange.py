"""The oracle and linearize take FMI 3.0 and FMUs that offer model exchange only, alone and mixed."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from cosim import SetupError, System, linearize, oracle, run, true_errors
from tests.conftest import described, rewritten
from tests.cosim.conftest import CommandOutput
from tests.cosim.test_linearize import DRIVE
from tests.cosim.test_reference import HYBRID
from tests.cosim.vector import pack
from tests.fmukit.test_native import built

EVERY = r"(?s)<CoSimulation[^>]*/>|<CoSimulation.*</CoSimulation>"
WITHOUT_COSIMULATION = described((EVERY, ""))
MATRIX = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -4.0, 0.0]])


def drive(motor: Path, conveyor: Path) -> System:
    """The drive of the conveyor, with an exact rod."""
    start = {"conveyor.phi": 0.7, "conveyor.rod.finite": True}
    return System({"motor": motor, "conveyor": conveyor}, DRIVE, start)


@pytest.mark.parametrize("mixed", [False, True])
def test_both_versions_have_the_same_bits(mixed: bool, native: Path) -> None:
    """Alone and mixed: rows, and the derivatives in all four matrices."""
    second = drive(native / "DriveMotor.fmu", native / "CrankConveyor.fmu")
    motor = native / "DriveMotor.fmu" if mixed else built("DriveMotor")
    third = drive(motor, built("CrankConveyor"))
    got, exact = (oracle(system, stop=0.05, output_step=0.005) for system in (third, second))
    assert got.names == exact.names and np.array_equal(got.data, exact.data)
    ours, theirs = (linearize(s, inputs=["conveyor.tau"]) for s in (third, second))
    for matrix in "ABCD":
        assert np.array_equal(getattr(ours, matrix), getattr(theirs, matrix)), matrix
    assert (ours.rates, ours.point, ours.units) == (theirs.rates, theirs.point, theirs.units)


def same_events(second: System, third: System, stop: float) -> None:
    got, exact = (oracle(s, stop=stop, output_step=stop / 10) for s in (third, second))
    assert exact.provenance["events"] == got.provenance["events"] != []
    assert np.array_equal(got.data, exact.data)


@pytest.mark.parametrize("case", HYBRID, ids=lambda case: case[0])
def test_both_versions_have_the_same_events(case: tuple, native: Path) -> None:
    name, start, stop, _ = case
    named_start = {f"m.{k}": value for k, value in start.items()}
    second, third = (
        System({"m": f}, start=named_start) for f in (native / f"{name}.fmu", built(name))
    )
    same_events(second, third, stop)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_model_exchange_is_enough_for_the_oracle_and_not_for_a_run(
    version: str, native: Path, tmp_path: Path
) -> None:
    third = version == "3.0"
    fmus = [built(n) if third else native / f"{n}.fmu" for n in ("DriveMotor", "CrankConveyor")]
    both = drive(*fmus)
    system = drive(*(rewritten(fmu, tmp_path / fmu.name, WITHOUT_COSIMULATION) for fmu in fmus))
    got, exact = (oracle(s, stop=0.02, output_step=0.005) for s in (system, both))
    assert np.array_equal(got.data, exact.data)
    assert np.array_equal(linearize(system).A, linearize(both).A)
    calls: tuple[Callable[[], object], ...] = (
        lambda: run(system, stop=0.1, step=0.01),
        lambda: true_errors(system, stop=0.1, step=0.01),
    )
    for call in calls:
        with pytest.raises(
            SetupError,
            match=r"part motor: .*DriveMotor\.fmu offers model exchange only; .* oracle and linearize",
        ):
            call()


def linear(u: float, k: float, t: float, x: np.ndarray) -> np.ndarray:
    """The states after a time t with k u1 = k u and u2 = 0."""
    rest = np.array([0.0, k * u / 4.0, 0.0])
    return np.asarray(expm(MATRIX * t) @ (x - rest) + rest)


def test_arrays_discrete_inputs_and_events_of_time(tmp_path: Path) -> None:
    """Of an FMU by FMI 3.0, whose discrete input takes event mode, against the matrix exponential."""
    fmu = pack(tmp_path / "vector.fmu")
    system = System({"v": fmu}, [], {"v.u[1]": 3.0}, changes=["at 0.3 s v.k = 2"])
    got = oracle(system, stop=1.0, output_step=0.1, record=["v.y[1]", "v.z", "v.x[2]"])
    x = np.array([1.0, 0.2, 0.0])
    for begin, end, k in ((0.0, 0.3, 1.0), (0.3, 0.5, 2.0), (0.5, 1.0, 2.0)):
        if begin == 0.5:
            x[1] = -x[1]
        x = linear(3.0, k, end - begin, x)
    assert got.provenance["events"] == [0.3, 0.5]
    assert got.data[-1, 1:] == pytest.approx([x[1] + 1.5, x[0], x[2]], abs=1e-11)
    reference = oracle(system, stop=0.1, record=["v.y"])
    assert reference.names == ["time", "v.y[1]", "v.y[2]"]


@pytest.mark.parametrize("slopes", [True, False])
def test_arrays_are_linearised_element_by_element(slopes: bool, tmp_path: Path) -> None:
    """By derivatives with a seed for each element, and by differences; two of them in a chain."""
    fmu = pack(tmp_path / "vector.fmu", slopes=slopes)
    linear = linearize(System({"v": fmu, "w": fmu}, ["v.y -> w.u"], {"v.k": 5.0}))
    assert linear.states == [f"{part}.{x}" for part in "vw" for x in ("z", "x[1]", "x[2]")]
    assert (linear.inputs, linear.outputs[2:]) == (["v.u[1]", "v.u[2]"], ["w.y[1]", "w.y[2]"])
    inner, entry = np.zeros((6, 6)), np.zeros((6, 2))
    inner[:3, :3] = inner[3:, 3:] = MATRIX
    inner[3, 2] = inner[5, 1] = 1.0  # u = x of the first one, whose k is 1 here
    entry[:3] = [[0.0, 1.0], [0.0, 0.0], [5.0, 0.0]]
    entry[3:] = [[0.0, 0.5], [0.0, 0.0], [0.5, 0.0]]
    expected = np.array([[0, 0.5, 0, 0, 1, 0], [0, 0, 0.5, 0, 0, 1]])
    for got, exact in ((linear.A, inner), (linear.B, entry), (linear.C[2:], expected)):
        assert got == pytest.approx(exact, abs=1e-12 if slopes else 1e-9)
    assert linear.D[2:] == pytest.approx(np.eye(2) / 4, abs=1e-9)


def test_the_shell_gives_the_truth_where_no_run_can_be(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    fmu, out = pack(tmp_path / "vector.fmu"), tmp_path / "true.csv"
    options = ["--stop", "0.4", "--record", "vector.x[1]", "--out", str(out)]
    text = command_output("oracle", fmu, *options)
    assert "with no run to compare: no co-simulation in vector" in text
    values = {row.split("  ")[1]: row.split() for row in text.splitlines()[1:-1]}
    for what, exact in {
        "at the end": 0.2 * math.cos(0.8),
        ", smallest": 0.2 * math.cos(0.8),
        ", largest": 0.2,
        ", mean": 0.2 * math.sin(0.8) / 0.8,
    }.items():
        (row,) = [row for name, row in values.items() if what in name]
        value, error = float(row[row.index("+-") - 1]), float(row[row.index("+-") + 1])
        assert 0.0 < error < 1e-6 and abs(value - exact) <= error, what
    assert len(out.read_text().splitlines()) == 1002
    assert "offers model exchange only" in command_output(
        "run", fmu, "--stop", "1", "--step", "0.1", code=2
    )
    assert "for model exchange only" in command_output("info", fmu)


def test_a_clock_that_is_to_tick_is_refused(tmp_path: Path) -> None:
    clock = '<Clock name="c" valueReference="9" causality="input" intervalVariability="constant" '
    swap = ("</ModelVariables>", f'{clock}intervalDecimal="0.1"/></ModelVariables>')
    fmu = rewritten(pack(tmp_path / "vector.fmu"), tmp_path / "ticking.fmu", described(swap))
    with pytest.raises(SetupError, match=r"v\.c is a clock, which ticks in co-simulation only"):
        oracle(System({"v": fmu}), stop=1.0)
