"""How does the motor's lag change the ripple of the iron drive, and is a resonance of importance?

At each speed the steady motion is resolved into orders 1..12 of the cam angle. Formula
nu_k = sqrt(B_eff / (theta T)) / k says where order k of the torque lags its excitation by 90
degrees; theta and the excitation come from turns at constant speed.
"""

from __future__ import annotations

import csv
import math
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import cosim
from cosim.result import partial, write_json

from . import fmus, iron, iron_plots, options, pool
from .orders import harmonics, last_revolutions

ORDERS = range(1, 13)
LAGS = (0.012, 0.08, 0.2)
SPEEDS = "2:7.5:23"
SETTLE, EVALUATE, PER_REV = 3, 2, 1440
RECORD = ("motor.tau", "iron.phi", "iron.w_cam")
SHARE = 0.1
COLUMNS = ("T", "nu", "order", "torque", "torque_phase", "speed", "excitation", "lag", "gain")

Amplitudes = NDArray[np.complex128]


class Machine(NamedTuple):
    """The mechanism at the cam's shaft: gear ratio, mean inertia, friction work per turn, torque.

    The excitation of the orders 1..12 at constant speed nu is `still` + `moving` nu^2.
    """

    i_g: float
    theta: float
    work: float
    still: Amplitudes
    moving: Amplitudes
    peak: tuple[iron.Samples, iron.Samples]

    @property
    def B(self) -> float:
        """Slope of the motor line at the cam's shaft [N.m.s/rad]; the iron's friction adds none."""
        return self.i_g**2 * iron.MOTOR["motor.B"]

    def w_n(self, T: float) -> float:
        """sqrt(B_eff / (theta T)): order k meets it at the speed w_n / k [rad/s]."""
        return math.sqrt(self.B / (self.theta * T))

    def zeta(self, T: float) -> float:
        """Damping ratio of the ripple."""
        return math.sqrt(self.theta / (self.B * T)) / 2

    def excitation(self, nu: float) -> Amplitudes:
        """Torque of the orders 1..12 at constant speed [N.m]."""
        return self.still + self.moving * nu**2

    def largest(self, nu: float) -> float:
        """Largest torque of the turn at constant speed [N.m]."""
        return float(np.abs(self.peak[0] + self.peak[1] * nu**2).max())


class Case(NamedTuple):
    """Motor lag T [s], mean speed nu of the cam [rad/s], the machine, start values of the drive."""

    T: float
    nu: float
    machine: Machine
    start: iron.Start


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


def measure(start: iron.Start) -> Machine:
    """The mechanism from two turns at constant speed."""
    record = iron.names(("phi", "w_cam", "tau_cam", "E_kin", "E_friction"))
    one, two = (iron.turn(speed, start, PER_REV, record) for speed in (1.0, 2.0))
    parameters = one.provenance["parts"]["iron"]["parameters"]
    i_g = float(parameters["reducer.i_g"])
    rotor = float(start.get("iron.reducer.J", 3e-4))
    moving = (two["iron.tau_cam"] - one["iron.tau_cam"]) / 3
    still = one["iron.tau_cam"] - moving
    phi = one["iron.phi"]
    whole = 2 * one["iron.E_kin"] / one["iron.w_cam"] ** 2
    inertia = (whole - (iron.FLYWHEEL - rotor) * i_g**2)[:-1].mean()
    return Machine(
        i_g=i_g,
        theta=float(inertia),
        work=float(one["iron.E_friction"][-1]),
        still=harmonics(phi[:-1], still[:-1], ORDERS[-1]),
        moving=harmonics(phi[:-1], moving[:-1], ORDERS[-1]),
        peak=(still, moving),
    )


