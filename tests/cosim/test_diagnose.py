"""The loop delay that is measured on FMUs is that of the ideal algorithm, and of the theory."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.coverage import Trial
from benchmarks.damping import centre_case, linear_case
from cosim import SetupError, System, diagnose, linearize
from fmukit.fmu.make import make_all
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.machine import conveyor_drive
from tests.conftest import ROOT
from tests.cosim.test_linearize import conveyor, two_masses
from tests.coupling_theory import Ideal, LinearPart, Scheme
from tests.linear_systems import DC_MOTOR, OSCILLATOR, couple, drive, twisting_drive

J_1, J_2, STIFF, DAMP = 1.1, 2.2, 1e4, 1.0
RESONANCE = math.sqrt(STIFF * (1 / J_1 + 1 / J_2))
LOOSE = 1e4


INERTIA = [[0, 1], [0, 0]]
THREE = {
    "drive": LinearPart(INERTIA, [[0], [-1 / J_1]], np.eye(2), [0, 1], ("shaft.1",)),
    "shaft": LinearPart(
        [[0]], [[0] * 4], [[0]], [0], ("drive.1", "drive.2", "load.1", "load.2"),
        D=[[STIFF, DAMP, -STIFF, -DAMP]],
    ),
    "load": LinearPart(INERTIA, [[0], [1 / J_2]], np.eye(2), [0, 0], ("shaft.1",)),
}  # fmt: skip


DELAYS = {
    ("two", "jacobi"): 7 / 18,
    ("two", "gauss-seidel"): 1 / 18,
    ("three", "jacobi"): 3 / 2,
    ("three", "gauss-seidel"): 1 / 2,
}
DRIVES = {"two": drive(DAMP), "three": THREE, "soft": drive(100.0)}


def damping_ratio(d: float) -> float:
    """Of the shaft's oscillation, in closed form."""
    return d * RESONANCE / (2 * STIFF)


def coupled(fmus: Path, units: dict[str, LinearPart], hold: int = 0) -> System:
    """The units as FMUs."""
    return couple(units, fmus / "LinearSystem.fmu", input_hold=hold)


def rates(units: dict[str, LinearPart], scheme: Scheme, h: float) -> Any:
    """ln z / h [1/s] of the eigenvalues z of the ideal step."""
    z = Ideal(units).eigenvalues(scheme, h)
    return np.log(z[np.abs(z) > 1e-3]) / h


def ideal_damping(
    units: dict[str, LinearPart], algorithm: str, h: float, input_order: int = 0
) -> float:
    """The damping ratio of the shaft's oscillation as the ideal algorithm shows it."""
    s = min(rates(units, Scheme(algorithm, input_order), h), key=lambda s: abs(s - 1j * RESONANCE))
    return float(-s.real / abs(s))


TABLE = [
    ("two", "jacobi", 1e-3, -0.01671),
    ("two", "jacobi", 5e-4, -0.00550),
    ("two", "jacobi", 1e-4, 0.00357),
    ("two", "gauss-seidel", 1e-3, 0.00260),
    ("two", "gauss-seidel", 5e-4, 0.00422),
    ("two", "gauss-seidel", 1e-4, 0.00551),
    ("three", "jacobi", 1e-3, -0.08079),
    ("three", "jacobi", 5e-4, -0.03786),
    ("three", "jacobi", 1e-4, -0.00292),
    ("three", "gauss-seidel", 1e-3, -0.02331),
    ("three", "gauss-seidel", 5e-4, -0.00875),
    ("three", "gauss-seidel", 1e-4, 0.00292),
    ("soft", "jacobi", 1e-3, 0.5745),
    ("soft", "gauss-seidel", 1e-3, 0.5827),
]


@pytest.mark.parametrize(
    ("drive", "algorithm", "h", "damping"),
    [pytest.param(*row, marks=[] if row[2] == 1e-3 else [pytest.mark.slow]) for row in TABLE],
)
def test_damping_is_that_of_the_ideal_algorithm(
    fmus: Path, drive: str, algorithm: str, h: float, damping: float
) -> None:
    """Also the drive's momentum, which a held angle lets grow at c H / (2 (J1 + J2))."""
    got = diagnose(coupled(fmus, DRIVES[drive]), step=h, algorithm=algorithm, share=LOOSE)
    real = damping_ratio(100.0 if drive == "soft" else DAMP)
    ideal = ideal_damping(DRIVES[drive], algorithm, h)
    assert got.trusted
    assert got.damping_seen == pytest.approx(damping, rel=3e-3)
    assert got.damping_seen == pytest.approx(ideal, rel=1e-6)
    assert got.frequency == pytest.approx(RESONANCE, rel=1e-3)
    assert abs(got.damping - real) <= got.error
    assert got.error < 0.05 * real
    assert got.delay == pytest.approx(2 * (real - ideal) / RESONANCE, rel=0.05)
    if h == 1e-4:
        assert got.delay / h == pytest.approx(DELAYS[drive, algorithm], rel=3e-3)
    pushes = drive != "three" and h >= 5e-4
    assert got.drift == pytest.approx(pushes * STIFF * h / (2 * (J_1 + J_2)), rel=3e-3)
    assert got.recommended_step == h
    assert ("unstable" in got.text()) is (damping < 0.0)


