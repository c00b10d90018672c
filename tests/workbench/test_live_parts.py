"""What a live page is made of: formulas, readers, drawings and declarations, and their twins in JavaScript."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from textwrap import indent
from typing import Any

import numpy as np
import pytest

import cosim
from cosim import Result, SetupError
from cosim.metrics import Integral
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.machine import conveyor_drive
from scenarios.project import PROJECT
from tests.conftest import ROOT, ask, fmus_of
from tests.workbench.javascript import Evaluate, evaluator
from workbench import live
from workbench.answer import Findings, LivePart
from workbench.catalog import load_module, names
from workbench.charts.motion import Shape, line
from workbench.figure import Figure
from workbench.formula import Formula
from workbench.live import (
    REVOLUTION,
    Coordinate,
    Live,
    LiveMotion,
    LiveRun,
    LiveSweep,
    Number,
    Reader,
    RunChart,
    RunPanel,
    Slider,
    drawing,
)  # fmt: skip
from workbench.live.build import FOLDER
from workbench.question import read
from workbench.run import ask as workbench_ask


@pytest.fixture(scope="module")
def javascript(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Evaluate]:
    with evaluator(tmp_path_factory.mktemp("script")) as evaluate:
        if evaluate is None:
            pytest.skip("neither node nor chromium is installed: no script was run")
        yield evaluate


VALUES = {"motor.B": 3.5, "speed": 40.0, "conveyor.crank.r": 0.01, "x": -0.75}
FORMULAS = [
    "motor.B * speed - 1", "-x**2", "(-x)**2", "2**-1", "2**3**2", "-2 - -x", "1e3 * x / (2 * pi)",
    "conveyor.crank.r**2 / 2 * (speed + 1)", "speed > 3", "x <= -0.75", "speed == 40", "7",
    "hypot(3, 4) + abs(x)", "atan2(x, speed)", "mod(x, 0.5)", "mod(-speed, 360)", "where(x > 0, 1, 2)",
    "min(x, 2, speed) + max(x, 2, speed)", "sqrt(speed) * sin(x) + cos(x) * exp(x) - log(speed)",
    "sqrt(x)", "log(x)", "1 / (speed - 40)", "where(speed > 40, 1 / (speed - 40), 0)", "1 / (1 / (speed - 40))",
    "(x - 2)**0.5", "exp(1000)", "max(1, log(x))", "where(sqrt(x), 1, 2)", "(speed > 3) + (x < 0) - -(x < 1)",
    "1**(1 / (speed - 40))", "mod(-1e-17, 360)", "hypot(x)", "hypot(3, 4, 12)", "max(x)", "0**-1", "mod(x, 0)",
]  # fmt: skip


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_means_the_same_in_both_languages(text: str, javascript: Evaluate) -> None:
    formula, source = Formula.read(text), (FOLDER / "formula.js").read_text()
    value = javascript(
        f"{source} const v = {json.dumps(VALUES)}; return `${{+({formula.source})}}`;"
    )
    assert float(value) == pytest.approx(formula(VALUES), rel=1e-14, nan_ok=True)


@pytest.mark.parametrize(
    "text",
    [
        "a if b else c", "__import__('os')", "x // 2", "x % 2", "[x]", "x[0]", "lambda: x", "not x", "'a'",
        "f(x)", "x and y", "a < b < c", "x := 2", "", "True", "1j", "max(*x)", "round(x, ndigits=2)", "(x).y()",
        "x != 2", "1; 2", "sin(1, 2)", "log(8, 2)", "where(x, 1)", "max()", "1e999", "9" * 400, "\0",
        "(" * 500 + "x" + ")" * 500,
    ],
)  # fmt: skip
def test_what_is_no_formula_is_refused(text: str) -> None:
    with pytest.raises(SetupError, match=r"^the formula "):
        Formula.read(text)


def run_up() -> Result:
    page = load_module(names(PROJECT.home)["run_up"])
    import cosim

    start = SETS["B"].start(60.0) | {"motor.tau": 0.0, "conveyor.w": 0.0}
    return cosim.run(conveyor_drive(fmus_of(page), start), stop=0.5, step=2e-4)


def orientator() -> Result:
    page = load_module(names(PROJECT.home)["orientator_cycle"])
    return cosim.run(read(page)().system(fmus_of(page)), stop=0.6, step=1e-3)


def arm(nonlinear: float = 0.0) -> LiveMotion:
    """An arm whose end turns, and a slide that moves; perhaps with what no table has."""

    def draw(at: Mapping[str, Any]) -> list[Shape]:
        end = at["a.phi"], at["a.x"]
        return [
            Shape("ground", line((0.0, 0.0), (1.0, 0.0)), "grey"),
            Shape("arm", line((0.0, 0.0), (np.cos(end[0]), np.sin(end[0]))), "red", label=1),
            Shape("slide", line((end[1], 0.0), (end[1] + nonlinear * end[1] ** 2, 1.0)), "blue"),
        ]

    coordinates = [Coordinate("a.phi", 0.0, 6.0, (1.0,)), Coordinate("a.x", 0.0, 1.0)]
    return LiveMotion("Arm", draw, coordinates, [], 1.0)


def points_of(
    table: Mapping[str, Any], columns: Mapping[str, Any], motion: LiveMotion
) -> list[Any]:
    """The points of every shape of a table, complex, of shape (frames, n)."""
    features = drawing._features(motion.coordinates, columns)
    return [
        sum(
            np.outer(features[:, k], np.array(re) + 1j * np.array(im))
            for k, re, im in shape["terms"]
        )
        for shape in table["shapes"]
    ]


def test_a_drawing_is_a_table_of_coefficients_or_is_refused(javascript: Evaluate) -> None:
    motion = arm()
    table = drawing.coefficient_table(motion, 1)
    phi, x = np.array([0.3, 2.0]), np.array([0.1, 0.7])
    ground, tip, slide = points_of(table, {"a.phi": phi, "a.x": x}, motion)
    scale = abs(ground[0][1] - ground[0][0])
    zero = ground[0][0]
    assert (tip[:, 1] - zero) / scale == pytest.approx(np.exp(-1j * phi), abs=1e-6)
    assert ((slide[:, 0] - zero) / scale).real == pytest.approx(x, abs=1e-6)
    coordinates = [asdict(c) for c in motion.coordinates]
    source = (FOLDER / "motion.js").read_text()
    poses = javascript(f"""{source} const table = {json.dumps(table)};
        const features = featured({json.dumps(coordinates)}, [2.0, 0.7]);
        return table.shapes.map((shape) => points(shape, features, [5, 7]));""")
    for shape, (k, position) in zip(poses, enumerate((ground, tip, slide))):
        assert [complex(*xy) for xy in shape] == pytest.approx(list(position[-1] + 5 + 7j)), k
    with pytest.raises(drawing.NonlinearDrawingError, match="the slide would be drawn"):
        drawing.coefficient_table(arm(0.2), 1)


def test_a_machine_that_has_no_live_drawing_costs_a_warning_and_not_the_answer() -> None:
    answer = ask("run_up", stop=0.1, start={"conveyor.crank.r": 0.1})
    assert answer.live is not None and answer.live.data["motion"] is None
    (warning,) = [text for text in answer.warnings if "does not show" in text]
    assert "'Both conveyors from rest': with these dimensions the spring would be drawn" in warning


def built(declaration: Any) -> Any:
    """The live part of a product in the orientator, with another declaration."""
    page = load_module(names(PROJECT.home)["orientator_cycle"])
    o, modules = read(page)(), PROJECT.wasm_modules(read(page))
    figures = {"orientation_time": Figure(0.26, "s", 0.0, "time from drop to end")}
    findings = Findings(figures, None, o.system(fmus_of(page)))
    return live.of(declaration, o, findings, modules, "")


PANEL = RunPanel("angle", {"orientator.phi1": "red"}, "deg")
PLAIN = Live(sliders=[Slider("speed", 1.0, 5.0)], charts=[RunChart("A", "time [s]", [PANEL])])


def with_panel(**changes: Any) -> dict[str, Any]:
    """Another panel in the only chart."""
    return {"charts": [RunChart("A", "time [s]", [replace(PANEL, **changes)])]}


def with_number(value: Any, **more: Any) -> dict[str, Any]:
    """A value of the figure of the product."""
    return {"numbers": [Number("orientation_time", value, **more)]}


def with_reader(*values: Any, **more: Any) -> dict[str, Any]:
    """The same, read of the rows of a run."""
    return with_number(Reader(*values, **more))


FIRST, SECOND = Number("one", "figures.two", "s", "one"), Number("two", "stop", "s", "two")
CHART, W = PLAIN.charts[0], "orientator.w1"
MISFITS: list[tuple[dict[str, Any], str]] = [
    ({"sliders": [Slider("orientator.cup.x", 0.0, 1.0)]},
     "slider 'orientator.cup.x' is neither an option nor a start value"),
    ({"stop": "0 * speed"}, "stop = '0 * speed' is 0 s, but must be above 0"),
    ({"start": {"orientator.nothing": "speed"}}, "start: "),
    ({"start": {"orientator.w": "sped"}}, "uses 'sped', which is no option"),
    ({"factors": {"orientator.w": "speed"}}, "no wire leads to 'orientator.w'"),
    (with_panel(curves={"orientator.phi9": "red"}), "did you mean phi2?"),
    (with_panel(unit="mm"), "is in rad, which does not convert to mm"),
    (with_panel(curves={"2 * orientator.phi1": "red"}, unit=""), "chart 'A': panel 'angle' needs a unit, as in unit='m'"),
    ({"charts": [replace(CHART, x="crank_angle")]}, "crank_angle needs `angle`"),
    ({"charts": [replace(CHART, window="figures.two")]}, "chart 'A': the formula 'figures.two'"),
    (with_reader("median", W), "'median' must be one of last, change, max"),
    (with_reader("amplitude", W), "amplitude needs the window 'revolution'"),
    ({"angle": "orientator.phi1", "numbers": [Number("lag", Reader("phase", W, REVOLUTION), "rad", "lag")]},
     "phase is an angle in deg, not in rad"),
    (with_reader("mean", W, REVOLUTION), "a revolution needs `angle`"),
    (with_reader("last", W, run="second"), "there is no run 'second'"),
    (with_reader("max", f"abs({W})"), f"'abs({W})' is not in s, with {W} in rad/s"),
    (with_reader("first_crossing", W, level="stop"), "level: 'stop' is not in rad/s"),
    (with_number(Integral(W)), "a page has no metric; write a Reader"),
    (with_number("1", unit="ms"), "has the unit 'ms', its figure 's'"),
    ({"numbers": [Number("new", "1")]}, "is no figure of the answer, so it must have unit and meaning"),
    ({"numbers": [FIRST, SECOND]}, "uses 'figures.two', which is no number of this page"),
    ({"until": "figures.two"}, "uses 'figures.two'"),
    ({"until": REVOLUTION}, "until must be a time"),
    ({"sweep": LiveSweep("nothing", [1, 2], "step", [], CHART)}, "sweep over 'nothing'"),
    ({"sweep": LiveSweep("speed", [1.0], "step", [], CHART)}, "needs two values"),
    ({"runs": [LiveRun(start={"x.y": 1.0})]}, "start of a run: "),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), MISFITS, ids=lambda x: str(x)[:40])
def test_a_declaration_that_does_not_fit_is_a_clear_line(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(SetupError, match=re.escape(message)):
        built(replace(PLAIN, **changes))


def test_a_declaration_that_fits_has_its_columns_in_any_order_of_its_numbers() -> None:
    assert built(PLAIN).data["columns"] == ["orientator.phi1"]
    later = replace(SECOND, name="three", when="figures.four"), replace(SECOND, name="four")
    assert built(replace(PLAIN, numbers=[SECOND, FIRST, *later], until="figures.one"))


def test_a_sweep_of_a_single_speed_costs_the_live_sweep_and_not_the_answer() -> None:
    answer = ask("resonance", speeds="40", steps_per_rev=64)
    assert answer.live is not None and answer.live.data["sweep"] is None


def test_what_the_guide_teaches_of_live_pages_is_on_the_page(tmp_path: Path) -> None:
    """Its method, put below the others of the example as the guide says, in a file of the user's own that is asked."""
    guide = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    (method,) = re.findall(r"```python\n(def live.*?)```", guide, re.DOTALL)
    own = tmp_path / "own.py"
    own.write_text(
        (ROOT / "examples" / "run_down.py").read_text(encoding="utf-8")
        + "\n"
        + indent(method, " " * 4)
    )
    part = workbench_ask(PROJECT, str(own), {}, program="scenarios").live
    assert isinstance(part, LivePart)
    assert [x["name"] for x in part.data["sliders"]] == ["speed", "lag", "conveyor.trough.m"]
    assert [x["name"] for x in part.data["numbers"]] == ["tenth", "brake"]
    levels = [x for x in part.data["charts"][0]["traces"] if "level" in x]
    assert len(levels) == len(("a half", "a tenth"))


