"""Every equation carries the units that its variables declare."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import pint
import pytest

from components.crank_conveyor import model as crank_conveyor
from components.drive_motor import model as drive_motor
from fmukit.declare.record import Declaration, declarations, fill
from tests.oracle import load_copy

UNITS = pint.UnitRegistry()
FUNCTIONS = {
    "sin": lambda q: math.sin(q.to("rad").magnitude),
    "cos": lambda q: math.cos(q.to("rad").magnitude),
    "sqrt": lambda q: q**0.5,
    "exp": lambda q: math.exp(q.to("").magnitude),
}


def unit(declaration: Declaration) -> Any:
    """kg.m2 -> kg*m**2 as a pint unit."""
    if declaration.quantity is None:
        return None
    text = ""
    for character in declaration.quantity.unit.replace(".", "*"):
        text += f"**{character}" if character.isdigit() and text[-1:].isalpha() else character
    return UNITS.parse_units("" if text == "1" else text)


def quantities(cls: Any, value: float) -> Any:
    """A record whose reals are quantities near their start values."""
    values = []
    for _, d in declarations(cls):
        number = (d.start or value) if d.kind == "Real" else d.start
        values.append(number if unit(d) is None else UNITS.Quantity(number, unit(d)))
    return fill(cls, values)


CASES = [
    (drive_motor, {}),
    (drive_motor, {"characteristic": 1}),
    (crank_conveyor, {}),
    (crank_conveyor, {"rod": True}),
]


@pytest.mark.parametrize(("model", "mode"), CASES)
def test_derivatives_have_the_unit_of_their_state_per_second(
    model: ModuleType, mode: dict[str, Any]
) -> None:
    p, x, u, copy = prepared(model, mode)
    for (name, d), slope in zip(declarations(model.State), copy.derivatives(p, 0.0, x, u)):
        assert slope.check(unit(d) / UNITS.s), name


@pytest.mark.parametrize(("model", "mode"), CASES)
def test_outputs_have_their_declared_unit(model: ModuleType, mode: dict[str, Any]) -> None:
    p, x, u, copy = prepared(model, mode)
    for (name, d), value in zip(declarations(model.Outputs), copy.outputs(p, 0.0, x, u)):
        assert value.check(unit(d)), name


def prepared(model: ModuleType, mode: dict[str, Any]) -> Any:
    """Parameters, state and inputs as quantities, and the component that can take them."""
    copy = load_copy(model, FUNCTIONS)
    p = quantities(model.Parameters, 1.0)
    if "rod" in mode:
        p = p._replace(rod=p.rod._replace(finite=True))
    elif mode:
        p = p._replace(**mode)
    return p, quantities(model.State, 0.7), quantities(model.Inputs, 3.0), copy
