"""Fit a system to a record of a machine, and say how far the values and what follows can be trusted.

The way is a sequence of steps, each a function from a frozen record to the next one:
`prepare` (problem), `fit` (minima), `refine` (linearisation), `validate` (misfit), `estimate_intervals`; `advise`
takes what comes out and plans the next record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Unpack

import numpy as np

from ..errors import SetupError
from ..result import Result
from ..series import Series
from ..system import System, connect
from .fit import SearchPlan, fit
from .intervals import Interval, estimate_intervals
from .linearisation import DEVIATIONS, Linearisation, refine
from .parameters import (
    Array,
    FreeNames,
    Prior,
    ValuesWithDeviation,
    free_parameters,
    independent_prior,
    is_sensor_parameter,
)
from .problem import (
    DerivedFunction,
    DerivedQuantity,
    Problem,
    SimulationSettings,
    prepare,
    require_runnable_guess,
)
from .record import measured_columns
from .residual import ColumnResidual
from .validation import validate

#: a quantity that depends on the values by name only
ValueFunction = Callable[[Mapping[str, float]], float]
#: Largest number of starts. Chosen: each of a few minima is met by one of them.
STARTS = 12
#: Step of the differences of a quantity, over the standard deviation or the size of a value. Chosen: far below what
#: the record distinguishes, far above the rounding of doubles.
GRADIENT_STEP = 1e-3


@dataclass(frozen=True)
class Identified:
    """What a record shows about a machine, or why it shows nothing.

    `misfit` is a list of sentences. If there are any, no machine of this kind fits, and `values` and
    `derived` are empty. `correlations` are those of the free values, in the order of `names`;
    `correlated_groups` are groups of them that the record cannot distinguish; `notes` are further remarks.
    `minima` are the values of chi2 that the starts reached, smallest first. `result` is the run of the fit,
    with steps of `step` [s].
    """

    values: Mapping[str, Interval]
    derived: Mapping[str, Interval]
    misfit: Sequence[str]
    names: Sequence[str]
    correlations: Array
    correlated_groups: Sequence[Sequence[str]]
    notes: Sequence[str]
    residuals: Mapping[str, ColumnResidual]
    chi2: float
    dof: int
    band: tuple[float, float]
    minima: Sequence[float]
    result: Result
    step: float
    runs: int
    problem: Problem = field(repr=False)
    linearisation: Linearisation = field(repr=False)

    @property
    def start_values(self) -> dict[str, float]:
        """All start values of the fitted system that are numbers, also where no machine of this kind fits."""
        return self.problem.start_values(self.linearisation.p)

    def is_machine_parameter(self, name: str) -> bool:
        """Whether the free value `name` is a parameter of the machine, not of this record only."""
        if is_sensor_parameter(name):
            return False
        return bool(connect(self.problem.system).port(name).variable.causality == "parameter")

    def prior(self, *without: str) -> Prior:
        """The machine's parameters as identified from this record, with their covariance.

        They serve to identify another record of the machine; `without` names those to omit, such as a
        supply that has changed.
        """
        indices = [
            k
            for k, name in enumerate(self.names)
            if self.is_machine_parameter(name) and name not in without
        ]
        covariance = self.linearisation.covariance[np.ix_(indices, indices)]
        return Prior([self.names[k] for k in indices], self.linearisation.p[indices], covariance)

    def gradient(self, quantity: ValueFunction) -> Array:
        """The gradient, shape (n,), of a `quantity` that depends on the values only, by the n free values."""
        problem, p = self.problem, self.linearisation.p
        deviations = np.sqrt(np.diag(self.linearisation.covariance))
        steps = GRADIENT_STEP * np.minimum(deviations, problem.sizes)
        below, above = (
            np.array([quantity(problem.start_values(p + sign * step)) for step in np.diag(steps)])
            for sign in (-1.0, 1.0)
        )
        return np.asarray((above - below) / (2 * steps), float)

    def interval(self, quantity: ValueFunction, unit: str = "") -> Interval:
        """The interval of a `quantity` in a `unit`, by the covariance of the values.

        The quantity depends on the values only, such as a limit does.
        """
        gradient = self.gradient(quantity)
        value = float(quantity(self.start_values))
        half_width = self.linearisation.half_width(gradient)
        error = half_width + self.linearisation.coupling_error(gradient)
        return Interval(value, value - error, value + error, half_width / DEVIATIONS, unit)

    def text(self) -> str:
        """The answer in lines."""
        if self.misfit:
            return "\n".join(["No machine of this kind fits:", *(f"  {x}" for x in self.misfit)])
        lines = [f"{name} = {x.text()}" for name, x in {**self.derived, **self.values}.items()]
        return "\n".join([*lines, *self.notes])


def identify(
    system: System,
    record: Mapping[str, Series],
    *,
    free: FreeNames,
    prior: ValuesWithDeviation | Prior | None = None,
    derived: Mapping[str, DerivedFunction] | None = None,
    units: Mapping[str, str] | None = None,
    noise: Mapping[str, float] | None = None,
    first: Sequence[str] = (),
    outliers: float = 0.0,
    starts: int = STARTS,
    begin: float | None = None,
    step: float | None = None,
    seed: int = 0,
    **settings: Unpack[SimulationSettings],
) -> Identified:
    """Fit start values and parameters of a system's FMUs to a record.

    Besides start values of FMUs, "gain(conveyor.w)", "delay(conveyor.w)" [s] and "zero(conveyor.w)" may be free:
    those of a sensor that shows gain * w(t - delay) + zero. Steps are halved until the coupling moves nothing by
    more than a tenth of its interval.

    Parameters
    ----------
    system:
        The machine with its first guess: the start values.
    record:
        Measured columns by the outputs that they measure, each with its own times [s].
    free:
        The values to be fitted, with bounds if it is a mapping.
    prior:
        Values and standard deviations of what is known beforehand, or what another record gave
        (`Identified.prior`); these values are free too.
    derived:
        Functions of all values and of the fitted run, such as a resonance.
    units:
        The units of `derived`.
    noise:
        Standard deviations of columns in the units of their variables, by default estimated from the rows.
    first:
        Values, such as an angle at the start and the supply, that are fitted before the rest, from each of several
        starts.
    outliers:
        The share of rows of a column that may be outliers.
    starts:
        The largest number of starts.
    begin:
        When runs begin [s], by default with the first row of all.
    step:
        The first step of runs [s], by default the spacing of the rows.
    seed:
        Of the random starts.
    settings:
        Those of `run`.

    Raises
    ------
    SetupError
        For a record or values that cannot be used, and what `run` raises at the guess.
    """
    network = connect(system)
    columns = measured_columns(network, record, noise or {})
    beforehand = prior if isinstance(prior, Prior) else independent_prior(prior or {})
    parameters = free_parameters(network, columns, free, beforehand)
    names = [parameter.name for parameter in parameters]
    for name in first:
        if name not in names:
            raise SetupError(f"first: {name} is not free, only {', '.join(names)}")
    quantities = [
        DerivedQuantity(name, function, (units or {}).get(name, ""))
        for name, function in (derived or {}).items()
    ]
    problem = prepare(
        network, columns, parameters, beforehand, quantities, begin=begin, step=step, **settings
    )
    require_runnable_guess(problem)
    plan = SearchPlan([names.index(name) for name in first], starts, seed)
    return _solve(problem, plan, outliers)


def _solve(problem: Problem, plan: SearchPlan, outliers: float) -> Identified:
    """Take the steps from a problem to what is known of its machine."""
    fitted = fit(problem, plan, outliers)
    refined = refine(fitted)
    validation = validate(refined)
    intervals = estimate_intervals(refined, validation, fitted.minima)
    notes = list(fitted.notes)
    if not validation.misfit:
        notes += [
            f"The record cannot distinguish {', '.join(group)} from each other."
            for group in intervals.correlated_groups
        ]
    for column in refined.problem.columns:
        notes.append(
            f"Noise of {column.port.name}: {column.noise.sigma:.3g} {column.port.unit}, {column.noise.source}."
        )
    # one run is that of the guess
    return Identified(
        values=intervals.values,
        derived=intervals.derived,
        misfit=intervals.misfit,
        names=refined.problem.names,
        correlations=intervals.correlations,
        correlated_groups=intervals.correlated_groups,
        notes=notes,
        residuals=validation.residuals,
        chi2=refined.linearisation.chi2,
        dof=validation.band.dof,
        band=(validation.band.low, validation.band.high),
        minima=[minimum.chi2 for minimum in fitted.minima],
        result=validation.result,
        step=refined.problem.step,
        runs=1 + fitted.runs + refined.runs + validation.runs + intervals.runs,
        problem=refined.problem,
        linearisation=refined.linearisation,
    )
