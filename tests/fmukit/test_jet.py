"""Jets against SymPy's derivatives."""

import math
import random
from typing import Any

import pytest
import sympy

from fmukit.runtime import jet
from fmukit.runtime.jet import Jet

FORMULAS: dict[str, Any] = {
    "products": lambda x, f: 3 * x * x - x * 2 + (1 - x) * (x + 0.5) - x**3,
    "quotients": lambda x, f: (x * x + 2) / (x + 3) / 2,
    "circle": lambda x, f: f.sin(x) * f.cos(2 * x) - f.sin(x * x),
    "roots": lambda x, f: f.sqrt(1 + x * x) * f.acos(x / 3),
    "angles": lambda x, f: f.atan2(1 + x, 2 - x * x) + f.atan2(0.5, 2 + x) + 0.3,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_jets_have_the_derivatives_of_a_formula(name: str) -> None:
    x, t = sympy.symbols("x t")
    formula, draw = FORMULAS[name], random.Random(1)
    along = formula(x, sympy)
    composed = along.subs(x, sympy.sin(t) + t / 5)
    for _ in range(20):
        at = draw.uniform(-1.0, 1.0)
        got = formula(Jet(at, 1.0, 0.0), jet)
        wanted = [float(along.diff(x, n).subs(x, at)) for n in range(3)]
        assert got == pytest.approx(wanted, rel=1e-13, abs=1e-13)
        assert formula(at, jet) == pytest.approx(got.value, rel=1e-14)
        inner = jet.sin(Jet(at, 1.0, 0.0)) + Jet(at, 1.0, 0.0) / 5
        chained = formula(Jet(inner.value, 1.0, 0.0), jet).along(inner)
        wanted = [float(composed.diff(t, n).subs(t, at)) for n in range(3)]
        assert chained == pytest.approx(wanted, rel=1e-12, abs=1e-12)
        assert formula(inner, jet) == pytest.approx(wanted, rel=1e-12, abs=1e-12)


def test_the_third_derivative_is_refused() -> None:
    value, first, second = Jet(2.0, 3.0, 5.0).derivative
    assert (value, first) == (3.0, 5.0) and math.isnan(second)
    assert jet.constant(2.0) * Jet(2.0, 3.0, 5.0) == (4.0, 6.0, 10.0)
