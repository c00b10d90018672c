"""An input over time on its way into a running part."""

from __future__ import annotations

import ctypes
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import NonFiniteValueError
from ..fmu.buffers import Slot, address
from ..fmu.operations import NOT_FINITE, Code, COperation, Operation
from ..system.inputs import FunctionInput, TableInput

Array = NDArray[np.float64]
#: Times by which an input may move within two steps more than their means move before, after and across them. A jump
#: gives 1, a line 2, a pulse as short as a step infinity. With half of it noise of ten rows in a step is refused in all
#: of 25 runs of 400 steps, with it in none; with twice of it a sine whose period is 0.95 steps
#: is not seen.
UNRESOLVED = 16.0
#: Steps before and after two whose means are compared. Measured as above, with noise of ten rows in a step: with half
#: of them it is refused in 14 of 25 runs, with twice as many in none, but then a pulse ten steps from a jump is not seen.
BESIDE = 8
#: Share of the largest value below which a difference is rounding of a table that is written with six digits.
LEAST_CHANGE = 1e-6
#: Points of a function in a step, and most of all points; the golden ratio sets them so that no period divides them.
POINTS = 16
MOST_POINTS = 1 << 16
NOWHERE = np.zeros(0)
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


class InputSource(Operation):
    """A Real input that follows a table or a function: `cell` holds its mean over the last step, `slot` is the same by name."""

    def __init__(self, name: str, profile: TableInput | FunctionInput, t: float) -> None:
        self.name, self.profile = name, profile
        self.cell = (ctypes.c_double * 1)(float(profile.at(t)))
        self.slot = Slot(name, self.cell, 0)

    def __call__(self, t: float, h: float) -> None:
        """Take the mean over the step from t by h [s]; raises NonFiniteValueError."""
        self.cell[0] = self.profile.mean(t, h)
        if not math.isfinite(self.cell[0]):
            self.answered(t, h, NOT_FINITE)

    def c_operation(self) -> COperation:
        """The means stand in a list, which is laid out with the steps."""
        return COperation(Code.FEED, checked=1, cells=address(self.cell))

    def answered(self, t: float, h: float, status: int) -> None:
        """Raise NonFiniteValueError with the mean that is not finite."""
        value = self.cell[0]
        raise NonFiniteValueError(f"{self.name} = {value!r} at t = {t!r} s must be a finite number")

    def taylor(self, begin: float, h: float) -> list[float]:
        """Coefficients of the line with the mean and the rise of the step from `begin` by h [s]."""
        self(begin, h)
        slope = self.profile.rise(begin, h) / h
        return [self.cell[0] - 0.5 * slope * h, slope]


class HiddenChange(NamedTuple):
    """By how much an input changes within two steps, unseen by their means, and when they begin [s]."""

    size: float
    time: float


class StepRanges(NamedTuple):
    """Of an input the mean that a part gets, the least and the largest value in each step, shape (steps,) each."""

    means: Array
    lows: Array
    highs: Array


def largest_change_within_steps(
    profile: TableInput | FunctionInput, times: Array, exact: Array = NOWHERE
) -> HiddenChange:
    """The largest change of an input within steps that their means do not show, of size 0 if there is none.

    A part gets the mean of its input over a step. Where the input moves within two steps by far more than the means
    move before, after and across them, it has a period or a pulse that no run with these steps shows, or that runs with
    this step, twice and four times it show at times which depend on where in a step the pulse is: differences of the
    runs may then vanish while all are off by the same shift in time. Two steps are looked at, since a pulse as short as
    one may lie in both.

    Parameters
    ----------
    profile : TableInput or FunctionInput
        The input.
    times : array of shape (steps + 1,)
        When the steps begin, and the end [s].
    exact : array
        Times [s] of jumps at which steps of all runs begin, so that none of them is wrong about it.
    """
    if isinstance(profile, TableInput):
        means, lows, highs = _table_ranges(profile, times)
    else:
        means, lows, highs = _function_ranges(profile, times)
    size = max(float(np.abs(lows).max()), float(np.abs(highs).max()))
    second = np.minimum(np.arange(len(means)) + 1, len(means) - 1)
    together = np.maximum(highs, highs[second]) - np.minimum(lows, lows[second])
    apart = np.maximum(highs - lows, (highs - lows)[second])
    within = np.where(np.isin(times[1:], exact), apart, together)
    ends = [(float(profile.at(float(times[k]))),) * (BESIDE + 2) for k in (0, -1)]
    padded = np.concatenate([ends[0], means, ends[1]])
    moves = np.lib.stride_tricks.sliding_window_view(np.abs(np.diff(padded)), BESIDE).max(axis=1)
    first = np.arange(len(means))
    across = np.abs(padded[first + BESIDE + 4] - padded[first + BESIDE + 1])
    beside = np.maximum(across, np.maximum(moves[first + 1], moves[first + BESIDE + 4]))
    unseen = (within > UNRESOLVED * beside) & (within > LEAST_CHANGE * size)
    if not unseen.any():
        return HiddenChange(0.0, math.nan)
    k = int(np.argmax(np.where(unseen, within, 0.0)))
    return HiddenChange(float(within[k]), float(times[k]))


def _table_ranges(table: TableInput, times: Array) -> StepRanges:
    """Those of a table."""
    knots, values = np.array(table.times), np.array(table.values, dtype=np.float64)
    inside = (knots > times[0]) & (knots < times[-1])
    points = np.unique(np.concatenate([times, knots[inside]]))
    middles = 0.5 * (points[1:] + points[:-1])
    row = np.clip(np.searchsorted(knots, middles, side="right") - 1, 0, len(knots) - 1)
    after = np.minimum(row + 1, len(knots) - 1)
    begin = end = values[row]
    if not table.held:
        width = knots[after] - knots[row]
        with np.errstate(all="ignore"):
            slope = np.where(width > 0.0, (values[after] - values[row]) / width, 0.0)
        slope = np.where(np.isfinite(slope), slope, 0.0)
        begin, end = (values[row] + slope * (t - knots[row]) for t in (points[:-1], points[1:]))
    first = np.searchsorted(points, times[:-1])
    integral = np.add.reduceat(0.5 * (begin + end) * np.diff(points), first)
    lows = np.minimum.reduceat(np.minimum(begin, end), first)
    highs = np.maximum.reduceat(np.maximum(begin, end), first)
    return StepRanges(integral / np.diff(times), lows, highs)


def _function_ranges(profile: FunctionInput, times: Array) -> StepRanges:
    """Those of a function, as far as its points show them."""
    steps = np.diff(times)
    count = max(2, min(POINTS, MOST_POINTS // len(steps)))
    shares = np.modf(GOLDEN * np.arange(1, len(steps) * count + 1))[0].reshape(-1, count)
    points = times[:-1, None] + steps[:, None] * shares
    values = np.array([float(profile.at(t)) for t in points.ravel().tolist()]).reshape(points.shape)
    means = np.array([profile.mean(t, h) for t, h in zip(times[:-1].tolist(), steps.tolist())])
    return StepRanges(means, values.min(axis=1), values.max(axis=1))
