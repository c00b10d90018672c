"""The limit of the orientator's speed: the formula against simulations, integrations and closed limits."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from cosim import SetupError, System
from scenarios.orientator import formula_comparison, neglected
from scenarios.orientator import machine as orientator
from scenarios.orientator.limit_formula import DOWN, UP, OrientatorParameters, rpm_of_squared
from scenarios.orientator.products import (
    PRODUCT_UNITS,
    RPM,
    Product,
    fastest,
    run_product,
    table_of,
)
from scenarios.orientator.questions import orientation_time
from tests.conftest import ask, fmus_of
from workbench import Context, Figure, Findings
from workbench.orbits import measured

LIMITS = {0.1: 126.38634, 0.2: 100.23145, 0.3: 84.54107, 0.35: 77.75026, 0.4: 71.75820,
          0.5: 62.12296, 0.6: 55.29936}  # fmt: skip
JOINT = {0.1: 132.078, 0.2: 103.739, 0.3: 88.210, 0.35: 82.672, 0.5: 70.762, 0.6: 65.191}
WITHIN = 2.03


def system(mu: float, **start: Any) -> System:
    """The orientator's native FMU at a friction."""
    return orientator.system(fmus_of(orientation_time), 0.0, mu, start)


def end_of(machine: System, mu: float, n: float) -> Any:
    """The stage, the reason and the times of one product at a speed [rpm]."""
    asked = Product.of(machine, mu, [n / RPM])
    return table_of(measured(Context(machine.parts, certifies=False), asked)).iloc[0]


def relative_difference(machine: OrientatorParameters, limit: float) -> float:
    """How far the formula is from a limit [%]."""
    return 100 * (rpm_of_squared(machine.limit()[0]) / limit - 1)


def test_the_formula_is_within_two_percent_of_the_reference_limits() -> None:
    for mu, limit in LIMITS.items():
        machine = OrientatorParameters.of(system(mu))
        assert abs(relative_difference(machine, limit)) < WITHIN
        assert machine.limit()[1] == (6 if mu <= 0.25 else 7)
        assert rpm_of_squared(machine.sticking) > rpm_of_squared(machine.joint_limit) > limit


class Upside(OrientatorParameters):
    """Friction that moves with the height of the contact, as printed."""

    def potential(self, phi1: Any, phi2: Any, yc: Any) -> tuple[Any, Any]:
        still, turning = super().potential(phi1, phi2, yc)
        return still, turning - self.centrifugal[1] * self.mu * self.r * phi2


class Outwards(OrientatorParameters):
    """The centrifugal force on the cup with the other sign, as printed."""

    @property
    def centrifugal(self) -> tuple[float, float]:
        return super().centrifugal[0], -super().centrifugal[1]


@pytest.mark.parametrize("wrong", [Upside, Outwards])
def test_a_wrong_sign_or_a_term_that_is_missing_leaves_the_limits(wrong: Any) -> None:
    machine = wrong(**vars(OrientatorParameters.of(system(0.35))))
    assert not abs(relative_difference(machine, LIMITS[0.35])) < 5.0


@pytest.mark.parametrize("mu", JOINT)
def test_joint_fails_where_its_closed_bound_has_it(mu: float) -> None:
    bound = rpm_of_squared(OrientatorParameters.of(system(mu)).joint_limit)
    assert bound == pytest.approx(JOINT[mu], abs=6e-4)
    below, above = (end_of(system(mu), mu, bound + x) for x in (-1e-5, 1e-5))
    assert below["reason"] != orientator.REASONS.index("catcher stopped")
    assert above["stage"] == orientator.JAMMED
    assert above["reason"] == orientator.REASONS.index("catcher stopped")


def test_friction_holds_the_cup_in_the_chute_where_the_bound_has_it() -> None:
    bound = rpm_of_squared(OrientatorParameters.of(system(0.35)).sticking)
    assert end_of(system(0.35), 0.35, bound - 1e-6)["reason"] != 1
    assert end_of(system(0.35), 0.35, bound + 1e-6)["reason"] == 1


