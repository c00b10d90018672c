"""A table of masters on reference systems: how far each is off, with which order that falls, and why."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from .accuracy.limit import LOWEST_ORDER
from .accuracy.referee import TOLERANCE, RefereeReport, referee
from .describe import table
from .errors import SetupError
from .files import replacement
from .formats.ssp.read import Package, read_ssp
from .json_values import without_infinities
from .scratch import scratch
from .series import Series

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: "quarter_car_0.5ms.csv": system, number, unit of the communication step.
NAME = re.compile(r"(?P<system>.+)_(?P<number>[0-9.]+(?:e[+-]?[0-9]+)?)(?P<unit>s|ms|us)")
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
SUFFIXES = (".csv", ".parquet", ".mat")
#: Longest processor time for the search for the cause of one result [s]. It ends by itself in 1 s to 10 s where a coupling
#: at the known step is the cause; half of this or twice it changes which of several causes at a time are found.
CAUSE_SECONDS = 30.0
#: Steps from one row to the next, and from the last row to the stop time, at most: one, but for the rounding of both.
LATEST = 1.5
#: The verdict of a result that is none.
UNREADABLE = "cannot be read"
#: Differences above so many ranges are called "grows": 10 ranges are no answer to any question.
GROWS = 10.0
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Scoreboard</title><style>
body {{ font: 15px/1.4 sans-serif; max-width: 80em; margin: 2em auto; padding: 0 1em; color: #1f2328 }}
table {{ border-collapse: collapse; margin: 1em 0 }}
td, th {{ text-align: left; vertical-align: top; padding: .3em .8em .3em 0; border-bottom: 1px solid #d0d7de }}
img {{ max-width: 100% }}
</style></head><body><h1>Scoreboard</h1>
<p>The largest difference from the exact answer of any signal at any row, as a share of the signal's range.</p>
{body}
<img alt="difference over step, a panel for each system" src="data:image/png;base64,{picture}">
</body></html>
"""


