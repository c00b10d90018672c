"""What drives a free input over time: a table of measurements, a function, or changes at given times."""

from __future__ import annotations

import hashlib
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from pathlib import Path
from typing import Any

from ..errors import SetupError
from ..json_values import Json
from ..numbers import real
from ..series import Kind, Reading, Series
from ..table_file import is_empty, number_of

#: Truth values as texts of a table.
FALSE_TRUE_TEXTS = {"true": True, "false": False}
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


class Table:
    """An input's values over time [s], interpolated linearly or `held` from each row to the next.

    Times must not fall; two rows at the same time are a jump. `unit` is the unit of the values if it
    is not the input's own. It may be one of the input's display units or any unit that an FMU of the
    system defines. `times` and `values` may be lists, NumPy arrays or columns of a pandas frame.
    `source` says where they come from. Raises SetupError if they do not make a table.
    """

    def __init__(
        self,
        times: Sequence[float],
        values: Sequence[Any],
        *,
        unit: str = "",
        held: bool = False,
        source: str = "",
    ) -> None:
        self.times = [float(t) for t in times]
        self.values = [v.item() if hasattr(v, "item") else v for v in values]
        self.unit, self.held, self.source = unit, held, source
        what = source or "a table"
        if not self.times or len(self.times) != len(self.values):
            raise SetupError(
                f"{what}: {len(self.times)} times and {len(self.values)} values do not make rows"
            )
        for before, t in zip([-math.inf, *self.times], self.times):
            if not before <= t < math.inf:
                raise SetupError(
                    f"{what}: time {t!r} s after {before!r} s must be finite and not fall"
                )

    @classmethod
    def read(
        cls, path: Path | str, column: str, *, unit: str | None = None, held: bool = False
    ) -> Table:
        """Read a column of a file, see `Series.read`, whose first column is the time.

        `column` is its name, or "M * 0.73:N.m" to scale it and give its unit. A header may give a
        unit too, "torque [N.mm]", which applies unless another is given here. A table that is `held`
        may contain truth values and texts.

        Parameters
        ----------
        path : path
            The file.
        column : str
            The column, with a factor and a unit where needed.
        unit : str, optional
            The unit of the values.
        held : bool
            Whether a value holds from its row to the next.

        Raises
        ------
        SetupError
            For a file that cannot be read, a column that does not exist, times in no unit of time, and with
            row and column for a cell that is not a number.
        """
        series = Series.read(path)
        clock, *names = series.names
        wanted = Reading.read(column, names, str(path))
        times = series.scaled(Reading(clock), "s")
        values: list[Any]
        if held and series.column(wanted.name).kind in (Kind.BOOLEAN, Kind.TEXT):
            cells = ("" if is_empty(cell) else cell for cell in series[wanted.name].tolist())
            values = [_cell(cell) for cell in cells]
        else:
            values = series.scaled(wanted, "").tolist()
        declared = series.column(wanted.name).unit if wanted.unit is None else wanted.unit
        source = f"{Path(path).name}, column {wanted.name}"
        return cls(
            times.tolist(),
            values,
            unit=declared if unit is None else unit,
            held=held,
            source=source,
        )

    def after(self, value: Any) -> Table:
        """The table with a value that holds before its first row.

        Parameters
        ----------
        value : float, bool or str
            In the unit of the table.
        """
        return self._with([-math.inf, *self.times], [value, *self.values], "")

    def mapped(self, change: Callable[[Any], Any]) -> Table:
        """The table with other values, in the input's unit.

        Parameters
        ----------
        change : callable
            Gives the new value for each value.
        """
        return self._with([*self.times], [change(v) for v in self.values], "")

    def _with(self, times: list[float], values: list[Any], unit: str) -> Table:
        other = copy(self)
        other.times, other.values, other.unit = times, values, unit
        return other

    def between(self, first: float, last: float) -> Table:
        """The rows between two times [s].

        Parameters
        ----------
        first : float
            The time of the earliest row [s].
        last : float
            The time of the latest row [s].

        Raises
        ------
        SetupError
            If there are no such rows.
        """
        rows = [(t, v) for t, v in zip(self.times, self.values) if first <= t <= last]
        if not rows:
            raise SetupError(
                f"{self.source or 'a table'}: it has no rows from {first:g} to {last:g} s, only from "
                f"{self.times[0]:g} to {self.times[-1]:g} s"
            )
        return self._with([t for t, _ in rows], [v for _, v in rows], self.unit)

    def at(self, t: float) -> Any:
        """The value at time t [s], after a jump there.

        Parameters
        ----------
        t : float
            The time [s].

        Examples
        --------
        >>> Table([0.0, 1.0, 1.0, 2.0], [0.0, 2.0, 5.0, 5.0]).at(0.5)
        1.0
        """
        return self._on(bisect_right(self.times, t) - 1, t)

    def mean(self, t: float, h: float) -> float:
        """The mean value from t to t + h [s].

        Parameters
        ----------
        t : float
            The beginning of the interval [s].
        h : float
            Its length [s].
        """
        times, end = self.times, t + h
        k = bisect_right(times, t)
        if k == len(times) or times[k] >= end:
            return float(self._on(k - 1, t + 0.5 * h))
        total = sum((b - a) * self._on(n, 0.5 * (a + b)) for n, a, b in self._pieces(t, end))
        return float(total / h)

    def rise(self, t: float, h: float) -> float:
        """By how much the value rises from t to t + h [s], not counting jumps.

        Parameters
        ----------
        t : float
            The beginning of the interval [s].
        h : float
            Its length [s].
        """
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
        """The times [s] between start and stop at which the value changes at once.

        Parameters
        ----------
        start : float
            The beginning of the interval [s].
        stop : float
            Its end [s].
        """
        return [
            b
            for a, b, u, v in zip(self.times, self.times[1:], self.values, self.values[1:])
            if (self.held or a == b) and u != v and start < b < stop
        ]

    def lacks(self, start: float, stop: float) -> str:
        """What is missing of the table for a run from start to stop [s]; empty if nothing is.

        Parameters
        ----------
        start : float
            When the run begins [s].
        stop : float
            When it ends [s].
        """
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


def _cell(cell: Any) -> float | bool | str:
    """A truth value, a number or a text of a table that is held."""
    if isinstance(cell, bool):
        return cell
    number = number_of(cell)
    return FALSE_TRUE_TEXTS.get(cell, cell) if math.isnan(number) else number


class FunctionInput:
    """A function of time [s] as an input."""

    held = False

    def __init__(self, function: Callable[[float], float]) -> None:
        self.at = function

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
