"""One page that shows what a question or a study found; it needs no network and no other file."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, NamedTuple

from ..figure import Figure, rounded
from .chart import Picture, words
from .layout import MOST
from .motion import Motion
from .plot import figure
from .svg import svg

if TYPE_CHECKING:
    from ..answer import Answer, Table

LARGEST, OPEN = 3_000_000, 12
TEMPLATE = Path(__file__).with_name("page.html")
ERRORS = """<p class="soft">The error covers every cause that is known. “None”: the value comes from a formula
or from one FMU alone.</p>"""
CURVES = f"""<p class="soft">A curve of more rows is drawn with at most {MOST} points; the smallest and largest
of every stretch are among them. <span class="hint">Drag to zoom, double-click to zoom back, click a name to hide
its curve.</span></p>"""


class Section(NamedTuple):
    """A part of the page, what the contents call it, and what they list below it by anchor."""

    name: str
    title: str
    body: str
    parts: Mapping[str, str] = {}


def report(answer: Answer, path: Path) -> None:
    """Write the page of an answer."""
    show = answer.show()
    charts = [*show.charts, *show.more]
    tables = {name: limited(table) for name, table in answer.tables.items()}
    content = {"charts": list(map(figure, charts)), "motions": list(map(_motion, show.motions))}
    sections = [
        Section("figures", "Figures", _figures(answer.figures)),
        _drawn("chart", "Curves", charts, CURVES),
        _drawn("motion", "Motion", show.motions, ""),
        Section("data", "Data", _downloads(tables)),
        Section("parameters", "Parameters", _parameters(answer)),
        Section("provenance", "How it was made", _provenance(answer.provenance)),
    ]
    sections = [section for section in sections if section.body]
    warnings = [f"<li>{escape(text)}</li>" for text in answer.warnings]
    verdict = [f"<p>{escape(line)}</p>" for line in answer.verdict.splitlines() if line]
    page = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(answer.question),
        scenario=escape(answer.scenario),
        warnings=_box("alarm warnings", "Warnings", "ul", warnings),
        verdict=_box("verdict", "Verdict", "div", verdict),
        contents="".join(map(_entry, sections)),
        sections="\n".join(map(_section, sections)),
        plotly=_plotly(),
        packed=_packed(json.dumps(content, separators=(",", ":")).encode()),
    )
    path.write_text(page, encoding="utf-8")


def _packed(content: bytes) -> str:
    """Compressed, in letters."""
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


@cache
def _plotly() -> str:
    return _packed((files("plotly") / "package_data" / "plotly.min.js").read_bytes())


def _box(kind: str, label: str, tag: str, lines: Sequence[str]) -> str:
    """Lines in a frame, if there are any."""
    inside = f"<{tag}>{''.join(lines)}</{tag}>"
    return f'<section class="{kind}" aria-label="{label}">{inside}</section>' if lines else ""


def _entry(section: Section) -> str:
    parts = [f'<li><a href="#{x}">{escape(text)}</a></li>' for x, text in section.parts.items()]
    below = f"<ul>{''.join(parts)}</ul>" if len(parts) > 1 else ""
    return f'<li><a href="#{section.name}">{section.title}</a>{below}</li>'


def _section(section: Section) -> str:
    head = f'<h2 id="{section.name}">{section.title}</h2>'
    return f'<section aria-labelledby="{section.name}">{head}{section.body}</section>'


def _drawn(kind: str, title: str, shown: Sequence[Picture | Motion], note: str) -> Section:
    """Places that the page's script fills."""
    parts, body = {}, ""
    for k, x in enumerate(shown):
        parts[f"{kind}{k}"] = x.title
        says = "" if isinstance(x, Motion) else f' role="img" aria-label="{escape(words(x))}"'
        body += f'<figure id="{kind}{k}"><h3>{escape(x.title)}</h3><div class="{kind}"{says}></div></figure>'
    return Section(f"{kind}s", title, body + note if body else "", parts)


