"""What a study found, as an answer: table, sensitivities, pictures, provenance and a few words."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pandas as pd

import cosim
from cosim import SetupError

from ..answer import Answer, Show, Table, write
from ..report.png import draw
from ..runs.worker import OK
from . import show
from .plan import Study
from .sensitivity import analyse
from .table import frame, refusals

SPOKEN = 8


@dataclass(frozen=True)
class Outcome:
    """The table of a study, units of its columns, sensitivities, and the answer in words."""

    folder: Path
    table: pd.DataFrame
    units: Mapping[str, str]
    sensitivities: pd.DataFrame
    verdict: str


def conclude(
    study: Study,
    rows: Sequence[Mapping[str, Any]],
    units: Mapping[str, str],
    identity: Mapping[str, Any],
    session: tuple[int, float],
    folder: Path,
) -> Outcome:
    """Write the files of a study whose runs are all done, rows in the order of the runs; `units` are
    those of the varied inputs, `session` is how many runs were done now and how long it took [s].

    Raises SetupError, after that, if the study asks for a figure that no run has.
    """
    table, names, more = frame(study, rows)
    units = {**units, **more}
    shown = [names[name] for name in study.figures or names if name in names]
    found, missing = analyse(study, shown, table)
    counts = Counter(str(row["status"]) for row in rows)
    seconds = [row["seconds"] for row in rows]
    facts = {
        "study": study.name,
        "runs": {"all": len(rows), **dict(sorted(counts.items()))},
        "sensitivities": found.to_dict("records"),
        "no_sensitivities": missing,
        "seconds_per_run": {
            "smallest": min(seconds),
            "median": statistics.median(seconds),
            "largest": max(seconds),
        },
        "session": dict(zip(("runs", "seconds"), session)),
        "identity": identity,
    }
    title = f"{study.name}: {study.scenario}, {len(table)} runs"
    pictures = {
        "overview.png": show.overview(study, table, shown, units),
        "sensitivity.png": [] if found.empty else show.sensitivity(study, found, units),
    }
    files: dict[str, Callable[[Path], object]] = {
        name: partial(draw, Show(drawn), title) for name, drawn in pictures.items() if drawn
    }
    if find_spec("pyarrow"):
        files["table.parquet"] = partial(table.to_parquet, index=False)
    tables = {"table.csv": Table(table, units)}
    if study.sampling is not None:
        tables["sensitivity.csv"] = Table(found, {})
    ended = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    words = [
        f"{len(rows)} runs, {session[0]} of them now in {session[1]:.1f} s: {ended}.",
        *_remarks(rows),
        *(_spread(table, name, units.get(name, "")) for name in shown[:SPOKEN]),
        *([] if study.grid or found.empty else _causes(found, shown[:SPOKEN])),
    ]
    answer = Answer(
        scenario="study",
        question=title,
        verdict="\n".join(words),
        figures={},
        parameters={},
        tables=tables,
        provenance={"parts": {}, "versions": cosim.versions()},
        facts=facts,
        files=files,
        show=lambda: Show(more=[picture for drawn in pictures.values() for picture in drawn]),
    )
    written = ", ".join(write(answer, folder))
    unknown = [name for name in study.figures if name not in names]
    if unknown and names:
        raise SetupError(
            f"{study.path}: figures: no run has {unknown[0]!r}, only {', '.join(names)}; "
            f"the table is in {folder}"
        )
    verdict = f"{answer.verdict}\n{written} written to {folder}"
    return Outcome(folder, table, units, found, verdict)


def _remarks(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How runs failed, what FMUs warned of and which figures were refused: how often, first where."""
    seen: dict[str, list[int]] = {}
    for number, row in enumerate(rows):
        failed = [f"{row['status']}: {row['message']}"] * (row["status"] != OK)
        for text in [*failed, *(f"warning: {x}" for x in row["warnings"]), *refusals(row)]:
            seen.setdefault(text, []).append(number)
    most = sorted(seen.items(), key=lambda one: -len(one[1]))
    lines = [f"Run {runs[0]}, {len(runs)} in all, {text}" for text, runs in most[:SPOKEN]]
    return lines + [f"{len(most) - SPOKEN} more remarks in the table."] * (len(most) > SPOKEN)


def _spread(table: pd.DataFrame, name: str, unit: str) -> str:
    """A figure over all runs."""
    y = table[name].dropna()
    if y.empty:
        return f"{name}: no run has it."
    text = f"{name}: {y.min():.6g} to {y.max():.6g} {unit.removeprefix('1')}".rstrip()
    if len(y) > 1:
        text += f", mean {y.mean():.6g}, standard deviation {y.std():.3g}"
    return f"{text} ({len(y)} runs)." if len(y) < len(table) else f"{text}."


def _causes(found: pd.DataFrame, shown: Sequence[str]) -> list[str]:
    """What moves each figure most, by its last index."""
    last = found[found["kind"] == found["kind"].iloc[-1]]
    tops = last.loc[last.groupby("figure")["value"].idxmax()].set_index("figure")
    return [
        f"{name} depends most on {tops['input'][name]}: {tops['kind'][name]} = "
        f"{tops['value'][name]:.2f} +- {tops['confidence'][name]:.2f} of its variance "
        f"({tops['method'][name]})."
        for name in shown
        if name in tops.index
    ]
