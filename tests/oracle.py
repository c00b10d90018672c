"""Components as one system without any FMI, and components in symbols: the independent references."""

from __future__ import annotations

import contextlib
import math
import random
from collections.abc import Callable, Mapping
from itertools import pairwise, product
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import sympy
from scipy.integrate import solve_ivp

from components.crank_conveyor import model as crank_conveyor
from components.drive_motor import model as drive_motor
from fmukit.declare.record import declarations, start
from fmukit.fmu.load import load
from fmukit.runtime import hybrid
from fmukit.trace.modules import modules

TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}


def load_copy(model: ModuleType, functions: dict[str, Any]) -> ModuleType:
    """A copy of a component that computes with other mathematical functions."""
    copy = load(Path(str(model.__file__)))
    for module, (name, function) in product(modules(copy), functions.items()):
        if getattr(module, name, None) is getattr(math, name):
            setattr(module, name, function)
    return copy


def events_and_end(
    model: Any, p: Any, t: float, x: Any, u: Any, h: float
) -> list[tuple[float, Any, Any]]:
    """The events of a step with constant inputs: time in the step, state before and after; last its end, twice."""
    events, s = [], 0.0
    while True:
        at = hybrid.run_to_event(model, p, t + s, x, hybrid.InputTrajectory(u, u, h - s))
        s += at.s
        if at.which < 0:
            return [*events, (h, at.x, at.x)]
        x = model.event_update(p, t + s, at.x, u, at.which)
        events.append((s, at.x, x))


def random_parameters(model: ModuleType, draw: random.Random, spread: float, **fixed: Any) -> Any:
    """Random parameters, off their start values by this share, that a component does not refuse."""
    while True:
        values = {
            name: d.start * draw.uniform(1 - spread, 1 + spread)
            for name, d in declarations(model.Parameters)
            if d.fmi_type == "Real"
        }
        p = start(model.Parameters, **values | fixed)
        with contextlib.suppress(ValueError):
            list(model.check(p))
            return p


def by_name(p: Any) -> dict[str, Any]:
    """The values of a record by dotted name."""
    return {name: attrgetter(name)(p) for name, _ in declarations(type(p))}


def lagrange(energy: Any, q: list[Any], w: list[Any], forces: list[Any]) -> tuple[Any, Any]:
    """Mass matrix M and rest b of Lagrange's equations M a + b = 0 from the kinetic less the potential
    energy, a function of the symbols of the coordinates q and their rates w, and the other forces.
    """
    momentum = sympy.Matrix([energy.diff(x) for x in w])
    inner = momentum.jacobian(q) * sympy.Matrix(w) - sympy.Matrix([energy.diff(x) for x in q])
    return momentum.jacobian(w), inner - sympy.Matrix(forces)


def split(values: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Start values "motor.A", "conveyor.crank.r" by part."""
    parts: dict[str, dict[str, Any]] = {"motor": {}, "conveyor": {}}
    for name, value in values.items():
        part, _, variable = name.partition(".")
        parts[part][variable] = value
    return parts["motor"], parts["conveyor"]


def monolithic(values: dict[str, Any], stop: float, t_eval: Any = None, **options: Any) -> Any:
    """Motor and conveyor integrated as one system: rows phi, w, tau, motor work, damper loss.

    `values` are start values as a co-simulated system takes them, with phi, w and tau.
    """
    motor, conveyor = split(values)
    state = [conveyor.pop("phi"), conveyor.pop("w"), motor.pop("tau"), 0.0, 0.0]
    p_motor = start(drive_motor.Parameters, **motor)
    p_conveyor = start(crank_conveyor.Parameters, **conveyor)

    def rhs(t: float, y: Any) -> list[float]:
        phi, w, tau = y[:3]
        x, u = crank_conveyor.State(phi, w), crank_conveyor.Inputs(tau)
        dphi, dw = crank_conveyor.derivatives(p_conveyor, t, x, u)
        (dtau,) = drive_motor.derivatives(p_motor, t, drive_motor.State(tau), drive_motor.Inputs(w))
        loss = crank_conveyor.outputs(p_conveyor, t, x, u).P_loss
        return [dphi, dw, dtau, tau * w, loss]

    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12} | options
    return solve_ivp(rhs, (0.0, stop), state, t_eval=t_eval, **settings)


class Part(NamedTuple):
    """A model with its parameters, the state it starts from and its inputs."""

    model: Any
    p: Any
    x: Any
    u: Any


def part(model: Any, **values: Any) -> Part:
    """A part with some start values changed."""
    records = (model.Parameters, model.State, model.Inputs)
    by_record = [{n: values[n] for n, _ in declarations(cls) if n in values} for cls in records]
    return Part(
        model, *(start(cls, **record_values) for cls, record_values in zip(records, by_record))
    )


def joined(
    parts: Mapping[str, Part],
    feed: Callable[[dict[str, Any]], list[Any]],
    times: Any,
    **options: Any,
) -> dict[str, Any]:
    """The states of parts as one system at these times; `feed` makes of states the inputs."""
    ends = np.cumsum([0, *(len(part.x) for part in parts.values())])

    def states(y: Any) -> dict[str, Any]:
        return {
            name: part.model.State(*y[first:last])
            for (name, part), (first, last) in zip(parts.items(), pairwise(ends))
        }

    def slopes(t: float, y: Any) -> list[float]:
        x = states(y)
        at = zip(parts.values(), x.values(), feed(x))
        return [rate for it, x, u in at for rate in it.model.derivatives(it.p, t, x, u)]

    span, first = (times[0], times[-1]), [value for part in parts.values() for value in part.x]
    return states(solve_ivp(slopes, span, first, t_eval=times, **(TIGHT | options)).y)
