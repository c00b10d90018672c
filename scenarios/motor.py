"""From the nameplate of an induction motor to the start values of a drive.

A motor with `2 p` poles on a supply of the frequency f turns at w_s = 2 pi f / p without load. Its torque over the slip
is that of Kloss, T = 2 T_b / (s / s_b + s_b / s); at the rated slip it is the rated torque, which gives the breakdown slip
s_b = s_N (k + sqrt(k^2 - 1)) for the ratio k of both torques. The flux of its rotor lags by T = 1 / (2 pi f s_b).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cosim import SetupError
from cosim.system import Value
from cosim.units import multiples, read_quantity

INERTIA = "conveyor.rotor.J"
FORM = '"5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, 3.43:1, 0.02 kg.m2"'
#: What a nameplate must have, by name: the unit that its number has here.
NEEDED = {"power": "W", "speed": "rad/s", "frequency": "Hz", "poles": "poles", "breakdown": ""}
#: And what it may have: the ratio of a gear, 1:1 without, and the inertia of the rotor.
MORE = {"ratio": ":1", "inertia": "kg.m2"}
#: Other units on nameplates: what has them, and the factor to the unit here.
OTHER_UNITS = {
    "pole pairs": ("poles", 2.0),
    "1/min": ("speed", math.pi / 30),
    "kgm2": ("inertia", 1.0),
}
#: Rated slips of induction motors from a few megawatts down to some tens of watts, and the largest ratio of torques; conventions
#: that are wider than what catalogues have.
SLIPS, LARGEST_BREAKDOWN = (0.001, 0.15), 6.0


class Nameplate(NamedTuple):
    """What a nameplate says, in SI units; `breakdown` is the breakdown torque over the rated torque."""

    power: float
    speed: float
    frequency: float
    poles: float
    breakdown: float
    ratio: float = 1.0
    inertia: float | None = None

    @property
    def no_load(self) -> float:
        """The synchronous speed of the motor [rad/s]."""
        return 4.0 * math.pi * self.frequency / self.poles

    @property
    def torque(self) -> float:
        """The rated torque of the motor [N.m]."""
        return self.power / self.speed

    @property
    def slip(self) -> float:
        """The slip at the rated speed."""
        return 1.0 - self.speed / self.no_load

    @property
    def breakdown_slip(self) -> float:
        """The slip at which Kloss's torque is largest."""
        k = self.breakdown
        return self.slip * (k + math.sqrt(k * k - 1.0))

    @property
    def lag(self) -> float:
        """The time constant of the rotor flux [s]."""
        return 1.0 / (2.0 * math.pi * self.frequency * self.breakdown_slip)


def read_nameplate(text: str) -> Nameplate:
    """Return what a nameplate says; raises SetupError for what it lacks, and for what contradicts itself."""
    values: dict[str, float] = {}
    for item in text.split(","):
        name, value = _item(item.strip(), text)
        if name in values:
            raise SetupError(f"nameplate {text!r}: {name} is given twice")
        values[name] = value
    lacking = [f"{name} [{unit or '1'}]" for name, unit in NEEDED.items() if name not in values]
    if lacking:
        raise SetupError(f"nameplate {text!r} lacks {', '.join(lacking)}: write it as {FORM}")
    plate = Nameplate(**values)
    if why := implausible(plate):
        raise SetupError(f"nameplate {text!r}: {why}")
    return plate


