"""How does the motor's lag change the ripple of the iron drive, and is a resonance of importance?

At each speed the steady motion is resolved into orders 1..12 of the cam angle. Formula
nu_k = sqrt(B_eff / (theta T)) / k says where order k of the torque lags its excitation by 90
degrees; theta and the excitation come from turns at constant speed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
import workbench
from cosim import System
from workbench import Bench, Figure, Findings, Show, Table, option
from workbench.answer import parameters, stream
from workbench.limit import coupling
from workbench.measure import Measured, harmonics
from workbench.options import Start
from workbench.orbit import NotSteady, steady

from . import drive as iron
from . import show as pictures

PARTS = iron.PARTS
OWN = ("motor.A", "motor.T")
ORDERS = range(1, 13)
HIGHEST = 60
LAGS = (0.012, 0.08, 0.2)
PER_REV = 1440
RECORD = ("motor.tau", "iron.phi", "iron.w_cam")
SHARE = 0.1
ALGORITHM = "strang"
TABLE = "iron_orders.csv"
UNITS = {
    "T": "s", "nu": "rad/s", "order": "1", "torque": "N.m", "torque_phase": "deg",
    "speed": "rad/s", "excitation": "N.m", "lag": "deg", "gain": "1",
}  # fmt: skip

Amplitudes = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    speeds: tuple[float, ...] = option("2:7.5:23", "mean speeds of the cam", "rad/s", above=0.0)


class Machine(NamedTuple):
    """Slope of the motor; the mechanism at the cam's shaft: gear ratio, mean inertia and what the
    rows of the turn leave open of it, friction work per turn, torque.

    The excitation of the orders 1..12 at constant speed nu is `still` + `moving` nu^2.
    """

    slope: float
    i_g: float
    theta: float
    theta_error: float
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
    """FMUs, motor lag T [s], mean speed nu of the cam [rad/s], the machine, start values of the
    drive, communication steps per revolution."""

    fmus: Mapping[str, Path]
    T: float
    nu: float
    machine: Machine
    start: Mapping[str, cosim.system.Value]
    per_rev: int = PER_REV


class Spectrum(NamedTuple):
    """Steady motion at one speed: orders 1..12 of the cam's speed and of the torque at its shaft,
    with what settling leaves of the torque; nan where `problem` says that there is none.
    """

    T: float
    nu: float
    speed: Amplitudes
    torque: Amplitudes
    excitation: Amplitudes
    settling: NDArray[np.float64]
    problem: str = ""

    def rows(self) -> Iterator[tuple[float | int, ...]]:
        """One row of the table per order; phases and lags in degrees."""
        for k, M, w, tau in zip(ORDERS, self.torque, self.speed, self.excitation):
            lag = math.degrees(np.angle(tau / M)) % 360.0
            phase = math.degrees(np.angle(M))
            yield self.T, self.nu, k, abs(M), phase, abs(w), abs(tau), lag, abs(M) / abs(tau)


class Worst(NamedTuple):
    """Where the lag adds most to an order: share of the largest torque, order, speed, gain."""

    share: float
    order: int
    nu: float
    gain: float


class Sweep(NamedTuple):
    """The machine, the iron drive by itself, the spectra by lag, and where each lag adds most."""

    machine: Machine
    alone: iron.Alone
    by_lag: Mapping[float, Sequence[Spectrum]]
    worst: Mapping[float, Worst]


def solve(o: Options, bench: Bench) -> Findings:
    """Sweep three motors; where the lag adds most, again with coarser steps."""
    alone = iron.own(bench.fmus, o.start)
    machine = measure(bench.fmus, o.start, alone)
    limit = iron.speed_limits(alone)["N"]
    cases = [Case(bench.fmus, T, nu, machine, o.start) for T in LAGS for nu in o.speeds]
    spectra: list[Spectrum] = []
    with stream(bench.out and bench.out / TABLE, list(UNITS)) as keep:
        for spectrum in bench.each(simulate, cases, "sweep"):
            keep(spectrum.rows())
            spectra.append(spectrum)
    by_lag = {T: [s for s in spectra if s.T == T] for T in LAGS}
    at = {T: worst(machine, mine) for T, mine in by_lag.items()}
    again = [
        case._replace(per_rev=PER_REV // n)
        for case in cases
        for n in (2, 4)
        if case.nu == at[case.T].nu and at[case.T].order
    ]
    coarser = list(bench.each(simulate, again, "coupling errors"))
    found = mechanism(machine, limit)
    for T, mine in by_lag.items():
        found |= effect(machine, at[T], mine, [s for s in coarser if s.T == T])
    rows = [row for s in spectra for row in s.rows()]
    return Findings(
        found,
        Sweep(machine, alone, by_lag, at),
        system(cases[0]),
        communication=f"{PER_REV} steps per revolution",
        algorithm=ALGORITHM,
        tables={TABLE: Table.of_rows(rows, UNITS)},
    )


def measure(
    fmus: Mapping[str, Path], start: Mapping[str, cosim.system.Value], alone: iron.Alone
) -> Machine:
    """The mechanism from two turns at constant speed."""
    told = parameters(iron.driven(fmus, iron.MOTOR, start))
    slope, i_g, rotor = (
        float(told[name].value) for name in ("motor.B", "iron.reducer.i_g", "iron.reducer.J")
    )
    record = iron.names(("phi", "w_cam", "tau_cam", "E_kin", "E_friction"))
    one, two = (iron.turn(speed, alone, PER_REV, record) for speed in (1.0, 2.0))
    moving = (two["iron.tau_cam"] - one["iron.tau_cam"]) / 3
    still = one["iron.tau_cam"] - moving
    whole = 2 * one["iron.E_kin"] / one["iron.w_cam"] ** 2
    inertia = once(whole - (iron.FLYWHEEL - rotor) * i_g**2)
    theta = mean(inertia)
    phi = once(one["iron.phi"])
    return Machine(
        slope=slope,
        i_g=i_g,
        theta=theta.value,
        theta_error=theta.error,
        work=float(one["iron.E_friction"][-1]),
        still=harmonics(phi, once(still), ORDERS[-1]),
        moving=harmonics(phi, once(moving), ORDERS[-1]),
        peak=(still, moving),
    )


def once(turn: iron.Samples) -> iron.Samples:
    """The rows of a turn without the last, which is the first again."""
    return turn[:-1]


def mean(x: iron.Samples) -> Measured:
    """Of a turn's rows, each once; every second row of either half says what they leave open."""
    value, halves = float(x.mean()), [float(x[first::2].mean()) for first in (0, 1)]
    return Measured(value, max(abs(value - half) for half in halves))


