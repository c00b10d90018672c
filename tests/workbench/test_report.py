"""What an answer shows: pictures as values, both renderers, the page parsed and in a browser, the
mechanisms that are drawn."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from lxml import html as lxml_html
from numpy.testing import assert_allclose
from PIL import Image

from cosim.units import multiples
from scenarios.conveyor import motion as conveyor
from scenarios.iron import motion as iron_mechanism
from scenarios.project import PROJECT
from tests.conftest import SAMPLED, ask, plain
from tests.workbench.browser import Browser, browser
from workbench.answer import Answer, Show, Table
from workbench.catalog import names
from workbench.charts import model as pictures
from workbench.charts import plotly
from workbench.charts.gif import gif
from workbench.charts.layout import layout_of
from workbench.charts.model import (
    Chart,
    Curve,
    HeatMap,
    Mark,
    Panel,
    SecondUnit,
    Span,
)
from workbench.charts.motion import Motion, Shape
from workbench.charts.style import STYLE
from workbench.export import write
from workbench.figure import Figure
from workbench.judgement import Judgement
from workbench.page import html
from workbench.run import ask as workbench_ask
from workbench.study.charts import is_geometric

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
QUESTIONS = names(PROJECT.home)
QUICK_QUESTIONS = ("resonance",)
OPTIONS = {
    "resonance": {"speeds": "36,38,40,42,44", "steps_per_rev": 128, "algorithm": "gauss-seidel"}
}
FIGURES = "//table[contains(@class, 'figures')]/tbody/tr"
Values = dict[tuple[str, str], Any]


@pytest.fixture(scope="module")
def page_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all pages."""
    program = next((path for name in PROGRAMS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"none of {', '.join(PROGRAMS)} is installed: no page was looked at")
    blank = tmp_path_factory.mktemp("blank") / "blank.html"
    blank.write_text('<!doctype html><html data-ready="yes"><title>blank</title></html>')
    with browser(program, tmp_path_factory.mktemp("browser")) as page:
        page.open(blank, 1000)  # a script can be run before any page of an answer is opened
        yield page


@cache
def answered(name: str) -> tuple[Answer, Show]:
    """The answer of a question with short options, and what it shows."""
    answer = ask(name, **OPTIONS[name]) if name in OPTIONS else plain(name)
    show = answer.show()
    return replace(answer, show=lambda: show), show


def named(plotted: Any, screen: str = "wide") -> dict[str, Any]:
    """What a picture says of each y axis, by its label."""
    axes = {key: axis for key, axis in plotted[screen].items() if key.startswith("yaxis")}
    return {
        axis["title"]["text"].replace("<br>", " "): axis | {"key": key}
        for key, axis in axes.items()
    }


def curves(picture: Chart | HeatMap) -> Values:
    """The values of plotly's traces by label of their panel and name; the last of those of a name."""
    plotted = plotly.figure(picture)
    labels = {axis["key"].replace("axis", ""): label for label, axis in named(plotted).items()}
    return {
        (labels[trace["yaxis"]], trace["name"]): np.array(
            trace.get("customdata", trace["y"]), float
        )
        for trace in sorted(plotted["data"], key=lambda trace: trace.get("hoverinfo") != "skip")
        if "name" in trace
    }


def test_an_axis_of_a_study_with_logarithmic_spacing_is_logarithmic() -> None:
    assert is_geometric([0.015, 0.015 * 4.0, 0.015 * 16.0]) and is_geometric(
        np.geomspace(1e-3, 1.0, 7)
    )
    for values in ([1.0, 2.0, 3.0], [1.0, 10.0], [0.0, 1.0, 10.0], [-1.0, 1.0, -1.0], []):
        assert not is_geometric(values)


def test_a_colour_and_a_look_that_do_not_exist_are_named() -> None:
    chart = Chart("", "x", [Panel("w", "rad/s", [Curve("w", [0.0, 1.0], [0.0, 1.0], "turquoise")])])
    with pytest.raises(ValueError, match="color 'turquoise' must be one of red, blue"):
        layout_of(chart)
    with pytest.raises(ValueError, match="curve 'w': 'dots' must be one of line, theory, points"):
        pictures.NamedLook.of(("w", "red", "dots"), "speed")
    assert pictures.NamedLook.of("red", "speed") == ("speed", "red", "line")


def test_a_field_is_coloured_by_its_logarithm_with_levels_and_curves_over_it() -> None:
    values = np.array([[0.1, 1.0, np.nan], [10.0, 100.0, 0.01]])
    x = pictures.GridAxis("speed", "rad/s", np.arange(3.0))
    y = pictures.GridAxis("T", "s", np.arange(1.0, 3.0), True)
    ridge = Curve("ridge", [0.5], [1.5], "grey", "theory")
    limit = pictures.Level(2.0, "limit", np.array([[1.0, 3.0, 3.0], [1.0, 3.0, 3.0]]))
    heat_map = HeatMap(
        "Gain", x, y, "gain", values, [ridge], True, [limit], [Span(0.5, 1.5, "range")]
    )
    assert curves(heat_map)["T [s]", "ridge"].tolist() == [1.5]
    heat, rim, line, *_ = plotly.figure(heat_map)["data"]
    assert heat["z"] == [[-1.0, 0.0, None], [1.0, 2.0, -2.0]]
    assert heat["customdata"] == [[0.1, 1.0, None], [10.0, 100.0, 0.01]]
    bar = plotly.figure(heat_map)["wide"]["coloraxis"]["colorbar"]
    assert (bar["tickvals"][0], bar["ticktext"][0], bar["ticktext"][-1]) == (-2.0, "0.01", "100")
    assert [set(trace["x"]) - {None} for trace in (rim, line)] == [{0.5}, {0.5}]


#: By case and part of the name of its table: a panel's quantity, its curve, and the column.
CLAIMS = {
    ("resonance", ""): "torque ripple: co-simulation = tau2; speed ripple: co-simulation = w2; "
    "lag behind the load: co-simulation = lag",
    ("resonance_map", "rows"): "largest torque ripple: nominal machine = ripple_in_range",
    ("mean_values", ""): "mean torque: with ripple, co-simulation = torque",
    (
        "resonance classical",
        "classical",
    ): "torque ripple: co-simulation = tau2; speed ripple: co-simulation = w2; "
    "largest rod force: co-simulation = f_rod_peak; "
    "error with spring and inertia: speed ripple = whole_speed",
    ("induction_motor", ""): "speed of 90 deg lag: full characteristic = nu_kloss; "
    "damping ratio: formula = zeta; torque ripple: linear motor = tau2_linear",
    ("iron_cycle", ""): "lift: lift = iron.lift; forces: chain at the link = iron.T_span",
    ("orientator_cycle", ""): "angle: cup = orientator.phi2; centre of mass: down = orientator.vyc",
    ("packing_line", ""): "power, supply: supply = P_supply",
}


@pytest.mark.parametrize(("name", "file"), CLAIMS)
def test_every_curve_is_the_column_that_it_claims_to_be(name: str, file: str) -> None:
    """In the unit that the table has, or one that it converts to."""
    answer, show = answered(name)
    for claim, column in (claim.split(" = ") for claim in CLAIMS[name, file].split("; ")):
        quantity, curve = claim.split(": ")
        (table,) = (t for n, t in answer.tables.items() if file in n and column in t.units)
        panels = [
            (chart, panel)
            for chart in show.charts if isinstance(chart, Chart)
            for panel in chart.panels if isinstance(panel, Panel) and panel.quantity == quantity
        ]  # fmt: skip
        assert panels
        for chart, panel in panels:
            unit = table.units[column]
            scale = multiples(panel.unit)[unit]
            (value,) = (np.asarray(c.y) for c in panel.curves if c.name == curve)
            assert np.isin(value, scale * table.frame[column].to_numpy()).all()
            y = curves(chart)[panel.label, curve]
            assert (y.min(), y.max()) == pytest.approx((value.min(), value.max()), rel=1e-6)


#: By question: names of a line of theory and of the points that it explains, in every panel that has both.
EXPLAINED = {
    "mean_values": [(f"{x}, second-order theory", f"{x}, co-simulation") for x in (
        "with ripple", "over time", "over the angle", "from the supply", "heat in the motor", "into the trough")],
    "rod_force": [("theory, machine's spring", "machine's spring")],
    "induction_motor": [("first-order theory", "linear motor")],
}  # fmt: skip


@pytest.mark.parametrize("name", EXPLAINED)
def test_theory_is_drawn_as_a_line_through_the_points_that_it_explains(name: str) -> None:
    """Within a twentieth of its range: another sign, factor or machine is further off."""
    _, show = answered(name)
    panels = [
        {curve.name: curve for curve in panel.curves}
        for chart in show.charts if isinstance(chart, Chart)
        for panel in chart.panels if isinstance(panel, Panel)
    ]  # fmt: skip
    for line, points in EXPLAINED[name]:
        pairs = [(p[line], p[points]) for p in panels if {line, points} <= p.keys()]
        assert pairs, line
        for theory, orbits in pairs:
            assert theory.look == "theory" and len(theory.x) > 50
            y = np.interp(orbits.positions, theory.positions, np.asarray(theory.y))
            off = np.abs(y - np.asarray(orbits.y))
            assert off.max() < 0.05 * np.ptp(theory.y), (line, off.max(), np.ptp(theory.y))


def arm(frames: int) -> Motion:
    """An arm of a metre that turns once around an end, in a tenth of its angle in seconds."""
    turn = np.linspace(0.0, 2 * np.pi, frames)
    ends = np.stack([np.cos(turn), np.sin(turn)], 1)
    shape = Shape("<arm>", np.stack([0 * ends, ends], 1), "red", label=1)
    return Motion("Arm", turn / 10, 2.0, [f"at {k}" for k in range(frames)], [shape])


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of an answer made up here, with all that a page may show."""
    folder = tmp_path_factory.mktemp("sample")
    x = np.linspace(0.0, 10.0, 5001)
    y = np.sin(x)
    y[1234] = 7.5
    panels = [
        Panel("force", "N", [Curve("theory", x[::500], np.sin(x[::500]), "black", "theory"),
                             Curve("seen", x, y, "red")]),
        Panel("way", "m", [Curve("way", x, x**2, "blue")], [Mark(50.0, "half")]),
    ]  # fmt: skip
    middle = [Mark(5.0, "middle")]
    chart = Chart("Force & way", "time [s]", panels, middle, second=SecondUnit("ms", 1e3))
    figures: dict[str, Any] = {
        "told": Figure(2.0, "N", 0.01, "a force"),
        "formula": Figure(1.25, "1", 0.0),
        "lost": Figure.undetermined("m", "the runs contradict each other"),
    }
    force, lost = figures["told"], figures["lost"]
    judgements = [
        Judgement("force below its limit", force, most=3.0),
        Judgement("force below its limit", force, most=1.0),
        Judgement("way below its limit", lost, most=1.0),
        Judgement("force", force),
    ]
    invented = Answer(
        scenario="sample",
        question="Is <this> & that told?",
        verdict="\n".join(x.text() for x in judgements),
        judgements=judgements,
        figures=figures,
        parameters={},
        tables={"sample.csv": Table.of_frame(pd.DataFrame({"x": x, "y": y}), {"x": "s", "y": "N"})},
        provenance={
            "algorithm": "strang", "communication": "steps of 0.1 s", "wires": ["a.y -> b.u"],
            "parts": {"a": {"fmu": "A.fmu", "guid": "{12-34}"}, "b": {"fmu": "B.fmu", "guid": "{5}"}},
            "versions": {"python": "3"}, "flavour": "native",
        },
        warnings=["a: the chain is <slack>"],
        show=lambda: Show([chart], [arm(61)]),
    )  # fmt: skip
    assert write(invented, folder) == ["sample.csv", "sample.json", "sample.png", "report.html"]
    assert (folder / "sample.png").read_bytes().startswith(b"\x89PNG")
    return folder


def parsed(file: Path) -> Any:
    """The page as a tree."""
    return lxml_html.fromstring(file.read_text(encoding="utf-8"))


def lines(tree: Any, path: str) -> list[list[str]]:
    """The text of a table, row by row."""
    return [[cell.text_content() for cell in row] for row in tree.xpath(path)]


@pytest.mark.parametrize("name", SAMPLED)
def test_the_page_of_every_question_holds_the_full_answer(name: str, tmp_path: Path) -> None:
    answer, show = answered(name)
    html.report(answer, tmp_path / "report.html")
    tree = parsed(tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 8e6
    assert tree.xpath("string(//h1)") == answer.question
    answered_lines = [
        lines.text_content() for lines in tree.xpath("//section[@class='verdict']//li/span[2]")
    ]
    assert answered_lines == answer.verdict.splitlines()
    rows = lines(tree, FIGURES)
    assert [(row[0], row[3]) for row in rows] == [
        (n, "" if f.unit == "1" else f.unit) for n, f in answer.figures.items()
    ]
    for (_, value, error, *_), figure in zip(rows, answer.figures.values()):
        if figure.error is None:
            assert (value, error) == ("not determined", figure.reason)
        elif not figure.has_digit:
            assert float(value.split()[1]) >= abs(figure.value) + figure.error
        else:
            assert float(value) == pytest.approx(figure.value, rel=1e-5, abs=figure.error)
    text = tree.text_content()
    assert all(parameter in text for parameter in answer.parameters)
    assert all(part["guid"] in text for part in answer.provenance["parts"].values())
    anchors = [link.get("href")[1:] for link in tree.xpath("//nav//a")]
    assert len(anchors) > 4
    assert all(tree.xpath(f"//*[@id='{anchor}']") for anchor in anchors)
    titles = [h.text_content() for h in tree.xpath("//figure/h3")]
    assert titles == [x.title for x in (*show.charts, *show.more, *show.motions)]
    assert all(cell.get("scope") for cell in tree.xpath("//th"))
    assert all(element.get("aria-label") for element in tree.xpath("//*[@class='chart']"))


def test_an_answer_is_written_over_the_rows_that_it_reads(tmp_path: Path) -> None:
    """Its charts read columns of the file of rows, which the answer replaces by its table."""
    answer = workbench_ask(PROJECT, "run_up", {"stop": 0.05}, out=tmp_path)
    assert {"run_up.png", "report.html"} <= {*write(answer, tmp_path)}


def test_the_page_reports_errors_warnings_and_what_is_dangerous_as_text(sample: Path) -> None:
    tree = parsed(sample / "report.html")
    assert lines(tree, FIGURES) == [
        ["told", "2.000", "±\N{NO-BREAK SPACE}0.010", "N", "a force"],
        ["formula", "1.25", "", "", ""],
        ["lost", "not determined", "the runs contradict each other", "m", ""],
    ]
    assert tree.xpath("string(//h1)") == "Is <this> & that told?"
    (box,) = tree.xpath("//main/section[contains(@class, 'warnings')]")
    assert box.text_content().strip() == "a: the chain is <slack>"
    assert box.getprevious().get("class") == "verdict"
    assert lines(tree, "//section[@class='verdict']/ul/li") == [
        [sign, text] for sign, text in zip(
            "\N{CHECK MARK}\N{BALLOT X}?\N{BULLET}",
            ["Force below its limit: yes, 2.000 ± 0.010 of 3 N (67 %)",
             "Force below its limit: no, 2.000 ± 0.010 N, limit 1 N (200 %)",
             "Way below its limit: not determined, because the runs contradict each other",
             "Force: 2.000 ± 0.010 N"],
        )
    ]  # fmt: skip
    (label,) = tree.xpath("//*[@class='chart']/@aria-label")
    assert "seen from -1 to 7.5 (force [N])" in label


COVERED = """[...document.querySelectorAll('.chart')].flatMap(chart => {
    const plots = [...chart.querySelectorAll('.nsewdrag')].map(x => x.getBoundingClientRect());
    const rows = Object.keys(chart._fullLayout).filter(key => /^yaxis/.test(key)).length;
    if (plots.length !== rows) return ['no plots'];
    const isPlane = chart.querySelector('.hm');
    const names = [...chart.querySelectorAll('.annotation')].flatMap(note => {
        const { name, text } = chart.layout.annotations[note.dataset.index];
        return name ? [{ text, box: note.querySelector('.annotation-text').getBoundingClientRect() }] : [];
    });
    const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 2 && b.top < a.bottom - 2;
    return names.filter(({ box }, k) => names.some((other, n) => n !== k && meet(box, other.box)) ||
        box.right > innerWidth + 1 || !isPlane && plots.some(plot => meet(box, plot))).map(({ text }) => text);
})"""
PLOTTED = (
    "[...document.querySelectorAll('.chart')].map(c => c.querySelectorAll('.trace, .hm').length)"
)
FITS = """[...document.querySelectorAll('.chart')].every(
    chart => Math.abs(chart.querySelector('svg').clientWidth - 928) < 2 &&
             Math.abs(chart.querySelector('svg').clientHeight - chart.clientHeight) < 2)"""
TIMES = "[...document.querySelectorAll('.motion svg')].map(s => s.getCurrentTime())"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK_QUESTIONS else [pytest.mark.slow])
        for name in QUESTIONS
    ],
)
def test_the_page_of_every_question_shows_without_network_or_error(
    name: str, page_browser: Browser, tmp_path: Path
) -> None:
    file = tmp_path / "report.html"
    answer, show = answered(name)
    html.report(answer, file)
    page_browser.open(file, 390)
    assert page_browser.value("document.documentElement.scrollWidth") == 390
    assert (
        page_browser.reported("Runtime.exceptionThrown")
        == page_browser.reported("Log.entryAdded")
        == []
    )
    requests = [
        event["request"]["url"] for event in page_browser.reported("Network.requestWillBeSent")
    ]
    assert [x for x in requests if not x.startswith(("data:", "blob:"))] == [
        file.resolve().as_uri()
    ]
    if answer.live is not None:
        page_browser.until(f"{first_element('#live-part')}.dataset.answered === '1'")
    page_browser.value(
        "document.querySelectorAll('details.original').forEach(x => { x.open = true; })"
    )
    plotted, times = page_browser.value(PLOTTED), page_browser.value(TIMES)
    assert len(plotted) == len(show.charts) + len(show.more) and all(plotted)
    assert len(times) == len(show.motions)
    assert bool(times) == (name != "orbit")  # whose motions are curves over a turn
    page_browser.until(f"{TIMES}.every((now, k) => now > {times}[k])")
    assert page_browser.value(COVERED) == []
    page_browser.resize(1000)
    page_browser.until(FITS)
    assert page_browser.value(COVERED) == []


@pytest.fixture
def opened(page_browser: Browser, sample: Path) -> Browser:
    """A browser with the page of the sample."""
    page_browser.open(sample / "report.html", 1000)
    return page_browser


def first_element(selector: str) -> str:
    """An element of the page in its own words."""
    return f"document.querySelector('{selector}')"


HOLES = """<base href="https://elsewhere.example/">
<script>document.title = "owned";</script>
<script type="module">document.title = "owned";</script>
<script src="data:text/javascript,document.title='owned'"></script>
<img src="data:," onerror="document.title = 'owned'">
<a id="leap" href="javascript:document.title = 'owned'">x</a>
<form id="sent" action="sent.html"><button>x</button></form>
"""


def test_a_page_runs_its_scripts_and_no_other(
    page_browser: Browser, sample: Path, tmp_path: Path
) -> None:
    """Even if a text of an answer were written into it unchanged."""
    page, file = (sample / "report.html").read_text(encoding="utf-8"), tmp_path / "report.html"
    file.write_text(page.replace("<main>", f"<main>{HOLES}", 1), encoding="utf-8")
    page_browser.open(file, 1000)
    assert page_browser.value("document.querySelectorAll('.chart .trace').length") > 0
    page_browser.value(f"{first_element('#leap')}.click()")
    page_browser.value(f"{first_element('#sent')}.requestSubmit()")
    page_browser.value("new Promise(resolve => setTimeout(resolve, 300))")
    assert page_browser.value("document.title") == "Is <this> & that told?"
    assert (
        page_browser.value("document.baseURI")
        == page_browser.value("location.href")
        == file.resolve().as_uri()
    )
    refused = [event["entry"]["text"] for event in page_browser.reported("Log.entryAdded")]
    for kind, times in (("base-uri", 1), ("script-src", 5)):
        assert (
            sum(f'directive: "{kind}' in text or f"directive '{kind}" in text for text in refused)
            == times
        )


def test_the_download_is_the_csv_to_the_byte(opened: Browser, sample: Path, tmp_path: Path) -> None:
    opened.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    opened.until(f"{first_element('a[download]')}.href.startsWith('blob:')")
    opened.value(f"{first_element('a[download]')}.click()")
    opened.until((tmp_path / "sample.csv").exists)
    assert (tmp_path / "sample.csv").read_bytes() == (sample / "sample.csv").read_bytes()


def test_motion_follows_slider_and_button(opened: Browser) -> None:
    """A quarter of a turn after a quarter of the time; the picture is 1000 wide for two arms."""
    tip = f"(p => [p.x, p.y])({first_element('.motion polyline')}.animatedPoints.getItem(1))"
    button, slider = first_element(".motion button"), first_element(".motion input")
    assert opened.value(f"{button}.textContent") == "Pause"
    opened.value(f"{button}.click()")
    assert opened.value(f"{button}.textContent") == "Play"
    still = opened.value(tip)
    opened.value("new Promise(resolve => setTimeout(resolve, 100))")
    assert opened.value(tip) == still
    opened.value(f"{slider}.value = {2 * np.pi / 10 / 4}")
    opened.value(f"{slider}.dispatchEvent(new Event('input'))")
    assert opened.value(tip) == pytest.approx([528.0, 28.0], abs=0.2)
    assert opened.value(f"{first_element('.motion .caption')}.textContent") == "at 15"
    assert opened.value(f"{first_element('.motion text')}.textContent") == "<arm>"
    opened.value(f"{button}.click()")
    opened.until(f"{tip}[0] < 500")


def test_thinning_keeps_peaks_beside_gaps_and_the_gaps() -> None:
    y = np.zeros(20_000)
    y[[5000, 5007]] = np.nan, 5.0
    y[[9000, 9001]] = np.inf, -4.0
    y[12_000:13_000] = np.nan
    indices = plotly.rows_to_draw(y)
    assert len(indices) <= STYLE.max_points
    assert {5000, 5007, 9000, 9001} <= set(indices)
    assert np.isnan(y[[k for k in indices if 12_010 <= k < 12_990]]).all()


def test_a_gif_has_the_frames_of_its_motion(tmp_path: Path) -> None:
    gif(tmp_path / "arm.gif", arm(7))
    with Image.open(tmp_path / "arm.gif") as image:
        assert image.n_frames == 7  # type: ignore[attr-defined]
        frames = [np.array(image.convert("L")) for k in (0, 3) if image.seek(k) is None]
    assert (frames[0] != frames[1]).sum() > 50


def lengths(points: np.ndarray) -> np.ndarray:
    """Lengths of the pieces of a line at all times, shape (frames, n - 1)."""
    return np.linalg.norm(np.diff(points, axis=1), axis=-1)


@pytest.mark.parametrize("wrap", [0, 1])
def test_the_drawing_of_the_iron_drive_keeps_its_lengths_and_its_contact(wrap: int) -> None:
    answer = ask("iron_cycle", samples=180, start=[f"iron.wrap={wrap}"])
    (motion,) = answer.show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes}
    p = {name.removeprefix("iron."): x.value for name, x in answer.parameters.items()}
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
    assert lift.max() == pytest.approx(answer.figures["stroke"].value, rel=1e-3)


def test_the_crank_of_the_drawing_moves_the_trough_of_the_drawing() -> None:
    (motion,) = ask("run_up", stop=0.2, start=["conveyor.rod.finite=1"]).show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes[: len(motion.shapes) // 2]}
    crank = lengths(shapes["crank"])
    assert_allclose(crank, conveyor.ENLARGED * 0.01)
    assert_allclose(lengths(shapes["rod"]), 0.4, rtol=0.01)
    assert_allclose(shapes["crank"][:, 1], shapes["rod"][:, 0])
    assert_allclose(shapes["rod"][:, 1], shapes["trough"][:, 0])
    assert_allclose(shapes["spring"][:, 0, 0], shapes["trough"][:, 2, 0])


def test_the_cup_of_the_drawing_is_rigid_and_turns_over_in_front_of_the_wall() -> None:
    (motion,) = ask("orientator_cycle").show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes}
    assert_allclose(np.ptp(lengths(shapes["cup"]), axis=0), 0.0, atol=1e-12)
    assert_allclose(lengths(shapes["catcher"]), [[0.18, 0.01]] * len(motion.times))
    wall = shapes["wall"][..., 0].min()
    assert shapes["cup"][..., 0].max() < wall + 1e-3
    upright = shapes["cup"][:, 13, 1] - shapes["cup"][:, 0, 1]
    assert upright[0] > 0.06 > -0.06 > upright[-1]
