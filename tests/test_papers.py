"""Every formula of the papers has a home, which exists, and says how well it is met."""

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

LETTERS = "abcdefghijklmno"
PRINTED = {
    # the numbers of a paper, and how many formulas without one follow which number
    "crank_conveyor": (26, {26: 1}, 1),
    "iron_drive": (48, {9: 2, 48: 4}, 3),
    "gravity_orientator": (10, {1: 2, 4: 1, 6: 3, 7: 4, 9: 2, 10: 15}, 4),
}
#: What a paper says in words, after its formulas and figures.
TEXTS = {
    "crank_conveyor": ["after (12)", "last sentence"],
    "iron_drive": ["assumptions"],
    "gravity_orientator": ["text on Fig. 4"],
}
DATA = {"iron_drive", "gravity_orientator"}
COLUMNS = ["no.", "what it says", "home", "erratum", "how well met"]


def printed(machine: str) -> list[str]:
    """All that a paper prints, by number and letter, its data, its figures."""
    last, unnumbered, figures = PRINTED[machine]
    formulas = [
        f"{number}{letter}"
        for number in range(1, last + 1)
        for letter in ("", *LETTERS[: unnumbered.get(number, 0)])
    ]
    pictures = [f"Fig. {k}" for k in range(1, figures + 1)]
    return formulas + ["data"] * (machine in DATA) + pictures + TEXTS[machine]


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


def faults(machine: str, page: str) -> Iterator[str]:
    """What is wrong with the table of formulas in the page of a machine."""
    head, *table = rows(page, FORMULAS) or [[]]
    if head != COLUMNS:
        yield f"the columns are {head}"
    numbers = [row[0] for row in table]
    if numbers != printed(machine):
        yield f"not in the table, or not in the paper, or out of order: {numbers}"
    errata = {row[0].rstrip(" †") for row in rows(page, "Errata of the paper")[1:]}
    for number, says, home, erratum, met in (row for row in table if len(row) == len(COLUMNS)):
        homes = re.findall(r"`([^`]+)`", home)
        if not says or not homes or re.sub(r"`[^`]+`|[, ]", "", home):
            yield f"{number} has no home: {home!r}"
        yield from (f"{number}: there is no {x}" for x in homes if not exists(x))
        named = re.split(r"; |, (?=\d)", erratum) if erratum else []
        yield from (f"{number}: there is no erratum {x}" for x in named if x not in errata)
        held = set(re.findall(r"`(test_\w+)`", met))
        if not met or not (held or number.startswith("Fig.")):
            yield f"{number} does not say how well it is met, and what holds that"
        yield from (f"{number}: there is no {x}" for x in held - defined_tests())
    yield from (f"{row[0]} has {len(row)} cells" for row in table if len(row) != len(COLUMNS))


def page_of(machine: str) -> str:
    return (ROOT / "components" / machine / "page.md").read_text()


@pytest.mark.parametrize("machine", PRINTED)
def test_every_formula_of_a_paper_has_a_home_that_exists(machine: str) -> None:
    assert list(faults(machine, page_of(machine))) == []


def test_no_machine_has_a_table_that_is_not_checked() -> None:
    pages = Path(ROOT / "components").glob("*/page.md")
    assert {p.parent.name for p in pages if f"## {FORMULAS}" in p.read_text()} == set(PRINTED)
