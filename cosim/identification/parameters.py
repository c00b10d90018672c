"""What is fitted: start values of FMUs and quantities of sensors, and what is known of them beforehand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import SetupError
from ..system import ANGLE, Network, Port, declared_start, unit_exponents
from .record import Measurement

Array = NDArray[np.float64]
#: values by name, each with its standard deviation
ValuesWithDeviation = Mapping[str, tuple[float, float]]
#: names of values to fit, with bounds if a mapping
FreeNames = Sequence[str] | Mapping[str, tuple[float, float]]
#: quantities of a sensor that may be fitted: the value of an ideal sensor, and the unit
SENSOR: dict[str, tuple[float, str]] = {"gain": (1.0, "1"), "delay": (0.0, "s"), "zero": (0.0, "")}
#: Half-width of the range of starts, over the size of a value. Chosen: more than a guess that is
#: 20 % off, as those of benchmarks/identify.py are.
RANGE_OVER_SIZE = 0.3
#: Half-width of the range of starts of a value that is measured or known, over its standard deviation.
#: Convention: three standard deviations hold 99.7 % of a normal distribution.
RANGE_OVER_DEVIATION = 3.0
#: Largest delay of a sensor, over the duration of the record. Chosen: so many rows are left out at either end.
LARGEST_DELAY = 0.02
#: Largest distance of a delay from its prior, over the standard deviation of this. Chosen: far outside of what
#: validation accepts, so that the bound never hides a misfit.
DELAY_OVER_DEVIATION = 8.0
#: Rows at the beginning whose median is the guess of a measured start value. Chosen: odd, so that one outlier or
#: two do not matter, and few, so that the value hardly moves meanwhile.
START_ROWS = 5


@dataclass(frozen=True)
class FreeParameter:
    """A value that is fitted, all numbers in its unit.

    It lies between `low` and `high`; the search starts at `guess`, then between `start_low` and `start_high`.
    `size` scales difference steps. `is_angle` says that half a turn more may look alike.
    """

    name: str
    unit: str
    guess: float
    low: float = -math.inf
    high: float = math.inf
    start_low: float = -math.inf
    start_high: float = math.inf
    size: float = 0.0
    is_angle: bool = False


@dataclass(frozen=True)
class Prior:
    """What is known of n values beforehand: names, means of shape (n,), and their covariance, (n, n)."""

    names: Sequence[str]
    mean: Array
    covariance: Array

    @property
    def deviations(self) -> Array:
        """The standard deviations, shape (n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def residuals(self, p: Array) -> Array:
        """How far values p are from the means, in independent standard deviations, shape (n,)."""
        sigma = self.deviations
        factor = np.linalg.cholesky(self.covariance / np.outer(sigma, sigma))
        return np.asarray(np.linalg.solve(factor, (p - self.mean) / sigma))


def independent_prior(values: ValuesWithDeviation) -> Prior:
    """The prior of values that are known one by one; raises SetupError for an invalid value or deviation."""
    for name, (mean, sigma) in values.items():
        if not (math.isfinite(mean) and 0.0 < sigma < math.inf):
            raise SetupError(f"known {name} = {mean!r} +- {sigma!r}: the deviation must be above 0")
    table = np.array([(float(mean), float(sigma)) for mean, sigma in values.values()])
    table = table.reshape(-1, 2)
    return Prior(list(values), table[:, 0], np.diag(table[:, 1] ** 2))


def is_sensor_parameter(name: str) -> bool:
    """Whether a free value belongs to a sensor, as "gain(conveyor.w)" does."""
    return name.partition("(")[0] in SENSOR and name.endswith(")")


def free_parameters(
    network: Network, columns: Sequence[Measurement], names: FreeNames, prior: Prior
) -> list[FreeParameter]:
    """The free parameters of these names; values with a prior are free too.

    Raises SetupError for values that cannot be free: not a number, not settable, or no room to move.
    """
    requested = list(dict.fromkeys([*names, *prior.names]))
    if not requested:
        raise SetupError("no value is free")
    measured = {column.port.name: column for column in columns}
    prior_values = dict(zip(prior.names, zip(prior.mean.tolist(), prior.deviations.tolist())))
    bounds = names if isinstance(names, Mapping) else {}
    parameters = []
    for name in requested:
        if is_sensor_parameter(name):
            parameter = _sensor_parameter(name, measured)
        else:
            parameter = _start_value(network, network.port(name), measured.get(name))
        parameter = _with_start_range(parameter, measured.get(name))
        if name in prior_values:
            parameter = _with_prior(parameter, *prior_values[name])
        if name in bounds:
            parameter = _with_bounds(parameter, *bounds[name])
        parameters.append(_checked(parameter))
    return parameters


def _sensor_parameter(name: str, measured: Mapping[str, Measurement]) -> FreeParameter:
    """Gain, delay or zero of the sensor of a measured column, as of an ideal sensor."""
    kind, _, source = name[:-1].partition("(")
    if source not in measured:
        raise SetupError(f"{name}: {source} is not a measured column, only {', '.join(measured)}")
    column = measured[source]
    guess, unit = SENSOR[kind]
    parameter = FreeParameter(name, unit or column.port.unit, guess)
    if kind == "zero":
        return replace(parameter, size=column.noise.sigma)
    if kind == "delay":
        largest = LARGEST_DELAY * float(np.ptp(column.times))
        return replace(parameter, low=-largest, high=largest, size=largest)
    return parameter


def _start_value(network: Network, port: Port, column: Measurement | None) -> FreeParameter:
    """A start value of an FMU; the guess is that of the system or, without one, of the first rows of its column."""
    variable, name = port.variable, port.name
    settable = variable.causality == "parameter" or variable.initial in ("exact", "approx")
    driven = name in {p.name for p, _ in network.inputs} | {x[1].name for x in network.wires}
    if port.type != "Real" or not settable or variable.variability == "constant" or driven:
        raise SetupError(f"{port} cannot be free: it must be a Real start value that can be set")
    start = {p.name: value for p, value in network.start}.get(name, declared_start(variable))
    guess = float(start or 0.0)
    if column is not None and name not in network.system.start:
        guess = float(np.median(column.values[:START_ROWS]))
    base = network.base_unit(port)
    return FreeParameter(
        name,
        port.unit,
        guess,
        -math.inf if variable.min is None else float(variable.min),
        math.inf if variable.max is None else float(variable.max),
        size=abs(float(variable.nominal or 0.0)),
        is_angle=base is not None and unit_exponents(base) == ANGLE and base.factor == 1.0,
    )


def _with_start_range(parameter: FreeParameter, column: Measurement | None) -> FreeParameter:
    """The size, from the guess where it is not 0, and the range of starts about the guess."""
    guess = parameter.guess
    size = abs(guess) or parameter.size or 1.0
    half_width = math.pi if parameter.is_angle else RANGE_OVER_SIZE * size
    if column is not None:
        half_width = RANGE_OVER_DEVIATION * column.noise.sigma
    return replace(
        parameter, size=size, start_low=guess - half_width, start_high=guess + half_width
    )


def _with_prior(parameter: FreeParameter, mean: float, deviation: float) -> FreeParameter:
    """Guess, size and range of starts that follow from a prior; a delay also gets its bounds from it."""
    half_width = RANGE_OVER_DEVIATION * min(
        deviation, RANGE_OVER_SIZE * max(abs(mean), min(deviation, parameter.size))
    )
    parameter = replace(
        parameter,
        guess=mean,
        size=max(abs(mean), min(deviation, parameter.size)),
        start_low=mean - half_width,
        start_high=mean + half_width,
    )
    if is_sensor_parameter(parameter.name) and parameter.name.startswith("delay("):
        largest = DELAY_OVER_DEVIATION * deviation
        return replace(parameter, low=mean - largest, high=mean + largest)
    return parameter


def _with_bounds(parameter: FreeParameter, first: float, last: float) -> FreeParameter:
    """Bounds that a user gives; the starts lie between them."""
    low, high = float(first), float(last)
    if not parameter.low <= low < high <= parameter.high:
        raise SetupError(
            f"{parameter.name} cannot move from {low!r} to {high!r} {parameter.unit}: its bounds must "
            f"rise and lie between {parameter.low!r} and {parameter.high!r}"
        )
    return replace(parameter, low=low, high=high, start_low=low, start_high=high)


def _checked(parameter: FreeParameter) -> FreeParameter:
    """The parameter with its starts inside its bounds; raises SetupError if the guess is not."""
    low, high, unit = parameter.low, parameter.high, parameter.unit
    if not low <= parameter.guess <= high:
        where = f"at least {low!r}" if high == math.inf else f"between {low!r} and {high!r}"
        raise SetupError(f"{parameter.name} = {parameter.guess!r} {unit} must be {where} {unit}")
    return replace(
        parameter,
        start_low=max(parameter.start_low, low),
        start_high=min(parameter.start_high, high),
    )
