"""Mean values, the classical calculation and the induction motor against derivations, exact orbits and
integration in time of equations written here.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from cosim import SetupError
from cosim.metrics import harmonics
from scenarios.conveyor.classical import worst
from scenarios.conveyor.first_order import SETS, Machine, classical, flux_lag
from scenarios.conveyor.machine import kloss_slips
from scenarios.conveyor.orbit import Drive as Runs
from scenarios.conveyor.questions import induction_motor
from scenarios.conveyor.second_order import deviation_left, means, settling_rates
from tests.conftest import QUICK, ask, fmus_of
from tests.scenarios.orbit_oracle import Drive, Orbit, angles, f_rod_peak, orbit
from workbench import Context, Figure
from workbench.answer import Answer

POINTS = {"A": "20,36,40,60", "B": "8,21,30,60"}


def drive(machine: Machine) -> Drive:
    """The same machine for the exact orbits."""
    names = {"theta1": "J"}
    return Drive(**{names.get(x, x): y for x, y in vars(machine).items() if x != "more"})


def shrunk(machine: Machine, share: float) -> Machine:
    """The machine with epsilon times a share: r^2 is smaller, theta0 as before."""
    r = machine.r * math.sqrt(share)
    return replace(machine, r=r, theta1=machine.theta0 - machine.m * r**2 / 2)


@cache
def exact(machine: Machine, nu: float) -> Orbit:
    return orbit(drive(machine), nu)


def true_means(machine: Machine, nu: float) -> dict[str, float]:
    """Means over the exact orbit, in time but for `angle`."""
    orbit = exact(machine, nu)
    w, M, phi = nu + orbit.v, orbit.M, angles(len(orbit.v))

    def timed(x: Any) -> float:
        return float(np.mean(x / w) * orbit.mean_speed)

    trough = machine.d * (machine.r * np.cos(phi) * w) ** 2
    torque = timed(M)
    return {
        "speed": orbit.mean_speed, "angle": float(w.mean()), "torque": torque,
        "supply": machine.A(nu) / machine.B * torque, "trough": timed(trough),
        "motor": timed(M**2) / machine.B,
    }  # fmt: skip


@pytest.fixture(
    scope="module",
    params=[
        "A",
        "B",
        *(pytest.param(f"{name}, all speeds", marks=pytest.mark.slow) for name in SETS),
    ],
)
def answers_of_set(request: pytest.FixtureRequest) -> tuple[str, Answer, Answer]:
    """The set, mean values and classical calculation of it."""
    name = request.param[0]
    speeds = "" if len(request.param) > 1 else POINTS[name]
    return (
        name,
        ask("mean_values", set=name, speeds=speeds),
        ask("resonance", theory="classical", set=name, speeds=speeds),
    )


def test_second_order_means_follow_from_the_equations_in_the_crank_angle() -> None:
    """Orders of epsilon in M = theta w w' + theta' w^2 / 2 + M_c, T w M' + M = A - B w."""
    phi, eps = sympy.symbols("phi epsilon")
    theta0, m, r, c, d, B, T, nu = sympy.symbols("theta0 m r c d B T nu", positive=True)
    s, k, mean = sympy.symbols("s k mean", real=True)
    a = d * r**2 / 2
    w = nu + eps * (s * sympy.sin(2 * phi) + k * sympy.cos(2 * phi)) + eps**2 * mean
    theta = theta0 + eps * m * r**2 / 2 * sympy.cos(2 * phi)
    load = a * w + eps * (c * r**2 / 2 * sympy.sin(2 * phi) + a * w * sympy.cos(2 * phi))
    M = theta * w * w.diff(phi) + theta.diff(phi) * w**2 / 2 + load
    left = sympy.expand(T * w * M.diff(phi) + M - (B + a) * nu + B * w)
    first, second = left.coeff(eps, 1), left.coeff(eps, 2)
    ripple = sympy.solve(
        [sympy.integrate(first * x, (phi, 0, sympy.pi)) for x in (sympy.sin(2 * phi), sympy.cos(2 * phi))],
        [s, k],
    )  # fmt: skip
    (more,) = sympy.solve(sympy.integrate(second, (phi, 0, sympy.pi)), mean)
    evaluate = sympy.lambdify(
        (theta0, m, r, c, d, B, T, nu), (ripple[s], ripple[k], more.subs(ripple))
    )
    for name, machine in SETS.items():
        for speed in map(float, POINTS[name].split(",")):
            x = machine
            sine, cosine, angle = evaluate(x.theta0, x.m, x.r, x.c, x.d, x.B, x.T, speed)
            assert x.speed_ripple(speed) == pytest.approx(complex(sine, cosine), rel=1e-12)
            formula = means(machine, speed)
            assert formula.angle - speed == pytest.approx(angle, rel=1e-9)
            timed = angle - (sine**2 + cosine**2) / (2 * speed)
            assert formula.speed - speed == pytest.approx(timed, rel=1e-9)