def simulate(case: Case) -> Spectrum:
    """Steady motion at one mean speed, in orders."""
    T, nu, machine, start = case
    mean = machine.work / (2 * math.pi * machine.i_g)
    B = iron.MOTOR["motor.B"]
    motor: iron.Start = {
        "motor.A": B * machine.i_g * nu + mean,
        "motor.B": B,
        "motor.T": T,
        "motor.tau": mean,
    }
    h = 2 * math.pi / (nu * PER_REV)
    steps = (SETTLE + EVALUATE) * PER_REV
    warn: iron.Start = {"iron.w_cam": nu, "iron.on_invalid": 1}
    system = iron.driven(motor, warn | start)
    result = cosim.run(system, stop=steps * h, step=h, record=RECORD)
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


def verdict(machine: Machine, T: float, spectra: Sequence[Spectrum]) -> str:
    """What one motor does, in plain words."""
    nus = [s.nu for s in spectra]
    met = meetings(machine, T, nus)
    orders = ", ".join(f"{k} at {nu:.2f}" for k, nu in met.items()) or "none"
    lines = []
    lines.append(
        f"T = {1e3 * T:g} ms: w_n = {machine.w_n(T):.2f} rad/s, damping ratio {machine.zeta(T):.2f}; "
        f"orders that meet it inside the sweep: {orders} rad/s."
    )
    worst, added, gain = 0, 0.0, 0.0
    place = spectra[0]
    for spectrum in spectra:
        more = (np.abs(spectrum.torque) - np.abs(spectrum.excitation)) / machine.largest(
            spectrum.nu
        )
        if more.max() > added:
            worst, added, place = int(more.argmax()) + 1, float(more.max()), spectrum
            gain = abs(spectrum.torque[worst - 1]) / abs(spectrum.excitation[worst - 1])
    word = "of practical importance" if added > SHARE else "of no practical importance"
    lines.append(
        f"  Resonance is {word}: the lag adds at most {added:.1%} of the largest torque, "
        f"order {worst} at {place.nu:.2f} rad/s with a gain of {gain:.2f}."
    )
    return "\n".join(lines)


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    add = parser.add_argument
    add("--speeds", default=SPEEDS, help="from:to:number or a,b,c of the cam [rad/s]")
    add("--jobs", type=int, default=pool.available_cores(), help="parallel processes")
    add("--out", type=Path, default=SUPPRESS, help="folder, results/iron_orders by default")
    iron.add_start(parser)


def run(
    speeds: str = SPEEDS,
    jobs: int = 1,
    start: Sequence[str] = (),
    out: Path = Path("results/iron_orders"),
) -> None:
    """Sweep three motors, write orders.csv, .json and .png, print the verdicts."""
    nus = options.numbers("speeds", speeds)
    for nu in nus:
        options.positive("speed", nu, "rad/s")
    options.at_least("jobs", jobs, 1)
    changes = iron.start_values(start)
    fmus.build("drive_motor", "iron_drive")
    machine = measure(changes)
    limit, _ = iron.speed_limits(changes)["N"]
    cases = [Case(T, nu, machine, changes) for T in LAGS for nu in nus]
    out.mkdir(parents=True, exist_ok=True)
    table = out / "orders.csv"
    spectra: list[Spectrum] = []
    with partial(table).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for spectrum in pool.each(simulate, cases, jobs, "sweep"):
            writer.writerows(spectrum.rows())
            file.flush()
            spectra.append(spectrum)
    iron_plots.orders(out / "orders.png", machine, spectra, limit)
    write_json(
        out / "orders.json",
        {
            "theta": machine.theta,
            "B_eff": machine.B,
            "w_n": {str(T): machine.w_n(T) for T in LAGS},
            "meetings": {str(T): meetings(machine, T, nus) for T in LAGS},
            "follower_lifts": limit,
            "steps_per_rev": PER_REV,
            "flavour": fmus.flavour(),
            "versions": cosim.versions(),
        },
    )
    partial(table).replace(table)
    for T in LAGS:
        print(verdict(machine, T, [s for s in spectra if s.T == T]))
    print(f"The follower lifts off at {limit:.3f} rad/s; speeds beyond are not reached.")
    print(f"{table}, orders.json and orders.png written")
