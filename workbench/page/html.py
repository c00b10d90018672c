"""One page that shows the answer of a question or a study; it needs no network and no other file."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
import secrets
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.json_values import Json

from ..charts.motion import Motion
from ..charts.plotly import alt_text, figure
from ..charts.style import STYLE
from ..charts.svg import svg
from ..figure import Figure
from ..judgement import Holds
from .script import compact

if TYPE_CHECKING:
    from markupsafe import Markup

    from ..answer import Answer, Table

#: Most letters that the tables of a page take together; chosen: a tenth of what plotly takes.
MAX_TABLE_LETTERS = 250_000
#: Rows of a list that is open from the beginning; chosen: half a screen.
MAX_OPEN_ROWS = 12
#: Heights of the first picture on paper, below the answer, and of a later one on a sheet with its title [px]; chosen by eye in
#: chromium on Letter, which is lower than A4.
FIRST_PICTURE_PX, LATER_PICTURE_PX = 480.0, 640.0
#: How hard gzip tries; a convention of gzip, whose higher levels take longer for less than 1 %.
COMPRESSION = 6


def report(answer: Answer, path: Path) -> None:
    """Write the page of an answer."""
    from jinja2 import Environment, FileSystemLoader

    show = answer.show()
    pictures = [*show.charts, *show.more]
    heights = [FIRST_PICTURE_PX] + [LATER_PICTURE_PX] * len(pictures)
    charts = [figure(picture, height) for picture, height in zip(pictures, heights)]
    live = None if isinstance(answer.live, str) else answer.live
    content: dict[str, Any] = {"charts": charts, "motions": list(map(motion_json, show.motions))}
    content |= {"live": live.data} if live else {}
    folder = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["compact"] = compact
    environment.filters["code"] = code
    page = environment.get_template("page.html")
    mark = f"own-{secrets.token_hex(16)}"
    text = page.render(
        answer=answer,
        live=live,
        still=answer.live if isinstance(answer.live, str) else "",
        scope=answer.error_scope,
        judged=list(lines_with_signs(answer)),
        mark=mark,
        charts=[{"title": picture.title, "alt_text": alt_text(picture)} for picture in pictures],
        motions=show.motions,
        figures=[_figure(name, x) for name, x in answer.figures.items()],
        tables={name: packed_csv(x, len(answer.tables)) for name, x in answer.tables.items()},
        parameters=_parameters(answer),
        provenance=_provenance(answer.provenance),
        max_open=MAX_OPEN_ROWS,
        packed=_packed(json.dumps(content, separators=(",", ":")).encode()),
        plotly=_packed_plotly(),
        modules={part: _packed(module) for part, module in live.modules.items()} if live else {},
        worker=_packed(live.worker.encode()) if live else "",
    )
    more = " 'wasm-unsafe-eval'; worker-src blob:" if live else ""
    path.write_text(with_content_policy(text, mark, [_plotly()], more), encoding="utf-8")


def lines_with_signs(answer: Answer) -> Iterator[tuple[str, str, str]]:
    """Give each line of the verdict with its sign, which is not told by colour alone, and what it means."""
    signs = {
        True: ("\N{CHECK MARK}", "yes"),
        False: ("\N{BALLOT X}", "no"),
        None: ("\N{BULLET}", ""),
    }
    for line, judgement in zip_longest(answer.verdict.splitlines(), answer.judgements):
        good = judgement.good if judgement else None
        is_open = judgement is not None and judgement.answer is Holds.OPEN
        yield *(("?", "open") if is_open else signs[good]), line


def code(text: str) -> Markup:
    """Return a text as HTML, in which what stands between backticks is code."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def with_content_policy(text: str, mark: str, inserted: Sequence[bytes], more: str = "") -> str:
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
    scripts = re.findall(f"<script {mark}>(.*?)</script>", text, re.DOTALL)
    hashes = [hashlib.sha256(script).digest() for script in (*map(str.encode, scripts), *inserted)]
    sources = " ".join(f"'sha256-{base64.b64encode(each).decode()}'" for each in hashes)
    policy = (
        f"default-src 'none'; script-src {sources}{more}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return text.replace(f"<script {mark}>", "<script>").replace(mark, policy)


def _packed(content: bytes) -> str:
    """Compressed, in letters."""
    return base64.b64encode(gzip.compress(content, COMPRESSION, mtime=0)).decode()


@cache
def _plotly() -> bytes:
    return (files("plotly") / "package_data" / "plotly.min.js").read_bytes()


@cache
def _packed_plotly() -> str:
    return _packed(_plotly())


def _figure(name: str, figure: Figure) -> Sequence[str]:
    """Name, value, error, unit and meaning; why there is no value where it is refused."""
    value, _, error = figure._replace(unit="").text().partition(" ± ")
    error = f"±\N{NO-BREAK SPACE}{error}" if error else ""
    if figure.error is None:
        value, error = "not determined", figure.reason
    return name, value, error, "" if figure.unit == "1" else figure.unit, figure.meaning


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


def packed_csv(table: Table, among: int = 1) -> tuple[str, str]:
    """Return the CSV packed, of every k-th row if it is too large, and a note that says so.

    All tables of a page together stay below MAX_TABLE_LETTERS.
    """
    rows, k = len(table), 1
    while True:
        packed = _packed("".join(table.csv(k)).encode())
        if len(packed) * among <= MAX_TABLE_LETTERS:
            part = f"one row in {k} of {rows}; the complete file is next to this page"
            return packed, f"{rows} rows" if k == 1 else part
        k *= 2


def _provenance(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the answer comes from: coupling, wires, FMUs, versions."""
    parts, flavour = provenance.get("parts", {}), provenance.get("flavour", "")
    once = {"coupling algorithm": provenance.get("algorithm") if len(parts) > 1 else None,
            "communication": provenance.get("communication")}  # fmt: skip
    rows = [(name, text) for name, text in once.items() if text]
    rows += [("wire", wire) for wire in provenance.get("wires", ())]
    rows += [(name, f"{x['fmu']} ({flavour}), {x['guid']}") for name, x in parts.items()]
    most, package = STYLE.max_points, f"plotly {version('plotly')}"
    points = f"at most {most} points each, with the smallest and largest of every stretch"
    curves = f"{points}, drawn by plotly.js of {package}, © Plotly, Inc., MIT licence"
    return [*rows, *provenance["versions"].items(), ("curves", curves)]


def motion_json(motion: Motion) -> dict[str, Json]:
    """Return a motion as the page's script gets it."""
    times = (motion.times - motion.times[0]).round(6).tolist()
    pace = "In real time." if motion.slow == 1 else f"{motion.slow:g} times slower than real time."
    return {
        "svg": svg(motion), "slow": motion.slow, "times": times,
        "captions": list(motion.captions), "note": f"{pace} {motion.note}",
    }  # fmt: skip
