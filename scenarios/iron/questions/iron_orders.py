"""How does the motor's lag change the ripple of the iron drive, and is a resonance important?

At each speed the steady motion is resolved into orders 1..12 of the cam angle. The formula
nu_k = sqrt(B_eff / (theta T)) / k gives the speed at which order k of the torque lags its excitation
by 90 degrees; theta and the excitation come from turns at constant speed.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

import cosim
from cosim import System, largest
from cosim.accuracy.limit import limit
from cosim.dense import Array as Samples
from cosim.metrics import harmonics
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Mark,
    Panel,
    Question,
    Show,
    Table,
    option,
)
from workbench.answer import parameters
from workbench.charts.model import SERIES
from workbench.context import captured_log_warnings
from workbench.figure import figure_of_columns, figure_of_figures, listed
from workbench.judgement import Holds
from workbench.live import moved
from workbench.steady import LastTwoTurns, steady_turns

from .. import machine as iron
from .. import motion

Frame = Any
FIXED_STARTS = ("motor.A", "motor.T", "motor.tau", "iron.w_cam", "iron.phi")
#: Orders of the cam angle that are reported; a convention.
ORDERS = 12
#: Even cam angles at which the steady motion is read, two for a degree: an order does not pass for one of those
#: reported unless it is above 700.
TURN_ANGLES = 720
LAGS = (12, 80, 200)
#: Communication steps per revolution of the cam, four for a degree; a convention.
PER_REV = 1440
#: Inertia of a light rotor [kg.m2], with which the inertia of the mechanism keeps more digits.
LIGHT = 1e4
#: Share of the largest torque that the lag must add to an order for a resonance to matter [%]; a convention.
IMPORTANT = 10.0
#: Excitation over the largest one below which the gain of an order is not drawn; a convention.
SMALL = 0.1
ALGORITHM = "strang"
RELEASED_FORCES = [force for force, _, _ in iron.LETS_GO.values()]
NO_ORDER = "the lag adds to no order"
LET_GO = "the results are not valid until all is loaded again"
UNITS = {
    "T": "s", "nu": "rad/s", "order": "1", "torque": "N.m", "torque_phase": "deg",
    "speed": "rad/s", "excitation": "N.m", "lag": "deg", "gain": "1", "settling": "N.m",
    "added": "%",
}  # fmt: skip


class IronOrders(Question):
    """The mean speeds at which the orders are found."""

    parts = iron.PARTS
    fixed_starts = FIXED_STARTS

    speeds: tuple[float, ...] = option("2:7.5:23", "mean speeds of the cam", "rad/s", above=0.0)

    def solve(self, context: Context) -> Findings:
        """Sweep three motors; where the lag adds most, again with coarser steps.

        This replaces the single certified run, because the figures come from steady motions at many speeds of
        several motors.
        """
        start = iron.MOTOR | {"iron.on_invalid": 1} | dict(self.start)
        machine = at_constant_speed(System(context.fmus, iron.WIRES, start))
        run = partial(simulate, machine)
        cases = [(lag / 1e3, nu, PER_REV) for lag in LAGS for nu in self.speeds]
        swept = chain.from_iterable(context.each(run, cases, "sweep"))
        orders = context.record_rows("iron_orders.csv", UNITS, swept)
        worst = orders.frame.dropna().query("added > 0").sort_values("added").groupby("T").tail(1)
        again = [(x["T"], x["nu"], PER_REV // n) for n in (2, 4) for _, x in worst.iterrows()]
        repeated = chain.from_iterable(context.each(run, again, "coupling errors"))
        which = set(zip(worst["T"], worst["order"]))
        runs = [*worst.itertuples(index=False), *(x for x in repeated if (x[0], x[2]) in which)]
        all_figures = figures(machine, orders.frame, Table.of_rows(runs, UNITS).frame)
        w_n = {lag / 1e3: all_figures[f"w_n_{lag}ms"].value for lag in LAGS}
        crossings = [(T, k, w / k) for T, w in w_n.items() for k in range(1, ORDERS + 1)]
        units = {x: UNITS[x] for x in ("T", "order", "nu")}
        tables = {
            "iron_orders.csv": orders,
            "iron_orders_meets.csv": Table.of_rows(crossings, units),
        }
        system, steps = machine.system(*cases[0][:2]), f"{PER_REV} steps per revolution"
        return Findings(all_figures, (machine, orders.frame), system, {}, steps, ALGORITHM, tables)

    def judgements(self, f: Mapping[str, Figure], r: object) -> list[Judgement]:
        """For which motors a resonance matters, and what the lag of each adds; the worst first."""
        answers = []
        grows = f"by more than {IMPORTANT:g} % of the largest torque"
        for lag in sorted(LAGS, key=lambda x: -np.nan_to_num(f[f"added_{x}ms"].value)):
            added = f[f"added_{lag}ms"]
            adds_nothing = added.reason.startswith(NO_ORDER)
            answers.append(
                Judgement(
                    f"with a motor lag of {lag} ms no torque order grows {grows}",
                    added,
                    most=IMPORTANT,
                    is_so=True if adds_nothing else None,
                    yes=f"With a motor lag of {lag} ms no torque order grows {grows}",
                    no=f"With a motor lag of {lag} ms a torque order grows {grows}",
                    note=added.reason if adds_nothing else "",
                )
            )
        first = (Holds.NO, Holds.OPEN, Holds.YES)
        answers.sort(key=lambda x: first.index(x.answer or Holds.OPEN))
        if answers[0].answer is Holds.YES:
            answers[0] = replace(answers[0], yes=f"No resonance matters; {answers[0].what}")
        return [*answers, Judgement("the follower lifts off at", f["follower_limit"])]

    def show(self, f: Mapping[str, Figure], r: tuple[MeasuredDrive, Frame]) -> Show:
        """Gains and torques of the orders, and a turn of the mechanism."""
        machine, orders = r
        nu = self.speeds[len(self.speeds) // 2]
        turn, title = iron.turn(machine.drive, nu, 360), f"The mechanism at {nu:g} rad/s"
        moving = moved(motion.live_motion(title, turn, machine.drive, 4.0), turn)
        return Show([gain(f, orders), *(torque_chart(lag, f, orders) for lag in LAGS)], [moving])


class MeasuredDrive(NamedTuple):
    """The drive with the user's start values; slope of the motor's line and gear ratio; at the cam's
    shaft mean inertia, friction work per turn, and a turn's torque at constant speed, `still` +
    `moving` nu^2, over its angles phi.
    """

    drive: System
    slope: float
    i_g: float
    theta: Figure
    work: float
    phi: Samples
    still: Samples
    moving: Samples

    def torque(self, nu: float) -> Samples:
        """Over a turn at constant speed [N.m]."""
        return self.still + self.moving * nu**2

    def largest_torque(self, nu: float) -> Figure:
        """The largest torque of such a turn, of either sign."""
        return figure_of_columns(largest, self.phi, abs(self.torque(nu)), unit="N.m")

    def excitation_error(self, nu: float, order: int) -> float:
        """How far the rows leave open what such a turn has of an order [N.m]."""
        every, *halves = (
            abs(harmonics(self.phi[rows], self.torque(nu)[rows], ORDERS)[order - 1])
            for rows in (np.s_[:], np.s_[::2], np.s_[1::2])
        )
        return float(max(abs(every - half) for half in halves))

    def system(self, lag: float, speed: float) -> System:
        """With the lag [s] of a motor that is set for the mean speed [rad/s], turning from phi = 0."""
        mean = self.work / (2 * math.pi * self.i_g)
        fixed = dict(
            zip(FIXED_STARTS, (self.slope * self.i_g * speed + mean, lag, mean, speed, 0.0))
        )
        return replace(self.drive, start={**self.drive.start, **fixed})


def at_constant_speed(drive: System) -> MeasuredDrive:
    """The mechanism from turns at constant speed, whose last rows are the first again: two tell the
    torque; the inertia, beside that of the rotor, is known to more digits with a light one.
    """
    values, names = parameters(drive), ("motor.B", "iron.reducer.i_g", "iron.reducer.J")
    slope, i_g, rotor = (float(values[x].value) for x in names)
    slow, two = (iron.turn(drive, w, PER_REV) for w in (1.0, 2.0))
    moving = (two["iron.tau_cam"] - slow["iron.tau_cam"])[:-1] / 3
    still = slow["iron.tau_cam"][:-1] - moving
    light, work = iron.turn(drive, 1.0, PER_REV, LIGHT), float(slow["iron.E_friction"][-1])
    theta = (2 * light["iron.E_kin"] / light["iron.w_cam"] ** 2)[:-1] - (LIGHT - rotor) * i_g**2
    mean = float(theta.mean())
    fewer = [theta[first::n].mean() for n in (2, 3) for first in range(n)]
    spread = max(abs(mean - float(x)) for x in fewer) + 4 * math.ulp(LIGHT * i_g**2)
    inertia = Figure(mean, "kg.m2", spread, "mean inertia at the cam shaft")
    return MeasuredDrive(drive, slope, i_g, inertia, work, slow["iron.phi"][:-1], still, moving)


def simulate(machine: MeasuredDrive, case: tuple[float, float, int]) -> list[Sequence[float]]:
    """The orders of the steady motion with a lag [s] at a mean speed [rad/s], in so many steps per
    revolution; a warning and nan where it does not settle.
    """
    T, nu, per_rev = case
    system, excitation = machine.system(T, nu), machine.torque(nu)
    states = {name: np.array([system.start[name]], float) for name in ("iron.w_cam", "motor.tau")}
    with captured_log_warnings() as warnings:
        turns = steady_turns(
            system, states, list(states), "iron.phi", np.array([nu]), steps_per_rev=per_rev,
            record=RELEASED_FORCES, algorithm=ALGORITHM, angles=TURN_ANGLES,
        )  # fmt: skip
    if turns.problems[0]:
        where = f"{nu:g} rad/s with a lag of {1e3 * T:g} ms"
        logging.getLogger("cosim").warning(f"no steady motion at {where}: {turns.problems[0]}")
    else:
        warn(turns, T, nu, warnings())
    orders = range(1, ORDERS + 1)
    both = machine.i_g * np.array([turns.sine_amplitudes("motor.tau", k)[0] for k in orders])
    torque, left = both[:, 1], turns.settling_error(both)
    speed = np.array([turns.sine_amplitudes("iron.w_cam", k)[0, 1] for k in orders])
    tau = harmonics(machine.phi, excitation, ORDERS)
    M, excited, behind = np.abs(torque), np.abs(tau), np.angle(tau) - np.angle(torque)
    columns = [
        M, np.degrees(np.angle(torque)), np.abs(speed), excited, np.degrees(behind) % 360.0,
        M / excited, left, 100 * (M - excited) / machine.largest_torque(nu).value,
    ]  # fmt: skip
    return [(T, nu, k, *row) for k, row in enumerate(np.transpose(columns).tolist(), 1)]


def warn(turns: LastTwoTurns, T: float, nu: float, warnings: Sequence[str]) -> None:
    """Name what lets go in the steady motion of a lag [s] at a mean speed [rad/s], once; other warnings
    of the runs are passed on.
    """
    log = logging.getLogger("cosim")
    for warning in warnings:
        if LET_GO not in warning:
            log.warning(warning)
    events = [
        event for force, event, _ in iron.LETS_GO.values() if turns.of(force)[0, 1].min() < 0.0
    ]
    if events:
        log.warning(
            f"in the steady motion at {nu:g} rad/s with a lag of {1e3 * T:g} ms {listed(events)}: the orders "
            "are not valid for a real drive"
        )


def figures(machine: MeasuredDrive, orders: Frame, runs: Frame) -> dict[str, Figure]:
    """Inertia, slope and limit of the mechanism; of each lag the formula, and where it adds most.

    `runs` are the order that each lag adds most to, with all, a half and a quarter of the steps;
    the errors are those of the coupling, of the excitation's rows, and what settling leaves.
    """
    theta, B = machine.theta, machine.i_g**2 * machine.slope
    result = {
        "theta": theta,
        "slope": Figure(B, "N.m.s/rad", 0.0, "slope of the motor line there"),
        **{n: x for n, x in iron.limits(machine.drive).items() if n.startswith("follower")},
    }
    share = "most that the lag adds to an order, over the largest torque"
    for lag in LAGS:
        T, mine = lag / 1e3, runs[runs["T"] == lag / 1e3]
        of_lag = {
            "w_n": figure_of_figures(
                lambda x, T=T: np.sqrt(B / (x * T)),
                theta,
                unit="rad/s",
                meaning="frequency of a lag of 90 deg, by formula",
            ),
            "zeta": figure_of_figures(
                lambda x, T=T: np.sqrt(x / (B * T)) / 2,
                theta,
                unit="1",
                meaning="damping ratio of the ripple",
            ),
        }
        why = ""
        if mine["added"].head(2).isna().any():  # an error of the coupling needs two step sizes
            why = "there is no steady motion with half the steps where the lag adds most"
        elif not len(mine):
            moves = orders[orders["T"] == T]["added"].notna().any()
            why = f"{NO_ORDER if moves else 'there is no steady motion'} at any speed of the sweep"
        if why:
            of_lag["added"] = Figure.undetermined("%", why, share)
        else:
            at = next(mine.itertuples())
            most, left = machine.largest_torque(at.nu), 2 * at.settling
            left += machine.excitation_error(at.nu, at.order)
            by_rows = (100 * left + at.added * (most.error or 0.0)) / most.value
            of_lag["added"] = figure_of(mine["added"], by_rows, "%", share)
            meaning = f"gain of order {at.order} there"
            of_lag["gain"] = figure_of(mine["gain"], left / at.excitation, "1", meaning)
            of_lag["worst_speed"] = Figure(at.nu, "rad/s", 0.0, "speed of the sweep there")
        for name, x in of_lag.items():
            result[f"{name}_{lag}ms"] = x._replace(meaning=f"{x.meaning}, lag {lag} ms")
    return result


def figure_of(runs: Any, by_rows: float, unit: str, meaning: str) -> Figure:
    """The first of values of runs with longer and longer steps; `by_rows` is added to its error."""
    of_runs = limit(runs, cosim.CONVERGENCE_ORDERS[ALGORITHM])
    if reason := of_runs.sentence():
        return Figure.undetermined(unit, reason, meaning)
    return Figure(float(of_runs.value), unit, float(of_runs.error) + by_rows, meaning)


def gain(f: Mapping[str, Figure], orders: Frame) -> Chart:
    """Torque over excitation; orders whose excitation is small say nothing and are left out."""
    curves, marks, theta, B = [], [], f["theta"].value, f["slope"].value
    for lag, color in zip(LAGS, SERIES):
        mine, name, w_n = orders[orders["T"] == lag / 1e3], f"lag {lag} ms", f[f"w_n_{lag}ms"].value
        strong = mine[mine["excitation"] > SMALL * mine["excitation"].max()]
        frequency = (strong["order"] * strong["nu"]).to_numpy()
        w = np.linspace(frequency.min(), frequency.max(), 300)
        formula = np.abs(B / (B - theta * lag / 1e3 * w**2 + 1j * theta * w))
        curves.append(Curve(f"{name}, theory", w, formula, color, "theory"))
        curves.append(Curve(name, frequency, strong["gain"].to_numpy(), color, "points"))
        if w[0] <= w_n <= w[-1]:
            marks.append(Mark(w_n, f"{name}: w_n {w_n:.1f} rad/s"))
    title = f"Gain of the orders whose excitation is above {SMALL:.0%} of the largest"
    slow = [Mark(1.0, "1: torque = excitation")]
    panel = Panel("gain", "1", curves, slow, includes=(0.0,))
    return Chart(title, "frequency of the order [rad/s]", [panel], marks)


def torque_chart(lag: int, f: Mapping[str, Figure], orders: Frame) -> Chart:
    """The torque of each order over the speed, where it meets w_n, and where the follower lifts."""
    mine = orders[orders["T"] == lag / 1e3]
    curves, marks = [], [Mark(f["follower_limit"].value, "follower lifts off")]
    for k, color in enumerate(SERIES, 1):
        nu, height = mine[mine["order"] == k][["nu", "torque"]].to_numpy().T
        curves.append(Curve(f"order {k}", nu, height, color, "linked"))
        marks.append(Mark(f[f"w_n_{lag}ms"].value / k, f"w_n / {k}"))
    title = f"Torque of the orders with a motor lag of {lag} ms"
    inside = [mark for mark in marks if nu[0] <= mark.at <= nu[-1]]
    panel = Panel("amplitude", "N.m", curves, includes=(0.0,))
    return Chart(title, "cam speed [rad/s]", [panel], inside)
