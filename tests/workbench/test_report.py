"""What an answer shows: pictures as values, both renderers, the page parsed and in a browser, the
mechanisms that are drawn."""

from __future__ import annotations

import base64
import gzip
import io
import json
import math
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from lxml import html as lxml_html
from numpy.testing import assert_allclose

from cosim.system import connect
from scenarios.__main__ import PROJECT, ROOT
from scenarios.conveyor import mechanism as conveyor
from scenarios.conveyor import show as conveyor_show
from scenarios.conveyor.drive import conveyor_drive
from scenarios.conveyor.theory import SETS
from scenarios.iron import mechanism as iron_mechanism
from tests.conftest import QUICK
from tests.workbench.browser import Browser, browser
from workbench import ask
from workbench.answer import Answer, Show, Table, write
from workbench.figure import Figure
from workbench.fmus import Library
from workbench.options import made
from workbench.question import load, names
from workbench.report import html as page
from workbench.report import png
from workbench.report.chart import (
    MOST,
    SHOWN,
    Chart,
    Curve,
    Direction,
    Field,
    Lanes,
    Level,
    Mark,
    Panel,
    Second,
    Span,
    decades,
    flags,
    height,
    thinned,
    width,
)
from workbench.report.gif import gif
from workbench.report.html import limited, report
from workbench.report.motion import Motion, Shape
from workbench.report.plot import LETTERS, figure
from workbench.study import show as study_show

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
QUESTIONS = names(PROJECT.home)
OPTIONS = QUICK | {
    "resonance": {"speeds": "36,38,40,42,44", "steps_per_rev": 66, "algorithm": "gauss-seidel"}
}
Values = dict[tuple[str, str], tuple[Any, Any]]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all pages."""
    program = next((path for name in PROGRAMS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"none of {', '.join(PROGRAMS)} is installed: no page was looked at")
    with browser(program, tmp_path_factory.mktemp("browser")) as page:
        yield page


def answer(name: str, **given: Any) -> Answer:
    """The answer of a question with native FMUs, which are built already."""
    page = load(QUESTIONS[name])
    fmus = Library(PROJECT.fmus.folders).paths(page.PARTS, "native", ROOT)
    return ask.answer(page, made(page.Options, given, name), fmus, flavour="native")


@cache
def answered(name: str) -> tuple[Answer, Show]:
    """The answer of a question with short options, and what it shows."""
    found = answer(name, **OPTIONS[name])
    show = found.show()
    return replace(found, show=lambda: show), show


def by_png(chart: Chart | Field) -> tuple[Values, dict[str, tuple[float, float]]]:
    """What matplotlib has in its axes: x and y by label of the panel and name, limits by label."""
    drawn = png.drawn([chart], "")
    curves, limits = {}, {}
    for axes in drawn.subfigs[0].axes:
        label = axes.get_ylabel().replace("\n[", " [")
        limits[label] = axes.get_ylim()
        for line in axes.lines:
            curves[label, str(line.get_label())] = (line.get_xdata(), line.get_ydata())
        for bars in axes.containers:
            tops = [patch.get_height() for patch in getattr(bars, "patches", ())]
            curves.setdefault((label, str(bars.get_label())), (None, tops))
    png.pyplot().close(drawn)
    return curves, limits


def by_html(chart: Chart | Field) -> tuple[Values, dict[str, tuple[float, float]]]:
    """The same of plotly's dictionaries."""
    drawn = figure(chart)
    axes = {
        key.replace("axis", "") if key != "yaxis" else "y1": axis
        for key, axis in drawn["layout"].items()
        if key.startswith("yaxis") and "title" in axis
    }
    label = {key: axis["title"]["text"].replace("<br>[", " [") for key, axis in axes.items()}
    limits = {label[key]: tuple(axis["range"]) for key, axis in axes.items()}
    curves = {}
    for trace in drawn["data"]:
        at = trace.get("yaxis", "y1")
        if "name" in trace and at in label:
            y = np.array(trace["y"], float)
            curves[label[at], trace["name"]] = (trace["x"], y)
    return curves, limits


