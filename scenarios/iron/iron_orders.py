"""How does the motor's lag change the ripple of the iron drive, and is a resonance of importance?

At each speed the steady motion is resolved into orders 1..12 of the cam angle. Formula
nu_k = sqrt(B_eff / (theta T)) / k says where order k of the torque lags its excitation by 90
degrees; theta and the excitation come from turns at constant speed.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
import workbench
from cosim import System
from cosim.system import Value
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.answer import parameters, stream
from workbench.limit import coupling
from workbench.measure import Measured, Samples, harmonics
from workbench.orbit import NotSteady, steady
from workbench.report.chart import SERIES

from . import drive as iron
from . import mechanism

Frame = Any
PARTS = iron.PARTS
OWN = ("motor.A", "motor.T")
ORDERS, HIGHEST = 12, 60
LAGS = {"12ms": 0.012, "80ms": 0.08, "200ms": 0.2}
PER_REV = 1440
IMPORTANT, SMALL = 10.0, 0.1
ALGORITHM = "strang"
TABLE, MEETS = "iron_orders.csv", "iron_orders_meets.csv"
UNITS = {
    "T": "s", "nu": "rad/s", "order": "1", "torque": "N.m", "torque_phase": "deg",
    "speed": "rad/s", "excitation": "N.m", "lag": "deg", "gain": "1", "settling": "N.m",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    speeds: tuple[float, ...] = option("2:7.5:23", "mean speeds of the cam", "rad/s", above=0.0)


class Machine(NamedTuple):
    """FMUs and start values; slope of the motor's line and gear ratio; at the cam's shaft mean
    inertia, friction work per turn, and a turn's torque at constant speed, `still` + `moving` nu^2,
    over its angles phi.
    """

    fmus: Mapping[str, Path]
    start: Mapping[str, Value]
    slope: float
    i_g: float
    theta: Measured
    work: float
    phi: Samples
    still: Samples
    moving: Samples

    def torque(self, nu: float) -> Samples:
        """Over a turn at constant speed [N.m]."""
        return self.still + self.moving * nu**2

    def system(self, T: float, nu: float) -> System:
        """The motor with the lag T [s], set for the mean speed nu [rad/s], on the iron drive."""
        mean = self.work / (2 * math.pi * self.i_g)
        motor = {"motor.A": self.slope * self.i_g * nu + mean, "motor.T": T, "motor.tau": mean}
        values = {**iron.MOTOR, **motor, "iron.w_cam": nu, "iron.on_invalid": 1, **self.start}
        return System(self.fmus, iron.WIRES, values)


class Case(NamedTuple):
    """Motor lag [s], mean speed [rad/s], communication steps per revolution."""

    T: float
    nu: float
    per_rev: int = PER_REV


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep three motors; where the lag adds most, again with coarser steps."""
    machine = measure(bench.fmus, o.start)
    run = partial(simulate, machine)
    cases = [Case(T, nu) for T in LAGS.values() for nu in o.speeds]
    rows: list[Sequence[float]] = []
    with stream(bench.out and bench.out / TABLE, list(UNITS)) as keep:
        for found in bench.each(run, cases, "sweep"):
            keep(found)
            rows += found
    orders = Table.of_rows(rows, UNITS).frame
    share = added(machine, orders).fillna(0.0).groupby(orders["T"])
    worst = orders.loc[share.idxmax()[share.max() > 0.0]]
    again = [Case(x["T"], x["nu"], PER_REV // n) for n in (1, 2, 4) for _, x in worst.iterrows()]
    more = [row for found in bench.each(run, again, "coupling errors") for row in found]
    finer = Table.of_rows(more, UNITS).frame.astype(float)
    told = figures(machine, finer.merge(worst[["T", "order"]].astype(float)))
    meets = [
        (T, k, told[f"w_n_{lag}"].value / k)
        for lag, T in LAGS.items()
        for k in range(1, ORDERS + 1)
    ]
    units = {x: UNITS[x] for x in ("T", "order", "nu")}
    tables = {TABLE: Table(orders, UNITS), MEETS: Table.of_rows(meets, units)}
    system, steps = machine.system(*cases[0][:2]), f"{PER_REV} steps per revolution"
    return Findings(told, (machine, orders), system, {}, steps, ALGORITHM, tables)


def measure(fmus: Mapping[str, Path], start: Mapping[str, Value]) -> Machine:
    """The mechanism from two turns at constant speed, whose last rows are the first again."""
    told = parameters(System(fmus, iron.WIRES, {**iron.MOTOR, **start}))
    slope, i_g, rotor = (
        float(told[x].value) for x in ("motor.B", "iron.reducer.i_g", "iron.reducer.J")
    )
    record = ("iron.phi", "iron.w_cam", "iron.tau_cam", "iron.E_kin", "iron.E_friction")
    alone = iron.alone(fmus, start)
    one, two = (iron.turn(speed, alone, PER_REV, record) for speed in (1.0, 2.0))
    moving = (two["iron.tau_cam"] - one["iron.tau_cam"])[:-1] / 3
    still = one["iron.tau_cam"][:-1] - moving
    whole = (2 * one["iron.E_kin"] / one["iron.w_cam"] ** 2)[:-1]
    theta, work = whole - (iron.FLYWHEEL - rotor) * i_g**2, float(one["iron.E_friction"][-1])
    off = max(abs(float(theta.mean() - theta[first::2].mean())) for first in (0, 1))
    mean = Measured(float(theta.mean()), off)
    return Machine(fmus, start, slope, i_g, mean, work, one["iron.phi"][:-1], still, moving)


def simulate(machine: Machine, case: Case) -> list[Sequence[float]]:
    """The orders of the steady motion at one mean speed; a warning and nan where it does not settle."""
    T, nu, per_rev = case
    system = machine.system(T, nu)

    def at(states: Mapping[str, float]) -> System:
        return replace(system, start={**system.start, **states, "iron.phi": 0.0})

    def amplitudes(column: str, back: int = 0) -> NDArray[np.complex128]:
        rows = turns.window(back)
        phi, x = turns.result["iron.phi"][rows], turns.result[column][rows]
        return harmonics(phi, x, HIGHEST)[:ORDERS]

    states = {name: float(system.start[name]) for name in ("iron.w_cam", "motor.tau")}
    torque = speed = before = np.full(ORDERS, complex(math.nan, math.nan))
    left = 0.0
    try:
        turns = steady(at, states, "iron.phi", nu, per_rev, (), ALGORITHM)
        torque, before = (machine.i_g * amplitudes("motor.tau", back) for back in (0, 1))
        speed, left = amplitudes("iron.w_cam"), turns.remains(1.0)
    except NotSteady as problem:
        where = f"{nu:g} rad/s with a lag of {1e3 * T:g} ms"
        logging.getLogger("cosim").warning(f"no steady motion at {where}: {problem}")
    tau = harmonics(machine.phi, machine.torque(nu), ORDERS)
    M, excited, behind = np.abs(torque), np.abs(tau), np.angle(tau) - np.angle(torque)
    columns = [
        M, np.degrees(np.angle(torque)), np.abs(speed), excited, np.degrees(behind) % 360.0,
        M / excited, left * np.abs(torque - before),
    ]  # fmt: skip
    return [(T, nu, k, *row) for k, row in enumerate(np.transpose(columns).tolist(), 1)]


def added(machine: Machine, orders: Frame) -> Frame:
    """What the lag adds to each order as a share of the largest torque [%]."""
    largest = [np.abs(machine.torque(nu)).max() for nu in orders["nu"]]
    return 100 * (orders["torque"] - orders["excitation"]) / largest


def figures(machine: Machine, worst: Frame) -> dict[str, Figure]:
    """Inertia, slope and limit of the mechanism; of each lag the formula, and where it adds most.

    `worst` are the order that each lag adds most to, with all, a half and a quarter of the steps;
    the errors are those of the coupling, and what settling leaves.
    """
    theta, B = machine.theta, machine.i_g**2 * machine.slope
    limits = iron.limits(iron.alone(machine.fmus, machine.start))
    found = {
        "theta": theta.figure("kg.m2", "mean inertia at the cam's shaft"),
        "slope": Figure(B, "N.m.s/rad", 0.0, "slope of the motor line there"),
        **{name: x for name, x in limits.items() if name.startswith("follower")},
    }
    for tail, T in LAGS.items():
        lag, off = f"lag {1e3 * T:g} ms", theta.error / (2 * theta.value)
        w_n, zeta = math.sqrt(B / (theta.value * T)), math.sqrt(theta.value / (B * T)) / 2
        meaning = f"frequency where an order lags 90 deg, by formula, {lag}"
        found[f"w_n_{tail}"] = Figure(w_n, "rad/s", w_n * off, meaning)
        meaning = f"damping ratio of the ripple, {lag}"
        found[f"zeta_{tail}"] = Figure(zeta, "1", zeta * off, meaning)
        share, runs = f"most that the lag adds, in largest torques, {lag}", worst[worst["T"] == T]
        if runs.empty:
            none = "the lag adds to no order at any speed of the sweep"
            found[f"added_{tail}"] = Figure.refused("%", none, share)
            continue
        at, shares = runs.iloc[0], added(machine, runs).to_list()
        nu, left = at["nu"], 2 * at["settling"]
        scale = shares[0] / (at["torque"] - at["excitation"])
        error = coupling(shares, cosim.ORDERS[ALGORITHM]) + scale * left
        found[f"added_{tail}"] = Figure(shares[0], "%", error, share)
        error = coupling(runs["gain"].to_list(), cosim.ORDERS[ALGORITHM]) + left / at["excitation"]
        meaning = f"gain of order {at['order']:g} there, {lag}"
        found[f"gain_{tail}"] = Figure(at["gain"], "1", error, meaning)
        found[f"worst_speed_{tail}"] = Figure(nu, "rad/s", 0.0, f"speed of the sweep there, {lag}")
    return found


def verdict(o: Options, f: Mapping[str, Figure], r: tuple[Machine, Frame]) -> str:
    """For which motors a resonance matters, and what the lag of each adds."""
    does = {x: f[f"added_{x}"] for x in LAGS if f[f"added_{x}"].error is not None}
    name = {x: f"{1e3 * T:g} ms" for x, T in LAGS.items()}
    matter = [name[x] for x, share in does.items() if share.value > IMPORTANT]
    which = f"a lag of {' and '.join(matter)}" if matter else "none of the motors"
    adds = [
        f"{share.text()} with {name[x]} at {f[f'worst_speed_{x}'].text()}"
        for x, share in does.items()
    ]
    return (
        f"A resonance is of practical importance with {which}: it is where the lag adds more than "
        f"{IMPORTANT:g} % of the largest torque to an order. At most the lag adds "
        f"{', '.join(adds) or 'nothing'}. The follower lifts off at {f['follower_limit'].text()}."
    )


def show(o: Options, f: Mapping[str, Figure], r: tuple[Machine, Frame]) -> Show:
    """Gains and torques of the orders, and a turn of the mechanism."""
    machine, orders = r
    nu, alone = o.speeds[len(o.speeds) // 2], iron.alone(machine.fmus, machine.start)
    turn = iron.turn(nu, alone, 360, [f"iron.{x}" for x in mechanism.SEEN])
    title = f"The mechanism at {nu:g} rad/s"
    moving = mechanism.motion(title, turn, alone, turn["time"][-1], 4.0)
    return Show([gain(f, orders), *(torque(lag, f, orders) for lag in LAGS)], [moving])


def gain(f: Mapping[str, Figure], orders: Frame) -> Chart:
    """Torque over excitation; orders whose excitation is small say nothing and are left out."""
    curves, marks, theta, B = [], [], f["theta"].value, f["slope"].value
    for (lag, T), color in zip(LAGS.items(), SERIES):
        mine, name, w_n = orders[orders["T"] == T], f"lag {1e3 * T:g} ms", f[f"w_n_{lag}"].value
        strong = mine[mine["excitation"] > SMALL * mine["excitation"].max()]
        frequency = (strong["order"] * strong["nu"]).to_numpy()
        w = np.linspace(frequency.min(), frequency.max(), 300)
        formula = np.abs(B / (B - theta * T * w**2 + 1j * theta * w))
        curves.append(Curve(f"{name}, theory", w, formula, color, "theory"))
        curves.append(Curve(name, frequency, strong["gain"].to_numpy(), color, "points"))
        if w[0] <= w_n <= w[-1]:
            marks.append(Mark(w_n, f"{name}: w_n {w_n:.1f} rad/s"))
    title = f"What the drive makes of an order's excitation, if above {SMALL:.0%} of the largest"
    one = [Mark(1.0, "1: torque = excitation")]
    panel = Panel("gain", "1", curves, one, includes=(0.0,))
    return Chart(title, "frequency of the order [rad/s]", [panel], marks)


def torque(lag: str, f: Mapping[str, Figure], orders: Frame) -> Chart:
    """The torque of each order over the speed, where it meets w_n, and where the follower lifts."""
    mine, adds = orders[orders["T"] == LAGS[lag]], f[f"added_{lag}"]
    curves, marks = [], [Mark(f["follower_limit"].value, "follower lifts off")]
    for k, color in enumerate(SERIES, 1):
        nu, height = mine[mine["order"] == k][["nu", "torque"]].to_numpy().T
        curves.append(Curve(f"order {k}", nu, height, color, "linked"))
        marks.append(Mark(f[f"w_n_{lag}"].value / k, f"w_n / {k}"))
    share = f"at most {adds.value:.1f} %" if adds.error is not None else "nothing"
    title = f"A motor lag of {1e3 * LAGS[lag]:g} ms adds {share} of the largest torque to an order"
    inside = [mark for mark in marks if nu[0] <= mark.at <= nu[-1]]
    panel = Panel("amplitude", "N.m", curves, includes=(0.0,))
    return Chart(title, "cam speed [rad/s]", [panel], inside)
