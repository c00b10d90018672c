"""The answer of a question over machines that scatter: a study of its judgements, whose shares stand behind its first line."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cosim import SetupError
from cosim.cli.options import assignment
from cosim.errors import pluralize

from ..answer import Answer, Show
from ..charts.model import Chart, Mark, Panel
from ..files import remove, replacement
from ..judgement import Judgement, bounded, capital
from ..options import parse_starts
from ..project import Project
from ..run import JUDGED
from . import charts
from .file import load
from .run import run
from .words import count_text, interval

#: A tolerance as it is written: of a normal distribution or a uniform one, a width or percents.
TOLERANCE = re.compile(r"(normal:)?(\+-)?([^%]+?)\s*%?")
STUDY = "tolerances"


def study_file(
    scenario: str,
    options: Mapping[str, Any],
    answer: Answer,
    texts: Sequence[str],
    machines: int,
) -> str:
    """Return the study of a question over so many machines, from tolerances "motor.T=5%", "motor.T=normal:+-0.001".

    Raises SetupError for a tolerance of what has no value that scatters.
    """
    given = {name: x.value for name, x in {**answer.parameters, **answer.options}.items()}
    fixed = {**options, **parse_starts(options.get("start", ()))}
    fixed.pop("start", None)
    tolerances = {}
    for name, text in map(assignment, texts):
        written = TOLERANCE.fullmatch(text)
        if name not in given or not isinstance(given[name], int | float) or not written:
            form = "NAME=PERCENT, NAME=+-VALUE, or either with normal: before it, of a number that the question has"
            raise SetupError(f"--tolerance {name}={text}: must be {form}")
        normal, is_width, width = written.groups()
        wide = width if is_width else json.dumps(f"{width} %")
        tolerances[name] = (
            f"{{ nominal = {float(given[name])!r}, {'normal' if normal else 'uniform'} = {wide} }}"
        )
    method = "lhs" if machines & (machines - 1) else "sobol"
    lines = [
        f"scenario = {json.dumps(scenario)}", "judgements = true", "[fixed]",
        *(f"{json.dumps(name)} = {json.dumps(x)}" for name, x in fixed.items() if name not in tolerances),
        "[sampling]", f'method = "{method}"', f"number = {machines}", "seed = 1", "[tolerances]",
        *(f"{json.dumps(name)} = {x}" for name, x in tolerances.items()),
    ]  # fmt: skip
    return "\n".join([*lines, ""])


def with_tolerances(
    answer: Answer, content: str, folder: Path, project: Project, **settings: Any
) -> Answer:
    """Return an answer with the share of machines for which each judgement is yes, and a picture of the scatter.

    The study goes to a folder of its own beside the answer's files, and is resumed there; one of other machines is replaced.
    """
    path = folder / STUDY / f"{STUDY}.toml"
    if path.exists() and path.read_text(encoding="utf-8") != content:
        remove(path.parent)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacement(path) as fresh:
        fresh.write_text(content, encoding="utf-8")
    table = run(load(path, project), out=path.parent, **settings).first_table
    lines, panels = [], []
    for k, x in enumerate(answer.judgements):
        name = next((name for name, y in answer.figures.items() if y == x.figure), "")
        if x.answer is not None:
            flags = table.get(JUDGED.format(k + 1), table["run"] * np.nan)
            lines.append(share_line(x, flags.to_numpy(float)))
            if name in table and table[name].notna().any():
                marks = [
                    Mark(y.value, f"{word} {y.brief()}")
                    for word, y in (
                        ("at least", bounded(x.least, x.figure)),
                        ("at most", bounded(x.most, x.figure)),
                    )
                    if np.isfinite(y.value)
                ]
                panels.append(
                    Panel(
                        name,
                        answer.figures[name].unit,
                        [charts.distribution_curve(table, name)],
                        marks,
                    )
                )
    chart = Chart(f"Scatter of {pluralize(len(table), 'machine')}", "machines below [%]", panels)
    first, *others = answer.verdict.splitlines()
    shown = answer.show

    def show() -> Show:
        known = shown()
        return known._replace(charts=[*known.charts, *([chart] if panels else [])])

    return replace(answer, verdict="\n".join([first, *lines, *others]), show=show)


def share_line(judgement: Judgement, flags: Any) -> str:
    """Return for how many machines a judgement is yes, with the interval of the share; what is not known may be either."""
    yes, unknown = int((flags == 1.0).sum()), int(np.isnan(flags).sum())
    text = count_text(yes, len(flags), "machine", *interval(yes, len(flags), unknown))
    near = f"; not determined in {unknown}" if unknown else ""
    return capital(f"{judgement.claim}: yes in {text}{near}")
