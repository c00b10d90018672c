"""The iron drive against material points, its derivation, reference numbers, balances, misuse."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from math import inf, nan, pi, radians
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

from components.iron_drive import dynamics, geometry
from components.iron_drive import model as iron
from components.iron_drive.declarations import Side
from cosim import System, run
from fmukit.declare.model import complete_model
from fmukit.declare.record import declarations, replace, start
from fmukit.runtime import hybrid as motion
from tests.components.iron_oracle import CoupledDrive, by_material_points, tables
from tests.hosts.host import MESSAGES, Unit
from tests.oracle import random_parameters

NOMINAL = 4 * pi / 3
MOTOR = {"A": 4.0, "B": 0.025, "T": 0.012}
STALLING = {"A": 0.10, "B": 0.0025, "T": 0.012}
E_TURN = 0.748782419985
FORCES = ("W", "T_iron", "T_span", "T_hang", "M_rocker", "N", "tau_cam")


def machine(**changes: Any) -> Any:
    """Parameters of a drive that goes on where it is not valid."""
    return start(iron.Parameters, **{"on_invalid": iron.OnInvalid.warn} | changes)


def quantities(p: Any, phi: float, w: float = NOMINAL, M: float | None = None) -> dict[str, float]:
    """All that the equations say at a state; without M at constant speed."""
    at, sense = geometry.position(p, phi), math.copysign(1, w)
    (_, H_1, H_2), K = at.H, dynamics.friction(p, at, sense)
    A, B = at.J + K * p.iron.m * H_1**2, at.J_1 / 2 + K * p.iron.m * H_1 * H_2
    C = K * at.W_0 * H_1 - at.Pi_1
    M = B * w * w - C if M is None else M
    y = iron.outputs(p, 0.0, start(iron.State, phi=phi, w_cam=w), iron.Inputs(M / p.reducer.i_g))
    d = dynamics.dynamics(p, at, w, sense, M)
    return at._asdict() | d._asdict() | y._asdict() | {
        "alpha_1": at.alpha.first, "alpha_2": at.alpha.second, "H_1": H_1, "H_2": H_2, "M": M,
        "A_1": A, "B_1": B, "C_load": C, "F_spring": p.spring.c * at.e,
        "R": geometry.cam(p, phi)[2].value,
    }  # fmt: skip


@pytest.mark.parametrize("deg", tables())
def test_every_reference_row_is_met(deg: float) -> None:
    got = quantities(machine(), radians(deg))
    got["pressure"] = math.degrees(got["pressure"])
    for name, value in tables()[deg].items():
        rel = 1e-8 if name in (*FORCES, "pressure") else 1e-9
        assert got[name] == pytest.approx(value, rel=rel, abs=1e-13), name


def test_extremes_of_the_cycle_and_of_its_variants() -> None:
    variants = {
        machine(): {
            "tau_cam": (-7.409358425, 6.627300006), "lift": (0.0, 0.062385664995),
            "v": (-0.409305232, 0.327444184), "a": (-4.211649935, 4.223719833),
            "T_iron": (58.72537684, 90.03612229), "T_span": (58.93705172, 93.06862786),
            "N": (175.4239707, 287.8936706), "J": (0.4013, 0.453597753),
        },
        machine(wrap=iron.Wrap.tangent): {
            "tau_cam": (-7.408801020, 6.626829208), "lift": (0.0, 0.062382109544),
        },
    }  # fmt: skip
    for p, extremes in variants.items():
        cycle = [quantities(p, radians((k - 1e-9) / 20)) for k in range(7200)]
        for name, expected in extremes.items():
            values = [row[name] for row in cycle]
            assert (min(values), max(values)) == pytest.approx(expected, rel=2e-6, abs=1e-12), name


@pytest.mark.parametrize("wrap", iron.Wrap)
def test_material_points_agree(wrap: iron.Wrap) -> None:
    """In random drives and states, and at the reference angles with their constant speed."""
    cases = [(machine(wrap=wrap), radians(deg), NOMINAL, None) for deg in tables()]
    for p, phi, w, M in [*cases, *states(wrap, 12)]:
        got = quantities(p, phi, w, M)
        with mpmath.workdps(30):
            points = by_material_points(p, phi, w, got["eps"], got["K"])
        assert abs(got["pressure"]) == pytest.approx(float(points.pop("tilt")), rel=1e-9)
        for name, value in points.items():
            rel = 1e-8 if name in FORCES else 1e-9
            floor = 1e-10 if name in FORCES else 1e-13
            assert got[name] == pytest.approx(float(value), rel=rel, abs=floor), (phi, name)


def states(wrap: iron.Wrap, count: int) -> Iterator[Any]:
    """Random drives and states: parameters, phi, w, M."""
    draw = random.Random(2)
    for _ in range(count):
        side = draw.choice(list(Side))
        p = random_parameters(iron, draw, 0.1, wrap=wrap, **{"spring.side": side})
        yield p, draw.uniform(-9, 9), draw.uniform(-9, 9), draw.uniform(-9, 9)


def printed(p: Any, phi: float, erratum: int) -> tuple[float, float]:
    """A1, and the torque at the nominal speed, with one of the paper's errors; 0 for none."""
    if erratum == 9:
        p = replace(p, spring=replace(p.spring, side=-p.spring.side))
    at, direction = geometry.position(p, phi), 1
    (_, H_1, H_2), J_1, Pi_1 = at.H, at.J_1, at.Pi_1
    if erratum == 1:
        _, a_1, a_2 = at.alpha
        H_1, H_2, direction = -H_1, H_2 - 2 * at.H_a * a_2, -1
        J_1, Pi_1 = J_1 - 2 * at.J_aa * a_1**3, Pi_1 - 2 * at.Pi_a * a_1
    K = (-1 if erratum == 8 else 1) * dynamics.friction(p, at, direction)
    B_1, C_1 = J_1 / 2 + K * p.iron.m * H_1 * H_2, K * at.W_0 * H_1 - Pi_1
    if erratum == 6:
        B_1 -= p.spring.m / 6 * H_1 * H_2
    if erratum == 10:
        C_1 += K * p.spring.m / 2 * p.g * H_1
    if erratum == 11:
        C_1 -= p.spring.m * p.g * H_1
    K = -K if erratum == 7 else K
    return at.J + K * p.iron.m * H_1**2, B_1 * NOMINAL**2 - C_1


