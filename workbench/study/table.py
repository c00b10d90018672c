"""The table of a study: one row per run in the order of the runs, whoever did them and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from cosim import SetupError
from cosim.result import partial

ERROR = "_error"
OWN = ("run", "status", "warnings", "message")


class Columns:
    """Names of the columns of figures, and their units."""

    def __init__(self, varied: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
        taken = {*varied, *OWN}
        self.units: dict[str, str] = {}
        self.names: dict[str, str] = {}
        self.errors: dict[str, str] = {}
        for row in rows:
            for figure, (_, unit, error, _) in row["figures"].items():
                name = f"answer.{figure}" if figure in taken else figure
                self.names[figure] = name
                if self.units.setdefault(name, unit) != unit:
                    raise SetupError(f"figure {figure!r} is in {self.units[name]} and in {unit}")
                if error is not None:
                    self.errors[figure] = f"{name}{ERROR}"
                    self.units[f"{name}{ERROR}"] = unit


def refusals(row: Mapping[str, Any]) -> list[str]:
    """The figures that a run did not tell, and why."""
    return [f"{name} not told: {reason}" for name, (*_, reason) in row["figures"].items() if reason]


def frame(
    varied: Sequence[str], inputs: Sequence[Sequence[Any]], rows: Sequence[Mapping[str, Any]]
) -> tuple[pd.DataFrame, Columns]:
    """run, inputs, figures, their errors, status, warnings, message; empty where a run does not tell.

    The message says why a run failed, or why it refuses figures.
    """
    columns = Columns(varied, rows)
    content: dict[str, list[Any]] = {"run": list(range(len(rows)))}
    content |= {name: [values[i] for values in inputs] for i, name in enumerate(varied)}
    for figure, name in columns.names.items():
        told = [row["figures"].get(figure, (None, "", None, "")) for row in rows]
        content[name] = [value for value, *_ in told]
        if figure in columns.errors:
            content[columns.errors[figure]] = [error for _, _, error, _ in told]
    content["status"] = [row["status"] for row in rows]
    content["warnings"] = ["; ".join(row["warnings"]) for row in rows]
    content["message"] = [row["message"] or "; ".join(refusals(row)) for row in rows]
    made = pd.DataFrame(content)
    figures = [name for name in made.columns[1 + len(varied) :] if name not in OWN]
    return made.astype(dict.fromkeys(figures, float)), columns


def write(table: pd.DataFrame, path: Path) -> list[str]:
    """Write NAME.csv, and NAME.parquet where pyarrow is there; the names of the files."""
    table.to_csv(partial(path), index=False)
    partial(path).replace(path)
    parquet = path.with_suffix(".parquet")
    try:
        table.to_parquet(partial(parquet), index=False)
    except ImportError:
        return [path.name]
    partial(parquet).replace(parquet)
    return [path.name, parquet.name]
