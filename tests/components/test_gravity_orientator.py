"""The gravity orientator: reference passages, balances, derivation, limits and many products."""

from __future__ import annotations

import functools
import itertools
import math
import random
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import mpmath
import pytest
import sympy

from components.gravity_orientator import model
from components.gravity_orientator.model import Reason, Stage
from fmukit.declare.model import complete_model
from fmukit.declare.record import start
from fmukit.runtime import hybrid as motion
from tests.components import orientator_oracle as reference
from tests.hosts.host import MESSAGES, Unit
from tests.oracle import by_name, events_and_end, random_parameters

FMU = "GravityOrientator.fmu"
RPM = pi / 30
ROUTE = ("t_falling", "t_joint", "t_turning", "t_released", "orientation_time")
MOVING = tuple(model.MECHANICS)


def passage(n: Any, mu: Any, h: float = 1e-3, component: Any = model) -> Any:
    """Parameters, end and events (t, before, after) of a product; n rpm, or the speed at a step."""
    p = start(model.Parameters, **{"chute.mu": mu}) if isinstance(mu, float) else mu
    complete_model(component)
    x, before, recorded = component.complete_state(p, start(model.State)), None, []
    for k in range(math.ceil(3.0 / h)):
        u = model.Inputs(RPM * (n(k * h) if callable(n) else n), True)
        x, before = motion.sample(component, p, k * h, x, before, u), u
        if x.stage in MOVING:
            for s, old, new in events_and_end(component, p, k * h, x, u, h):
                recorded += [(k * h + s, old, new)] if new is not old else []
            x = component.complete_state(p, new)
    return p, x, recorded


def machine(fmus: Path, n: float, mu: float, h: float, stop: float = 1.0, **values: Any) -> Unit:
    """The FMU after it has dropped a product; n rpm, or the speed at a communication point."""
    turns = n if callable(n) else lambda t: n
    unit = Unit(fmus / FMU).start(w=RPM * turns(0.0), **{"chute.mu": mu, **values})
    for k in range(math.ceil(stop / h)):
        unit.set(w=RPM * turns(k * h)).step(k * h, h)
        if unit.get("stage") in (Stage.oriented, Stage.jammed):
            break
    return unit


def read(unit: Unit, *names: str) -> list[Any]:
    return [unit.get(name) for name in names]


def numbers(x: Any) -> list[float]:
    """phi1, w1, phi2, w2, xc, yc, vxc, vyc."""
    return list(x[:8])


@pytest.mark.parametrize("seed", range(5))
def test_a_passage_of_any_machine_is_that_of_the_reference_solution(seed: int, fmus: Path) -> None:
    """A speed on a line, which jams one of the machines, and none, at which the product flies from its
    release; times, and the impulses at the impacts.
    """
    draw = random.Random(seed)
    p = random_parameters(model, draw, 0.1)
    values = by_name(p)
    n, rise = (draw.uniform(0, 60), draw.uniform(-100, 100)) if seed < 4 else (0.0, 0.0)
    names = {name: name for name in (*ROUTE, "S_x", "P_K")}
    names |= {"S_y": "corner_impulse", "S_k": "wall_impulse", "P_B": "hook_impulse"}
    for folder, h in ((fmus / "native", 1e-4), (fmus / "native", 7e-3), (fmus, 2e-2)):
        unit = Unit(folder / FMU).start(w=n * RPM, input_hold=2, **values)
        for k in range(math.ceil(0.6 / h)):
            unit.set(w=(n + rise * h * (k + 1)) * RPM).step(k * h, h)
        try:
            wanted = reference.passage(values, lambda t: (n + rise * t) * RPM)
            actual = dict(zip(names.values(), read(unit, *names)))
            assert actual == pytest.approx(wanted, rel=1e-9, abs=1e-11)
        except reference.Jam:
            assert unit.get("jammed") == 1


