"""How a metric of one column gets its error: from three runs, from the band of the solution, from the rows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..dense import DenseSolution, Side
from ..metrics import Metric
from .estimate import Estimate
from .limit import CONFIRMED_FACTOR, UNCONFIRMED_FACTOR, limit
from .three_runs import ColumnRuns

#: Every second and every third row are left: convention, the smallest numbers without a common factor.
THINNED = (2, 3)
#: Orders between which a number may depend on the spacing of the rows. Derived: the time of a row is known to
#: order 1, the height of a peak to order 2; splines have order 4, which is not relied on.
ROW_ORDERS = (1.0, 2.0)
#: Factor of safety of the rows' share: convention of this project, between those of Roache, as the order is bounded.
ROWS_FACTOR = 1.5
SOME_RUNS = "only some of the runs have it"
NO_ROWS = "it cannot be determined from fewer rows"


def metric_error(metric: Metric, runs: ColumnRuns) -> Estimate:
    """Estimate a metric of a column in continuous time.

    The larger one of two errors of the coupling counts: that of the number, from its values in the three runs,
    and that of the solution, from the number of the extrapolated solution and what else the band of the
    solution makes possible. That of the rows is added: how far the number moves with every second and every
    third row, and where a gap between two rows hides an event, with the polynomial of either side in it.
    """
    value = metric.value(runs.finest)
    values = [metric.value(s) for s in runs.solutions]
    rows = rows_error(metric, runs.finest, value)
    if rows is None or not math.isfinite(value):
        return Estimate(value, None, math.nan, reason=NO_ROWS)
    of_runs = limit(values, runs.order, runs.ratio, rows, scale=metric.scale(runs.finest))
    if math.isnan(sum(values)):
        return Estimate(value, None, math.nan, rows, SOME_RUNS)
    error = float(of_runs.error) if of_runs.is_stated else None
    order = float(of_runs.order)
    if runs.band is not None:
        error, reason = _with_band(error, metric, runs, value, rows=rows, values=values)
        if reason:
            return Estimate(value, None, order, rows, reason)
    reason = of_runs.sentence() if error is None else ""
    return Estimate(value, error, order, rows, reason)


def _with_band(
    error: float | None,
    metric: Metric,
    runs: ColumnRuns,
    value: float,
    *,
    rows: float,
    values: Sequence[float],
) -> tuple[float | None, str]:
    """The error of a number that is at least as wide as the band of the solution makes it, or a reason against it.

    Where the number has no order, but the solution converges at the times that decide it, its error is
    the spread of the runs or what the extrapolation moves, with the larger factor of safety.
    """
    finest, band = runs.finest, runs.band
    assert band is not None
    behind = metric.value(finest.filled(Side.AFTER))
    shift = max(
        abs(metric.value(band.solution) - value),
        abs(metric.value(band.solution.filled(Side.AFTER)) - behind),
    )
    if math.isnan(shift):
        return None, SOME_RUNS
    if error is None:
        times = [*metric.times(finest), *metric.times(band.solution)]
        if not times or not all(band.converges_at(t) for t in times):
            return None, ""
        error = max(max(values) - min(values), UNCONFIRMED_FACTOR * shift) + rows
    return band_error(error - rows, shift, metric.doubt(finest, band.width)) + rows, ""


def band_error(error: float, shift: float, doubt: float = 0.0) -> float:
    """The error of a number, or the one that the band makes if that is larger.

    Parameters
    ----------
    error : float
        The error of the number from its values in the three runs.
    shift : float
        How far the extrapolation of the solution moves it.
    doubt : float
        See `Metric.doubt`.
    """
    agree = shift * CONFIRMED_FACTOR**2 <= UNCONFIRMED_FACTOR * error
    factor = CONFIRMED_FACTOR if agree else UNCONFIRMED_FACTOR
    return max(error, factor * shift, doubt)


def rows_error(metric: Metric, solution: DenseSolution, value: float) -> float | None:
    """The error of a metric due to the spacing of the rows; None if it has no value with fewer of them."""
    second, third = (
        max(abs(metric.value(solution.thinned(n, k)) - value) for k in range(n)) for n in THINNED
    )
    filled = [Side.AFTER] if not len(solution.gaps) else [Side.BEFORE, Side.AFTER]
    sides = max(abs(metric.value(solution.filled(side)) - value) for side in filled)
    if not math.isfinite(second + third + sides):
        return None
    return ROWS_FACTOR * max(spacing_error(second, third), sides)


def spacing_error(second: float, third: float) -> float:
    """The error with all rows, from the changes with every second and every third row.

    An error C h^q becomes C (2 h)^q and C (3 h)^q, so that the changes are 2^q - 1 and 3^q - 1 times it. The ratio
    of the two shows q.
    """
    low, high = ROW_ORDERS
    ratios = [(3.0**q - 1.0) / (2.0**q - 1.0) for q in ROW_ORDERS]
    position = (third / second - ratios[0]) / (ratios[1] - ratios[0]) if second else 1.0
    q = low + (high - low) * min(max(position, 0.0), 1.0)
    return float(max(third / (3.0**q - 1.0), second / (2.0**q - 1.0)))
