"""The five systems of `masters.py` as single systems of differential equations, without any FMU.

What the parts are comes from the equations of the components, what the wires do is written here by hand, and SciPy
integrates all states together: neither FMI, nor a master, nor the reference solution of `cosim` takes part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from components.crank_conveyor import model as crank_conveyor
from components.DC_motor import model as dc_motor
from components.drive_motor import model as drive_motor
from components.gearbox import model as gearbox
from components.shaft_link import model as shaft_link
from components.speed_controller import model as speed_controller
from fmukit.declare.record import declarations, start
from fmukit.fmu.load import load

Array = NDArray[np.float64]
#: Tolerance of the integration: chosen near the limit of double precision.
TOLERANCE = 1e-13
#: How much looser the second integration is, whose difference from the first is the error: chosen, so that the error of
#: the first is about a hundredth of it.
LOOSER = 100.0
#: Absolute tolerance as a share of the relative one: chosen, since the smallest state, a twist, is about 1e-3 rad.
ABSOLUTE = 1e-3
#: Longest step of the integration [s], of which the second one takes twice as much: chosen, since no step may pass
#: over the limit of the controller's torque.
LONGEST_STEP = 1e-3
MODELS = Path(__file__).with_name("models")

#: Parameters and states of each part, and what follows: the inputs of each part.
Inputs = Callable[[Any, Any, Mapping[str, Any]], dict[str, Any]]


@dataclass(frozen=True)
class Monolith:
    """Parts and the inputs that their states give each of them; `p`, `x` have an attribute for each part."""

    models: Mapping[str, ModuleType]
    inputs: Inputs


def _drive(p: Any, x: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "motor": drive_motor.Inputs(w=x.conveyor.w),
        "conveyor": crank_conveyor.Inputs(tau=x.motor.tau),
    }


def _two_masses(p: Any, x: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    shaft = shaft_link.Inputs(w_a=x.first.w_a / p.first.i, w_b=x.second.w_a)
    torque = shaft_link.outputs(p.shaft, 0.0, x.shaft, shaft)
    return {
        "first": gearbox.Inputs(tau_a=values["first.tau_a"], tau_b=torque.tau_a),
        "shaft": shaft,
        "second": gearbox.Inputs(tau_a=torque.tau_b, tau_b=values["second.tau_b"]),
    }


def _controlled(p: Any, x: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    controller = speed_controller.Inputs(w_ref=values["controller.w_ref"], w=x.gear.w_a)
    voltage = speed_controller.outputs(p.controller, 0.0, x.controller, controller).tau
    motor = dc_motor.Inputs(v=voltage, w=x.gear.w_a)
    torque = dc_motor.outputs(p.motor, 0.0, x.motor, motor).tau
    shaft = shaft_link.Inputs(w_a=x.gear.w_a / p.gear.i, w_b=x.conveyor.w)
    twisted = shaft_link.outputs(p.shaft, 0.0, x.shaft, shaft)
    return {
        "controller": controller,
        "motor": motor,
        "gear": gearbox.Inputs(tau_a=torque, tau_b=twisted.tau_a),
        "shaft": shaft,
        "conveyor": crank_conveyor.Inputs(tau=twisted.tau_b),
    }


def _quarter_car(wheel: ModuleType, chassis: ModuleType) -> Monolith:
    def inputs(p: Any, x: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "wheel": wheel.Inputs(z_c=x.chassis.z, v_c=x.chassis.v),
            "chassis": chassis.Inputs(z_w=x.wheel.z, v_w=x.wheel.v),
        }

    return Monolith({"wheel": wheel, "chassis": chassis}, inputs)


DRIVE = Monolith({"motor": drive_motor, "conveyor": crank_conveyor}, _drive)


def monolith(key: str) -> Monolith:
    """The system of this key of `masters_systems.cases`."""
    return {
        "drive A": DRIVE,
        "drive B": DRIVE,
        "two masses": Monolith(
            {"first": gearbox, "shaft": shaft_link, "second": gearbox}, _two_masses
        ),
        "controlled": Monolith(
            {"controller": speed_controller, "motor": dc_motor, "gear": gearbox, "shaft": shaft_link,
             "conveyor": crank_conveyor},
            _controlled,
        ),
        "quarter car": _quarter_car(load(MODELS / "wheel.py"), load(MODELS / "chassis.py")),
    }[key]  # fmt: skip


def integrate(
    system: Monolith, values: Mapping[str, Any], times: Array
) -> tuple[dict[str, Array], dict[str, float]]:
    """All outputs of a system at these times, and the error of each.

    Parameters
    ----------
    system : Monolith
        The parts and how they are wired.
    values : mapping of str to number
        Start values "motor.A" of parameters, inputs and states; the others are those of the components.
    times : array of shape (rows,)
        Times [s], which rise from 0 or later.

    Returns
    -------
    columns : dict of str to array of shape (rows,)
        "motor.tau" and so on.
    errors : dict of str to float
        The largest difference between two integrations.
    """
    tight = _solve(system, values, times, TOLERANCE, LONGEST_STEP)
    loose = _solve(system, values, times, LOOSER * TOLERANCE, 2.0 * LONGEST_STEP)
    return tight, {name: float(np.abs(tight[name] - loose[name]).max()) for name in tight}


def _solve(
    system: Monolith, values: Mapping[str, Any], times: Array, tolerance: float, longest: float
) -> dict[str, Array]:
    p = SimpleNamespace(
        **{name: _record(m.Parameters, name, values) for name, m in system.models.items()}
    )
    first = {name: _record(model.State, name, values) for name, model in system.models.items()}
    ends = np.cumsum([0, *(len(x) for x in first.values())])

    def states(y: Array) -> SimpleNamespace:
        models = system.models.items()
        return SimpleNamespace(
            **{name: m.State(*y[a:b]) for (name, m), a, b in zip(models, ends, ends[1:])}
        )

    def slopes(t: float, y: Array) -> list[float]:
        x = states(y)
        u = system.inputs(p, x, values)
        return [
            slope
            for name, model in system.models.items()
            for slope in model.derivatives(getattr(p, name), t, getattr(x, name), u[name])
        ]

    y0 = [value for x in first.values() for value in x]
    solution = solve_ivp(
        slopes, (0.0, times[-1]), y0, "DOP853", times, rtol=tolerance, atol=ABSOLUTE * tolerance,
        max_step=longest,
    )  # fmt: skip
    rows: list[dict[str, float]] = []
    for t, y in zip(solution.t, solution.y.T):
        x = states(y)
        u = system.inputs(p, x, values)
        rows.append({})
        for name, model in system.models.items():
            state = getattr(x, name)
            records = [state]
            if hasattr(model, "outputs"):
                records.append(model.outputs(getattr(p, name), t, state, u[name]))
            rows[-1] |= {
                f"{name}.{field}": value
                for record in records
                for field, value in zip(record._fields, record)
            }
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _record(cls: Any, part: str, values: Mapping[str, Any]) -> Any:
    """Parameters or states of a part, with the start values that are set."""
    names = [name for name, _ in declarations(cls)]
    return start(cls, **{n: values[f"{part}.{n}"] for n in names if f"{part}.{n}" in values})
