"""The live part of a page in a browser: what it tells is what Python tells."""

from __future__ import annotations

import base64
import json
import re
import shlex
import shutil
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import pytest

import cosim
from cosim import SetupError, SimulationError
from cosim.system import connect
from scenarios.__main__ import PROJECT
from scenarios.fmu_files import FMUS
from tests.conftest import ask, fmus_of
from tests.workbench.browser import Browser
from tests.workbench.firefox import Firefox, firefox
from tests.workbench.test_report import one, shown
from workbench import live
from workbench.answer import Answer, Findings
from workbench.live import ENGINE, FOLDER, Slider
from workbench.options import add, made
from workbench.question import load, names
from workbench.report import html

__all__ = ["shown"]
SWEEP = {"speeds": "34,38,40,42,46", "steps_per_rev": 128}
LIVE: dict[str, Mapping[str, Any]] = {
    "iron_bounce": {},
    "iron_cycle": {},
    "iron_start": {},
    "orientator_cycle": {},
    "packing_line": {},
    "resonance": {"speeds": "36,40,44", "steps_per_rev": 72, "limit": 120},
    "run_up": {},
    "sommerfeld": {"supplies": "18:32:8"},
    "speed_step": {},
}
SAMPLE = ("CrankConveyor", "GravityOrientator")
TRIED = [
    name if name == "iron_cycle" else pytest.param(name, marks=pytest.mark.slow) for name in LIVE
]
PART = "document.getElementById('live-part')"
MOVED = [
    ("iron_cycle", {"speed": 9.0, "iron.iron.m": 2.0}),
    ("iron_cycle", {"speed": 3.0, "iron.spring.c": 900.0, "iron.friction.K_up": 0.2}),
    ("resonance", {"conveyor.spring.c": 5e5, "motor.T": 0.04, "speed": 44.0}),
    ("resonance", {"conveyor.trough.d": 9000.0, "conveyor.rotor.J": 0.9, "motor.B": 320.0}),
    ("resonance", {"conveyor.trough.m": 330.0, "conveyor.spring.c": 1.3e6}),
    ("orientator_cycle", {"friction": 0.1, "orientator.chute.H": 0.06, "speed": 6.0}),
    ("orientator_cycle", {"friction": 0.8, "speed": 9.0}),
    ("orientator_cycle", {"orientator.spring.c": 35.0, "speed": 2.0}),
    ("iron_bounce", {"speed": 11.0, "iron.follower.e": 0.6}),
    ("iron_start", {"motor_A": 2.0, "iron.iron.m": 7.0}),
    ("packing_line", {"gear": 2.2, "orientator.chute.mu": 0.7}),
    ("packing_line", {"iron_speed": 5.0, "iron.iron.m": 6.0, "speed": 50.0}),
    ("run_up", {"motor.T": 0.03, "conveyor.spring.c": 5e5}),
    ("run_up", {"conveyor.trough.m": 390.0, "speed": 45.0}),
    ("sommerfeld", {"motor.R": 4.5}),
    ("sommerfeld", {"exciter.mount.d": 150.0}),
    ("speed_step", {"shaft.c": 3000.0, "controller.K": 1.0}),
    ("speed_step", {"ratio": 4.0, "speed": 30.0, "shaft.b": 0.03}),
]
OTHERS = [
    ("resonance", {**SWEEP, "algorithm": "gauss-seidel", "steps_per_rev": 256}),
    ("resonance", {**SWEEP, "algorithm": "jacobi", "steps_per_rev": 400, "speeds": "38,40,42"}),
    ("resonance", {**SWEEP, "set": "B", "speeds": "12,17,20,23,26,30,40,60"}),
    ("resonance", {**SWEEP, "set": "B", "start": ["motor.characteristic=kloss", "motor.B=35.8"],
                   "speeds": "12,17,20,23,26,30,40,60"}),
]  # fmt: skip


@cache
def page(name: str, folder: Path, **given: Any) -> tuple[Answer, Path]:
    """An answer and its page."""
    file = folder / f"{name}.html"
    answer = ask(name, **given)
    html.report(answer, file)
    return answer, file


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("live")


