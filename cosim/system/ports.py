"""Variables of a system by name: ports, and the parts they belong to."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ..errors import SetupError
from ..names import only
from ..series import Column, Kind
from .base_units import BaseUnit, Unit, agreed_unit, common_unit, unit_conversion
from .description import Fmu, ModelDescription, Value, Variable
from .wires import Name, System, dotted

#: The kinds of columns by type of variable, but for Reals.
KINDS = {
    "Integer": Kind.INTEGER,
    "Boolean": Kind.BOOLEAN,
    "Clock": Kind.BOOLEAN,
    "Enumeration": Kind.ENUMERATION,
    "String": Kind.TEXT,
    "Binary": Kind.TEXT,
}
#: What a table is to do that is mapped to an input.
FOLLOW_A_TABLE = "follow a table"
#: Flaws of a part that are named in one line. A convention: a line that one reads.
MOST_FLAWS = 3


class Port(NamedTuple):
    """A variable of a part; `type` is that of FMI 2.0, `native` that of the FMU's own version.

    `label` is the connector of the system under which it is recorded, if it is.
    """

    part: str
    variable: Variable
    label: str = ""

    @property
    def name(self) -> str:
        """The name that wires, start values and results give it: part.variable."""
        return f"{self.part}.{self.variable.name}"

    @property
    def type(self) -> str:
        """The type as FMI 2.0 names it, whichever version the FMU has."""
        return self.variable.type

    @property
    def native(self) -> str:
        """The type as the FMU's own version of FMI names it."""
        return self.variable.native

    @property
    def unit(self) -> str:
        """The unit of the model description; empty if it gives none."""
        return self.variable.unit or ""

    @property
    def column(self) -> Column:
        """What it is as a column of a table."""
        return Column(self.label or self.name, self.unit, self.kind)

    @property
    def kind(self) -> Kind:
        """What its values are. A Real is discrete if it changes only at events or between steps."""
        if self.type == "Real":
            is_held = self.variable.variability in ("discrete", "tunable")
            return Kind.DISCRETE if is_held else Kind.CONTINUOUS
        return KINDS[self.type]

    def xml_text(self, value: Value) -> str:
        """A value of it as XML spells it."""
        return str(bool(value)).lower() if self.type == "Boolean" else str(value)

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Catalog:
    """The parts of a system with their FMUs, whose variables it finds by name."""

    system: System
    fmus: Mapping[str, Fmu]

    @property
    def descriptions(self) -> dict[str, ModelDescription]:
        """The model descriptions by part."""
        return {name: fmu.description for name, fmu in self.fmus.items()}

    @property
    def flaws(self) -> dict[str, tuple[str, ...]]:
        """By part, what is wrong in its model description but does not affect a run, a sentence each."""
        return {name: fmu.flaws for name, fmu in self.fmus.items() if fmu.flaws}

    def flaw_texts(self, *, in_full: bool = False) -> Iterator[str]:
        """The flaws of each part in a line, which names the first three; or `in_full` a line for each."""
        for part, flaws in self.flaws.items():
            if in_full:
                yield from (f"{part}: {flaw}" for flaw in flaws)
                continue
            more = f"; and {len(flaws) - MOST_FLAWS} more, see cosim check"
            text = "; ".join(flaws[:MOST_FLAWS])
            yield f"{part}: {text}{more if len(flaws) > MOST_FLAWS else ''}"

    def port(self, name: Name) -> Port:
        """The port of a name; raises SetupError if there is none."""
        candidates = self._places(name)
        for part, variable in candidates:
            if variable in self.fmus[part].variables:
                return Port(part, self.fmus[part].variables[variable])
            if shape := self.fmus[part].shapes.get(variable):
                first = ",".join("1" for _ in shape)
                raise SetupError(
                    f"{part}.{variable} is an array of {size_text(shape)}: name one, {variable}[{first}]"
                )
        if not candidates and (wires := self.system.connectors.get(dotted(name).strip())):
            inner, *others = self.behind(dotted(name).strip())
            if others or inner[1:] != (1.0, 0.0):
                ways = ", ".join(map(str, wires))
                raise SetupError(f"{dotted(name)} is no variable as it is, but {ways}: name that")
            return inner[0]
        if not candidates:
            text = dotted(name).strip()
            part = text.partition(".")[0] if isinstance(name, str) else name[0]
            raise SetupError(f"{text}: there is no part {part!r}, {only(part, self.fmus)}")
        part, variable = candidates[0]
        if variable in self.fmus[part].terminals:
            raise SetupError(
                f"{part}.{variable} is a terminal: a wire joins it as '{part}.{variable} -- part.terminal'"
            )
        names = self.fmus[part].variables
        raise SetupError(f"{part} has no variable {variable!r}, {only(variable, names)}")

    def _places(self, name: Name) -> list[tuple[str, str]]:
        """The parts and variables that a name may mean; in a system of one part, a variable's bare name is enough."""
        require_name(name)
        if not isinstance(name, str):
            return [name] if name[0] in self.fmus else []
        name = name.strip()
        places = [place for place in split_name(name) if place[0] in self.fmus]
        if not places and len(self.fmus) == 1 and name not in self.system.connectors:
            ((part, fmu),) = self.fmus.items()
            if "." not in name or name in fmu.variables or name in fmu.shapes:
                places = [(part, name)]
        return places

    def array(self, name: Name) -> tuple[tuple[int, ...], list[Port]]:
        """The dimensions and elements of an array, none and the port of another name; SetupError."""
        for part, variable in self._places(name):
            if variable in self.fmus[part].shapes:
                variables = self.fmus[part].variables.values()
                elements = [Port(part, v) for v in variables if v.name.startswith(f"{variable}[")]
                return self.fmus[part].shapes[variable], elements
        is_label = isinstance(name, str) and name.strip() in self.system.connectors
        return (), [self.port(name)._replace(label=str(name).strip() if is_label else "")]

    def behind(self, name: str) -> list[tuple[Port, float, float]]:
        """The variables behind a connector of the system, each with factor and offset; of another name its own."""
        wires = self.system.connectors.get(name.strip(), ())
        if not wires:
            return [(self.port(name), 1.0, 0.0)]
        ends = [w.target if w.source == name.strip() else w.source for w in wires]
        return [(self.port(end), w.factor, w.offset) for end, w in zip(ends, wires)]

    def unit(self, port: Port) -> Unit:
        """The unit of a port as its FMU defines it; no definition if it does not say.

        That of a difference has no offset.
        """
        unit = self.fmus[port.part].units.get(port.unit, Unit(port.unit))
        return unit.without_offset() if port.variable.relativeQuantity else unit

    def base_unit(self, port: Port) -> BaseUnit | None:
        """The unit of a port in SI base units, None if its model description does not say."""
        return self.unit(port).baseUnit