@pytest.mark.parametrize(("name", "nu"), [("A", 30.0), ("A", 40.0), ("B", 21.0), ("B", 34.0)])
def test_what_the_means_neglect_is_of_fourth_order_and_without_ripple_of_second(
    name: str, nu: float
) -> None:
    error: dict[str, list[float]] = {}
    for share in (0.5, 0.25):
        machine = shrunk(SETS[name], share)
        truth = true_means(machine, nu)
        for ripple in (True, False):
            theory = means(machine, nu, ripple=ripple)._asdict()
            for key, value in truth.items():
                error.setdefault(f"{key} {ripple}", []).append(abs(theory[key] - value))
    for key, (large, small) in error.items():
        wanted = 4.0 if key.endswith("True") else 2.0
        assert math.log2(large / small) == pytest.approx(wanted, abs=0.35), key


def test_mean_values_are_those_of_exact_orbits(answers_of_set: Any) -> None:
    name, answer, _ = answers_of_set
    machine, rows = SETS[name], answer.tables["mean_values.csv"].frame
    for _, row in rows.iterrows():
        theory, plain = means(machine, row["nu"]), means(machine, row["nu"], ripple=False)
        for key, value in true_means(machine, row["nu"]).items():
            assert abs(row[key] - value) <= row[f"{key}_error"] < 1e-4 * abs(value), key
            assert (row[f"{key}_theory"], row[f"{key}_plain"]) == pytest.approx(
                (getattr(theory, key), getattr(plain, key)), rel=1e-12
            )
    stated, nu = answer.figures, machine.nu_res
    truth, plain = true_means(machine, nu), means(machine, nu, ripple=False)
    more = 100 * (truth["torque"] / plain.torque - 1)
    assert more == pytest.approx({"A": 8.2298, "B": 9.4856}[name], abs=1e-4)
    assert abs(stated["more"].value - more) <= stated["more"].error
    for key in ("supply", "motor", "trough"):
        figure = stated[f"{key}_more"]
        assert abs(figure.value - truth[key] + getattr(plain, key)) <= figure.error
    assert abs(stated["missing"].value) <= stated["missing"].error < 2e-3
    assert truth["supply"] == pytest.approx(truth["trough"] + truth["motor"], rel=1e-12)


