"""An answer is written: CSV, JSON, picture, page, motions."""

from __future__ import annotations

import json
import sys
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cosim.journal import differences
from cosim.json_values import without_infinities
from cosim.result import partial, write_json

from .answer import Answer
from .charts.gif import gif
from .charts.mpl import draw
from .files import replacement
from .page.html import report
from .remedies import with_remedies
from .runs.folder import reservation

#: File name of the page.
PAGE = "report.html"


def draw_answer(answer: Answer, path: Path) -> bool:
    """Write the picture of an answer: its motions that have still frames, and its charts, below its first line.

    Returns whether there is anything to draw.
    """
    show, title = answer.show(), answer.verdict.partition("\n")[0] or answer.question
    pictures = [*(motion for motion in show.motions if motion.ghosts), *show.charts]
    if pictures:
        with replacement(path) as fresh:
            draw(pictures, title, fresh)
    return bool(pictures)


def html_picture(answer: Answer) -> str:
    """Return the picture of an answer as an element of HTML, for a notebook."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "answer.png"
        if not draw_answer(answer, path):
            return ""
        content = b64encode(path.read_bytes()).decode()
    return f'<img src="data:image/png;base64,{content}" style="max-width: 100%">'


def write(answer: Answer, folder: Path, *, animate: bool = False) -> list[str]:
    """Write tables, JSON, other files, page and, on request, motions to a folder; return their names.

    Raises SetupError if another run uses the folder.
    """
    with reservation(folder):
        folder.mkdir(parents=True, exist_ok=True)
        show = (
            answer.show()
        )  # before the file is replaced from which columns are read when asked for
        answer = replace(answer, show=lambda: show)
        for name, table in answer.tables.items():
            with (
                replacement(folder / name) as fresh,
                fresh.open("w", encoding="utf-8", newline="\n") as file,
            ):
                file.writelines(table.csv())
            partial(folder / name).unlink(missing_ok=True)
        with replacement(folder / f"{answer.scenario}.json") as fresh:
            write_json(fresh, content(answer))
        for name, save in answer.files.items():
            with replacement(folder / name) as fresh:
                save(fresh)
        image = f"{answer.scenario}.png"
        pictures = [image] * draw_answer(answer, folder / image)
        for number, motion in enumerate(answer.show().motions if animate else (), 1):
            pictures.append(f"{answer.scenario}{f'_{number}' if number > 1 else ''}.gif")
            with replacement(folder / pictures[-1]) as fresh:
                gif(fresh, motion)
        written = [*answer.tables, f"{answer.scenario}.json", *answer.files, *pictures]
        if find_spec("plotly"):
            with replacement(folder / PAGE) as fresh:
                report(answer, fresh)
            written.append(PAGE)
        return written


def content(answer: Answer) -> dict[str, Any]:
    """Return the content of the JSON file, each number once."""
    parts = {
        name: {key: part[key] for key in part if key not in ("parameters", "warnings")}
        for name, part in answer.provenance["parts"].items()
    }
    return {
        "scenario": answer.scenario,
        "question": answer.question,
        "verdict": answer.verdict.splitlines(),
        "judgements": [judgement.json() for judgement in answer.judgements],
        "warnings": list(answer.warnings),
        "figures": {name: figure.json() for name, figure in answer.figures.items()},
        "refused": answer.refused,
        "options": {name: value._asdict() for name, value in answer.options.items()},
        "parameters": {name: value._asdict() for name, value in answer.parameters.items()},
        "units": {
            key: unit for table in answer.tables.values() for key, unit in table.units.items()
        },
        **answer.provenance,
        "parts": parts,
        **answer.facts,
    }


def replacement_notice(answer: Answer, folder: Path) -> str:
    """Say in a sentence which answer to other values a folder has, and in what they differ; "" without one."""
    path = folder / f"{answer.scenario}.json"
    try:
        before, after = (_asked_values(json.loads(text)) for text in (
            path.read_text(encoding="utf-8"), json.dumps(without_infinities(content(answer)))))  # fmt: skip
        written = datetime.fromtimestamp(path.stat().st_mtime)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return ""
    if before == after:
        return ""
    return (
        f"{folder}: this replaces the answer of {written:%Y-%m-%d %H:%M} to other values: "
        f"{differences(before, after)}; to keep both, choose another folder with --out"
    )


def _asked_values(content: Mapping[str, Any]) -> dict[str, Any]:
    """What was asked: the values of options and parameters of a JSON file, and its flavour."""
    asked = {**content["options"], **content["parameters"]}
    values = {name: parameter["value"] for name, parameter in asked.items()}
    return {**values, "flavour": content["flavour"]} if "flavour" in content else values


def print_and_write(
    answer: Answer,
    folder: Path,
    *,
    animate: bool = False,
    most_steps: float = 0.0,
    more: Sequence[str] = (),
) -> None:
    """Print the verdict, the figures and the FMUs' warnings; then write the files, and print where they are.

    An answer to other values that the folder has is replaced, which is said on stderr. Remedies are sought and printed behind
    the answer if that takes no more than so many communication steps. `more` has been written to the folder before.
    """
    if text := replacement_notice(answer, folder):
        print(text, file=sys.stderr)
    if text := repr(answer):
        print(text, flush=True)
    answer, lines = with_remedies(answer, most_steps)
    for line in lines:
        print(line, flush=True)
    names = [*write(answer, folder, animate=animate), *more]
    print(f"{', '.join(names)} written to {folder}")
    if PAGE not in names:
        print('no page was written: install it with pip install "drive-fmus[page]"')
