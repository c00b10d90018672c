"""What the runs of a study say of a figure: its share above a limit, from where to where it holds, its spread.

A share of samples has the interval of Clopper and Pearson (1934), since it must not be too sure of machines that keep a
limit: it covers the true share in at least 95 % of studies, also where no run of a few hundred is above. Wilson's interval
is narrower and covers it in 95 % on the average only, less where shares are small. Samples of a Latin hypercube or
Sobol's are spread more evenly than random ones, for which the interval holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binomtest

from cosim import SetupError
from cosim.errors import pluralize
from cosim.rounding import rounded, unit_suffix

from ..answer import Table
from ..figure import MOST_DIGITS, Figure
from ..judgement import share_text
from ..options import Option
from . import charts
from .file import Study

#: Stretches of an input that are named one by one; chosen: they fit a line.
MOST_STRETCHES = 3
#: Share of studies whose interval covers the true share.
CONFIDENCE = 0.95
Flags = NDArray[np.bool_]


class Share(NamedTuple):
    """How many runs of one point of the grid are above a limit, with the share's interval where they are samples.

    A run is `open` if the limit lies within the error of its figure: the interval covers both cases.
    """

    figure: str
    limit: float
    above: int
    open: int
    runs: int
    low: float
    high: float

    def text(self) -> str:
        """The share in words, "2 of 128 runs (0.2 % to 5.5 %)"."""
        near = f", and the limit lies within the error of {self.open} more" if self.open else ""
        return f"{count_text(self.above, self.runs, 'run', self.low, self.high)}{near}"


def interval(count: int, number: int, more: int = 0) -> tuple[float, float]:
    """The interval of Clopper and Pearson for the share of which so many of a number of samples were found, or `more`."""
    low, high = (
        binomtest(x, number).proportion_ci(CONFIDENCE, "exact") for x in (count, count + more)
    )
    return float(low.low), float(high.high)


def count_text(
    count: int, number: int, what: str, low: float = math.nan, high: float = math.nan
) -> str:
    """How many of what were found, with the interval of their share if it is known, "2 of 128 runs (0.2 % to 5.5 %)"."""
    text = f"{count} of {pluralize(number, what)}"
    if math.isnan(low):
        return text
    if low <= 0.0 or high >= 1.0:
        return f"{text} ({f'at most {share_text(high)}' if low <= 0.0 else f'at least {share_text(low)}'})"
    return f"{text} ({share_text(low)} to {share_text(high)})"


def stretches_of(holds: Flags) -> list[tuple[int, int]]:
    """The first and the last number of each stretch over which flags hold."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(int), [0]])))
    return [(int(first), int(last) - 1) for first, last in edges.reshape(-1, 2)]


def share_above(study: Study, table: Table, name: str, limit: float, rows: Flags) -> Share:
    """How many of these rows have a figure above its limit; those without the figure do not count."""
    y = np.asarray(table.columns[name], float)
    error = np.nan_to_num(
        np.asarray(table.columns.get(name + charts.ERROR, np.zeros(len(y))), float)
    )
    rows = rows & np.isfinite(y)
    above = rows & (y - error > limit)
    near = rows & ~above & (y + error > limit)
    count, more, number = (int(x.sum()) for x in (above, near, rows))
    is_sample = study.sampling is not None and number
    ends = interval(count, number, more) if is_sample else (np.nan, np.nan)
    return Share(name, limit, count, more, number, *ends)


def shares_above_limits(
    study: Study, table: Table, names: Mapping[str, str]
) -> tuple[Table, list[str]]:
    """The shares above the study's limits at every point of its grid, and a sentence for each limit."""
    grid = list(study.grid) if study.sampling is not None else []
    keys = list(zip(*(table.columns[name] for name in grid))) or [()] * len(table)
    points = list(dict.fromkeys(keys))
    rows: list[Sequence[Any]] = []
    sentences = []
    for figure, raw in study.limits.items():
        if figure not in names:
            continue
        name, unit = names[figure], table.units[names[figure]]
        try:
            limit = Option(figure, float, unit=unit).read(raw, f"limits.{figure}")
        except SetupError as error:
            raise SetupError(f"{study.path}: {error}") from None
        shares = [
            share_above(study, table, name, limit, np.array([key == point for key in keys]))
            for point in points
        ]
        rows += [(*point, *one) for point, one in zip(points, shares)]
        sentences.append(_limit(study, table, shares, points, grid))
    units = {name: table.units.get(name, "") for name in grid} | dict.fromkeys(Share._fields, "")
    return Table.of_rows(rows, units), sentences


