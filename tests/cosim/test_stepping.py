"""How runs step: two loops with the same bits, adaptive steps, moving inputs, rows on any grid."""

from __future__ import annotations

import json
import math
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal
from scipy.integrate import solve_ivp

from cosim import Adaptive, Result, SetupError, System, run
from cosim.engine.output import OutputGrid
from cosim.engine.recorder import CHUNK, Recorder
from cosim.series import Column, Series
from scenarios.conveyor.first_order import SETS
from tests.conftest import described, rewritten
from tests.cosim.foreign import idle, pack
from tests.cosim.test_cosim import NU, RECORD, REST, WIRES, pair
from tests.hosts.host import Unit
from tests.oracle import monolithic

START = SETS["A"].start(NU)
PEAK = 1396.458


def from_rest(fmus: Path, **settings: Any) -> Result:
    """The drive of native FMUs runs up for a second."""
    settings = {"stop": 1.0, "record": ["motor.tau", "conveyor.w"]} | settings
    return run(pair(fmus / "native", START | REST), **settings)


@cache
def exact() -> Any:
    """phi, w, tau of the drive that runs up, at any time."""
    return monolithic(START | REST, 1.0, dense_output=True).sol


def torque_error(result: Result) -> float:
    """Largest error of the motor's torque, over its largest value."""
    return float(np.abs(result["motor.tau"] - exact()(result["time"])[2]).max()) / PEAK


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "strang"])
@pytest.mark.parametrize("rates", [{}, {"motor": 3, "conveyor": 2}])
def test_both_loops_give_the_same_bits(
    fmus: Path, algorithm: str, rates: dict[str, int], request: pytest.FixtureRequest
) -> None:
    wires = ("motor.tau * 0.5 + 1 -> conveyor.tau", "conveyor.w * 2 -> motor.w")
    settings = {"stop": 0.3004, "step": 1e-3, "algorithm": algorithm, "record": RECORD}
    settings |= {"substeps": rates, "output_step": 3e-3}
    compiled = run(pair(fmus, START, wires), **settings)
    request.getfixturevalue("interpreted")
    plain = run(pair(fmus, START, wires), **settings)
    assert compiled.provenance["loop"] == "compiled"
    assert plain.provenance["loop"] == "Python, since the compiled loop is missing: no compiler"
    assert_array_equal(compiled.data, plain.data)
    assert compiled.energy == plain.energy
    assert compiled.provenance["do_steps"] == plain.provenance["do_steps"]
    assert plain["time"][-1] == 0.3004


@pytest.mark.parametrize("text", [False, True])
def test_only_text_needs_python(text: bool, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Whole numbers, truth values and choices take the compiled loop and give the same bits."""
    kinds = ["integer", "boolean", "enumeration", *["string"] * text]
    parts = {name: pack(tmp_path / f"{name}.fmu", counts=True) for name in "AB"}
    wires = ["A.y -> B.u", *(f"A.{kind}_out -> B.{kind}_in" for kind in kinds)]
    start = idle("AB", *(wire.split("-> ")[1] for wire in wires))
    record = [f"B.{kind}_out" for kind in kinds[:3]] + ["B.y", "B.spelled"]
    settings: dict[str, Any] = {"stop": 2.0, "step": 0.01, "record": record}
    quick = run(System(parts, wires, start), **settings)
    assert quick.provenance["loop"] == ("Python" if text else "compiled")
    request.getfixturevalue("interpreted")
    assert_array_equal(quick.data, run(System(parts, wires, start), **settings).data)
    assert np.diff(quick["B.enumeration_out"]).any()


def test_substeps_are_steps_with_held_inputs(fmus: Path) -> None:
    """The motor's step is exact: three instead of one change rounding only."""
    single = from_rest(fmus, step=1e-3)
    three = from_rest(fmus, step=1e-3, substeps={"motor": 3})
    assert three["motor.tau"] == pytest.approx(single["motor.tau"], abs=1e-8)
    assert three.provenance["do_steps"] == {"motor": 6000, "conveyor": 1000}


def test_adaptive_error_follows_the_tolerance_over_four_decades(fmus: Path) -> None:
    tolerances = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5]
    errors = [torque_error(from_rest(fmus, step=Adaptive(tol))) for tol in tolerances]
    slopes = [math.log10(a / b) for a, b in pairwise(errors)]
    assert slopes == pytest.approx([1.0] * 4, abs=0.15)
    assert errors[0] < tolerances[0]


