"""How does the motor's lag change the ripple of the iron drive, and is a resonance of importance?

At each speed the steady motion is resolved into orders 1..12 of the cam angle. Formula
nu_k = sqrt(B_eff / (theta T)) / k says where order k of the torque lags its excitation by 90
degrees; theta and the excitation come from turns at constant speed.
"""

from __future__ import annotations

import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim import System

from . import fmus, iron, iron_plots, iron_show, options, pool
from .answer import Answer, Figure, Show, Table, finish, parameters, question, stream
from .orders import harmonics, last_revolutions
from .page.motion import Motion

PARTS = iron.PARTS
ORDERS = range(1, 13)
LAGS = (0.012, 0.08, 0.2)
SPEEDS = "2:7.5:23"
SETTLE, EVALUATE, PER_REV = 3, 2, 1440
RECORD = ("motor.tau", "iron.phi", "iron.w_cam")
SHARE = 0.1
ALGORITHM = "strang"
TABLE = "orders.csv"
TOLD = ("motor.B", "iron.reducer.i_g", "iron.reducer.J")
COLUMNS = ("T", "nu", "order", "torque", "torque_phase", "speed", "excitation", "lag", "gain")

UNITS = {
    "T": "s", "nu": "rad/s", "order": "1", "torque": "N.m", "torque_phase": "deg",
    "speed": "rad/s", "excitation": "N.m", "lag": "deg", "gain": "1",
}  # fmt: skip

Amplitudes = NDArray[np.complex128]


class Machine(NamedTuple):
    """Slope of the motor; the mechanism at the cam's shaft: gear ratio, mean inertia, friction work
    per turn, torque.

    The excitation of the orders 1..12 at constant speed nu is `still` + `moving` nu^2.
    """

    slope: float
    i_g: float
    theta: float
    work: float
    still: Amplitudes
    moving: Amplitudes
    peak: tuple[iron.Samples, iron.Samples]

    @property
    def B(self) -> float:
        """Slope of the motor line at the cam's shaft [N.m.s/rad]; the iron's friction adds none."""
        return self.i_g**2 * self.slope

    def w_n(self, T: float) -> float:
        """sqrt(B_eff / (theta T)): order k meets it at the speed w_n / k [rad/s]."""
        return math.sqrt(self.B / (self.theta * T))

    def zeta(self, T: float) -> float:
        """Damping ratio of the ripple."""
        return math.sqrt(self.theta / (self.B * T)) / 2

    def gain(self, w: float, T: float) -> complex:
        """Torque over excitation of a ripple of frequency w [rad/s], the inertia at its mean."""
        return self.B / complex(self.B - self.theta * T * w**2, self.theta * w)

    def excitation(self, nu: float) -> Amplitudes:
        """Torque of the orders 1..12 at constant speed [N.m]."""
        return self.still + self.moving * nu**2

    def largest(self, nu: float) -> float:
        """Largest torque of the turn at constant speed [N.m]."""
        return float(np.abs(self.peak[0] + self.peak[1] * nu**2).max())


class Case(NamedTuple):
    """Motor lag T [s], mean speed nu of the cam [rad/s], the machine, start values of the drive,
    communication steps per revolution."""

    T: float
    nu: float
    machine: Machine
    start: options.Start
    per_rev: int = PER_REV


class Spectrum(NamedTuple):
    """Steady motion at one speed: orders 1..12 of the cam's speed and of the torque at its shaft."""

    T: float
    nu: float
    speed: Amplitudes
    torque: Amplitudes
    excitation: Amplitudes

    def rows(self) -> Iterator[tuple[float | int, ...]]:
        """One row of COLUMNS per order; phases and lags in degrees."""
        for k, M, w, tau in zip(ORDERS, self.torque, self.speed, self.excitation):
            lag = math.degrees(np.angle(tau / M)) % 360.0
            phase = math.degrees(np.angle(M))
            yield self.T, self.nu, k, abs(M), phase, abs(w), abs(tau), lag, abs(M) / abs(tau)


def measure(start: options.Start) -> Machine:
    """The mechanism from two turns at constant speed."""
    own = parameters(iron.driven(iron.MOTOR, start))
    slope, i_g, rotor = (float(own[name].value) for name in TOLD)
    record = iron.names(("phi", "w_cam", "tau_cam", "E_kin", "E_friction"))
    one, two = (iron.turn(speed, iron.own(start), PER_REV, record) for speed in (1.0, 2.0))
    moving = (two["iron.tau_cam"] - one["iron.tau_cam"]) / 3
    still = one["iron.tau_cam"] - moving
    phi = one["iron.phi"]
    whole = 2 * one["iron.E_kin"] / one["iron.w_cam"] ** 2
    inertia = (whole - (iron.FLYWHEEL - rotor) * i_g**2)[:-1].mean()
    return Machine(
        slope=slope,
        i_g=i_g,
        theta=float(inertia),
        work=float(one["iron.E_friction"][-1]),
        still=harmonics(phi[:-1], still[:-1], ORDERS[-1]),
        moving=harmonics(phi[:-1], moving[:-1], ORDERS[-1]),
        peak=(still, moving),
    )


