"""First-order theory of any mechanism: closed coefficients, a derivation, exact orbits and FMUs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import System
from scenarios.conveyor.first_order import (
    NODE_ANGLES,
    SETS,
    Machine,
    Mechanism,
    Position,
    acceleration,
    at_angles,
    crank,
)
from scenarios.conveyor.speed_sweep import SPEEDS
from tests.scenarios.orbit_oracle import Drive, orbit
from workbench.steady import steady_turns

LINK = 0.05


def slotted_link(r: float, l: float = math.inf) -> Position:
    """The trough's position with a crank pin at r and a link that swings about a pivot at l [m]."""
    return lambda phi: np.asarray(r * np.sin(phi) / (1 + r / l * np.cos(phi)))


class Link(Drive):
    """An exact drive whose trough a swinging link moves, its pivot at l: tan(psi) l, by hand."""

    @property
    def slope(self) -> float:
        return self.B + self.d * float(np.mean(self.trough(NODE_ANGLES)[1] ** 2))

    def trough(self, phi: Any) -> tuple[Any, Any, Any, Any]:
        q, s, c = self.r / self.l, np.sin(phi), np.cos(phi)
        below = 1 + q * c
        bend = s * (2 * q * q - 1 + q * c) / below**3
        return self.r * s / below, self.r * (c + q) / below**2, self.r * bend, np.ones_like(s)


def speeds(name: str) -> list[float]:
    """Those of the sweep of a set."""
    return [float(nu) for nu in SPEEDS[name].split(",")]


def exact(drive: Drive, nu: float) -> tuple[Any, Any]:
    """Amplitudes of the orders 1, 2, .. of speed and torque on the periodic orbit."""
    solution = orbit(drive, nu)
    return tuple(2j * np.fft.rfft(x, norm="forward")[1:7] for x in (solution.v, solution.M))


def weakened(machine: Machine, share: float) -> Machine:
    """The machine with all that swings, as a share, at the same mean inertia and slope."""
    m, d = share * machine.m, share * machine.d
    mean = machine.theta0 - m * machine.r**2 / 2
    rest = machine.slope - d * machine.r**2 / 2
    return replace(machine, B=rest, theta1=mean, m=m, c=share * machine.c, d=d)


def drive(machine: Machine, kind: type[Drive] = Drive, **more: Any) -> Drive:
    """The same machine in the independent theory of periodic orbits."""
    return kind(
        machine.B, machine.T, machine.theta1, machine.m, machine.r, machine.c, machine.d, **more
    )


@pytest.mark.parametrize("name", SETS)
def test_quadrature_of_the_crank_gives_its_closed_coefficients(name: str) -> None:
    """At every speed of the set, with all other orders zero; also as a link with a far pivot."""
    machine = SETS[name]
    for position in (crank(machine.r), slotted_link(machine.r)):
        any_ = Mechanism.of(machine, position)
        for nu in speeds(name):
            ripples = any_.ripples(nu)
            for ours, closed in zip(
                ripples,
                (machine.load_ripple(nu), machine.speed_ripple(nu), machine.torque_ripple(nu)),
            ):
                assert ours[1] == pytest.approx(closed, rel=1e-11)
                assert np.abs(np.delete(ours, 1)).max() < 1e-11 * abs(closed)


@pytest.mark.parametrize("name", SETS)
def test_ripples_of_a_link_are_those_of_exact_orbits_to_the_order_that_theory_neglects(
    name: str,
) -> None:
    """The error of every amplitude is of the second order of the swing, over the speeds of the set."""
    machine_set = SETS[name]
    for nu in speeds(name)[::6]:
        errors = []
        for share in (0.25, 0.125, 0.0625):
            machine = weakened(machine_set, share)
            ripples = Mechanism.of(machine, slotted_link(machine.r, LINK)).ripples(nu)
            orbit = exact(drive(machine, Link, l=LINK), nu)
            pairs = zip((ripples.speed, ripples.torque), orbit)
            errors.append([np.abs(ours[:4] - true[:4]).max() for ours, true in pairs])
        first, second, third = np.array(errors)
        assert np.log2(second / third) == pytest.approx([2.0, 2.0], abs=0.25)
        largest = np.abs(np.array(orbit)[:, :4]).max(axis=1)
        assert (third < 0.01 * largest).all()


def test_load_that_depends_on_the_acceleration_is_inertia() -> None:
    """Mass of the trough or of its load: the same ripples but for what (10) leaves out."""
    full_machine, nu = SETS["A"], 36.0
    position = slotted_link(full_machine.r, LINK)
    ripples = Mechanism.of(full_machine, position).ripples(nu)
    rest, path = Mechanism.of(replace(full_machine, m=120.0), position), at_angles(position)
    parted = replace(
        rest, load=lambda w, a: rest.load(w, a) + 80.0 * path[1] * acceleration(path, w, a)
    )
    shared = parted.ripples(nu)
    for ours, theirs in zip(shared, ripples):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-12)
    still = replace(parted, load=lambda w, a: parted.load(w, 0.0)).ripples(nu)
    assert abs(still.torque[1] / ripples.torque[1] - 1) > 0.01


@pytest.mark.parametrize("name", SETS)
def test_coupled_link_has_the_ripple_of_exact_orbits_and_that_of_theory(
    name: str, fmus: Path
) -> None:
    """The link swings and pulls a load by its acceleration; over the speeds of both sets."""
    machine, parts = SETS[name], ("DriveMotor", "SlottedLink")
    fmus_ = dict(zip(("motor", "conveyor"), (fmus / "native" / f"{part}.fmu" for part in parts)))
    wires = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    values = {"trough.m": 150.0, "load.m": 50.0, "link.l": LINK, "link.swings": True}
    link = Mechanism.of(machine, slotted_link(machine.r, LINK))
    for nu in speeds(name)[::4]:
        mean = float(np.mean(link.load(nu, 0.0)))
        start = machine.start(nu) | {f"conveyor.{key}": value for key, value in values.items()}
        start["motor.A"] = machine.B * nu + mean

        near = {"conveyor.w": np.array([nu]), "motor.tau": np.array([mean])}
        turns = steady_turns(
            System(fmus_, wires, start), near, list(near), "conveyor.phi", np.array([nu]),
            steps_per_rev=512, record=["conveyor.f_pin"],
        )  # fmt: skip
        simulated = 2j * np.fft.rfft(turns.of("motor.tau")[0, 1], norm="forward")[1:5]
        theory = link.ripples(nu).torque[:4]
        true = exact(drive(machine, Link, l=LINK), nu)[1][:4]
        largest = np.abs(true).max()
        assert np.abs(simulated - true).max() < 5e-4 * largest
        assert np.abs(simulated - theory).max() < 0.035 * largest
        assert np.abs(simulated[[0, 2]]).max() > 0.05 * largest