@dataclass(frozen=True)
class Standing:
    """A master on a system.

    Attributes
    ----------
    master, system : str
        Who, and on what.
    steps, differences : tuple of float
        Communication steps [s], the longest first, and the largest difference with each in ranges of the signal.
    calls : float
        How often a part is stepped in a communication step; 0 where parts are integrated, nan where it is not stated.
    order : float
        With which power of the step the difference falls; nan where that cannot be told.
    verdict, cause : str
        Of the shortest step.
    reason : str
        Why there is no result; "" if there is one.
    """

    master: str
    system: str
    steps: tuple[float, ...] = ()
    differences: tuple[float, ...] = ()
    calls: float = math.nan
    order: float = math.nan
    verdict: str = "not run"
    cause: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Scoreboard:
    """What `scoreboard` found; `notes` are files that are no results, a line for each."""

    standings: tuple[Standing, ...]
    notes: tuple[str, ...] = ()

    @property
    def systems(self) -> list[str]:
        """The systems that somebody entered."""
        return list(dict.fromkeys(s.system for s in self.standings if s.verdict != "not run"))

    def best(self, system: str) -> list[tuple[float, Standing, float]]:
        """For each number of steps of a part in a second: that number, who comes closest with no more, and how close.

        Who integrates parts, or does not say how often it steps them, has no such number.
        """
        points = [
            (s.calls / step, difference, s)
            for s in self.standings
            if s.system == system and s.calls > 0.0
            for step, difference in zip(s.steps, s.differences)
            if difference < GROWS
        ]
        front: list[tuple[float, Standing, float]] = []
        for cost, difference, standing in sorted(points, key=lambda point: point[:2]):
            if not front or difference < front[-1][2]:
                front = [point for point in front if point[0] < cost]
                front.append((cost, standing, difference))
        return front

    def text(self) -> str:
        """A line for each master and system, the best by cost, and what is no result."""
        lines = list(table([HEADINGS, *map(_cells, self.standings)]))
        return "\n".join([*lines, "", *self._best_lines(), *self.notes])

    def _best_lines(self) -> Iterator[str]:
        for system in self.systems:
            found = [
                f"{cost:g}/s {standing.master} ({_share(difference)})"
                for cost, standing, difference in self.best(system)
            ]
            if found:
                yield f"closest on {system} by steps of a part in a second: {', '.join(found)}"

    def to_json(self) -> dict[str, Any]:
        """The scoreboard for programs; a number that is none or infinite is null."""
        best = {
            system: [
                {"steps_of_a_part": cost, "master": s.master, "difference": difference}
                for cost, s, difference in self.best(system)
            ]
            for system in self.systems
        }
        return {
            "standings": [asdict(s) for s in self.standings],
            "best": best,
            "notes": list(self.notes),
        }

    def html(self) -> str:
        """A page that needs nothing else."""
        image = BytesIO()
        self.plot(image)
        rows = [[*_cells(s), _steps_text(s)] for s in self.standings]
        body = _html_table([(*HEADINGS, "All steps"), *rows])
        body += "".join(
            f"<p>{html.escape(line)}</p>" for line in (*self._best_lines(), *self.notes)
        )
        return PAGE.format(body=body, picture=base64.b64encode(image.getvalue()).decode())

    def plot(self, path: Path | str | IO[bytes] | None = None) -> Figure:
        """Plot difference over step, a panel for each system; `path` also writes the picture."""
        from .picture import Picture

        masters = list(dict.fromkeys(s.master for s in self.standings if s.steps))
        columns = max(1, min(3, len(self.systems)))
        rows = max(1, math.ceil(len(self.systems) / columns))
        figure = Picture(figsize=(5.0 * columns, 4.0 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, system in zip(axes, self.systems):
            for s in self.standings:
                if s.system == system and s.steps:
                    k = masters.index(s.master)
                    shown = [d if d < GROWS else math.nan for d in s.differences]
                    style = f"{'os^vD'[k // 10 % 5]}{('-', '--', ':')[k // 10 % 3]}"
                    axis.loglog(
                        s.steps, shown, style, color=f"C{k % 10}", markersize=3, label=s.master
                    )
            axis.set(
                title=system, xlabel="communication step / s", ylabel="largest difference / range"
            )
            axis.grid(alpha=0.3)
        for axis in axes[len(self.systems) :]:
            axis.axis("off")
        lines = {line.get_label(): line for axis in axes for line in axis.get_lines()}
        if lines:
            figure.legend(
                lines.values(), lines.keys(), loc="outside lower center", ncols=3, fontsize="small"
            )
        if path is not None:
            figure.savefig(path, dpi=110)
        return figure

    def write(self, path: Path | str) -> None:
        """Write a .txt, .json, a page .html, or a picture .png, .svg or .pdf; raises SetupError for another suffix."""
        path = Path(path)
        write = writer(path)
        with replacement(path) as fresh:
            write(self, fresh)


HEADINGS = ("Master", "System", "Step", "Off by", "Order", "Verdict", "Cause")
WRITERS: dict[str, Callable[[Scoreboard, Path], object]] = {
    ".txt": lambda board, path: path.write_text(board.text() + "\n", encoding="utf-8"),
    ".json": lambda board, path: path.write_text(
        json.dumps(without_infinities(board.to_json()), indent=2) + "\n", encoding="utf-8"
    ),
    ".html": lambda board, path: path.write_text(board.html(), encoding="utf-8"),
    ".png": lambda board, path: board.plot(path),
    ".svg": lambda board, path: board.plot(path),
    ".pdf": lambda board, path: board.plot(path),
}


def writer(path: Path) -> Callable[[Scoreboard, Path], object]:
    """What writes a file of this suffix; raises SetupError for one that is not known."""
    if path.suffix not in WRITERS:
        raise SetupError(f"{path} must end in one of {', '.join(WRITERS)}")
    return WRITERS[path.suffix]


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
    systems = {
        p.parent.name: p
        for p in sorted(folder.glob("*/*_ref.csv"))
        if p.stem == f"{p.parent.name}_ref"
    }
    if not systems:
        raise SetupError(f"{folder} has no reference system: NAME/NAME.ssp with NAME/NAME_ref.csv")
    results = folder / "results"
    masters = sorted(p for p in results.glob("*") if p.is_dir() and any(p.iterdir()))
    if not masters:
        raise SetupError(
            f"{results} has no results: write {results}/MASTER/{next(iter(systems))}_1ms.csv"
        )
    notes: list[str] = []
    entries = [
        (master, _files(master, systems, notes), _facts(master, notes)) for master in masters
    ]
    standings = [
        Standing(str(facts.get("title", master.name)), "all", reason=str(facts["not_run"]))
        for master, _, facts in entries
        if "not_run" in facts
    ]
    with TemporaryDirectory(dir=scratch()) as unpacked:
        for name, reference in systems.items():
            package: Package | None = None
            ranges: dict[str, float] = {}
            for master, files, facts in entries:
                title = (
                    " ".join(str(facts[k]) for k in ("title", "version") if k in facts)
                    or master.name
                )
                mine = files.get(name, {})
                if not mine:
                    if name in facts.get("failed", {}):
                        reason = str(facts["failed"][name])
                        standings.append(Standing(title, name, verdict="fails", reason=reason))
                    continue
                if package is None:
                    package = read_ssp(reference.with_name(f"{name}.ssp"), Path(unpacked) / name)
                    rows = Series.read(reference)
                    ranges = {n: float(np.ptp(rows.numbers(n))) or 1.0 for n in rows.names[1:]}
                judge = _Judge(package, reference, ranges, tolerance, cause_seconds)
                standings.append(
                    judge.standing(
                        Standing(title, name, calls=float(facts.get("calls", math.nan))), mine
                    )
                )
                progress("  ".join(_cells(standings[-1])))
    return Scoreboard(tuple(standings), tuple(notes))


def _files(
    master: Path, systems: Mapping[str, Path], notes: list[str]
) -> dict[str, dict[float, Path]]:
    """The results of a master by system and step [s]; other files get a note."""
    found: dict[str, dict[float, Path]] = {}
    for path in sorted(p for p in master.iterdir() if p.name != "master.json"):
        match = NAME.fullmatch(path.stem)
        try:
            step = float(match["number"]) * UNITS[match["unit"]] if match else 0.0
        except ValueError:
            step = 0.0
        if path.suffix == ".json" and any(path.with_suffix(s).is_file() for s in SUFFIXES):
            continue
        if match is None or not step > 0.0 or path.suffix not in SUFFIXES:
            notes.append(
                f"{path} is no result: its name must read SYSTEM_STEP.csv, as in {next(iter(systems))}_1ms.csv"
            )
        elif match["system"] not in systems:
            notes.append(f"{path} is of no system here: {', '.join(systems)}")
        else:
            found.setdefault(match["system"], {})[step] = path
    return found


def _facts(master: Path, notes: list[str]) -> dict[str, Any]:
    """What master.json states; a note where it cannot be read."""
    path = master / "master.json"
    if not path.is_file():
        return {}
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        calls = facts.get("calls", 0.0)
        if not (isinstance(calls, int | float) and calls >= 0.0):
            raise ValueError(f"calls = {calls!r} must be a number from 0 on")
        if not isinstance(facts.get("failed", {}), dict):
            raise TypeError("failed must be a mapping of system to reason")
    except (ValueError, TypeError, AttributeError) as error:
        notes.append(f"{path} is ignored: {error or 'it must be a mapping'}")
        return {}
    return dict(facts)


@dataclass(frozen=True)
class _Judge:
    """Judges results on one system."""

    package: Package
    reference: Path
    ranges: Mapping[str, float]
    tolerance: float
    cause_seconds: float

    def report(self, path: Path, step: float, seconds: float) -> RefereeReport:
        return referee(
            self.package.system, path, stop=self.package.stop, step=step, reference=self.reference,
            tolerance=self.tolerance, cause_seconds=seconds,
        )  # fmt: skip

    def require_whole(self, report: RefereeReport, path: Path, step: float) -> None:
        """Raise SetupError if a result lacks a column, its end, or the rows of its steps."""
        if missing := self.ranges.keys() - {s.name for s in report.signals}:
            raise SetupError(f"{path} has no column {', '.join(sorted(missing))}")
        t, stop = report.signals[0].t, self.package.stop
        if stop is not None and t[-1] < stop - LATEST * step:
            raise SetupError(f"{path} ends at {t[-1]:g} s, not at {stop:g} s")
        if (apart := float(np.diff(t).max())) > LATEST * step:
            raise SetupError(
                f"{path} has rows {apart:g} s apart, and a step of {step:g} s in its name"
            )

    def standing(self, entry: Standing, files: Mapping[float, Path]) -> Standing:
        """The entry with what its results, by step [s], are."""
        steps = sorted(files, reverse=True)
        differences: list[float] = []
        for step in steps:
            seconds = self.cause_seconds if step == steps[-1] else 0.0
            try:
                report = self.report(files[step], step, seconds)
                self.require_whole(report, files[step], step)
            except SetupError as error:
                return Standing(
                    entry.master,
                    entry.system,
                    calls=entry.calls,
                    verdict=UNREADABLE,
                    reason=str(error),
                )
            differences.append(max(s.deviation / self.ranges[s.name] for s in report.signals))
        finest = {report.explained(s.name) for s in report.signals} - {None}
        causes = [
            cause.text if cause.is_certain else f"not certain: {cause.text}"
            for cause in report.causes
            if cause in finest or not cause.signals
        ]
        return Standing(
            entry.master, entry.system, tuple(steps), tuple(differences), entry.calls,
            _order(steps, differences), str(report.verdict), "; ".join(causes),
        )  # fmt: skip


def _order(steps: Sequence[float], differences: Sequence[float]) -> float:
    """The order between the two shortest steps; nan for one step, or where the difference does not fall."""
    pairs = [(h, d) for h, d in zip(steps, differences) if 0.0 < d < GROWS][-2:]
    if len(pairs) == 1 or not pairs or pairs[-1][0] != steps[-1]:
        return math.nan
    (coarse, before), (fine, after) = pairs
    order = math.log(before / after) / math.log(coarse / fine)
    return order if order >= LOWEST_ORDER else math.nan


def _share(difference: float) -> str:
    if not math.isfinite(difference):
        return "no number"
    return f"{100.0 * difference:.2g} %" if difference < GROWS else "grows"


def _cells(s: Standing) -> tuple[str, ...]:
    if not s.steps:
        return s.master, s.system, "", "", "", s.verdict, s.reason
    order = f"{s.order:.1f}" if math.isfinite(s.order) else ""
    return (
        s.master,
        s.system,
        f"{1e3 * s.steps[-1]:g} ms",
        _share(s.differences[-1]),
        order,
        s.verdict,
        s.cause,
    )


def _steps_text(s: Standing) -> str:
    return ", ".join(f"{1e3 * h:g} ms: {_share(d)}" for h, d in zip(s.steps, s.differences))


def _html_table(rows: Sequence[Sequence[str]]) -> str:
    lines = [
        "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
        for row, tag in zip(rows, ("th", *("td" for _ in rows)))
    ]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"
