"""Where values of runs with smaller and smaller steps go, and how far the finest run is from there.

Runs have the steps h, r h and r^2 h. Their differences d = x(h) - x(r h) and D = x(r h) - x(r^2 h) fall with the
observed order q = log(D / d) / log r. The error of x(h) is the Grid Convergence Index of Roache (J. Fluids Eng.
116, 1994) and Celik et al. (J. Fluids Eng. 130, 2008), with the factors of safety of Oberkampf and Roy
(Verification and Validation in Scientific Computing, 2010, section 8.7); the data range takes its place where runs
do not converge monotonically (Eca and Hoekstra, J. Comput. Phys. 262, 2014). No other factors of safety are in
the project.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Runs from which an order is observed: derived, two differences need three.
RUNS = 3
#: Ratio of two steps: the smallest whole one, so that the finer run has all times of the coarser one.
STEP_RATIO = 2.0
#: Factor of safety where the observed order is that of the algorithm (Roache 1998, three grids).
CONFIRMED_FACTOR = 1.25
#: Factor of safety where it is another one, or where only two runs are there (Roache 1994, two grids); also that of
#: the data range where there is no order (Eca and Hoekstra 2014).
UNCONFIRMED_FACTOR = 3.0
#: Distance of the two orders, as a share of that of the algorithm, up to which it is confirmed (Oberkampf and Roy).
CONFIRMED_DISTANCE = 0.1
#: Lowest order with which differences may fall (Oberkampf and Roy; Eca and Hoekstra).
LOWEST_ORDER = 0.5
#: An order so far above that of the algorithm is an accident: two differences of which the finer one passes through
#: zero. Half of it and twice it leave the share of errors that hold as it is, and change how many are refused.
ACCIDENTAL_EXCESS = 1.5
#: Largest error of a number without an order, as a share of it: a number without one digit is none.
ACCIDENTAL_SHARE = 0.15
#: Factor on the data range of runs that come closer to each other from both sides. Derived: that of two terms of opposite
#: signs, of the orders 1 and 2 and a ratio of 2, is up to 2; of higher orders it is less. Eca and Hoekstra's 3 is for runs
#: that do not come closer; those are refused here.
ALTERNATING_FACTOR = 2.0
#: Spread of values in no order, as a share of the value or the scale, up to which three times it is an error (Eca and
#: Hoekstra): three digits are left. Of 6 636 figures of benchmarks/certify.py, with an earlier rule for
#: chaos, half of it refuses 6 more, twice of it 3 fewer, and none of it 47 more; 19, 18, 19 and with it 18 are outside
#: their errors.
UNORDERED_SHARE = 1e-3
#: Differences below this share of a value are rounding. Derived: 10^6 operations of relative error 1e-16.
ROUNDING_SHARE = 1e-10
#: Times the noise of a value by which two runs may differ. Derived: each has it once.
BOTH_NOISES = 2.0


class Reason(IntEnum):
    """Why an error is no claim."""

    STATED = 0
    NOT_FALLING = 1
    GROWING = 2
    MISSING = 3
    NO_VALUE = 4

    def sentence(self, order: float = math.nan) -> str:
        """The reason in words; `order` is the one observed."""
        with_order = f"order {order:.1f}" if math.isfinite(order) else "no order"
        return {
            Reason.STATED: "",
            Reason.NOT_FALLING: f"not converged: the error falls with {with_order}",
            Reason.GROWING: "not converged: the value grows without end as the step shrinks",
            Reason.MISSING: "the runs with longer steps fail, so that no error can be estimated",
            Reason.NO_VALUE: "it has no value",
        }[self]


@dataclass(frozen=True)
class Limit:
    """Values of the finest of three runs, and what remains to a step of zero; arrays of one shape.

    Attributes
    ----------
    value
        The values of the finest run.
    error
        By how much they may be off. Where `reason` is not 0, it is three times the spread of the runs, which
        bounds nothing.
    extrapolated
        The values at a step of zero (Richardson); those of the finest run where they do not converge regularly.
    extrapolated_error
        By how much these may be off: the distance of what the finer pair of runs extrapolates to from what the
        coarser pair does, which falls with the observed order, and at least the largest next term that a confirmed
        order leaves open: terms of opposite signs may make both agree by accident, and no three runs show that.
    order
        The observed order; nan where there is none.
    reason
        A `Reason`, 0 where the error holds.
    """

    value: Array
    error: Array
    extrapolated: Array
    extrapolated_error: Array
    order: Array
    reason: NDArray[np.intp]

    @property
    def is_stated(self) -> NDArray[np.bool_]:
        """Where the error is a claim."""
        return np.asarray(self.reason == Reason.STATED)

    def sentence(self) -> str:
        """Why a single value has no error; "" if it has one."""
        return Reason(int(self.reason)).sentence(float(self.order))


def limit(
    x: ArrayLike,
    order: ArrayLike,
    ratio: float = STEP_RATIO,
    noise: ArrayLike = 0.0,
    *,
    scale: ArrayLike = 0.0,
    is_regular: ArrayLike = True,
) -> Limit:
    """Estimate the errors of values of three runs, element by element.

    Parameters
    ----------
    x : array of shape (3, ...)
        Values with the steps h, r h and r^2 h, finest first. The coarsest may be nan, if there is no such run:
        the order is then taken to be that of the algorithm. The errors of complex values are distances in their plane:
        their differences are arrows, of which a part along an axis may pass through zero while the whole falls.
    order : array
        The order p of the algorithm for each value.
    ratio : float
        The ratio r of the steps.
    noise : array
        What else each value of the three runs may be wrong by, such as the spacing of rows. It is added to the
        error, and runs that differ by no more than it makes of both have their spread as error.
    scale : array
        What an error without an order is compared with where that is larger than the value.
    is_regular : array of bool
        False where something else says that the runs are not yet where errors fall with their order: an order that
        is observed is then an accident and confirms nothing.

    Returns
    -------
    Limit
        The first of these that is so gives the error: values that are the same have their rounding; without the
        coarsest run it is 3 d / (r^p - 1); of values that come closer from both sides 2 D, where they are not regular
        3 D, if that is at most 0.15 of them; of monotonic values whose differences fall with the order q it is
        F max(d, D / r^p) / (r^s - 1), with F = 1.25 and s = p where q is within a tenth of p, else F = 3 and s = q
        between 0.5 and p; if q is so high that it is an accident, that or 2 D, if it is at most 0.15 of them. Values
        in no order that do not grow have their spread if that is their noise, and three times it if they agree to 1e-3
        of the value or the scale. Others have no error.

    Examples
    --------
    >>> of_runs = limit([1.01, 1.04, 1.16], 2.0)
    >>> round(float(of_runs.error), 4), round(float(of_runs.extrapolated), 4)
    (0.0125, 1.0)
    """
    p, *each = np.broadcast_arrays(np.asarray(order, float), *(np.asarray(x) + 0.0))
    fine, middle, coarse = runs = np.array(each)
    noises, regular = np.broadcast_to(np.asarray(noise, float), runs.shape), np.asarray(is_regular)
    with np.errstate(all="ignore"):
        least = ROUNDING_SHARE * np.where(fine == 0.0, 1.0, np.abs(fine))
        finer, coarser = fine - middle, middle - coarse
        d, D = np.abs(finer), np.abs(coarser)
        spread = np.fmax(np.fmax(d, D), np.abs(fine - coarse))
        size = np.maximum(np.abs(fine), scale)
        most, gain, root = ACCIDENTAL_SHARE * size, ratio**p - 1.0, ratio**LOWEST_ORDER
        q = np.where(D > 0.0, np.log(D / np.maximum(d, least)) / math.log(ratio), -math.inf)

        settled = np.maximum(d, D) <= least
        lacking = np.isnan(coarse) & np.isfinite(middle)
        alternating = (finer * coarser.conj()).real < 0.0
        accidental = q > p + ACCIDENTAL_EXCESS
        grows = (np.abs(fine) >= root * np.abs(middle)) & (np.abs(middle) >= root * np.abs(coarse))
        grows &= (d >= root * D) & (d > least)
        largest = np.maximum(d, D / ratio**p)
        with_order = UNCONFIRMED_FACTOR * largest / (ratio ** np.clip(q, LOWEST_ORDER, p) - 1.0)
        from_both = np.where(regular, ALTERNATING_FACTOR, UNCONFIRMED_FACTOR) * D
        by_accident = np.maximum(with_order, ALTERNATING_FACTOR * D)

        falls = (q >= LOWEST_ORDER) & ~alternating
        errors = [
            (settled, least),
            (lacking, UNCONFIRMED_FACTOR * d / gain),
            (alternating & (q > 0.0) & (from_both <= most), from_both),
            (
                falls & regular & (np.abs(q - p) <= CONFIRMED_DISTANCE * p),
                CONFIRMED_FACTOR * largest / gain,
            ),
            (falls & ~accidental, with_order),
            (falls & accidental & (by_accident <= most), by_accident),
            (~grows & (spread <= BOTH_NOISES * np.fmax.reduce(noises)), spread),
            (~grows & (spread <= UNORDERED_SHARE * size), UNCONFIRMED_FACTOR * spread),
        ]
        conditions, values = [where for where, _ in errors], [value for _, value in errors]
        stated = np.any(conditions, axis=0)
        error = np.select(conditions, values, UNCONFIRMED_FACTOR * spread)
        reason = np.select(
            [~np.isfinite(fine), ~np.isfinite(middle), stated, grows],
            [Reason.NO_VALUE, Reason.MISSING, Reason.STATED, Reason.GROWING],
            Reason.NOT_FALLING,
        )
        error = np.where(stated, np.maximum(error, least), error) + noises[0]
        observed = np.where(alternating | lacking, math.nan, q)
        observed = np.where(falls & accidental & (by_accident > most), -math.inf, observed)
        is_limit = lacking | (falls & ~settled & ~accidental)
        hidden = ratio**p * (ratio ** (CONFIRMED_DISTANCE * p) - 1.0) / (ratio ** (p + 1.0) - 1.0)
        apart = _extrapolation_error(runs, noises, gain, np.minimum(1.0, ratio**q - 1.0), hidden)
        return Limit(
            fine,
            error,
            extrapolated=np.where(is_limit, fine + finer / gain, fine),
            extrapolated_error=np.where(is_limit & ~lacking, apart, error),
            order=np.where(settled, p, observed),
            reason=reason.astype(np.intp),
        )


def _extrapolation_error(
    runs: Array, noises: Array, gain: Array, distance_of_error: Array, hidden: Array
) -> Array:
    """The error of what the finer two of three runs extrapolate to, from what the coarser two do.

    The distance of the two is the error times `distance_of_error` where that is below 1. It vanishes where the terms
    of the next two orders cancel in it, x(h) = x + a h^p + b h^(p+1) + c h^(p+2), while b h^(p+1) + c h^(p+2) does not.
    An order q within CONFIRMED_DISTANCE of p leaves the distance (r^p - r^q) / (r^p - 1) of a h^p, and so a next term of
    that over r^(p+1) - 1: `hidden` over r^p - 1.
    """
    fine, middle, coarse = runs
    finer, coarser = fine + (fine - middle) / gain, middle + (middle - coarse) / gain
    least = hidden * np.abs(fine - middle) / gain
    error = np.maximum(np.abs(finer - coarser) / distance_of_error, least)
    return np.asarray(error + noises[0] + (noises[0] + noises[1]) / gain)


def likeliest(
    x: ArrayLike, orders: ArrayLike, ratio: float = STEP_RATIO, noise: ArrayLike = 0.0, **more: Any
) -> Limit:
    """What `limit` estimates of values, shape (3, n), that may each have one of several orders, shape (orders, n).

    The order is the highest one that the runs confirm, else the lowest. A value of a low order that happens to
    fall with a higher one gets too small an error.
    """
    p = np.asarray(orders, dtype=np.float64)
    runs, noises = (np.asarray(of, dtype=np.float64) for of in (x, noise))
    every = limit(runs[:, None], p, ratio, noises[:, None] if noises.ndim else noises, **more)
    confirmed = np.abs(every.order - p) <= CONFIRMED_DISTANCE * p
    highest = np.where(confirmed, p, -math.inf).argmax(axis=0)
    k = np.where(confirmed.any(axis=0), highest, p.argmin(axis=0))[None]
    return Limit(*(np.take_along_axis(field, k, axis=0)[0] for field in vars(every).values()))
