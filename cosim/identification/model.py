"""A system as a function of free values: what its measured columns would show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SetupError
from ..fmu.messages import quiet
from ..master import run
from ..metrics import spline
from ..result import Result, SimulationError
from ..system import ANGLE, Network, System, Value, connect, declared_start, unit_exponents
from .record import Column

Vector = NDArray[np.float64]
Derived = Callable[[Mapping[str, float], Result], float]
Known = Mapping[str, tuple[float, float]]
Sought = Sequence[str] | Mapping[str, tuple[float, float]]
SENSOR: dict[str, tuple[float, str]] = {"gain": (1.0, "1"), "delay": (0.0, "s"), "zero": (0.0, "")}
FORWARD, CENTRAL = 1e-5, 1e-4
WIDTH, DEVIATIONS, ROOM = 0.3, 3.0, 0.02
LOST = 1e6


class Free(NamedTuple):
    """A value that is sought: its unit, its first guess, between which bounds it lies, between which it
    is drawn, its size, on which steps of it are taken, and whether it is an angle.
    """

    name: str
    unit: str
    guess: float
    low: float
    high: float
    drawn: tuple[float, float]
    size: float
    turns: bool


class Prior(NamedTuple):
    """What is known of values beforehand: names, means, and their covariance."""

    names: Sequence[str]
    mean: Vector
    covariance: Vector

    @property
    def deviations(self) -> Vector:
        """The standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def residuals(self, p: Vector) -> Vector:
        """How far values are from what is known, in independent standard deviations."""
        sigma = self.deviations
        factor = np.linalg.cholesky(self.covariance / np.outer(sigma, sigma))
        return np.asarray(np.linalg.solve(factor, (p - self.mean) / sigma))


def independent(known: Known) -> Prior:
    """What is known of values one by one; raises SetupError for an invalid value or deviation."""
    for name, (mean, sigma) in known.items():
        if not (math.isfinite(mean) and 0.0 < sigma < math.inf):
            raise SetupError(f"known {name} = {mean!r} +- {sigma!r}: the deviation must be above 0")
    told = np.array([(float(mean), float(sigma)) for mean, sigma in known.values()]).reshape(-1, 2)
    return Prior(list(known), told[:, 0], np.diag(told[:, 1] ** 2))


@dataclass
class Model:
    """What a system's measured columns show with free values, and what is known of these beforehand.

    Residuals are in standard deviations of the noise, those of the prior last.
    """

    system: System
    columns: Sequence[Column]
    free: Sequence[Free]
    prior: Prior
    step: float
    span: tuple[float, float]
    settings: Mapping[str, Any]
    runs: int = 0
    _last: tuple[bytes, Vector] | None = field(default=None, repr=False)

    @property
    def names(self) -> list[str]:
        """Of the free values."""
        return [free.name for free in self.free]

    @property
    def guess(self) -> Vector:
        return np.array([free.guess for free in self.free])

    @property
    def sizes(self) -> Vector:
        return np.array([free.size for free in self.free])

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        return np.array([f.low for f in self.free]), np.array([f.high for f in self.free])

    def values(self, p: Vector) -> dict[str, float]:
        """All start values of the system that are numbers, with the free ones in their place."""
        given = {k: float(v) for k, v in self.system.start.items() if isinstance(v, int | float)}
        return given | dict(zip(self.names, p.tolist()))

    def play(self, p: Vector, step: float | None = None, *, all: bool = False) -> Result:
        """A run with free values p over the record; raises what `run` does where its FMUs refuse them."""
        own = {n: v for n, v in zip(self.names, p.tolist()) if not sensor(n)}
        self.runs += 1
        system = replace(self.system, start={**self.system.start, **own})
        (start, stop), names = self.span, list(dict.fromkeys(c.name for c in self.columns))
        how = {"step": step or self.step, "record": None if all else names, **self.settings}
        with quiet():
            return run(system, start=start, stop=stop, **how)

    def shown(self, p: Vector, result: Result) -> list[Vector]:
        """What the sensors of the columns show of a run, at the times of their rows."""
        told = dict(zip(self.names, p.tolist()))
        seen = []
        for column in self.columns:
            gain, delay, zero = (
                told.get(f"{what}({column.name})", start) for what, (start, _) in SENSOR.items()
            )
            t, x = result["time"], result[column.name]
            at = column.times - delay
            same = len(t) == len(at) and np.abs(t - at).max() < 1e-9 * (t[1] - t[0])
            seen.append(gain * (x if same else spline(t, x)(at)) + zero)
        return seen

    def residuals(self, p: Vector) -> Vector:
        """Model less measurement over noise by column, then the prior's; LOST where the FMUs refuse."""
        key = p.tobytes() + repr(self.step).encode()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        try:
            shown = self.shown(p, self.play(p))
        except (SimulationError, SetupError):
            shown = [np.full(len(c.times), LOST) for c in self.columns]
        found = self.whole(p, shown)
        self._last = key, found
        return found

    def whole(self, p: Vector, shown: Sequence[Vector]) -> Vector:
        """The residuals of what is shown with free values p."""
        places = [self.names.index(name) for name in self.prior.names]
        each = [(x - c.values) / c.noise.sigma for c, x in zip(self.columns, shown)]
        found = np.concatenate([*each, self.prior.residuals(p[places])])
        return np.where(np.isfinite(found), np.clip(found, -LOST, LOST), LOST)

    def jacobian(self, p: Vector, which: Sequence[int] | None = None) -> Vector:
        """Of the residuals by the free values, or by some of them, from forward differences."""
        base = self.residuals(p)
        kept = self._last
        columns = []
        for k in range(len(p)) if which is None else which:
            moved, step = p.copy(), FORWARD * self.free[k].size
            moved[k] += step * (1.0 if self.free[k].high - p[k] > step else -1.0)
            columns.append((self.residuals(moved) - base) / (moved[k] - p[k]))
        self._last = kept
        return np.stack(columns, axis=1)


