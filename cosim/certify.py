"""What the coupling did to a figure: Richardson extrapolation over three step sizes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

NEGLIGIBLE = 1e-10
SLOWER, FASTER = 0.5, 1.5


class Estimate(NamedTuple):
    """A figure with its coupling error and the order at which it converges.

    `error` is None where the runs do not converge at the order of the algorithm: the figure is then
    no answer, and its text says so.
    """

    value: float
    error: float | None
    order: float

    def text(self, unit: str) -> str:
        """The figure as it may be printed."""
        if self.error is None:
            return f"{self.value:.5g} {unit} (not converged: the steps are too long to tell)"
        digits = min(7, max(0, 1 - math.floor(math.log10(max(self.error, 1e-7)))))
        shown = max(self.error, 10.0**-digits)
        return f"{self.value:.{digits}f} +- {shown:.{digits}f} {unit}"


def estimate(values: Sequence[float], order: int) -> Estimate:
    """The estimate from runs with steps h, 2 h and 4 h, in this order, of an algorithm's order p.

    The error is |v(h) - v(2h)| / (2^q - 1), with q the observed order where that is below p.
    """
    fine, middle, coarse = values
    last, before = fine - middle, middle - coarse
    if abs(last) <= NEGLIGIBLE * abs(fine):
        return Estimate(fine, abs(last), float(order))
    observed = math.log2(abs(before / last)) if last * before > 0.0 else math.nan
    if not order - SLOWER <= observed <= order + FASTER:
        return Estimate(fine, None, observed)
    return Estimate(fine, abs(last) / (2 ** min(observed, order) - 1), observed)