@pytest.mark.parametrize(
    "algorithm", ["jacobi", pytest.param("gauss-seidel", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("drive", ["two", pytest.param("three", marks=pytest.mark.slow)])
def test_the_recommended_step_keeps_its_share_and_is_no_shorter_than_it_must(
    fmus: Path, drive: str, algorithm: str
) -> None:
    got = diagnose(coupled(fmus, DRIVES[drive]), step=1e-3, algorithm=algorithm, share=0.05)
    remaining = ideal_damping(DRIVES[drive], algorithm, got.recommended_step)
    assert 0.04 < abs(remaining / damping_ratio(DAMP) - 1) < 0.05
    assert got.damping == pytest.approx(damping_ratio(DAMP), rel=1e-3)
    assert f"Steps of {got.recommended_step:.3g} s keep the damping within 5 %" in got.text()


def test_gauss_seidel_coupled_by_speed_has_no_delay(fmus: Path) -> None:
    system = coupled(fmus, twisting_drive(DAMP))
    got = diagnose(system, step=1e-3, algorithm="gauss-seidel")
    assert abs(got.delay) < 1e-4 * got.step
    assert got.damping_seen == pytest.approx(0.0058386, abs=5e-8)
    assert (got.recommended_step, got.drift) == (got.step, 0.0)
    diagnosis = diagnose(system, step=1e-3, algorithm="jacobi", share=LOOSE)
    assert diagnosis.damping_seen == pytest.approx(-0.01360, abs=5e-6)


def test_moving_inputs_are_measured_too(fmus: Path) -> None:
    """Extrapolating FMUs, a master that extrapolates means, and a wire with a factor."""
    extrapolates = coupled(fmus, DRIVES["two"], hold=1)
    extrapolating = diagnose(extrapolates, step=1e-3, algorithm="jacobi", share=1.0)
    assert extrapolating.damping_seen == pytest.approx(0.00564, abs=5e-6)
    system = coupled(fmus, DRIVES["two"])
    doubled = {"shaft.C[1,1]": STIFF / 2, "shaft.C[1,2]": DAMP / 2}
    doubled |= {"shaft.D[1,1]": -STIFF / 2, "shaft.D[1,2]": -DAMP / 2}
    wires = [w.replace("shaft.z[1]", "shaft.z[1] * 2") for w in system.wires]
    geared = replace(system, wires=wires, start={**system.start, **doubled})
    got = diagnose(geared, step=1e-3, algorithm="jacobi", input_order=1, share=1.0)
    ideal = ideal_damping(DRIVES["two"], "jacobi", 1e-3, input_order=1)
    assert got.damping_seen == pytest.approx(ideal, rel=1e-6)


@pytest.mark.parametrize(("algorithm", "delay"), [("jacobi", 1.0), ("gauss-seidel", 0.0)])
def test_loop_delay_of_the_conveyor_drive_on_its_orbit(algorithm: str, delay: float) -> None:
    """The rule for the lagging motor, J - B tau in place of J, on the nonlinear FMUs."""
    machine = SETS["A"]
    nu = machine.nu_res
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    fmus = {part: ROOT / "fmus" / f"{name}.fmu" for part, name in parts.items()}
    turn, system = 2 * math.pi / nu, conveyor_drive(fmus, machine.start(nu))
    got = diagnose(system, step=turn / 128, algorithm=algorithm, settle=4 * turn)
    assert got.trusted
    assert got.frequency == pytest.approx(2 * nu, rel=1e-3)
    assert got.damping == pytest.approx(machine.zeta, rel=2e-3)
    assert got.delay / got.step == pytest.approx(delay, abs=0.02)
    if delay:
        longest = 0.05 * machine.J / machine.B
        assert 0.75 * longest < got.recommended_step < longest
    else:
        assert got.recommended_step == got.step


@pytest.mark.parametrize(
    "algorithm", ["jacobi", pytest.param("gauss-seidel", marks=pytest.mark.slow)]
)
def test_model_exchange_gives_the_damping_itself(algorithm: str, fmus: Path, native: Path) -> None:
    """Two masses on a shaft: the eigenvalue, and within its error what runs of the Python FMUs tell."""
    start = {"shaft__c": STIFF, "shaft__d": 100.0, "shaft__twist": 0.001}
    start |= dict.fromkeys(("one__w_a", "two__w_a", "two__tau_b"), 0.0)
    linear, runs = (
        diagnose(two_masses(folder, **start), step=1e-4, algorithm=algorithm, share=LOOSE)
        for folder in (native, fmus)
    )
    assert (linear.linear, runs.linear) == (True, False)
    assert linear.frequency == pytest.approx(RESONANCE, rel=1e-8)
    assert linear.damping == pytest.approx(damping_ratio(100.0), rel=1e-8)
    assert abs(runs.damping - linear.damping) <= runs.error
    assert linear.error < runs.error / 10
    assert linear.damping_seen == pytest.approx(runs.damping_seen, rel=1e-6)


def test_eigenvalues_at_an_angle_are_not_taken_for_those_of_a_turning_crank(native: Path) -> None:
    got = diagnose(conveyor(native), step=1e-3, algorithm="gauss-seidel", share=LOOSE)
    assert got.trusted and not got.linear
    frozen = linearize(conveyor(native)).modes["frequency [rad/s]"]
    assert got.frequency == pytest.approx(2 * SETS["A"].nu_res, rel=1e-3)
    assert min(abs(frozen - got.frequency)) > 2e-3 * got.frequency


def test_an_undamped_system_has_no_share_to_keep(fmus: Path) -> None:
    got = diagnose(coupled(fmus, OSCILLATOR), step=0.01, algorithm="jacobi")
    assert got.trusted
    assert abs(got.damping) <= got.error < 1e-4
    s = rates(OSCILLATOR, Scheme("jacobi"), 0.01)
    growing = min(s[s.imag > 0.0], key=lambda s: -s.real / abs(s))
    assert got.damping_seen == pytest.approx(-growing.real / abs(growing), rel=1e-6)
    assert got.recommended_step is None
    assert "does not damp it" in got.text()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 30))
@pytest.mark.parametrize("case", [linear_case, centre_case])
def test_damping_of_random_systems_is_true(case: Callable[[int], Trial], seed: int) -> None:
    """At steps where a damping ratio follows a parabola, and where it does not yet; of centres none is stated."""
    for name, figure in case(seed).figures.items():
        assert (figure.error_ratio() or 0.0) < 1.5, name


def hunt(half: Path, a: float, b: float, x: float, y: float) -> System:
    """Prey x' = x (a - y) and hunters y' = y (x - b) from (x, y): they go round the centre (b, a)."""
    parts = {"prey": f"x1 * ({a!r} - u1)", "hunter": f"x1 * (u1 - {b!r})"}
    start: dict[str, Any] = {f"{name}.f1": rate for name, rate in parts.items()}
    start |= {"prey.x1": x, "hunter.x1": y, "prey.u2": 0.0, "hunter.u2": 0.0}
    wires = ["prey.x1 -> hunter.u1", "hunter.x1 -> prey.u1"]
    return System(dict.fromkeys(parts, half), wires, start)


#: step [s] that is tried with each algorithm; shorter ones are slow
LONGEST = 0.2


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "strang"])
@pytest.mark.parametrize(
    ("step", "settle"),
    [
        (LONGEST, 0.0),
        *(pytest.param(*x, marks=pytest.mark.slow) for x in ((0.05, 7.0), (0.02, 0.0))),
    ],
)
def test_a_centre_has_no_damping(algorithm: str, step: float, settle: float, half: Path) -> None:
    """Hunters and prey go round on the orbit on which they are: one sentence, and no number."""
    system = hunt(half, 1.1, 1.1, 1.5, 0.7)
    got = diagnose(system, step=step, algorithm=algorithm, settle=settle)
    assert got.recommended_step is None
    assert not got.damped
    text = got.text()
    assert "no damping to speak of" in text or "next to none" in text
    assert not re.search(r"\d", text)
    assert text.count(".") == 1