@pytest.mark.parametrize("algorithm", cosim.ALGORITHMS)
def test_the_coupling_loop_gives_the_rows_of_the_master(
    algorithm: str, javascript: Evaluate
) -> None:
    """Motor and conveyor over a start from rest, all columns of all rows."""
    answer = ask("run_up", stop=0.05, algorithm=algorithm)
    assert answer.live is not None
    worker = answer.live.worker.replace("\nonmessage =", "\nconst handle =")
    modules = {k: base64.b64encode(x).decode() for k, x in answer.live.modules.items()}
    rows = javascript(f"""{worker}
        const bytes = (text) => Uint8Array.from(atob(text), x => x.charCodeAt(0));
        const compiled = Object.entries({json.dumps(modules)}).map(([k, x]) => [k, new WebAssembly.Module(bytes(x))]);
        model = new Model({json.dumps(answer.live.data)}, Object.fromEntries(compiled));
        const rows = model.rows(model.values({{}}), model.data.runs[0], {{}}, 1);
        return Object.fromEntries(Object.entries(rows).map(([k, x]) => [k, [...x]]));""")
    question = PROJECT.load("run_up")
    system = question().system(PROJECT.fmus(question, "native"))["linear"]
    frame = cosim.run(system, stop=0.05, step=2e-4, algorithm=algorithm)
    for column in ("time", "motor.tau", "conveyor.w", "conveyor.f_rod", "conveyor.phi"):
        scale = float(np.abs(frame[column]).max())
        assert rows[column] == pytest.approx(frame[column].tolist(), rel=1e-11, abs=1e-12 * scale)
