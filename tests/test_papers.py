"""Every formula of the papers has a home and a test that holds it, and what the pages name exists."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from fmpy.model_description import read_model_description

from build_fmus import FORMULAS
from scenarios.project import PROJECT
from tests.conftest import ROOT
from workbench.catalog import names


def rows(page: str, heading: str) -> list[list[str]]:
    """The cells of the first table under a heading, its head among them."""
    section = page.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines if "---" not in line
    ]


@cache
def variables() -> set[str]:
    """All variables of the FMUs, "IronDrive.alpha"."""
    names = set()
    for fmu in (ROOT / "fmus").glob("*.fmu"):
        described = read_model_description(str(fmu), validate=False)
        names |= {f"{fmu.stem}.{v.name}" for v in described.modelVariables}
    return names


@cache
def defined_tests() -> set[str]:
    """The names of all tests."""
    text = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    return set(re.findall(r"^def (test_\w+)\(", text, re.MULTILINE))


def exists(home: str) -> bool:
    """Whether there is such a function in a file, such a file, variable of an FMU or question."""
    if "/" not in home:
        return home in variables() or home in names(PROJECT.home)
    path, _, name = home.partition(":")
    file = ROOT / path
    if not name or not file.is_file():
        return file.is_file() and not name
    return any(getattr(node, "name", "") == name for node in ast.walk(ast.parse(file.read_text())))


def faults(page: str) -> Iterator[str]:
    """What the table of formulas in the page of a machine names, and there is not."""
    for number, _, home, _, met in rows(page, FORMULAS)[1:]:
        homes, held = re.findall(r"`([^`]+)`", home), re.findall(r"`(test_\w+)`", met)
        if not homes or not (held or number.startswith("Fig.")):
            yield f"{number} has no home, or nothing that holds it"
        yield from (f"{number}: there is no {x}" for x in homes if not exists(x))


@pytest.mark.parametrize(
    "page", sorted(ROOT.glob("components/*/page.md")), ids=lambda p: p.parent.name
)
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text()
    assert list(faults(text)) == []
    assert {*re.findall(r"`(test_\w+)`", text)} <= defined_tests()