def jacobi(m: OrientatorParameters, W: float) -> tuple[float, float, float] | None:
    """Angles of catcher and cup and the square of the cup's speed at its release, from the equation
    of motion over phi2 and the energy at the hook contact; None where the catcher comes back first.
    """
    slope, a, b, share = m.hook_impact
    phi1, phi2, _ = m.begin_of_turning
    k = m.hook_motion(phi1, phi2)
    mass = (k["M11"] * slope + 2 * k["M12"]) * slope + k["M22"]
    half, (F_1, F_2) = m.l1 / 2, (W * x for x in m.centrifugal)

    def rates(phi2: float, z: Any) -> list[float]:
        phi1, p, y = z
        k = m.hook_motion(phi1, phi2)
        ay = ((k["Y11"] * p + 2 * k["Y12"]) * p + k["Y22"]) * y
        down = m.m2 * (m.g - ay) - m.mu * F_2
        pull = F_1 * math.sin(phi1) + m.c * half * (phi1 - m.phi10) * math.cos(phi1)
        lever = m.e * math.cos(phi2)
        Q_2 = k["z2"] * down + k["x2"] * (F_2 - m.m2 * lever * y) - m.mu * F_2 * (lever + m.r)
        matrix = [[k["M11"], k["M12"]], [k["M12"], k["M22"]]]
        a1, a2 = np.linalg.solve(matrix, [k["z1"] * down - half * pull, Q_2])
        return [p, (a1 - p * a2) / y, 2 * a2]

    def leaves(phi2: float, z: Any) -> float:
        return float(m.h - m.hook_motion(z[0], phi2)["x1"])

    def back(phi2: float, z: Any) -> float:
        return float(z[0] - m.phi10)

    def stands(phi2: float, z: Any) -> float:
        return float(z[2] - 1e-3)

    ends = (leaves, back, stands)
    for end in ends:
        end.terminal = True  # type: ignore[attr-defined]
    began = [phi1, slope, 2 * share * (a + W * b) / mass]
    solution = solve_ivp(rates, (phi2, DOWN), began, events=ends, rtol=1e-9, atol=1e-10)
    if not len(solution.t_events[0]):
        return None
    return float(solution.y[0, -1]), float(solution.t[-1]), float(solution.y[2, -1])


@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_an_integration_over_the_angle_jams_where_the_simulation_does(mu: float) -> None:
    machine = OrientatorParameters.of(system(mu))

    def orients(n: float) -> bool:
        W = (n * math.pi / 30) ** 2
        end = jacobi(machine, W)
        return end is not None and end[2] >= W * machine.needed_speed_squared(end[1])

    assert orients(LIMITS[mu] - 2e-3)
    assert not orients(LIMITS[mu] + 2e-3)


def test_the_release_is_that_of_the_simulation() -> None:
    n, machine = 60.0, OrientatorParameters.of(system(0.5))
    result = run_product(system(0.5), 0.5, n, 1e-4)
    W = (n * math.pi / 30) ** 2
    phi1, phi2, square = jacobi(machine, W) or (0.0, 0.0, 0.0)
    row = int(np.flatnonzero(result["orientator.stage"] == 3)[0])
    w2 = result["orientator.w2"][row]
    assert result["orientator.phi2"][row] == pytest.approx(phi2, abs=1e-4 * w2)
    assert result["orientator.phi1"][row] == pytest.approx(phi1, abs=1e-4 * 10)
    assert w2**2 == pytest.approx(square, rel=1e-3)
    assert machine.begin_of_turning[1] - machine.begin_of_turning[0] == pytest.approx(UP, abs=1e-12)


@pytest.mark.parametrize(
    "frictions",
    [(0.3,), pytest.param(np.linspace(0.05, 0.6, 23).tolist(), marks=pytest.mark.slow)],
    ids=["one friction", "all"],
)
def test_the_formula_holds_for_three_cups(frictions: Any) -> None:
    cups = [system(0.35, **cup) for cup, _ in formula_comparison.CUPS.values()]
    assert len(cups) == 3
    for cup, mu in itertools.product(cups, frictions):
        *_, limit, error, formula, joint = formula_comparison.limit_row((cup, mu))
        assert abs(100 * (formula / limit - 1)) < WITHIN + 100 * error / limit
        assert joint > limit + error
        assert 0.0 < error < 0.01


def test_a_smaller_chute_raises_the_limit_as_the_centrifugal_force_says() -> None:
    """Only R - r and R - d - l1 cos(phi10)/2 hold R: with F_1 and F_2 in proportion W R would be kept."""
    plain, small = (system(0.35, **{"orientator.chute.R": R}) for R in (0.27, 0.2646))
    slow, fast = (fastest(x, 0.35, np.arange(74.0, 82.0) / RPM).value for x in (plain, small))
    gain = math.log(fast / slow) / math.log(0.2646 / 0.27)
    assert gain == pytest.approx(-0.522, abs=0.01)
    assert gain == pytest.approx(-0.5 * 0.27 / (0.27 - 0.02), abs=0.03)


def test_an_extreme_is_as_uncertain_as_what_may_lie_beyond_it() -> None:
    values, errors = pd.Series([1.0, 0.99, math.nan]), pd.Series([0.001, 0.05, 0.2])
    assert formula_comparison.largest_of(values, errors, "x").error == pytest.approx(0.04)
    assert formula_comparison.largest_of(values, errors / 100, "x").error == pytest.approx(1e-5)