def test_rejected_steps_leave_no_trace(fmus: Path) -> None:
    """A first step far too long is taken back; energy and rows are those of a good start."""
    good = from_rest(fmus, step=Adaptive(1e-3, first=1e-4))
    hasty = from_rest(fmus, step=Adaptive(1e-3, first=0.3))
    assert hasty.provenance["rejected"] > 2
    assert hasty.provenance["steps"] < 1.2 * good.provenance["steps"]
    assert torque_error(hasty) == pytest.approx(torque_error(good), rel=0.2)
    (bond,) = hasty.energy.values()
    assert bond["given"] == pytest.approx(next(iter(good.energy.values()))["given"], rel=1e-3)


def test_an_absolute_tolerance_stands_in_the_unit_of_its_signal(fmus: Path) -> None:
    tight = Adaptive(1.0, absolute={"motor.tau": 0.01, "conveyor.w": 1.0})
    assert torque_error(from_rest(fmus, step=tight)) * PEAK < 0.01


def test_longest_step_is_respected(fmus: Path) -> None:
    times = from_rest(fmus, step=Adaptive(1.0, longest=2e-3))["time"]
    assert np.diff(times).max() <= 2e-3 * (1 + 1e-12)
    assert times[-1] == 1.0


def test_energy_control_holds_what_the_bond_creates(fmus: Path) -> None:
    """What the coupling makes follows the tolerance, without going back; at looser ones, with some
    tens of steps a revolution, the last bit of an FMU decides its sign."""
    steps, created, tolerances = [], [], (1e-3, 1e-4)
    for tolerance in tolerances:
        control = Adaptive(tolerance, control="energy")
        result = from_rest(fmus, step=control, algorithm="gauss-seidel")
        (bond,) = result.energy.values()
        created.append(bond["residual"] / tolerance)
        steps.append(result.provenance["steps"] * tolerance)
        assert result.provenance["rejected"] == 0
    assert created[1] == pytest.approx(created[0], rel=0.5)
    assert steps[1] == pytest.approx(steps[0], rel=0.05)


def test_energy_stands_in_joules_whatever_the_units(fmus: Path) -> None:
    """A gear between the shafts: speed down, torque up, no energy lost."""
    wires = ("motor.tau * 2 -> conveyor.tau", "conveyor.w * 2 -> motor.w")
    result = run(pair(fmus, START, wires), stop=0.5, step=1e-4, record=["motor.P"])
    (bond,) = result.energy.values()
    assert abs(bond["residual"]) < 1e-4 * abs(bond["given"])
    assert abs(bond["given"]) > 1.0


def test_a_bond_can_be_named(fmus: Path) -> None:
    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    named = System(parts, WIRES, START, bonds=["conveyor.w * motor.tau"])
    result = run(named, stop=0.1, step=1e-3, record=["motor.tau"])
    plain = run(pair(fmus), stop=0.1, step=1e-3, record=["motor.tau"])
    (bond,), (other,) = result.energy.values(), plain.energy.values()
    assert bond["given"] == other["taken"]
    for text, message in (
        ("motor.tau", "must read 'part.output * part.output'"),
        ("motor.tau * motor.P", "must name two Real outputs, wired there and back once"),
    ):
        with pytest.raises(SetupError, match=message.replace("*", r"\*")):
            run(System(parts, WIRES, START, bonds=[text]), stop=0.1, step=1e-3)


@pytest.mark.parametrize("step", [1e-3, 7e-4, Adaptive(1e-3)])
def test_rows_lie_on_the_users_grid_whatever_the_steps(fmus: Path, step: Any) -> None:
    result = from_rest(fmus, step=step, output_step=2.5e-3)
    assert result["time"] == pytest.approx(np.arange(401) * 2.5e-3, abs=1e-15)
    assert torque_error(result) < 2e-3