def system(case: Case) -> System:
    """The motor of the case, set for the mean speed, on the iron drive."""
    fmus, T, nu, machine, start, _ = case
    mean = machine.work / (2 * math.pi * machine.i_g)
    motor: Start = {
        "motor.A": machine.slope * machine.i_g * nu + mean,
        "motor.B": machine.slope,
        "motor.T": T,
        "motor.tau": mean,
    }
    return iron.driven(fmus, motor, {"iron.w_cam": nu, "iron.on_invalid": 1, **start})


def simulate(case: Case) -> Spectrum:
    """Steady motion at one mean speed, in orders."""
    _, T, nu, machine, _, per_rev = case
    whole = system(case)

    def at(states: Mapping[str, float]) -> System:
        return replace(whole, start={**whole.start, **states, "iron.phi": 0.0})

    states = {name: float(whole.start[name]) for name in ("iron.w_cam", "motor.tau")}
    excitation = machine.excitation(nu)
    try:
        turns = steady(at, states, "iron.phi", nu, per_rev, RECORD, ALGORITHM)
    except NotSteady as problem:
        none = np.full(len(ORDERS), complex(math.nan, math.nan))
        return Spectrum(T, nu, none, none, excitation, none.real, str(problem))

    def amplitudes(column: str, back: int = 0) -> Amplitudes:
        rows = turns.window(back)
        return harmonics(turns.result["iron.phi"][rows], turns.result[column][rows], HIGHEST)[:12]

    torque, before = (machine.i_g * amplitudes("motor.tau", back) for back in (0, 1))
    settling = np.array([turns.remains(x) for x in np.abs(torque - before)])
    return Spectrum(T, nu, amplitudes("iron.w_cam"), torque, excitation, settling)


def worst(machine: Machine, spectra: Sequence[Spectrum]) -> Worst:
    """What the lag of one motor does at its worst."""
    found = Worst(0.0, 0, spectra[0].nu, 0.0)
    for spectrum in spectra:
        if spectrum.problem:
            continue
        k = int((np.abs(spectrum.torque) - np.abs(spectrum.excitation)).argmax()) + 1
        share, gain = added(machine, spectrum, k)
        if share > found.share:
            found = Worst(share, k, spectrum.nu, gain)
    return found


def added(machine: Machine, spectrum: Spectrum, k: int) -> tuple[float, float]:
    """What the lag adds to order k as a share of the largest torque [%], and the gain of the order."""
    torque, excitation = abs(spectrum.torque[k - 1]), abs(spectrum.excitation[k - 1])
    share = 100 * (torque - excitation) / machine.largest(spectrum.nu)
    return float(share), float(torque / excitation)