def test_drift_solves_its_equation_and_16_is_its_limit_for_a_short_lag() -> None:
    machine, t = SETS["B"], np.linspace(0.0, 0.2, 4001)
    _, deviation = deviation_left(machine, t)
    rate, bend = np.gradient(deviation, t), np.gradient(np.gradient(deviation, t), t)
    rest = machine.theta0 * machine.T * bend + machine.J * rate + machine.slope * deviation
    assert deviation[0] == pytest.approx(1.0) and abs(rate[0]) < 0.1
    assert abs(rest[3:-3]).max() < 1e-3 * machine.slope
    error = []
    for T in (1e-4, 5e-5):
        plain, deviation = deviation_left(replace(machine, T=T), t)
        error.append(abs(plain - deviation).max())
    assert math.log2(error[0] / error[1]) == pytest.approx(1.0, abs=0.05)
    edge = replace(machine, d=0.0, T=machine.theta0 / machine.B / 22.05)
    slow = -settling_rates(edge).real.max()
    assert slow / (edge.slope / edge.J) == pytest.approx(1.05, abs=1e-3)


def drifted(machine: Machine, nu: float, stop: float, starts: int = 8) -> Any:
    """The mean speed of starts side by side, from the orbit of a speed 5 % below nu, by time."""
    slow, half = 0.95 * nu, machine.r**2 / 2
    phi = 2 * np.pi / starts * np.arange(starts)
    turned = np.exp(2j * phi)
    w = slow + (machine.speed_ripple(slow) * turned).imag
    tau = machine.load_slope * slow + (machine.torque_ripple(slow) * turned).imag

    def slopes(t: float, y: Any) -> Any:
        phi, w, tau = y.reshape(3, -1)
        s, c = np.sin(2 * phi), np.cos(2 * phi)
        load = half * (machine.c * s + machine.d * w * (1 + c) - machine.m * s * w**2)
        theta = machine.theta0 + half * machine.m * c
        lag = (machine.A(nu) - machine.B * w - tau) / machine.T
        return np.concatenate([w, (tau - load) / theta, lag])

    start = np.concatenate([phi, w, tau])
    run = solve_ivp(
        slopes, (0.0, stop), start, method="DOP853", rtol=1e-9, atol=1e-9, dense_output=True
    )
    return lambda t: run.sol(t).reshape(3, starts, -1)[1].mean(axis=0)


def test_the_mean_speed_drifts_as_the_coupled_system_and_theory_misses_it_by_second_order(
    answers_of_set: Any,
) -> None:
    name, answer, _ = answers_of_set
    machine, rows = SETS[name], answer.tables["drift.csv"].frame
    nu, t = float(machine.nu_res), rows["time"].to_numpy()
    transient = drifted(machine, nu, t[-1])
    assert rows["mean"].to_numpy() == pytest.approx(transient(t), abs=2e-4)
    change, t = 0.05 * nu, np.linspace(0.0, t[-1], 50_000)
    mean = transient(t)
    for key, theory in zip(("off_16", "off_whole"), deviation_left(machine, t)):
        figure = answer.figures[key]
        difference = 100 * abs(mean - (nu - change * theory)).max() / change
        assert abs(figure.value - difference) <= figure.error + 1e-5
    assert answer.figures["overshoot"].value == pytest.approx(
        100 * (mean.max() - nu) / change, abs=0.01
    )
    zeta = machine.zeta
    overshoot = 100 * math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    assert answer.figures["overshoot"].value == pytest.approx(overshoot, abs=4.0)
    error = []
    for share in (0.5, 0.25):
        small = shrunk(machine, share)
        nu, stop = float(small.nu_res), t[-1]
        at = np.linspace(0.0, stop, 2001)
        error.append(
            abs(drifted(small, nu, stop)(at) - nu * (1 - 0.05 * deviation_left(small, at)[1])).max()
        )
    assert math.log2(error[0] / error[1]) == pytest.approx(2.0, abs=0.3)


