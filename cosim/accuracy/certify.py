"""The error of a figure: from the coupling, and from what lies between the rows."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..describe import table
from ..engine.control import Adaptive
from ..master import run
from ..metrics import FEWEST, largest, mean, smallest, spline
from ..result import Result, Rows
from ..system import System

NEGLIGIBLE = 1e-10
SLOWEST, FASTER, VAGUE, SAFETY = 0.5, 1.5, 0.1, 1.5
HALVED, TENTH = 2.0, 10.0
THINNED, FAR = (2, 3), 10.0
SHIFTED = (0.03, 0.06, 0.125, 0.25, 0.5, 0.75, 0.875)
CUBIC, CALM, KINK, FLAT, SIDED = 4, 3, 8.0, 1e-8, (0.25, 0.5, 0.75)
MOST_DIGITS, TICKS, SHARED = 7, 12, 0.5
UNKNOWN = "it cannot be determined from fewer rows"
#: Shares of a run's rows over which trajectories are compared. A convention: a jump that one run makes
#: a row later than another is a small share of such a stretch, and a run that has diverged fills many.
STRETCHES = 20
#: Mean distance of two trajectories over a stretch, as a share of the range of a column, from which on
#: they may have diverged. Two states of the Lorenz attractor drawn at random are 0.2 to 0.3 of the range
#: apart on average; runs that converge and are so far apart show it by falling differences.
FAR_APART = 0.1
#: Stretches before and after one in which the coarser runs are looked at, too: a convention. Where two
#: runs differ in phase, their distance vanishes twice a period, and not at the same times for each pair.
NEIGHBOURS = 2
DIVERGED = "not converged: the runs diverge"

SUMMARY: dict[str, Callable[[Rows, Rows], float]] = {
    " at the end": lambda t, x: x[-1],
    ", smallest": smallest,
    ", largest": largest,
    ", mean": mean,
}


class Estimate(NamedTuple):
    """A figure with its error and the order at which it converges.

    `error` is None if none can be stated. The figure is then no answer; its text says so and gives
    the `reason`. `rows` is the part of the error that is due to the spacing of the rows.
    """

    value: float
    error: float | None
    order: float
    rows: float = 0.0
    reason: str = ""

    def __str__(self) -> str:
        """The figure without a unit."""
        return self.text("").replace("  ", " ").rstrip()

    def text(self, unit: str) -> str:
        """The figure for printing, with two digits of its error, rounded up."""
        if self.error is None:
            return f"{self.value:.5g} {unit} ({self.reason or self._unconverged()})"
        digits = MOST_DIGITS
        if self.error > 0.0:
            digits = min(digits, 1 - math.floor(math.log10(self.error)))
        value, last = self._rounded(digits)
        if last > 99:
            digits -= 1
            value, last = self._rounded(digits)
        places = max(0, digits)
        return f"{value:.{places}f} +- {last * 10.0**-digits:.{places}f} {unit}"

    def _rounded(self, digits: int) -> tuple[float, int]:
        """The value with this many decimals, and its error, including that of rounding, in units of the
        last of them."""
        value = round(self.value, digits)
        off = (self.error or 0.0) + abs(self.value - value)
        return value, max(1, math.ceil(off * 10.0**digits * (1 - 1e-9)))

    def _unconverged(self) -> str:
        if math.isfinite(self.order):
            return f"not converged: the error falls with order {self.order:.1f}"
        return "not converged: the error falls with no order"


def estimate(values: Sequence[float], order: float, ratio: float = HALVED) -> Estimate:
    """The estimate from runs with steps h, r h and r^2 h, in this order, by an algorithm of order p.

    The differences `d = |v(h) - v(r h)|` and `D = |v(r h) - v(r^2 h)|` fall with the observed order q,
    but the errors are assumed to fall no faster than with p: the error is the larger of d and D / r^p,
    divided by r^q - 1, times SAFETY. Where the differences have opposite signs and fall, it is D times
    SAFETY. No error is stated where they do not fall, or where they fall with no known order and the
    error would exceed the share VAGUE of the value.
    """
    fine, *_, middle, coarse = values
    last, before = fine - middle, middle - coarse
    least = NEGLIGIBLE * (abs(fine) or 1.0)
    if max(abs(last), abs(before)) <= least:
        return Estimate(fine, least, float(order))
    falls = math.log(abs(before) / max(abs(last), least), ratio) if before else -math.inf
    if last * before >= 0.0:
        observed, fails = falls, not falls >= SLOWEST
        regular = falls <= order + FASTER
        bound = max(abs(last), abs(before) / ratio**order)
        bound /= ratio ** min(max(falls, SLOWEST), order) - 1
    else:
        observed, fails, regular, bound = math.nan, not falls > 0.0, False, abs(before)
    if fails or (not regular and bound > VAGUE * abs(fine)):
        return Estimate(fine, None, observed)
    return Estimate(fine, max(SAFETY * bound, least), observed)


class Certified(NamedTuple):
    """The finest of three runs, and every figure with its error."""

    result: Result
    figures: dict[str, Estimate]

    def __str__(self) -> str:
        """A line for each figure, and what the run warns of."""
        lines = list(table([(name, str(figure)) for name, figure in self.figures.items()]))
        return "\n".join([*lines, *(f"warning: {text}" for text in self.result.warnings)])

    def _repr_html_(self) -> str:
        """The figures as a table, for notebooks."""
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(str(figure))}</td></tr>"
            for name, figure in self.figures.items()
        )
        warnings = "".join(f"<p>{html.escape(text)}</p>" for text in self.result.warnings)
        return f"<table><tr><th>figure</th><th>value and error</th></tr>{rows}</table>{warnings}"


def certify(
    system: System,
    figures: Callable[[Result], Mapping[str, float]],
    *,
    step: float | Adaptive,
    runner: Callable[..., Result] = run,
    **settings: Any,
) -> Certified:
    """Run with the step, a half and a quarter of it, or the tolerance, a tenth and a hundredth.

    `figures` computes the figures from a result. It is called for each run. For the finest run it is
    called again with fewer rows and with rows in between, to see how the figures depend on the rows.
    The error is the sum of those from the coupling and from the rows; `largest`, `crossing`, `mean`
    and the like look between rows and keep it small. For figures that count rows, it is also called
    with rows repeated to the original number.

    Rows are `step` apart in all runs unless `settings`, which are those of `run`, say otherwise.
    `runner` runs a system, as `run` does; only the last run gets `csv`. Raises whatever `runner` raises.
    """
    progress = settings.pop("progress", None) or (lambda share: None)
    csv = settings.pop("csv", None)
    if isinstance(step, Adaptive):
        ratio = TENTH
        steps: list[Any] = [replace(step, tolerance=step.tolerance / ratio**k) for k in range(3)]
    else:
        ratio = HALVED
        steps = [step / ratio**k for k in range(3)]
        settings = {"output_step": step} | settings
    values: list[Mapping[str, float]] = []
    data: list[Rows] = []
    for k, h in enumerate(steps):
        done, share = ((ratio**n - 1) / (ratio**3 - 1) for n in (k, k + 1))

        def told(part: float, done: float = done, share: float = share) -> None:
            progress(done + part * (share - done))

        last = {} if csv is None or k < 2 else {"csv": csv}
        result = runner(system, step=h, **settings, progress=told, **last)
        values.insert(0, figures(result))
        data.insert(0, result.data)
    order = 1.0 if ratio == TENTH else result.provenance["convergence_order"]
    late = result.provenance.get("first_order", ())
    orders = np.array([min(order, 1.0) if name in late else order for name in result.columns])
    converges = _order(figures, result, values[0], orders)
    rows = by_rows(figures, result, values[0])
    hidden = _hidden(figures, result, values[0], data, orders, ratio)
    diverged = _diverged(figures, result, values[0], data, ratio)
    found = {}
    for name in values[0]:
        if reason := diverged.get(name):
            found[name] = Estimate(values[0][name], None, math.nan, reason=reason)
            continue
        coupling = estimate([v[name] for v in values], converges[name], ratio)
        whole = _summed(coupling, [v[name] for v in values], rows[name])
        if whole.error is not None and math.isfinite(least := hidden.get(name, 0.0)):
            whole = whole._replace(error=max(whole.error, least))
        found[name] = whole
    return Certified(result, found)


def _diverged(
    figures: Callable[[Result], Mapping[str, float]],
    result: Result,
    values: Mapping[str, float],
    runs: Sequence[Rows],
    ratio: float,
) -> dict[str, str]:
    """The figures that need rows after the runs have diverged, each with the reason why it is refused.

    In a chaotic system two trajectories part exponentially, however close they begin. When their distance
    has reached the size of the attractor, smaller steps do not reduce it, and the difference of two
    figures does not show their error any more.
    """
    begin, columns = divergence(runs, ratio)
    if not columns.any():
        return {}
    reason = f"{DIVERGED} from {begin:.4g} s on"
    for moved in _tried(figures, result, disturbed(result.data, begin, columns)):
        return {name: reason for name, value in values.items() if moved[name] != value}
    return dict.fromkeys(values, reason)


def disturbed(rows: Rows, begin: float, columns: NDArray[np.bool_]) -> Rows:
    """Rows whose columns have other values from the time `begin` [s] on; figures that need them change."""
    changed = rows.copy()
    after = rows[:, 0] >= begin
    changed[np.ix_(after, columns)] *= np.linspace(0.5, 1.5, int(after.sum()))[:, None]
    return changed


def divergence(runs: Sequence[Rows], ratio: float = HALVED) -> tuple[float, NDArray[np.bool_]]:
    """The time [s] from which on the finest two of three runs have diverged, and in which columns.

    The runs, the finest first, have steps whose sizes differ by `ratio`. Trajectories have diverged where,
    over one of STRETCHES stretches of the run, they are on average more than the share FAR_APART of the
    range of a column apart, and that distance is not smaller than between the coarser two, near that
    stretch, by at least the order SLOWEST. The time is infinite, and there is no column, if they have not.
    """
    t = runs[-1][:, 0]
    pieces = np.array_split(np.arange(len(t)), min(STRETCHES, len(t)))
    fine, middle, coarse = (
        np.column_stack([t, *(np.interp(t, rows[:, 0], x) for x in rows.T[1:])]) for rows in runs
    )
    last, before = (
        np.array([np.abs(finer - coarser)[piece].mean(axis=0) for piece in pieces])
        for finer, coarser in ((fine, middle), (middle, coarse))
    )
    least = np.maximum(FAR_APART * np.ptp(fine, axis=0), NEGLIGIBLE * np.abs(fine).max(axis=0))
    padded = np.pad(before, ((NEIGHBOURS, NEIGHBOURS), (0, 0)))
    around = np.max([padded[k : k + len(before)] for k in range(2 * NEIGHBOURS + 1)], axis=0)
    distant = last > least
    diverged = distant & (last > around / ratio**SLOWEST)
    diverged[:, (fine == np.round(fine)).all(axis=0)] = False
    if not diverged.any():
        return math.inf, np.zeros(fine.shape[1], dtype=bool)
    first = int(diverged.any(axis=1).argmax())
    return float(t[pieces[first][0]]), distant[first:].any(axis=0)


def _order(
    figures: Callable[[Result], Mapping[str, float]],
    result: Result,
    values: Mapping[str, float],
    orders: Rows,
) -> dict[str, float]:
    """The order at which each figure converges: the lowest of the columns that change it."""
    most, low = float(orders.max()), orders < orders.max()
    rows = result.data.copy()
    rows[:, low] *= np.linspace(0.5, 1.5, len(rows))[:, None]
    seen = _tried(figures, result, rows) if low.any() else []
    least = float(orders.min())
    return {k: least if seen and seen[0][k] != value else most for k, value in values.items()}


def _hidden(
    figures: Callable[[Result], Mapping[str, float]],
    result: Result,
    values: Mapping[str, float],
    runs: Sequence[Rows],
    orders: Rows,
    ratio: float,
) -> dict[str, float]:
    """How far figures are from those of the rows that the runs tend to, and of rows between them.

    Each value that converges in the three runs is extrapolated to steps of zero by itself. This shows
    what all runs miss alike, such as an extreme next to the start (which is exact in each run) that the
    coupling smoothes away. Rows that not all runs have, as those at events, are moved like their
    neighbours. Empty if most rows are of that kind.
    """
    data, times = runs[0], [np.round(rows[:, 0], TICKS) for rows in runs]
    shared = reduce(np.intersect1d, times)
    if SHARED * len(data) > len(shared):
        return {}
    fine, middle, coarse = (
        rows[np.searchsorted(t, shared)] for rows, t in zip(runs, times, strict=True)
    )
    last, before = fine - middle, middle - coarse
    with np.errstate(all="ignore"):
        falls = np.log(before / last) / math.log(ratio)
    regular = (last * before > 0.0) & (falls >= SLOWEST) & (falls <= orders + FASTER)
    off = np.zeros((2, *data.shape))
    for k in 1 + np.flatnonzero((data != np.round(data))[:, 1:].any(axis=0)):
        left = last[:, k] / (ratio ** orders[k] - 1)
        for found, of in zip(off, (np.where(regular[:, k], left, 0.0), abs(left))):
            found[:, k] = np.interp(times[0], shared, of)
    rows = data + off[0]
    tipped = _tipped(figures, result, data, off[1], values)
    for seen in _tried(figures, result, rows):
        moved = _moved(figures, result, rows, seen)
        return {
            k: max(SAFETY * (abs(seen[k] - value) + moved[k]), tipped[k])
            for k, value in values.items()
        }
    return {}


def _tipped(
    figures: Callable[[Result], Mapping[str, float]],
    result: Result,
    data: Rows,
    off: Rows,
    values: Mapping[str, float],
) -> dict[str, float]:
    """How far figures jump if the highest or the lowest part of each column, all of it or either end, is
    reduced by its error `off`.

    Another peak that is nearly as high, or the other end of a flat one, may in truth be the highest; its
    time is then different. A figure that follows the rows evenly moves half as far for half the reduction;
    that part is not counted.
    """
    found = dict.fromkeys(values, 0.0)
    for sign, ends in product((1.0, -1.0), ((SAFETY, SAFETY), (0.0, 1.0), (1.0, 0.0))):
        cut = np.zeros_like(data)
        for k in range(1, data.shape[1]):
            top = _around_top(sign * data[:, k])
            cut[top, k] = -sign * off[top, k] * np.linspace(*ends, top.stop - top.start)
        for half in _tried(figures, result, data + cut / 2):
            for whole in _tried(figures, result, data + cut):
                for name, value in values.items():
                    found[name] = max(found[name], abs(whole[name] - 2 * half[name] + value))
    return found


def _around_top(x: Rows) -> slice:
    """The rows around the highest, down to where they rise again."""
    top, steps = int(np.argmax(x)), np.diff(x)
    falls, rises = np.flatnonzero(steps[:top] < 0.0), np.flatnonzero(steps[top:] > 0.0)
    return slice(falls[-1] + 1 if len(falls) else 0, top + rises[0] + 1 if len(rises) else len(x))


def by_rows(
    figures: Callable[[Result], Mapping[str, float]], result: Result, values: Mapping[str, float]
) -> dict[str, float | None]:
    """The error of each figure due to the spacing of a result's rows; None if it cannot be determined."""
    thinned = [[_thinned(figures, result, n, i) for i in range(n)] for n in THINNED]
    moved = _moved(figures, result, result.data, values)
    found = {}
    for name, value in values.items():
        second, third = (
            max(_away(value, [v[name] for v in seen]) for seen in group) for group in thinned
        )
        found[name] = _rows(second, third, moved[name])
    return found


