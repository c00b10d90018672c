"""The live part of a page in a browser: its numbers are those of the answer, and it stays usable."""

from __future__ import annotations

import json
import math
import re
import shlex
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from scenarios.conveyor.live_ripple import SWEEP_ORBIT, SWEEP_POINTS, SWEEP_STEPS
from scenarios.project import PROJECT
from tests.conftest import ask
from tests.workbench.browser import Browser
from tests.workbench.test_report import first_element, page_browser
from workbench.answer import Answer
from workbench.options import add_arguments, parse_starts
from workbench.page import html

__all__ = ["page_browser"]
LIVE: dict[str, Mapping[str, Any]] = {
    "iron_bounce": {"speeds": "80rpm,100rpm"},
    "iron_cycle": {},
    "iron_start": {},
    "orientator_cycle": {},
    "packing_line": {},
    "resonance": {"speeds": "20,36,38,40,42,44,66"},
    "run_up": {},
    "sommerfeld": {"supplies": "18:30:3", "hold": 2.0, "step": 0.02},
    "speed_step": {},
}
TRIED = [
    name if name in ("iron_cycle", "resonance") else pytest.param(name, marks=pytest.mark.slow)
    for name in LIVE
]
MOVES = [
    ("iron_bounce", {"speed": 11.0, "iron.follower.e": 0.6}),
    ("iron_cycle", {"speed": 3.0, "iron.spring.c": 900.0, "iron.friction.K_up": 0.2}),
    ("iron_cycle", {"speed": 9.0, "iron.iron.m": 2.0}),
    ("iron_start", {"motor_A": 2.0, "iron.iron.m": 7.0}),
    ("orientator_cycle", {"friction": 0.1, "orientator.chute.H": 0.06, "speed": 6.0}),
    ("orientator_cycle", {"friction": 1.0, "speed": 12.0}),
    ("packing_line", {"gear": 2.2, "speed": 50.0}),
    ("resonance", {"conveyor.spring.c": 5e5, "motor.T": 0.04, "speed": 44.0}),
    ("resonance", {"conveyor.trough.d": 9000.0, "conveyor.rotor.J": 0.9, "motor.B": 320.0}),
    ("run_up", {"motor.T": 0.03, "conveyor.spring.c": 5e5}),
    ("run_up", {"conveyor.trough.m": 390.0, "speed": 45.0}),
    ("sommerfeld", {"exciter.mount.d": 150.0}),
    ("speed_step", {"ratio": 4.0, "speed": 30.0, "shaft.b": 0.03}),
    ("speed_step", {"shaft.c": 3000.0, "controller.K": 1.0}),
]
KLOSS = {
    "set": "B",
    "start": ["motor.characteristic=kloss", "motor.B=35.8"],
    "speeds": "12,20,40,60",
}
FEEDER = {
    "conveyor.trough.m": 180.0, "conveyor.crank.r": 0.012, "conveyor.spring.c": 9e5, "conveyor.trough.d": 1300.0,
}  # fmt: skip
OF_FEEDER = {
    "speed": "400rpm", "nameplate": "7.5 kW, 970 rpm, 50 Hz, 6 poles, 2.6, 2.35:1, 0.05 kg.m2", "start": FEEDER,
    "speeds": "30,40,50,60,70",
}  # fmt: skip
OF_DOCS = {
    "speed": "420rpm", "nameplate": "5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, 3.43:1, 0.02 kg.m2", "speeds": "40,60,80",
}  # fmt: skip
#: Options that change what a slider means: question, options, and moves.
MEANT: list[tuple[str, dict[str, Any], list[dict[str, float]]]] = [
    ("resonance", OF_FEEDER, [{"speed": 60.83}, {"conveyor.spring.c": 8e5, "motor.kloss.tau_b": 400.0}]),
    ("resonance", OF_DOCS, [{"conveyor.rotor.J": 0.725}, {"speed": 60.0, "conveyor.trough.m": 320.0}]),
    ("resonance", {**OF_DOCS, "start": {"motor.characteristic": "linear"}}, [{"motor.B": 80.0, "motor.T": 0.03}]),
    ("resonance", {**KLOSS, "start": [*KLOSS["start"], "motor.kloss.w_s=70", "motor.kloss.s_b=0.2"]},
     [{"speed": 45.0, "motor.T": 0.03}]),
    ("resonance", {"set": "B", "speeds": "20,30,40", "theory": "classical"}, [{"motor.B": 60.0, "speed": 35.0}]),
    ("run_up", {"nameplate": OF_FEEDER["nameplate"], "start": FEEDER}, [{"conveyor.rotor.J": 1.0}]),
    ("run_up", {"set": "A", "start": {"motor.kloss.w_s": 70.0}}, [{"speed": 45.0, "motor.T": 0.03}]),
    ("speed_step", {"algorithm": "jacobi", "start": {"controller.T_i": 0.1}}, [{"ratio": 4.0}]),
    ("iron_cycle", {"samples": 720, "start": {"iron.spring.c": 500.0}}, [{"speed": 4.0}]),
]  # fmt: skip
PART = "document.getElementById('live-part')"
#: bytes of the scripts of a page without plotly, and of a page, which were 74 000 and 2.8 million
LARGEST_SCRIPT, LARGEST_PAGE = 44_000, 2_800_000
#: every so many points of a sweep are compared, since an orbit takes Python longer
TRIED_POINTS = 9
#: sin, cos and their like may round otherwise in a module than in the C library
ROUNDING = 1e-9


