"""Is a column where the reference solution is: how far off it is, from when on, and whether that can be told."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .solution import ReferenceSolution
from .table import Array, MatchedColumn

#: Share of a run for which a difference must stay to count: a convention; a spike of a row is reported, but no reason
#: to reject a result.
LASTING = 0.01
#: Share of the rows within such a time that must differ: differences that oscillate cross zero twice a period.
MAJORITY = 0.5
#: Steps by which a jump may be late: the part in which it happens shows it at the end of its step, and a part that takes
#: this as its input at the end of the next one.
LATE_STEPS = 2
#: Range of a column below which it counts as constant, as a share of its largest value: a thousand times the rounding
#: of results that are printed with twelve digits.
CONSTANT = 1e-9
#: Rounding of a number of rows in a step.
ROUNDING = 1e-6
FIGURES: dict[str, Callable[[Array, Array], float]] = {
    "at the end": lambda _, x: float(x[-1]),
    "smallest": lambda _, x: float(x.min()),
    "largest": lambda _, x: float(x.max()),
    "mean": lambda t, x: float(np.trapezoid(x, t) / (t[-1] - t[0])),
}


class Verdict(StrEnum):
    """What can be said of a result."""

    AGREES = "agrees"
    DIFFERS = "differs"
    UNDECIDED = "cannot be told"


@dataclass(frozen=True)
class FigureComparison:
    """A figure of a column: at the end, smallest, largest or mean over the rows that were compared.

    `error` is that of the reference, `deviation` the value minus the reference, all in the unit of the column.
    """

    name: str
    value: float
    reference: float
    error: float

    @property
    def deviation(self) -> float:
        """By how much the value is too large."""
        return self.value - self.reference


@dataclass(frozen=True)
class SignalJudgement:
    """A column beside the reference solution, in the unit of its variable.

    Attributes
    ----------
    name, column, unit : str
        The variable, what the table calls it, and the unit.
    verdict : Verdict
        Whether it agrees.
    deviation, error, time : float
        The largest difference [unit], the error of the reference there [unit], and when it is [s].
    allowed : float
        The tolerance [unit], to which the error of the reference adds.
    since : float
        From when on it differs [s]; infinite where it does not.
    rows_beyond : int
        How many rows are further off than allowed.
    figures : tuple of FigureComparison
        Of the rows that were compared.
    """

    name: str
    column: str
    unit: str
    verdict: Verdict
    deviation: float
    error: float
    time: float
    allowed: float
    since: float
    rows_beyond: int
    figures: tuple[FigureComparison, ...]
    t: Array = field(repr=False)
    values: Array = field(repr=False)
    reference: Array = field(repr=False)
    errors: Array = field(repr=False)

    @property
    def scale(self) -> float:
        """The range of the reference, or its size where it is constant [unit]."""
        return column_scale(self.reference)


def column_scale(values: Array) -> float:
    """The range of a column, or its largest value where it is constant, or 1 where it is zero."""
    size = float(np.abs(values).max())
    extent = float(np.ptp(values))
    return extent if extent > CONSTANT * size else size or 1.0


def judge_signal(
    match: MatchedColumn,
    solution: ReferenceSolution,
    rows: NDArray[np.bool_],
    tolerance: float,
    step: float | None = None,
) -> SignalJudgement:
    """Compare a column with the reference solution.

    Parameters
    ----------
    match : MatchedColumn
        The column.
    solution : ReferenceSolution
        Its values at the rows that are compared.
    rows : array of bool, shape (rows of the table,)
        Which rows of the table these are.
    tolerance : float
        The difference that is allowed, as a share of the range of the reference.
    step : float, optional
        The communication step [s]; by default the time between rows.
    """
    name, t = match.port.name, solution.time
    values, reference, errors = match.values[rows], solution.values[name], solution.errors[name]
    finite = np.isfinite(values)
    allowed = tolerance * column_scale(reference)
    low, high = _around_events(match, solution, step)
    distance = np.maximum(0.0, np.maximum(values - high, low - values))
    distance = np.where(finite, distance, np.inf)
    beyond = distance > allowed + errors
    since = min([_lasting_since(t, beyond), *t[~finite][:1].tolist()])
    vague = np.count_nonzero(errors > allowed) > LASTING * len(t)
    verdict = Verdict.AGREES if since == math.inf else Verdict.DIFFERS
    if verdict is Verdict.AGREES and vague:
        verdict = Verdict.UNDECIDED
    with np.errstate(invalid="ignore"):
        worst = int(np.argmax(np.where(np.isfinite(errors), distance - errors, distance)))
    figures = tuple(
        FigureComparison(what, take(t, values), take(t, reference), _figure_error(what, t, errors))
        for what, take in FIGURES.items()
    )
    return SignalJudgement(
        name, match.column, match.port.unit, verdict, float(distance[worst]), float(errors[worst]),
        float(t[worst]), allowed, since, int(np.count_nonzero(beyond)), figures, t, values, reference,
        errors,
    )  # fmt: skip


def _figure_error(what: str, t: Array, errors: Array) -> float:
    """The error of a figure from those of the rows: none of these figures moves further than the rows do."""
    if what in ("at the end", "mean"):
        return FIGURES[what](t, errors)
    return float(errors.max())


def _around_events(
    match: MatchedColumn, solution: ReferenceSolution, step: float | None
) -> tuple[Array, Array]:
    """The least and the largest value that a column may have: where it jumps, those of the rows around.

    A master that exchanges values only at its steps shows an event up to LATE_STEPS late.
    """
    x, t = solution.values[match.port.name], solution.time
    held = match.port.type != "Real"
    if not held and not solution.events:
        return x, x
    spacing = float(np.median(np.diff(t)))
    late = LATE_STEPS * max(1, math.ceil((step or spacing) / spacing - ROUNDING))
    near = np.full(len(t), held)
    for event in solution.events:
        k = int(np.searchsorted(t, event))
        near[max(0, k - 1) : k + late + 1] = True
    before, after = np.pad(x, (late, 0), "edge"), np.append(x[1:], x[-1:])
    stack = np.stack([after, *(before[n : n + len(x)] for n in range(late + 1))])
    return np.where(near, stack.min(axis=0), x), np.where(near, stack.max(axis=0), x)


def _lasting_since(t: Array, beyond: NDArray[np.bool_]) -> float:
    """The first time from which on most rows are beyond for LASTING of the run; infinite if there is none."""
    starts = np.flatnonzero(beyond)
    if not len(starts):
        return math.inf
    window = LASTING * (t[-1] - t[0])
    count = np.concatenate([[0], np.cumsum(beyond)])
    stops = np.searchsorted(t, t[starts] + window, "right")
    lasting = count[stops] - count[starts] >= MAJORITY * (stops - starts)
    # At the end of the run the window is cut off: it then reaches back.
    cut = t[starts] + window > t[-1]
    begins = np.searchsorted(t, t[-1] - window, "left")
    lasting[cut] = count[-1] - count[begins] >= MAJORITY * (len(t) - begins)
    return float(t[starts[lasting][0]]) if lasting.any() else math.inf
