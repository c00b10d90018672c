"""How does the motor's lag change the ripple of the iron drive, and is a resonance important?

At each speed the steady motion is resolved into orders 1..12 of the cam angle. The formula
nu_k = sqrt(B_eff / (theta T)) / k gives the speed at which order k of the torque lags its excitation
by 90 degrees; theta and the excitation come from turns at constant speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cosim import System
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
from workbench.charts.model import SERIES
from workbench.judgement import Holds
from workbench.live import moved

from .. import machine as iron
from .. import motion
from ..orders import (
    FIXED_STARTS,
    NO_ORDER,
    ORDERS,
    MeasuredDrive,
    SteadyTurn,
    at_constant_speed,
    figures,
    steady_turns,
    table_of_orders,
)

Frame = Any
LAGS = (12, 80, 200)
#: Share of the largest torque that the lag must add to an order for a resonance to matter [%]; a convention.
IMPORTANT = 10.0
#: Excitation over the largest one below which the gain of an order is not drawn; a convention.
SMALL = 0.1


class IronOrders(Question):
    """The mean speeds at which the orders are found."""

    parts = iron.PARTS
    fixed_starts = FIXED_STARTS

    speeds: tuple[float, ...] = option("2:7.5:23", "mean speeds of the cam", "rad/s", above=0.0)

    def solve(self, context: Context) -> Findings:
        """Seek the steady turns of three motors at all speeds, and where the lag of each adds most.

        This replaces the single certified run, because the figures come from steady motions at many speeds of
        several motors.
        """
        start = iron.MOTOR | {"iron.on_invalid": 1} | dict(self.start)
        machine = at_constant_speed(System(context.fmus, iron.WIRES, start))
        asked = [
            SteadyTurn.parse({"start": machine.start(lag / 1e3, nu), "speed": nu})
            for lag in LAGS
            for nu in self.speeds
        ]
        orders = table_of_orders(machine, steady_turns(context, asked))
        all_figures = figures(machine, orders.frame, LAGS)
        w_n = {lag / 1e3: all_figures[f"w_n_{lag}ms"].value for lag in LAGS}
        crossings = [(T, k, w / k) for T, w in w_n.items() for k in ORDERS]
        tables = {
            "iron_orders.csv": orders,
            "iron_orders_meets.csv": Table.of_rows(
                crossings, {"T": "s", "order": "1", "nu": "rad/s"}
            ),
        }
        first, steps = asked[0], f"{asked[0].steps_per_rev} steps per revolution"
        return Findings(
            all_figures, (machine, orders.frame), System(context.fmus, iron.WIRES, first.start), {}, steps, first.algorithm, tables
        )  # fmt: skip

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