@cache
def page(name: str, folder: Path, **options: Any) -> tuple[Answer, Path]:
    """An answer and its page."""
    file = folder / f"{name}.html"
    answer = ask(name, **options)
    html.report(answer, file)
    return answer, file


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("live")


def opened(page_browser: Browser, name: str, folder: Path, width: int = 1000) -> Answer:
    """The page of a question whose first live answer is there."""
    answer, file = page(name, folder, **LIVE[name])
    page_browser.open(file, width)
    answered(page_browser)
    return answer


def answered(page_browser: Browser, number: int = 1) -> None:
    page_browser.until(f"{PART}.dataset.answered === '{number}' && {PART}.ariaBusy === 'false'")


def move(page_browser: Browser, values: Mapping[str, float]) -> None:
    address = "&".join(f"{name}={value!r}" for name, value in values.items())
    page_browser.value(f"location.hash = '#live:{quote(address)}'")


def numbers(page_browser: Browser) -> dict[str, list[Any]]:
    """By name: the live number and its step difference as texts, and as values."""
    page_numbers: dict[str, list[Any]] = page_browser.value(
        f"""Object.fromEntries([...{PART}.querySelectorAll('tr[data-number]')].map(row => [row.dataset.number,
        [...row.querySelectorAll('td')].slice(0, 2).flatMap(x => [x.textContent, x.dataset.value])]))"""
    )
    return page_numbers


def agrees(page_browser: Browser, answer: Answer) -> None:
    """A live number is the figure within its step difference and the figure's error."""
    compared = 0
    for name, (text, value, difference_text, difference) in numbers(page_browser).items():
        figure = answer.figures.get(name)
        assert "±" not in text + difference_text
        if figure is None or math.isnan(float(value)):
            assert figure is None or figure.error is None, name
            continue
        slack = float(difference) + ROUNDING * abs(figure.value)
        if figure.error is not None:
            assert abs(float(value) - figure.value) <= slack + figure.error, (name, value, figure)
            compared += 1
    assert compared
    alarms = page_browser.value(f"{PART}.querySelector('.live-alarm').textContent")
    assert bool(alarms) == any(": " in warning for warning in answer.warnings), alarms


def quiet(page_browser: Browser, file: Path) -> None:
    """No error, no warning, no request but for the page itself."""
    for method in ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled"):
        assert page_browser.reported(method) == []
    requests = [
        event["request"]["url"] for event in page_browser.reported("Network.requestWillBeSent")
    ]
    assert [x for x in requests if not x.startswith(("data:", "blob:"))] == [
        file.resolve().as_uri()
    ]


def check_move(
    page_browser: Browser,
    name: str,
    values: Mapping[str, float],
    number: int = 2,
    original: Mapping[str, Any] | None = None,
) -> None:
    """Move sliders of a page and compare with Python, asked by the command that the page gives."""
    move(page_browser, values)
    answered(page_browser, number)
    arguments = shlex.split(page_browser.value(f"{PART}.querySelector('code').textContent"))
    kind, parser = PROJECT.load(name), ArgumentParser()
    add_arguments(parser, kind)
    begin = arguments.index(name) + 1 + 2 * ("--flavour" in arguments)
    options = {k: x for k, x in vars(parser.parse_args(arguments[begin:])).items() if x is not None}
    starts = {key: value for key, value in values.items() if "." in key}
    before = LIVE[name] if original is None else original
    expected_options = {**before, **{key: x for key, x in values.items() if key not in starts}}
    starts = parse_starts(before.get("start", {})) | starts
    assert kind.parse(options) == kind.parse({**expected_options, "start": starts})
    agrees(page_browser, ask(name, **options))