def implausible(plate: Nameplate) -> str:
    """Return why no induction motor has this nameplate; "" for one that may exist."""
    if not all(0.0 < given < math.inf for given in plate if given is not None):
        return "every number must be finite and above 0"
    if plate.poles % 2.0:
        return f"poles = {plate.poles:g} must be a whole even number, two for each pair"
    if not 1.0 < plate.breakdown <= LARGEST_BREAKDOWN:
        return (
            f"breakdown = {plate.breakdown:g} must be above 1 and at most {LARGEST_BREAKDOWN:g}, the breakdown over the "
            "rated torque"
        )
    speed, no_load = (x * 30 / math.pi for x in (plate.speed, plate.no_load))
    supply = f"the synchronous speed of {no_load:.6g} rpm that {plate.frequency:g} Hz and {plate.poles:g} poles give"
    if plate.slip <= 0.0:
        return f"speed = {speed:.6g} rpm must be below {supply}"
    least, most = SLIPS
    if not least <= plate.slip <= most:
        pairs = (
            math.ceil(plate.poles / (1.0 - plate.slip) / 2.0) - 1.0
        )  # the most with a slip above 0
        fits = least <= plate._replace(poles=2.0 * pairs).slip <= most
        question = f": {plate.poles:g} poles, or {pairs:g} pole pairs?"
        return (
            f"speed = {speed:.6g} rpm is a slip of {100 * plate.slip:.3g} % of {supply}, and no rated slip from "
            f"{100 * least:g} to {100 * most:g} %{question if fits else ''}"
        )
    if plate.breakdown_slip >= 1.0:
        return (
            f"breakdown = {plate.breakdown:g} with a rated slip of {100 * plate.slip:.3g} % gives a breakdown slip of "
            f"{plate.breakdown_slip:.3g}, which must be below 1"
        )
    return ""


def _item(item: str, text: str) -> tuple[str, float]:
    """The name and the value of an item of a nameplate."""
    first, _, unit = item.partition(" ")
    if unit in OTHER_UNITS and (quantity := read_quantity(first)):
        name, factor = OTHER_UNITS[unit]
        return name, quantity.number * factor
    number, colon, one = item.partition(":")
    quantity = read_quantity(number if colon and one.strip() == "1" else item)
    if quantity and colon:
        return "ratio", quantity.number
    if quantity and not quantity.unit:
        return "breakdown", quantity.number
    for name, unit in (NEEDED | MORE).items():
        scale = multiples(unit).get(quantity.unit) if quantity and unit else None
        if quantity and scale:
            return name, quantity.number * scale
    raise SetupError(f"nameplate {text!r}: {item!r} cannot be read: write it as {FORM}")


def nameplate(text: str, motor: str = "motor", inertia: str = INERTIA) -> dict[str, Value]:
    """Return start values of a DriveMotor, at the shaft behind its gear, from the nameplate of an induction motor.

    Torques grow by the ratio of the gear, speeds fall by it, and the inertia of the rotor grows by its square. A linear
    motor in its place has the slope of the characteristic without load.

    Parameters
    ----------
    text : str
        Power, speed and frequency with their units, the number of poles, the breakdown over the rated torque; and, if
        there are any, the ratio of a gear and the inertia of the rotor [kg.m2], in any sequence.
    motor : str
        The part of the motor in the system.
    inertia : str
        The start value that takes the inertia of the rotor.

    Raises
    ------
    SetupError
        For what lacks, cannot be read, or contradicts itself.

    Examples
    --------
    >>> start = nameplate("5.5 kW, 1440 rpm, 50 Hz, 4 poles, 2.8, 3.43:1, 0.02 kg.m2")
    >>> round(start["motor.kloss.tau_b"], 1), round(start["motor.T"], 4)
    (350.3, 0.0147)
    """
    plate = read_nameplate(text)
    tau_b, w_s = plate.breakdown * plate.torque * plate.ratio, plate.no_load / plate.ratio
    values: dict[str, Value] = {
        f"{motor}.characteristic": 1,
        f"{motor}.kloss.tau_b": tau_b,
        f"{motor}.kloss.s_b": plate.breakdown_slip,
        f"{motor}.kloss.w_s": w_s,
        f"{motor}.B": 2.0 * tau_b / (plate.breakdown_slip * w_s),
        f"{motor}.T": plate.lag,
    }
    if plate.inertia is not None:
        values[inertia] = plate.inertia * plate.ratio**2
    return values