def test_the_classical_calculation_solves_its_linear_equations() -> None:
    """theta0 w' = M - M_c(t), M + T M' = A - B w; and the formula that is printed after (26)."""
    t, theta0, T, B, nu, sine, cosine = sympy.symbols("t theta0 T B nu sine cosine", real=True)
    names = sympy.symbols("ws wc ms mc", real=True)
    ws, wc, ms, mc = names
    S, C = sympy.sin(2 * nu * t), sympy.cos(2 * nu * t)
    w, M, load = ws * S + wc * C, ms * S + mc * C, sine * S + cosine * C
    rest = [theta0 * w.diff(t) - M + load, M + T * M.diff(t) + B * w]
    parts = [sympy.expand(x).coeff(y) for x in rest for y in (S, C)]
    solved = sympy.solve(parts, names)
    evaluate = sympy.lambdify((theta0, T, B, nu, sine, cosine), [solved[x] for x in names])
    for machine in SETS.values():
        for speed in (6.0, 21.0, 40.0, 66.0):
            for inertia in (False, True):
                total = complex(machine.load_ripple(speed))
                L = total if inertia else machine.r**2 * machine.c / 2 + 0j
                ws, wc, ms, mc = evaluate(
                    machine.theta0, machine.T, machine.B, speed, L.real, L.imag
                )
                formula = classical(machine, speed, inertia=inertia)
                assert formula.speed == pytest.approx(complex(ws, wc), rel=1e-9)
                assert formula.torque == pytest.approx(complex(ms, mc), rel=1e-9)
            T_M = machine.theta0 / machine.B
            root = math.hypot(1 - 4 * T_M * machine.T * speed**2, 2 * speed * T_M)
            printed = machine.r**2 * machine.c / 2 / root
            assert abs(classical(machine, speed, inertia=False).torque) == pytest.approx(
                printed, rel=1e-12
            )


@pytest.mark.parametrize("name", SETS)
def test_the_spring_is_the_limit_without_mass_and_resistance(name: str) -> None:
    """Then it neglects the square of c r^2 / (2 theta0 nu^2) alone."""
    bare, error = replace(SETS[name], m=0.0, d=0.0, theta1=SETS[name].theta0), []
    for c in (4e5, 2e5):
        machine = replace(bare, c=c)
        orbit, theory = exact(machine, 34.0), classical(machine, 34.0, inertia=False)
        error.append([abs(theory.torque - orbit.tau2) / c, abs(theory.speed - orbit.w2) / c])
    assert np.log2(np.array(error[0]) / error[1]) == pytest.approx([2.0, 2.0], abs=0.15)


@pytest.mark.parametrize("name", SETS)
def test_with_the_inertia_force_it_neglects_the_slope_of_the_load_first(name: str) -> None:
    """First order in r^2 by that slope, second order without it; in the rod force always first order."""
    for d, orders in ((4000.0, (1.0, 1.0, 1.0)), (0.0, (2.0, 2.0, 1.0))):
        error = []
        for share in (0.2, 0.1):
            machine = shrunk(replace(SETS[name], d=d), share)
            orbit, theory = exact(machine, 34.0), classical(machine, 34.0, inertia=True)
            pairs = (theory.torque, orbit.tau2), (theory.speed, orbit.w2)
            parts = [abs(x / y - 1) for x, y in pairs]
            error.append([*parts, abs(theory.force / orbit.f_rod_max - 1)])
        assert np.log2(np.array(error[0]) / error[1]) == pytest.approx(orders, abs=0.25), d


def classical_error(machine: Machine, nu: float, variant: str, load: str) -> float:
    """Of the exact orbit, in %."""
    orbit, theory = exact(machine, nu), classical(machine, nu, inertia=variant == "whole")
    truth = {"torque": abs(orbit.tau2), "speed": abs(orbit.w2), "force": orbit.f_rod_max}
    return 100 * (abs(getattr(theory, load)) / truth[load] - 1)


def test_errors_of_the_classical_calculation_are_those_of_exact_orbits(answers_of_set: Any) -> None:
    name, _, answer = answers_of_set
    rows = answer.tables["classical.csv"].frame
    for variant in ("spring", "whole"):
        for load in ("torque", "speed", "force"):
            for _, row in rows.iterrows():
                truth = classical_error(SETS[name], row["nu"], variant, load)
                assert abs(row[f"{variant}_{load}"] - truth) <= row[f"{variant}_{load}_error"] < 0.2


