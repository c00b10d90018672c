"""A drive that was fitted to a record: its resonance, and its torque ripple on steady orbits with the interval of the fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

from cosim import Identified, SetupError
from workbench import Context, Figure
from workbench.fit import figure_of

from .first_order import FIELDS, Machine
from .options import RippleOptions
from .orbit import Drive, DriveOrbit

DRIVE_QUANTITIES = {
    "nu_res": ("rad/s", "resonance by formula (22) of the fitted machine"),
    "away": ("%", "operating speed above the resonance"),
    "tau2": ("N.m", "torque ripple at the operating speed"),
}
#: Communication steps per revolution of the orbits of the fitted drive; a convention.
STEPS = 512


class IdentifiedDrive(NamedTuple):
    """A fit, the machine of its values, and the operating speed [rad/s]."""

    fit: Identified
    machine: Callable[[Mapping[str, float]], Machine]
    operating: float

    @property
    def best(self) -> Machine:
        """The machine found."""
        return self.machine(self.fit.start_values)

    def orbit(self, o: RippleOptions, context: Context) -> DriveOrbit:
        """Return the question how the machine found turns at the operating speed."""
        drive = Drive(context, o.algorithm, STEPS)
        orbit = DriveOrbit.of(self.best, self.operating, drive)
        return replace(orbit, set=o.set, limit=o.limit, rated_torque=o.rated_torque_or_default)

    def torque_ripple(self, o: DriveOrbit, figures: Mapping[str, Figure]) -> Figure:
        """Return the torque ripple of its orbit, or of one that differs in values or speed, with the interval of the fit."""
        tau2, best = figures["tau2"], self.best
        if tau2.error is None:
            return tau2
        set_values = {
            x: y for x in FIELDS.values() if (y := getattr(o.given, x)) != getattr(best, x)
        }
        wide = self.fit.interval(
            lambda v: float(abs(replace(self.machine(v), **set_values).torque_ripple(o.nu)))
        )
        return tau2._replace(error=tau2.error + wide.error)


def figures(o: RippleOptions, context: Context, drive: IdentifiedDrive) -> dict[str, Figure]:
    """The resonance, how far the operating speed is from it, and the torque ripple there."""
    fit, nu = drive.fit, drive.operating
    orbit = drive.orbit(o, context)
    try:
        tau2 = drive.torque_ripple(orbit, orbit.solve(context).figures)
    except SetupError as error:
        tau2 = Figure.undetermined("N.m", str(error))
    return {
        "nu_res": figure_of(fit.derived["nu_res"]),
        "away": figure_of(
            fit.interval(lambda v: 100.0 * (nu / drive.machine(v).nu_res - 1.0), "%")
        ),
        "tau2": tau2,
    }
