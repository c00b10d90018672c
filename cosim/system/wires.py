"""What a user writes: a system as a value, of parts, wires and start values."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from ..errors import SetupError
from ..series import NUMBER, Series
from .description import Value

Name = str | tuple[str, str]
WIRE = re.compile(
    rf"\s*(?P<source>[^*+\s]+)\s*(?:\*\s*(?P<factor>[+-]?{NUMBER}))?\s*(?P<offset>[+-]{NUMBER})?"
    r"\s*(?P<arrow>->|=>|\+>|\+=>)\s*(?P<target>[^*+\s]+)\s*"
)
SHAFT = re.compile(r"\s*(?P<one>[^*+\s]+)\s+--\s+(?P<other>[^*+\s]+)\s*")


class Wire(NamedTuple):
    """A wire as a value. Its ends may have any names: "motor.tau" or ("motor", "tau").

    Factor and offset apply in the source's unit. Unless the wire `converts`, the target takes the
    number unchanged, whatever the units. A wire that `adds` is added to the earlier wires into the
    same input.
    """

    source: Name
    target: Name
    factor: float = 1.0
    offset: float = 0.0
    converts: bool = True
    adds: bool = False

    def __str__(self) -> str:
        factor = "" if self.factor == 1.0 else f" * {self.factor!r}"
        sign = "-" if self.offset < 0.0 else "+"
        offset = "" if self.offset == 0.0 else f" {sign} {abs(self.offset)!r}"
        arrow = ("+>" if self.converts else "+=>") if self.adds else "->" if self.converts else "=>"
        return f"{dotted(self.source)}{factor}{offset} {arrow} {dotted(self.target)}"

    @classmethod
    def read(cls, text: str) -> Wire:
        """Read a wire from text.

        Parameters
        ----------
        text : str
            Two dotted names with an arrow between them, and a factor and an offset where needed.

        Raises
        ------
        SetupError
            For a text that is no wire.

        Examples
        --------
        >>> Wire.read("motor.w * 2 -> gearbox.w_a").factor
        2.0
        """
        match = WIRE.fullmatch(re.sub(r"\s+", " ", text))
        if match is None:
            raise SetupError(
                f"wire {text!r} must read 'part.output [* factor] [+ offset] -> part.input', "
                "=> to convert no units, +> or +=> to add to another wire, "
                "or 'part.terminal -- part.terminal'"
            )
        factor, offset = (
            float(re.sub(r"\s", "", match[key] or default))
            for key, default in (("factor", "1"), ("offset", "0"))
        )
        converts, adds = "=" not in match["arrow"], "+" in match["arrow"]
        return cls(match["source"], match["target"], factor, offset, converts, adds)


def dotted(name: Name) -> str:
    """A name as one text."""
    return name if isinstance(name, str) else ".".join(name)


@dataclass(frozen=True)
class System:
    """FMU files by part name, wires, start values by variable.

    A wire reads "motor.tau -> conveyor.tau" or, with a factor and an offset in the source's unit,
    "cam.w * 2.5 + 0.1 -> rotor.w". Convertible units are converted (rpm -> rad/s). With "=>" the
    target takes the number unchanged, whatever the units. A `Wire` is the same as a value; names
    with a blank, * or + need it. "motor.flange -- conveyor.flange" joins two terminals: it stands
    for a wire for each member that both have, from the output to the input. A bond names two outputs
    that are wired there and back and whose product is a power: "motor.tau * conveyor.w". Bonds that
    are clear from the units of the wires need not be named. A part of a subsystem has a dotted name,
    "line.motor".

    `inputs` are inputs over time by variable: a `Series` with one column beside the times, or a function of time [s]. A change of an
    input or a tunable parameter reads "at 2 s motor.A = 7500". Within a step, a Real input is held at
    its mean, or follows a line if its FMU can interpolate; everything else changes between steps.

    `connectors` are names of the system's own, as a file may give it: the wires from each to the inputs or parameters
    behind it, or the one from an output to it.
    """

    parts: Mapping[str, Path]
    wires: Sequence[str | Wire] = ()
    start: Mapping[str, Value] = field(default_factory=dict)
    bonds: Sequence[str] = ()
    inputs: Mapping[str, Series | Callable[[float], float]] = field(default_factory=dict)
    changes: Sequence[str] = ()
    connectors: Mapping[str, Sequence[Wire]] = field(default_factory=dict)


def require_field_types(system: System) -> None:
    """Refuse what is not of the kind that a system is made of; raises SetupError with what to write."""
    _require_files(system.parts)
    for what in ("wires", "bonds", "changes"):
        entries = getattr(system, what)
        if isinstance(entries, str | Wire) or not isinstance(entries, Sequence):
            hint = f": write [{entries!r}]" if isinstance(entries, str | Wire) else ", as a list"
            raise SetupError(f"{what} must be a sequence of texts{hint}")
        for entry in entries:
            if not isinstance(entry, str | Wire if what == "wires" else str):
                raise SetupError(f"{entry!r} in {what} must be a text{_wire_hint(entry)}")
    for what, example in (
        ("start", "0.05"),
        ("inputs", "Series.of({'t': [0.0, 1.0], 'T': [0.0, 2.0]})"),
    ):
        if not isinstance(getattr(system, what), Mapping):
            raise SetupError(f"{what} must be values by name: write {{'motor.T': {example}}}")
    for name, profile in system.inputs.items():
        if not isinstance(profile, Series) and not callable(profile):
            hint = "; to hold it, give it as a start value" if isinstance(profile, Real) else ""
            text = f"input {dotted(name)} = {profile!r} must be a Series or a function of time"
            raise SetupError(f"{text}{hint}")


def _require_files(parts: object) -> None:
    """Refuse parts that are no files by name; raises SetupError with what to write."""
    if not isinstance(parts, Mapping):
        files = [parts] if isinstance(parts, str | PathLike) else parts
        some = (
            [f for f in files if isinstance(f, str | PathLike)]
            if isinstance(files, Iterable)
            else []
        )
        named = {Path(f).stem: str(f) for f in some} or {"motor": "motor.fmu"}
        raise SetupError(f"parts must be FMU files by name: write {named}")
    for name, file in parts.items():
        if not isinstance(name, str) or not isinstance(file, str | PathLike):
            raise SetupError(f"part {name!r}: {file!r} must be the path of an FMU")


def _wire_hint(entry: object) -> str:
    """How to write two names as a wire, where they are two names."""
    if isinstance(entry, tuple | list) and [type(name) for name in entry] == [str, str]:
        return f": write '{entry[0]} -> {entry[1]}'"
    return ""
