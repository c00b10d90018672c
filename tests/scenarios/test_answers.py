"""What every question of the project finds: figures with errors and units, words, parameters."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from fmpy.model_description import read_model_description

import scenarios
from cosim import SetupError
from scenarios.orientator import machine as orientator
from scenarios.packing_line.questions import packing_line
from scenarios.project import PROJECT
from tests.conftest import CASES, LONG, QUICK, SAMPLED, ask, fmus_of, plain, question_of
from workbench.catalog import load_module, names
from workbench.cli import main
from workbench.export import content, print_and_write, write

QUESTIONS = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
    for name in names(PROJECT.home)
]
CHANGED = {
    "resonance": ("motor.T", 0.06),
    "resonance_map": ("conveyor.rotor.J", 0.6),
    "mean_values": ("motor.T", 0.06),
    "orbit": ("motor.T", 0.06),
    "induction_motor": ("motor.kloss.tau_b", 180.0),
    "rod_force": ("motor.T", 0.06),
    "run_up": ("motor.T", 0.03),
    "iron_cycle": ("iron.spring.side", -1),
    "iron_start": ("motor.T", 0.05),
    "iron_orders": ("motor.B", 0.03),
    "iron_bounce": ("iron.spring.c", 280.0),
    "orientation_time": ("orientator.chute.R", 0.25),
    "orientator_cycle": ("orientator.cup.m", 0.05),
    "packing_line": ("conveyor_motor.T", 0.03),
    "sommerfeld": ("exciter.mount.d", 82.0),
    "speed_step": ("shaft.c", 900.0),
    "identify": ("conveyor.crank.r", 0.0101),
    "iron_identify": ("iron.rocker.J", 0.026),
    "orientator_identify": ("orientator.cup.m", 0.041),
}
EXACT = {
    "nu_res", "zeta", "build_up", "slope", "cycles", "oriented", "released", "lost", "theory_up",
    "theory_down", "torque_plain", "settling", "settling_16", "motor_lag", "free_frequency",
    "held_frequency", "tau_cam_rest", "slip", "nu_flux", "most_resistance", "heavy_res", "heavy_flux", "least_slip",
    "spring", "spring_formula", "spring_theory", "f_rod_formula", "formula", "joint",
    "landings",
}  # fmt: skip


@cache
def variables(name: str) -> dict[str, Any]:
    """Those of the FMUs of a question, as their XML describes them."""
    fmus = fmus_of(load_module(PROJECT.locate(question_of(name)))).items()
    read = {part: read_model_description(str(x), validate=False) for part, x in fmus}
    return {f"{part}.{v.name}": v for part, x in read.items() for v in x.modelVariables}


@pytest.mark.parametrize("name", SAMPLED)
def test_an_answer_is_returned_by_value_without_a_word_or_a_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    question = question_of(name)
    changed, value = CHANGED[question]
    before, after = plain(name), ask(question, **CASES[name], start={changed: value})
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []
    assert before.question.endswith("?")
    assert [f.value for f in before.figures.values()] != [f.value for f in after.figures.values()]
    assert after.parameters[changed].value == value != before.parameters[changed].value
    same = set(before.parameters) - {changed}
    for key in same - {x for x in same if x.endswith((".A", ".tau", "conveyor.w", ".phi"))}:
        assert before.parameters[key] == after.parameters[key]


def numbers(value: Any) -> Iterator[float]:
    """All numbers in what a JSON file holds."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


@pytest.mark.parametrize("name", QUESTIONS)
def test_every_error_is_above_0_or_of_a_formula_or_refused_and_no_fact_says_a_figure_again(
    name: str,
) -> None:
    for key, figure in plain(name).figures.items():
        assert re.fullmatch(r"[a-z][a-z0-9_]*", key)
        assert figure.unit and figure.meaning
        if figure.error is None:
            assert math.isnan(figure.value) and figure.reason, key
        elif figure.error == 0.0:
            assert (
                key in EXACT
                or figure.value == 0.0
                or key.startswith("worst_speed")
                or key.endswith(("_theory", "_plain"))
            ), key
        else:
            assert 0.0 < figure.error < math.inf, key
    facts = json.loads(json.dumps(content(plain(name))))
    assert list(facts)[:3] == ["scenario", "question", "verdict"]
    measured = {x["value"] for x in facts["figures"].values() if x["error"] and x["value"]}
    assert not measured & set(numbers(dict(plain(name).facts)))


@pytest.mark.parametrize("name", QUESTIONS)
def test_parameters_and_columns_have_the_units_of_the_fmus(name: str) -> None:
    answer, compared = plain(name), 0
    units = {key: x.unit for key, x in answer.parameters.items()}
    for table in answer.tables.values():
        assert list(table.units) == list(table.frame.columns)
        units |= table.units
        errors = [key for key in table.units if key.endswith("_error")]
        assert all(table.units[x] == table.units[x.removesuffix("_error")] for x in errors)
    for key, v in variables(name).items():
        if key in units:
            assert units[key] == (v.unit or (v.declaredType and v.declaredType.unit) or ""), key
            compared += 1
    assert compared > 5