def rows_on_grid(rows: Any, ends: Any = (), **settings: Any) -> Any:
    """Rows on a grid, from rows that come in pieces, the first one alone."""
    found: list[float] = []
    grid = OutputGrid(found.extend, **settings)
    for piece in np.split(rows, [1, *ends]):
        grid.add(piece.ravel().tolist())
    grid.flush()
    return np.reshape(found, (-1, rows.shape[1]))


def test_interpolated_rows_are_of_fourth_order() -> None:
    """A sine given at some of its times, asked for at all; a step does not ring. Also beside the step and the ends."""
    errors = []
    for every in (8, 4, 2):
        times = np.arange(0, 2000 + 1, every) * 1e-3
        given = np.column_stack([times, np.sin(20 * times), times >= 1.0])
        found = rows_on_grid(given, spacing=1e-3, discrete=[2])
        t, x, switch = found.T
        assert t == pytest.approx(np.arange(2001) * 1e-3, abs=1e-12)
        assert_array_equal(switch, t >= 1.0)
        errors.append(np.abs(x - np.sin(20 * t))[abs(t - 1.0) > 0.008].max())
    assert [math.log2(a / b) for a, b in pairwise(errors)] == pytest.approx([4.0] * 2, abs=0.2)


@pytest.mark.parametrize("spacing", [0.3e-3, 1e-3, 2.5e-3, 0.01, 0.37])
def test_rows_of_many_times_at_once_are_those_of_one_after_the_other(
    spacing: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit, also in pieces, where a break begins between, where a column is held, and where a time comes twice."""
    t = np.sort(np.append(np.arange(2000) * 1e-3, 0.9))
    rows = np.column_stack([t, np.sin(20.0 * t), np.where(t < 1.2, t, -t), np.floor(3.0 * t)])
    rows[901, 1] = 3.0
    how: dict[str, Any] = {"spacing": spacing, "discrete": [3], "breaks": [(0.5, 0.52)]}
    at_once = rows_on_grid(rows, **how)
    pieces = rows_on_grid(rows, [2, 4, 700, 701, 1500], **how)
    monkeypatch.setattr("cosim.engine.output.WAITING_ROWS", 1)
    one_by_one = rows_on_grid(rows, range(2, len(rows)), **how)
    assert_array_equal(at_once, one_by_one)
    assert_array_equal(at_once, pieces)
    assert set(t[np.flatnonzero(np.diff(rows[:, 3])) + 1]) <= set(at_once[:, 0])
    assert at_once[at_once[:, 0] == 0.9, 1].tolist() == [rows[900, 1], 3.0]


def test_events_get_separate_rows(fmus: Path) -> None:
    """The stages of the orientator, far faster than the rows asked for."""
    start = {"orientator.w": 6.0, "orientator.release": True}
    system = System({"orientator": fmus / "GravityOrientator.fmu"}, (), start)
    settings: dict[str, Any] = {"stop": 1.0, "step": 1e-3, "record": ["orientator.stage"]}
    every = run(system, **settings)
    result = run(system, **settings, output_step=0.25)
    stage = every["orientator.stage"]
    changes = every["time"][1:][np.diff(stage) != 0]
    assert len(changes) > 2
    assert set(changes) <= set(result["time"])
    assert len(result.data) <= 5 + len(changes)
    stage_by_time = dict(zip(every["time"], stage))
    assert [stage_by_time[t] for t in result["time"]] == result["orientator.stage"].tolist()


def test_streamed_rows_do_not_stay_in_memory(fmus: Path, tmp_path: Path) -> None:
    recorder = Recorder([Column("x")], tmp_path / "rows.csv")
    for n in range(50_000):
        recorder.add([n, n / 3])
    assert len(recorder.rows) < 3 * CHUNK
    nothing = run(System({"motor": fmus / "DriveMotor.fmu"}), stop=1e-3, step=1e-3)
    result = recorder.finish(nothing.provenance)
    assert_array_equal(result["x"], np.arange(50_000) / 3)
    streamed = from_rest(fmus, step=1e-3, csv=tmp_path / "deep" / "run.csv")
    assert_array_equal(streamed.data, from_rest(fmus, step=1e-3).data)
    facts = json.loads((tmp_path / "deep" / "run.json").read_text())
    assert facts["status"] == "complete" and facts["parts"]["conveyor"]["guid"].startswith("{")


def test_a_part_s_columns_are_written_under_bare_names(fmus: Path, tmp_path: Path) -> None:
    result = from_rest(fmus, step=1e-2)
    result.write(tmp_path / "motor.csv", part="motor")
    assert (tmp_path / "motor.csv").read_text().startswith("time,tau\n0.0,0.0\n")
    with pytest.raises(SetupError, match="no column of part 'pump'"):
        result.write(tmp_path / "pump.csv", part="pump")
    with pytest.raises(SetupError, match=r"must end in \.csv or \.parquet"):
        result.write(tmp_path / "run.xlsx")


def test_parquet_carries_the_frame(fmus: Path, tmp_path: Path) -> None:
    result = from_rest(fmus, step=1e-2)
    result.write(tmp_path / "run.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "run.parquet"), result.frame)
    result.write(tmp_path / "run.csv", part="motor")  # of other names, and so of other facts
    assert Series.read(tmp_path / "run.parquet").units["motor.tau"] == "N.m"
    assert Series.read(tmp_path / "run.csv").units["tau"] == "N.m"


def test_native_fmus_follow_polynomials(fmus: Path) -> None:
    """Derivatives up to order 6 over one long step, against an independent solver."""
    rates = [3.0, -40.0, 500.0, -2e4, 3e5, -4e6]
    slave = Unit(fmus / "native" / "DriveMotor.fmu").start(w=35.0)
    w, *torques = (slave.variables[name].valueReference for name in ("w", "tau", "tau_static"))
    slave.fmi.setRealInputDerivatives([w] * 6, [1, 2, 3, 4, 5, 6], rates)
    torque = slave.step(0.0, 0.1).get("tau")
    slope, fed_through = slave.fmi.getRealOutputDerivatives(torques, [1, 1])
    later = slave.set(w=35.0).step(0.1, 0.01).get("tau")
    slave.end().fmi.freeInstance()

    def speed(t: float) -> float:
        return 35.0 + sum(r * t**k / math.factorial(k) for k, r in enumerate(rates, 1))

    def rate(t: float, tau: Any) -> Any:
        return (8000.0 - 199.8 * speed(t) - tau) / 0.0625

    final = 8000.0 - 199.8 * 35.0
    assert later == pytest.approx(final + (torque - final) * math.exp(-0.16), rel=1e-12)
    solved = solve_ivp(rate, (0.0, 0.1), [8.0], "DOP853", rtol=1e-12, atol=1e-10)
    assert torque == pytest.approx(solved.y[0, -1], rel=1e-9)
    assert slope == pytest.approx(float(rate(0.1, torque)), rel=1e-9)
    turning = sum(r * 0.1 ** (k - 1) / math.factorial(k - 1) for k, r in enumerate(rates, 1))
    assert fed_through == pytest.approx(-199.8 * turning, rel=1e-9)


def test_an_output_that_inputs_act_on_at_once_does_not_stall_the_steps(fmus: Path) -> None:
    """Its error is of first order in the step however short, so it must not count per step."""
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w", "motor.P => watt.u[1]")
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor", "watt": "LinearSystem"}
    start = {f"watt.u[{i}]": 0.0 for i in (2, 3, 4)} | START | REST
    system = System({name: fmus / f"{fmu}.fmu" for name, fmu in parts.items()}, wires, start)
    settings: dict[str, Any] = {"algorithm": "gauss-seidel", "record": ["motor.tau"]}
    result = run(system, stop=0.1, step=Adaptive(0.1), **settings)
    assert result.provenance["steps"] < 1000
    assert torque_error(result) < 0.1


def test_adaptive_steps_take_a_nominal_value_of_0_as_1(tmp_path: Path) -> None:
    """Of a signal that has been 0 so far, the permitted error was 0, by which its error was divided."""
    one = pack(tmp_path / "1.fmu", x0=0.0)
    zero = rewritten(
        one, tmp_path / "0.fmu", described(('(?<=continuous"><Real)/>', ' nominal="0"/>'))
    )
    first, second = (
        run(
            System({"a": fmu, "b": fmu}, ["a.y -> b.u", "b.y -> a.u"]),
            stop=1.0,
            step=Adaptive(1e-3),
        )
        for fmu in (one, zero)
    )
    assert_array_equal(first.data, second.data)
