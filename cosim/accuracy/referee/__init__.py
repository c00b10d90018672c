"""Judge a result that another master computed: is it right, how far is it off, and why."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...engine.settings import RunSettings
from ...errors import SetupError, pluralize
from ...series import Series
from ...system import Network, System, connect
from ...units import multiples
from .causes import DECISIVE_REDUCTION, Cause, table_causes
from .report import RefereeReport
from .search import CauseSearch, coupling_causes, find_causes
from .signals import SignalJudgement, Verdict, judge_signal
from .solution import ReferenceSolution, Request, exact_rows, solve_reference
from .table import MatchedColumn, match_columns, read_foreign

if TYPE_CHECKING:
    from .table import Source

#: Difference that is allowed, as a share of the range of a signal: a convention, that of the FMI cross-check's users.
TOLERANCE = 0.01
#: Share of the tolerance that the reference solution aims at: a quarter leaves room for the difference itself.
PRECISION = 0.25
#: Longest real time for an integration [s]: a convention.
TIMEOUT = 120.0
#: Longest processor time for the search for causes [s]: a convention.
CAUSE_SECONDS = 120.0
#: Causes that a coupling can have, too. It is named in their place where it explains more.
DOUBTFUL_KINDS = ("delay", "offset", "missed event")
#: How far the ratio of the table's last time to the expected one may be from that of two units of time.
TIME_UNIT_MARGIN = 0.02
#: A ratio of last times from which on the unit of time is in doubt: a result of a run cut short is not as far off.
TIME_UNIT_DOUBT = 30.0

__all__ = [
    "Cause", "RefereeReport", "SignalJudgement", "Verdict", "referee",
]  # fmt: skip


def referee(
    system: System,
    result: Source,
    *,
    columns: Mapping[str, str] | None = None,
    start: float = 0.0,
    stop: float | None = None,
    step: float | None = None,
    reference: Path | str | None = None,
    tolerance: float = TOLERANCE,
    timeout: float = TIMEOUT,
    cause_seconds: float = CAUSE_SECONDS,
) -> RefereeReport:
    """Judge a result of another master: how far each column is off, from when on, and why.

    The reference solution is computed at the times of the result: the model-exchange sides of all parts,
    integrated as one system, or, where a part has none, runs with ever smaller steps. A signal differs where
    `|result - reference| > error of the reference + tolerance * range` for 1 % of the run. Then causes are
    reproduced: units, crossed columns, delays, inputs that are held over steps, start values, wires, factors and
    changes that are lost or crossed. One is named only if it makes the difference ten times smaller.

    Parameters
    ----------
    system : System
        What the other master was to simulate.
    result : Result, pandas frame or path
        What it wrote: .csv, .parquet, or .mat of a Modelica tool.
    columns : mapping of str to str, optional
        Variables whose column has another name: "motor.tau": "M * 0.73:N.m". By default, columns are the
        outputs that their names, without what masters add, end with.
    start : float
        When the simulation began [s].
    stop : float, optional
        When it was to end [s]; only needed to notice that the times of the result are in another unit.
    step : float, optional
        The communication step of the other master [s], if it is known; else several are tried.
    reference : path, optional
        Rows that are known to be right, NAME.csv, with their errors in NAME_error.csv beside it, in place of a
        solution that is computed here. Only their columns are judged.
    tolerance : float
        The difference that is allowed, as a share of the range of a signal.
    timeout : float
        The longest real time for an integration [s].
    cause_seconds : float
        The longest processor time for the search for causes [s]; 0 for none.

    Returns
    -------
    RefereeReport
        Verdict, signals, figures and causes.

    Raises
    ------
    SetupError
        If the result cannot be read or has no column of the system, and for settings that cannot be.
    """
    if not 0.0 < tolerance < 1.0:
        raise SetupError(f"tolerance = {tolerance!r} must be above 0 and below 1")
    for name, seconds in (("step", step), ("timeout", timeout)):
        if seconds is not None and not seconds > 0.0:
            raise SetupError(f"{name} = {seconds!r} s must be above 0")
    network = connect(system)
    table, timeless = read_foreign(result)
    label = Path(table.label).name
    table, time_cause = _in_seconds(table, stop)
    ports = RunSettings(math.inf, 1.0, start).ports(network)
    if reference is not None:
        known = Series.read(reference).names
        ports = [port for port in ports if port.name in known]
    matches = match_columns(table, network, ports, columns or {})
    if not matches:
        raise SetupError(
            f"{table.label} has no column of the system: it has {', '.join(table.names[1:])}, the system "
            f"has {', '.join(port.name for port in ports)}; give --map NAME=COLUMN"
        )
    rows = table.t >= start
    if np.count_nonzero(rows) <= 1 or table.t[-1] <= start:
        raise SetupError(
            f"{table.label} ends at {table.t[-1]:g} s: it has no rows after {start:g} s"
        )
    names = [port.name for port in ports]
    request = Request(
        names, table.t[rows], start, PRECISION * tolerance, step, timeout, table.breaks[:, 0]
    )
    notes = tuple(_notes(table, matches, rows, timeless))
    if reference is not None:
        solution = exact_rows(reference, request)
    else:
        try:
            solution = solve_reference(network, request)
        except SetupError as error:
            return RefereeReport(label, Verdict.UNDECIDED, (), (), str(error), tolerance, notes)
    signals = tuple(judge_signal(match, solution, rows, tolerance, step) for match in matches)
    causes = [time_cause] if time_cause else []
    if cause_seconds > 0.0:
        causes += _find_causes(network, signals, solution, request, cause_seconds)
    verdicts = {signal.verdict for signal in signals}
    verdict = next(
        (v for v in (Verdict.DIFFERS, Verdict.UNDECIDED) if v in verdicts), Verdict.AGREES
    )
    verdict = Verdict.DIFFERS if time_cause else verdict
    return RefereeReport(label, verdict, signals, tuple(causes), solution.method, tolerance, notes)


def _in_seconds(table: Series, stop: float | None) -> tuple[Series, Cause | None]:
    """The table with its times in s, and the cause if they were in another unit without saying so."""
    ratio = table.t[-1] / stop if stop and stop > 0.0 else 1.0
    fits = [
        (unit, scale)
        for unit, scale in multiples("s").items()
        if abs(ratio * scale - 1.0) <= TIME_UNIT_MARGIN
    ]
    if 1.0 / TIME_UNIT_DOUBT < ratio < TIME_UNIT_DOUBT or not fits:
        return table, None
    ((unit, scale),) = fits
    times = scale * table.t
    text = f"the times are in {unit}, not in s: the last is {table.t[-1]:g}, not {stop:g}"
    in_seconds = table.with_columns_from(lambda k: table.load(k) if k else times)
    in_seconds.breaks = scale * table.breaks
    return in_seconds, Cause("time unit", text, math.inf, ())


def _find_causes(
    network: Network,
    signals: Sequence[SignalJudgement],
    solution: ReferenceSolution,
    request: Request,
    seconds: float,
) -> list[Cause]:
    """What explains the signals that differ: each from the table alone, then all that are left by variants."""
    causes: list[Cause] = []
    unexplained = False
    for signal in signals:
        if signal.verdict is Verdict.DIFFERS:
            found = table_causes(signal, network, solution.values)
            best = max(found, key=lambda cause: cause.reduction, default=None)
            causes += [] if best is None else [best]
            unexplained = unexplained or best is None
    # What explains a column roughly may be a trace of what explains all columns exactly.
    doubtful = [c for c in causes if c.kind in DOUBTFUL_KINDS or c.reduction < DECISIVE_REDUCTION]
    certain = [cause for cause in causes if cause not in doubtful]
    if not unexplained and not doubtful:
        return causes

    def common(explained: Sequence[Cause], *, thorough: bool) -> Cause | None:
        """What explains all signals that these causes do not; only a coupling unless it is thorough."""
        names = {name for cause in explained for name in cause.signals}
        rest = [s for s in signals if s.name not in names and s.verdict is not Verdict.UNDECIDED]
        search = CauseSearch(network, rest, request, seconds)
        return next(iter(find_causes(search) if thorough else coupling_causes(search)), None)

    is_rough = any(cause.reduction < DECISIVE_REDUCTION for cause in doubtful)
    one = common(certain, thorough=is_rough or unexplained)
    if one and all(one.reduction > min(c.reduction, DECISIVE_REDUCTION) for c in doubtful):
        return [*certain, one]
    if unexplained and doubtful:
        one = common(causes, thorough=True)
    return [*causes, one] if one and unexplained else causes


def _notes(
    table: Series,
    matches: Sequence[MatchedColumn],
    rows: np.ndarray[tuple[int], np.dtype[np.bool_]],
    timeless: int,
) -> Iterable[str]:
    """What is not judged, of which are so many rows without a time."""
    used = {match.column for match in matches}
    rest = [name for name in table.names[1:] if name not in used]
    if rest:
        yield f"not judged: {', '.join(rest)}"
    if ignored := int(np.count_nonzero(~rows)):
        yield f"{pluralize(ignored, 'row')} before the start is not judged"
    if timeless:
        yield f"{pluralize(timeless, 'row')} without a time at the end: not judged"
    if assumed := [m.column for m in matches if not m.stated_unit and m.port.unit not in ("", "1")]:
        yield f"without a unit, taken to be in the FMU's: {', '.join(assumed)}"