def test_a_perturbation_is_small_for_a_small_signal(half: Path) -> None:
    """x'' = -x - x^3 / 10 L^2 - x' / 10 with x of 1e-5: beside 1 + abs(x) the cubic term would dominate."""
    size = 1e-5
    start = {
        "place.f1": "u1", "place.x1": 0.0, "place.u2": 0.0,
        "speed.f1": f"-u1 - 0.1 * x1 - {0.1 / size**2!r} * u1**3",
        "speed.x1": 0.5 * size, "speed.u2": 0.0,
    }  # fmt: skip
    wires = ["speed.x1 -> place.u1", "place.x1 -> speed.u1"]
    system = System(dict.fromkeys(["place", "speed"], half), wires, start)
    got = diagnose(system, step=LONGEST, algorithm="gauss-seidel", share=LOOSE)
    assert got.damped
    assert abs(got.damping - 0.05) <= got.error < 1e-3


def test_figures_that_are_not_trustworthy_are_not_stated(fmus: Path) -> None:
    """Frequencies that fall with the step may end below zero when they are continued to zero."""
    good = diagnose(coupled(fmus, DRIVES["two"]), step=1e-3, algorithm="jacobi", share=LOOSE)
    assert good.damped
    changes: list[dict[str, float]] = [{"residual": 0.05}, {"error": 0.2 * good.damping}]
    changes += [{"frequency": -3.0}, {"damping": 2.3, "frequency": 0.1}]
    for odd in (replace(good, **change) for change in changes):
        assert not odd.damped
        assert odd.text().startswith("The damping cannot be determined: ")
        assert not re.search(r"\d", odd.text())