def sample_chart() -> Chart:
    """All that a chart can have."""
    x = np.linspace(1.0, 10.0, 41)
    gap = np.where(x > 8.0, np.nan, np.sin(x))
    return Chart(
        "All of it", "speed [rad/s]",
        [
            Panel("torque", "N.m", [
                Curve("theory", x, np.sin(x), "grey", "theory"),
                Curve("seen", x[::4], gap[::4], "red", "points", np.full(11, 0.1)),
            ], [Mark(2.5, "rated")]),
            Panel("force", "N", [Curve("force", x, x, "gold")], includes=(0.0,)),
            Panel("done", "1", [Curve("flag", x, (x > 4.0) * 1.0, "blue", "step")], includes=(0.0, 1.0)),
            Panel("energy", "J", [
                Curve("friction", x, x, "grey", "area"), Curve("stored", x, 2 * x, "sky", "area"),
                Curve("given", x, 3 * x, "red"),
            ]),
            Lanes({"stage": [Span(1.0, 9.0, "falling"), Span(9.0, 9.2, "turning", "red")]}),
        ],
        [Mark(3.0, "peak"), Mark(3.1, "crossing")], [Span(2.0, 4.0, "avoid", "red")],
        Second("rpm", 30 / math.pi),
    )  # fmt: skip


@pytest.mark.parametrize("read", [by_png, by_html])
def test_both_renderers_draw_the_values(read: Any) -> None:
    chart = sample_chart()
    curves, limits = read(chart)
    panels = [panel for panel in chart.panels if isinstance(panel, Panel)]
    assert {f"{p.quantity} [{p.unit}]" for p in panels} <= limits.keys()
    for panel in panels:
        assert limits[panel.label] == pytest.approx(height(panel))
        for curve in panel.curves:
            if curve.look != "area" or read is by_html:
                _, y = curves[panel.label, curve.name]
                assert_allclose(np.array(y, float), curve.y, rtol=1e-6)
    assert limits["force [N]"][0] == 0.0 < limits["force [N]"][1]
    assert limits["done [1]"] == (0.0, 1.0)
    assert limits["energy [J]"] == pytest.approx((0.0, 31.5), rel=0.01)
    assert_allclose(curves["torque [N.m]", "rated"][1], 2.5)
    assert limits["torque [N.m]"][1] > 2.5


def test_the_renderers_draw_marks_spans_lanes_errors_and_a_second_unit() -> None:
    chart = sample_chart()
    drawn = png.drawn([chart], "A title")
    axes = drawn.subfigs[0].axes
    words = {text.get_text() for a in axes for text in a.texts}
    names = {text.get_text() for a in axes if a.get_legend() for text in a.get_legend().get_texts()}
    (rpm,) = axes[-1].child_axes
    assert drawn._suptitle.get_text() == "A title"
    assert rpm.get_xlabel() == "[rpm]"
    layout, data = (figure(chart)[key] for key in ("layout", "data"))
    assert words == {text["text"] for text in layout["annotations"]}
    assert words == {"peak", "crossing", "avoid", "falling"}
    assert "turning" in names
    assert layout["xaxis2"]["range"] == pytest.approx(
        [x * 30 / math.pi for x in width(chart) or ()]
    )
    assert [s["x0"] for s in layout["shapes"] if s["type"] == "line"] == [3.0, 3.1]
    by_name = {trace.get("name"): trace for trace in data}
    assert by_name["seen"]["error_y"]["array"] == [0.1] * 11
    assert by_name["flag"]["line"]["shape"] == "hvh"
    (line,) = (line for line in axes[2].lines if line.get_label() == "flag")
    assert line.get_drawstyle() == "steps-mid"
    png.pyplot().close(drawn)


def test_words_above_a_picture_stand_in_lanes_where_they_meet() -> None:
    placed = flags(sample_chart(), LETTERS)
    assert {flag.text: flag.lane for flag in placed} == {"avoid": 0, "peak": 1, "crossing": 2}
    far = Chart("", "", [Panel("", "", [Curve("", [0.0, 100.0], [0.0, 1.0], "red")])],
                [Mark(10.0, "here"), Mark(90.0, "there")])  # fmt: skip
    assert [flag.lane for flag in flags(far, LETTERS)] == [0, 0]