def test_the_equations_as_printed_cost_this_much() -> None:
    p = machine()
    costs = {erratum: [0.0, 0.0] for erratum in (1, 6, 7, 8, 9, 10, 11)}
    for degrees in np.arange(0.5, 360.0, 0.5):
        A, M = printed(p, radians(degrees), 0)
        for erratum, worst in costs.items():
            printed_A, printed_M = printed(p, radians(degrees), erratum)
            worst[:] = max(worst[0], abs(printed_M - M)), max(worst[1], abs(printed_A / A - 1))
    assert costs.pop(7) == pytest.approx([0.0, 0.0127], rel=0.01, abs=1e-10)
    assert [cost for cost, _ in costs.values()] == pytest.approx(
        [15.1, 6.7e-3, 1.09, 4.34, 5.4e-3, 0.144], rel=0.02
    )


def test_formula_as_printed_has_no_second_derivative_in_the_dwells() -> None:
    """It divides by R', which is 0 there; the component's does not."""
    at_rest = [math.radians(deg + 0.25) for deg in range(360)]
    slopes = [geometry.cam(machine(), phi)[2].first for phi in at_rest]
    assert sum(slope == 0.0 for slope in slopes) == 180
    assert all(math.isfinite(geometry.position(machine(), phi).alpha.second) for phi in at_rest)


def test_gear_ratio_as_printed_loses_the_rotor() -> None:
    p = machine()
    in_the_dwell = geometry.position(p, 2.0).J
    right, printed_13 = (p.cam.J + p.reducer.J * i**2 for i in (36.0, 1 / 36))
    assert in_the_dwell == pytest.approx(right, rel=1e-12)
    assert (right, printed_13) == pytest.approx((0.4013, 0.0125), rel=1e-4)


def test_friction_as_printed_feeds_energy_in() -> None:
    p = machine()
    for deg, w in itertools.product((50, 200), (NOMINAL, -NOMINAL)):
        got = quantities(p, radians(deg), w)
        assert got["K"] * got["W"] * got["H_1"] * w < 0.0


