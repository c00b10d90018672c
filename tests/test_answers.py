"""What every scenario finds: figures, parameters and start values, without a word or a file."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from conftest import QUICK

from cosim import Estimate, SetupError
from scenarios import fmus, packing
from scenarios.__main__ import SCENARIOS, load
from scenarios.answer import Figure, write
from scenarios.theory import FIELDS, Machine

CHANGED = {
    "resonance": ("motor.T", 0.06),
    "resonance_map": ("conveyor.rotor.J", 0.6),
    "run_up": ("motor.T", 0.03),
    "iron_cycle": ("iron.spring.side", -1),
    "iron_start": ("motor.T", 0.05),
    "iron_orders": ("motor.B", 0.03),
    "orientation_time": ("orientator.cup.m", 0.05),
    "orientator_cycle": ("orientator.chute.mu", 0.3),
    "packing_line": ("conveyor_motor.T", 0.03),
}


@pytest.fixture(autouse=True)
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled FMUs, which are built already."""
    monkeypatch.setenv(fmus.CHOICE, "native")
    monkeypatch.setattr(fmus, "build", lambda *_: None)


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_answer_is_told_by_value_without_a_word_or_a_file(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    changed, value = CHANGED[name]
    plain = load(name).answer(**QUICK[name])
    other = load(name).answer(**QUICK[name], start=[f"{changed}={value}"])
    assert capsys.readouterr().out == ""
    assert list(tmp_path.iterdir()) == []
    for answer in (plain, other):
        assert answer.question.endswith("?")
        for figure, told in answer.figures.items():
            assert re.fullmatch(r"[a-z][a-z0-9_]*", figure)
            assert math.isfinite(told.value)
            assert told.unit
        for table in answer.tables.values():
            assert list(table.units) == list(table.frame.columns)
    assert plain.figures.keys() == other.figures.keys()
    assert {n: f.value for n, f in plain.figures.items()} != {
        n: f.value for n, f in other.figures.items()
    }
    assert other.parameters[changed].value == value != plain.parameters[changed].value
    same = {n: p for n, p in plain.parameters.items() if n != changed}
    assert all(
        parameter == other.parameters[n]
        for n, parameter in same.items()
        if not n.endswith((".A", ".tau", "conveyor.w"))
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_start_value_that_no_fmu_has_is_named(name: str, tmp_path: Path) -> None:
    part = CHANGED[name][0].split(".")[0]
    for wrong, message in (
        (f"{part}.nonsense=1", f"{part} has no variable 'nonsense'"),
        ("nobody.T=1", "there is no part 'nobody'"),
    ):
        with pytest.raises(SetupError, match=message):
            load(name).answer(**QUICK[name], start=[wrong], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("resonance", "motor.A"),
        ("resonance", "motor.characteristic"),
        ("resonance_map", "motor.A"),
        ("resonance_map", "motor.T"),
        ("run_up", "motor.characteristic"),
        ("iron_cycle", "iron.reducer.J"),
        ("iron_cycle", "iron.w_cam"),
        ("iron_orders", "motor.T"),
        ("orientation_time", "orientator.chute.mu"),
        ("orientator_cycle", "orientator.release"),
    ],
)
def test_what_a_scenario_sets_on_its_own_is_refused(name: str, own: str) -> None:
    with pytest.raises(SetupError, match=f"start value {own}: this scenario sets it on its own"):
        load(name).answer(start=[f"{own}=1"])


def test_theory_and_machine_follow_the_same_start_values() -> None:
    """Every value that the theory knows, far enough from set A that one left behind would show."""
    machine = Machine(B=150.0, T=0.05, theta1=0.6, m=180.0, r=0.008, c=7e5, d=3500.0)
    values = {name: getattr(machine, field) for name, field in FIELDS.items()}
    answer = load("resonance").answer(
        speeds="30,32", steps_per_rev=128, start=[f"{name}={x}" for name, x in values.items()]
    )
    assert answer.figures["nu_res"][:3] == (machine.nu_res, "rad/s", 0.0)
    assert {name: answer.parameters[name].value for name in values} == values
    rows = answer.tables["resonance.csv"].frame
    assert rows["tau2"].to_list() == pytest.approx(rows["tau2_theory"].to_list(), rel=3e-3)
    assert rows["w2"].to_list() == pytest.approx(rows["w2_theory"].to_list(), rel=3e-3)
    assert rows["w_mean"].to_list() == pytest.approx(rows["nu"].to_list(), rel=1e-3)
    assert rows["tau2_theory"][0] == abs(machine.torque_ripple(30.0))


def test_the_line_keeps_its_speeds_whatever_its_motors_are() -> None:
    start = {"conveyor_motor.B": 50.0, "conveyor.trough.d": 3e3, "iron_motor.B": 0.05}
    line = packing.system(1.25, 4.0, "B", 60.0, start | {"iron.reducer.i_g": 30.0})
    assert line.start["conveyor_motor.A"] == pytest.approx((50.0 + 3e3 * 0.01**2 / 2) * 60.0)
    assert line.start["iron_motor.A"] == pytest.approx(0.05 * 30.0 * 4.0)
    assert start.items() <= line.start.items()


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("motor.T=0", "T = 0.0 s must be > 0"),
        ("motor.B=0", "motor.B = 0.0 N.m.s/rad must be above 0"),
        ("conveyor.crank.r=wide", "conveyor.crank.r [m] = 'wide' must be of type Real"),
        ("motor.T", "'motor.T' must read NAME=VALUE"),
    ],
)
def test_start_values_that_theory_or_fmus_cannot_bear_are_refused(start: str, message: str) -> None:
    for name in ("resonance", "run_up"):
        with pytest.raises(SetupError, match=re.escape(message)):
            load(name).answer(start=[start])


def test_rows_are_kept_on_the_way_and_the_files_stand_at_the_end(tmp_path: Path) -> None:
    answer = load("orientation_time").answer(**QUICK["orientation_time"], out=tmp_path)
    partial = tmp_path / "orientation_time.partial.csv"
    kept = partial.read_text().splitlines()
    assert len(kept) == 1 + len(answer.tables["orientation_time.csv"].frame)
    names = write(answer, tmp_path)
    assert not partial.exists()
    assert {path.name for path in tmp_path.iterdir()} == set(names)
    assert (tmp_path / "orientation_time.csv").read_text().splitlines() == kept


def test_a_figure_says_what_is_known_of_its_error() -> None:
    assert Figure.of(Estimate(2.0, 0.01, 2.0), "N.m").text() == "2.000 +- 0.010 N.m"
    assert Figure(2.0, "N.m", 0.01).text() == "2.000 +- 0.010 N.m"
    assert Figure(2.0, "N.m").text() == "2 N.m (coupling error not known)"
    assert Figure(2.0, "N.m", 0.0).text() == "2 N.m"
    lost = Figure.of(Estimate(2.0, None, 0.7), "N.m").text()
    assert lost == "2 N.m (not converged: the error falls with order 0.7)"


def test_a_resonance_near_a_speed_of_the_sweep_is_found_with_coarser_steps_too() -> None:
    wide = load("resonance").answer(speeds="36,42,44", steps_per_rev=128).figures["nu_90"]
    near = load("resonance").answer(speeds="36,40.03,44", steps_per_rev=128).figures["nu_90"]
    assert near.value == pytest.approx(wide.value, abs=1e-3)
    assert near.error == pytest.approx(wide.error, rel=0.05)
