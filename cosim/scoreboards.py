"""Judge the results of many masters in a folder of reference systems."""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from .accuracy.limit import LOWEST_ORDER
from .accuracy.referee import TOLERANCE, RefereeReport, referee
from .errors import RunError, SetupError
from .formats.ssp.read import Package, read_ssp
from .scratch import scratch
from .series import Series
from .standings import GROWS, NO_RESULT, Scoreboard, Standing
from .units import multiples

#: "quarter_car_0.5ms.csv": system, number, unit of the communication step.
NAME = re.compile(r"(?P<system>.+)_(?P<number>[0-9.]+(?:e[+-]?[0-9]+)?)(?P<unit>s|ms|us)")
SUFFIXES = (".csv", ".parquet", ".mat")
#: Longest processor time for the search for the cause of one result [s]. It ends by itself in 1 s to 10 s where a coupling
#: at the known step is the cause; half of this or twice it changes which of several causes at a time are found.
CAUSE_SECONDS = 30.0
#: Steps from one row to the next, and from the last row to the stop time, at most: one, but for the rounding of both.
LATEST = 1.5
#: Letters of a text that a master states, at most. A convention: it fits into a cell.
MOST_LETTERS = 300
#: How a file of a master may fail, which ends no scoreboard of all.
UNFIT = (
    SetupError, RunError, ValueError, TypeError, LookupError, ArithmeticError, RecursionError, MemoryError, OSError,
)  # fmt: skip
#: The verdict of a result that is none.
UNREADABLE = "cannot be read"


def scoreboard(
    folder: Path | str,
    *,
    tolerance: float = TOLERANCE,
    cause_seconds: float = CAUSE_SECONDS,
    progress: Callable[[str], object] = lambda _: None,
) -> Scoreboard:
    """Judge the results of any number of masters on reference systems.

    Parameters
    ----------
    folder : path
        It has a folder for each system, NAME with NAME.ssp, NAME_ref.csv and NAME_ref_error.csv, and the results
        in results/MASTER/NAME_1ms.csv, by master, system and communication step. A file results/MASTER/master.json
        may state `title`, `version`, `calls` in a step, `failed`, a mapping of system to reason, and `not_run`, the reason
        why there are no results at all.
    tolerance : float
        The difference that is allowed, as a share of the range of a signal.
    cause_seconds : float
        The longest processor time for the search for the cause of one result [s]; 0 for none.
    progress : callable
        Called with a line when a master has been judged on a system.

    Returns
    -------
    Scoreboard
        Verdict and cause are those of the shortest step.

    Raises
    ------
    SetupError
        If the folder has no reference system, or no results.
    """
    folder = Path(folder)
    found = sorted(folder.glob("*/*_ref.csv"))
    systems = {p.parent.name: p for p in found if p.stem == f"{p.parent.name}_ref"}
    if not systems:
        raise SetupError(f"{folder} has no reference system: NAME/NAME.ssp with NAME/NAME_ref.csv")
    results = folder / "results"
    masters = sorted(p for p in results.glob("*") if p.is_dir() and any(p.iterdir()))
    if not masters:
        raise SetupError(
            f"{results} has no results: write {results}/MASTER/{next(iter(systems))}_1ms.csv"
        )
    notes: list[str] = []
    standings: list[Standing] = []
    entries = []
    for master in masters:
        facts, files = _facts(master, notes), _files(master, systems, notes)
        name = " ".join(str(facts[k]) for k in ("title", "version") if k in facts)
        entries.append((name or master.name, facts, files))
        if "not_run" in facts:
            title = str(facts.get("title", master.name))
            standings.append(Standing(title, "all", reason=str(facts["not_run"])))
    for system, reference in systems.items():
        before = len(standings)
        with TemporaryDirectory(dir=scratch()) as unpacked:
            judge = None
            for name, facts, files in entries:
                if files[system]:
                    judge = judge or _Judge(reference, Path(unpacked), tolerance, cause_seconds)
                    entry = Standing(name, system, calls=float(facts.get("calls", math.nan)))
                    standings.append(judge.standing(entry, files[system]))
                    progress("  ".join(standings[-1].cells()))
                elif reason := facts.get("failed", {}).get(system):
                    standings.append(
                        Standing(name, system, verdict="fails", reason=str(reason)[:MOST_LETTERS])
                    )
        if len(standings) == before:
            reason = f"there is no {results}/MASTER/{system}_1ms.csv"
            standings.append(Standing("", system, verdict=NO_RESULT, reason=reason))
    return Scoreboard(tuple(standings), tuple(notes))


