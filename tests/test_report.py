"""The page of a scenario in a real browser, and the mechanisms that it draws."""

from __future__ import annotations

import base64
import gzip
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import Browser, browser
from conftest import QUICK
from numpy.testing import assert_allclose

from scenarios import fmus, iron, iron_cycle
from scenarios.__main__ import SCENARIOS, load
from scenarios.answer import Answer, Figure, Show, Table, write
from scenarios.page import charts, fields, mechanisms
from scenarios.page import report as page
from scenarios.page.charts import Chart, Curve, Panel, thinned
from scenarios.page.fields import Direction, Field
from scenarios.page.motion import Motion, Shape
from scenarios.page.report import limited, report

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = QUICK | {
    "resonance": {"speeds": "36,38,40,42,44", "steps_per_rev": 66, "algorithm": "gauss-seidel"}
}


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all pages."""
    program = next((path for name in PROGRAMS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"none of {', '.join(PROGRAMS)} is installed: no page was looked at")
    with browser(program, tmp_path_factory.mktemp("browser")) as page:
        yield page


@pytest.fixture(autouse=True)
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled FMUs, which are built already."""
    monkeypatch.setenv(fmus.CHOICE, "native")
    monkeypatch.setattr(fmus, "build", lambda *_: None)


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
        Panel(
            "force",
            "N",
            [
                Curve("theory", x[::500], np.sin(x[::500]), "grey", "theory"),
                Curve("seen", x, y, "red"),
            ],
        ),
        Panel("way", "m", [Curve("way", x, x**2, "blue")], [charts.Mark(50.0, "half")]),
    ]
    answer = Answer(
        scenario="sample",
        question="Is <this> & that told?",
        verdict="Yes: 2.00 +- 0.01 N.\nNo.",
        figures={
            "told": Figure(2.0, "N", 0.01, 2.0, "a force"),
            "formula": Figure(1.25, "1", 0.0),
            "alone": Figure(3.0, "m"),
            "lost": Figure(4.0, "m", None, 0.7),
        },
        parameters={},
        tables={"sample.csv": Table(pd.DataFrame({"x": x, "y": y}), {"x": "s", "y": "N"})},
        provenance={
            "algorithm": "strang", "communication": "steps of 0.1 s", "wires": ["a.y -> b.u"],
            "parts": {"a": {"fmu": "A.fmu", "guid": "{12-34}"}, "b": {"fmu": "B.fmu", "guid": "{5}"}},
            "versions": {"python": "3"}, "flavour": "native",
        },
        stem="sample",
        show=lambda: Show(
            [Chart("Force and way", "time [s]", panels, [charts.Mark(5.0, "middle")])],
            [
                Motion(
                    "Arm", turn / 10, 2.0, [f"at {k}" for k in range(61)], [Shape("arm", arm, "red")]
                )
            ],
        ),
    )  # fmt: skip
    write(answer, folder)
    return folder


