"""Which record to make next: how far each of several possible ones would narrow an interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ..system import Value, connect
from .evidence import DEVIATIONS
from .identify import Identified
from .model import Model, Vector, independent, sensor
from .record import Column, Noise


class Experiment(NamedTuple):
    """A record that might be made: start values that replace the identified ones, the noise of each
    column in its unit, its duration [s], the free parameters that apply to this record only, such as a
    supply, and inputs that replace those of the system.
    """

    start: Mapping[str, Value]
    noise: Mapping[str, float]
    stop: float
    own: Sequence[str] = ()
    inputs: Mapping[str, Any] = MappingProxyType({})


class Advice(NamedTuple):
    """An experiment by its name, and the half-width of the interval after it."""

    name: str
    error: float


def advise(
    fit: Identified,
    experiments: Mapping[str, Experiment],
    tell: Callable[[Mapping[str, float]], float],
) -> list[Advice]:
    """How well a quantity of the values would be known after each experiment, the best first.

    The Fisher information of each record, simulated with the identified values and the present spacing
    of rows, is added to what is known. The states at the start are unknown in every record, and so are
    its `own` values. The result is linear about the present values: a ranking, not a promise. Raises
    what `cosim.run` raises.
    """
    gap = float(np.median(np.diff(fit.model.columns[0].times)))
    names, gradient = fit.names, fit.gradient(tell)
    found = []
    for name, experiment in experiments.items():
        own = [k for k, one in enumerate(names) if not fit.shared(one) or one in experiment.own]
        shared = [k for k in range(len(names)) if k not in own]
        model, p = _model(fit, experiment, gap)
        rows = sum(len(column.times) for column in model.columns)
        J = model.jacobian(p)[:rows]
        mine, theirs = J[:, own], J[:, shared]
        left = theirs - mine @ np.linalg.lstsq(mine, theirs)[0]
        known = np.linalg.inv(fit.local.covariance[np.ix_(shared, shared)])
        after = np.linalg.inv(known + left.T @ left)
        g = gradient[shared]
        found.append(Advice(name, DEVIATIONS * float(g @ after @ g) ** 0.5))
    return sorted(found, key=lambda advice: advice.error)


def _model(fit: Identified, experiment: Experiment, gap: float) -> tuple[Model, Vector]:
    """The model of an experiment, and its free values."""
    old = fit.model
    values = {k: v for k, v in old.values(fit.local.p).items() if not sensor(k)}
    start = {**old.system.start, **values, **experiment.start}
    system = replace(old.system, start=start, inputs={**old.system.inputs, **experiment.inputs})
    network = connect(system)
    times = np.linspace(0.0, experiment.stop, round(experiment.stop / gap) + 1)
    columns = [
        Column(network.port(name), times, np.zeros(len(times)), Noise(sigma, "as expected"))
        for name, sigma in experiment.noise.items()
    ]
    p = fit.local.p.copy()
    for k, name in enumerate(fit.names):
        p[k] = float(experiment.start.get(name, p[k]))
    span = 0.0, experiment.stop
    nothing = independent({})
    return replace(old, system=system, columns=columns, prior=nothing, span=span, _last=None), p
