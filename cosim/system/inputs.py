"""What drives a free input over time: a table of measurements, a function, or changes at given times."""

from __future__ import annotations

import hashlib
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..errors import SetupError
from ..json_values import Json
from ..numbers import real

CHANGE = re.compile(
    r"\s*(?:at\s+)?(?P<time>\S+?)\s*(?:s\s)?\s*(?P<name>[^\s=]+)\s*=\s*(?P<value>.*?)\s*"
)
#: Distance of the points of Gauss' rule from the middle, over the interval: derived, the roots of the Legendre
#: polynomial of degree 2.
GAUSS = 0.5 / math.sqrt(3.0)
#: Share of the run that a table may lack at its ends. Derived: a time that is written with ten significant digits is
#: off by up to 5e-10 of itself, and so are the stop and the last row of a run from 0. The first two
#: rows are continued to the start, and the last row holds to the stop.
END_ROUNDING = 1e-9


class TableInput:
    """An input's values over time [s], in its unit, on lines or `held` from each row to the next.

    Times do not fall; two rows at the same time are a jump. `source` says where they come from.
    """

    def __init__(
        self, times: Sequence[float], values: Sequence[Any], *, held: bool = False, source: str = ""
    ) -> None:
        self.times, self.values, self.held, self.source = times, values, held, source

    def at(self, t: float) -> Any:
        """The value at time t [s], after a jump there."""
        return self._on(bisect_right(self.times, t) - 1, t)

    def before(self, t: float) -> Any:
        """The value at time t [s], before a jump there."""
        return self._on(bisect_left(self.times, t) - 1, t)

    def mean(self, t: float, h: float) -> float:
        """The mean value from t to t + h [s]."""
        times, end = self.times, t + h
        k = bisect_right(times, t)
        if k == len(times) or times[k] >= end:
            return float(self._on(k - 1, t + 0.5 * h))
        total = sum((b - a) * self._on(n, 0.5 * (a + b)) for n, a, b in self._pieces(t, end))
        return float(total / h)

    def rise(self, t: float, h: float) -> float:
        """By how much the value rises from t to t + h [s], not counting jumps."""
        return float(sum(self._on(n, b) - self._on(n, a) for n, a, b in self._pieces(t, t + h)))

    def _pieces(self, begin: float, end: float) -> Iterator[tuple[int, float, float]]:
        """The rows that hold between two times [s], each with its share of the time."""
        first, last = bisect_right(self.times, begin), bisect_left(self.times, end)
        times = [begin, *self.times[first:last], end]
        yield from zip(range(first - 1, last), times, times[1:])

    def _on(self, k: int, t: float) -> Any:
        """The value at time t [s] after row k, which counts from 0."""
        k = max(k, 0)
        if self.held or k == len(self.times) - 1:
            return self.values[k]
        begin, end = self.times[k], self.times[k + 1]
        low, high = self.values[k], self.values[k + 1]
        return low if begin == end else low + (high - low) * ((t - begin) / (end - begin))

    def jumps(self, start: float, stop: float) -> list[float]:
        """The times [s] between start and stop at which the value changes at once."""
        return [
            b
            for a, b, u, v in zip(self.times, self.times[1:], self.values, self.values[1:])
            if (self.held or a == b) and u != v and start < b < stop
        ]

    def lacks(self, start: float, stop: float) -> str:
        """What is missing of the table for a run from start to stop [s]; empty if nothing is."""
        near = END_ROUNDING * (stop - start)
        first, last = self.times[0], self.times[-1]
        if first > start + near:
            return f"begins at {first!r} s, after the start at {start!r} s"
        if not self.held and last < stop - near:
            return f"ends at {last!r} s, before the stop at {stop!r} s"
        return ""

    def provenance(self) -> dict[str, Json]:
        """What a result says of it."""
        rows = list(zip(self.times, self.values))
        digest = hashlib.sha256(repr(rows).encode()).hexdigest()[:16]
        return {"source": self.source, "rows": len(rows), "held": self.held, "sha256": digest}


class FunctionInput:
    """A function of time [s] as an input."""

    held = False

    def __init__(self, function: Callable[[float], float]) -> None:
        self.at = self.before = function

    def mean(self, t: float, h: float) -> float:
        """The mean value from t to t + h [s], by Gauss' rule of two points."""
        middle, aside = t + 0.5 * h, GAUSS * h
        return 0.5 * (float(self.at(middle - aside)) + float(self.at(middle + aside)))

    def rise(self, t: float, h: float) -> float:
        """By how much the value rises from t to t + h [s]."""
        return float(self.at(t + h)) - float(self.at(t))

    def jumps(self, start: float, stop: float) -> list[float]:
        """None are known."""
        return []

    def lacks(self, start: float, stop: float) -> str:
        """Nothing."""
        return ""

    def provenance(self) -> dict[str, Json]:
        """What a result says of it."""
        return {"function": getattr(self.at, "__qualname__", repr(self.at))}


def parse_change(text: str) -> tuple[float, str, str]:
    """Time [s], name and value of a change, "at 2 s motor.A = 7500"; raises SetupError."""
    match = CHANGE.fullmatch(re.sub(r"\s+", " ", text))
    try:
        time = real(match["time"]) if match else math.nan
    except ValueError:
        time = math.nan
    if match is None or not math.isfinite(time):
        raise SetupError(f"change {text!r} must read 'at TIME s part.variable = value'")
    return time, match["name"], match["value"]