def test_a_slider_that_moves_nothing_is_refused(tmp_path: Path) -> None:
    page = load(names(PROJECT.home)["orientator_cycle"])
    o, modules = made(page.Options, {}, "it"), PROJECT.modules(page, "native")
    found = Findings({}, None, page.system(o, fmus_of(page)))
    copy = SimpleNamespace(__file__=str(tmp_path / "it.py"), Options=page.Options)
    copy.LIVE = (Slider("orientator.cup.x", 0.0, 1.0),)
    with pytest.raises(SetupError, match=r"'orientator.cup.x' is neither an option nor a start"):
        live.of(copy, o, found, {}, modules, "")  # type: ignore[arg-type]
    assert live.of(copy, o, found, {}, {}, "") is None  # type: ignore[arg-type]
    copy.Options, copy.LIVE = (
        load(names(PROJECT.home)["resonance"]).Options,
        (Slider("speed", 1, 2),),
    )
    with pytest.raises(SetupError, match="'speed' has no value of its own, and none in the data"):
        live.of(copy, made(copy.Options, {}, "it"), found, {}, modules, "")  # type: ignore[arg-type]


def opened(shown: Browser, name: str, folder: Path, width: int = 1000) -> Answer:
    """The page of a question whose first live answer is there."""
    answer, file = page(name, folder, **LIVE[name])
    shown.open(file, width)
    answered(shown)
    return answer


def answered(shown: Browser | Firefox, number: int = 1) -> None:
    shown.until(f"{PART}.dataset.answered === '{number}'")


def move(shown: Browser, values: Mapping[str, float]) -> None:
    words = "&".join(f"{name}={value!r}" for name, value in values.items())
    shown.value(f"location.hash = '#live:{quote(words)}'")


def agrees(shown: Browser | Firefox, answer: Answer) -> None:
    """Live figures and verdict are those of Python; errors to what their differences leave."""
    cells = shown.value(f"""Object.fromEntries([...{PART}.querySelectorAll('tr[data-figure]')].map(
        row => [row.dataset.figure, [row.querySelector('td').textContent, {{...row.querySelector('td').dataset}}]]))""")
    for name, figure in answer.figures.items():
        told, data = cells.pop(name)
        if figure.error is None:
            assert told == f"not determined ({figure.reason})", name
            continue
        assert float(data["value"]) == pytest.approx(figure.value, rel=1e-9), name
        slack = 1e-9 * abs(figure.value)
        assert float(data["error"]) == pytest.approx(figure.error, rel=1e-3, abs=slack), name
    assert all(told == "none" for told, _ in cells.values())
    said = shown.value(f"[...{PART}.querySelectorAll('.verdict p')].map(p => p.textContent)")
    assert said == answer.verdict.splitlines()
    alarms = f"[...{PART}.querySelectorAll('.live-alarm span')].map(x => x.textContent)"
    same(shown.value(alarms), answer.warnings)


def same(told: Sequence[str], wanted: Sequence[str]) -> None:
    """Sentences are the same, numbers in them but for how sin and cos round."""
    number = r"(?<![\w.])-?\d[\d.]*(?:e-?\d+)?"
    assert [re.sub(number, "#", x) for x in told] == [re.sub(number, "#", x) for x in wanted]
    numbers = [
        [float(x) for text in texts for x in re.findall(number, text)] for texts in (told, wanted)
    ]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-9, abs=1e-11)


def quiet(shown: Browser, file: Path) -> None:
    """No error, no warning, no request but for the page itself."""
    for method in ("Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled"):
        assert shown.reported(method) == []
    asked = [event["request"]["url"] for event in shown.reported("Network.requestWillBeSent")]
    assert [x for x in asked if not x.startswith(("data:", "blob:"))] == [file.resolve().as_uri()]


def test_the_questions_with_sliders_are_tried_here() -> None:
    pages = {name: load(module) for name, module in names(PROJECT.home).items()}
    assert {name for name, page in pages.items() if hasattr(page, "LIVE")} == set(LIVE)


def moved(shown: Browser, name: str, values: Mapping[str, float], number: int = 2) -> None:
    """Move sliders of a page and compare with Python, asked by the command that the page gives."""
    move(shown, values)
    answered(shown, number)
    words = shlex.split(shown.value(f"{PART}.querySelector('code').textContent"))
    kind, parser = load(names(PROJECT.home)[name]).Options, ArgumentParser()
    add(parser, kind)
    assert words[3:5] == ["--flavour", "native"]
    asked = {k: x for k, x in vars(parser.parse_args(words[5:])).items() if x is not None}
    starts = {key: value for key, value in values.items() if "." in key}
    given = {**LIVE[name], **{key: x for key, x in values.items() if key not in starts}}
    assert made(kind, asked, name) == made(kind, {**given, "start": starts}, name)
    agrees(shown, ask(name, **asked))