def effect(
    machine: Machine, at: Worst, spectra: Sequence[Spectrum], coarser: Sequence[Spectrum]
) -> dict[str, Figure]:
    """What the lag of one motor does: the formula, and share and gain where it adds most.

    Their errors are those of the coupling, from runs with a half and a quarter of the steps, and
    what settling leaves.
    """
    T = spectra[0].T
    lag, tail = f"lag {1e3 * T:g} ms", f"{1e3 * T:g}ms"
    off = machine.theta_error / (2 * machine.theta)
    w_n, zeta = machine.w_n(T), machine.zeta(T)
    formula = f"frequency where an order lags 90 deg, by formula, {lag}"
    found = {
        f"w_n_{tail}": Figure(w_n, "rad/s", w_n * off, formula),
        f"zeta_{tail}": Figure(zeta, "1", zeta * off, f"damping ratio of the ripple, {lag}"),
    }
    for k in ORDERS:
        if spectra[0].nu <= w_n / k <= spectra[-1].nu:
            what = f"speed where order {k} meets it, by formula, {lag}"
            found[f"meets_{k}_{tail}"] = Figure(w_n / k, "rad/s", w_n / k * off, what)
    meanings = {
        f"added_{tail}": ("%", f"most that the lag adds, in largest torques, {lag}"),
        f"gain_{tail}": ("1", f"gain of order {at.order} there, {lag}"),
    }
    if not at.order:
        none = "the lag adds to no order at any speed of the sweep"
        return found | {
            name: Figure.refused(unit, none, meaning) for name, (unit, meaning) in meanings.items()
        }
    fine = next(s for s in spectra if s.nu == at.nu)
    tell = partial(added, machine, k=at.order)
    runs = zip(*(tell(spectrum) for spectrum in (fine, *coarser)))
    left = fine.settling[at.order - 1]
    scales = (100 / machine.largest(fine.nu), 1 / abs(fine.excitation[at.order - 1]))
    for (name, (unit, meaning)), values, scale in zip(meanings.items(), runs, scales):
        error = coupling(values, cosim.ORDERS[ALGORITHM]) + 2 * scale * float(left)
        found[name] = Figure(values[0], unit, error, meaning)
    return found | {
        f"worst_speed_{tail}": Figure(at.nu, "rad/s", 0.0, f"speed of the sweep there, {lag}")
    }


def mechanism(machine: Machine, limit: iron.Limit) -> dict[str, Figure]:
    """Inertia, slope and limit of the mechanism alone."""
    inertia, slope = "mean inertia at the cam's shaft", "slope of the motor line there"
    return {
        "theta": Figure(machine.theta, "kg.m2", machine.theta_error, inertia),
        "slope": Figure(machine.B, "N.m.s/rad", 0.0, slope),
        **limit.figures("follower_limit", "the follower lifts off"),
    }


def verdict(o: Options, f: Mapping[str, Figure], r: Sweep) -> str:
    """For which motors a resonance matters, and what the lag of each does."""
    matter = [T for T in LAGS if r.worst[T].share > SHARE * 100]
    names = " and ".join(f"{1e3 * T:g} ms" for T in matter)
    answer = f"with a lag of {names}" if matter else "with none of the motors"
    lines = [
        f"A resonance is of practical importance {answer}: there the lag adds more than "
        f"{SHARE:.0%} of the largest torque. The follower lifts off at "
        f"{f['follower_limit'].text()}; speeds beyond are not reached."
        if matter
        else f"A resonance is of practical importance {answer}. The follower lifts off at "
        f"{f['follower_limit'].text()}."
    ]
    for T, at in r.worst.items():
        tail = f"{1e3 * T:g}ms"
        met = ", ".join(
            f"{k} at {f[f'meets_{k}_{tail}'].text()}" for k in ORDERS if f"meets_{k}_{tail}" in f
        )
        word = "of practical" if T in matter else "of no practical"
        lines.append(
            f"A lag of {1e3 * T:g} ms is {word} importance: it adds at most "
            f"{f[f'added_{tail}'].text()} of the largest torque, to order {at.order} at "
            f"{at.nu:.4g} rad/s, whose gain is {f[f'gain_{tail}'].text()}."
            if at.order
            else f"A lag of {1e3 * T:g} ms adds to no order."
        )
        lines.append(
            f"By formula an order lags 90 degrees at {f[f'w_n_{tail}'].text()}, damping ratio "
            f"{f[f'zeta_{tail}'].text()}; orders that meet it in the sweep: {met or 'none'}."
        )
    return "\n".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: Sweep) -> Show:
    """Gains and torques of the orders, and a turn of the mechanism."""
    nu = o.speeds[len(o.speeds) // 2]
    turn = iron.turn(nu, r.alone, 360, iron.names(pictures.SEEN))
    title, last = f"The mechanism at {nu:g} rad/s", float(turn["time"][-1])
    moving = pictures.motion(turn, r.alone, title, 0.0, last, 4.0)
    return Show(pictures.orders(r.machine, r.by_lag, f["follower_limit"].value), [moving])