def _files(
    master: Path, systems: Mapping[str, Path], notes: list[str]
) -> Mapping[str, dict[float, Path]]:
    """The results of a master by system and step [s]; other files get a note."""
    found: dict[str, dict[float, Path]] = defaultdict(dict)
    for path in sorted(p for p in master.iterdir() if p.name != "master.json"):
        match = NAME.fullmatch(path.stem)
        try:
            step = float(match["number"]) * multiples("s")[match["unit"]] if match else 0.0
        except (ValueError, OverflowError):
            step = 0.0
        if path.suffix == ".json" and any(path.with_suffix(s).is_file() for s in SUFFIXES):
            continue
        if match is None or not 0.0 < step < math.inf or path.suffix not in SUFFIXES:
            notes.append(
                f"{path} is no result: its name must read SYSTEM_STEP.csv, as in {next(iter(systems))}_1ms.csv"
            )
        elif match["system"] not in systems:
            notes.append(f"{path} is of no system here: {', '.join(systems)}")
        elif step in found[match["system"]]:
            notes.append(f"{path} has the step of {found[match['system']][step]} and is left out")
        else:
            found[match["system"]][step] = path
    return found


def _facts(master: Path, notes: list[str]) -> dict[str, Any]:
    """What master.json states; a note where it cannot be read."""
    path = master / "master.json"
    if not path.is_file():
        return {}
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        calls = facts.get("calls", 0.0)
        if (
            not isinstance(calls, int | float)
            or not 0.0 <= calls < math.inf
            or isinstance(calls, bool)
        ):
            raise ValueError(f"calls = {calls!r} must be a number from 0 on")
        if not isinstance(facts.get("failed", {}), dict):
            raise TypeError("failed must be a mapping of system to reason")
        for key in ("title", "version", "not_run"):
            text = facts.get(key, "")
            if not isinstance(text, str) or len(text) > MOST_LETTERS:
                raise TypeError(f"{key} must be a text of at most {MOST_LETTERS} letters")
    except (ValueError, TypeError, AttributeError, RecursionError, OverflowError, OSError) as error:
        reason = str(error) or "it must be a mapping"
        notes.append(f"{path} is ignored: {reason[:MOST_LETTERS]}")
        return {}
    return dict(facts)


class _Judge:
    """Judges results on one system, whose package is unpacked into a folder."""

    def __init__(
        self, reference: Path, folder: Path, tolerance: float, cause_seconds: float
    ) -> None:
        self.reference, self.tolerance, self.cause_seconds = reference, tolerance, cause_seconds
        self.package: Package = read_ssp(
            reference.with_name(f"{reference.parent.name}.ssp"), folder
        )
        rows = Series.read(reference)
        self.ranges = {n: float(np.ptp(rows.numbers(n))) or 1.0 for n in rows.names[1:]}

    def report(self, path: Path, step: float, seconds: float) -> RefereeReport:
        """The report on a result; raises SetupError if it lacks a column, its end, or the rows of its steps."""
        stop = self.package.stop
        report = referee(
            self.package.system, path, stop=stop, step=step, reference=self.reference,
            tolerance=self.tolerance, cause_seconds=seconds,
        )  # fmt: skip
        if missing := self.ranges.keys() - {s.name for s in report.signals}:
            raise SetupError(f"{path} has no column {', '.join(sorted(missing))}")
        t = report.signals[0].t
        if stop is not None and t[-1] < stop - LATEST * step:
            raise SetupError(f"{path} ends at {t[-1]:g} s, not at {stop:g} s")
        if (apart := float(np.diff(t).max())) > LATEST * step:
            raise SetupError(
                f"{path} has rows {apart:g} s apart, and a step of {step:g} s in its name"
            )
        return report

    def standing(self, entry: Standing, files: Mapping[float, Path]) -> Standing:
        """The entry with what its results, by step [s], are."""
        steps = sorted(files, reverse=True)
        try:
            reports = [
                self.report(files[step], step, self.cause_seconds if step == steps[-1] else 0.0)
                for step in steps
            ]
        except UNFIT as error:
            reason = (
                str(error) if isinstance(error, SetupError) else f"{type(error).__name__}: {error}"
            )
            return replace(entry, verdict=UNREADABLE, reason=reason[:MOST_LETTERS])
        differences = [max(s.deviation / self.ranges[s.name] for s in r.signals) for r in reports]
        last = reports[-1]
        used = {last.explained(s.name) for s in last.signals}
        causes = [
            cause.text if cause.is_certain else f"not certain: {cause.text}"
            for cause in last.causes
            if cause in used or not cause.signals
        ]
        return replace(
            entry, steps=tuple(steps), differences=tuple(differences),
            order=_order(steps, differences), verdict=str(last.verdict), cause="; ".join(causes),
        )  # fmt: skip


def _order(steps: Sequence[float], differences: Sequence[float]) -> float:
    """The order between the two shortest steps; nan for one step, or where the difference does not fall."""
    pairs = [(h, d) for h, d in zip(steps, differences) if 0.0 < d < GROWS][-2:]
    if len(pairs) == 1 or not pairs or pairs[-1][0] != steps[-1]:
        return math.nan
    (coarse, before), (fine, after) = pairs
    order = math.log(before / after) / math.log(coarse / fine)
    return order if order >= LOWEST_ORDER else math.nan