@pytest.mark.parametrize("name", TRIED)
def test_live_numbers_are_the_figures_and_follow_the_sliders(
    name: str, page_browser: Browser, folder: Path
) -> None:
    answer = opened(page_browser, name, folder, 390)
    agrees(page_browser, answer)
    assert page_browser.value("document.documentElement.scrollWidth") == 390
    assert page_browser.value(f"{PART}.querySelectorAll('.live-chart .trace').length") > 0
    lines = f"[...{PART}.querySelectorAll('.live-motion polyline')].map(x => x.getAttribute('points')).join()"
    before = page_browser.value(lines)
    assert "NaN" not in before and len(before) > 100
    page_browser.until(f"{lines} !== {json.dumps(before)}")
    check_move(page_browser, name, next(values for question, values in MOVES if question == name))
    _, file = page(name, folder, **LIVE[name])
    quiet(page_browser, file)
    assert file.stat().st_size < LARGEST_PAGE
    scripts = page_browser.value(
        "[...document.querySelectorAll('body script:not([type])')].map(x => x.textContent.length)"
    )
    assert answer.live is not None
    assert sum(scripts) + len(answer.live.worker) < LARGEST_SCRIPT


@pytest.mark.slow
@pytest.mark.parametrize(("name", "values"), MOVES)
def test_changed_machines_have_the_figures_of_python(
    name: str, values: Mapping[str, float], page_browser: Browser, folder: Path
) -> None:
    opened(page_browser, name, folder)
    check_move(page_browser, name, values)


def test_an_induction_motor_has_separate_formulas(page_browser: Browser, tmp_path: Path) -> None:
    answer, file = ask("resonance", **KLOSS), tmp_path / "page.html"
    html.report(answer, file)
    page_browser.open(file, 1000)
    answered(page_browser)
    agrees(page_browser, answer)
    assert "nu_res" not in numbers(page_browser)


@pytest.mark.parametrize(
    ("name", "options", "moves"),
    [
        case if k < 1 else pytest.param(*case, marks=pytest.mark.slow)
        for k, case in enumerate(MEANT)
    ],
    ids=[f"{name}-{k}" for k, (name, _, _) in enumerate(MEANT)],
)
def test_a_page_computes_the_machine_of_its_options(
    name: str,
    options: Mapping[str, Any],
    moves: Sequence[Mapping[str, float]],
    page_browser: Browser,
    tmp_path: Path,
) -> None:
    """A motor of a nameplate keeps its slip speed at breakdown where a slider moves the speed, as the question has it."""
    answer, file = ask(name, **options), tmp_path / "page.html"
    html.report(answer, file)
    page_browser.open(file, 1000)
    answered(page_browser)
    agrees(page_browser, answer)
    for number, values in enumerate(moves, 2):
        check_move(page_browser, name, values, number, options)


def test_a_motor_on_the_mains_has_no_sliders_and_the_page_says_why(
    page_browser: Browser, tmp_path: Path
) -> None:
    """Its operating speed follows from the torques, so that a slider of the speed would be another supply."""
    start = ["motor.characteristic=kloss"]
    answer = ask("resonance", supply="mains", start=start, speeds="40,60", steps_per_rev=64)
    html.report(answer, tmp_path / "page.html")
    page_browser.open(tmp_path / "page.html", 1000)
    assert page_browser.value(f"{PART} === null")
    told = page_browser.value("document.body.textContent")
    assert "Without sliders: on the mains the operating speed follows from the machine" in told


def test_the_sweep_runs_through_the_rows_of_the_answer(page_browser: Browser, folder: Path) -> None:
    """Those of the orbits with as many steps per revolution, to the share to which revolutions repeat."""
    answer = opened(page_browser, "resonance", folder)
    traces = page_browser.value(
        f"{PART}.querySelector('.live-chart').data.filter(x => x.name === 'co-simulation').map(x => [x.x, x.y])"
    )
    data, speeds = answer.data, traces[0][0]
    assert len(speeds) == SWEEP_POINTS and speeds == sorted(speeds)
    some = np.array(speeds[::TRIED_POINTS])
    drive = data.drive._replace(steps_per_rev=SWEEP_STEPS)
    columns = drive.motions(data.base, some, 1).columns
    expected = [columns[name].steps[0] for name in ("tau2", "w2", "lag")]
    for (x, y), values in zip(traces, expected, strict=True):
        assert x == pytest.approx(speeds)
        assert y[::TRIED_POINTS] == pytest.approx(values, rel=10 * SWEEP_ORBIT.tolerance)
    theory = page_browser.value(
        f"{PART}.querySelector('.live-chart').data.filter(x => x.name === 'first-order theory')[0].x.length"
    )
    assert theory > 100


