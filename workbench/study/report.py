"""What a study found, as an answer: table, sensitivities, pictures, provenance and a few words."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import cosim
from cosim import SetupError
from cosim.calls import OK, Outcome
from cosim.errors import pluralize

from ..answer import Answer, Show, Table
from ..charts.mpl import draw
from ..figure import Figure
from ..run import Row
from . import charts
from .file import Study
from .sensitivity import analyse
from .words import sentence, shares_above_limits

#: Figures, and remarks, that are sentences of the verdict, the rest is in the table; chosen: more is a log.
SPOKEN = 3
PRINTED_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+(?:e[-+]?\d+)?|e[-+]?\d+)(?!\w)")

RESERVED_COLUMNS = ("run", "status", "warnings", "message")
NOTHING: Row = [], np.empty((0, 2)), []
NO_FIGURE = Figure.undetermined("1", "the run failed")


def conclude(
    study: Study,
    outcomes: Sequence[Outcome],
    units: Mapping[str, str],
    identity: Mapping[str, Any],
    session: tuple[int, float],
) -> Answer:
    """Return the answer of a study whose runs are all done, in their order.

    `units` are those of the varied inputs, `session` is how many runs were done now and how long it took
    [s].
    """
    table, names = frame(study, outcomes, units)
    wanted = study.figures or dict.fromkeys([*study.find, *names])
    figures = [names[name] for name in wanted if name in names]
    indices, missing = analyse(study, figures, table.frame)
    seconds = np.quantile([outcome.seconds for outcome in outcomes], (0.0, 0.5, 1.0)).tolist()
    counts = Counter(outcome.status for outcome in outcomes)
    shares, of_limits = shares_above_limits(study, table, names)
    facts = {
        "study": study.name,
        "runs": {"all": len(outcomes), **dict(sorted(counts.items()))},
        "sensitivities": indices.to_dict("records"),
        "no_sensitivities": missing,
        "limits": shares.frame.to_dict("records"),
        "seconds_per_run": dict(zip(("smallest", "median", "largest"), seconds)),
        "session": dict(zip(("runs", "seconds"), session)),
        "identity": identity,
    }
    title = f"{study.name}: {study.scenario}, {pluralize(len(outcomes), 'run')}"
    pictures = {
        "overview.png": charts.overview(study, table.frame, figures, table.units),
        "sensitivity.png": [] if indices.empty else charts.sensitivity(study, indices, table.units),
    }
    files: dict[str, Callable[[Path], object]] = {
        name: partial(draw, pictures_of_file, title)
        for name, pictures_of_file in pictures.items()
        if pictures_of_file
    }
    if find_spec("pyarrow"):
        files["table.parquet"] = partial(table.frame.to_parquet, index=False)
    tables = {"table.csv": table}
    if study.sampling is not None:
        tables["sensitivity.csv"] = Table.of_frame(indices, {})
    causes = {} if study.grid or indices.empty else _causes(indices)
    if study.limits:
        tables["limits.csv"] = shares
    spreads = [sentence(study, table, name) + causes.get(name, "") for name in figures[:SPOKEN]]
    more = len(figures) - SPOKEN
    ended = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    sentences = [
        *(f"{text}." for text in (*of_limits, *spreads)),
        *([f"{pluralize(more, 'more figure')} in the table."] if more > 0 else []),
        f"{pluralize(len(outcomes), 'run')}, {session[0]} of them now in {session[1]:.1f} s: {ended}.",
        *_remarks(outcomes),
    ]
    return Answer(
        scenario="study",
        question=title,
        verdict="\n".join(sentences),
        figures={},
        tables=tables,
        provenance={"parts": {}, "versions": cosim.versions()},
        facts=facts,
        files=files,
        show=lambda: Show(
            more=[picture for pictures_of_file in pictures.values() for picture in pictures_of_file]
        ),
    )


def _causes(indices: pd.DataFrame) -> dict[str, str]:
    """What moves each figure most, by its last index."""
    last = indices[indices["kind"] == indices["kind"].iloc[-1]]
    tops = last.loc[last.groupby("figure")["value"].idxmax()]
    return {
        top.figure: f"; it depends most on {top.input} ({top.kind} = {top.value:.2f} ± "
        f"{top.confidence:.2f} of its variance, {top.method})"
        if top.value > top.confidence
        else "; no input stands out"
        for top in tops.itertuples()
    }


def _remarks(outcomes: Sequence[Outcome]) -> list[str]:
    """Return how runs failed, what FMUs warned of and which figures were refused.

    Each remark says how often, and where first; texts that differ in their numbers alone are one remark.
    """
    runs_by_remark: dict[str, dict[int, str]] = {}
    for number, outcome in enumerate(outcomes):
        failed = [] if outcome.status == OK else [f"{outcome.status}: {outcome.message}"]
        warned = (f"warning: {text}" for text in warnings_of(outcome))
        for text in (*failed, *warned, *undetermined_figures(outcome)):
            runs_by_remark.setdefault(PRINTED_NUMBER.sub("#", text), {}).setdefault(number, text)
    lines = []
    for runs in sorted(runs_by_remark.values(), key=len, reverse=True):
        number, text = next(iter(runs.items()))
        where = f"Run {number}" if len(runs) == 1 else f"{len(runs)} runs (first: run {number})"
        short = PRINTED_NUMBER.sub(lambda number: f"{float(number[0]):.6g}", text)
        lines.append(f"{where}: {' '.join(short.split())}")
    left = len(lines) - SPOKEN
    more = [f"{left} more remarks in the table."] if left > 0 else []
    return lines[:SPOKEN] + more


def is_row(answer: Any) -> bool:
    """Whether an answer is a row of a study."""
    match answer:
        case ([*figures], np.ndarray(shape=shape), [*warnings]):
            texts = [text for figure in (*figures, warnings) for text in figure]
            is_each = all(isinstance(text, str) for text in texts)
            is_each &= {len(figure) for figure in figures} <= {3}
            return is_each and shape == (len(figures), 2)
    return False


def figures_of(outcome: Outcome) -> dict[str, Figure]:
    """The figures of a run by name; of one that failed none."""
    figures, numbers, _ = outcome.answer or NOTHING
    return {
        name: Figure(value, unit, None if math.isnan(error) else error, reason=reason)
        for (name, unit, reason), (value, error) in zip(figures, numbers)
    }


def warnings_of(outcome: Outcome) -> list[str]:
    """What FMUs and the question warned of in a run."""
    return list((outcome.answer or NOTHING)[2])


def undetermined_figures(outcome: Outcome) -> list[str]:
    """The figures that a run did not determine, and why."""
    figures = figures_of(outcome).items()
    return [f"{name} not determined: {x.reason}" for name, x in figures if x.reason]


def frame(
    study: Study, outcomes: Sequence[Outcome], units: Mapping[str, str]
) -> tuple[Table, dict[str, str]]:
    """The table, and the names of the columns by figure; `units` are those of the varied inputs.

    The columns are run, inputs, figures, their errors, status, warnings and message; cells are empty
    where a run does not tell. The message says why a run failed, or why it refuses figures. Raises
    SetupError for a figure in two units.
    """
    names: dict[str, str] = {}
    units = dict(units)
    rows = [figures_of(outcome) for outcome in outcomes]
    for figure, (_, unit, error, *_) in (item for row in rows for item in row.items()):
        taken = figure in study.varied or figure in RESERVED_COLUMNS
        name = names.setdefault(figure, f"answer.{figure}" if taken else figure)
        if units.setdefault(name, unit) != unit:
            raise SetupError(f"figure {figure!r} is in {units[name]} and in {unit}")
        if error is not None:
            units[name + charts.ERROR] = unit
    columns: dict[str, Any] = {"run": range(len(rows))}
    for name, values in zip(study.varied, zip(*study.runs())):
        kinds = set(map(type, values))
        convert: Callable[[Any], Any] = str if str in kinds else lambda value: +value
        columns[name] = values if len(kinds) == 1 else [convert(value) for value in values]
    for figure, name in names.items():
        cells = [row.get(figure, NO_FIGURE) for row in rows]
        columns[name] = pd.Series([x.value for x in cells], dtype=float)
        if name + charts.ERROR in units:
            columns[name + charts.ERROR] = pd.Series([x.error for x in cells], dtype=float)
    columns["status"] = [outcome.status for outcome in outcomes]
    columns["warnings"] = ["; ".join(warnings_of(outcome)) for outcome in outcomes]
    columns["message"] = [x.message or "; ".join(undetermined_figures(x)) for x in outcomes]
    return Table.of_frame(pd.DataFrame(columns), units), names