def test_start_up_as_a_coupled_system() -> None:
    rows = """
    0.02 -1.02273930068 3.00972374284 2.02824595119 1.821925660 0.000000000
    0.044475 nan 5.13483138 nan nan nan
    0.05 -0.88519403802 5.07419199351 -0.21814777918 5.195855755 0.000000000
    0.10 -0.65810204326 4.36088738387 0.05690113712 3.889255535 0.000000000
    0.248325980 0 nan nan nan nan
    0.50 1.08865494980 4.29101006741 0.15221702867 8.013924396 0.311535739
    0.649484923 1.74532925199 nan nan nan nan
    0.884805733 2.79252680319 nan nan nan nan
    1.00 3.31017967564 4.57811231216 -0.10081636505 8.558056480 0.475497139
    1.192050952 4.18879020479 nan nan nan nan
    2.00 7.74016264991 4.41611904647 0.03952452236 10.025983970 1.148663771
    2.607496610 10.4719755120 nan nan nan nan
    3.00 12.21472872729 4.43855728039 0.00535426289 5.583556326 1.497564840
    """
    line = CoupledDrive(start(iron.Parameters), MOTOR)
    top = 0.0
    for row in rows.split("\n")[1:-1]:
        t, *expected = map(float, row.split())
        x = line.to(t)
        got = [x.phi, x.w_cam, x.tau, x.E_in, x.E_friction]
        for value, wanted in zip(got, expected):
            assert math.isnan(wanted) or value == pytest.approx(wanted, abs=3e-9)
        top = max(top, x.w_cam)
    assert top == pytest.approx(5.13483138, abs=1e-8)


def test_stall_and_stick_as_a_coupled_system() -> None:
    p = start(iron.Parameters)
    line = CoupledDrive(p, STALLING, phi=0.0)
    *_, (stop, x), (_, end) = line.events(3.0)
    assert stop == pytest.approx(1.091105685, abs=1e-8)
    assert (x.phi, x.w_cam, x.direction) == (pytest.approx(0.5284195507, abs=1e-10), 0.0, 0)
    assert x.E_friction == pytest.approx(0.047067759, abs=1e-9)
    assert (end.phi, end.E_friction) == (x.phi, x.E_friction)
    assert end.tau == pytest.approx(0.10, rel=1e-12)
    at = geometry.position(p, radians(50))
    for limit, K, factor, turned_angle in (
        (0.155304038, p.friction.K_down, 0.999, -8.42e-6),
        (0.181371849, p.friction.K_up, 1.001, 9.80e-6),
        (0.155304038, p.friction.K_down, 1.001, 0.0),
        (0.181371849, p.friction.K_up, 0.999, 0.0),
    ):
        assert (at.Pi_1 - K * at.W_0 * at.H.first) / 36 == pytest.approx(limit, abs=1e-9)
        motor = {"A": limit * factor, "B": 0.025, "T": 0.012}
        line = CoupledDrive(p, motor, phi=radians(50), tau=limit * factor)
        assert line.to(0.05).phi - radians(50) == pytest.approx(turned_angle, rel=2e-3, abs=1e-300)


@pytest.mark.slow
@pytest.mark.parametrize(("A", "cycles"), [(4.0, 42.3895), (3.7732, 39.9822), (3.77488, 40.0)])
def test_speed_torque_and_friction_loss_of_the_steady_state(A: float, cycles: float) -> None:
    line = CoupledDrive(start(iron.Parameters), MOTOR | {"A": A})
    x, t = line.until(4 * pi), line.t
    end = line.until(6 * pi)
    assert 60 / (line.t - t) == pytest.approx(cycles, abs=1e-4)
    assert (end.E_in - x.E_in) / (2 * pi) == pytest.approx(0.119172423, abs=1e-8)
    assert end.E_friction - x.E_friction == pytest.approx(E_TURN, rel=1e-9)


@pytest.mark.slow
def test_friction_loss_per_turn_does_not_depend_on_the_speed() -> None:
    p = machine(**{"reducer.J": 1e3})
    for w in (20 * pi / 30, 40 * pi / 30, 60 * pi / 30):
        assert coast(p, w, 2 * pi / w).E_friction == pytest.approx(E_TURN, rel=1e-9)
    s, h = p.spring, 0.062385664995
    load = (p.iron.m + s.m / 2) * p.g * h + s.c * (s.e_0 * h + h * h / 2)
    assert (p.friction.K_up - p.friction.K_down) * load == pytest.approx(E_TURN, rel=1e-9)


