"""Options: declared once; the command line, study files, Python, the JSON and the page read them there."""

from __future__ import annotations

import math
import os
from argparse import ArgumentParser, BooleanOptionalAction
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from functools import cache
from numbers import Integral, Real
from operator import ge, gt, le
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

import cosim
from cosim import SetupError
from cosim.cli.options import assignment
from cosim.rounding import unit_suffix
from cosim.system import Value, literal
from cosim.units import multiples, read_quantity

Start = dict[str, Value]
HOLDS = {"above": gt, "at least": ge, "at most": le}
TYPE_NAMES = {
    float: "a finite number",
    int: "a whole number",
    str: "a string",
    bool: "true or false",
}


def option(
    default: Any,
    meaning: str,
    unit: str = "",
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    choices: Iterable[str] = (),
) -> Any:
    """Declare an option of a dataclass of options; the default may be written with a unit, "2ms".

    Parameters
    ----------
    default : object
        The value of an option that is not set; its type is that of the annotation.
    meaning : str
        What the option is, for the help.
    unit : str
        The SI unit of the value; "" for none.
    above : float, optional
        A lower bound that the value may not reach.
    least : float, optional
        A lower bound that the value may reach.
    most : float, optional
        An upper bound that the value may reach.
    choices : iterable of str
        The texts that are allowed; empty for any.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Options:
    ...     speed: float = option("300rpm", "mean speed of the crank", "rad/s", above=0.0)
    >>> Options().speed
    '300rpm'
    """
    bounds = {"above": above, "at least": least, "at most": most}
    limits = {word: bound for word, bound in bounds.items() if bound is not None}
    declared = Option(
        "",
        float,
        default=default,
        meaning=meaning,
        unit=unit,
        bounds=limits,
        choices=tuple(choices),
    )
    return field(default=default, metadata={"option": declared})


