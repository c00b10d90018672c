"""The jumps of the unbalanced rotor against periodic orbits and averaged theory solved here without FMUs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import root

from components.DC_motor import model as motor
from components.unbalance_exciter import model as exciter
from cosim import SetupError
from tests.conftest import ask
from tests.oracle import joined, part
from tests.scenarios.exciter_oracle import DEFAULT, NAMES, fold, guess, linearised, returned, steady

RANDOM_EXCITER = {
    "R": 3.32,
    "k": 0.2398,
    "m_u": 0.457,
    "m": 34.1,
    "c": 94220.0,
    "d": 91.25,
    "J": 0.0131,
}
"""A machine for which levels that are held for a time overran both folds."""


@pytest.fixture(scope="module")
def answer() -> Any:
    return ask("sommerfeld", supplies="18:30:13", step=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "passes"), [(0.995, False), (1.005, True)])
def test_the_coupled_system_passes_just_above_the_supply_that_is_stated(
    share: float, passes: bool, answer: Any
) -> None:
    """Raised in small steps, in one system without FMUs."""
    parts = {"motor": part(motor, R=5.0), "exciter": part(exciter, w=40.0)}
    supply = share * answer.figures["supply_up"].value

    for v in (24.0, 26.0, 27.5, 28.2, supply):

        def feed(x: dict[str, Any], v: float = v) -> list[Any]:
            return [motor.Inputs(v, x["exciter"].w), exciter.Inputs(0.2 * x["motor"].i)]

        solution = joined(parts, feed, np.linspace(0.0, 12.0, 2), rtol=1e-6, atol=1e-8)
        ends = {name: type(x)(*(row[-1] for row in x)) for name, x in solution.items()}
        parts = {name: it._replace(x=ends[name]) for name, it in parts.items()}
    assert (ends["exciter"].w > 80.0) == passes


@pytest.mark.parametrize(
    ("changes", "directions"),
    [({}, ("up", "down")), pytest.param(RANDOM_EXCITER, ("up", "down"), marks=pytest.mark.slow)],
)
def test_jumps_are_folds_of_periodic_orbits(
    changes: dict[str, float], directions: tuple[str, ...]
) -> None:
    """Where a Floquet multiplier is 1; speed and voltage of the jump and the speed after it."""
    machine = DEFAULT | changes
    start = {NAMES[name]: value for name, value in changes.items()}
    answer: Any = ask("sommerfeld", supplies="18,20", hold=2.0, start=start)
    f = answer.figures
    for direction in directions:
        supply, before = fold(machine, f[f"before_{direction}"].value)
        after = steady(machine, supply, f[f"after_{direction}"].value)
        for name, exact in (("supply", supply), ("before", before), ("after", after)):
            figure = f[f"{name}_{direction}"]
            assert abs(figure.value - exact) < figure.error < 1e-4, (name, direction)


@pytest.mark.slow
def test_a_motor_below_the_jump_is_called_caught() -> None:
    """At 28.5 V it turns a little faster than the resonance, and jumps only at 28.5515 V."""
    answer = ask("sommerfeld", supplies="26:28.5:6")
    assert answer.figures["supply_up"].value > 28.5
    assert answer.judgements[0].answer == "no"
    assert answer.show().charts[0].marks == []


@pytest.mark.slow
def test_a_mount_without_damping_gives_no_end() -> None:
    """The motor is held at the resonance, and the mount shakes ever more."""
    answer = ask("sommerfeld", supplies="16:20:5", start={"exciter.mount.d": 0.0})
    assert answer.figures["supply_up"].error is None
    assert any(" V the motion is not steady after 200 s" in x for x in answer.warnings)


@pytest.mark.slow
def test_a_motion_that_is_unstable_before_its_fold_gives_no_voltage() -> None:
    """With so little damping the free motor starts to swing at 18.0386 V, before the fold at 18.0373 V."""
    answer = ask("sommerfeld", supplies="17,20", hold=2.0, start={"exciter.mount.d": 10.0})
    why = "the motion is unstable before the fold of its voltage at 18.0373 V"
    assert answer.figures["supply_down"].reason == why
    machine, w = DEFAULT | {"d": 10.0}, 53.52

    def equations(z: Any) -> list[float]:
        y, period = returned(machine, float(z[4]), z[:4])
        return [*(y - z[:4]), period - 2 * math.pi / w]

    y, supply = guess(machine, w)
    y = root(equations, [*y, supply]).x
    assert abs(np.linalg.eigvals(linearised(machine, y[4], y[:4]))).max() > 1.01
    assert 18.0374 < y[4] < 18.0386


@pytest.mark.slow
def test_a_strong_motor_is_not_caught() -> None:
    """Its line falls more steeply than any load behind the peak, and every supply has one speed."""
    strong = {"motor.R": 0.1, "motor.L": 5e-4}
    answer = ask("sommerfeld", supplies="8:12:9", start=strong)
    assert answer.figures["supply_up"].reason == "the speed does not jump"
    assert answer.show().charts[0].marks == []


@pytest.mark.slow
def test_coarse_levels_find_the_same_jumps_and_low_ones_none() -> None:
    """From 18 V to 28 V at once the motor is thrown past the resonance, where it would stay caught."""
    coarse = ask("sommerfeld", supplies="12,18,28,32")
    rows = coarse.tables["sommerfeld.csv"].frame
    assert rows[rows["supply"] == 28.0]["speed"].min() > 80.0
    for direction, supply in (("up", 28.55154), ("down", 20.05641)):
        assert coarse.figures[f"supply_{direction}"].value == pytest.approx(supply, abs=1e-5)
    with pytest.raises(SetupError, match="must be two levels or more"):
        ask("sommerfeld", supplies="20")
    with pytest.raises(SetupError, match=r"motor.k = 0 V.s/rad gives no torque"):
        ask("sommerfeld", supplies="18,20", start={"motor.k": 0.0})
