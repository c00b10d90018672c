"""Carry a component over one communication step: its own exact update, or the integrator."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

from .interface import InputHold
from .ode import Vector, integrate
from .record import declarations

TOLERANCE = 1e-11


def course(hold: int, before: Any, now: Any, past: float, h: float) -> tuple[Any, Any]:
    """Inputs at both ends of a step of h seconds, for the inputs set `before` (past s ago) and `now`.

    Without a past (past = 0) there is no line to follow: extrapolation holds the value.
    """
    if hold == InputHold.interpolate:
        return before, now
    if hold == InputHold.extrapolate and past > 0.0 and before != now:
        return now, now._make(b + (b - a) * h / past for a, b in zip(before, now))
    return now, now


def advance(model: ModuleType, p: Any, t: float, x: Any, u0: Any, u1: Any, h: float) -> Any:
    """The state h seconds after t, the inputs running linearly from u0 to u1.

    A component with a closed solution gives it in `exact(p, x, u0, u1, h)`, None where it has none.
    """
    if hasattr(model, "exact"):
        end = model.exact(p, x, u0, u1, h)
        if end is not None:
            return end
    derivatives, state = model.derivatives, model.State._make
    if u0 == u1:

        def slope(s: float, y: Vector) -> Vector:
            dx: Vector = derivatives(p, t + s, state(y), u0)
            return dx

    else:
        rate = [(b - a) / h for a, b in zip(u0, u1)]

        def slope(s: float, y: Vector) -> Vector:
            u = u0._make(a + s * da for a, da in zip(u0, rate))
            dx: Vector = derivatives(p, t + s, state(y), u)
            return dx

    return state(integrate(slope, x, h, tolerances(model.State)))


@cache
def tolerances(cls: Any) -> list[float]:
    """The error of each state that a sub-step may make: a share of the nominal value."""
    return [TOLERANCE * (d.nominal or 1.0) for _, d in declarations(cls)]