def test_a_logarithmic_axis_tells_its_numbers() -> None:
    assert decades(0.01, 100.0) == [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]
    assert decades(0.015, 0.16) == [0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15]


@pytest.mark.parametrize("read", [by_png, by_html])
def test_a_field_is_coloured_by_its_logarithm_with_levels_and_curves_over_it(read: Any) -> None:
    values = np.array([[0.1, 1.0, np.nan], [10.0, 100.0, 0.01]])
    x = Direction("speed", "rad/s", np.arange(3.0))
    y = Direction("T", "s", np.arange(1.0, 3.0), True)
    ridge = Curve("ridge", [0.5], [1.5], "grey", "theory")
    limit = Level(2.0, "limit", np.array([[1.0, 3.0, 3.0], [1.0, 3.0, 3.0]]))
    field = Field("Gain", x, y, "gain", values, [ridge], True, [limit], [Span(0.5, 1.5, "range")])
    assert read(field)[0]["T [s]", "ridge"][1] == [1.5]
    heat, *lines, line = figure(field)["data"]
    assert heat["z"] == [[-1.0, 0.0, None], [1.0, 2.0, -2.0]]
    assert heat["customdata"] == [[0.1, 1.0, None], [10.0, 100.0, 0.01]]
    assert heat["colorbar"]["ticktext"][0::12] == ["0.01", "100"]
    assert [contour["contours"]["start"] for contour in lines] == [2.0, 2.0]
    drawn = png.drawn([field], "")
    (mesh, *contours) = drawn.subfigs[0].axes[0].collections
    assert mesh.norm.vmin == 0.01 and mesh.norm.vmax == 100.0
    assert_allclose(contours[0].get_paths()[0].vertices[:, 0], 0.5)
    assert drawn.subfigs[0].axes[0].get_yscale() == "log"
    png.pyplot().close(drawn)


CLAIMS = """
resonance | torque ripple | co-simulation | | tau2
resonance | speed ripple | co-simulation | | w2
resonance | lag behind the load | co-simulation | | lag
resonance_map | largest torque ripple | nominal machine | rows | ripple_in_range
run_up | crank speed | linear motor | linear | conveyor.w
run_up | motor torque | linear motor | linear | motor.tau
run_up | motor torque | induction motor (Kloss) | kloss | motor.tau
run_up | rod force | induction motor (Kloss) | kloss | conveyor.f_rod
iron_cycle | lift | lift | | iron.lift
iron_cycle | velocity | velocity | | iron.v
iron_cycle | acceleration | acceleration | | iron.a
iron_cycle | torque of the cam | torque of the cam | | iron.tau_cam
iron_cycle | forces | cam on follower | | iron.N
iron_cycle | forces | chain at the link | | iron.T_span
iron_cycle | forces | chain at the iron | | iron.T_iron
iron_start | cam speed | cam speed | | iron.w_cam
iron_start | motor torque | motor torque | | motor.tau
iron_start | energy | from the motor | | E_in
iron_start | energy | stored | | E_stored
iron_start | energy | friction | | E_friction
orientator_cycle | angle | catcher | | orientator.phi1
orientator_cycle | angle | cup | | orientator.phi2
orientator_cycle | speed | cup | | orientator.w2
orientator_cycle | centre of mass | down | | orientator.vyc
orientator_cycle | reaction of the wall | wall | | orientator.N_K
packing_line | lift of the iron | iron | | iron.lift
packing_line | power, iron | iron | | iron_motor.P
packing_line | power, conveyor | conveyor | | conveyor_motor.P
packing_line | power, supply | supply | | P_supply
""".strip()


@pytest.mark.parametrize("claim", CLAIMS.splitlines())
def test_every_curve_is_the_column_that_it_claims_to_be(claim: str) -> None:
    """As a value and by both renderers, in the unit that the table has, or one that it converts to."""
    name, quantity, curve, file, column = (word.strip() for word in claim.split("|"))
    found, show = answered(name)
    (table,) = (t for n, t in found.tables.items() if file in n and column in t.units)
    seen = 0
    for chart in show.charts:
        for panel in chart.panels if isinstance(chart, Chart) else ():
            if not isinstance(panel, Panel) or panel.quantity != quantity:
                continue
            unit, seen = table.units[column], seen + 1
            scale = 1.0 if panel.unit == unit else SHOWN[unit, panel.unit]
            (value,) = (np.asarray(c.y) for c in panel.curves if c.name == curve)
            assert np.isin(value, scale * table.frame[column].to_numpy()).all()
            for read in (by_png, by_html):
                if read is by_png and curve in ("stored", "friction"):
                    continue
                _, y = read(chart)[0][panel.label, curve]
                y = np.array(y, float)
                assert (y.min(), y.max()) == pytest.approx((value.min(), value.max()), rel=1e-6)
    assert seen