def test_effects_have_the_sense_of_their_cause() -> None:
    answer = ask("orientation_time", compare="neglected", speeds="0rpm")
    f, row = answer.figures, answer.first_table.iloc[0]
    assert row["coriolis"] == pytest.approx(row["paper"], abs=1e-12), (
        "no rotation, no Coriolis force"
    )
    assert f["coriolis"].value == pytest.approx(2.296, abs=1e-3)
    assert f["hook"].value == pytest.approx(-11.652, abs=5e-3)
    assert 0.0 < f["corner"].value < 0.05
    assert f["spring"].value == pytest.approx(-0.0323, abs=1e-4)
    assert f["limit_coriolis"].value < f["limit_paper"].value
    assert f["limit_paper"].value <= LIMITS[0.35] <= f["limit_paper"].value + f["limit_paper"].error


def test_what_neglected_friction_makes_lies_within_its_error_of_what_hardly_creeps() -> None:
    """Where it would stick the FMU creeps, which acts on times and limits in proportion."""
    creeping = system(0.35, **{"orientator.neglected.mu_catcher": 0.35, neglected.CREEP: 2.5e-4})
    hardly = replace(creeping, start=creeping.start | {neglected.CREEP: 1e-3 / 64})
    (asked,) = neglected.SlowlyCreeping.of(creeping, 0.35, [60.0 / RPM])
    stated, limit = (
        neglected.orientation(creeping.parts, asked),
        neglected.fastest_oriented(0.35, creeping),
    )
    exact = end_of(hardly, 0.35, 60.0)["orientation_time"]
    assert abs(stated.value - exact) <= stated.error < 4e-4
    exact = fastest(hardly, 0.35, np.arange(76.0, 79.0) / RPM)
    assert abs(limit.value - exact.value) <= limit.error + exact.error < 0.1


def test_what_is_neglected_has_the_same_bits_in_both_flavours() -> None:
    names = {"mu_side": 0.35, "mu_catcher": 0.35, "rim": 5e-4, "anchored": True}
    start = {f"orientator.neglected.{name}": value for name, value in names.items()}
    native, python = (
        orientator.system(fmus_of(orientation_time, flavour), 0.0, 0.35, start)
        for flavour in ("native", "python")
    )
    first, second = (run_product(x, 0.35, 40.0, 5e-3) for x in (native, python))
    assert first.data.tobytes() == second.data.tobytes()
    plain = run_product(replace(native, start=system(0.35).start), 0.35, 40.0, 5e-3)
    assert plain["orientator.orientation_time"][-1] == pytest.approx(0.2638050034, abs=1e-9)
    assert first["orientator.orientation_time"][-1] == pytest.approx(0.254603, abs=2e-5)


def test_the_last_product_that_works_and_the_first_that_jams_stand_beside_each_other() -> None:
    """They differ by a hundred-thousandth of their speed, and each has its name."""
    answer = ask("orientation_time", speeds="40rpm,80rpm", frictions="0.35")
    (motion,) = answer.show().motions
    limit = answer.figures["limit_mu_0_35"]
    for n in (limit.value, limit.value + limit.error):
        assert f"{n:.7g} rpm" in motion.title
    assert "oriented" in motion.captions[-1] and "jammed" in motion.captions[-1]
    assert len([x for x in motion.shapes if x.name == "cup"]) == 2


def test_a_jam_between_speeds_that_work_is_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that lies between two neighbours of the sweep, below the speed from which on all products jam."""

    def solve_all(_context: Context, asked: Any) -> list[Findings]:
        jams = [6.94 <= o.speed <= 6.99 or o.speed >= 7.1 for o in asked]
        return [
            Findings({
                **{x: Figure(0.1, "s", 0.0) for x in [*PRODUCT_UNITS][4:]},
                "stage": Figure(4.0 + jam, "1", 0.0), "reason": Figure(6.0 * jam, "1", 0.0),
                "oriented": Figure(1.0 - jam, "1", 0.0),
            })
            for jam in jams
        ]  # fmt: skip

    monkeypatch.setattr(Product, "solve_all", solve_all)
    limit = fastest(system(0.35), 0.35, np.arange(5.0, 8.0, 0.25))
    assert limit.value <= 6.94 * RPM <= limit.value + limit.error < 6.941 * RPM


def test_a_machine_that_orients_no_product_has_no_limit_to_compare() -> None:
    """Its spring holds the catcher, so that by the closed bound no product reaches the hook."""
    with pytest.raises(SetupError, match="no product reaches the hook at any speed"):
        ask(
            "orientation_time",
            compare="formula",
            frictions="0.5",
            start={"orientator.spring.c": 200.0},
        )