def curves(picture: Chart | Field) -> int:
    """Curves and points of a picture."""
    panels = [picture] if isinstance(picture, Field) else picture.panels
    return sum(len(panel.curves) for panel in panels)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_page_of_every_scenario_shows_without_network_or_error(
    name: str, shown: Browser, tmp_path: Path
) -> None:
    file = tmp_path / "report.html"
    answer = load(name).answer(**OPTIONS[name])
    report(answer, file)
    assert file.stat().st_size < 8e6
    show = answer.show()
    shown.open(file, 390, 800)
    assert shown.value("document.documentElement.scrollWidth") == 390
    assert shown.told("Runtime.exceptionThrown") == []
    assert shown.told("Log.entryAdded") == []
    asked = [told["request"]["url"] for told in shown.told("Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [
        file.resolve().as_uri()
    ]
    drawn = shown.value(
        "[...document.querySelectorAll('.chart')].map("
        "c => [c.querySelectorAll('.scatterlayer .trace').length, c.querySelectorAll('.hm').length])"
    )
    assert drawn == [[curves(chart), isinstance(chart, Field)] for chart in show.charts]
    assert all(any(pictures) for pictures in drawn)
    outlines = "[...document.querySelectorAll('.motion svg')].map(s => s.innerHTML)"
    before = shown.value(outlines)
    assert len(before) == len(show.motions) > 0
    shown.until(f"{outlines}.every((now, k) => now !== {json.dumps(before)}[k])")
    text = shown.value("document.querySelector('main').innerText")
    for words in (answer.question, *answer.figures, *answer.parameters):
        assert words in text
    for line in answer.verdict.replace("+-", "±").splitlines():
        assert " ".join(line.split()) in text
    for identity in answer.provenance["parts"].values():
        assert identity["guid"] in text
    shown.resize(1000, 800)
    shown.until("Math.abs(document.querySelector('.chart svg').clientWidth - 928) < 2")


def test_the_mouse_over_a_curve_shows_its_values(shown: Browser, sample: Path) -> None:
    shown.open(sample / "report.html", 1000, 800)
    place = shown.value(
        """(() => { const chart = document.querySelector('.chart'), full = chart._fullLayout;
        chart.scrollIntoView();
        const box = chart.getBoundingClientRect();
        return [box.left + full._size.l + full.xaxis.d2p(4), box.top + full._size.t + 60]; })()"""
    )
    for shift in (-3, 0):
        x, y = place[0] + shift, place[1]
        shown.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    shown.until("document.querySelectorAll('.hoverlayer text').length > 0")
    words = shown.value("document.querySelector('.hoverlayer').textContent")
    assert f"{np.sin(4.0):.4f}"[:5] in words.replace("−", "-")
    assert "way" in words
    assert words.rstrip().endswith(" m")


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


def test_what_is_known_of_errors_and_what_is_dangerous_is_text(
    shown: Browser, sample: Path
) -> None:
    shown.open(sample / "report.html", 1000, 800)
    rows = shown.value("[...document.querySelectorAll('.figures tbody tr')].map(r => r.innerText)")
    assert [row.split("\t") for row in rows] == [
        ["told", "2.000", "± 0.010", "N", "a force"],
        ["formula", "1.25", "none", "1", ""],
        ["alone", "3", "not known", "m", ""],
        ["lost", "4", "not converged", "m", ""],
    ]
    assert shown.value("document.querySelector('h1').innerText") == "Is <this> & that told?"
    label = shown.value("document.querySelector('.chart').getAttribute('aria-label')")
    assert "seen from -1 to 7.5 (force [N])" in label
    assert shown.value("Math.max(...document.querySelector('.chart').data[1].y)") == 7.5


def test_paper_gets_everything_but_the_controls(shown: Browser, sample: Path) -> None:
    shown.open(sample / "report.html", 1000, 800)
    assert shown.pdf().startswith(b"%PDF")
    shown.call("Emulation.setEmulatedMedia", media="print")
    shown.value("dispatchEvent(new Event('beforeprint'))")
    gone = "getComputedStyle(document.querySelector('{}')).display === 'none'"
    for control in (".controls", "a[download]", ".hint"):
        assert shown.value(gone.format(control))
    for content in (".chart", ".motion svg", ".figures", ".verdict"):
        assert not shown.value(gone.format(content))
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
    assert len(few_x) <= charts.MOST
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


def lengths(points: np.ndarray) -> np.ndarray:
    """Lengths of the pieces of a line at all times, shape (frames, n - 1)."""
    return np.linalg.norm(np.diff(points, axis=1), axis=-1)


@pytest.mark.parametrize("wrap", [0, 1])
def test_the_drawn_iron_drive_keeps_its_lengths_and_its_contact(wrap: int) -> None:
    answer = iron_cycle.answer(samples=180, start=[f"iron.wrap={wrap}"])
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
    assert gap.max() < 0.5 * lengths(shapes["cam"]).max() + 1e-6
    lift = shapes["iron"][:, 0, 1] - shapes["iron"][0, 0, 1]
    assert lift.max() == pytest.approx(answer.figures["stroke"].value, rel=1e-3)


def test_the_drawn_crank_moves_the_drawn_trough() -> None:
    answer = load("run_up").answer(stop=0.2, start=["conveyor.rod.finite=1"])
    (motion,) = answer.show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes[:6]}
    crank = lengths(shapes["crank"])
    assert_allclose(crank, mechanisms.ENLARGED * 0.01)
    assert_allclose(lengths(shapes["rod"]), 0.4, rtol=0.01)
    assert_allclose(shapes["crank"][:, 1], shapes["rod"][:, 0])
    assert_allclose(shapes["rod"][:, 1], shapes["trough"][:, 0])
    assert_allclose(shapes["spring"][:, 0, 0], shapes["trough"][:, 2, 0])


def test_the_drawn_cup_is_rigid_and_turns_over_in_front_of_the_wall() -> None:
    answer = load("orientator_cycle").answer()
    (motion,) = answer.show().motions
    shapes = {shape.name: shape.points for shape in motion.shapes}
    assert_allclose(np.ptp(lengths(shapes["cup"]), axis=0), 0.0, atol=1e-12)
    assert_allclose(lengths(shapes["catcher"]), [[0.18, 0.01]] * len(motion.times))
    wall = shapes["wall"][0, 0, 0]
    assert shapes["cup"][..., 0].max() < wall + 1e-3
    upright = shapes["cup"][:, 13, 1] - shapes["cup"][:, 0, 1]
    assert upright[0] > 0.06 > -0.06 > upright[-1]


def test_the_drawn_cam_is_that_of_the_same_drive() -> None:
    """A turn at any speed tells the same cam."""
    curves = []
    for speed in (1.0, 4.0):
        turn = iron.turn(speed, {}, 90, iron.names(("phi", "alpha")))
        p = turn.provenance["parts"]["iron"]["parameters"]
        curves.append(mechanisms.pitch_curve(p, turn["iron.phi"], turn["iron.alpha"]))
    assert_allclose(*curves, atol=1e-8)
    distance = np.hypot(*curves[0])
    assert_allclose([distance.min(), np.ptp(distance)], [0.1, 0.02], rtol=1e-6)


def test_a_field_is_coloured_by_its_logarithm_and_tells_its_values() -> None:
    values = np.array([[0.1, 1.0, np.nan], [10.0, 100.0, 0.01]])
    x, y = (
        Direction("speed", "rad/s", np.arange(3.0)),
        Direction("T", "s", np.arange(1.0, 3.0), True),
    )
    ridge = Curve("ridge", [0.5], [1.5], "grey", "theory")
    drawn = fields.figure(Field("Gain", x, y, "gain", values, [ridge], log=True))
    heat, line = drawn["data"]
    assert heat["z"] == [[-1.0, 0.0, None], [1.0, 2.0, -2.0]]
    assert heat["customdata"] == [[0.1, 1.0, None], [10.0, 100.0, 0.01]]
    assert (heat["x"], heat["y"]) == ([0.0, 1.0, 2.0], [1.0, 2.0])
    assert heat["colorbar"]["ticktext"][0] == "0.01"
    assert heat["colorbar"]["ticktext"][-1] == "1e+02"
    assert (drawn["layout"]["xaxis"]["type"], drawn["layout"]["yaxis"]["type"]) == ("linear", "log")
    assert line["name"] == "ridge"
    assert drawn["told"] == "Gain: gain from 0.01 to 100 over speed [rad/s] and T [s]."
