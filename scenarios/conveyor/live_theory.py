"""First-order theory of `first_order` as formulas of a live page, in the same symbols; a test compares both."""

from __future__ import annotations

from workbench import Number
from workbench.live import Formulas

from .first_order import Machine
from .machine import has_kloss_characteristic

LINEAR = {"B": "motor.B"}
#: the slope of Kloss's characteristic at the load of the mean speed, as `machine.linearised` has it
KLOSS_LINE = {
    "share": "load_slope * speed / motor.kloss.tau_b",
    "b": "motor.kloss.s_b * motor.kloss.w_s",
    "slip": "b * share / (1 + sqrt(1 - share**2))",
    "B": "2 * motor.kloss.tau_b * b * (b**2 - slip**2) / (slip**2 + b**2)**2",
}
START: Formulas = {
    "motor.A": "slope * speed",
    "motor.tau": "load_slope * speed",
    "conveyor.phi": 0.0,
    "conveyor.w": "speed",
}
KLOSS_START: Formulas = {"motor.kloss.w_s": "speed + slip", "motor.kloss.s_b": "b / (speed + slip)"}
NUMBERS = (Number("nu_res", "nu_res"), Number("zeta", "zeta"))


def values(machine: Machine) -> dict[str, str]:
    """The quantities of a machine at the mean speed `speed`, by the characteristic of its motor."""
    load = "conveyor.crank.r**2 / 2"
    return {
        "load_slope": f"conveyor.trough.d * {load}",
        **(KLOSS_LINE if has_kloss_characteristic(machine) else LINEAR),
        "slope": "B + load_slope",
        "theta0": f"conveyor.rotor.J + conveyor.trough.m * {load}",
        "J": "theta0 + motor.T * load_slope",
        "nu_res": "sqrt(slope / (theta0 * motor.T)) / 2",
        "zeta": "J / (2 * sqrt(slope * theta0 * motor.T))",
        "load_re": f"{load} * (conveyor.spring.c - conveyor.trough.m * speed**2)",
        "load_im": f"{load} * conveyor.trough.d * speed",
        "below_re": "slope - 4 * theta0 * motor.T * speed**2",
        "below_im": "2 * speed * J",
        "load_ripple": "hypot(load_re, load_im)",
        "torque_ripple": "B * load_ripple / hypot(below_re, below_im)",
        "speed_ripple": "load_ripple * hypot(1, 2 * motor.T * speed) / hypot(below_re, below_im)",
        "torque_lag": "mod(atan2(below_im, below_re) * 180 / pi, 360)",
    }