@pytest.mark.parametrize("name", ["A", pytest.param("B", marks=pytest.mark.slow)])
def test_where_the_classical_calculation_goes_wrong_is_where_exact_orbits_say(name: str) -> None:
    speeds = {"A": "8:38:11", "B": "8:30:9"}[name]
    most = {"A": 2.0, "B": 2.8}[name]
    answer = ask("resonance", theory="classical", set=name, speeds=speeds, accepted_error=most)
    held = 0
    for variant in ("spring", "whole"):
        for load in ("torque", "speed", "force"):
            figure = answer.figures[f"limit_{variant}_{load}"]
            if figure.error is None:
                assert (
                    figure.reason == f"the error stays below {most:g} % at every speed of the sweep"
                )
                continue
            held += 1
            low, high = figure.value - figure.error, figure.value + figure.error
            below, above = (abs(classical_error(SETS[name], x, variant, load)) for x in (low, high))
            assert below <= most <= above
            assert figure.error < 2e-3 * figure.value
    assert held == {"A": 6, "B": 3}[name]
    machine, share = SETS[name], answer.figures["share"]
    end = answer.figures["limit_spring_torque"]
    assert share.value == pytest.approx(100 * machine.m * end.value**2 / machine.c, rel=1e-12)
    assert share.error / share.value == pytest.approx(2 * end.error / end.value, rel=1e-3)


def test_a_tolerance_that_nothing_keeps_has_no_limit() -> None:
    answer = ask(
        "resonance", theory="classical", speeds="20,40", steps_per_rev=128, accepted_error=1.0
    )
    end = answer.figures["limit_spring_torque"]
    assert (end.error, end.reason) == (None, "not even at the lowest speed of the sweep")
    figure = answer.figures["limit_whole_force"]
    assert figure.error is not None and 0.0 < figure.error < 0.5
    below, above = (
        abs(classical_error(SETS["A"], figure.value + x, "whole", "force"))
        for x in (-figure.error, figure.error)
    )
    assert below <= 1.0 <= above


def test_what_steps_too_long_leave_of_the_classical_calculation_is_a_reason() -> None:
    """T is one to four steps: the coarsest of the three runs, at which the secant comes to rest, is unstable."""
    answer = ask(
        "resonance",
        theory="classical",
        speeds="10:30:4",
        steps_per_rev=128,
        start={"motor.T": 0.00625},
    )
    why = "the run with four times the step is unstable, so that no error can be estimated; take more steps per revolution"
    assert answer.figures["limit_spring_torque"].reason == why
    ends = [x for x in answer.judgements if x.what.startswith("classical calculation")]
    why = "the coupling error of an orbit is not known; take more steps per revolution"
    assert [x.figure.reason for x in ends if x.figure] == [why, why]


def test_a_largest_error_covers_another_as_large() -> None:
    """Of the other sign, too: which is the largest is not known then."""
    values, errors = np.array([5.0, -4.9, 1.0, math.nan]), np.array([0.1, 0.1, 0.3, math.nan])
    assert worst(values[:3], errors[:3], "").error == pytest.approx(10.0, rel=1e-12)
    assert worst(values[::2], errors[::2], "").error == pytest.approx(0.1, rel=1e-12)
    assert worst(values, errors, "").reason.endswith("has a steady orbit")


MOTOR = {"tau_b": 190.0, "s_b": 0.16, "w_s": 65.4}


def sheet(**changed: float) -> induction_motor.Motor:
    """The motor of the data sheet, with other fields of its conveyor."""
    start = {f"motor.kloss.{name}": value for name, value in MOTOR.items()}
    start |= {"motor.characteristic": 1}
    machine = replace(SETS["B"], T=1 / (2 * math.pi * 50.0 * MOTOR["s_b"]), **changed)
    machine = shrunk(machine, 1.0) if "r" not in changed else machine
    start |= {"conveyor.crank.r": machine.r, "conveyor.rotor.J": machine.theta1}
    return induction_motor.Motor(machine.follow(start))


