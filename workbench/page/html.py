"""One page that shows what a question or a study found; it needs no network and no other file."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import math
import re
import secrets
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..charts.motion import Motion
from ..charts.plotly import MOST, Words, alt_text, figure
from ..charts.svg import svg
from ..figure import ERROR_SCOPE, Figure
from .script import compact

if TYPE_CHECKING:
    from ..answer import Answer, Table

LARGEST, OPEN = 250_000, 12
SHEET, LEAST, LATER = 8.0, 3.2, 6.4


def report(answer: Answer, path: Path) -> None:
    """Write the page of an answer."""
    from jinja2 import Environment, FileSystemLoader

    show = answer.show()
    pictures, most = [*show.charts, *show.more], [first_sheet(answer)]
    charts = [figure(each, room) for each, room in zip(pictures, most + [LATER] * len(pictures))]
    live = answer.live
    content: dict[str, Any] = {"charts": charts, "motions": list(map(motion, show.motions))}
    content |= {"live": live.data} if live else {}
    folder = FileSystemLoader(Path(__file__).parent)
    made = Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    made.filters["compact"] = compact
    page = made.get_template("page.html")
    mark = f"own-{secrets.token_hex(16)}"
    text = page.render(
        answer=answer,
        scope=ERROR_SCOPE,
        mark=mark,
        charts=[
            {"title": x.title, "words": alt_text(x, drawn)} for x, drawn in zip(pictures, charts)
        ],
        motions=show.motions,
        figures=[_figure(name, x) for name, x in answer.figures.items()],
        tables={name: limited(x, len(answer.tables)) for name, x in answer.tables.items()},
        parameters=_parameters(answer),
        provenance=_provenance(answer.provenance),
        open=OPEN,
        packed=_packed(json.dumps(content, separators=(",", ":")).encode()),
        plotly=_packed_plotly(),
        modules={part: _packed(module) for part, module in live.modules.items()} if live else {},
        worker=_packed(live.worker.encode()) if live else "",
    )
    more = " 'wasm-unsafe-eval'; worker-src blob:" if live else ""
    path.write_text(secured(text, mark, [_plotly()], more), encoding="utf-8")


def secured(text: str, mark: str, inserted: Sequence[bytes], more: str = "") -> str:
    """A page that runs its own scripts and no other.

    Parameters
    ----------
    text
        The page. A mark, which no text of an answer can know, stands in the tag of each script of its
        template, and in place of its content security policy.
    inserted
        Scripts that these insert, in UTF-8.
    more
        What else the policy allows to scripts, and further directives.
    """
    own = re.findall(f"<script {mark}>(.*?)</script>", text, re.DOTALL)
    hashes = [hashlib.sha256(script).digest() for script in (*map(str.encode, own), *inserted)]
    sources = " ".join(f"'sha256-{base64.b64encode(each).decode()}'" for each in hashes)
    policy = (
        f"default-src 'none'; script-src {sources}{more}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return text.replace(f"<script {mark}>", "<script>").replace(mark, policy)


def first_sheet(answer: Answer) -> float:
    """The height [inches of 100 px] that the words leave for a picture on the first sheet of A4 or
    Letter, if they leave enough for one."""
    lines = [*answer.verdict.splitlines(), *answer.warnings]
    title = 0.24 * math.ceil(len(answer.question) / 56)
    room = SHEET - title - 0.23 * sum(math.ceil(len(line) / 95) for line in lines)
    return room if room > LEAST else LATER


def _packed(content: bytes) -> str:
    """Compressed, in letters."""
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


@cache
def _plotly() -> bytes:
    return (files("plotly") / "package_data" / "plotly.min.js").read_bytes()


@cache
def _packed_plotly() -> str:
    return _packed(_plotly())


def _figure(name: str, figure: Figure) -> Sequence[str]:
    """Name, value, error, unit and meaning; why there is no value where it is refused."""
    value, _, error = figure._replace(unit="").text().partition(" ± ")
    error = f"±\N{NO-BREAK SPACE}{error}" if error else "none"
    if figure.error is None:
        value, error = "not determined", figure.reason
    return name, value, error, figure.unit, figure.meaning


def _parameters(answer: Answer) -> list[Sequence[str]]:
    """Name, value, unit and meaning."""
    return [
        (name, _value(x.value), "" if x.value is None else x.unit, x.meaning)
        for name, x in {**answer.options, **answer.parameters}.items()
    ]


def _value(value: object) -> str:
    """What was given, numbers with six digits, the items of a list one after the other."""
    if value is None:
        return "not given"
    if isinstance(value, tuple):
        return ", ".join(map(_value, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def limited(table: Table, among: int = 1) -> tuple[str, str]:
    """The CSV packed, of every k-th row if it is too large, and a note that says so; all tables of
    a page together stay below LARGEST."""
    rows, k = len(table.frame), 1
    while True:
        packed = _packed(table.frame.iloc[::k].to_csv(index=False).encode())
        if len(packed) * among <= LARGEST:
            part = f"one row in {k} of {rows}; the complete file is next to this page"
            return packed, f"{rows} rows" if k == 1 else part
        k *= 2


def _provenance(known: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the answer comes from: coupling, wires, FMUs, versions."""
    parts = known.get("parts", {})
    once = {"coupling algorithm": known.get("algorithm") if len(parts) > 1 else None,
            "communication": known.get("communication")}  # fmt: skip
    rows = [(name, text) for name, text in once.items() if text]
    rows += [("wire", wire) for wire in known.get("wires", ())]
    rows += [(p, f"{x['fmu']} ({known['flavour']}), {x['guid']}") for p, x in parts.items()]
    points = f"at most {MOST} points each, with the smallest and largest of every stretch"
    drawn = (
        f"{points}, drawn by plotly.js of plotly {version('plotly')}, © Plotly, Inc., MIT licence"
    )
    return [*rows, *known["versions"].items(), ("curves", drawn)]


def motion(it: Motion) -> Words:
    """A motion as the page's script gets it."""
    times = (it.times - it.times[0]).round(6).tolist()
    pace = "In real time." if it.slow == 1 else f"{it.slow:g} times slower than real time."
    return {
        "svg": svg(it), "slow": it.slow, "times": times, "captions": list(it.captions),
        "note": f"{pace} {it.note}",
    }  # fmt: skip
