"""A number with its error."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..rounding import rounded


class Estimate(NamedTuple):
    """A value with its error and the order with which the error falls.

    `error` is None if none can be stated. The value is then no answer; its text says so and gives
    the `reason`. `rows` is the part of the error that is due to the spacing of the rows.
    """

    value: float
    error: float | None
    order: float
    rows: float = 0.0
    reason: str = ""

    def __str__(self) -> str:
        """Write the value without a unit."""
        return self.text("").replace("  ", " ").rstrip()

    def text(self, unit: str) -> str:
        """Write the value with two digits of its error, rounded up, and a unit.

        Parameters
        ----------
        unit : str
            Stands after the number; "" for none.
        """
        if self.error is None:
            return f"{self.value:.5g} {unit} ({self.reason or self._unconverged()})"
        value, error = rounded(self.value, self.error)
        return f"{value} +- {error} {unit}"

    def _unconverged(self) -> str:
        if math.isfinite(self.order):
            return f"not converged: the error falls with order {self.order:.1f}"
        return "not converged: the error falls with no order"