def lag_speeds(*motors: induction_motor.Motor) -> list[Figure]:
    """The speeds of 90 degrees lag of motors with their characteristics, then with their lines."""
    drive = Runs(Context(fmus_of(induction_motor)), "strang", 512)
    kinds = [
        [(x.machine, x.speeds_around_resonance) for x in motors],
        [(x.line, x.speeds_around_resonance) for x in motors],
    ]
    return [figure for kind in kinds for figure in induction_motor.lag_speeds(drive, kind)]


def in_time(motor: induction_motor.Motor, nu: float, flux: bool) -> float:
    """The lag of the torque behind its load [deg], of one system in time, by (2) and Kloss, or with
    the rotor's flux x + i y in a field of constant flux turning at w_s: T (x + i y)' = 1 - (1 + i u)
    (x + i y), u the slip in shares of the breakdown slip, torque -2 tau_b y.
    """
    m = motor.machine
    tau_b, b, _ = kloss_slips(m, nu)
    u0 = float(motor.slip(nu))
    w_s, half = nu + u0 * b, m.r**2 / 2

    def slopes(t: float, state: Any) -> list[float]:
        phi, w, x, y = state
        u, s, c = (w_s - w) / b, math.sin(2 * phi), math.cos(2 * phi)
        load = half * (m.c * s + m.d * w * (1 + c) - m.m * s * w**2)
        slope = (-2 * tau_b * y - load) / (m.theta0 + half * m.m * c)
        if flux:
            return [w, slope, (1 - x + u * y) / m.T, (-y - u * x) / m.T]
        return [w, slope, 0.0, (-u / (1 + u**2) - y) / m.T]

    t = 2 * math.pi / nu * np.arange(16 * 64 + 1) / 64
    y = solve_ivp(
        slopes, (0.0, t[-1]), [0.0, nu, 1 / (1 + u0**2), -u0 / (1 + u0**2)],
        method="DOP853", rtol=1e-8, atol=1e-9, t_eval=t,
    ).y  # fmt: skip
    settled = y[0] >= y[0][-1] - 4 * math.pi
    torque = -2 * tau_b * harmonics(y[0][settled], y[3][settled])[1]
    return float(np.angle(m.load_ripple(nu) / torque, deg=True) % 360.0)


def test_lag_and_slope_of_the_motor_follow_from_the_flux_of_its_rotor() -> None:
    """Linearised around slip sigma: Kloss's slope at rest, and without slip the lag T of (2), which is
    1 / (2 pi f s_b) as breakdown is where the flux turns by one radian in T.
    """
    x, y = sympy.symbols("x y", real=True)
    u, T, p, sigma, tau_b, b = sympy.symbols("u T p sigma tau_b b", positive=True)
    rates = sympy.Matrix([(1 - x + u * y) / T, (-y - u * x) / T])
    (steady,) = sympy.solve(list(rates), [x, y], dict=True)
    torque = sympy.simplify(-2 * tau_b * steady[y])
    assert sympy.simplify(torque - 2 * tau_b / (1 / u + u)) == 0
    at = {**{k: v.subs(u, sigma) for k, v in steady.items()}, u: sigma}
    by_state, by_slip = rates.jacobian([x, y]).subs(at), rates.jacobian([u]).subs(at)
    response = (p / T * sympy.eye(2) - by_state).solve(by_slip)
    gain = sympy.simplify(-2 * tau_b * response[1] / b)
    assert sympy.simplify(gain.subs(p, 0) - torque.diff(u).subs(u, sigma) / b) == 0
    assert sympy.simplify(gain.subs(sigma, 0) - 2 * tau_b / b / (1 + p)) == 0
    motor = sheet()
    for slip in (0.0, 0.1, 0.4, 0.9):
        for nu in (0.0, 20.0, 45.0):
            numbers = {
                p: 2j * nu * motor.machine.T,
                sigma: slip,
                tau_b: 190.0,
                b: kloss_slips(motor.machine, 0.0).at_breakdown,
            }
            formula = flux_lag(motor.machine, slip, motor.stiff.B, nu)
            assert formula == pytest.approx(complex(gain.subs(numbers)), rel=1e-9)


