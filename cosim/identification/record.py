"""A record: measured columns of a file, in the units of variables, and the noise on them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from math import comb
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SetupError
from ..system import Network, Port, conversion_to
from ..system.inputs import COLUMN, Reading, Table, read_table
from ..units import multiples

Samples = NDArray[np.float64]
SECONDS = {"": 1.0} | multiples("s")
ORDERS, FEWEST, EVEN = (2, 4, 6, 8), 30, 0.02
CLIPPED, AGREE = 4.5, 2.0
NORMAL, MOST = 1.4826, 1e30


class Noise(NamedTuple):
    """The standard deviation of white noise on a column, in its unit; how it was found, and whether it
    was given; `spread` is the variance of chi2 per row times the number of rows.
    """

    sigma: float
    told: str
    spread: float = 2.0
    given: bool = False


class Column(NamedTuple):
    """What was measured of a variable: times [s], values in its unit, both of shape (n,), and noise."""

    port: Port
    times: Samples
    values: Samples
    noise: Noise

    @property
    def name(self) -> str:
        return self.port.name


def measured(
    path: Path | str, columns: Mapping[str, str], *, time: str | None = "time", gaps: bool = False
) -> dict[str, Table]:
    """Columns of a CSV file by the variables that they measure, all over one column of times, or over
    the row number, from 0, if `time` is None.

    A column is given by its name in the header, with a factor, an offset and a unit after it where
    needed: "n * 0.4:rpm", "n / 2.5:rpm". A header may have a unit too, "n [rpm]". Times are in s
    unless they have another unit, "t:ms". With `gaps`, cells may be empty or nan.

    Raises SetupError with file, row and column for times that do not rise, for a cell that is not a
    number, and for a column that is named twice.
    """
    head, *rows = read_table(path)
    heads = [match.groups() for match in map(COLUMN.fullmatch, head) if match]
    names = [name for name, _ in heads]
    places: dict[int, str] = {}

    def found(variable: str, text: str) -> tuple[int, float, float, str]:
        """Place in the header, factor, offset and unit of a column."""
        name, factor, offset, unit = Reading.read(text, names, str(path))
        place = names.index(name)
        if place in places:
            raise SetupError(
                f"{path}, column {name}: it is mapped twice, to {places[place]} and {variable}"
            )
        places[place] = variable
        return place, factor, offset, unit or heads[place][1] or ""

    def numbers(place: int, gaps: bool) -> Samples:
        values = np.full(len(rows), math.nan)
        for k, row in enumerate(rows):
            text = row[place].strip() if place < len(row) else ""
            here = f"{path}, row {k + 2}, column {names[place]}"
            try:
                values[k] = float(text or "nan")
            except ValueError:
                raise SetupError(f"{here}: {text!r} is not a number") from None
            if not abs(values[k]) < MOST and not (gaps and math.isnan(values[k])):
                raise SetupError(
                    f"{here}: {text or 'an empty cell'!r} is not a finite number "
                    f"below {MOST:g}; gaps must be allowed, and a time cannot be one"
                )
        return values

    def rising(time: str) -> Samples:
        """The column of times [s]."""
        place, factor, offset, unit = found("time", time)
        if unit not in SECONDS:
            known = ", ".join(filter(None, SECONDS))
            raise SetupError(
                f"{path}, column {names[place]}: times are in {known}, not in {unit!r}"
            )
        times = (factor * numbers(place, False) + offset) * SECONDS[unit]
        for k, (before, now) in enumerate(pairwise(times.tolist()), 3):
            if not before < now:
                raise SetupError(
                    f"{path}, row {k}, column {names[place]}: times must rise, but "
                    f"{now!r} s follows {before!r} s"
                )
        return times

    if not rows:
        raise SetupError(f"{path} has no rows below its header")
    times = np.arange(float(len(rows))) if time is None else rising(time)
    tables = {}
    for variable, text in columns.items():
        place, factor, offset, unit = found(variable, text)
        values = factor * numbers(place, gaps) + offset
        source = f"{Path(path).name}, column {names[place]}"
        tables[variable] = Table(times.tolist(), values.tolist(), unit=unit, source=source)
    return tables


def columns(
    network: Network, data: Mapping[str, Table], noise: Mapping[str, float]
) -> list[Column]:
    """The measured columns in the units of their variables, each with its noise.

    Raises SetupError for a variable that is not a Real output, a unit that does not fit, times that do
    not rise, a column that never changes, and a noise that is neither given nor can be estimated.
    """
    if not data:
        raise SetupError("a record needs a column")
    for name, sigma in noise.items():
        if name not in data or not 0.0 < sigma < math.inf:
            raise SetupError(
                f"noise of {name} = {sigma!r} must be above 0 and belong to a measured column"
            )
    found = []
    for port, table in ((network.port(name), table) for name, table in data.items()):
        what = table.source or f"the record of {port.name}"
        if port.variable.causality != "output" or port.type != "Real":
            raise SetupError(
                f"{what}: {port} is not a Real output, so nothing can be compared with it"
            )
        factor, offset = conversion_to(network, port, table.unit, "be compared with a column")
        times, values = np.array(table.times), factor * np.array(table.values, float) + offset
        there = np.isfinite(values)
        times, values = times[there], values[there]
        if len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise SetupError(f"{what}: its times must rise, and there must be two rows at least")
        if np.ptp(values) == 0.0:
            raise SetupError(
                f"{what}: it is {table.values[0]!r} in all rows and carries no information"
            )
        given = noise.get(port.name)
        known = told(times, values, what) if given is None else Noise(given, "as given", given=True)
        found.append(Column(port, times, values, known))
    return found


def told(times: Samples, values: Samples, what: str) -> Noise:
    """The noise of a column from differences of neighbouring rows; raises SetupError if they hide it.

    Differences of order k remove what is smooth over k + 1 rows and leave white noise with
    (2k over k) times its variance. Of several orders, the first one is taken with which the next agrees.
    Outliers are ignored. A column whose values lie on a grid of spacing q has at least the noise of
    rounding, q / sqrt(12).
    """
    gaps = np.diff(times)
    even = np.abs(gaps / np.median(gaps) - 1.0) <= EVEN
    quantum = _quantum(values)
    found = []
    for order in ORDERS:
        whole = np.array([even[k : k + order].all() for k in range(len(even) - order + 1)], bool)
        weights = np.array([(-1) ** k * comb(order, k) for k in range(order + 1)])
        weights = weights / math.sqrt(comb(2 * order, order))
        d = np.convolve(values, weights, "valid")[whole] if whole.any() else np.empty(0)
        if len(d) < FEWEST:
            break
        rough = max(NORMAL * float(np.median(np.abs(d))), quantum / math.sqrt(12.0))
        kept = d[np.abs(d) <= CLIPPED * rough]
        rho = np.array([comb(2 * order, order + k) for k in range(order + 1)])
        rho = rho / comb(2 * order, order)
        spread = 4.0 * float((rho[1:] ** 2).sum())
        found.append((float(np.sqrt(np.mean(kept**2))), order, spread))
    least = quantum / math.sqrt(12.0)
    for (sigma, order, spread), (after, *_) in pairwise(found):
        if sigma <= max(after, least) * (1.0 + AGREE * math.sqrt(spread / len(values))):
            if sigma < least:
                return Noise(least, f"that of rounding to {quantum:.4g}")
            grid = f", on a grid of {quantum:.4g}" if quantum else ""
            return Noise(sigma, f"from differences of order {order} of the rows{grid}", spread)
    raise SetupError(
        f"{what}: its rows are too few, too uneven or too far apart to separate noise from signal; "
        "give the noise"
    )


def _quantum(values: Samples) -> float:
    """The distance of the grid on which values stand; 0 if there is none that is much of the noise."""
    levels = np.unique(values)
    steps = np.diff(levels)
    least = float(steps.min())
    if least <= 1e-9 * float(np.abs(values).max()) or len(levels) > len(values) / 2:
        return 0.0
    ratio = steps / least
    return least if (np.abs(ratio - np.round(ratio)) < 0.05 * np.round(ratio)).all() else 0.0


def segments(times: Samples, most: int) -> Iterator[slice]:
    """A record in pieces of equal duration that hold rows, at most so many."""
    edges = np.searchsorted(times, np.linspace(times[0], times[-1], most + 1)[1:-1])
    for first, last in pairwise([0, *edges.tolist(), len(times)]):
        if last > first:
            yield slice(first, last)
