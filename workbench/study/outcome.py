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
from . import table as tables
from .plan import Study, Value
from .sensitivity import analyse

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
    inputs: Sequence[Sequence[Value]],
    rows: Sequence[Mapping[str, Any]],
    units: Mapping[str, str],
    session: Session,
    folder: Path,
) -> Outcome:
    """Write the files of a study whose runs are all done, rows in the order of the runs.

    Raises SetupError, after that, if the study asks for a figure that no run has.
    """
    table, columns = tables.frame(study.varied, inputs, rows)
    written = tables.write(table, folder / "table.csv")
    shown = [
        columns.names[name] for name in study.figures or columns.names if name in columns.names
    ]
    units = {**units, **columns.units}
    found, missing = pd.DataFrame(), dict[str, str]()
    if study.sampling is not None:
        grid, sampled = list(study.grid), list(study.tolerances)
        found, missing = analyse(study.sampling, grid, sampled, shown, table)
        found.to_csv(partial(folder / "sensitivity.csv"), index=False)
        written.append(partial(folder / "sensitivity.csv").replace(folder / "sensitivity.csv").name)
    pictures = {
        "overview.png": show.overview(study, table, shown, units),
        "sensitivity.png": [] if found.empty else show.sensitivity(study, found, units),
    }
    title = f"{study.name}: {study.scenario}, {len(table)} runs"
    written += [
        name for path, drawn in pictures.items() for name in draw(Show(drawn), title, folder / path)
    ]
    counts = Counter(str(row["status"]) for row in rows)
    seconds = [row["seconds"] for row in rows]
    write_json(
        folder / "study.json",
        {
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
        },
    )
    verdict = "\n".join(
        [
            f"{len(rows)} runs, {session.runs} of them now in {session.seconds:.1f} s: "
            + ", ".join(f"{count} {status}" for status, count in counts.most_common())
            + ".",
            *_remarks(rows),
            *(_spread(table, name, units.get(name, "")) for name in shown[:SPOKEN]),
            *_causes(found, study.grid, shown[:SPOKEN]),
            f"{', '.join([*written, 'study.json', 'report.html'])} written to {folder}",
        ]
    )
    answer = Answer(
        f"Study of {study.scenario}",
        title,
        verdict,
        {},
        {},
        {"table.csv": Table(table, units)},
        {"versions": cosim.versions()},
        show=lambda: Show([picture for drawn in pictures.values() for picture in drawn]),
    )
    report(answer, folder / "report.html")
    unknown = [name for name in study.figures if name not in columns.names]
    if unknown and columns.names:
        raise SetupError(
            f"{study.path}: figures: no run has {unknown[0]!r}, only {', '.join(columns.names)}; "
            f"the table is in {folder}"
        )
    return Outcome(folder, table, units, found, verdict)


def _remarks(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How runs failed, what FMUs warned of and which figures were refused: how often, first where."""
    seen: dict[str, list[int]] = {}
    for number, row in enumerate(rows):
        told = [f"{row['status']}: {row['message']}"] * (row["status"] != OK)
        for text in [*told, *(f"warning: {x}" for x in row["warnings"]), *tables.refusals(row)]:
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


def _causes(found: pd.DataFrame, grid: Mapping[str, object], shown: Sequence[str]) -> list[str]:
    """What moves each figure most, where the study has no grid."""
    if grid or found.empty:
        return []
    lines = []
    for name in shown:
        own = found[found["figure"] == name]
        if len(own):
            top = own[own["kind"] == own["kind"].iloc[-1]].nlargest(1, "value").iloc[0]
            lines.append(
                f"{name} depends most on {top['input']}: {top['kind']} = {top['value']:.2f} +- "
                f"{top['confidence']:.2f} of its variance ({top['method']})."
            )
    return lines
