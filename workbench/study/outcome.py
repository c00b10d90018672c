"""What a study found: table, sensitivities, pictures, provenance and a few words."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

import cosim
from cosim import SetupError
from cosim.result import partial, write_json

from ..answer import Answer, Show, Table
from ..report.html import report
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


class Session(NamedTuple):
    """What was studied, and the runs and wall time [s] of this session."""

    identity: Mapping[str, Any]
    runs: int
    seconds: float


def conclude(
    study: Study,
    rows: Sequence[Mapping[str, Any]],
    units: Mapping[str, str],
    session: Session,
    folder: Path,
) -> Outcome:
    """Write the files of a study whose runs are all done, rows in the order of the runs; `units` are
    those of the varied inputs.

    Raises SetupError, after that, if the study asks for a figure that no run has.
    """
    table, names, more = frame(study, rows)
    units = {**units, **more}
    shown = [names[name] for name in study.figures or names if name in names]
    written = [_write(table, folder / "table.csv"), *_parquet(table, folder / "table.parquet")]
    found, missing = analyse(study, shown, table)
    if study.sampling is not None:
        written.append(_write(found, folder / "sensitivity.csv"))
    title = f"{study.name}: {study.scenario}, {len(table)} runs"
    overview = show.overview(study, table, shown, units)
    shares = [] if found.empty else show.sensitivity(study, found, units)
    for name, drawn in (("overview.png", overview), ("sensitivity.png", shares)):
        written += draw(Show(drawn), title, folder / name)
    counts = Counter(str(row["status"]) for row in rows)
    seconds = [row["seconds"] for row in rows]
    content = {
        "study": study.name,
        "runs": {"all": len(rows), **dict(sorted(counts.items()))},
        "units": units,
        "sensitivities": found.to_dict("records"),
        "no_sensitivities": missing,
        "seconds_per_run": {
            "smallest": min(seconds),
            "median": statistics.median(seconds),
            "largest": max(seconds),
        },
        "session": {"runs": session.runs, "seconds": session.seconds},
        "platform": cosim.versions()["platform"],
        "identity": session.identity,
    }
    write_json(folder / "study.json", content)
    ended = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    words = [
        f"{len(rows)} runs, {session.runs} of them now in {session.seconds:.1f} s: {ended}.",
        *_remarks(rows),
        *(_spread(table, name, units.get(name, "")) for name in shown[:SPOKEN]),
        *([] if study.grid or found.empty else _causes(found, shown[:SPOKEN])),
        f"{', '.join([*written, 'study.json', 'report.html'])} written to {folder}",
    ]
    answer = Answer(
        f"Study of {study.scenario}",
        title,
        "\n".join(words),
        {},
        {},
        {"table.csv": Table(table, units)},
        {"versions": cosim.versions()},
        show=lambda: Show([*overview, *shares]),
    )
    report(answer, folder / "report.html")
    unknown = [name for name in study.figures if name not in names]
    if unknown and names:
        raise SetupError(
            f"{study.path}: figures: no run has {unknown[0]!r}, only {', '.join(names)}; "
            f"the table is in {folder}"
        )
    return Outcome(folder, table, units, found, answer.verdict)


def _write(table: pd.DataFrame, path: Path) -> str:
    """Write a CSV file; its name."""
    table.to_csv(partial(path), index=False)
    return partial(path).replace(path).name


def _parquet(table: pd.DataFrame, path: Path) -> list[str]:
    """Write a Parquet file where pyarrow is there; its name."""
    try:
        table.to_parquet(partial(path), index=False)
    except ImportError:
        return []
    return [partial(path).replace(path).name]


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
    last = found[found["kind"] == found["kind"].iloc[-1]].sort_values("value", kind="stable")
    tops = last.groupby("figure").tail(1).set_index("figure")
    return [
        f"{name} depends most on {top['input']}: {top['kind']} = {top['value']:.2f} +- "
        f"{top['confidence']:.2f} of its variance ({top['method']})."
        for name, top in tops.reindex([name for name in shown if name in tops.index]).iterrows()
    ]
