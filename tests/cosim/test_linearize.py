"""The linear system of a coupled one has the eigenvalues and responses of the formulas."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from cosim import SetupError, System, linearize
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.machine import linearised, start_values
from tests.conftest import described, rewritten

DRIVE = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
SHAFT = ["one.w_b -> shaft.w_a", "two.w_a -> shaft.w_b"]
SHAFT += ["shaft.tau_a -> one.tau_b", "shaft.tau_b -> two.tau_a"]
J_1, J_2, STIFF = 1.1, 2.2, 1e6
RIGID = {"one.J": J_1, "two.J": J_2, "one.i": 1.0, "two.i": 1.0, "one.eta": 1.0, "two.eta": 1.0}
RIGID |= {"shaft.b": 0.0, "shaft.c": STIFF, "shaft.d": 0.0, "shaft.twist": 0.0}


def conveyor(native: Path, **start: Any) -> System:
    """The drive of the conveyor."""
    parts = {"motor": native / "DriveMotor.fmu", "conveyor": native / "CrankConveyor.fmu"}
    named_start = {name.replace("__", "."): value for name, value in start.items()}
    return System(parts, DRIVE, named_start)


def two_masses(native: Path, **changed: Any) -> System:
    """Two gearboxes without losses on an elastic shaft."""
    parts = dict.fromkeys(("one", "two"), native / "Gearbox.fmu")
    parts["shaft"] = native / "ShaftLink.fmu"
    wires = changed.pop("wires", SHAFT)
    start = RIGID | {name.replace("__", "."): value for name, value in changed.items()}
    return System(parts, wires, start)


def fastest(linear: Any) -> complex:
    """The eigenvalue of the fastest oscillation, its upper half."""
    return complex(max(linear.eigenvalues, key=lambda s: (round(abs(s), 6), s.imag)))


@pytest.mark.parametrize("name", ["A", "B"])
def test_conveyor_at_rest_in_the_middle_of_its_stroke(native: Path, name: str) -> None:
    """(theta s^2 + alpha r^2 s + C r^2)(T s + 1) + B s = 0 with theta = theta1 + m r^2."""
    m = SETS[name]
    start = {key: value for key, value in m.start(1.0).items() if "." in key}
    start |= {"motor.A": 0.0, "motor.tau": 0.0, "conveyor.w": 0.0, "conveyor.phi": 0.0}
    system = conveyor(native, **{key.replace(".", "__"): value for key, value in start.items()})
    shaft = [m.theta1 + m.m * m.r**2, m.d * m.r**2, m.c * m.r**2]
    exact = np.roots(np.polyadd(np.polymul(shaft, [m.T, 1.0]), [m.B, 0.0]))
    linear = linearize(system)
    assert sorted(linear.eigenvalues, key=np.imag) == pytest.approx(
        sorted(exact, key=np.imag), rel=1e-8
    )
    assert linear.rates == pytest.approx(dict.fromkeys(linear.states, 0.0), abs=1e-12)


@pytest.mark.parametrize("name", ["A", "B"])
def test_resonance_22_where_a_constant_inertia_and_no_slope_of_the_spring_show_it(
    native: Path, name: str
) -> None:
    """Held by the motor's stall torque C r^2/2 at 45 degrees: theta = theta0, dM_c/dphi = 0.

    The torque answers a load with B/Dhat (21), at 2 nu since the ripple is of order 2, and lags by
    90 degrees at twice the speed (22).
    """
    m = SETS[name]
    stall = m.c * m.r**2 / 2
    start = {key: value for key, value in m.start(1.0).items() if "." in key}
    start |= {"motor.A": stall, "motor.tau": stall, "conveyor.w": 0.0, "conveyor.phi": math.pi / 4}
    system = conveyor(native, **{key.replace(".", "__"): value for key, value in start.items()})
    linear = linearize(system, inputs=["conveyor.tau"])
    electromechanical = linear.modes.iloc[-1]
    assert electromechanical["frequency [rad/s]"] == pytest.approx(2 * m.nu_res, rel=1e-8)
    assert electromechanical["damping ratio"] == pytest.approx(m.zeta, rel=1e-8)
    nu = np.linspace(5.0, 60.0, 12)
    exact = m.B / (m.slope - 4 * m.theta0 * m.T * nu**2 + 2j * nu * m.J)
    load = -linear.frequency_response("conveyor.tau", "motor.tau", 2 * nu)
    assert load == pytest.approx(exact, rel=1e-8)
    lag = -np.angle(-linear.frequency_response("conveyor.tau", "motor.tau", 2 * m.nu_res))
    assert math.degrees(lag) == pytest.approx(90.0, abs=1e-8)
    peak = minimize_scalar(
        lambda w: -abs(linear.frequency_response("conveyor.tau", "motor.tau", w)),
        bounds=(m.nu_res, 3 * m.nu_res), method="bounded", options={"xatol": 1e-9},
    ).x  # fmt: skip
    assert peak == pytest.approx(2 * m.nu_res * math.sqrt(1 - 2 * m.zeta**2), rel=1e-7)


def test_the_slope_of_an_induction_motor_is_that_of_the_theory(native: Path) -> None:
    """tau' T = tau_static(w) - tau: by the FMU's derivatives, and in closed form as resonance takes it."""
    m, kloss = SETS["A"], {"motor.characteristic": 1}
    m = m.follow(kloss)
    values = start_values(m, 40.0)
    start = {k: v for k, v in values.items() if k.startswith("motor.")} | {"motor.w": 40.0}
    linear = linearize(System({"motor": native / "DriveMotor.fmu"}, [], start))
    assert -linear.B[0, 0] * m.T == pytest.approx(linearised(m, 40.0).B, rel=1e-12)


def test_a_stiff_shaft_between_two_masses(native: Path) -> None:
    """Undamped w = sqrt(c (1/J1 + 1/J2)); with damping the ratio d w / (2 c)."""
    w = math.sqrt(STIFF * (1 / J_1 + 1 / J_2))
    assert fastest(linearize(two_masses(native))) == pytest.approx(1j * w, rel=1e-8)
    for c, d in ((STIFF, 50.0), (1e4, 1.0), (1e4, 100.0)):
        w = math.sqrt(c * (1 / J_1 + 1 / J_2))
        damped = fastest(linearize(two_masses(native, shaft__c=c, shaft__d=d)))
        assert abs(damped) == pytest.approx(w, rel=1e-8)
        assert -damped.real / w == pytest.approx(d * w / (2 * c), rel=1e-8)


def test_factors_and_ratios_reduce_inertias(native: Path) -> None:
    """A ratio of 2 makes 4 J of J, and so do factors of 1/2 on the two wires of a shaft end."""
    w = math.sqrt(STIFF * (1 / (4 * J_1) + 1 / J_2))
    geared = linearize(two_masses(native, one__i=2.0))
    halved = [SHAFT[0].replace("one.w_b", "one.w_b * 0.5"), SHAFT[1]]
    halved += [SHAFT[2].replace("shaft.tau_a", "shaft.tau_a * 0.5"), SHAFT[3]]
    wired = linearize(two_masses(native, wires=halved))
    assert fastest(geared) == pytest.approx(1j * w, rel=1e-8)
    assert fastest(wired) == pytest.approx(1j * w, rel=1e-8)


def test_a_lagging_motor_turns_an_inertia(native: Path) -> None:
    """J T s^2 + J s + B = 0; the columns, rows and units are those of the parts."""
    B, T, J = 20.0, 0.05, 0.4
    parts = {"motor": native / "DriveMotor.fmu", "load": native / "Gearbox.fmu"}
    start = {"motor.B": B, "motor.T": T, "load.J": J, "load.eta": 1.0, "load.i": 1.0}
    linear = linearize(System(parts, ["motor.tau -> load.tau_a", "load.w_a -> motor.w"], start))
    root = complex(-J, math.sqrt(4 * J * T * B - J**2)) / (2 * J * T)
    assert fastest(linear) == pytest.approx(root, rel=1e-8)
    assert list(linear.modes["frequency [rad/s]"]) == pytest.approx(
        [0.0, math.sqrt(B / (J * T))], abs=1e-6
    )
    assert (linear.states, linear.inputs) == (
        ["motor.tau", "load.phi_a", "load.w_a"],
        ["load.tau_b"],
    )
    assert list(linear.frame("B").columns) == ["load.tau_b [N.m]"]
    assert list(linear.frame("C").index)[:2] == ["motor.tau [N.m]", "motor.tau_static [N.m]"]
    w = np.array([0.0, 3.0, 30.0])
    speed = (T * 1j * w + 1) / (J * T * (1j * w) ** 2 + J * 1j * w + B)
    got = linear.frequency_response("load.tau_b", "load.w_a", w[1:])
    assert got == pytest.approx(speed[1:], rel=1e-8)
    stepped = linear.step_response("load.tau_b", "load.w_a", [0.0, 1e-8, 10.0])
    assert stepped == pytest.approx([0.0, 1e-8 / J, 1 / B], rel=1e-6)
    assert linear.point["load.w_a"] == 100.0
    assert "not at rest" in repr(linear)


def test_differences_stand_in_for_derivatives(native: Path, tmp_path: Path) -> None:
    """Of FMUs that offer none, in a motion and with an exact rod."""
    start = {"conveyor__phi": 0.7, "conveyor__rod__finite": True}
    exact = linearize(conveyor(native, **start))
    system = conveyor(native, **start)
    without = described(('providesDirectionalDerivative="true"', ""))
    parts = {k: rewritten(v, tmp_path / v.name, without) for k, v in system.parts.items()}
    linear = linearize(System(parts, system.wires, system.start))
    for matrix in "ABCD":
        a, b = getattr(linear, matrix), getattr(exact, matrix)
        assert a == pytest.approx(b, rel=1e-7, abs=1e-7 * np.abs(b).max(initial=1.0))


def looped(native: Path, factor: float) -> System:
    """Two shafts whose torques are each other's speeds: an algebraic loop of gain (factor d)^2."""
    wires = [f"one.tau_a * {factor} => two.w_a", f"two.tau_a * {factor} => one.w_a"]
    start = {f"{k}.{n}": v for k in ("one", "two") for n, v in (("b", 0.0), ("d", 5.0), ("c", 7.0))}
    return System(dict.fromkeys(("one", "two"), native / "ShaftLink.fmu"), wires, start)


def test_feedthrough_is_closed_or_refused(native: Path) -> None:
    k, c, d = 0.1, 7.0, 5.0
    linear = linearize(looped(native, k))
    inner = k * c / (1 - (k * d) ** 2) * np.array([[k * d, -1.0], [-1.0, k * d]])
    assert pytest.approx(inner, rel=1e-12) == linear.A
    with pytest.raises(SetupError, match=r"loop .*one.tau_a -> two.w_a, two.tau_a -> one.w_a"):
        linearize(looped(native, 0.2))


def test_what_cannot_be_linearised_is_refused(native: Path, fmus: Path) -> None:
    system = conveyor(native)
    mixed = System({**system.parts, "motor": fmus / "DriveMotor.fmu"}, DRIVE)
    with pytest.raises(SetupError, match=r"motor: .*DriveMotor\.fmu offers no model exchange"):
        linearize(mixed)
    with pytest.raises(SetupError, match=r"conveyor.w \[rad/s\] is not a Real input"):
        linearize(system, inputs=["conveyor.w"])
    linear = linearize(system)
    with pytest.raises(SetupError, match=r"conveyor\.tau is not one of none"):
        linear.frequency_response("conveyor.tau", "motor.tau", 1.0)
