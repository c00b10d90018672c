"""Units that formulas give."""

import numpy as np
import pytest

from cosim import SetupError
from workbench.dimensions import check_unit, conversion

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


@pytest.mark.parametrize(
    ("right", "wrong", "unit"),
    [
        ("0.5 * 1000 * l", "0.5 * l", "mm"), ("1000 * l - x", "l - x", "mm"), ("w * 30 / pi - n", "60 * w", "rpm"),
        ("w * 60 / (2 * pi)", "w / 2", "rpm"), ("60 / n", "1 / n", "s"), ("cos(p * pi / 180)", "cos(p)", "1"),
        ("mod(a * 180 / pi - p, 360)", "0.95 * a", "deg"), ("100 * (1 - e)", "2 * e", "%"), ("1000 * P * t", "P * t", "J"),
        ("57.3 * a", "60 * a", "deg"), (f"w * {30 / np.pi}", "60 * w", "1/min"), ("n / 60", "n / 50", "1/s"),
        ("w / (2 * pi)", "w", "Hz"), ("n / 60", "n", "Hz"), ("e * w", "e * n", "1/s"),
    ],
)  # fmt: skip
def test_numbers_convert_where_they_are_the_factor_between_the_units(
    right: str, wrong: str, unit: str
) -> None:
    units = UNITS | {"l": "m", "n": "rpm", "p": "deg", "a": "rad"}
    assert not check_unit(right, unit, units, "here")
    with pytest.raises(SetupError, match=f"here: .* is not in {unit}, with "):
        check_unit(wrong, unit, units, "here")


def test_what_is_not_known_is_named() -> None:
    assert not check_unit("5", "N", UNITS, "here")
    assert check_unit("sqrt(x - 5)", "mm", UNITS, "here") == ["sqrt(x - 5)"]
    assert check_unit("w", "furlong", UNITS, "here") == ["w"]
    assert check_unit("odd * t + gone", "m.s", UNITS, "here") == ["gone", "odd"]


def test_a_speed_converts_to_a_speed_and_not_to_a_count() -> None:
    assert conversion("rad/s", "rpm", "x") == pytest.approx(30 / np.pi)
    assert conversion("Hz", "1/min", "x") == pytest.approx(60.0)
    for speed, count in (
        ("rad/s", "Hz"),
        ("rad/s", "1/min"),
        ("rpm", "Hz"),
        ("Hz", "rad/s"),
        ("1/min", "rpm"),
    ):
        with pytest.raises(SetupError, match=f"x is in {speed}, which does not convert to {count}"):
            conversion(speed, count, "x")