@pytest.mark.parametrize("name", TRIED)
def test_the_live_answer_is_the_still_one_and_follows_the_sliders_while_the_page_goes_on(
    name: str, shown: Browser, folder: Path
) -> None:
    answer = opened(shown, name, folder, 390)
    agrees(shown, answer)
    assert shown.value("document.documentElement.scrollWidth") == 390
    assert shown.value(f"{PART}.querySelectorAll('.live-chart .trace').length") > 0
    assert shown.value(f"{PART}.querySelectorAll('.live-motion animate').length") > 0
    drawn = "[...document.querySelectorAll('{} svg')].map(x => x.outerHTML).join()"
    assert shown.value(f"{drawn.format('.motion')} === {drawn.format('.live-motion')}")
    shown.value(
        f"(window.ticks = 0, setInterval(() => {{ ticks += {PART}.ariaBusy === 'true'; }}, 5), 0)"
    )
    moved(shown, name, next(values for question, values in MOVED if question == name))
    assert shown.value("ticks") > 5
    _, file = page(name, folder, **LIVE[name])
    quiet(shown, file)
    assert file.stat().st_size < 3_000_000


@pytest.mark.slow
@pytest.mark.parametrize(("name", "values"), MOVED)
def test_many_moved_machines_are_told_as_python_tells_them(
    name: str, values: Mapping[str, float], shown: Browser, folder: Path
) -> None:
    opened(shown, name, folder)
    moved(shown, name, values)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "given"), OTHERS)
def test_other_options_are_told_as_python_tells_them(
    name: str, given: Mapping[str, Any], shown: Browser, tmp_path: Path
) -> None:
    answer, file = ask(name, **given), tmp_path / "page.html"
    html.report(answer, file)
    shown.open(file, 1000)
    answered(shown)
    agrees(shown, answer)


def typed(shown: Browser, number: int, text: str) -> tuple[str, str]:
    """What stands below a box and whether it is invalid, after a text was typed into it."""
    box = f"{PART}.querySelector('#typed{number}')"
    shown.value(f"{box}.value = {json.dumps(text)}")
    shown.value(f"['input', 'change'].map(x => {box}.dispatchEvent(new Event(x)))")
    wrong = f"document.getElementById({box}.getAttribute('aria-describedby'))"
    return shown.value(f"[{wrong}.textContent, {box}.getAttribute('aria-invalid')]")


@pytest.mark.slow
def test_boxes_keys_and_links_move_the_machine_and_what_it_does_is_spoken(
    shown: Browser, folder: Path
) -> None:
    answer = opened(shown, "orientator_cycle", folder)
    assert typed(shown, 0, "99") == ["must be at most 12 rad/s", "true"]
    assert typed(shown, 0, "0.1") == ["must be at least 0.5 rad/s", "true"]
    assert typed(shown, 1, "rough") == ["must be a number", "true"]
    agrees(shown, answer)
    assert shown.value("location.hash") == ""
    assert typed(shown, 0, "5") == ["", "false"]
    answered(shown, 2)
    assert shown.value("location.hash") == "#live:speed=5"
    shown.value(f"{one('.live-reset')}.click()")
    answered(shown, 3)
    agrees(shown, answer)
    assert shown.value("location.hash") == ""
    shown.value(f"{PART}.querySelector('[type=range]').focus()")
    for kind in ("keyDown", "keyUp"):
        shown.call("Input.dispatchKeyEvent", type=kind, key="End", windowsVirtualKeyCode=35)
    answered(shown, 4)
    assert shown.value("location.hash") == "#live:speed=12"
    spoken = shown.value(f"{PART}.querySelector('[role=status]').textContent")
    assert spoken == shown.value(f"{PART}.querySelector('.verdict p').textContent")
    tree = shown.call("Accessibility.getFullAXTree")["nodes"]
    called = {(x["role"]["value"], x["name"]["value"]) for x in tree if x.get("name")}
    assert {("slider", "Speed of the rotor, slider"), ("textbox", "Speed of the rotor")} <= called
    move(shown, {"speed": 99.0, "cup.x": 1.0})
    answered(shown, 5)
    said = shown.value(f"{PART}.querySelector('.live-alarm').textContent")
    assert said == "The link sets cup.x, which this page does not have."
    assert shown.value(f"{PART}.querySelector('.wrong').textContent") == "must be at most 12 rad/s"
    for words in ("speed=%E0%A4%A", "speed=5=6", "speed"):
        shown.value(f"{PART}.querySelector('.wrong').textContent = ''")
        shown.value(f"location.hash = '#live:{words}'")
        shown.until(f"{PART}.querySelector('.wrong').textContent === 'must be a number'")