def test_warnings_of_fmus_are_reported_once_after_the_answer(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    answer = ask("iron_start", motor_A="8N.m", stop=0.6, start={"iron.on_invalid": 1})
    (warning,) = answer.warnings
    assert warning.startswith("iron: cam follower lifts off at phi = 3.05")
    print_and_write(answer, tmp_path)
    output, errors = capfd.readouterr()
    assert errors == ""
    assert output.splitlines()[-3] == f"Warning: {warning}"
    assert output.startswith("The cam does not complete a turn within 0.6 s: ")
    assert json.loads((tmp_path / "iron_start.json").read_text())["warnings"] == [warning]
    assert "cam follower lifts off" in (tmp_path / "report.html").read_text()
    assert plain("orientation_time").warnings == []


def test_jams_and_stalls_are_named() -> None:
    jam, reason = ask("orientator_cycle", speed="62.5rpm", friction=0.5), "rotation stopped after"
    assert jam.figures["orientation_time"].reason.startswith(f"the product jams: {reason}")
    rows = plain("orientation_time").tables["orientation_time.csv"].frame
    jammed = rows["stage"] == orientator.JAMMED
    assert 0 < jammed.sum() < len(rows)
    assert rows["orientation_time"].isna().equals(jammed)
    none = ask("orientation_time", speeds="90,100rpm", frictions="0.5,0.6")
    assert none.show().charts == []
    slow = ask("run_up", stop=3.0, step=1e-3, start={"motor.kloss.tau_b": 1.0})
    reason = "the crank does not stay above the resonance for a whole turn"
    assert slow.figures["kloss_passing"].reason == reason


@pytest.mark.parametrize("name", QUESTIONS)
def test_a_start_value_that_no_fmu_has_is_named(name: str, tmp_path: Path) -> None:
    part = CHANGED[name][0].split(".")[0]
    fixed = PROJECT.load(name).fixed_starts
    refused = [(f"{x}=1", f"start value {x}: this question sets it itself") for x in fixed]
    for wrong, message in (
        (f"{part}.nonsense=1", f"{part} has no variable 'nonsense'"),
        ("nobody.T=1", "there is no part 'nobody'"),
        *refused,
    ):
        with pytest.raises(SetupError, match=message):
            ask(name, **QUICK[name], start=[wrong], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_line_keeps_its_speeds_whatever_its_motors_are() -> None:
    start = {"conveyor_motor.B": 50.0, "conveyor.trough.d": 3e3, "iron_motor.B": 0.05}
    asked = packing_line.PackingLine.parse(
        {"iron_speed": 4.0, "start": start | {"iron.reducer.i_g": 30.0}}
    )
    line = asked.system(fmus_of(packing_line))
    assert line.start["conveyor_motor.A"] == pytest.approx((50.0 + 3e3 * 0.01**2 / 2) * 60.0)
    assert line.start["iron_motor.A"] == pytest.approx(0.05 * 30.0 * 4.0)
    assert start.items() <= line.start.items()


def test_python_asks_what_the_command_asks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An answer is the text of the command and, in a notebook, the text and the picture."""
    mine = tmp_path / "mine"
    answer = scenarios.ask("resonance", speeds=np.linspace(36, 44, 3), flavour="native", out=mine)
    folder = tmp_path / "there"
    arguments = [
        "run",
        "resonance",
        "--speeds",
        "36:44:3",
        "--flavour",
        "native",
        "--no-remedies",
        "--out",
        str(folder),
    ]
    assert main(arguments, PROJECT, "scenarios") == 0
    text, files = capsys.readouterr().out.rsplit("\n", 2)[:2]
    assert repr(answer) == text
    assert "formula (22): electromechanical resonance, docs/papers.md" in text
    assert files.endswith(f"written to {folder}")
    assert sorted(x.name for x in mine.iterdir()) == sorted(x.name for x in folder.iterdir())
    assert (mine / "resonance.csv").read_bytes() == (folder / "resonance.csv").read_bytes()
    page = answer._repr_html_()
    assert "On resonance: yes, lag" in page and "data:image/png;base64,iV" in page
    assert "±" in page and "<script" not in page


def test_python_gives_numbers_and_paths_of_its_libraries() -> None:
    turn = scenarios.ask("iron_cycle", flavour="native", samples=np.int64(720), speed=np.float32(3))
    assert turn.options["samples"].value == 720 and turn.options["speed"].value == 3.0
    assert len(turn.first_table) == 721
    options: dict[str, Any] = {
        "flavour": "native",
        "data": Path("no record.csv"),
        "map": ["time=t"],
    }
    with pytest.raises(SetupError, match="no record"):
        scenarios.ask("identify", **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sed": 1}, "run_up has no option 'sed': did you mean 'speed'?"),
        ({"set": "C"}, "set = 'C' must be one of A, B"),
        ({"flavour": "nativ"}, "flavour = 'nativ' must be one of python, native"),
        ({"jobs": 0}, "jobs = 0 must be at least 1"),
        ({"start": 3}, 'start = 3 must be start values by name, a dictionary, {"motor.T": 0.05}'),
        ({"start": "motor.T=1"}, "start = 'motor.T=1' must be start values by name"),
        ({"stop": True}, "stop = True must be a number in s"),
    ],
)
def test_python_is_refused_what_the_command_is(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=re.escape(message)):
        scenarios.ask("run_up", **{"flavour": "native"} | options)


def test_rows_are_saved_meanwhile_and_the_files_stand_at_the_end(tmp_path: Path) -> None:
    answer = ask("orientation_time", tmp_path, **QUICK["orientation_time"])
    partial = tmp_path / "orientation_time.partial.csv"
    table = pd.read_csv(partial)
    pd.testing.assert_frame_equal(table, answer.tables["orientation_time.csv"].frame)
    files = write(answer, tmp_path)
    assert not partial.exists()
    assert {path.name for path in tmp_path.iterdir()} == set(files)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "orientation_time.csv"), table)


def test_the_enumerations_are_those_of_the_fmu() -> None:
    for name, items in {"stage": orientator.STAGES, "reason": orientator.REASONS}.items():
        declared_items = variables("orientator_cycle")[f"orientator.{name}"].declaredType.items
        assert tuple(item.name.replace("_", " ") for item in declared_items) == items