@dataclass(frozen=True)
class Option:
    """An option as it was declared; `many` values make a tuple, `bounds` stand by their words."""

    name: str
    kind: type
    many: bool = False
    default: Any = None
    meaning: str = ""
    unit: str = ""
    bounds: Mapping[str, float] = field(default_factory=dict)
    choices: Sequence[str] = ()

    def read(self, raw: Any, key: str = "") -> Any:
        """The value as the question takes it, in the declared unit.

        Raises SetupError with the key (by default the name), the value and what was expected.
        """
        key = key or self.name
        if raw is None and self.default is None:
            return None
        if not self.many:
            return self._single(raw, key)
        values = self._list(raw, key)
        return tuple(sorted(set(values)) if self.kind is float else values)

    def help_text(self) -> str:
        """Meaning, unit, bounds and default, for the help."""
        unit = f" [{self.unit}]" if self.unit not in ("", "1") else ""
        default_text = f"{self.default:g}" if isinstance(self.default, float) else str(self.default)
        facts = [f"{word} {bound:g}" for word, bound in self.bounds.items()]
        facts += [] if self.default in (None, (), "", False) else [f"default: {default_text}"]
        more = f" ({', '.join(facts)})" if facts else ""
        return f"{self.meaning}{unit}{more}".replace("%", "%%")

    def _single(self, raw: Any, key: str) -> Any:
        """A value of the declared kind, within its bounds."""
        if self.kind is float:
            return self._checked(self._number(raw, key), key)
        value = literal(raw) if isinstance(raw, str) and self.kind is not str else raw
        if self.kind is int and isinstance(value, Integral) and not isinstance(value, bool):
            value = int(value)
        if self.kind is str and isinstance(value, os.PathLike):
            value = os.fspath(value)
        if self.choices and value not in self.choices:
            start = "; a start value of an FMU is given with --start" if "=" in str(raw) else ""
            raise SetupError(
                f"{key} = {quoted(raw)} must be one of {', '.join(self.choices)}{start}"
            )
        if type(value) is not self.kind:
            raise SetupError(f"{key} = {quoted(raw)} must be {TYPE_NAMES[self.kind]}")
        return self._checked(value, key)

    def _number(self, raw: Any, key: str) -> float:
        prefix = f"{key} = {quoted(raw)}"
        if isinstance(raw, str):
            return self._parsed([raw], prefix, self._expected())[0]
        if isinstance(raw, bool) or not isinstance(raw, Real):
            raise SetupError(f"{prefix} must {self._expected()}")
        return float(raw)

    def _list(self, raw: Any, key: str) -> list[Any]:
        """Values, "a,b,c", or numbers "20:66:24" (from, to, number); the unit of one is that of all."""
        prefix, form = f"{key} = {quoted(raw)}", "read from:to:number or a,b,c"
        if isinstance(raw, str) and self.kind is not float:
            raw = raw.split(",")
        if not isinstance(raw, str):
            if not isinstance(raw, Iterable):
                raise SetupError(f"{prefix} must be a list, each {TYPE_NAMES[self.kind]}")
            return [self._single(x, key) for x in raw]
        match raw.split(":"):
            case [values]:
                numbers = self._parsed(values.split(","), prefix, form) if values else []
            case [low, high, count] if count.strip().isdigit():
                if int(count) < 1:
                    raise SetupError(f"{prefix} contains no number")
                start, stop = self._parsed([low, high], prefix, form)
                numbers = np.linspace(start, stop, int(count)).tolist()
            case _:
                raise SetupError(f"{prefix} must {form}")
        return [self._checked(number, key) for number in numbers]

    def _parsed(self, texts: Sequence[str], prefix: str, form: str) -> list[float]:
        """Numbers that are written in one unit, in the declared one; others are refused by their form."""
        written = [quantity for quantity in map(read_quantity, texts) if quantity]
        if len(written) < len(texts):
            raise SetupError(f"{prefix} must {form}")
        units = list(dict.fromkeys(unit for _, unit in written if unit))
        if len(units) > 1:
            raise SetupError(f"{prefix} must be in one unit, not {' and '.join(units)}")
        scale = multiples(self.unit).get("".join(units) or self.unit)
        if scale is None:
            raise SetupError(f"{prefix} must {self._expected()}")
        return [number * scale for number, _ in written]

    def _expected(self) -> str:
        units = " or ".join(multiples(self.unit))
        return f"be a number in {units}" if self.unit else "be a number"

    def _checked(self, value: Any, key: str) -> Any:
        """The value, unless it is not finite or out of bounds."""
        if self.kind not in (float, int):
            return value
        if math.isfinite(value) and all(HOLDS[word](value, x) for word, x in self.bounds.items()):
            return value
        unit = unit_suffix(self.unit)
        limits = " and ".join(f"{word} {bound:.10g}{unit}" for word, bound in self.bounds.items())
        raise SetupError(
            f"{key} = {value:.7g}{unit} must be {TYPE_NAMES[self.kind]} {limits}".rstrip()
        )


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of every question; values are read and checked when it is made.

    Raises SetupError for a value that an option cannot take.
    """

    start: Mapping[str, Value] = field(default_factory=dict)

    @property
    def given_start(self) -> Mapping[str, Value]:
        """The start values that were given, without those that follow from options."""
        return self.start

    def __post_init__(self) -> None:
        for name, option_of in declared(type(self)).items():
            object.__setattr__(self, name, option_of.read(getattr(self, name)))
        object.__setattr__(self, "start", parse_starts(self.start))


@dataclass(frozen=True, kw_only=True)
class RunOptions(Options):
    """The options of every question of one certified run."""

    stop: float = option(1.0, "simulated time", "s", above=0.0)
    step: float = option("0.2ms", "finest of three communication steps", "s", above=0.0)
    algorithm: str = option("strang", "coupling algorithm", choices=cosim.ALGORITHMS)


def declared(kind: type[Options]) -> dict[str, Option]:
    """The options of a question by name, its own first."""
    known: Hashable = kind  # type: ignore[assignment]
    return _declared(known)


@cache
def _declared(kind: Any) -> dict[str, Option]:
    """The same, which type hints are slow to give."""
    hints = get_type_hints(kind)
    options = {}
    for entry in sorted(fields(kind), key=lambda entry: entry.name in RunOptions.__annotations__):
        if "option" in entry.metadata:
            hint = hints[entry.name]
            if NoneType in get_args(hint):
                (hint,) = (x for x in get_args(hint) if x is not NoneType)
            many = get_origin(hint) is tuple
            bare = get_args(hint)[0] if many else hint
            if bare not in TYPE_NAMES:
                raise SetupError(
                    f"option {entry.name!r} must be a float, int, str or bool, or a tuple of one of them"
                )
            options[entry.name] = replace(
                entry.metadata["option"], name=entry.name, kind=bare, many=many
            )
    return options


def quoted(value: object) -> str:
    """A value in a message."""
    return "(not given)" if value is None else repr(value)


def unknown_option(name: str, names: Iterable[str], who: str) -> SetupError:
    """The error for an option that a question does not have, with the closest that it has."""
    near = get_close_matches(name, list(names), 1)
    hint = f": did you mean {near[0]!r}?" if near else f", only {', '.join(names)}"
    return SetupError(f"{who} has no option {name!r}{hint}")


def add_arguments(parser: ArgumentParser, kind: type[Options]) -> None:
    """The options on a command line, whose values stay texts; what is not given is left out."""
    for name, option_of in declared(kind).items():
        flag = f"--{name.replace('_', '-')}"
        if option_of.kind is bool:
            parser.add_argument(flag, action=BooleanOptionalAction, help=option_of.help_text())
        elif option_of.kind is str and option_of.many:
            parser.add_argument(flag, action="append", metavar="TEXT", help=option_of.help_text())
        else:
            placeholder = "|".join(option_of.choices) or {float: "NUMBER", int: "N"}.get(
                option_of.kind, "TEXT"
            )
            parser.add_argument(
                flag, metavar="LIST" if option_of.many else placeholder, help=option_of.help_text()
            )
    parser.add_argument(
        "--start",
        action="append",
        metavar="NAME=VALUE",
        help="start value of an FMU, which overrides other options (repeatable)",
    )


def parse_starts(starts: Mapping[str, Value] | Iterable[str]) -> Start:
    """Start values by name, from a mapping or from texts, ["motor.T=0.05"]."""
    if isinstance(starts, Mapping):
        return dict(starts)
    if isinstance(starts, str) or not isinstance(starts, Iterable):
        form = 'a dictionary, {"motor.T": 0.05}'
        raise SetupError(f"start = {quoted(starts)} must be start values by name, {form}")
    return {name: literal(text) for name, text in map(assignment, starts)}


def check_fixed_starts(start: Mapping[str, Value], fixed: Iterable[str]) -> None:
    """Raise SetupError for a start value that a question sets itself."""
    for name in fixed:
        if name in start:
            raise SetupError(f"start value {name}: this question sets it itself")


def at_least(name: str, value: int, least: int) -> None:
    """Refuse a count that is too small."""
    if value < least:
        raise SetupError(f"{name} = {value} must be at least {least}")
