"""Steady turns of the iron's drive, and the orders of the cam angle in them beside those that excite it."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import System, largest
from cosim.dense import Array
from cosim.metrics import harmonics
from workbench import Context, Figure, Number, Question, Reader, Table, option
from workbench.answer import parameters
from workbench.context import captured_log_warnings
from workbench.figure import figure_of_columns, figure_of_figures, listed
from workbench.live import REVOLUTION
from workbench.options import Start
from workbench.orbits import Motions, Orbit, measured, orbit_figure

from . import machine as iron

Frame = Any
FIXED_STARTS = ("motor.A", "motor.T", "motor.tau", "iron.w_cam", "iron.phi")
#: Orders of the cam angle that are reported; a convention.
ORDERS = range(1, 13)
#: Even cam angles at which the steady motion is read, two for a degree: an order does not pass for one of those
#: reported unless it is above 700.
TURN_ANGLES = 720
#: Communication steps per revolution of the cam, four for a degree; a convention.
PER_REV = 1440
#: Inertia of a light rotor [kg.m2], with which the inertia of the mechanism keeps more digits.
LIGHT = 1e4
NO_ORDER = "the lag adds to no order"
LET_GO = "the results are not valid until all is loaded again"
TORQUE = "motor.tau * iron.reducer.i_g"
UNITS_OF_ORDERS = {
    "T": "s", "nu": "rad/s", "order": "1", "torque": "N.m", "torque_phase": "deg",
    "speed": "rad/s", "excitation": "N.m", "lag": "deg", "gain": "1", "torque_error": "N.m",
    "added": "%",
}  # fmt: skip


class SteadyTurn(Question):
    """The mean speed, and how the turn is run."""

    parts = iron.PARTS
    wires = iron.WIRES
    method = Orbit("iron.phi", "iron.w_cam", ("iron.w_cam", "motor.tau"), angles=TURN_ANGLES)
    numbers = (
        *(
            Number(f"{name}_{k}", Reader(kind, column, REVOLUTION, k), unit, f"{kind} of order {k}")
            for k in ORDERS
            for name, kind, column, unit in (
                ("torque", "amplitude", TORQUE, "N.m"),
                ("torque_phase", "phase", TORQUE, "deg"),
                ("speed", "amplitude", "iron.w_cam", "rad/s"),
            )
        ),
        *(
            Number(f"{name}_least", Reader("min", force, REVOLUTION), "N", f"least {meaning}")
            for name, (force, _, meaning) in iron.LETS_GO.items()
        ),
    )

    speed: float = option(iron.NOMINAL, "mean speed of the cam", "rad/s", above=0.0)
    steps_per_rev: int = option(PER_REV, "communication steps per revolution", least=1)
    algorithm: str = option("strang", "coupling algorithm")


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
    phi: Array
    still: Array
    moving: Array

    def torque(self, nu: float) -> Array:
        """Over a turn at constant speed [N.m]."""
        return self.still + self.moving * nu**2

    def largest_torque(self, nu: float) -> Figure:
        """The largest torque of such a turn, of either sign."""
        return figure_of_columns(largest, self.phi, abs(self.torque(nu)), unit="N.m")

    def excitation(self, nu: float, rows: slice = np.s_[:]) -> NDArray[np.complex128]:
        """The orders of such a turn [N.m], of some of its rows."""
        return harmonics(self.phi[rows], self.torque(nu)[rows], len(ORDERS))

    def excitation_of(self, nu: float, order: int) -> Figure:
        """The size of an order of such a turn; the error is what every second row alone changes."""
        every, *halves = (
            abs(self.excitation(nu, rows)[order - 1])
            for rows in (np.s_[:], np.s_[::2], np.s_[1::2])
        )
        return Figure(float(every), "N.m", float(max(abs(every - half) for half in halves)))

    def start(self, lag: float, speed: float) -> Start:
        """With the lag [s] of a motor that is set for the mean speed [rad/s], turning from phi = 0."""
        mean = self.work / (2 * math.pi * self.i_g)
        fixed = dict(
            zip(FIXED_STARTS, (self.slope * self.i_g * speed + mean, lag, mean, speed, 0.0))
        )
        return {**self.drive.start, **fixed}


def at_constant_speed(drive: System) -> MeasuredDrive:
    """The mechanism from turns at constant speed, whose last rows are the first again: two tell the
    torque; the inertia, beside that of the rotor, is known to more digits with a light one.
    """
    values, names = parameters(drive), ("motor.B", "iron.reducer.i_g", "iron.reducer.J")
    slope, i_g, rotor = (float(values[x].value) for x in names)
    turns = iron.two_turns(drive, PER_REV)
    still, moving = (x[:-1] for x in turns.parts("iron.tau_cam"))
    light, work = iron.turn(drive, 1.0, PER_REV, LIGHT), float(turns.slow["iron.E_friction"][-1])
    theta = (2 * light["iron.E_kin"] / light["iron.w_cam"] ** 2)[:-1] - (LIGHT - rotor) * i_g**2
    mean = float(theta.mean())
    fewer = [theta[first::n].mean() for n in (2, 3) for first in range(n)]
    spread = max(abs(mean - float(x)) for x in fewer) + 4 * math.ulp(LIGHT * i_g**2)
    inertia = Figure(mean, "kg.m2", spread, "mean inertia at the cam shaft")
    phi = turns.slow["iron.phi"][:-1]
    return MeasuredDrive(drive, slope, i_g, inertia, work, phi, still, moving)


def steady_turns(context: Context, asked: Sequence[SteadyTurn]) -> Motions:
    """Return the steady turns; a warning names once where there is none, or what lets go in it."""
    log = logging.getLogger("cosim")
    with captured_log_warnings() as warnings:
        motions = measured(context, asked)
    others = [x for x in warnings() if LET_GO not in x]
    for j, (o, why) in enumerate(zip(asked, motions.problems)):
        where = f"at {o.speed:g} rad/s with a lag of {1e3 * float(o.start['motor.T']):g} ms"
        events = [
            event
            for force, event, _ in iron.LETS_GO.values()
            if motions.turn[force][0, j].min() < 0.0
        ]
        if why:
            others.append(f"no steady motion {where}: {why}")
        elif events:
            others.append(
                f"in the steady motion {where} {listed(events)}: the orders are not valid for a real drive"
            )
    for warning in others:
        log.warning(warning)
    return motions


def table_of_orders(machine: MeasuredDrive, motions: Motions) -> Table:
    """Return the orders of motions, those of each in sequence; nan where there is none."""

    def of(name: str, what: str = "value") -> Array:
        return np.stack([getattr(motions.columns[f"{name}_{k}"], what) for k in ORDERS], axis=1)

    T, nu = (np.array(x) for x in zip(*((o.start["motor.T"], o.speed) for o in motions.asked)))
    tau = np.array([machine.excitation(x) for x in nu])
    torque, phase, excited = of("torque"), of("torque_phase"), np.abs(tau)
    most = np.array([machine.largest_torque(x).value for x in nu])[:, None]
    columns = {
        "T": T[:, None], "nu": nu[:, None], "order": np.array(ORDERS), "torque": torque, "torque_phase": phase,
        "speed": of("speed"), "excitation": excited, "lag": (np.angle(tau, deg=True) - phase) % 360.0,
        "gain": torque / excited, "torque_error": of("torque", "error"), "added": 100 * (torque - excited) / most,
    }  # fmt: skip
    return Table(
        {name: np.broadcast_to(x, torque.shape).ravel() for name, x in columns.items()},
        UNITS_OF_ORDERS,
    )


def figures(machine: MeasuredDrive, orders: Frame, lags: Sequence[int]) -> dict[str, Figure]:
    """Inertia, slope and limit of the mechanism; of each lag [ms] the formula, and where it adds most."""
    theta, B = machine.theta, machine.i_g**2 * machine.slope
    result = {
        "theta": theta,
        "slope": Figure(B, "N.m.s/rad", 0.0, "slope of the motor line there"),
        **{n: x for n, x in iron.limits(machine.drive).items() if n.startswith("follower")},
    }
    share = "most that the lag adds to an order, over the largest torque"
    for lag in lags:
        T = lag / 1e3
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
        added = orders[orders["T"] == T].dropna(subset="added")["added"]
        if (added > 0.0).any():
            of_lag |= where_it_adds_most(machine, orders.loc[added.idxmax()], share)
        else:
            why = NO_ORDER if len(added) else "there is no steady motion"
            of_lag["added"] = Figure.undetermined("%", f"{why} at any speed of the sweep", share)
        for name, x in of_lag.items():
            result[f"{name}_{lag}ms"] = x._replace(meaning=f"{x.meaning}, lag {lag} ms")
    return result


def where_it_adds_most(machine: MeasuredDrive, at: Any, share: str) -> dict[str, Figure]:
    """What a lag adds to the order of a row, and its gain there."""
    torque = orbit_figure(at["torque"], at["torque_error"], "N.m", "", "")
    both = torque, machine.excitation_of(at["nu"], int(at["order"]))
    return {
        "added": figure_of_figures(
            lambda x, excited, most: 100 * (x - excited) / most,
            *both,
            machine.largest_torque(at["nu"]),
            unit="%",
            meaning=share,
        ),
        "gain": figure_of_figures(
            lambda x, excited: x / excited,
            *both,
            unit="1",
            meaning=f"gain of order {at['order']:g} there",
        ),
        "worst_speed": Figure(float(at["nu"]), "rad/s", 0.0, "speed of the sweep there"),
    }