def system(case: Case) -> System:
    """The motor of the case, set for the mean speed, on the iron drive."""
    T, nu, machine, start, _ = case
    mean = machine.work / (2 * math.pi * machine.i_g)
    motor: options.Start = {
        "motor.A": machine.slope * machine.i_g * nu + mean,
        "motor.B": machine.slope,
        "motor.T": T,
        "motor.tau": mean,
    }
    mechanism: options.Start = {"iron.w_cam": nu, "iron.on_invalid": 1}
    return iron.driven(motor, mechanism | start)


def simulate(case: Case) -> Spectrum:
    """Steady motion at one mean speed, in orders."""
    T, nu, machine, _, per_rev = case
    h = 2 * math.pi / (nu * per_rev)
    steps = (SETTLE + EVALUATE) * per_rev
    result = cosim.run(system(case), stop=steps * h, step=h, algorithm=ALGORITHM, record=RECORD)
    phi = result["iron.phi"]
    late = last_revolutions(phi, EVALUATE)
    torque, speed = (
        harmonics(phi[late], result[name][late], ORDERS[-1]) for name in ("motor.tau", "iron.w_cam")
    )
    return Spectrum(T, nu, speed, machine.i_g * torque, machine.excitation(nu))


def meetings(machine: Machine, T: float, nus: Sequence[float]) -> dict[int, float]:
    """The orders that meet the formula inside the sweep, and their speeds [rad/s]."""
    w_n = machine.w_n(T)
    return {k: w_n / k for k in ORDERS if nus[0] <= w_n / k <= nus[-1]}


class Worst(NamedTuple):
    """Where the lag adds most to an order: share of the largest torque, order, speed, gain."""

    share: float
    order: int
    nu: float
    gain: float


def worst(machine: Machine, spectra: Sequence[Spectrum]) -> Worst:
    """What the lag of one motor does at its worst."""
    found = Worst(0.0, 0, spectra[0].nu, 0.0)
    for spectrum in spectra:
        k = int((np.abs(spectrum.torque) - np.abs(spectrum.excitation)).argmax()) + 1
        share, gain = added(machine, spectrum, k)
        if share > found.share:
            found = Worst(share, k, spectrum.nu, gain)
    return found


def added(machine: Machine, spectrum: Spectrum, k: int) -> tuple[float, float]:
    """What the lag adds to order k as a share of the largest torque, and the gain of the order."""
    torque, excitation = abs(spectrum.torque[k - 1]), abs(spectrum.excitation[k - 1])
    share = (torque - excitation) / machine.largest(spectrum.nu)
    return float(share), float(torque / excitation)


def certified(
    machine: Machine, at: Worst, spectra: Sequence[Spectrum], coarser: Sequence[Spectrum]
) -> dict[str, Figure]:
    """Share and gain where the lag adds most, with coupling errors from runs with a half and a
    quarter of the steps."""
    T = spectra[0].T
    meanings = {
        "added": f"most that the lag adds, in largest torques, lag {1e3 * T:g} ms",
        "gain": f"gain of order {at.order} there, at {at.nu:.4g} rad/s of the cam",
    }
    if not coarser:
        values = zip(meanings.items(), (at.share, at.gain))
        return {name: Figure(x, "1", meaning=meaning) for (name, meaning), x in values}
    fine = next(s for s in spectra if s.nu == at.nu)
    runs = zip(*(added(machine, run, at.order) for run in (fine, *coarser)))
    order = cosim.ORDERS[ALGORITHM]
    return {
        name: Figure.of(cosim.estimate(x, order), "1", meaning)
        for (name, meaning), x in zip(meanings.items(), runs)
    }


def verdict(
    machine: Machine, T: float, nus: Sequence[float], at: Worst, found: Mapping[str, Figure]
) -> str:
    """What one motor does, in plain words."""
    met = meetings(machine, T, nus)
    orders = ", ".join(f"{k} at {nu:.2f} rad/s" for k, nu in met.items()) or "none"
    word = "of practical importance" if at.share > SHARE else "of no practical importance"
    return (
        f"T = {1e3 * T:g} ms: w_n = {machine.w_n(T):.2f} rad/s, damping ratio {machine.zeta(T):.2f}; "
        f"orders that meet it inside the sweep: {orders}.\n"
        f"  Resonance is {word}: the lag adds at most {at.share:.1%} of the largest torque, "
        f"order {at.order} at {at.nu:.2f} rad/s with a gain of {found['gain'].text()}."
    )


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--speeds", default=SPEEDS, help="from:to:number or a,b,c of the cam [rad/s]")
    add("--jobs", type=int, default=pool.available_cores(), help="parallel processes")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/iron_orders by default")
    options.add_start(parser, "iron.spring.side=-1")