def _table(kind: str, head: Sequence[str], rows: Iterable[Sequence[str]], fold: str = "") -> str:
    """A table, folded if it is long; its roles stay where a small screen stacks its cells."""
    heads = "".join(f'<th scope="col" role="columnheader">{name}</th>' for name in head)
    lines = []
    for first, *cells in rows:
        name = f'<th scope="row" role="rowheader">{escape(first)}</th>'
        rest = "".join(f'<td role="cell">{escape(cell)}</td>' for cell in cells)
        lines.append(f'<tr role="row">{name}{rest}</tr>')
    table = (
        f'<table class="{kind}" role="table"><thead role="rowgroup"><tr role="row">{heads}</tr></thead>'
        f'<tbody role="rowgroup">{"".join(lines)}</tbody></table>'
    )
    if not fold or not lines:
        return table if lines else ""
    opened = " open" if len(lines) <= OPEN else ""
    return f"<details{opened}><summary>{len(lines)} {fold}</summary>{table}</details>"


def _figures(figures: Mapping[str, Figure]) -> str:
    rows = [(name, *_value(x), x.unit, x.meaning) for name, x in figures.items()]
    table = _table("numbers figures", ("figure", "value", "error", "unit", "meaning"), rows)
    return table and table + ERRORS


def _value(figure: Figure) -> tuple[str, str]:
    """Value and error as text; why there is none where it is refused."""
    if figure.error is None:
        return "not told", figure.reason
    if figure.error == 0.0:
        return f"{figure.value:.6g}", "none"
    value, error = rounded(figure.value, figure.error)
    return value, f"±\N{NO-BREAK SPACE}{error}"


def _parameters(answer: Answer) -> str:
    rows = [
        (name, f"{x.value:.6g}" if isinstance(x.value, float) else str(x.value), x.unit, x.meaning)
        for name, x in {**answer.options, **answer.parameters}.items()
    ]
    return _table("numbers", ("name", "value", "unit", "meaning"), rows, "parameters")


def limited(table: Table) -> tuple[str, str]:
    """The CSV packed, of every k-th row if it is too large, and a note that says so."""
    rows, k = len(table.frame), 1
    while True:
        packed = _packed(table.frame.iloc[::k].to_csv(index=False).encode())
        if len(packed) <= LARGEST:
            part = f"one row in {k} of {rows}; the whole file lies beside this page"
            return packed, f"{rows} rows" if k == 1 else part
        k *= 2


def _downloads(tables: Mapping[str, tuple[str, str]]) -> str:
    return "".join(
        f'<p><a class="button" data-of="table{number}" download="{escape(name)}">'
        f"{escape(name)}</a> {note}</p>"
        f'<script type="application/gzip" id="table{number}">{packed}</script>'
        for number, (name, (packed, note)) in enumerate(tables.items())
    )


def _provenance(known: Mapping[str, Any]) -> str:
    parts = known.get("parts", {})
    once = {"coupling algorithm": known.get("algorithm") if len(parts) > 1 else None,
            "communication": known.get("communication")}  # fmt: skip
    rows = [(name, text) for name, text in once.items() if text]
    rows += [("wire", wire) for wire in known.get("wires", ())]
    rows += [(p, f"{x['fmu']} ({known['flavour']}), {x['guid']}") for p, x in parts.items()]
    rows += known["versions"].items()
    rows.append(("curves", f"plotly.js of plotly {version('plotly')}, © Plotly, Inc., MIT licence"))
    return _table("", ("what", "which"), rows, "entries")


def _motion(motion: Motion) -> dict[str, Any]:
    """A motion as the page's script gets it."""
    times = (motion.times - motion.times[0]).round(6).tolist()
    pace = "In real time." if motion.slow == 1 else f"{motion.slow:g} times slower than real."
    return {
        "svg": svg(motion), "slow": motion.slow, "times": times, "captions": list(motion.captions),
        "note": f"{pace} {motion.note}",
    }  # fmt: skip