def test_the_ripples_have_the_units_of_what_ripples() -> None:
    fmus = Library(PROJECT.fmus.folders).paths(load(QUESTIONS["resonance"]).PARTS, "native", ROOT)
    network = connect(conveyor_drive(fmus, SETS["A"].start(40.0)))
    units = {port: network.port(port).unit for port in ("motor.tau", "conveyor.w")}
    (ripple,) = answered("resonance")[1].charts
    assert isinstance(ripple, Chart)
    told = {panel.quantity: panel.unit for panel in ripple.panels if isinstance(panel, Panel)}
    assert told["torque ripple"] == units["motor.tau"] == "N.m"
    assert told["speed ripple"] == units["conveyor.w"] == "rad/s"


def test_the_resonance_answers_its_question_in_the_title() -> None:
    machine, nu = SETS["A"], np.linspace(20.0, 60.0, 41)
    error = {f"{name}_error": 0.5 for name in ("tau2", "w2", "lag")}
    points = [
        SimpleNamespace(nu=x, tau2=abs(machine.torque_ripple(x)), w2=1.0, lag=90.0, **error)
        for x in nu
    ]
    figures = {
        "nu_90": Figure(40.0034, "rad/s", 0.0012),
        "nu_peak_tau": Figure.refused("rad/s", "no peak"),
    }
    on, off = (
        conveyor_show.ripple(machine, points, figures, speed, 100.0, 50.0, [(27.0, 45.0)])
        for speed in (40.0, 57.0)
    )
    where = "the torque ripple is above 50 N.m at 27.0 to 45.0 rad/s"
    assert (on.title, off.title) == (f"Yes at 40 rad/s: {where}", f"No at 57 rad/s: {where}")
    assert list(on.spans) == [Span(27.0, 45.0, "avoid", "red")]
    assert [mark.text for mark in on.marks] == [
        "formula 40.00 rad/s", "90 deg lag 40.0034 ± 0.0012 rad/s", "operating speed 40 rad/s",
    ]  # fmt: skip
    torque = on.panels[0]
    assert isinstance(torque, Panel)
    assert [level.at for level in torque.levels] == [100.0, 50.0]
    assert list(torque.curves[1].error or ()) == [0.5] * 41


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of an answer made up here, with all that a page may show."""
    folder = tmp_path_factory.mktemp("sample")
    x = np.linspace(0.0, 10.0, 5001)
    y = np.sin(x)
    y[1234] = 7.5
    turn = np.linspace(0.0, 2 * np.pi, 61)
    arm = np.stack(
        [np.stack([0 * turn, 0 * turn], 1), np.stack([np.cos(turn), np.sin(turn)], 1)], 1
    )
    panels = [
        Panel("force", "N", [Curve("theory", x[::500], np.sin(x[::500]), "grey", "theory"),
                             Curve("seen", x, y, "red")]),
        Panel("way", "m", [Curve("way", x, x**2, "blue")], [Mark(50.0, "half")]),
    ]  # fmt: skip
    motion = Motion("Arm", turn / 10, 2.0, [f"at {k}" for k in range(61)],
                    [Shape("arm", arm, "red", label=1)])  # fmt: skip
    chart = Chart(
        "Force & way", "time [s]", panels, [Mark(5.0, "middle")], second=Second("ms", 1e3)
    )
    figures: dict[str, Any] = {
        "told": Figure(2.0, "N", 0.01, "a force"),
        "formula": Figure(1.25, "1", 0.0),
        "lost": Figure.refused("m", "the runs contradict each other"),
    }
    made_up = Answer(
        scenario="sample",
        question="Is <this> & that told?",
        verdict="Yes: 2.00 ± 0.01 N.\nNo.",
        figures=figures,
        parameters={},
        tables={"sample.csv": Table(pd.DataFrame({"x": x, "y": y}), {"x": "s", "y": "N"})},
        provenance={
            "algorithm": "strang", "communication": "steps of 0.1 s", "wires": ["a.y -> b.u"],
            "parts": {"a": {"fmu": "A.fmu", "guid": "{12-34}"}, "b": {"fmu": "B.fmu", "guid": "{5}"}},
            "versions": {"python": "3"}, "flavour": "native",
        },
        warnings=["a: the chain is <slack>"],
        show=lambda: Show([chart], [motion]),
    )  # fmt: skip
    assert write(made_up, folder) == ["sample.csv", "sample.json", "sample.png", "report.html"]
    assert (folder / "sample.png").read_bytes().startswith(b"\x89PNG")
    return folder


def parsed(file: Path) -> Any:
    """The page as a tree."""
    return lxml_html.fromstring(file.read_text(encoding="utf-8"))


def lines(tree: Any, place: str) -> list[list[str]]:
    """The text of a table, row by row."""
    return [[cell.text_content() for cell in row] for row in tree.xpath(place)]


FIGURES = "//table[contains(@class, 'figures')]/tbody/tr"


@pytest.mark.parametrize("name", QUESTIONS)
def test_the_page_of_every_question_holds_all_that_was_found(name: str, tmp_path: Path) -> None:
    found, show = answered(name)
    report(found, tmp_path / "report.html")
    tree = parsed(tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 8e6
    assert tree.xpath("string(//h1)") == found.question
    said = [p.text_content() for p in tree.xpath("//section[@class='verdict']//p")]
    assert said == [line for line in found.verdict.splitlines() if line]
    rows = lines(tree, FIGURES)
    assert [(row[0], row[3]) for row in rows] == [(n, f.unit) for n, f in found.figures.items()]
    for (_, value, error, *_), told in zip(rows, found.figures.values()):
        if told.error is None:
            assert (value, error) == ("not told", told.reason)
        else:
            assert float(value) == pytest.approx(told.value, rel=1e-5, abs=told.error)
    text = tree.text_content()
    assert all(parameter in text for parameter in found.parameters)
    assert all(part["guid"] in text for part in found.provenance["parts"].values())
    anchors = [link.get("href")[1:] for link in tree.xpath("//nav//a")]
    assert len(anchors) > 4
    assert all(tree.xpath(f"//*[@id='{anchor}']") for anchor in anchors)
    titles = [h.text_content() for h in tree.xpath("//figure/h3")]
    assert titles == [x.title for x in (*show.charts, *show.more, *show.motions)]
    assert all(cell.get("scope") for cell in tree.xpath("//th"))
    assert all(place.get("aria-label") for place in tree.xpath("//*[@class='chart']"))


def test_the_page_tells_errors_warnings_and_what_is_dangerous_as_text(sample: Path) -> None:
    tree = parsed(sample / "report.html")
    assert lines(tree, FIGURES) == [
        ["told", "2.000", "± 0.010", "N", "a force"],
        ["formula", "1.25", "none", "1", ""],
        ["lost", "not told", "the runs contradict each other", "m", ""],
    ]
    assert tree.xpath("string(//h1)") == "Is <this> & that told?"
    (box,) = tree.xpath("//main/section[contains(@class, 'warnings')]")
    assert box.text_content().strip() == "a: the chain is <slack>"
    assert box.getnext().get("class") == "verdict"
    assert lines(tree, "//section[@class='verdict']") == [["Yes: 2.00 ± 0.01 N.", "No."]]
    (label,) = tree.xpath("//*[@class='chart']/@aria-label")
    assert "seen from -1 to 7.5 (force [N])" in label


@pytest.mark.parametrize("name", QUESTIONS)
def test_the_page_of_every_question_shows_without_network_or_error(
    name: str, shown: Browser, tmp_path: Path
) -> None:
    file = tmp_path / "report.html"
    found, show = answered(name)
    report(found, file)
    shown.open(file, 390, 800)
    assert shown.value("document.documentElement.scrollWidth") == 390
    assert shown.told("Runtime.exceptionThrown") == []
    assert shown.told("Log.entryAdded") == []
    asked = [told["request"]["url"] for told in shown.told("Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [
        file.resolve().as_uri()
    ]
    drawn = shown.value(
        "[...document.querySelectorAll('.chart')].map(c => c.querySelectorAll('.trace, .hm').length)"
    )
    assert len(drawn) == len(show.charts) + len(show.more) and all(drawn)
    outlines = "[...document.querySelectorAll('.motion svg')].map(s => s.innerHTML)"
    before = shown.value(outlines)
    assert len(before) == len(show.motions) > 0
    shown.until(f"{outlines}.every((now, k) => now !== {json.dumps(before)}[k])")
    covered = """[...document.querySelectorAll('.chart')].flatMap(c =>
        [...c.querySelectorAll('g.legend')].filter(g => {
            const box = g.getBoundingClientRect();
            return [...c.querySelectorAll('.subplot .plot')].some(p => {
                const plot = p.getBoundingClientRect();
                return plot.height && box.top < plot.bottom - 3 && plot.top + 3 < box.bottom; });
        }).map(g => g.textContent))"""
    assert shown.value(covered) == []
    shown.resize(1000, 800)
    shown.until("Math.abs(document.querySelector('.chart svg').clientWidth - 928) < 2")


def test_the_mouse_shows_values_and_the_second_unit_follows_the_zoom(
    shown: Browser, sample: Path
) -> None:
    shown.open(sample / "report.html", 1000, 800)
    place = shown.value(
        """(() => { const chart = document.querySelector('.chart'), full = chart._fullLayout;
        chart.scrollIntoView();
        const box = chart.getBoundingClientRect();
        return [box.left + full._size.l + full.xaxis.d2p(4), box.top + full._size.t + 90]; })()"""
    )
    for shift in (-3, 0):
        x, y = place[0] + shift, place[1]
        shown.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    shown.until("document.querySelectorAll('.hoverlayer text').length > 0")
    words = shown.value("document.querySelector('.hoverlayer').textContent")
    assert f"{np.sin(4.0):.4f}"[:5] in words.replace("−", "-")
    assert "way" in words
    assert words.rstrip().endswith(" m")
    shown.value(
        "Plotly.relayout(document.querySelector('.chart'), {'xaxis.range': [2, 3]}).then(() => 1)"
    )
    axis = "document.querySelector('.chart')._fullLayout.xaxis2.range"
    shown.until(f"{axis}[0] === 2000 && {axis}[1] === 3000")


def test_the_download_is_the_csv_to_the_byte(shown: Browser, sample: Path, tmp_path: Path) -> None:
    shown.open(sample / "report.html", 1000, 800)
    shown.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    shown.until("document.querySelector('a[download]').href.startsWith('blob:')")
    shown.value("document.querySelector('a[download]').click()")
    saved = tmp_path / "sample.csv"
    shown.until_here(saved.exists)
    assert saved.read_bytes() == (sample / "sample.csv").read_bytes()


def test_motion_follows_slider_and_button(shown: Browser, sample: Path) -> None:
    """A quarter of a turn after a quarter of the time; the picture is 1000 wide for two arms."""
    shown.open(sample / "report.html", 1000, 800)
    assert shown.value("document.querySelector('.motion button').textContent") == "Pause"
    shown.value("document.querySelector('.motion button').click()")
    outline = "document.querySelector('.motion path').getAttribute('d')"
    still = shown.value(outline)
    shown.value("new Promise(resolve => setTimeout(resolve, 100))")
    assert shown.value(outline) == still
    assert shown.value("document.querySelector('.motion button').textContent") == "Play"
    quarter = 2 * np.pi / 10 / 4
    shown.value(
        f"""(() => {{ const slider = document.querySelector('.motion input');
        slider.value = {quarter}; slider.dispatchEvent(new Event('input')); }})()"""
    )
    assert shown.value(outline) == "M500.0 500.0L500.0 0.0"
    assert shown.value("document.querySelector('.motion .caption').textContent") == "at 15"
    shown.value("document.querySelector('.motion button').click()")
    shown.until(f"{outline} !== 'M500.0 500.0L500.0 0.0'")


def test_paper_gets_everything_but_the_controls(shown: Browser, sample: Path) -> None:
    shown.open(sample / "report.html", 1000, 800)
    assert shown.pdf().startswith(b"%PDF")
    shown.call("Emulation.setEmulatedMedia", media="print")
    shown.value("dispatchEvent(new Event('beforeprint'))")
    gone = "getComputedStyle(document.querySelector('{}')).display === 'none'"
    for control in (".controls", "nav", ".hint", "[aria-labelledby=data]"):
        assert shown.value(gone.format(control))
    for content in (".chart", ".motion svg", ".figures", ".verdict", ".warnings"):
        assert not shown.value(gone.format(content))
    assert shown.value("[...document.querySelectorAll('details')].every(d => d.open)")
    shown.until("document.querySelector('.chart svg').getBoundingClientRect().width === 680")


def test_the_page_is_dark_where_the_screen_is(shown: Browser, sample: Path) -> None:
    features = [{"name": "prefers-color-scheme", "value": "dark"}]
    shown.open(sample / "report.html", 1000, 800)
    back = "getComputedStyle(document.body).backgroundColor"
    assert shown.value(back) == "rgb(255, 255, 255)"
    shown.call("Emulation.setEmulatedMedia", features=features)
    assert shown.value(back) == "rgb(18, 23, 28)"
    ink = "getComputedStyle(document.querySelector('.chart .ytick text')).fill"
    assert shown.value(ink) == "rgb(227, 232, 237)"


def test_thinning_keeps_ends_and_peaks() -> None:
    rng = np.random.default_rng(1)
    x, y = np.arange(100_000.0), rng.normal(size=100_000)
    y[[777, 54_321]] = 99.0, -99.0
    few_x, few_y = thinned(x, y)
    assert len(few_x) <= MOST
    assert {777.0, 54_321.0, 0.0, 99_999.0} <= set(few_x)
    assert (few_y.min(), few_y.max()) == (-99.0, 99.0)
    assert (np.diff(few_x) > 0).all()
    assert_allclose(few_y, y[few_x.astype(int)])
    assert thinned(x[:10], y[:10])[0].tolist() == x[:10].tolist()


def test_a_table_too_large_for_a_page_is_thinned_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    x = np.random.default_rng(1).normal(size=4000)
    table = Table(pd.DataFrame({"x": x}), {"x": "1"})
    whole, note = limited(table)
    assert note == "4000 rows"
    monkeypatch.setattr(page, "LARGEST", len(whole) // 3)
    packed, note = limited(table)
    assert len(packed) < len(whole) // 3
    assert note == "one row in 4 of 4000; the whole file lies beside this page"
    rows = pd.read_csv(io.BytesIO(gzip.decompress(base64.b64decode(packed))))
    assert_allclose(rows["x"], x[::4])


def test_a_study_draws_flags_as_steps_and_no_share_below_0(tmp_path: Path) -> None:
    table = pd.DataFrame(
        {"w": [1.0, 2.0, 3.0], "oriented": [1.0, 1.0, 0.0], "time": [0.2, 0.3, np.nan]}
    )
    study: Any = SimpleNamespace(varied=["w"], grid={"w": table["w"]}, tolerances={})
    (chart,) = study_show.overview(study, table, ["oriented", "time"], {"w": "rad/s", "time": "s"})
    assert isinstance(chart, Chart)
    assert [curve.look for panel in chart.panels for curve in panel.curves] == ["step", "linked"]
    assert [panel.label for panel in chart.panels] == ["oriented [1]", "time [s]"]
    assert chart.x == "w [rad/s]"
    found = pd.DataFrame(
        [("time", "T", "S1", -0.09, 0.15), ("time", "J", "S1", 0.7, 0.1)],
        columns=["figure", "input", "kind", "value", "confidence"],
    )
    study = SimpleNamespace(grid={}, tolerances={"T": 0, "J": 0})
    (shares,) = study_show.sensitivity(study, found, {})
    for read in (by_png, by_html):
        curves, limits = read(shares)
        assert_allclose(curves["share of time [1]", "S1, alone"][1], [0.0, 0.7])
        assert limits["share of time [1]"][0] == 0.0


def test_a_gif_has_the_frames_of_its_motion(tmp_path: Path) -> None:
    turn = np.linspace(0.0, 1.0, 7)
    arm = np.stack(
        [np.stack([0 * turn, 0 * turn], 1), np.stack([np.cos(turn), np.sin(turn)], 1)], 1
    )
    gif(
        tmp_path / "arm.gif",
        Motion("Arm", turn, 1.0, [""] * 7, [Shape("arm", arm, "red", label=1)]),
    )
    from PIL import Image

    with Image.open(tmp_path / "arm.gif") as image:
        assert image.n_frames == 7  # type: ignore[attr-defined]
        frames = [np.array(image.convert("L")) for k in (0, 6) if image.seek(k) is None]
    assert (frames[0] != frames[1]).sum() > 50


def lengths(points: np.ndarray) -> np.ndarray:
    """Lengths of the pieces of a line at all times, shape (frames, n - 1)."""
    return np.linalg.norm(np.diff(points, axis=1), axis=-1)


@pytest.mark.parametrize("wrap", [0, 1])
def test_the_drawn_iron_drive_keeps_its_lengths_and_its_contact(wrap: int) -> None:
    found = answer("iron_cycle", samples=180, start=[f"iron.wrap={wrap}"])
    (motion,) = found.show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes}
    p = {name.removeprefix("iron."): x.value for name, x in found.parameters.items()}
    assert_allclose(lengths(shapes["rocker"])[:, 0], p["rocker.l"])
    assert_allclose(lengths(shapes["rocker"])[:, 1], p["rocker.l_K"])
    assert_allclose(lengths(shapes["link"]), p["link.l"])
    assert_allclose(lengths(shapes["chain"]).sum(axis=1), p["chain.l"], rtol=1e-3)
    span = np.diff(shapes["chain"][:, :2], axis=1)[:, 0]
    link = np.diff(shapes["link"], axis=1)[:, 0]
    assert_allclose(span[:, 0] * link[:, 1], span[:, 1] * link[:, 0], atol=1e-9)
    roller = shapes["rocker"][:, :1]
    gap = np.linalg.norm(shapes["cam"] - roller, axis=-1).min(axis=1)
    assert_allclose(gap, iron_mechanism.ROLLER, atol=2e-4)
    assert_allclose(np.linalg.norm(shapes["roller"] - roller, axis=-1), iron_mechanism.ROLLER)
    assert_allclose(shapes["spring"][:, 0, 1] - shapes["iron"][:, 2, 1], 0.0, atol=1e-9)
    lift = shapes["iron"][:, 0, 1] - shapes["iron"][0, 0, 1]
    assert lift.max() == pytest.approx(found.figures["stroke"].value, rel=1e-3)


def test_the_drawn_crank_moves_the_drawn_trough() -> None:
    (motion,) = answer("run_up", stop=0.2, start=["conveyor.rod.finite=1"]).show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes[: len(motion.shapes) // 2]}
    crank = lengths(shapes["crank"])
    assert_allclose(crank, conveyor.ENLARGED * 0.01)
    assert_allclose(lengths(shapes["rod"]), 0.4, rtol=0.01)
    assert_allclose(shapes["crank"][:, 1], shapes["rod"][:, 0])
    assert_allclose(shapes["rod"][:, 1], shapes["trough"][:, 0])
    assert_allclose(shapes["spring"][:, 0, 0], shapes["trough"][:, 2, 0])


def test_the_drawn_cup_is_rigid_and_turns_over_in_front_of_the_wall() -> None:
    (motion,) = answer("orientator_cycle").show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes}
    assert_allclose(np.ptp(lengths(shapes["cup"]), axis=0), 0.0, atol=1e-12)
    assert_allclose(lengths(shapes["catcher"]), [[0.18, 0.01]] * len(motion.times))
    wall = shapes["wall"][..., 0].min()
    assert shapes["cup"][..., 0].max() < wall + 1e-3
    upright = shapes["cup"][:, 13, 1] - shapes["cup"][:, 0, 1]
    assert upright[0] > 0.06 > -0.06 > upright[-1]