def answer(
    speeds: str = SPEEDS,
    start: Sequence[str] = (),
    jobs: int = 1,
    out: Path | None = None,
) -> Answer:
    """Sweep three motors; rows are kept in `out` on the way."""
    nus = options.numbers("speeds", speeds)
    for nu in nus:
        options.positive("speed", nu, "rad/s")
    options.at_least("jobs", jobs, 1)
    changes = options.start_values(start, ("motor.A", "motor.T"))
    fmus.build(*PARTS.values())
    machine = measure(changes)
    limit, _ = iron.speed_limits(iron.own(changes))["N"]
    cases = [Case(T, nu, machine, changes) for T in LAGS for nu in nus]
    spectra: list[Spectrum] = []
    with stream(out and out / TABLE, COLUMNS) as keep:
        for spectrum in pool.each(simulate, cases, jobs, "sweep"):
            keep(spectrum.rows())
            spectra.append(spectrum)
    by_lag = {T: [s for s in spectra if s.T == T] for T in LAGS}
    at = {T: worst(machine, mine) for T, mine in by_lag.items()}
    again = [
        Case(T, at[T].nu, machine, changes, PER_REV // n)
        for T in LAGS
        for n in (2, 4)
        if at[T].order
    ]
    coarser = list(pool.each(simulate, again, jobs, "coupling errors"))
    found = {
        T: certified(machine, at[T], mine, [s for s in coarser if s.T == T])
        for T, mine in by_lag.items()
    }
    told = [verdict(machine, T, nus, at[T], found[T]) for T in LAGS]
    told.append(f"The follower lifts off at {limit:.3f} rad/s; speeds beyond are not reached.")
    rows = [row for s in spectra for row in s.rows()]
    return Answer(
        scenario="iron_orders",
        question=question(__doc__),
        verdict="\n".join(told),
        figures=figures(machine, found, limit),
        parameters=parameters(system(cases[0])),
        tables={TABLE: Table.of_rows(rows, UNITS)},
        provenance=fmus.provenance(system(cases[0]), ALGORITHM, f"{PER_REV} steps per revolution"),
        stem="orders",
        facts={
            "theta": machine.theta,
            "B_eff": machine.B,
            "w_n": {str(T): machine.w_n(T) for T in LAGS},
            "meetings": {str(T): meetings(machine, T, nus) for T in LAGS},
            "follower_lifts": limit,
            "steps_per_rev": PER_REV,
        },
        files={"orders.png": lambda path: iron_plots.orders(path, machine, spectra, limit)},
        show=lambda: Show(
            iron_show.orders(machine, by_lag), [turning(nus[len(nus) // 2], changes)]
        ),
    )


def turning(nu: float, start: options.Start) -> Motion:
    """A turn of the mechanism at constant speed [rad/s]."""
    turn = iron.turn(nu, iron.own(start), 360, iron.names(iron_show.SEEN))
    title, last = f"The mechanism at {nu:g} rad/s", float(turn["time"][-1])
    return iron_show.motion(turn, iron.own(start), title, 0.0, last, 4.0)


def figures(
    machine: Machine, found: Mapping[float, Mapping[str, Figure]], limit: float
) -> dict[str, Figure]:
    """Inertia, slope and limit of the mechanism alone; for each lag the formula and its effect."""
    told = {
        "theta": Figure(machine.theta, "kg.m2", 0.0, meaning="mean inertia at the cam's shaft"),
        "slope": Figure(machine.B, "N.m.s/rad", 0.0, meaning="slope of the motor line there"),
        "follower_limit": Figure(
            limit, "rad/s", 0.0, meaning="cam speed where the follower lifts off"
        ),
    }
    for T, effect in found.items():
        lag = f"{1e3 * T:g}ms"
        formula = f"frequency where an order lags 90 deg, by formula, lag {1e3 * T:g} ms"
        damping = f"damping ratio of the ripple, lag {1e3 * T:g} ms"
        told |= {
            f"w_n_{lag}": Figure(machine.w_n(T), "rad/s", 0.0, meaning=formula),
            f"zeta_{lag}": Figure(machine.zeta(T), "1", 0.0, meaning=damping),
            **{f"{name}_{lag}": figure for name, figure in effect.items()},
        }
    return told


def run(out: Path = Path("results/iron_orders"), **settings: Any) -> None:
    """Write the answer and print the verdict."""
    finish(answer(out=out, **settings), out)