def test_the_resonance_with_the_full_characteristic_is_that_of_the_coupled_system() -> None:
    motor = sheet(d=40000.0)
    figure, _ = lag_speeds(motor)
    assert figure.error is not None and figure.error < 2e-3
    sides = [in_time(motor, figure.value + s * 2e-3, flux=False) for s in (-1, 1)]
    assert sides[0] < 90.0 < sides[1]


def test_the_curve_of_the_characteristic_shifts_the_resonance_by_the_square_of_the_ripple() -> None:
    shares, shifts = (0.5, 0.25), []
    radii = [SETS["B"].r * math.sqrt(share) for share in shares]
    speeds = lag_speeds(*(sheet(r=r, theta1=0.5 - 100 * r**2) for r in radii))
    for share, kloss, line in zip(shares, speeds[:2], speeds[2:]):
        shifts.append(1 - kloss.value / line.value)
        ripple = (
            abs(sheet().tangent.speed_ripple(30.0))
            * share
            / kloss_slips(sheet().machine, 0.0).at_breakdown
        )
        assert shifts[-1] == pytest.approx(3 / 8 * ripple**2, rel=0.1)
    assert math.log2(shifts[0] / shifts[1]) == pytest.approx(2.0, abs=0.1)


def test_the_flux_of_the_rotor_keeps_the_resonance_under_load_where_2_lowers_it() -> None:
    """The load is that of 40 000 N.s/m with the whole crank; its ripple is a sixteenth of that."""
    r = SETS["B"].r / 4
    motor = sheet(d=16 * 40000.0, r=r, theta1=0.5 - 100 * r**2)
    assert motor.nu_res == pytest.approx(29.91, abs=0.01)
    assert motor.flux_lag_speed() == pytest.approx(30.843, abs=2e-3)
    small = in_time(motor, motor.flux_lag_speed(), flux=True)
    assert small == pytest.approx(90.0, abs=0.6)
    assert in_time(motor, motor.nu_res, flux=True) < 88.0
    loaded = sheet(d=40000.0)
    assert in_time(loaded, 30.69, flux=True) < 90.0 < in_time(loaded, 30.71, flux=True)


def test_breakdown_slip_moves_the_damping_and_not_the_resonance() -> None:
    machine, omega = SETS["B"], 2 * math.pi * 50.0
    swing = MOTOR["tau_b"] * omega / (2 * machine.theta0 * MOTOR["w_s"])
    answer = ask("induction_motor", **QUICK["induction_motor"])
    rows = answer.tables["induction_motor.csv"].frame
    assert rows["breakdown_slip"].to_list() == [0.16, 0.16, 0.32]
    for _, row in rows[rows["resistance"] == 4000.0].iterrows():
        load = machine.load_slope / (4 * machine.theta0 * row["lag"])
        assert row["nu_res"] ** 2 == pytest.approx(swing + load, rel=1e-3)
        assert row["lag"] == pytest.approx(1 / (omega * row["breakdown_slip"]), rel=1e-12)
        assert abs(row["nu_linear"] / row["nu_res"] - 1) < 5e-4
    assert rows["zeta"][2] / rows["zeta"][0] == pytest.approx(2.0, rel=0.03)
    assert answer.figures["motor_lag"].value == pytest.approx(0.0199, abs=1e-4)
    assert answer.figures["nu_kloss"].value == rows["nu_kloss"][0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"resistances": "2e5"}, "motor.kloss.tau_b = 190.0 N.m must be above"),
        ({"start": {"motor.kloss.s_b": 0.0}}, "kloss.s_b = 0.0 must be > 0"),
        (
            {
                "resistances": "4",
                "start": {"conveyor.spring.c": 183375.0, "conveyor.trough.d": 4.0},
            },
            "rad/s: the load ripple is almost zero there",
        ),
        ({"slips": "0"}, "slips = 0 must be a finite number above 0"),
    ],
)
def test_motors_without_an_answer_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError) as refused:
        ask("induction_motor", **options)
    assert message in str(refused.value)


