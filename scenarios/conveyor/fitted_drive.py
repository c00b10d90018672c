"""A drive that was fitted to a record: its torque ripple on steady orbits, and what would bring it to its limit.

First-order theory of the fitted machine says where the ripple is at its limit, with the interval of the fit; an
orbit there shows what theory leaves out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cosim import Identified
from workbench import Context, Figure
from workbench.fit import figure_of
from workbench.orbits import STEP_MULTIPLES, extrapolated
from workbench.roots import roots_between

from .drive_orbits import Drive
from .first_order import FIELDS, Machine
from .options import RippleOptions

CHANGED = {"conveyor.rotor.J": "rotor_j", "motor.T": "motor_t"}
DRIVE_QUANTITIES = {
    "nu_res": ("rad/s", "resonance by formula (22) of the fitted machine"),
    "away": ("%", "operating speed above the resonance"),
    "tau2": ("N.m", "torque ripple at the operating speed"),
    "avoid_from": ("rad/s", "speed above which the torque ripple exceeds its limit"),
    "avoid_to": ("rad/s", "speed below which the torque ripple exceeds its limit"),
    "clear_rotor_j": ("kg.m2", "conveyor.rotor.J at which that torque ripple is at its limit"),
    "change_rotor_j": (
        "%",
        "change of conveyor.rotor.J from its fitted value at which that torque ripple is at its limit",
    ),
    "clear_motor_t": ("s", "motor.T at which that torque ripple is at its limit"),
    "change_motor_t": (
        "%",
        "change of motor.T from its fitted value at which that torque ripple is at its limit",
    ),
}
#: Communication steps per revolution of the orbits of the fitted drive; a convention.
STEPS = 512
#: Speeds between which the limit of the ripple is sought, over the resonance; a convention.
SWEEP = (0.2, 2.5)
#: Factors of a parameter between which the limit of the ripple is sought; a convention.
FACTORS = (0.2, 5.0)
#: Points at which a sign is taken before Brent's method; two crossings within one step of 0.4 % are not told apart.
SIGN_POINTS = 600
#: Relative step of a central difference. Its error, of the order of its square, is far below that of a fit.
SLIGHT = 1e-3


class IdentifiedDrive(NamedTuple):
    """A fit, the machine it found, the operating speed [rad/s], stretches of speed to avoid with the
    figures of their ends.
    """

    fit: Identified
    machine: Callable[[Mapping[str, float]], Machine]
    operating: float
    edges: Sequence[tuple[Figure, Figure]]


def figures(o: RippleOptions, context: Context, drive_data: IdentifiedDrive) -> dict[str, Figure]:
    """The resonance, how far the operating speed is from it, the torque ripple there, the stretch of
    speed to avoid, and what would change it.
    """
    fit, machine, nu = drive_data.fit, drive_data.machine, drive_data.operating
    all_figures = {"nu_res": figure_of(fit.derived["nu_res"])}
    gap = fit.interval(lambda v: 100.0 * (nu / machine(v).nu_res - 1.0), "%")
    all_figures["away"] = figure_of(gap)
    all_figures["tau2"] = ripple(o, context, drive_data)
    best = machine(fit.start_values)

    def changed(name: str, x: float) -> tuple[Machine, float]:
        many: dict[str, Any] = {FIELDS[name]: x}
        return replace(best, **many), nu

    near = min(drive_data.edges, key=partial(distance, nu), default=None)
    for name, k in (("avoid_from", 0), ("avoid_to", 1)):
        nowhere = Figure.undetermined("rad/s", "the torque ripple is below its limit everywhere")
        edge = near[k] if near else nowhere
        all_figures[name] = with_error_of_theory(o, context, edge, lambda x: (best, x))
    for name, key in CHANGED.items():
        clear = value_at_limit(o, drive_data, name, DRIVE_QUANTITIES[f"clear_{key}"][0])
        all_figures[f"clear_{key}"] = with_error_of_theory(
            o,
            context,
            clear,
            partial(changed, name),
        )
        all_figures[f"change_{key}"] = change_to_limit(
            o, drive_data, name, all_figures[f"clear_{key}"], clear
        )
    return all_figures


def distance(nu: float, stretch: tuple[Figure, Figure]) -> float:
    """How far a speed is from a stretch of speeds, whose ends may not be told [rad/s]."""
    low, high = (end.value for end in stretch)
    return low - nu if nu < low else nu - high if nu > high else 0.0


def ripple(o: RippleOptions, context: Context, drive_data: IdentifiedDrive) -> Figure:
    """The torque ripple of the machine found on its steady orbit at the operating speed."""
    fit, nu = drive_data.fit, drive_data.operating
    machine = drive_data.machine(fit.start_values)
    drive = Drive(context, o.algorithm, STEPS)
    orbits = drive.orbits(machine, drive.for_each_step([nu]), "operating speed")
    if problem := orbits.problem[0, 0]:
        return Figure.undetermined("N.m", str(problem))
    torque, errors = extrapolated(orbits.torque, drive.convergence_order, orbits.torque_error)
    value, error = float(abs(torque[0])), float(errors[0])
    if math.isnan(error):
        return Figure.undetermined("N.m", "the coupling error is not known")
    wide = fit.interval(lambda v: float(abs(drive_data.machine(v).torque_ripple(nu)))).error
    return Figure(value, "N.m", error + wide)


def with_error_of_theory(
    o: RippleOptions,
    context: Context,
    figure: Figure,
    at: Callable[[float], tuple[Machine, float]],
) -> Figure:
    """A place where first-order theory has the torque ripple at its limit, and its error with what
    theory leaves out: the machine and speed `at` that place are run, and so far away is the limit.
    """
    if figure.error is None:
        return figure
    x = figure.value

    def theory(x: float) -> float:
        machine, nu = at(x)
        return float(np.log(np.abs(machine.torque_ripple(nu))))

    machine, nu = at(x)
    drive = Drive(context, o.algorithm, STEPS // STEP_MULTIPLES[-1])
    orbit = drive.orbits(machine, np.array([nu]), "limits")[0]
    if orbit.problem:
        return Figure.undetermined(figure.unit, str(orbit.problem))
    slope = (theory(x * (1 + SLIGHT)) - theory(x * (1 - SLIGHT))) / (2 * SLIGHT * x)
    shift = abs((math.log(abs(orbit.torque)) - math.log(o.torque_ripple_limit)) / slope)
    return figure._replace(error=figure.error + shift)


def stretches_above_limit(
    o: RippleOptions, fit: Identified, machine: Callable[[Mapping[str, float]], Machine]
) -> list[tuple[Figure, Figure]]:
    """The stretches of speed in which first-order theory has the torque ripple above its limit."""
    if fit.misfit:
        return []
    values = fit.start_values
    nus = machine(values).nu_res * np.geomspace(*SWEEP, SIGN_POINTS)

    def passed(v: Mapping[str, float]) -> list[float]:
        drive = machine(v)
        return roots_between(
            lambda nu: np.log(np.abs(drive.torque_ripple(nu)) / o.torque_ripple_limit), nus
        )

    def edge(near: float, v: Mapping[str, float]) -> float:
        return float(min(passed(v), key=lambda x: abs(x - near), default=math.nan))

    ends = [figure_of(fit.interval(partial(edge, x), "rad/s")) for x in passed(values)]
    if abs(machine(values).torque_ripple(nus[0])) > o.torque_ripple_limit:
        ends.insert(
            0,
            Figure.undetermined(
                "rad/s", "the torque ripple is above its limit at every lower speed"
            ),
        )
    if len(ends) % 2:
        ends.append(
            Figure.undetermined(
                "rad/s", "the torque ripple is above its limit at every higher speed"
            )
        )
    return list(zip(ends[::2], ends[1::2]))


def value_at_limit(o: RippleOptions, drive_data: IdentifiedDrive, name: str, unit: str) -> Figure:
    """What a parameter would have to be for the torque ripple at the operating speed to be at its
    limit.
    """
    fit, nu = drive_data.fit, drive_data.operating
    values = fit.start_values
    if abs(drive_data.machine(values).torque_ripple(nu)) <= o.torque_ripple_limit:
        return Figure.undetermined(unit, "the operating speed is already clear")
    if math.isnan(factor_to_limit(o, drive_data, name, values)):
        return Figure.undetermined(unit, f"no {name} from a fifth to five times its value does it")
    return figure_of(
        fit.interval(lambda v: v[name] * factor_to_limit(o, drive_data, name, v), unit)
    )


def change_to_limit(
    o: RippleOptions, drive_data: IdentifiedDrive, name: str, clear: Figure, by_theory: Figure
) -> Figure:
    """The same as a change from the fitted value [%], whose error is smaller than that of the value:
    what is not known of the drive moves both. What theory leaves out is that of the value.
    """
    if clear.error is None or by_theory.error is None:
        return Figure.undetermined("%", clear.reason)
    value = drive_data.fit.start_values[name]
    ratio = drive_data.fit.interval(
        lambda v: 100.0 * (factor_to_limit(o, drive_data, name, v) - 1.0), "%"
    )
    figure = figure_of(ratio)
    if figure.error is None:
        return figure
    return figure._replace(error=figure.error + 100.0 * (clear.error - by_theory.error) / value)


def factor_to_limit(
    o: RippleOptions, drive_data: IdentifiedDrive, name: str, values: Mapping[str, float]
) -> float:
    """The nearest factor of a parameter's value with which the torque ripple at the operating speed is
    at its limit by first-order theory; nan if there is none.
    """
    nu, drive, field = drive_data.operating, drive_data.machine(values), FIELDS[name]

    def over_limit(factor: Any) -> Any:
        changed: dict[str, Any] = {field: values[name] * factor}
        return np.log(np.abs(replace(drive, **changed).torque_ripple(nu)) / o.torque_ripple_limit)

    factors = roots_between(over_limit, np.geomspace(*FACTORS, SIGN_POINTS))
    return min(factors, key=lambda x: abs(math.log(x)), default=math.nan)