def test_a_product_is_held_in_the_chute_and_falls_on_when_the_rotor_slows_down(fmus: Path) -> None:
    def speed(t: float) -> float:
        return min(100.0, 60 + 400 * t) * RPM

    h, unit = 2e-3, Unit(fmus / FMU).start(w=speed(0.0), input_hold=2, **{"chute.mu": 0.5})
    speeds = []
    for k in range(500):
        unit.set(w=speed(h * (k + 1))).step(k * h, h)
        speeds.append(unit.get("vyc"))
    stopped = next(k for k, v in enumerate(speeds) if v == 0.0)
    assert h * stopped < 0.121916244776 < h * (stopped + 1)
    assert read(unit, "stage", "reason", "vyc") == [Stage.falling, Reason.held_in_chute, 0.0]
    y = unit.get("yc")
    for k in range(500, 900):
        unit.set(w=40 * RPM).step(k * h, h)
    assert y < unit.get("yc")
    assert read(unit, "stage", "reason", "oriented", "jammed") == [4, 0, 1, 0]


PASSAGES = [(0, 0.35), (35, 0.35), (40, 0.2), (60, 0.5), (62, 0.5), (75, 0.35), (70, 0.5)]


def test_positions_are_continuous_and_energy_falls_only_at_the_four_impacts() -> None:
    impacts = set()
    for n, mu in PASSAGES:
        p, _, events = passage(n, mu)
        u = model.Inputs(RPM * n, True)
        for _, old, new in events:
            for name in ("phi1", "phi2", "xc", "yc"):
                assert getattr(new, name) == pytest.approx(getattr(old, name), abs=1e-12)
            before, after = (model.outputs(p, 0.0, x, u) for x in (old, new))
            assert after.E_pot == pytest.approx(before.E_pot, abs=1e-13)
            if max(abs(a - b) for a, b in zip(numbers(old), numbers(new))) > 1e-9:
                assert after.E_kin < before.E_kin
                impacts.add((Stage(old.stage), Stage(new.stage), old.contact, new.contact))
            else:
                assert after.E_kin == pytest.approx(before.E_kin, rel=1e-11)
    released, jammed = Stage.released, Stage.jammed
    assert impacts == {
        (Stage.falling, Stage.joint, True, True),
        (Stage.joint, Stage.turning, True, True),
        (released, released, False, True),
        (released, released, True, True),
        (Stage.turning, jammed, True, True),
    }


def test_without_speed_and_friction_energy_is_kept_between_the_impacts() -> None:
    """Of catcher, cup and spring, in every stage."""
    p, _, events = passage(0, 0.0)
    u = model.Inputs(0.0, True)
    energies = [
        [y.E_kin + y.E_pot for y in (model.outputs(p, 0.0, x, u) for x in (old, new))]
        for _, old, new in events
    ]
    assert len(energies) > 4
    for (_, after), (before, _) in itertools.pairwise(energies):
        assert before == pytest.approx(after, rel=1e-10)