def test_without_resistance_the_mean_torque_is_zero_but_for_the_ripple() -> None:
    start = {"conveyor.trough.d": 0.0}
    figures = ask("mean_values", speeds="40", steps_per_rev=256, start=start).figures
    assert (figures["torque_plain"].value, figures["more"].error) == (0.0, None)
    assert figures["torque"].value > 0.1
    assert figures["trough_more"].value == 0.0


def test_the_limit_of_a_calculation_lies_where_a_sweep_of_a_handful_of_speeds_states_it() -> None:
    """Four speeds draw a poor curve of the error: exact orbits have 5 % within the error that is told."""
    d = 2332.417797948394
    answer = ask(
        "resonance",
        theory="classical",
        speeds="10.5:30:4",
        steps_per_rev=128,
        start={"conveyor.trough.d": d},
    )
    machine, stated = replace(SETS["A"], d=d), answer.figures["limit_spring_force"]
    assert stated.error and stated.error < 0.1
    below, above = (
        classical(machine, nu, inertia=False).force / exact(machine, nu).f_rod_max - 1.05
        for nu in (stated.value - stated.error, stated.value + stated.error)
    )
    assert below * above < 0.0


def test_a_step_of_the_supply_lasts_as_long_whatever_the_steps() -> None:
    """What the theory leaves grows to the end of that time."""
    start = {"conveyor.trough.d": 1143.5, "conveyor.rotor.J": 0.255, "conveyor.trough.m": 111.1}
    start |= {"conveyor.spring.c": 102833.0, "conveyor.crank.r": 0.008958}
    coarse, fine = (
        ask("mean_values", speeds="24.83,45.66", steps_per_rev=n, start=start).figures["off_whole"]
        for n in (512, 1024)
    )
    assert coarse.error and fine.error and coarse.error < 0.01
    assert abs(coarse.value - fine.value) <= coarse.error + fine.error


def test_an_error_that_leaves_its_tolerance_between_two_speeds_is_found() -> None:
    """It is -3.3 % at 6.17 and 10.15 rad/s, and -4.9 % at 8.5: outside 4.6 % from 7.6495 rad/s on."""
    drive = Drive(B=9.74785, T=0.126715, J=0.0110593, r=0.0108158, m=5.18383, d=39.0499, c=882.742,
                  l=0.058943, finite=True)  # fmt: skip
    answer = ask(
        "resonance", theory="classical", accepted_error=4.6, start=drive.start,
        speeds="6.1719,10.15,14.13,18.11,22.09,26.07",
    )  # fmt: skip
    machine = Machine(
        B=drive.B, T=drive.T, theta1=drive.J, m=drive.m, r=drive.r, c=drive.c, d=drive.d
    )

    def off(nu: float) -> float:
        told = abs(classical(machine, nu, inertia=True).force)
        return float(100.0 * (told / f_rod_peak(drive, [nu]) - 1.0))

    exact = brentq(lambda nu: off(nu) + 4.6, 7.0, 8.0, xtol=1e-6)
    figure = answer.figures["limit_whole_force"]
    assert figure.error is not None and abs(figure.value - exact) <= figure.error + 1e-5
    assert off(8.5) < -4.6 < off(10.15)