def _limit(
    study: Study,
    table: Table,
    shares: Sequence[Share],
    points: Sequence[Sequence[Any]],
    grid: Sequence[str],
) -> str:
    """What the runs say of a limit, in a sentence without its end; of a grid, where they are above it most often."""
    worst = max(range(len(shares)), key=lambda k: (shares[k].high, shares[k].above))
    one = shares[worst]
    unit = unit_suffix(table.units[one.figure])
    what = f"{one.figure} is above {one.limit:.6g}{unit} in {one.text()}"
    if not one.runs:
        return f"no run has {one.figure}"
    if grid:
        at = (
            f"{name} = {_number(x)}{unit_suffix(table.units[name])}"
            for name, x in zip(grid, points[worst])
        )
        return f"{what} at {', '.join(at)}, nowhere more often"
    missing = len(table) - one.runs
    without = f"; {pluralize(missing, 'run')} without it" if missing else ""
    y = np.asarray(table.columns[one.figure], float)
    return what + without + stretches(study, table, np.isfinite(y), y > one.limit)


def stretches(study: Study, table: Table, rows: Flags, flags: Flags) -> str:
    """From where to where flags hold among rows, "; for x = 1 to 3 m"; "" unless one input varies, by numbers."""
    x = study.varied[0]
    at = table.columns[x]
    if len(study.varied) > 1 or study.sampling is not None or at.dtype.kind not in "if":
        return ""
    order = np.argsort(at[rows])
    at, holds = at[rows][order], flags[rows][order]
    if holds.all() or not holds.any():
        return ""
    pairs = [(at[first], at[last]) for first, last in stretches_of(holds)]
    unit = unit_suffix(table.units[x])
    if len(pairs) > MOST_STRETCHES:
        return f"; for {x} in {len(pairs)} stretches between {_number(pairs[0][0])} and {_number(pairs[-1][1])}{unit}"
    return f"; for {x} = {' and '.join(_range(*pair) for pair in pairs)}{unit}"


def sentence(study: Study, table: Table, name: str) -> str:
    """What the runs say of a figure, in a sentence without its end."""
    y = np.asarray(table.columns[name], float)
    rows = np.isfinite(y)
    if table.units[name] == "1" and rows.sum() > 1 and charts.is_flag(y):
        return _yes_or_no(study, table, name, y, rows)
    if len(y) == 1 and rows.all() and name + charts.ERROR in table.columns:
        error = float(table.columns[name + charts.ERROR][0])
        return f"{name} is {Figure(float(y[0]), table.units[name], error).text()} in the only run"
    return _spread(pd.Series(y, name=name), table.units[name])


def _yes_or_no(study: Study, table: Table, name: str, y: NDArray[Any], rows: Flags) -> str:
    """How often a figure is yes, and where: over one input from where to where, of samples with the share's interval."""
    yes, number = int(y[rows].sum()), int(rows.sum())
    ends = interval(yes, number) if study.sampling and not study.grid else ()
    text = f"{name}: yes in {count_text(yes, number, 'run', *ends)}"
    if study.sampling is None:
        return text + stretches(study, table, rows, y == 1.0)
    if not study.grid:
        return text
    x = next(iter(study.grid))
    if len(study.grid) > 1 or table.columns[x].dtype.kind not in "if":
        return text
    points = pd.Series(y[rows]).groupby(table.columns[x][rows]).mean()
    unit = unit_suffix(table.units[x])
    whole = []
    for word, share in (("all", 1.0), ("none", 0.0)):
        at = [points.index[[*ends]] for ends in stretches_of((points == share).to_numpy())]
        if len(at) == 1:
            whole.append(f"in {word} of those at {x} = {_range(*at[0])}{unit}")
    return "; ".join([text, *whole])


def _spread(column: pd.Series[float], unit: str) -> str:
    """A figure over all runs, in a sentence without its end."""
    name, y = column.name, column.dropna()
    if y.empty:
        return f"No run has {name}"
    runs = f"the {len(y)} of {len(column)} runs that have it"
    runs = f"all {len(y)} runs" if len(y) == len(column) > 1 else runs
    unit = unit_suffix(unit)
    if y.min() == y.max():
        return f"{name} is {y.min():.6g}{unit} in {runs}"
    low, high, mean = (rounded(x, y.std(), MOST_DIGITS)[0] for x in (y.min(), y.max(), y.mean()))
    return (
        f"{name} lies between {low} and {high}{unit} in {runs}, with a mean of {mean}{unit} and a "
        f"standard deviation of {y.std():.2g}{unit}"
    )


def _range(begin: Any, end: Any) -> str:
    return _number(begin) if begin == end else f"{_number(begin)} to {_number(end)}"


def _number(x: Any) -> str:
    return f"{x:.4g}" if isinstance(x, int | float | np.number) else str(x)
