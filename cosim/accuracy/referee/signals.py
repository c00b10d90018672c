"""Is a column where the reference solution is: how far off it is, from when on, and whether that can be told."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .solution import Array, ReferenceSolution
from .table import MatchedColumn

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
#: Figures that no row states.
EXTREMES = ("smallest", "largest")


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
    def varies(self) -> bool:
        """Whether the reference is not constant."""
        return varies(self.reference)

    @property
    def scale(self) -> float:
        """The range of the reference, or its size where it is constant, or 1 where it is zero [unit]."""
        return scale_of(self.reference)


def varies(values: Array) -> bool:
    """Whether a column is not constant but for rounding."""
    return bool(np.ptp(values) > CONSTANT * np.abs(values).max())


def scale_of(values: Array) -> float:
    """The range of a column, or its largest value where it is constant, or 1 where it is zero."""
    return float(np.ptp(values) if varies(values) else np.abs(values).max()) or 1.0


def judge_signal(
    match: MatchedColumn,
    solution: ReferenceSolution,
    rows: NDArray[np.bool_],
    tolerance: float,
    step: float | None = None,
) -> SignalJudgement:
    """Compare some rows of a column with the reference solution; `step` [s] is the time between rows unless it is known."""
    port, t, values = match.port, solution.time, match.values[rows]
    reference, errors = solution.values[port.name], solution.errors[port.name]
    allowed = tolerance * scale_of(reference)
    low, high = _around_events(reference, solution, is_held=port.type != "Real", step=step)
    finite = np.isfinite(values)
    distance = np.where(finite, np.maximum(0.0, np.maximum(values - high, low - values)), np.inf)
    beyond = distance > allowed + errors
    since = min([_lasting_since(t, beyond), *t[~finite][:1].tolist()])
    verdict = Verdict.DIFFERS
    if since == math.inf:
        is_vague = np.count_nonzero(errors > allowed) > LASTING * len(t)
        verdict = Verdict.UNDECIDED if is_vague else Verdict.AGREES
    with np.errstate(invalid="ignore"):
        worst = int(np.argmax(np.where(np.isfinite(errors), distance - errors, distance)))
    figures = tuple(
        # no extreme moves further than the rows do
        FigureComparison(what, take(t, values), take(t, reference),
                         float(errors.max()) if what in EXTREMES else take(t, errors))
        for what, take in FIGURES.items()
    )  # fmt: skip
    return SignalJudgement(
        port.name, match.column, port.unit, verdict, float(distance[worst]), float(errors[worst]),
        float(t[worst]), allowed, since, int(np.count_nonzero(beyond)), figures, t, values, reference,
        errors,
    )  # fmt: skip


def _around_events(
    x: Array, solution: ReferenceSolution, *, is_held: bool, step: float | None
) -> tuple[Array, Array]:
    """The least and the largest value that a column may have: where it jumps, those of the rows around.

    A master that exchanges values only at its steps shows an event up to LATE_STEPS late.
    """
    t = solution.time
    spacing = float(np.median(np.diff(t)))
    late = LATE_STEPS * max(1, math.ceil((step or spacing) / spacing - ROUNDING))
    near = np.full(len(t), is_held)
    for k in np.searchsorted(t, solution.events):
        near[max(0, k - 1) : k + late + 1] = True
    padded = np.pad(x, (late, 1), "edge")
    around = np.stack([padded[n : n + len(x)] for n in range(late + 2)])
    return np.where(near, around.min(axis=0), x), np.where(near, around.max(axis=0), x)


def _lasting_since(t: Array, beyond: NDArray[np.bool_]) -> float:
    """The first time from which on most rows are beyond for LASTING of the run; infinite if there is none."""
    window = LASTING * (t[-1] - t[0])
    # At the end of the run the window would be cut off: it then reaches back.
    begins = np.minimum(np.arange(len(t)), np.searchsorted(t, t[-1] - window, "left"))
    ends = np.searchsorted(t, t[begins] + window, "right")
    count = np.concatenate([[0], np.cumsum(beyond)])
    lasting = beyond & (count[ends] - count[begins] >= MAJORITY * (ends - begins))
    return float(t[lasting][0]) if lasting.any() else math.inf
