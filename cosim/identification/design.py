"""The last step: which record to make next, by how far each of several possible ones would narrow an interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..series import Series
from ..system import Value, connect
from .identify import Identified, ValueFunction
from .linearisation import DEVIATIONS
from .noise import Noise
from .parameters import Array, independent_prior, is_sensor_parameter
from .problem import Evaluator, Problem
from .record import Measurement


class Experiment(NamedTuple):
    """A record that might be made.

    It has start values that replace the identified ones, the noise of each column in its unit, its
    duration [s], the free parameters that apply to this record only, such as a supply, and inputs that
    replace those of the system.
    """

    start: Mapping[str, Value]
    noise: Mapping[str, float]
    stop: float
    specific: Sequence[str] = ()
    inputs: Mapping[str, Series | Callable[[float], float]] = MappingProxyType({})


class Advice(NamedTuple):
    """An experiment by its name, and the half-width of the interval after it."""

    name: str
    error: float


def advise(
    fit: Identified, experiments: Mapping[str, Experiment], quantity: ValueFunction
) -> list[Advice]:
    """Predict how well a quantity of the values would be known after each experiment, the best first.

    The Fisher information of each record, simulated with the identified values and the present spacing
    of rows, is added to what is known. The states at the start are unknown in every record, and so are
    its `specific` values: they are eliminated by a projection, the Schur complement of their information. The result
    is linear about the present values: a ranking, not a promise.

    Parameters
    ----------
    fit:
        The machine as identified so far.
    experiments:
        Records that might be made, by name.
    quantity:
        A function of all values by name.

    Raises
    ------
    SetupError, SimulationError
        What `cosim.run` raises for an experiment.
    """
    spacing = float(np.median(np.diff(fit.problem.columns[0].times)))
    names, gradient = fit.names, fit.gradient(quantity)
    advice = []
    for name, experiment in experiments.items():
        specific = [
            k
            for k, x in enumerate(names)
            if not fit.is_machine_parameter(x) or x in experiment.specific
        ]
        shared = [k for k in range(len(names)) if k not in specific]
        problem, p = _experiment_problem(fit, experiment, spacing)
        jacobian = Evaluator(problem).jacobian(p)[: problem.rows]
        by_specific, by_shared = jacobian[:, specific], jacobian[:, shared]
        projected = by_shared - by_specific @ np.linalg.lstsq(by_specific, by_shared)[0]
        present = np.linalg.inv(fit.linearisation.covariance[np.ix_(shared, shared)])
        covariance = np.linalg.inv(present + projected.T @ projected)
        g = gradient[shared]
        advice.append(Advice(name, DEVIATIONS * float(g @ covariance @ g) ** 0.5))
    return sorted(advice, key=lambda advice: advice.error)


def _experiment_problem(
    fit: Identified, experiment: Experiment, spacing: float
) -> tuple[Problem, Array]:
    """The problem that an experiment would make, and the values of its free parameters."""
    problem = fit.problem
    values = {k: v for k, v in fit.start_values.items() if not is_sensor_parameter(k)}
    system = replace(
        problem.system,
        start={**problem.system.start, **values, **experiment.start},
        inputs={**problem.system.inputs, **experiment.inputs},
    )
    network = connect(system)
    times = np.linspace(0.0, experiment.stop, round(experiment.stop / spacing) + 1)
    columns = [
        Measurement(network.port(name), times, np.zeros(len(times)), Noise(sigma, "as expected"))
        for name, sigma in experiment.noise.items()
    ]
    p = fit.linearisation.p.copy()
    for k, name in enumerate(fit.names):
        p[k] = float(experiment.start.get(name, p[k]))
    planned = replace(
        problem,
        system=system,
        columns=columns,
        prior=independent_prior({}),
        span=(0.0, experiment.stop),
    )
    return planned, p