@functools.cache
def lagrange() -> Any:
    """Lagrange's equations of the first kind in phi1, phi2, xc, yc, for each stage.

    Masses, loads without friction, the generalised force of a unit of friction at the wall, the
    constraints with their rates: the wall, and the corner in joint, the hook in turning; friction of
    the side walls, and what a unit of each constraint's force rubs at the catcher, of which the last
    row is the push. Side walls press at the rim and at the end of the cylinder against the Coriolis
    forces on four masses that have the cup's mass and moments of inertia.
    """
    names = "d h l2 m2 J2 l1 h1 m1 J1 phi10 c R H mu mu_s J_a mu_c rim creep anchored s0 g w"
    p = sympy.symbols(names)
    d, h, l2, m2, J2, l1, h1, m1, J1, phi10, c, R, H, mu, mu_s, J_a, mu_c, rim = p[:18]
    creep, anchored, s0, g, w = p[18:]
    q, rates = sympy.symbols("p1 p2 x y"), sympy.symbols("w1 w2 vx vy")
    r, e = d / 2, h - l2

    def rate(position: Any) -> Any:
        return sympy.Matrix(position).jacobian(q) * sympy.Matrix(rates)

    a = sympy.Matrix([sympy.cos(q[1]), sympy.sin(q[1])])
    n = sympy.Matrix([-a[1], a[0]])
    C, arm = sympy.Matrix(q[2:]), sympy.Matrix([sympy.cos(q[0]), sympy.sin(q[0])])
    D, stretch = l1 * arm, l1 / 2 * (q[0] - phi10)
    B = D + h1 * sympy.Matrix([arm[1], -arm[0]])
    F1 = m1 * w**2 * (R - d - l1 * sympy.cos(phi10) / 2)
    F2 = m2 * w**2 * (R - r)
    kinetic = (J1 * rates[0] ** 2 + J2 * rates[1] ** 2 + m2 * rate(C).dot(rate(C))) / 2
    potential = -m2 * g * C[1] - F2 * C[0] - F1 * arm[0] * l1 / 2
    end = l1 / 2 * sympy.Matrix([sympy.cos(phi10), sympy.sin(phi10)]) - sympy.Matrix([0, s0])
    longer = sympy.sqrt((arm * l1 / 2 - end).dot(arm * l1 / 2 - end)) - s0
    stored = m1 * g * longer + c * longer**2 / 2 - m1 * g * arm[1] * l1 / 2
    pull = (1 - anchored) * -c * stretch * (arm[1] * l1 / 2).diff(q[0])
    spring = sympy.Matrix([pull - anchored * stored.diff(q[0]), 0, 0, 0])
    wall = l1 * sympy.cos(phi10) + d - (C + e * a)[0] - r
    corner = C - l2 * a - r * n - D
    constraints = {
        Stage.joint: [wall, *corner],
        Stage.turning: [wall, (B - C).dot(n) + r],
        Stage.released: [wall],
    }
    point = (C + e * a)[1] + r * q[1]
    friction = -sympy.Matrix([point.diff(x) for x in q])

    along, across = sympy.sqrt(2 * (J2 - J_a / 2) / m2), sympy.sqrt(J_a / m2)
    points = [along * a, -along * a, across * n, -across * n]
    pushes = [-2 * m2 / 4 * -w * rate(C + x)[0] for x in points]
    moments = [push * x.dot(a) for push, x in zip(pushes, points)]
    at_end = (sum(moments) + l2 * sum(pushes)) / h
    sides = sympy.zeros(4, 1)
    for push, location in ((at_end, C + e * a), (sum(pushes) - at_end, C - l2 * a)):
        v = rate(location)
        heading = v / sympy.sqrt(v.dot(v) + creep**2)
        sides -= mu_s * sympy.Abs(push) * location.jacobian(q).T * heading

    slip = rate([(B - C).dot(a)])[0]
    rubbed = slip / sympy.sqrt(slip**2 + creep**2) * sympy.Matrix([slip.diff(x) for x in rates])
    turns = sympy.Matrix([1, -1, 0, 0]) * rim
    faces = sympy.Matrix([[0, arm[1] - arm[0], -arm[1] - arm[0]]])
    catcher = {
        Stage.joint: mu_c * turns * faces,
        Stage.turning: -mu_c * rubbed * sympy.Matrix([[0, 1]]),
        Stage.released: sympy.zeros(4, 1),
    }
    push = {Stage.joint: faces, Stage.turning: sympy.Matrix([[0, 1]])}
    mass = sympy.hessian(kinetic, rates)
    load = spring - sympy.Matrix([potential.diff(x) for x in q])
    variables = [*p, *q, *rates]
    derived = {}
    for stage, g_s in constraints.items():
        g_s = sympy.Matrix(g_s)
        slope = g_s.jacobian(q)
        bend = rate(slope * sympy.Matrix(rates))
        touches = push.get(stage, sympy.Matrix([[0]]))
        parts = [mass, load, friction, slope, bend, sides, catcher[stage], touches]
        derived[stage] = sympy.lambdify(variables, parts, "mpmath")
    return derived


