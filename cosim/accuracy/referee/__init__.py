"""Judge a result that another master computed: is it right, how far is it off, and why."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...engine.settings import RunSettings
from ...errors import SetupError, pluralize
from ...series import Series
from ...system import Network, System, connect
from ...units import multiples
from .causes import Cause, not_finite, table_causes
from .connections import DECISIVE_REDUCTION
from .report import RefereeReport
from .signals import SignalJudgement, Verdict, judge_signal
from .solution import ReferenceSolution, SolutionRequest, read_exact, solve_reference
from .table import MatchedColumn, match_columns, read_foreign
from .variants import Reproduction, best_coupling, variant_causes

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
    table = read_foreign(result)
    label = Path(table.label).name
    table, time_cause = _in_seconds(table, stop)
    ports = RunSettings(math.inf, 1.0, start).ports(network)
    exact = None if reference is None else read_exact(Path(reference))
    if exact is not None:
        ports = [port for port in ports if port.name in exact.values.names]
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
    times = table.t[rows]
    request = SolutionRequest(names, times, start, PRECISION * tolerance, step, timeout)
    notes = tuple(_notes(table, matches, rows))
    if exact is not None:
        solution = exact.at(request)
    else:
        try:
            solution = solve_reference(system, request)
        except SetupError as error:
            return RefereeReport(label, Verdict.UNDECIDED, (), (), str(error), tolerance, notes)
    signals = tuple(judge_signal(match, solution, rows, tolerance, step) for match in matches)
    causes = [time_cause] if time_cause else []
    if cause_seconds > 0.0:
        causes += _find_causes(network, signals, solution, request, cause_seconds)
    verdict = _overall(signals, time_cause)
    return RefereeReport(label, verdict, signals, tuple(causes), solution.method, tolerance, notes)


def _overall(signals: Iterable[SignalJudgement], time_cause: Cause | None) -> Verdict:
    verdicts = {signal.verdict for signal in signals}
    if Verdict.DIFFERS in verdicts or time_cause is not None:
        return Verdict.DIFFERS
    return Verdict.UNDECIDED if Verdict.UNDECIDED in verdicts else Verdict.AGREES


def _in_seconds(table: Series, stop: float | None) -> tuple[Series, Cause | None]:
    """The table with its times in s, and the cause if they were in another unit without saying so."""
    if not stop or stop <= 0.0:
        return table, None
    ratio = float(table.t[-1]) / stop
    if 1.0 / TIME_UNIT_DOUBT < ratio < TIME_UNIT_DOUBT:
        return table, None
    for unit, scale in multiples("s").items():
        if scale != 1.0 and abs(ratio * scale - 1.0) <= TIME_UNIT_MARGIN:
            text = f"the times are in {unit}, not in s: the last is {table.t[-1]:g}, not {stop:g}"
            return _with_times(table, scale * table.t), Cause("time unit", text, math.inf, ())
    return table, None


def _with_times(table: Series, times: NDArray[np.float64]) -> Series:
    """The table with other times [s] in its first column."""
    return Series(table.columns, lambda k: table[table.names[k]] if k else times, label=table.label)


def _find_causes(
    network: Network,
    signals: Sequence[SignalJudgement],
    solution: ReferenceSolution,
    request: SolutionRequest,
    seconds: float,
) -> list[Cause]:
    """What explains the signals that differ: each from the table alone, then all that are left by variants."""
    causes: list[Cause] = []
    differing = [signal for signal in signals if signal.verdict is Verdict.DIFFERS]
    references = [(network.port(name), values) for name, values in solution.values.items()]
    unexplained = []
    for signal in differing:
        best = not_finite(signal) or max(
            table_causes(signal, network, references),
            key=lambda cause: cause.reduction,
            default=None,
        )
        if best is None:
            unexplained.append(signal)
        else:
            causes.append(best)
    # What explains a column roughly may be a trace of what explains all columns exactly.
    doubtful = [c for c in causes if c.kind in DOUBTFUL_KINDS or c.reduction < DECISIVE_REDUCTION]
    if not unexplained and not doubtful:
        return causes
    certain = [cause for cause in causes if cause not in doubtful]
    is_approximate = any(cause.reduction < DECISIVE_REDUCTION for cause in doubtful)
    common = _common_cause(
        network, signals, certain, request, seconds, thorough=is_approximate or bool(unexplained)
    )
    if common is not None and all(
        common.reduction > min(cause.reduction, DECISIVE_REDUCTION) for cause in doubtful
    ):
        return [*certain, common]
    if unexplained and doubtful:
        common = _common_cause(network, signals, causes, request, seconds, thorough=True)
    return causes if common is None or not unexplained else [*causes, common]


def _common_cause(
    network: Network,
    signals: Sequence[SignalJudgement],
    explained: Sequence[Cause],
    request: SolutionRequest,
    seconds: float,
    *,
    thorough: bool,
) -> Cause | None:
    """What explains all signals that these causes do not; only a coupling unless the search is thorough."""
    names = {name for cause in explained for name in cause.signals}
    rest = [s for s in signals if s.name not in names and s.verdict is not Verdict.UNDECIDED]
    reproduction = Reproduction(network, rest, request, seconds)
    if not thorough:
        return best_coupling(reproduction, reproduction.system)[1]
    return next(iter(variant_causes(reproduction)), None)


def _notes(
    table: Series,
    matches: Sequence[MatchedColumn],
    rows: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> Iterable[str]:
    """What is not judged."""
    used = {match.column for match in matches}
    rest = [name for name in table.names[1:] if name not in used]
    if rest:
        yield f"not judged: {', '.join(rest)}"
    if ignored := int(np.count_nonzero(~rows)):
        yield f"{pluralize(ignored, 'row')} before the start is not judged"
    if assumed := [m.column for m in matches if not m.stated_unit and m.port.unit not in ("", "1")]:
        yield f"without a unit, taken to be in the FMU's: {', '.join(assumed)}"