@pytest.fixture(scope="module")
def fox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Firefox]:
    """Firefox for all pages."""
    program = shutil.which("firefox-esr") or shutil.which("firefox")
    if program is None:
        pytest.skip("neither firefox-esr nor firefox is installed: no page was opened in it")
    with firefox(program, tmp_path_factory.mktemp("fox") / "profile") as page:
        yield page


@pytest.mark.slow
@pytest.mark.parametrize("name", LIVE)
def test_firefox_tells_the_same(name: str, fox: Firefox, folder: Path) -> None:
    answer, file = page(name, folder, **LIVE[name])
    fox.open(file)
    answered(fox)
    agrees(fox, answer)


@pytest.mark.slow
def test_the_curve_is_drawn_before_the_places_on_it_are_found(shown: Browser, folder: Path) -> None:
    opened(shown, "resonance", folder)
    table = f"{PART}.querySelector('tbody').textContent"
    shown.value(f"""(window.before = {table}, window.drawn = [], window.react = Plotly.react,
        Plotly.react = (...all) => {{ drawn.push({table} === before); return react(...all); }}, 0)""")
    moved(shown, "resonance", {"conveyor.spring.c": 5e5})
    first, *others = shown.value("drawn")
    assert first and others and not any(others)


@pytest.mark.slow
def test_a_move_in_the_middle_of_a_long_answer_is_answered_alone(
    shown: Browser, folder: Path
) -> None:
    opened(shown, "sommerfeld", folder)
    move(shown, {"motor.R": 7.0})
    shown.value("new Promise(resolve => setTimeout(resolve, 1600))")
    moved(shown, "sommerfeld", {"exciter.mount.d": 100.0}, 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("orientator_cycle", {"friction": 1.0, "speed": 12.0}, "The product jams: "),
        ("packing_line", {"orientator.chute.mu": 1.0}, "does not keep pace: 0 of "),
        ("iron_cycle", {"speed": 9.0}, "is NOT possible: the follower lifts off at "),
        ("iron_bounce", {"speed": 11.0}, "it is off the cam for "),
    ],
)
def test_a_jam_and_a_lift_off_are_the_sentences_that_python_says(
    name: str, values: Mapping[str, float], words: str, shown: Browser, folder: Path
) -> None:
    opened(shown, name, folder)
    moved(shown, name, values)
    assert words in shown.value(f"{PART}.querySelector('.verdict p').textContent")


def broken_off(
    shown: Browser, file: Path, name: str, values: Mapping[str, float], **given: Any
) -> tuple[str, str]:
    """What page and Python say of a move to which there is no answer; the page keeps the last one."""
    answer = ask(name, **given)
    html.report(answer, file)
    shown.open(file, 1000)
    answered(shown)
    agrees(shown, answer)
    before = shown.value(f"{PART}.querySelector('tbody').textContent")
    move(shown, values)
    answered(shown, 2)
    starts = [f"{key}={x}" for key, x in values.items() if "." in key] + given.pop("start", [])
    with pytest.raises((SetupError, SimulationError)) as refused:
        ask(name, start=starts, **given | {k: x for k, x in values.items() if "." not in k})
    assert shown.value(f"{PART}.querySelector('tbody').textContent") == before
    said = shown.value(f"{PART}.querySelector('.live-alarm').textContent")
    told = re.fullmatch("No answer with these values: (.+). Below is the last answer.", said)
    assert told is not None, said
    return told[1], str(refused.value)


def test_a_run_that_breaks_off_is_the_sentence_that_python_says(
    shown: Browser, tmp_path: Path
) -> None:
    given: dict[str, Any] = {"start": ["iron.on_invalid=stop"], "samples": 180}
    said, wanted = broken_off(shown, tmp_path / "page.html", "iron_cycle", {"speed": 9.0}, **given)
    same([said], [wanted])
    assert "cam follower lifts off at phi = " in said and "; stopped at t = " in said