def accelerations(p: Any, x: Any, w: float) -> list[float]:
    """phi1'', phi2'', xc'', yc'' and the reactions of Lagrange's equations, with 30 digits."""
    with mpmath.workdps(30):
        values = [*p.cup, *p.catcher, p.spring.c, *p.chute, *p.neglected, p.g, w]
        positions = [x.phi1, x.phi2, x.xc, x.yc, x.w1, x.w2, x.vxc, x.vyc]
        arguments = map(mpmath.mpf, [*values, *positions])
        mass, load, friction, slope, bend, sides, catcher, touches = lagrange()[x.stage](*arguments)
        friction, push = p.chute.mu * friction, slope.T
        load = load + sides
        if x.stage == Stage.released:
            push = push + friction
        else:
            load = load + p.cup.m * w * w * (p.chute.R - p.cup.d / 2) * friction
        solved = solve(mass, push, slope, load, bend)
        if (touches * solved[4:, 0])[0] > 0:
            solved = solve(mass, push + catcher, slope, load, bend)
        return [float(z) for z in solved]


def solve(mass: Any, push: Any, slope: Any, load: Any, bend: Any) -> Any:
    """Accelerations and the forces of the constraints."""
    system = mpmath.zeros(4 + slope.rows)
    system[:4, :4], system[:4, 4:], system[4:, :4] = mass, -push, slope
    return mpmath.lu_solve(system, mpmath.matrix([*load, *(-bend)]))


FRICTIONAL = {"mu_side": 0.4, "mu_catcher": 0.3, "rim": 2e-3, "creep": 0.05, "anchored": True}
ALL_NEGLECTED = {f"neglected.{name}": value for name, value in FRICTIONAL.items()}


def products(stage: Stage, count: int, **options: Any) -> Any:
    """Random machines with a product in this stage."""
    draw = random.Random(int(stage))
    for _ in range(count):
        p = random_parameters(model, draw, 0.15, **options)
        phi1 = draw.uniform(p.catcher.phi, model.flush_angle(p))
        phi2 = draw.uniform(5.6, 6.4) if stage == Stage.turning else draw.uniform(6.3, 7.8)
        x = start(model.State, stage=int(stage), phi1=phi1, w1=draw.uniform(-5, 5), phi2=phi2,
                  w2=draw.uniform(-30, 30), yc=0.2, vyc=draw.uniform(0, 2))  # fmt: skip
        yield p, model.complete_state(p, x), draw.uniform(0, 9)


def differences(component: Any, stage: Stage, **options: Any) -> Any:
    """Per random state, how far a component is from Lagrange's equations, over the largest."""
    for p, x, w in products(stage, 50, **options):
        a1, a2, ax, ay, N_K, N_B = component.MECHANICS[stage](p, x, w)
        derived = accelerations(p, x, w)
        turned, pushed = [a1 - derived[0], a2 - derived[1]], [ax - derived[2], ay - derived[3]]
        forces = [N_K - derived[4]] + ([N_B - derived[5]] if stage == Stage.turning else [])
        scales = [max(map(abs, part)) for part in (derived[:2], derived[2:4], derived[4:])]
        parts = zip((turned, pushed, forces), scales)
        yield max(abs(z) / scale for part, scale in parts for z in part)


@pytest.mark.parametrize(
    "options", [{}, ALL_NEGLECTED], ids=["as in the paper", "what it neglects"]
)
@pytest.mark.parametrize("stage", [Stage.joint, Stage.turning, Stage.released])
def test_accelerations_and_reactions_follow_from_lagrange(stage: Stage, options: Any) -> None:
    assert max(differences(model, stage, **options)) < 1e-12


