"""A number with its error."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..rounding import unit_suffix, with_error


class Estimate(NamedTuple):
    """A value with its error, the order with which the error falls, and its unit.

    `error` is None if none can be stated. The value is then no answer; its text says so and gives
    the `reason`. `rows` is the part of the error that is due to the spacing of the rows.
    """

    value: float
    error: float | None
    order: float = math.nan
    rows: float = 0.0
    reason: str = ""
    unit: str = ""

    def __str__(self) -> str:
        """The value with two digits of its error, rounded up, and its unit; or the reason against it."""
        if self.error is None:
            value = "" if math.isnan(self.value) else f"{self.value:.5g}{unit_suffix(self.unit)} "
            return f"{value}({self.reason or 'not determined'})"
        return with_error(self.value, self.error, self.unit)