def coast(p: Any, w: float, stop: float) -> Any:
    """The state of a drive with a heavy rotor that turns at this speed, without torque."""
    u = iron.Inputs(0.0)
    x = iron.sample(p, 0.0, replace(start(iron.State), w_cam=w), None, u)
    return motion.advance(complete_model(iron), p, 0.0, x, motion.InputTrajectory(u, u, stop))


@pytest.mark.parametrize(
    ("changes", "limit"),
    [({}, 7.89776), ({"spring.c": 0.0, "spring.m": 0.0}, 5.63049), ({"spring.side": -1}, 5.15434)],
)
def test_follower_leaves_its_cam_where_it_should(changes: dict[str, Any], limit: float) -> None:
    p = start(iron.Parameters, **{"reducer.J": 1e3}, **changes)
    coast(p, limit * 0.999, 6.0 / limit)
    with pytest.raises(ValueError, match=r"cam follower lifts off at phi = 3\.1"):
        coast(p, limit * 1.001, 6.0 / limit)


def test_chain_goes_slack_where_it_should() -> None:
    p = machine()
    for name, deg, limit in (("T_span", 182.56, 8.54097), ("T_iron", 182.57, 9.11191)):
        assert quantities(p, radians(deg), limit)[name] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("tau", "phi", "w", "directions"),
    [
        (0.1, -pi / 3, 0.0, [1]),
        (0.3, -pi / 3, 0.0, [1]),
        (0.02, 0.3, 1.5, [1, -1]),
        (0.16, 0.9, 0.5, [1, 0]),
    ],
)
def test_the_communication_step_does_not_matter(
    tau: float, phi: float, w: float, directions: list[int], fmus: Path
) -> None:
    ends = []
    for folder, h in ((fmus / "native", 1e-4), (fmus, 1e-3), (fmus, 7e-3)):
        unit, recorded = (
            Unit(folder / "IronDrive.fmu").start(on_invalid=1, tau=tau, phi=phi, w_cam=w),
            [],
        )
        for n in range(round(0.7 / h)):
            recorded.append(unit.get("direction"))
            unit.step(n * h, h)
        assert [direction for direction, _ in itertools.groupby(recorded)] == directions
        ends.append([unit.get(name) for name in ("phi", "w_cam", "E_friction")])
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)
    assert ends[2] == pytest.approx(ends[0], abs=1e-9)


def coupled(fmus: Path, step: float, stop: float, algorithm: str, **motor: float) -> Any:
    """Motor and drive as FMUs, the drive from the middle of its bottom dwell or, stalled, from 0."""
    start = {"motor.tau": 0.0} | {f"motor.{name}": value for name, value in motor.items()}
    system = System(
        parts={"motor": fmus / "DriveMotor.fmu", "drive": fmus / "IronDrive.fmu"},
        wires=["motor.tau -> drive.tau", "drive.w -> motor.w"],
        start=start | ({} if motor == MOTOR else {"drive.phi": 0.0}),
    )
    return run(system, stop=stop, step=step, algorithm=algorithm, order=["motor", "drive"])


@pytest.mark.slow
def test_coupled_start_up_is_that_of_the_reference_solution(fmus: Path) -> None:
    line, times = CoupledDrive(start(iron.Parameters), MOTOR), (0.05, 0.1, 0.5, 1.0, 2.0, 3.0)
    fine, coarse = (coupled(fmus, h, 3.0, "strang", **MOTOR) for h in (5e-4, 1e-3))
    for t in times:
        x, at = line.to(t), [round(t / h) for h in (5e-4, 1e-3)]
        for name, wanted, tolerance in (("phi", x.phi, 1e-6), ("w_cam", x.w_cam, 1e-5)):
            a, b = (result[f"drive.{name}"][n] for result, n in zip((fine, coarse), at))
            assert a + (a - b) / 3 == pytest.approx(wanted, abs=tolerance)


def test_energy_ledger_of_a_coupled_start_up_closes(fmus: Path) -> None:
    result = coupled(fmus, 1e-3, 3.0, "gauss-seidel", **MOTOR)
    phi, tau = result["drive.phi"], result["motor.tau"]
    stored = sum(result[f"drive.{name}"] for name in ("E_kin", "E_pot", "E_friction"))
    work = np.concatenate([[0.0], np.cumsum(36 * tau[1:] * np.diff(phi))])
    assert np.abs(stored - stored[0] - work).max() < 1e-9 * np.abs(work).max()


