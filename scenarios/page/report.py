"""One page that shows what a scenario found; it needs no network and no other file."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from . import charts, fields
from .charts import MOST, Chart
from .fields import Field
from .motion import COLORS, Motion, bounds

if TYPE_CHECKING:
    from ..answer import Answer, Figure, Table

LARGEST = 3_000_000
TEMPLATE = Path(__file__).with_name("report.html")


def report(answer: Answer, path: Path) -> None:
    """Write the page of an answer."""
    show, said = answer.show(), answer.verdict.replace(" +- ", " ± ")
    content = {
        "charts": [_drawn(picture) for picture in show.charts],
        "motions": [_motion(motion) for motion in show.motions],
    }
    tables = {name: limited(table) for name, table in answer.tables.items()}
    path.write_text(
        Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
            title=html.escape(answer.question),
            scenario=html.escape(answer.scenario),
            verdict="\n".join(f"<p>{html.escape(x)}</p>" for x in said.splitlines()),
            figures="\n".join(_figures(answer)),
            parameters="\n".join(_parameters(answer)),
            downloads="\n".join(_downloads(tables)),
            provenance="\n".join(_provenance(answer)),
            most=MOST,
            plotly=_plotly(),
            packed=_packed(json.dumps(content, separators=(",", ":")).encode()),
        ),
        encoding="utf-8",
    )


def _drawn(picture: Chart | Field) -> dict[str, Any]:
    return fields.figure(picture) if isinstance(picture, Field) else charts.figure(picture)


def _packed(content: bytes) -> str:
    """Compressed, in letters."""
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


@cache
def _plotly() -> str:
    return _packed((files("plotly") / "package_data" / "plotly.min.js").read_bytes())


def _row(cells: Iterable[str]) -> str:
    """A row of a table, with roles that stay where a small screen stacks its cells."""
    told = (f'<td role="cell">{html.escape(cell)}</td>' for cell in cells)
    return f'<tr role="row">{"".join(told)}</tr>'


def _figures(answer: Answer) -> Iterator[str]:
    for name, told in answer.figures.items():
        value, error = _rounded(told)
        yield _row((name, value, error, told.unit, told.meaning))


def _rounded(told: Figure) -> tuple[str, str]:
    """Value and error as text."""
    if told.error == 0.0:
        return f"{told.value:.6g}", "none"
    if told.error is None:
        return f"{told.value:.5g}", "not known" if told.order is None else "not converged"
    value, _, rest = told.text().partition(" +- ")
    return value, f"± {rest.partition(' ')[0]}"


def _parameters(answer: Answer) -> Iterator[str]:
    for name, parameter in answer.parameters.items():
        value = parameter.value
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
        yield _row((name, text, parameter.unit, parameter.meaning))


def limited(table: Table) -> tuple[str, str]:
    """The CSV packed, of every k-th row if it is too large, and a note that says so."""
    rows, k = len(table.frame), 1
    while True:
        packed = _packed(table.frame.iloc[::k].to_csv(index=False).encode())
        if len(packed) <= LARGEST:
            part = f"one row in {k} of {rows}; the whole file lies beside this page"
            return packed, f"{rows} rows" if k == 1 else part
        k *= 2


def _downloads(tables: dict[str, tuple[str, str]]) -> Iterator[str]:
    for number, (name, (packed, note)) in enumerate(tables.items()):
        yield (
            f'<p><a class="button" data-of="table{number}" download="{html.escape(name)}">'
            f"{html.escape(name)}</a> {note}</p>"
            f'<script type="application/gzip" id="table{number}">{packed}</script>'
        )


def _provenance(answer: Answer) -> Iterator[str]:
    told = answer.provenance
    if told["algorithm"] and len(told["parts"]) > 1:
        yield _row(("coupling algorithm", told["algorithm"]))
    yield _row(("communication", told["communication"]))
    for wire in told["wires"]:
        yield _row(("wire", wire))
    for part, identity in told["parts"].items():
        yield _row((part, f"{identity['fmu']} ({told['flavour']}), {identity['guid']}"))
    for name, number in told["versions"].items():
        yield _row((name, number))
    yield _row(("curves", f"plotly.js of plotly {version('plotly')}, © Plotly, Inc., MIT licence"))


def _motion(motion: Motion) -> dict[str, Any]:
    """A motion in the units of its picture, which is 1000 wide and counts y downwards."""
    low, high = bounds(motion)
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
        "shapes": [
            {
                "name": shape.name,
                "color": COLORS[shape.color],
                "width": shape.width,
                "closed": shape.closed,
                "frames": frames(shape.points),
            }
            for shape in motion.shapes
        ],
    }