def _moved(
    figures: Callable[[Result], Mapping[str, float]],
    result: Result,
    data: Rows,
    values: Mapping[str, float],
) -> dict[str, float]:
    """How far figures move with other rows in place of a result's."""
    shifted = [seen for rows in _others(data) for seen in _tried(figures, result, rows)]
    return {
        name: max((abs(seen[name] - value) for seen in shifted), default=0.0)
        for name, value in values.items()
    }


def _summed(coupling: Estimate, values: Sequence[float], rows: float | None) -> Estimate:
    """The estimate with the error due to the rows added.

    Where the runs differ by no more than that, their differences show no order and count as an error.
    """
    if rows is None:
        return coupling._replace(error=None, reason=UNKNOWN)
    spread = max(values) - min(values)
    if coupling.error is None and spread <= 2 * rows:
        return coupling._replace(error=spread + rows, rows=rows)
    if coupling.error is None:
        return coupling
    return coupling._replace(error=coupling.error + rows, rows=rows)


def _away(value: float, others: Sequence[float]) -> float:
    """How far a figure is from its values with fewer rows, alone or repeated; inf if it has none.

    A figure that counts rows picks different ones where they are not repeated, and is then far off.
    """
    away = [abs(v - value) for v in others if math.isfinite(v)]
    return away[0] if away and away[0] <= FAR * away[-1] else min(away, default=math.inf)


