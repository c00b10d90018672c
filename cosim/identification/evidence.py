"""What a fit is worth: intervals, values that cannot be separated, and whether the model fits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.signal import lombscargle
from scipy.sparse.csgraph import connected_components

from ..errors import SetupError
from ..result import SimulationError
from .model import CENTRAL, Derived, Model, Vector
from .record import Column, Noise, segments

INSIDE = 0.95
DEVIATIONS = float(stats.norm.ppf(0.5 + INSIDE / 2))
RISE = DEVIATIONS**2
DOUBT = 1e-3
ALIKE = 0.95
PASSES, TARGETS, MOST_WIDE, NEAR = 4, 3, 8.0, 0.03
SAFETY, FAR, BEYOND = 1.5, 3.3, 3.0
SEGMENTS = 8
SINGULAR = 1e-12


class Interval(NamedTuple):
    """A value with the ends of its 95 % interval and its standard deviation, in its unit.

    The ends are those of the profile likelihood where it was followed, else of the covariance. They
    include the coupling error.
    """

    value: float
    low: float
    high: float
    deviation: float
    unit: str = ""

    @property
    def error(self) -> float:
        """The farther of the ends from the value."""
        return max(self.high - self.value, self.value - self.low)

    def text(self) -> str:
        """The value and its interval, rounded to two digits of this."""
        if not 0.0 < self.error < math.inf:
            return f"{self.value:.6g} {self.unit} (not determined)".replace("  ", " ")
        places = max(0, 1 - math.floor(math.log10(self.error)))
        return f"{self.value:.{places}f} +- {self.error:.{places}f} {self.unit}".rstrip()


class Residual(NamedTuple):
    """A column and its fit: times [s]; measured values, fitted values and noise in its unit; and the
    spectrum of the residual over frequencies [Hz], in units of that of the noise.
    """

    unit: str
    times: Vector
    measured: Vector
    fitted: Vector
    sigma: float
    noise: str
    frequencies: Vector
    power: Vector

    @property
    def top(self) -> float:
        """The frequency [Hz] above which neither the machine nor a similar one moves the column: a multiple
        of the frequency up to which the fitted values stand out from the noise.
        """
        t = (self.times - self.times[0]) / float(np.ptp(self.times))
        window = np.sin(math.pi * t) ** 2
        moved = window * (self.fitted - np.average(self.fitted, weights=window)) / self.sigma
        power = spectrum(self.times, moved)[1] / float(np.mean(window**2))
        return BEYOND * float(self.frequencies[power > 1.0].max(initial=self.frequencies[0]))

    @property
    def chi2(self) -> float:
        """The sum of squares of the residual over the noise."""
        return float(np.sum(((self.fitted - self.measured) / self.sigma) ** 2))


class Local(NamedTuple):
    """A minimum and its neighbourhood: free values p, residuals, their Jacobian J, the covariance of p,
    and derived quantities with their gradients; `moved` is how far p moves with a half and a quarter of
    the step, and `order` how fast that falls.
    """

    p: Vector
    residuals: Vector
    J: Vector
    covariance: Vector
    derived: Vector
    gradients: Vector
    moved: Vector
    order: float

    @property
    def chi2(self) -> float:
        return float(np.sum(self.residuals**2))

    def reach(self, g: Vector) -> float:
        """The half-width of the 95 % interval of a quantity with gradient g."""
        return DEVIATIONS * math.sqrt(max(0.0, float(g @ self.covariance @ g)))

    def coupling(self, g: Vector) -> float:
        """The error of that quantity from the coupling and from the spacing of the rows of the runs."""
        half, quarter = (self.moved @ g).tolist()
        return float(SAFETY * (abs(quarter) + abs(quarter - half) / (2.0**self.order - 1.0)))


Look = Callable[[Vector], tuple[Vector, Vector]]


def looking(model: Model, derived: Mapping[str, Derived]) -> Look:
    """What a run with free values p gives: residuals and derived quantities."""

    def look(p: Vector) -> tuple[Vector, Vector]:
        result = model.play(p, all=bool(derived))
        values = model.values(p)
        told = [float(tell(values, result)) for tell in derived.values()]
        return model.whole(p, model.shown(p, result)), np.array(told)

    return look


def close_by(model: Model, p: Vector, look: Look, order: float) -> Local:
    """The minimum at p, from central differences; from one side where the FMUs refuse the other."""
    residuals, told = look(p)
    columns, gradients = [], []
    for k, free in enumerate(model.free):
        ends = []
        for sign in (-1.0, 1.0):
            moved = p.copy()
            moved[k] = min(max(p[k] + sign * CENTRAL * free.size, free.low), free.high)
            try:
                ends.append((moved[k], *look(moved)))
            except (SimulationError, SetupError):
                ends.append((p[k], residuals, told))
        (a, r, d), (b, s, e) = ends
        columns.append((s - r) / ((b - a) or 1.0))
        gradients.append((e - d) / ((b - a) or 1.0))
    J = np.stack(columns, axis=1)
    C = covariance(J)
    finer = [model.play(p, model.step / n) for n in (2.0, 4.0)]
    off = np.array([residuals - model.whole(p, model.shown(p, run)) for run in finer])
    return Local(p, residuals, J, C, told, np.stack(gradients, axis=1), off @ J @ C, order)


def covariance(J: Vector) -> Vector:
    """The covariance of the free values, shape (n, n); huge for those that do not affect the residuals."""
    norms = np.linalg.norm(J, axis=0)
    scale = 1.0 / np.where(norms > 0.0, norms, 1.0)
    _, s, right = np.linalg.svd(J * scale, full_matrices=False)
    weak = np.maximum(s, SINGULAR * max(float(s[0]), 1e-300))
    half = (right.T / weak) * scale[:, None]
    return np.asarray(half @ half.T)


def correlation(covariance: Vector) -> Vector:
    """The correlations of a covariance, both of shape (n, n)."""
    deviations = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviations, deviations))


def profile(
    model: Model, local: Local, look: Look, g: Vector, tell: Callable[[Vector, Vector], float]
) -> tuple[float, float]:
    """The ends of the range of a quantity with gradient g, a function of free values and derived
    quantities, in which chi2 rises by no more than RISE while everything else is fitted again.

    An end that is not found stays at the last value that was tried.
    """
    reach, (low, high) = local.reach(g), model.bounds
    start, ends = tell(local.p, local.derived), []

    def held(target: float) -> float:
        """The least chi2 with the quantity held at its target; inf where the FMUs refuse."""
        p, residuals, J, C = local.p, local.residuals, local.J, local.covariance
        value, best = start, math.inf
        for turn in range(PASSES):
            direction = C @ g
            move = direction * (target - value) / (g @ direction)
            if turn:
                free = -C @ (J.T @ residuals)
                move += free - direction * (g @ free) / (g @ direction)
            p = np.clip(p + move, low, high)
            try:
                residuals, derived = look(p)
            except (SimulationError, SetupError):
                return math.inf
            value, chi2 = tell(p, derived), float(np.sum(residuals**2))
            if not math.isfinite(value):
                return math.inf
            if abs(chi2 - best) < NEAR:
                break
            best = min(best, chi2)
            if turn == 1:
                J = model.jacobian(p)
                C = covariance(J)
        return min(best, chi2)

    for sign in (-1.0, 1.0):
        away = reach
        for _ in range(TARGETS):
            rise = held(start + sign * away) - local.chi2
            if not 0.0 < rise < 1e3:
                break
            ratio = math.sqrt(RISE / rise)
            away = min(away * min(max(ratio, 0.25), 4.0), MOST_WIDE * reach)
            if abs(ratio - 1.0) < NEAR:
                break
        ends.append(start + sign * away)
    return ends[0], ends[1]


def residuals(model: Model, shown: Sequence[Vector]) -> dict[str, Residual]:
    """The columns beside what the model shows of them."""
    found = {}
    for column, x in zip(model.columns, shown):
        port, times, values, noise = column
        power = spectrum(times, (x - values) / noise.sigma)
        found[column.name] = Residual(port.unit, times, values, x, noise.sigma, noise.told, *power)
    return found


def spectrum(times: Vector, residual: Vector) -> tuple[Vector, Vector]:
    """Frequencies [Hz] and the power of a residual there, which is 1 on average for white noise of
    variance 1, over even rows and over uneven ones (Lomb and Scargle).
    """
    gaps = np.diff(times)
    even = bool(np.abs(gaps / gaps.mean() - 1.0).max() < 1e-3)
    mean = float(gaps.mean() if even else np.median(gaps))
    span = float(times[-1] - times[0]) + mean
    number = (min(len(times), round(span / mean)) + 1) // 2
    frequencies = np.arange(1, max(2, number)) / span
    if even:
        power = np.abs(np.fft.rfft(residual)) ** 2 / len(times)
        return frequencies, np.asarray(power[1 : len(frequencies) + 1], float)
    return frequencies, np.asarray(lombscargle(times, residual, 2 * math.pi * frequencies), float)


def band(columns: Sequence[Column], known: int, unknown: int) -> tuple[int, float, float]:
    """Degrees of freedom, and the band in which chi2 lies for all but a share DOUBT of the records of a
    machine of this kind, with white noise.
    """
    rows = sum(len(column.times) for column in columns)
    dof = rows + known - unknown
    variance = sum(len(c.times) * c.noise.spread for c in columns) + 2 * known - 2 * unknown
    like = 2.0 * dof**2 / max(variance, 1.0)
    low, high = (float(stats.chi2.ppf(q, like)) * dof / like for q in (DOUBT / 2, 1 - DOUBT / 2))
    return dof, low, high


def misfits(model: Model, local: Local, seen: Mapping[str, Residual]) -> Iterator[str]:
    """Why no machine of this kind fits, and where the misfit is; empty if one does."""
    known = len(model.prior.names)
    dof, low, high = band(model.columns, known, len(model.free))
    where = [text for column in model.columns for text in _where(column, seen[column.name])]
    if local.chi2 > high:
        yield (
            f"chi2 = {local.chi2:.4g} for {dof} degrees of freedom is above its 99.9 % band, which "
            f"ends at {high:.4g}"
        )
    powers = [x.power[x.frequencies <= x.top] for x in seen.values()]
    bins = sum(map(len, powers)) - (len(model.free) - known) / 2
    slow = sum(float(power.sum()) for power in powers)
    if slow > float(stats.gamma.isf(DOUBT, max(bins, 1.0))):
        k = int(np.argmax([power.mean() for power in powers]))
        name, x = list(seen.items())[k]
        yield (
            f"{name}: up to {x.top:.4g} Hz, where the machine moves, the residual has "
            f"{powers[k].mean():.3g} times the power of the noise"
        )
    if local.chi2 < low:
        yield (
            f"chi2 = {local.chi2:.4g} for {dof} degrees of freedom is below its 99.9 % band, which "
            f"begins at {low:.4g}: the noise is smaller"
        )
    yield from (text for text, certain in where if certain or local.chi2 > high)
    for name, x, sigma in zip(model.prior.names, model.prior.mean, model.prior.deviations):
        k = model.names.index(name)
        off = abs(local.p[k] - x) / sigma
        if off > FAR:
            yield (
                f"{name} would be {local.p[k]:.5g} {model.free[k].unit}, {off:.1f} standard deviations from "
                f"the known {x:.5g}"
            )


def overrated(model: Model, local: Local) -> bool:
    """Where a column's residuals are smaller than the noise estimated from its rows, as for a counter with
    alternating errors, take the noise from the residuals; whether there are such columns.
    """
    share = 1.0 - len(model.free) / sum(len(column.times) for column in model.columns)
    found, first = [], 0
    for column in model.columns:
        r = local.residuals[first : first + len(column.times)]
        first += len(r)
        dof, low, _ = band([column], 0, 0)
        less = float(np.mean(r**2)) / share
        if not column.noise.given and less * dof < low:
            why = "that of the residual, since the errors of neighbouring rows are not independent"
            column = column._replace(noise=Noise(column.noise.sigma * math.sqrt(less), why))
        found.append(column)
    changed = any(new is not old for new, old in zip(found, model.columns))
    model.columns, model._last = found, None
    return changed


def _where(column: Column, seen: Residual) -> Iterator[tuple[str, bool]]:
    """Where a residual is not white noise, and whether that finding is certain by itself."""
    name, r = column.name, (seen.fitted - seen.measured) / seen.sigma
    reached = seen.frequencies <= seen.top
    k = int(np.argmax(seen.power * reached))
    if seen.power[k] > math.log(len(seen.power) / DOUBT):
        f, amplitude = float(seen.frequencies[k]), 2.0 * math.sqrt(float(seen.power[k]) / len(r))
        swings = f"oscillates at {f:.4g} Hz ({2 * math.pi * f:.4g} rad/s) with an amplitude of"
        size = f"{seen.sigma * amplitude:.3g} {seen.unit}".rstrip()
        yield f"{name}: the residual {swings} {size}", True
    for rows in segments(column.times, SEGMENTS):
        x = r[rows]
        off = (float(np.sum(x**2)) - len(x)) / math.sqrt(len(x) * max(column.noise.spread, 2.0))
        if off > 4.0:
            first, last = column.times[rows][[0, -1]]
            ratio, span = math.sqrt(float(np.mean(x**2))), f"from {first:.4g} s to {last:.4g} s"
            yield f"{name}: {span} the residual is {ratio:.1f} times the noise", False


def alike(names: Sequence[str], correlations: Vector) -> list[list[str]]:
    """Groups of free values that a record cannot distinguish: each is almost a function of the others."""
    count, label = connected_components(np.abs(correlations) > ALIKE)
    groups = [[name for name, mine in zip(names, label) if mine == k] for k in range(count)]
    return [group for group in groups if len(group) > 1]