@pytest.mark.slow
def test_an_unstable_step_is_the_sentence_that_python_says(shown: Browser, tmp_path: Path) -> None:
    given = {"speeds": "38,40,42", "steps_per_rev": 128, "algorithm": "jacobi"}
    file = tmp_path / "page.html"
    said, wanted = broken_off(shown, file, "resonance", {"motor.B": 500.0}, **given)
    assert said == wanted and "unstable" in said


@pytest.mark.slow
def test_a_step_too_long_to_tell_errors_is_the_sentence_that_python_says(
    shown: Browser, tmp_path: Path
) -> None:
    given: dict[str, Any] = {"algorithm": "jacobi", "step": 1.8e-3, "ratio": 6.0, "stop": 0.5}
    file = tmp_path / "page.html"
    said, wanted = broken_off(shown, file, "speed_step", {"ratio": 3.0}, **given)
    begin = "step = 0.0018 s is too long to determine errors: a run with 4 times the step, 0.0072 s, fails: gear"
    assert said.startswith(begin) and wanted.startswith(begin)


def test_without_webassembly_and_on_paper_the_page_is_still(shown: Browser, folder: Path) -> None:
    _, file = page("orientator_cycle", folder)
    shown.open(file, 1000)
    display = f"getComputedStyle({PART}).display"
    shown.until(f"{display} === 'block'")
    shown.call("Emulation.setEmulatedMedia", media="print")
    assert shown.value(display) == "none"
    shown.call("Emulation.setEmulatedMedia", media="screen")
    shown.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.WebAssembly")
    shown.events.clear()
    shown.call("Page.reload")
    shown.until("document.documentElement?.dataset.ready === 'yes' && !window.WebAssembly")
    assert shown.value(display) == "none"
    quiet(shown, file)


@pytest.mark.parametrize(
    "name",
    [
        path.stem if path.stem in SAMPLE else pytest.param(path.stem, marks=pytest.mark.slow)
        for path in sorted(FMUS.glob("native/*.fmu"))
    ],
)
def test_a_module_computes_what_its_fmu_does(name: str, shown: Browser, tmp_path: Path) -> None:
    """All outputs over steps of the default experiment; sin, cos and their like may round otherwise."""
    system = cosim.System({"m": FMUS / "native" / f"{name}.fmu"})
    description = connect(system).descriptions["m"]
    step = float(description.defaultExperiment.stepSize)
    inputs = [x.name for x in description.modelVariables if x.causality == "input"]
    result = cosim.run(system, stop=50 * step, step=step)
    engine = "".join((FOLDER / file).read_text().replace('"use strict";', "") for file in ENGINE)
    letters = base64.b64encode((FMUS / "wasm" / f"{name}.wasm").read_bytes()).decode()
    columns, empty = json.dumps(result.columns[1:]), tmp_path / "empty.html"
    empty.write_text("<!doctype html><html data-ready='yes'>")
    shown.open(empty, 1000)
    shown.value(f"window.letters = '{letters}', 0")
    imports, values, once, again = shown.value(f"""(() => {{ {engine}
        const bytes = Uint8Array.from(atob(letters), x => x.charCodeAt(0));
        const module = new WebAssembly.Module(bytes), system = new Network({{ m: module }}, [], ["m"]);
        system.start({{}});
        const rows = system.run({50 * step!r}, {step!r}, "strang", {columns});
        for (const name of {json.dumps(inputs)}) system.parts.m.set(name, system.parts.m.get(name) + 0.1);
        const {{ flat, instance }} = system.parts.m, kept = flat.save(instance);
        const on = () => {{
            flat.step(instance, rows.time.at(-1), {step!r});
            return {columns}.map(name => system.parts.m.get(name.slice(2)));
        }};
        const once = on();
        flat.restore(instance, kept);
        const again = on();
        flat.forget(instance, kept);
        return [WebAssembly.Module.imports(module), {columns}.map(name => rows[name].at(-1)), once,
            again]; }})()""")
    assert imports == []
    assert once == again != values
    assert values == pytest.approx(result.data[-1, 1:].tolist(), rel=1e-11, abs=1e-13)