def _rows(second: float, third: float, shifted: float) -> float | None:
    """The error of a figure due to the spacing of the rows: from how far it moves with only every second
    and every third row, n^q - 1 times the error with a q between 1 and 2 that follows from both, and
    with shifted rows.
    """
    if not math.isfinite(second + third + shifted):
        return None
    low, high = ((3**q - 1) / (2**q - 1) for q in (1, 2))
    steepness = (third / second - low) / (high - low) if second else 1.0
    q = 1.0 + min(max(steepness, 0.0), 1.0)
    return SAFETY * max(third / (3**q - 1), second / (2**q - 1), shifted)


def _tried(
    figures: Callable[[Result], Mapping[str, float]], result: Result, rows: Rows
) -> list[Mapping[str, float]]:
    """The figures of these rows in place of the result's; empty if they cannot be computed."""
    with suppress(Exception), np.errstate(all="ignore"):
        return [figures(Result(result.columns, result.units, result.provenance, lambda: rows))]
    return []


def _thinned(
    figures: Callable[[Result], Mapping[str, float]], result: Result, n: int, first: int
) -> list[Mapping[str, float]]:
    """The figures of the rows first, first + n, ..., and the ends: alone, and, for figures that count
    rows, repeated until there are as many as before. Empty if they cannot be computed.
    """
    count = len(result.data)
    kept = np.unique([0, *range(first, count, n), count - 1])
    repeated = kept[np.arange(count) * len(kept) // count]
    return [
        seen for places in (kept, repeated) for seen in _tried(figures, result, result.data[places])
    ]


def _others(data: Rows) -> Iterator[Rows]:
    """Other rows that the result could equally have, on a cubic spline.

    First the ends, and rows a fixed share of the way from each row to the next; columns of whole
    numbers keep the number before. Then all rows, with the first one on the cubic through the next
    four: a start that is not smooth may hide something between the first two rows that no other row
    shows.
    """
    if len(data) >= FEWEST:
        curve = spline(data[:, 0], data)
        whole = (data == np.round(data)).all(axis=0)
        for share in SHIFTED:
            t = (1.0 - share) * data[:-1, 0] + share * data[1:, 0]
            between = curve(t)
            between[:, whole] = data[:-1, whole]
            between[:, 0] = t
            yield np.vstack([data[:1], between, data[-1:]])
        for way in (1, -1):
            yield from _beyond_kinks(data, curve, way)
    t = np.unique(data[:, 0])
    if len(t) > FEWEST and t[1] == data[1, 0]:
        rows, after = data.copy(), data[1 : FEWEST + 1]
        rows[0, 1:] = spline(after[:, 0], after[:, 1:])(rows[0, 0])
        yield rows


def _beyond_kinks(data: Rows, curve: Callable[[Rows], Rows], way: int) -> Iterator[Rows]:
    """The rows, with more of them where a column has a kink between two rows: on the cubic through the
    next four or, with a way of -1, the four before.

    That cubic predicts the row before its four nearly as well as the neighbouring cubics predict theirs,
    unless something has happened in between, such as an impact, after which a dip may be over before the
    next row.
    """
    rows = data[::way]
    t, many = rows[:, 0], len(rows) - CUBIC
    if many <= CALM:
        return

    def told(k: Any, s: Rows) -> Rows:
        """The cubics through rows k + 1 to k + 4 at times s, shape (len(k), columns)."""
        nodes, weights = t[k[:, None] + np.arange(1, CUBIC + 1)], np.ones((len(k), CUBIC))
        for i, j in permutations(range(CUBIC), 2):
            weights[:, j] *= (s - nodes[:, i]) / (nodes[:, j] - nodes[:, i])
        return np.asarray(sum(weights[:, [j]] * rows[k + 1 + j] for j in range(CUBIC)))

    every = np.arange(many)
    off = abs(told(every, t[:many]) - rows[:many])
    calm = np.max([off[n : many - CALM + n] for n in range(1, CALM + 1)], axis=0)
    kinked = off[:-CALM] > np.maximum(KINK * calm, FLAT * np.ptp(rows, axis=0))
    kinked &= (data != np.round(data)).any(axis=0)
    k = np.flatnonzero(kinked.any(axis=1))
    if not len(k):
        return
    more = [data]
    for share in SIDED:
        s = (1.0 - share) * t[k] + share * t[k + 1]
        seen = np.where(kinked[k], told(k, s), curve(s))
        seen[:, 0] = s
        more.append(seen)
    together = np.vstack(more)
    yield together[np.argsort(together[:, 0], kind="stable")]


def summary(result: Result) -> dict[str, float]:
    """The last, smallest, largest and mean value of every column over time."""
    t = result["time"]
    return {
        f"{name}{what}": float(figure(t, result[name]))
        for name in result.columns[1:]
        for what, figure in SUMMARY.items()
    }
