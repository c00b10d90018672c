"""Reports as files: by its suffix a text, JSON, JUnit's XML, a picture, or a page that needs nothing else."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar
from xml.etree import ElementTree

from .errors import SetupError
from .files import replacement
from .json_values import json_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.4 sans-serif; max-width: 80em; margin: 2em auto; padding: 0 1em; color: #1f2328 }}
table {{ border-collapse: collapse; margin: 1em 0 }}
td, th {{ text-align: left; vertical-align: top; padding: .35em .8em .35em 0; border-bottom: 1px solid #d0d7de }}
img {{ max-width: 100% }}
</style></head><body><h1>{title}</h1>
{body}
</body></html>
"""
#: Colors of verdicts on a white page, dark enough to be read (WCAG 2, contrast above 4.5).
GREEN, RED, AMBER, GREY = "#1a7f37", "#cf222e", "#9a6700", "#6e7781"


class ReportFile:
    """A report that writes itself; by suffix, FORMATS names the method that gives the content of a file."""

    FORMATS: ClassVar[Mapping[str, str]]

    @classmethod
    def format_of(cls, path: Path | str) -> str:
        """The method that makes this file; raises SetupError for a suffix that is not known."""
        suffix = Path(path).suffix
        if suffix not in cls.FORMATS:
            raise SetupError(f"{path} must end in one of {', '.join(cls.FORMATS)}")
        return cls.FORMATS[suffix]

    def write(self, path: Path | str) -> None:
        """Write a file whose suffix decides what is in it; raises SetupError for one that is not known.

        Parameters
        ----------
        path : path
            The file.
        """
        name = self.format_of(path)
        if name == "plot":
            getattr(self, name)(path)
            return
        content = getattr(self, name)()
        if not isinstance(content, str):
            content = json_text(content)
        with replacement(Path(path)) as fresh:
            fresh.write_text(content.rstrip("\n") + "\n", encoding="utf-8")


def page(title: str, *body: str) -> str:
    """A page of some HTML."""
    return PAGE.format(title=html.escape(title), body="\n".join(body))


def paragraphs(lines: Iterable[str], color: str = "") -> str:
    """Lines as paragraphs; those in a color are bold."""
    style = f' style="color:{color};font-weight:bold"' if color else ""
    return "\n".join(f"<p{style}>{html.escape(line)}</p>" for line in lines)


def html_table(rows: Sequence[Sequence[str]], colors: Mapping[str, str] = {}) -> str:
    """A table whose first row is its heading; cells that say one of some words have its color."""

    def cell(tag: str, text: str) -> str:
        style = f' style="color:{colors[text]};font-weight:bold"' if text in colors else ""
        return f"<{tag}{style}>{html.escape(text)}</{tag}>"

    lines = (
        f"<tr>{''.join(cell('td' if k else 'th', text) for text in row)}</tr>"
        for k, row in enumerate(rows)
    )
    return f"<table>{''.join(lines)}</table>"


def picture(figure: Figure, meaning: str, resolution: int) -> str:
    """A picture in a page, with what it shows in words."""
    image = BytesIO()
    figure.savefig(image, dpi=resolution)
    data = base64.b64encode(image.getvalue()).decode()
    return f'<img alt="{html.escape(meaning)}" src="data:image/png;base64,{data}">'


def junit(name: str, of: str, cases: Sequence[tuple[str, str, str, str]]) -> str:
    """JUnit's XML of tests, each with its name, what became of it, a message and a text.

    What becomes of a test is the name of an element: failure, skipped, system-out, or none.
    """
    outcomes = [outcome for _, outcome, _, _ in cases]
    suite = ElementTree.Element(
        "testsuite", name=name, tests=str(len(cases)), failures=str(outcomes.count("failure")),
        errors="0", skipped=str(outcomes.count("skipped")),
    )  # fmt: skip
    for test, outcome, message, text in cases:
        case = ElementTree.SubElement(suite, "testcase", classname=of, name=test)
        if outcome:
            attributes = {"message": message} if message else {}
            ElementTree.SubElement(case, outcome, attributes).text = text or None
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