def sensor(name: str) -> bool:
    """Whether a free value is one of a sensor, "gain(conveyor.w)"."""
    return name.partition("(")[0] in SENSOR and name.endswith(")")


def frees(network: Network, columns: Sequence[Column], names: Sought, known: Prior) -> list[Free]:
    """The free values of these names; known values are free too.

    Raises SetupError for values that cannot be free: not a number, not settable, or no room to move.
    """
    wanted = list(dict.fromkeys([*names, *known.names]))
    if not wanted:
        raise SetupError("no value is free")
    measured = {column.name: column for column in columns}
    told = dict(zip(known.names, zip(known.mean.tolist(), known.deviations.tolist())))
    return [_free(name, network, measured, names, told) for name in wanted]


def _free(
    name: str, network: Network, measured: Mapping[str, Column], names: Sought, known: Known
) -> Free:
    low, high, guess, unit, size, turn = -math.inf, math.inf, 0.0, "", 0.0, False
    if sensor(name):
        what, _, of = name[:-1].partition("(")
        if of not in measured:
            raise SetupError(f"{name}: {of} is not a measured column, only {', '.join(measured)}")
        guess, unit = SENSOR[what]
        unit = unit or measured[of].port.unit
        if what == "zero":
            size = measured[of].noise.sigma
        if what == "delay":
            span = float(np.ptp(measured[of].times))
            low, high, size = -ROOM * span, ROOM * span, ROOM * span
    else:
        port = network.port(name)
        variable = port.variable
        settable = variable.causality == "parameter" or variable.initial in ("exact", "approx")
        driven = name in {p.name for p, _ in network.inputs} | {x[1].name for x in network.wires}
        if port.type != "Real" or not settable or variable.variability == "constant" or driven:
            raise SetupError(
                f"{port} cannot be free: it must be a Real start value that can be set"
            )
        given: dict[str, Value] = {p.name: value for p, value in network.start}
        own = given.get(name, declared_start(variable))
        low = low if variable.min is None else float(variable.min)
        high = high if variable.max is None else float(variable.max)
        guess, unit = float(own or 0.0), port.unit
        if name in measured and name not in network.system.start:
            guess = float(np.median(measured[name].values[:5]))
        size = abs(float(variable.nominal or 0.0))
        base = network.base_unit(port)
        turn = base is not None and unit_exponents(base) == ANGLE and base.factor == 1.0
    size = abs(guess) or size or 1.0
    aside = math.pi if turn else WIDTH * size
    drawn = guess - aside, guess + aside
    if name in measured:
        off = DEVIATIONS * measured[name].noise.sigma
        drawn = (guess - off, guess + off)
    if name in known:
        guess, deviation = known[name]
        size = max(abs(guess), min(deviation, size))
        off = DEVIATIONS * min(deviation, WIDTH * size)
        drawn = (guess - off, guess + off)
        if sensor(name) and name.startswith("delay("):
            low, high = guess - 8 * deviation, guess + 8 * deviation
    if isinstance(names, Mapping) and name in names:
        first, last = map(float, names[name])
        if not low <= first < last <= high:
            raise SetupError(
                f"{name} cannot move from {first!r} to {last!r} {unit}: its bounds must rise "
                f"and lie between {low!r} and {high!r}"
            )
        low, high = first, last
        drawn = (low, high)
    if not low <= guess <= high:
        raise SetupError(f"{name} = {guess!r} {unit} must lie between {low!r} and {high!r} {unit}")
    drawn = max(drawn[0], low), min(drawn[1], high)
    return Free(name, unit, guess, low, high, drawn, size, turn)


def build(
    system: System,
    columns: Sequence[Column],
    free: Sequence[Free],
    prior: Prior,
    step: float | None,
    settings: Mapping[str, Any],
    begin: float | None = None,
) -> Model:
    """The model; its step is the median spacing of the record's rows unless a step [s] is given.

    It begins with the first row of all, or before it. Rows of a delayed column that may show what was
    before the begin or after the last row are left out.
    """
    first, last = min(float(c.times[0]) for c in columns), max(float(c.times[-1]) for c in columns)
    if begin is not None and not begin <= first:
        raise SetupError(f"begin = {begin!r} s must not be after the first row, at {first!r} s")
    span = first if begin is None else begin, last
    kept = []
    for column in columns:
        delay = next((f for f in free if f.name == f"delay({column.name})"), None)
        low, high = (delay.low, delay.high) if delay else (0.0, 0.0)
        inside = (column.times - high >= span[0]) & (column.times - low <= span[1])
        kept.append(column._replace(times=column.times[inside], values=column.values[inside]))
    rows = min(float(np.median(np.diff(column.times))) for column in columns)
    return Model(system, kept, free, prior, step or rows, span, settings)


def checked(model: Model) -> None:
    """Run the guess once, so that a refusal by the FMUs or the master is reported unchanged."""
    connect(model.system)
    try:
        model.play(model.guess)
    except SimulationError as error:
        raise SetupError(f"the first guess cannot be run: {error}") from error
    rows, unknown = sum(len(c.times) for c in model.columns), len(model.free)
    if rows <= unknown:
        raise SetupError(
            f"the record has {rows} rows, fewer than are needed for {unknown} free values"
        )