def test_coupled_stall_sticks_where_the_reference_solution_does(fmus: Path) -> None:
    end = coupled(fmus, 1e-4, 1.2, "strang", **STALLING)
    assert end["drive.phi"][-1] == pytest.approx(0.5284195507, abs=1e-3)
    assert end["drive.motion"][-1] == iron.Motion.stuck
    assert end["drive.w_cam"][-1] == 0.0


BAD = {
    "cam angles exceed one revolution: cam.rise + cam.top + cam.ret = 8.1": {"cam.top": 5.0},
    "cam triangle cannot close: cam.R_b = 0.06 m must be > 0.06 m": {"cam.R_b": 0.06},
    "cam triangle cannot close: cam.R_b = 0.1 m must be > 0.06 m and, with cam.h = 0.14 m":
        {"cam.h": 0.14},
    "friction: -1 < K_down <= 0 <= K_up violated: friction.K_down = -1.0,": {"friction.K_down": -1.0},
    "K_up violated: friction.K_down = 0.1, friction.K_up = 0.089": {"friction.K_down": 0.1},
    "K_up violated: friction.K_down = -0.0747, friction.K_up = -0.1": {"friction.K_up": -0.1},
    "spring.side = 2 must be one of 1 (below), -1 (above)": {"spring.side": 2},
    "wrap = 7 must be one of 0 (top), 1 (tangent)": {"wrap": 7},
    "on_invalid = 7 must be one of 0 (stop), 1 (warn)": {"on_invalid": 7},
    "rocker end must stay on the far side of the sprocket: sprocket.C + rocker.l_K cos(alpha) = -0":
        {"sprocket.C": 0.02},
    "link reaches the sprocket: link.l = 0.4 m of a run of 0.37": {"link.l": 0.4},
    "link reaches the sprocket: its end is within sprocket.R": {"sprocket.C": 0.03, "wrap": 1},
    "chain too short: hanging part vanishes: H = -": {"chain.l": 0.25},
    "dead centre: beta - alpha = -1": {"rocker.alpha0": 4.0},
    "spring slack: stretch = -0.01 m with spring.e_0 = -0.01 m at phi = 0.0": {"spring.e_0": -0.01},
    "spring slack: stretch = -0.0": {"spring.side": -1, "spring.e_0": 0.05},
    "chain slack at standstill: T_iron = -": {"spring.side": -1, "spring.c": 2000.0},
    "phi = nan rad must be a finite number": {"phi": nan},
    "w_cam = inf rad/s must be a finite number": {"w_cam": inf},
    "tau = nan N.m must be a finite number": {"tau": nan},
    "cam follower lifts off at phi = 3.1853 rad, omega = 9.0 rad/s: N = -": {"phi": 3.1853, "w_cam": 9.0},
}  # fmt: skip


def test_bad_input_is_refused_and_the_process_lives_on(fmus: Path) -> None:
    rows = dict(BAD)
    for name, d in declarations(iron.Parameters):
        if d.kind == "Real":
            rows[f"{name} = nan"] = {name: nan}
            rows[f"{name} = inf"] = {name: inf}
        if d.min == 0.0:
            unit = f" {d.quantity.unit}".removesuffix(" 1")
            limit = "> 0" if d.positive else f"at least 0.0{unit}"
            for bad in (-1.0, 0.0) if d.positive else (-1.0,):
                rows[f"{name} = {bad}{unit} must be {limit}"] = {name: bad}
    for reason, values in rows.items():
        unit = Unit(fmus / "IronDrive.fmu", "unit 7")
        refusal = unit.refusal(lambda u, values=values: u.start(**values))
        assert reason in refusal
        assert "unit 7: " in refusal
        unit.fmi.freeInstance()
    assert Unit(fmus / "IronDrive.fmu").start().step(0.0, 0.1).get("w_cam") > 0.0


def test_every_bound_of_the_specification_is_declared() -> None:
    declared_reals = {name: d for name, d in declarations(iron.Parameters) if d.kind == "Real"}
    free = {"cam.gamma", "rocker.gamma", "rocker.alpha0", "spring.e_0"}
    free |= {"friction.K_down", "friction.K_up"}
    zero = {"cam.h", "cam.top", "cam.r", "rocker.r", "spring.c", "spring.m", "follower.e"}
    zero |= {f"joints.{joint}" for joint in ("cam", "rocker", "link", "sprocket")}
    assert {name for name, d in declared_reals.items() if d.min is None} == free
    assert {name for name, d in declared_reals.items() if d.min == 0.0 and not d.positive} == zero


