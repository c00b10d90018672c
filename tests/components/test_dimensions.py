"""Every equation carries the units that its variables declare."""

from __future__ import annotations

import itertools
import math
from types import ModuleType, SimpleNamespace
from typing import Any

import pint
import pytest
from pint.compat import upcast_type_map

from components.crank_conveyor import model as crank_conveyor
from components.DC_motor import model as DC_motor
from components.drive_motor import model as drive_motor
from components.gearbox import model as gearbox
from components.gravity_orientator import model as gravity_orientator
from components.iron_drive import model as iron_drive
from components.iron_drive.declarations import Side
from components.shaft_link import model as shaft_link
from components.slotted_link import model as slotted_link
from components.speed_controller import model as speed_controller
from components.unbalance_exciter import model as unbalance_exciter
from fmukit.declare.record import Declaration, declarations, fill
from fmukit.runtime import jet
from tests.oracle import load_copy

UNITS = pint.UnitRegistry()
upcast_type_map[f"{jet.__name__}.Jet"] = jet.Jet  # Jet, not Quantity, multiplies the two


def pure(q: Any) -> float:
    """The number of an angle or ratio."""
    return float(q.to("").magnitude if isinstance(q, pint.Quantity) else q)


PLAIN = (math.sin, math.cos, math.tan, math.acos, math.atan, math.exp)
FUNCTIONS: dict[str, Any] = {f.__name__: lambda *q, f=f: f(*map(pure, q)) for f in PLAIN}
FUNCTIONS |= {"sqrt": lambda q: q**0.5, "atan2": lambda y, x: math.atan(pure(y / x))}
CASES: list[tuple[ModuleType, dict[str, Any], dict[str, Any]]] = [
    *(
        (model, {}, {})
        for model in (DC_motor, gearbox, shaft_link, speed_controller, unbalance_exciter)
    ),
    *((drive_motor, {"characteristic": kind}, {}) for kind in (0, 1)),
    *((crank_conveyor, {"rod.finite": finite}, {}) for finite in (False, True)),
    *((slotted_link, {"link.swings": swings}, {}) for swings in (False, True)),
    *(
        (iron_drive, {"wrap": wrap, "spring.side": side}, {"phi": phi, "direction": 1})
        for wrap, side in itertools.product(iron_drive.Wrap, Side)
        for phi in (0.9, 2.0, 3.5, 5.0)
    ),
    (
        iron_drive,
        {"follower.lifts": True},
        {"phi": 3.5, "direction": 1, "flying": True, "gap": 0.1},
    ),
    *(
        (gravity_orientator, {}, {"stage": stage, "phi1": 0.6, "phi2": 6.3})
        for stage in gravity_orientator.MECHANICS
    ),
]


def unit(declaration: Declaration) -> Any:
    """kg.m2 -> kg*m**2 as a pint unit."""
    if declaration.quantity is None:
        return None
    text = ""
    for character in declaration.quantity.unit.replace(".", "*").replace("Ohm", "ohm"):
        text += f"**{character}" if character.isdigit() and text[-1:].isalpha() else character
    return UNITS.parse_units("" if text == "1" else text)


def quantities(cls: Any, value: float, overrides: dict[str, Any]) -> Any:
    """A record whose reals are quantities near their start values, or as given."""
    values = []
    for name, d in declarations(cls):
        number = overrides.get(name, (d.start or value) if d.fmi_type == "Real" else d.start)
        values.append(number if unit(d) is None else UNITS.Quantity(number, unit(d)))
    return fill(cls, values)


@pytest.mark.parametrize(("model", "parameters", "state"), CASES)
def test_every_equation_has_its_unit(
    model: ModuleType,
    parameters: dict[str, Any],
    state: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    copy = load_copy(model, FUNCTIONS)
    monkeypatch.setattr(jet, "math", SimpleNamespace(**vars(math) | FUNCTIONS))
    p = quantities(model.Parameters, 1.0, parameters)
    x, u = quantities(model.State, 0.7, state), quantities(model.Inputs, 3.0, {})
    rates, outputs = copy.derivatives(p, 0.0, x, u), copy.outputs(p, 0.0, x, u)
    for cls, values, per in ((model.State, rates, UNITS.s), (model.Outputs, outputs, 1)):
        for (name, d), value in zip(declarations(cls), values):
            if d.fmi_type == "Real" and not d.held:
                assert UNITS.Quantity(value).check(unit(d) / per), name
    if model is gravity_orientator or state.get("flying"):
        ends = copy.event_update(p, 0.0 * UNITS.s, x, u, 2 if model is iron_drive else 0)
        for (name, d), value in zip(declarations(model.State), ends):
            assert not isinstance(value, pint.Quantity) or value.check(unit(d)), name
