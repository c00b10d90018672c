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

import numpy as np

from ..figure import Figure, rounded
from .chart import COLORS, MOST, Picture, words
from .motion import Motion
from .plot import figure

if TYPE_CHECKING:
    from ..answer import Answer, Table

LARGEST = 3_000_000
OPEN = 12
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
    pictures, tables = [*show.charts, *show.more], {
        name: limited(table) for name, table in answer.tables.items()
    }  # fmt: skip
    content = {
        "charts": [figure(picture) for picture in pictures],
        "motions": [_motion(motion) for motion in show.motions],
    }
    sections = [
        Section("figures", "Figures", _figures(answer.figures)),
        _drawn("chart", "Curves", pictures, [_chart(x) for x in pictures], CURVES),
        _drawn("motion", "Motion", show.motions, ["" for _ in show.motions], ""),
        Section("data", "Data", _downloads(tables)),
        Section("parameters", "Parameters", _parameters(answer)),
        Section("provenance", "How it was made", _provenance(answer.provenance)),
    ]
    sections = [section for section in sections if section.body]
    path.write_text(
        Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
            title=escape(answer.question),
            scenario=escape(answer.scenario),
            warnings=_warnings(answer.warnings),
            verdict=_verdict(answer.verdict.splitlines()),
            contents="".join(_entry(section) for section in sections),
            sections="\n".join(_section(section) for section in sections),
            plotly=_plotly(),
            packed=_packed(json.dumps(content, separators=(",", ":")).encode()),
        ),
        encoding="utf-8",
    )


def _packed(content: bytes) -> str:
    """Compressed, in letters."""
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


@cache
def _plotly() -> str:
    return _packed((files("plotly") / "package_data" / "plotly.min.js").read_bytes())


def _warnings(warnings: Sequence[str]) -> str:
    if not warnings:
        return ""
    lines = "".join(f"<li>{escape(text)}</li>" for text in warnings)
    return f'<section class="alarm warnings" aria-label="Warnings"><ul>{lines}</ul></section>'


def _verdict(lines: Sequence[str]) -> str:
    """The answer, if the page gives one."""
    if not lines:
        return ""
    paragraphs = "".join(f"<p>{escape(line)}</p>" for line in lines if line)
    return f'<section class="verdict" aria-label="Verdict">{paragraphs}</section>'


def _entry(section: Section) -> str:
    parts = "".join(
        f'<li><a href="#{x}">{escape(text)}</a></li>' for x, text in section.parts.items()
    )
    below = f"<ul>{parts}</ul>" if len(section.parts) > 1 else ""
    return f'<li><a href="#{section.name}">{section.title}</a>{below}</li>'


def _section(section: Section) -> str:
    return (
        f'<section aria-labelledby="{section.name}"><h2 id="{section.name}">{section.title}</h2>'
        f"{section.body}</section>"
    )


def _drawn(
    kind: str, title: str, drawn: Sequence[Picture | Motion], bodies: Sequence[str], note: str
) -> Section:
    """Places that the page's script fills."""
    names = [f"{kind}{k}" for k in range(len(drawn))]
    places = [
        f'<figure id="{name}"><h3>{escape(x.title)}</h3><div class="{kind}"{body}></div></figure>'
        for name, x, body in zip(names, drawn, bodies)
    ]
    parts = dict(zip(names, (x.title for x in drawn)))
    return Section(f"{kind}s", title, "".join([*places, note]) if places else "", parts)


def _chart(picture: Picture) -> str:
    return f' role="img" aria-label="{escape(words(picture))}"'


def _table(kind: str, head: Sequence[str], rows: Iterable[Sequence[str]], fold: str = "") -> str:
    """A table, folded if it is long; its roles stay where a small screen stacks its cells."""
    heads = "".join(f'<th scope="col" role="columnheader">{name}</th>' for name in head)
    lines = []
    for first, *cells in rows:
        told = "".join(f'<td role="cell">{escape(cell)}</td>' for cell in cells)
        name = f'<th scope="row" role="rowheader">{escape(first)}</th>'
        lines.append(f'<tr role="row">{name}{told}</tr>')
    if not lines:
        return ""
    table = (
        f'<table class="{kind}" role="table">'
        f'<thead role="rowgroup"><tr role="row">{heads}</tr></thead>'
        f'<tbody role="rowgroup">{"".join(lines)}</tbody></table>'
    )
    if not fold:
        return table
    opened = "" if len(lines) > OPEN else " open"
    return f"<details{opened}><summary>{len(lines)} {fold}</summary>{table}</details>"


def _figures(figures: Mapping[str, Figure]) -> str:
    rows = [(name, *_told(x), x.unit, x.meaning) for name, x in figures.items()]
    head = ("figure", "value", "error", "unit", "meaning")
    table = _table("numbers figures", head, rows)
    return table + ERRORS if table else ""


def _told(figure: Figure) -> tuple[str, str]:
    """Value and error as text; why there is none where it is refused."""
    if figure.error == 0.0:
        return f"{figure.value:.6g}", "none"
    if figure.error is None:
        return "not told", figure.reason
    value, error = rounded(figure.value, figure.error)
    return value, f"± {error}"


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


def _provenance(told: Mapping[str, Any]) -> str:
    rows = []
    if told.get("algorithm") and len(told["parts"]) > 1:
        rows.append(("coupling algorithm", told["algorithm"]))
    if "communication" in told:
        rows.append(("communication", told["communication"]))
    rows += [("wire", wire) for wire in told.get("wires", ())]
    for part, identity in told.get("parts", {}).items():
        rows.append((part, f"{identity['fmu']} ({told['flavour']}), {identity['guid']}"))
    rows += list(told["versions"].items())
    rows.append(("curves", f"plotly.js of plotly {version('plotly')}, © Plotly, Inc., MIT licence"))
    return _table("", ("what", "which"), rows, "entries")


def _motion(motion: Motion) -> dict[str, Any]:
    """A motion in the units of its picture, which is 1000 wide and counts y downwards."""
    low, high = motion.bounds
    scale = 1000.0 / (high[0] - low[0])
    height = float(high[1] - low[1]) * scale

    def frames(points: Any) -> list[list[float]]:
        placed = np.stack(
            [(points[..., 0] - low[0]) * scale, height - (points[..., 1] - low[1]) * scale], -1
        )
        return [row.ravel().tolist() for row in np.round(placed, 1)]

    return {
        "title": motion.title,
        "note": motion.note,
        "height": round(height, 1),
        "times": np.round(motion.times - motion.times[0], 6).tolist(),
        "slow": motion.slow,
        "captions": list(motion.captions),
        "ghosts": list(motion.ghosts),
        "shapes": [
            {
                "name": shape.name,
                "color": COLORS[shape.color],
                "width": shape.width,
                "closed": shape.closed,
                "label": shape.label,
                "frames": frames(shape.points),
            }
            for shape in motion.shapes
        ],
    }