def test_velocities_are_the_transfer_functions_times_the_speeds_of_catcher_and_cup() -> None:
    for stage in (Stage.joint, Stage.turning):
        for p, x, w in products(stage, 20):
            y = model.outputs(p, 0.0, x, model.Inputs(w, True))
            v_K = x.vyc + (p.cup.h - p.cup.l) * cos(x.phi2) * x.w2
            for actual, by_1, by_2 in (
                (x.vxc, y.u_xc1, y.u_xc2), (x.vyc, y.u_yc1, y.u_yc2), (v_K, y.u_yK1, y.u_yK2)
            ):  # fmt: skip
                assert by_1 * x.w1 + by_2 * x.w2 == pytest.approx(actual, rel=1e-12, abs=1e-15)
            ahead = model.complete_state(p, x._replace(phi1=x.phi1 + 1e-6))
            back = model.complete_state(p, x._replace(phi1=x.phi1 - 1e-6))
            slope = [(a - b) / 2e-6 for a, b in zip(ahead[:6], back[:6])]
            assert slope[2] == pytest.approx(y.u_phi2, abs=1e-7)
            assert slope[4:] == pytest.approx([y.u_xc1, y.u_yc1], abs=1e-7)


@pytest.mark.parametrize(
    ("mu", "n", "reason"),
    [(0.5, 62.5, 7), (0.5, 70, 4), (0.5, 72, 2), (0.2, 101, 6), (0.5, 1e5, 1)],
)
def test_a_jam_is_a_state_that_the_next_release_leaves(
    mu: float, n: float, reason: int, fmus: Path
) -> None:
    unit = machine(fmus, n, mu, 2e-2, stop=2.0)
    assert read(unit, "reason", "jammed", "orientation_time") == [reason, int(reason > 1), 0.0]
    assert read(unit, "w1", "w2", "vxc", "vyc") == [0.0] * 4
    stopped = unit.outputs()
    assert all(map(math.isfinite, stopped))
    t = 2.0 if reason == 1 else 0.02 * math.ceil(unit.get("since") / 0.02)
    if reason > 1:
        assert unit.set(w=1.0, release=False).step(t, 2e-2).outputs() == stopped
        unit.set(release=True)
        t += 2e-2
    for k in range(30):
        unit.set(w=0.0).step(t + 2e-2 * k, 2e-2)
    assert read(unit, "stage", "reason", "oriented") == [Stage.oriented, 0, 1]


def test_a_product_waits_for_an_edge_and_an_early_product_is_counted(fmus: Path) -> None:
    h, now = 7e-3, itertools.count()
    unit = Unit(fmus / FMU).start(5.0, release=False)
    MESSAGES.clear()

    def run(steps: int, release: bool) -> list[Any]:
        for _ in range(steps):
            unit.set(release=release).step(5.0 + h * next(now), h)
        return read(unit, "stage", "oriented", "missed")

    waiting = unit.outputs()
    assert run(10, False) == [Stage.waiting, 0, 0]
    assert unit.outputs() == waiting
    assert run(10, True) == [Stage.falling, 0, 0]
    assert [run(1, step % 2 == 0) for step in (1, 2, 3, 4)][-1] == [Stage.falling, 0, 2]
    assert run(60, True) == [Stage.oriented, 1, 2]
    assert unit.get("orientation_time") == pytest.approx(0.2638050034, abs=1e-10)
    assert run(1, False) == [Stage.oriented, 1, 2]
    assert run(1, True) == [Stage.falling, 1, 2]
    assert read(unit, *ROUTE[:4], "P_K") == [0.0] * 5
    assert run(60, True) == [Stage.oriented, 2, 2]
    assert [m for m in MESSAGES if "found a product under way" in m] == MESSAGES
    assert len(MESSAGES) == 1


def test_a_start_follows_the_parameters_and_closes_the_mechanism(fmus: Path) -> None:
    unit = Unit(fmus / FMU).start(release=False, **{"catcher.phi": 0.6, "chute.H": 0.1})
    expected = [0.6, 0.18 * cos(0.6) + 0.02, 0.18 * sin(0.6) - 0.043 - 0.1]
    assert read(unit, "phi1", "xc", "yc") == pytest.approx(expected, abs=1e-15)
    values = {"phi1": 0.83, "phi2": 6.3, "w1": 0.5, "w2": 26.0}
    unit = Unit(fmus / FMU).start(stage=2, release=False, **values)
    assert unit.get("yc") == pytest.approx(0.146872546424636 - 0.005 * sin(6.3), abs=1e-14)
    assert unit.step(0.0, 0.2).get("stage") == Stage.oriented