def test_a_geometric_refusal_names_the_cam_angle() -> None:
    for values in ({"chain.l": 0.25}, {"spring.side": -1, "spring.e_0": 0.05}):
        p = start(iron.Parameters, **values)
        with pytest.raises(ValueError, match="at phi = ") as error:
            list(iron.check(p))
        phi = float(str(error.value).split("phi = ")[1].split()[0])
        at = [geometry.position(p, angle) for angle in (phi - radians(0.5), phi)]
        before, after = (min(x.H.value, x.e) for x in at)
        assert before > 0.0 > after


def test_a_steep_run_to_the_top_of_the_sprocket_is_warned_of() -> None:
    p = machine(**{"sprocket.A": 0.4})
    assert [sentence.split(":")[1] for sentence in iron.check(p)] == [
        " wrap = top (0) is a poor assumption"
    ]
    assert list(iron.check(replace(p, wrap=iron.Wrap.tangent))) == []
    assert list(iron.check(machine())) == []


def test_where_the_follower_leaves_its_cam_the_fmu_stops_or_warns_once_per_episode(
    fmus: Path,
) -> None:
    heavy = {"reducer.J": 1e3, "w_cam": 8.2, "tau": 0.0}
    stops = Unit(fmus / "IronDrive.fmu").start(**heavy)
    refusal = stops.refusal(lambda u: [u.step(n * 0.01, 0.01) for n in range(100)])
    assert "cam follower lifts off at phi = 3.1" in refusal
    assert "omega = 8.19" in refusal
    assert ": N = -" in refusal
    stops.fmi.freeInstance()
    MESSAGES.clear()
    warns, valid = Unit(fmus / "IronDrive.fmu").start(on_invalid=1, **heavy), []
    for n in range(1600):
        valid.append(warns.step(n * 1e-3, 1e-3).get("valid"))
        assert valid[-1] == (warns.get("N") > 0.0)
    edges = [a and not b for a, b in itertools.pairwise(valid)]
    assert sum(edges) == len([m for m in MESSAGES if "cam follower lifts off at phi" in m]) == 2
    assert valid[-1]
    reason_for = Unit(fmus / "IronDrive.fmu").start(on_invalid=1, phi=3.1853, w_cam=9.0)
    assert not reason_for.get("valid")


def test_slack_of_the_chain_is_named() -> None:
    p, x = machine(), start(iron.State, phi=0.8, w_cam=4.0)
    at = geometry.position(p, 0.8)
    d = dynamics.dynamics(p, at, 4.0, 1, 6.0)
    pulls = {"W": d.W} | dynamics.forces(p, at, 4.0, d)._asdict()

    def reason_for(**changed: float) -> str:
        W, *forces = (pulls | changed).values()
        return iron.invalid_reason(p, x, at, W, dynamics.Forces(*forces))

    assert reason_for() == ""
    for name in ("T_span", "T_iron", "W"):
        expected = f"chain slack at phi = 0.8 rad, omega = 4.0 rad/s: {name} = -2.0 N"
        assert reason_for(**{name: -2.0}) == expected


def test_the_state_is_consistent_when_initialisation_ends(fmus: Path) -> None:
    phi, p = radians(50), start(iron.Parameters)
    for w, tau, motion_, direction in (
        (NOMINAL, 0.1, "up", 1), (-NOMINAL, 0.1, "down", -1), (0.0, 0.19, "up", 1),
        (0.0, 0.15, "down", -1), (0.0, 0.17, "stuck", 0),
    ):  # fmt: skip
        unit = Unit(fmus / "IronDrive.fmu").start(phi=phi, w_cam=w, tau=tau)
        assert unit.get("motion") == iron.Motion[motion_]
        assert unit.get("direction") == direction
        y = iron.outputs(
            p, 0.0, start(iron.State, phi=phi, w_cam=w, direction=direction), iron.Inputs(tau)
        )
        for name in ("T_iron", "N", "a", "tau_cam"):
            assert unit.get(name) == getattr(y, name)
    K = unit.get("T_iron") / geometry.position(p, phi).W_0 - 1
    assert p.friction.K_down < K < p.friction.K_up
    assert (unit.get("tau_cam"), unit.get("a")) == (36 * 0.17, 0.0)
    unit.set(tau=0.19).step(0.0, 0.01)
    assert unit.get("motion") == iron.Motion.up
