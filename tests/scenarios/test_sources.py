"""A question that names a paper's formula by its number says at the end of its page which paper that is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from scenarios.__main__ import PROJECT
from tests.conftest import QUICK, ask
from workbench.page.html import report


@pytest.mark.parametrize("name", QUICK)
def test_a_formula_number_has_its_source(name: str) -> None:
    question = PROJECT.load(name)
    named = set(re.findall(r"formula (\(\d+\))", question.path.read_text(encoding="utf-8")))
    cited = set(re.findall(r"formula (\(\d+\))", " ".join(text for text, _ in question.sources)))
    assert named <= cited
    root = Path(__file__).parents[2]
    assert all((root / link.partition("#")[0]).is_file() for _, link in question.sources)


def test_the_page_ends_with_the_sources(tmp_path: Path) -> None:
    answer = ask("run_up", out=tmp_path, **QUICK["run_up"])
    report(answer, tmp_path / "page.html")
    ((text, link),) = answer.sources
    _, heading, end = (
        (tmp_path / "page.html").read_text(encoding="utf-8").partition(">Sources</h2>")
    )
    assert heading and f"<li>{text} (<code>{link}</code>)</li>" in end
    assert "formula (22)" in text and link.startswith("docs/papers.md#")
