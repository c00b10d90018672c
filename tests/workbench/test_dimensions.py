"""Units that formulas give."""

import numpy as np
import pytest

from cosim import SetupError
from workbench.dimensions import check_unit

UNITS = {"m": "kg", "x": "mm", "t": "s", "w": "rad/s", "P": "kW", "e": "1", "odd": "furlong"}


def test_a_product_has_the_unit_of_its_terms_and_no_other() -> None:
    rng = np.random.default_rng(4)
    for _ in range(40):
        powers = dict(zip("mxtP", rng.integers(-2, 3, 4).tolist()))
        factors = [f"{name}**{n}" for name, n in powers.items() if n]
        text = " * ".join([*factors, "cos(w * t)", "(1 - e)"])
        unit = ".".join(f"{UNITS[name]}{n}" for name, n in powers.items() if n) or "1"
        assert not check_unit(text, unit, UNITS, "here")
        for wrong in (f"{unit}.s", f"{unit}/kg", unit.replace("mm", "m")):
            if wrong != unit:
                with pytest.raises(SetupError, match=r"here: .* is not in "):
                    check_unit(text, wrong, UNITS, "here")
        with pytest.raises(SetupError, match="adds or compares what is in different units"):
            check_unit(f"{text} + t * {text}", unit, UNITS, "here")


def test_numbers_convert_and_what_is_not_known_is_named() -> None:
    assert not check_unit("w * 30 / pi", "rpm", UNITS, "here")
    assert not check_unit("5", "N", UNITS, "here")
    assert check_unit("odd * t + gone", "m.s", UNITS, "here") == ["gone", "odd"]
    with pytest.raises(SetupError, match="is not in rpm, with w in rad/s"):
        check_unit("w / 2", "rpm", UNITS, "here")