def conversion_to(catalog: Catalog, port: Port, unit: str, purpose: str) -> tuple[float, float]:
    """Factor and offset from a unit to that of a port, which is to do `purpose` in that unit.

    A name means first what the port's own FMU says: a display unit of the port's unit, then a unit that
    it defines. Then come the common units of measurements, and last what the other FMUs of the system
    define. Raises SetupError for other names, units that do not fit, and names with two meanings.
    """
    if unit in ("", port.unit):
        return 1.0, 0.0
    if not port.unit:
        way = f", or write {port.name}=>COLUMN" if purpose == FOLLOW_A_TABLE else ""
        raise SetupError(
            f"{port} cannot {purpose} in {unit}: its FMU states no unit; leave it out{way}"
        )
    target = catalog.unit(port)
    try:
        for display in target.displayUnits:
            if display.name == unit:
                target.shown_in(display)  # refuses what converts nothing
                return 1.0 / display.factor, -display.offset / display.factor
        source = _meaning(catalog, port, unit)
        if source.baseUnit is None:
            raise SetupError("no FMU here defines that unit")
        if port.variable.relativeQuantity:
            source = source.without_offset()
        if target.baseUnit is None:
            target = common_unit(port.unit)
        return unit_conversion(source, target)
    except SetupError as error:
        raise SetupError(f"{port} cannot {purpose} in {unit}: {error}") from None


def _meaning(catalog: Catalog, port: Port, unit: str) -> Unit:
    """What a name of a unit means where a port is given a value; not defined if nothing says."""
    own = catalog.fmus[port.part].units.get(unit, Unit(unit))
    if own.baseUnit is not None:
        return own
    others = (fmu.units[unit] for fmu in catalog.fmus.values() if unit in fmu.units)
    common = common_unit(unit)
    return agreed_unit(unit, others) if common.baseUnit is None else common


def require_name(name: object) -> None:
    """Refuse what is neither a text nor a part and a variable; raises SetupError with what to write."""
    is_pair = isinstance(name, tuple) and [isinstance(piece, str) for piece in name] == [True, True]
    if not isinstance(name, str) and not is_pair:
        raise SetupError(f"{name!r} is not a name: write 'part.variable'")


def split_name(name: str) -> list[tuple[str, str]]:
    """The two pieces of a name, cut at each of its dots, the last one first."""
    return [(name[: dot.start()], name[dot.end() :]) for dot in re.finditer(r"\.", name)][::-1]


def size_text(shape: Sequence[int]) -> str:
    """Dimensions in words."""
    return f"{' x '.join(map(str, shape))} elements" if shape else "one element"


def is_continuous_input(port: Port) -> bool:
    """Whether it is an input that moves within steps: a Real one, in FMI 3.0 if it is continuous."""
    real = port.type == "Real" and port.variable.causality == "input"
    return real and port.variable.variability != "discrete"
