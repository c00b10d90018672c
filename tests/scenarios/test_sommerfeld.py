"""The jumps of the unbalanced rotor against averaged theory and the machine integrated as one system."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from components.DC_motor import model as motor
from components.unbalance_exciter import model as exciter
from cosim import SetupError
from tests.conftest import ask
from tests.oracle import joined, part


@pytest.fixture(scope="module")
def answer() -> Any:
    return ask("sommerfeld", supplies="18:30:13", step=0.02)


def test_jumps_lie_where_theory_has_its_folds(answer: Any) -> None:
    """The folds of v = R/k tau(w) + k w, found here on a grid; the verdict tells both jumps."""
    w = np.linspace(45.0, 60.0, 150_001)
    shaken = 80.0 * 0.025**2 * w**5 / (2 * ((50000.0 - 20.0 * w**2) ** 2 + (80.0 * w) ** 2))
    v = 5.0 / 0.2 * (0.005 * w + shaken) + 0.2 * w
    top = int(np.argmax(v[w < 52.0]))
    bottom = top + int(np.argmin(v[top:]))
    for way, fold, side in (("up", top, 0.1), ("down", bottom, 0.5)):
        told = {x: answer.figures[f"{x}_{way}"] for x in ("supply", "before", "theory")}
        fold_of = np.polynomial.Polynomial.fit(
            w[fold - 50 : fold + 51], v[fold - 50 : fold + 51], 4
        )
        exact = fold_of(min(fold_of.deriv().roots(), key=lambda x: abs(x - w[fold])).real)
        assert told["theory"].value == pytest.approx(exact, rel=1e-11)
        assert abs(told["supply"].value - v[fold]) < told["supply"].error + 1e-3
        assert told["before"].value == pytest.approx(w[fold], abs=side)
        assert 0.0 < told["supply"].error < 0.02
        assert told["supply"].text() in answer.verdict
    rows = answer.tables["sommerfeld.csv"].frame
    rising, falling = (rows[rows["falling"] == k].set_index("supply")["speed"] for k in (0, 1))
    assert rising[28.0] < 51.0 < 1.1 * rising[28.0] < falling[21.0] < falling[28.0] < rising[29.0]
    steady = rising[[22.0, 24.0, 26.0, 28.0]]
    assert np.interp(steady, w, v) == pytest.approx(steady.index, rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "passes"), [(0.995, False), (1.005, True)])
def test_one_system_passes_just_above_the_supply_that_is_told(
    share: float, passes: bool, answer: Any
) -> None:
    """Raised in small steps, in one system without FMUs."""
    parts = {"motor": part(motor, R=5.0), "exciter": part(exciter, w=40.0)}
    supply = share * answer.figures["supply_up"].value

    for v in (24.0, 26.0, 27.5, 28.2, supply):

        def feed(x: dict[str, Any], v: float = v) -> list[Any]:
            return [motor.Inputs(v, x["exciter"].w), exciter.Inputs(0.2 * x["motor"].i)]

        found = joined(parts, feed, np.linspace(0.0, 12.0, 2), rtol=1e-6, atol=1e-8)
        ends = {name: type(x)(*(row[-1] for row in x)) for name, x in found.items()}
        parts = {name: it._replace(x=ends[name]) for name, it in parts.items()}
    assert (ends["exciter"].w > 80.0) == passes


@pytest.mark.slow
def test_a_strong_motor_is_not_caught() -> None:
    """Its line falls more steeply than any load behind the peak, and every supply has one speed."""
    strong = {"motor.R": 0.1, "motor.L": 5e-4}
    answer = ask("sommerfeld", supplies="8:12:9", start=strong)
    assert answer.verdict.startswith("The motor is not caught")
    assert answer.figures["supply_up"].reason == "the speed does not jump"
    assert answer.show().charts[0].marks == []


@pytest.mark.slow
def test_coarse_levels_find_the_same_jumps_and_low_ones_none() -> None:
    """From 18 V to 28 V at once the motor is thrown past the resonance, where it would stay caught."""
    coarse = ask("sommerfeld", supplies="12,18,28,32")
    rows = coarse.tables["sommerfeld.csv"].frame
    assert rows[rows["supply"] == 28.0]["speed"].min() > 80.0
    for way, supply in (("up", 28.55), ("down", 20.056)):
        assert coarse.figures[f"supply_{way}"].value == pytest.approx(supply, abs=0.02)
    caught = ask("sommerfeld", supplies="18,24")
    assert caught.verdict == "The motor stays caught up to 24 V, below the resonance at 50 rad/s."
    with pytest.raises(SetupError, match="must be two levels or more"):
        ask("sommerfeld", supplies="20")
