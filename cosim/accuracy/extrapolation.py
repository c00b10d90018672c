"""Values of searches at a step of zero: Richardson's extrapolation with errors of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .estimate import Estimate
from .limit import RUNS, STEP_RATIO

#: Differences that do not fall by this factor are not extrapolated: a convention of this project, not derived.
SLOWEST_FALL = 1.5
#: Differences below this share of a value are those of a settled orbit: a convention of this project.
SETTLED_SHARE = 1e-9
#: Differences in no order up to this share of a value still give an error: convention, three digits.
UNORDERED_SHARE = 1e-3
#: Factor on such differences: convention, twice the spread for each of two runs.
UNORDERED_FACTOR = 4.0
#: Smallest error of an extrapolated value as a share of the last difference, for limits of both pairs that agree by
#: accident: a convention of this project, not derived.
EXTRAPOLATION_SHARE = 0.02
#: The reasons why nothing is extrapolated.
UNSTABLE = "the run with four times the step is unstable, so that no error can be estimated"
NOT_CONVERGED = "results do not converge as the step is halved"


def extrapolate(
    values: Sequence[float], order: float, errors: Sequence[float] = (0.0, 0.0, 0.0)
) -> Estimate:
    """Extrapolate values of runs with the steps h, 2 h and 4 h to a step of zero (Richardson).

    Parameters
    ----------
    values : sequence of floats
        The value with the step h, 2 h and 4 h; fewer where the runs with longer steps have failed.
    order : float
        The order with which the error falls.
    errors : sequence of floats
        What else the values may be wrong by, such as the errors of the searches that found them.

    Returns
    -------
    Estimate
        Its error is the distance of what the finer pair of runs extrapolates to from what the coarser pair does,
        which is 2^q times as wrong where differences fall with the order q; below order 1 the distance is less than
        the error and is divided by 2^q - 1. The errors of the finer two values are added with the weights that
        these have in the extrapolated one. Values that move by little and in no order are not
        extrapolated and keep four times their moves as error. The error is None, with a reason, where there are
        fewer than three values, or where they move by more and in no order.
    """
    if len(values) < RUNS:
        return Estimate(values[0], None, math.nan, reason=UNSTABLE)
    fine, middle, coarse = values
    last, previous = fine - middle, middle - coarse
    most = max(abs(last), abs(previous))
    if abs(previous) < SLOWEST_FALL * abs(last) or most <= SETTLED_SHARE * abs(fine):
        if most > UNORDERED_SHARE * abs(fine):
            return Estimate(fine, None, math.nan, reason=NOT_CONVERGED)
        return Estimate(fine, UNORDERED_FACTOR * most + errors[0], math.nan)
    observed = math.log2(abs(previous / last)) if last else math.inf
    gain = STEP_RATIO**order - 1.0
    limit, coarse_limit = fine + last / gain, middle + previous / gain
    distance = abs(limit - coarse_limit)
    if observed < 1.0:
        distance /= math.pow(STEP_RATIO, observed) - 1.0
    error = distance + EXTRAPOLATION_SHARE * abs(last)
    error_of_values = errors[0] + (errors[0] + errors[1]) / gain
    return Estimate(limit, error + error_of_values, observed)
