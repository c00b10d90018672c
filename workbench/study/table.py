"""The table of a study: one row per run in the order of the runs, whoever did them and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from cosim import SetupError

from ..answer import Table
from ..runs.worker import Outcome
from .plan import Study

ERROR = "_error"
OWN = ("run", "status", "warnings", "message")
NOTHING: Mapping[str, Any] = {"figures": {}, "warnings": []}


def found(outcome: Outcome) -> Mapping[str, Any]:
    """What `row` made of a run; nothing of one that failed."""
    return outcome.answer or NOTHING


def refusals(outcome: Outcome) -> list[str]:
    """The figures that a run did not tell, and why."""
    figures = found(outcome)["figures"].items()
    return [f"{name} not told: {reason}" for name, (*_, reason) in figures if reason]


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
    rows = [found(outcome)["figures"] for outcome in outcomes]
    for figure, (_, unit, error, _) in (item for row in rows for item in row.items()):
        taken = figure in study.varied or figure in OWN
        name = names.setdefault(figure, f"answer.{figure}" if taken else figure)
        if units.setdefault(name, unit) != unit:
            raise SetupError(f"figure {figure!r} is in {units[name]} and in {unit}")
        if error is not None:
            units[name + ERROR] = unit
    columns: dict[str, Any] = {"run": range(len(rows))}
    columns |= dict(zip(study.varied, zip(*study.runs())))
    for figure, name in names.items():
        cells = [row.get(figure, (None, "", None, "")) for row in rows]
        columns[name] = pd.Series([value for value, *_ in cells], dtype=float)
        if name + ERROR in units:
            columns[name + ERROR] = pd.Series([error for _, _, error, _ in cells], dtype=float)
    columns["status"] = [outcome.status for outcome in outcomes]
    columns["warnings"] = ["; ".join(found(outcome)["warnings"]) for outcome in outcomes]
    columns["message"] = [x.message or "; ".join(refusals(x)) for x in outcomes]
    return Table(pd.DataFrame(columns), units), names
