"""The site: it builds without a warning, every link leads somewhere, and everybody can use it, from a
file and offline.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from lxml import html

from gallery.__main__ import build_site
from gallery.answers import Answered
from scenarios.project import PROJECT
from tests.conftest import QUICK, ROOT, ask
from tests.pictures import differ
from tests.test_docs import SITE_COMMAND
from tests.workbench.browser import Browser
from tests.workbench.test_report import page_browser
from workbench.export import PAGE, write

__all__ = ["page_browser"]
LARGEST = 3_000_000
LOOKED_AT = ("machines.html", "docs/machines/shaft_link.html", "search.html")
AXE = """axe.run(document, {iframes: false, resultTypes: ["violations"]}).then(found =>
    found.violations.map(({id, nodes}) => `${id}: ${nodes[0].target}`))"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site with one answer, to a question with short options."""
    folder = tmp_path_factory.mktemp("gallery")
    answers = folder / "answers"
    write(ask("resonance", answers, **QUICK["resonance"]), answers)
    question = PROJECT.load("resonance")
    return build_site([Answered("resonance", question, "scenarios run resonance", answers)], folder)


@pytest.fixture(scope="module")
def full_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command of the README makes when nothing is there yet."""
    folder = tmp_path_factory.mktemp("gallery")
    _, _, arguments = SITE_COMMAND.partition(" python ")
    command = [sys.executable, *arguments.split(), "--out", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True)
    return folder


@cache
def parse_page(page: Path) -> Any:
    return html.parse(str(page)).getroot()


@cache
def names(page: Path) -> frozenset[str]:
    """What a link may lead to within a page."""
    return frozenset(parse_page(page).xpath("//@id"))


def pages(site: Path) -> list[Path]:
    return sorted(site.rglob("*.html"))


def wrong(page: Path, site: Path) -> Iterator[str]:
    """What is missing in a page, and the links that lead nowhere or fetch something."""
    tree = parse_page(page)
    for what in ("/html[@lang]", "//title[string-length() > 3]", "//meta[@name='viewport']"):
        if not tree.xpath(what):
            yield f"no {what}"
    headings = [(int(x.tag[1]), x.text_content()) for x in tree.iter("h1", "h2", "h3", "h4", "h5")]
    if [level for level, _ in headings].count(1) != 1:
        yield f"not one h1: {headings}"
    for (upper, _), (lower, heading) in pairwise(headings):
        if lower > upper + 1:
            yield f"{heading!r} skips a level"
    for image in tree.iter("img"):
        caption = "".join(image.xpath("ancestor::a//text()")).strip()
        if not (image.get("alt") or (image.get("alt") == "" and caption)):
            yield f"no alternative text: {image.get('src')}"
    yield from (f"no title: {frame.get('src')}" for frame in tree.xpath("//iframe[not(@title)]"))
    for element, _, link, _ in tree.iterlinks():
        to = urlsplit(link)
        if to.scheme in ("http", "https"):
            if element.tag != "a" and element.get("rel") != "license":
                yield f"fetches {link}"
        elif to.scheme not in ("data", "blob", "mailto"):
            target = (page.parent / unquote(to.path)).resolve() if to.path else page
            if not target.is_file() or site.resolve() not in target.parents:
                yield f"leads nowhere: {link}"
            elif to.fragment and unquote(to.fragment) not in names(target):
                yield f"leads to no place of {target.name}: {link}"


def weight(page: Path) -> int:
    """How many bytes a page loads, with what stands in its frames."""
    loaded = parse_page(page).xpath(
        "//script/@src | //link[@rel='stylesheet']/@href | //iframe/@src"
    )
    return sum((page.parent / urlsplit(link).path).stat().st_size for link in {*loaded, page.name})


def problems(site: Path) -> dict[str, list[str]]:
    faults_by_page = {page: list(wrong(page, site)) for page in pages(site) if page.name != PAGE}
    for page, faults in faults_by_page.items():
        if (heavy := weight(page)) > LARGEST:
            faults.append(f"loads {heavy} bytes")
    return {
        str(page.relative_to(site)): faults for page, faults in faults_by_page.items() if faults
    }


def looked_at(browser: Browser, pages: Sequence[Path]) -> dict[str, list[str]]:
    """What a browser and axe, on light and dark screens and on a phone, find wrong with pages."""
    axe, messages_by_page = (
        (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8"),
        {},
    )
    for page in pages:
        messages = messages_by_page[str(page)] = []
        for scheme in ("dark", "light"):
            browser.open(page, 390 if scheme == "dark" else 1280)
            media = [{"name": "prefers-color-scheme", "value": scheme}]
            browser.call("Emulation.setEmulatedMedia", features=media)
            browser.value(f"{axe}; 0")
            messages += browser.value(AXE)
            wide = browser.value("document.documentElement.scrollWidth - innerWidth")
            if wide > 0:
                messages.append(f"{wide} pixels too wide")
            messages += map(str, browser.reported("Runtime.exceptionThrown"))
            messages += map(str, browser.reported("Log.entryAdded"))
            requests = [x["request"]["url"] for x in browser.reported("Network.requestWillBeSent")]
            messages += [url for url in requests if not url.startswith(("file:", "data:", "blob:"))]
    return {page: messages for page, messages in messages_by_page.items() if messages}


def test_pages_are_complete_every_link_leads_somewhere_and_the_search_finds_a_page_from_a_file(
    site: Path, request: pytest.FixtureRequest
) -> None:
    assert not problems(site)
    written = {str(page.relative_to(site)) for page in pages(site)}
    expected = (
        "index",
        "questions",
        "questions/resonance",
        "questions/resonance/report",
        "commands",
    )
    assert {*LOOKED_AT, *(f"{name}.html" for name in expected)} <= written
    guides = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    assert {str(guide.relative_to(ROOT).with_suffix(".html")) for guide in guides} <= written
    text = (site / "reference" / "cosim.html").read_text(encoding="utf-8")
    assert 'id="cosim.run"' in text
    assert "Alias for field" not in text
    browser = request.getfixturevalue("page_browser")
    browser.open(site / "search.html", 1280)
    browser.call("Page.navigate", url=f"{(site / 'search.html').as_uri()}?q=backlash")
    links = "[...document.querySelectorAll('#search-results li a')]"
    browser.until(f"{links}.some(link => link.href.includes('shaft_link'))")


@pytest.mark.slow
def test_pages_are_for_everybody_and_need_no_network(site: Path, page_browser: Browser) -> None:
    assert not looked_at(page_browser, [site / name for name in LOOKED_AT])


@pytest.mark.slow
def test_so_is_the_site_that_the_command_makes(full_site: Path, page_browser: Browser) -> None:
    site = full_site / "site"
    assert not problems(site)
    assert not looked_at(page_browser, [page for page in pages(site) if page.name != PAGE])


@pytest.mark.slow
def test_pictures_of_the_guides_are_those_of_the_answers(full_site: Path) -> None:
    for picture in (ROOT / "docs").glob("*.png"):
        assert not differ(picture, full_site / "answers" / picture.stem / picture.name)
