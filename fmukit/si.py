"""Quantities of the SI: name, unit and exponents of the base units, the radian counted as one."""

import math
import re
from typing import Annotated, NamedTuple, NoReturn, get_args, get_origin


class Display(NamedTuple):
    """A unit for display: value_in_display_unit = factor * value_in_unit."""

    unit: str
    factor: float


class Quantity(NamedTuple):
    """A physical quantity; `exponents` maps the FMI base units (kg, m, s, A, K, rad) to powers."""

    name: str
    unit: str
    exponents: dict[str, int]
    display: Display | None = None


#: Convention of the SI (9th brochure, tables 2 and 4): the exponents of the base units in each coherent unit.
COHERENT: dict[str, dict[str, int]] = {
    "1": {},
    "rad": {"rad": 1},
    "sr": {},
    **{base: {base: 1} for base in ("kg", "m", "s", "A", "K", "mol", "cd")},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "C": {"s": 1, "A": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "S": {"kg": -1, "m": -2, "s": 3, "A": 2},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
}


def exponents_of(unit: str) -> dict[str, int] | None:
    """The exponents of the base units in a unit such as N.m/rad or W/(m2.K), the radian among them.

    None if a part of it is no coherent unit of the SI, or if it cannot be read in one way only.
    """
    above, *below = unit.split("/")
    total: dict[str, int] = {}
    for part, sign in ((above, 1), *((part, -1) for part in below)):
        inner = part[1:-1] if part[:1] + part[-1:] == "()" else part
        if sign < 0 and "." in inner and inner == part:
            return None
        for factor in inner.split("."):
            match = re.fullmatch(r"([A-Za-z]+|1)(-?\d+)?", factor)
            if match is None or match[1] not in COHERENT:
                return None
            for base, power in COHERENT[match[1]].items():
                total[base] = total.get(base, 0) + sign * power * int(match[2] or 1)
    return {base: power for base, power in total.items() if power}


def coherent(name: str, unit: str, display: Display | None = None) -> Quantity:
    """A quantity in a coherent unit of the SI, which has its exponents."""
    exponents = exponents_of(unit)
    assert exponents is not None
    return Quantity(name, unit, exponents, display)


Angle = Annotated[float, coherent("Angle", "rad", Display("deg", 180 / math.pi))]
AngularVelocity = Annotated[
    float, coherent("AngularVelocity", "rad/s", Display("rpm", 30 / math.pi))
]
AngularAcceleration = Annotated[float, coherent("AngularAcceleration", "rad/s2")]
Length = Annotated[float, coherent("Length", "m")]
Velocity = Annotated[float, coherent("Velocity", "m/s")]
Acceleration = Annotated[float, coherent("Acceleration", "m/s2")]
Time = Annotated[float, coherent("Time", "s")]
Rate = Annotated[float, coherent("Rate", "1/s")]
Mass = Annotated[float, coherent("Mass", "kg")]
LinearDensity = Annotated[float, coherent("LinearDensity", "kg/m")]
Inertia = Annotated[float, coherent("MomentOfInertia", "kg.m2")]
Force = Annotated[float, coherent("Force", "N")]
Impulse = Annotated[float, coherent("Impulse", "N.s")]
Torque = Annotated[float, coherent("Torque", "N.m")]
Energy = Annotated[float, coherent("Energy", "J")]
Power = Annotated[float, coherent("Power", "W")]
TranslationalStiffness = Annotated[float, coherent("TranslationalSpringConstant", "N/m")]
TranslationalDamping = Annotated[float, coherent("TranslationalDampingConstant", "N.s/m")]
RotationalStiffness = Annotated[float, coherent("RotationalSpringConstant", "N.m/rad")]
RotationalDamping = Annotated[float, coherent("RotationalDampingConstant", "N.m.s/rad")]
Pressure = Annotated[float, coherent("Pressure", "Pa", Display("bar", 1e-5))]
VolumeFlowRate = Annotated[float, coherent("VolumeFlowRate", "m3/s")]
MassFlowRate = Annotated[float, coherent("MassFlowRate", "kg/s")]
Temperature = Annotated[float, coherent("ThermodynamicTemperature", "K")]
Voltage = Annotated[float, coherent("Voltage", "V")]
Current = Annotated[float, coherent("Current", "A")]
ElectricalTorqueConstant = Annotated[float, coherent("ElectricalTorqueConstant", "N.m/A")]
Resistance = Annotated[float, coherent("Resistance", "Ohm")]
Inductance = Annotated[float, coherent("Inductance", "H")]
MagneticFlux = Annotated[float, coherent("MagneticFlux", "Wb")]
Ratio = Annotated[float, coherent("DimensionlessRatio", "1")]


def require_matching_exponents(quantity: Quantity) -> None:
    """Raise ValueError if a unit that is made of those of the SI has other exponents than are declared."""
    exponents = exponents_of(quantity.unit)
    wanted, declared = (
        {base: power for base, power in (some or {}).items() if base != "rad" and power}
        for some in (exponents, quantity.exponents)
    )
    if exponents is not None and wanted != declared:
        radians = {"rad": quantity.exponents["rad"]} if "rad" in quantity.exponents else {}
        raise ValueError(
            f"the unit {quantity.unit} of {quantity.name} has the exponents {wanted}, not {declared}: "
            f'write Quantity("{quantity.name}", "{quantity.unit}", {wanted | radians})'
        )


RATES: dict[str, Quantity] = {
    get_args(quantity)[1].name: get_args(rate)[1]
    for quantity, rate in (
        (Angle, AngularVelocity),
        (AngularVelocity, AngularAcceleration),
        (Length, Velocity),
        (Velocity, Acceleration),
        (Energy, Power),
        (Mass, MassFlowRate),
    )
}


def per_second(quantity: Quantity) -> Quantity:
    """The quantity of a derivative by time."""
    if quantity.name in RATES:
        return RATES[quantity.name]
    power = quantity.exponents.get("s", 0) - 1
    slashed = re.fullmatch(r"(.+/s)(\d*)", quantity.unit)
    unit = f"{slashed[1]}{int(slashed[2] or 1) + 1}" if slashed else f"{quantity.unit}/s"
    return Quantity(f"{quantity.name}Rate", unit, quantity.exponents | {"s": power})


def list_quantities() -> str:
    """The names of all quantities, and how to write another one."""
    names = ", ".join(name for name, it in globals().items() if get_origin(it) is Annotated)
    return f'{names}; or write Annotated[float, Quantity("Density", "kg/m3", {{"kg": 1, "m": -3}})]'


def __getattr__(name: str) -> NoReturn:
    """Raise ImportError for an unknown quantity, with the names of all that there are."""
    if name.startswith("_"):
        raise AttributeError(name)
    raise ImportError(f"fmukit.si has no {name}: import one of {list_quantities()}")
