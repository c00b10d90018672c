"""Times that differ only by rounding."""

from __future__ import annotations

import math


def coincide(a: float, b: float) -> bool:
    """Whether two times [s] differ by rounding only."""
    return abs(a - b) <= 64 * math.ulp(max(abs(a), abs(b)))


def is_reached(time: float, t: float) -> bool:
    """Whether a time [s] is not after t, but for rounding."""
    return time <= t or (time < math.inf and coincide(time, t))