def test_a_system_that_does_not_oscillate_is_reported(fmus: Path) -> None:
    got = diagnose(coupled(fmus, DC_MOTOR), step=1e-3)
    assert math.isnan(got.frequency)
    assert got.recommended_step is None
    assert got.text() == "No oscillation shows on the wires with strang and steps of 0.001 s."


def test_damping_that_does_not_converge_is_not_trusted(fmus: Path) -> None:
    coarse = diagnose(coupled(fmus, THREE), step=6e-3, algorithm="jacobi", share=LOOSE)
    assert not coarse.trusted
    assert "it still changes with the step" in coarse.text()


def test_what_cannot_be_diagnosed_is_refused(fmus: Path) -> None:
    system = coupled(fmus, DRIVES["two"])
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"share": 0.0}, "share = 0.0 must be a finite number above 0"),
        ({"settle": -1.0}, "settle = -1.0 s must be a finite number of at least 0"),
        ({"algorithm": "newmark"}, "algorithm 'newmark' must be one of"),
        ({"step": 0.0}, "step = 0.0 s must be above 0"),
        ({"order": ["load"]}, "must name each of"),
    ]
    for settings, reason in wrong:
        with pytest.raises(SetupError, match=reason):
            diagnose(system, **{"step": 1e-3} | settings)
    single = System({"a": fmus / "LinearSystem.fmu"}, start={f"a.u[{i}]": 0.0 for i in range(1, 5)})
    with pytest.raises(SetupError, match="needs a wire that carries a Real"):
        diagnose(single, step=1e-3)


@pytest.mark.parametrize("force", [0.0, 0.1])
def test_a_perturbation_that_changes_the_sequence_of_events_is_the_reason(
    force: float, tmp_path: Path
) -> None:
    """A mass at rest on the threshold of its switch, whether or not that adds a force [N] elsewhere.

    Away from the threshold, the damping is determined.
    """
    assert not make_all([Path(__file__).with_name("relay.py")], "python", tmp_path)
    parts = dict.fromkeys(["left", "right"], tmp_path / "Relay.fmu")
    wires = ["left.f_coupled -> right.F", "right.f_coupled -> left.F"]
    start = {"right.k": 150.0, "right.F_c": force}
    system = System(parts, [*wires, "left.above -> right.closed"], start)
    refused = diagnose(system, step=0.01, algorithm="gauss-seidel")
    assert not refused.trusted
    assert refused.recommended_step is None
    assert refused.text() == (
        "The damping cannot be determined: a perturbation of left.F changes the sequence of events at "
        "t = 0.0025 s: left.above becomes 1 instead of 0. "
        "Deviations are not small there; try another start or settling time."
    )
    for other in (
        replace(system, start={**system.start, "left.x": 1.0}),
        replace(system, wires=wires),
    ):
        got = diagnose(other, step=0.01)
        assert got.damped
        assert not got.event_change


@pytest.mark.parametrize("force", ["5 * abs(u1)", "(0.01 if u1 > 0 else 0.0)"])
def test_deviations_that_do_not_change_sign_with_the_perturbation_are_the_reason(
    force: str, half: Path
) -> None:
    """x'' = -x - x' / 10 - force, at rest on the corner or the step of the force."""
    start = {
        "place.f1": "u1", "place.x1": 0.0, "place.u2": 0.0,
        "speed.f1": f"-u1 - 0.1 * x1 - {force}", "speed.x1": 0.0, "speed.u2": 0.0,
    }  # fmt: skip
    wires = ["speed.x1 -> place.u1", "place.x1 -> speed.u1"]
    system = System(dict.fromkeys(["place", "speed"], half), wires, start)
    refused = diagnose(system, step=LONGEST, algorithm="gauss-seidel", share=LOOSE)
    assert not refused.trusted
    assert refused.recommended_step is None
    assert refused.text().startswith(
        "The damping cannot be determined: opposite perturbations have no opposite effects, "
    )
