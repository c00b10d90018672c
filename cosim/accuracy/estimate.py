"""A number with its error."""

from __future__ import annotations

import math
from typing import NamedTuple

#: Decimals of a value whose error is 0 or far below it: convention, more than any figure here has certain.
MOST_DECIMALS = 7
#: The error of a value is written with this many units of its last digit at most: convention, two digits.
LARGEST_TWO_DIGITS = 99
#: An error that exceeds a whole number of units by this share of a unit is not rounded up: rounding.
ROUNDING_FRACTION = 1e-9


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
        digits = MOST_DECIMALS
        if self.error > 0.0:
            digits = min(digits, 1 - math.floor(math.log10(self.error)))
        value, units = self._rounded(digits)
        if units > LARGEST_TWO_DIGITS:
            digits -= 1
            value, units = self._rounded(digits)
        decimals = max(0, digits)
        return f"{value:.{decimals}f} +- {units * 10.0**-digits:.{decimals}f} {unit}"

    def _rounded(self, digits: int) -> tuple[float, int]:
        """The value with this many decimals, and its error in units of the last of them.

        The error includes that of rounding.
        """
        value = round(self.value, digits)
        error = (self.error or 0.0) + abs(self.value - value)
        return value, max(1, math.ceil(error * 10.0**digits * (1 - ROUNDING_FRACTION)))

    def _unconverged(self) -> str:
        if math.isfinite(self.order):
            return f"not converged: the error falls with order {self.order:.1f}"
        return "not converged: the error falls with no order"