def typed(page_browser: Browser, number: int, text: str) -> tuple[str, str]:
    """What stands below a box and whether it is invalid, after a text was typed into it."""
    box = f"{PART}.querySelector('#typed{number}')"
    page_browser.value(f"{box}.value = {json.dumps(text)}")
    page_browser.value(f"['input', 'change'].map(x => {box}.dispatchEvent(new Event(x)))")
    wrong = f"document.getElementById({box}.getAttribute('aria-describedby'))"
    return page_browser.value(f"[{wrong}.textContent, {box}.getAttribute('aria-invalid')]")


def test_boxes_refuse_what_is_out_of_bounds_and_move_the_machine(
    page_browser: Browser, folder: Path
) -> None:
    answer = opened(page_browser, "orientator_cycle", folder)
    note = "getComputedStyle(document.querySelector('.of-original')).display"
    assert page_browser.value(note) == "none"
    assert typed(page_browser, 0, "99") == ["must be at most 12 rad/s", "true"]
    assert typed(page_browser, 0, "0.1") == ["must be at least 0.5 rad/s", "true"]
    assert typed(page_browser, 1, "rough") == ["must be a number", "true"]
    agrees(page_browser, answer)
    assert page_browser.value("location.hash") == ""
    assert typed(page_browser, 0, "5") == ["", "false"]
    answered(page_browser, 2)
    assert page_browser.value("location.hash") == "#live:speed=5"
    assert page_browser.value(note) == "block"
    page_browser.value(f"{first_element('.live-reset')}.click()")
    answered(page_browser, 3)
    agrees(page_browser, answer)
    assert page_browser.value("location.hash") == ""


def test_an_address_opens_the_page_with_its_values_and_the_original_curves_in_grey(
    page_browser: Browser, folder: Path
) -> None:
    _, file = page("iron_cycle", folder, **LIVE["iron_cycle"])
    linked = folder / "iron_cycle.html"
    assert linked == file
    page_browser.open(file, 1000)
    answered(page_browser)
    page_browser.value("(location.hash = '#live:speed=8', 0)")
    answered(page_browser, 2)
    command = page_browser.value(f"{PART}.querySelector('code').textContent")
    page_browser.events.clear()
    page_browser.call("Page.reload")
    page_browser.until("document.documentElement?.dataset.ready === 'yes'")
    answered(page_browser, 2)
    assert page_browser.value(f"{PART}.querySelector('code').textContent") == command
    assert "--speed 8" in command
    greys = (
        f"{PART}.querySelector('.live-chart').data.filter(x => x.legendgroup === 'original').length"
    )
    assert page_browser.value(greys) == 7
    quiet(page_browser, file)


def test_only_the_newest_of_many_moves_is_answered(page_browser: Browser, folder: Path) -> None:
    opened(page_browser, "resonance", folder)
    for speed in (30.0, 31.0, 32.0):
        move(page_browser, {"speed": speed})
        page_browser.value("new Promise((resolve) => setTimeout(resolve, 30))")
    check_move(page_browser, "resonance", {"speed": 36.0}, 5)


def test_a_run_that_fails_is_reported_above_the_last_answer(
    page_browser: Browser, tmp_path: Path
) -> None:
    answer = ask("iron_cycle", start=["iron.on_invalid=stop"], samples=180)
    html.report(answer, tmp_path / "page.html")
    page_browser.open(tmp_path / "page.html", 1000)
    answered(page_browser)
    agrees(page_browser, answer)
    before = numbers(page_browser)
    move(page_browser, {"speed": 9.0})
    answered(page_browser, 2)
    assert numbers(page_browser) == before
    alarm = page_browser.value(f"{PART}.querySelector('.live-alarm').textContent")
    match = re.fullmatch("No answer with these values: (.+). Below is the last answer.", alarm)
    assert match is not None, alarm
    assert "iron: doStep(t = " in match[1] and "cam follower lifts off at phi = " in match[1]


def test_without_webassembly_the_page_is_still(page_browser: Browser, folder: Path) -> None:
    _, file = page("orientator_cycle", folder)
    page_browser.open(file, 1000)
    display = f"getComputedStyle({PART}).display"
    page_browser.until(f"{display} !== 'none'")
    page_browser.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.WebAssembly")
    page_browser.events.clear()
    page_browser.call("Page.reload")
    page_browser.until("document.documentElement?.dataset.ready === 'yes' && !window.WebAssembly")
    assert page_browser.value(display) == "none"
    assert page_browser.value("document.querySelector('details.original').open")
    quiet(page_browser, file)
