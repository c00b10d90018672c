"""The table of a study: one row per run in the order of the runs, whoever did them and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from cosim import SetupError

from .plan import Study

ERROR = "_error"
OWN = ("run", "status", "warnings", "message")


def refusals(row: Mapping[str, Any]) -> list[str]:
    """The figures that a run did not tell, and why."""
    return [f"{name} not told: {reason}" for name, (*_, reason) in row["figures"].items() if reason]


def frame(
    study: Study, rows: Sequence[Mapping[str, Any]]
) -> tuple[pd.DataFrame, dict[str, str], dict[str, str]]:
    """The table, the names of the columns by figure, and the units of these columns.

    The columns are run, inputs, figures, their errors, status, warnings and message; cells are empty
    where a run does not tell. The message says why a run failed, or why it refuses figures.
    """
    names: dict[str, str] = {}
    units: dict[str, str] = {}
    for row in rows:
        for figure, (_, unit, error, _) in row["figures"].items():
            taken = figure in study.varied or figure in OWN
            name = names.setdefault(figure, f"answer.{figure}" if taken else figure)
            if units.setdefault(name, unit) != unit:
                raise SetupError(f"figure {figure!r} is in {units[name]} and in {unit}")
            if error is not None:
                units[name + ERROR] = unit
    columns: dict[str, Any] = {"run": range(len(rows))}
    columns |= dict(zip(study.varied, zip(*study.runs())))
    for figure, name in names.items():
        cells = [row["figures"].get(figure, (None, "", None, "")) for row in rows]
        columns[name] = pd.Series([value for value, *_ in cells], dtype=float)
        if name + ERROR in units:
            columns[name + ERROR] = pd.Series([error for _, _, error, _ in cells], dtype=float)
    columns["status"] = [row["status"] for row in rows]
    columns["warnings"] = ["; ".join(row["warnings"]) for row in rows]
    columns["message"] = [row["message"] or "; ".join(refusals(row)) for row in rows]
    return pd.DataFrame(columns), names, units
