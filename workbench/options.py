"""Options: declared once; the command line, study files, Python, the JSON and the page read them there."""

from __future__ import annotations

import math
import os
from argparse import ArgumentParser, BooleanOptionalAction
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from numbers import Integral, Real
from operator import ge, gt, le
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

import cosim
from cosim import SetupError
from cosim.cli.options import assignment, literal
from cosim.system import Value
from cosim.units import QUANTITY, multiples

Start = dict[str, Value]
HOLDS = {"above": gt, "at least": ge, "at most": le}
KINDS = {float: "a finite number", int: "a whole number", str: "a string", bool: "true or false"}


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
    told = {word: bound for word, bound in bounds.items() if bound is not None}
    declared = Option("", float, False, default, meaning, unit, told, tuple(choices))
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

    def read(self, given: Any, key: str = "") -> Any:
        """The value as the question takes it, in the declared unit.

        Raises SetupError with the key (by default the name), the value and what was expected.
        """
        key = key or self.name
        if given is None and self.default is None:
            return None
        if not self.many:
            return self._one(given, key)
        values = self._list(given, key)
        return tuple(sorted(set(values)) if self.kind is float else values)

    def words(self) -> str:
        """Meaning, unit and default, for the help."""
        unit = f" [{self.unit}]" if self.unit not in ("", "1") else ""
        default_text = f"{self.default:g}" if isinstance(self.default, float) else str(self.default)
        default = "" if self.default in (None, (), "", False) else f" (default: {default_text})"
        return f"{self.meaning}{unit}{default}".replace("%", "%%")

    def _one(self, given: Any, key: str) -> Any:
        """A value of the declared kind, within its bounds."""
        if self.kind is float:
            return self._checked(self._number(given, key), key)
        value = literal(given) if isinstance(given, str) and self.kind is not str else given
        if self.kind is int and isinstance(value, Integral) and not isinstance(value, bool):
            value = int(value)
        if self.kind is str and isinstance(value, os.PathLike):
            value = os.fspath(value)
        if self.choices and value not in self.choices:
            start = "; a start value of an FMU is given with --start" * ("=" in str(given))
            raise SetupError(
                f"{key} = {quoted(given)} must be one of {', '.join(self.choices)}{start}"
            )
        if type(value) is not self.kind:
            raise SetupError(f"{key} = {quoted(given)} must be {KINDS[self.kind]}")
        return self._checked(value, key)

    def _number(self, given: Any, key: str) -> float:
        said = f"{key} = {quoted(given)}"
        if isinstance(given, str):
            return self._parsed([given], said, self._expected())[0]
        if isinstance(given, bool) or not isinstance(given, Real):
            raise SetupError(f"{said} must {self._expected()}")
        return float(given)

    def _list(self, given: Any, key: str) -> list[Any]:
        """Values, "a,b,c", or numbers "20:66:24" (from, to, number); the unit of one is that of all."""
        said, form = f"{key} = {quoted(given)}", "read from:to:number or a,b,c"
        if isinstance(given, str) and self.kind is not float:
            given = given.split(",")
        if not isinstance(given, str):
            if not isinstance(given, Iterable):
                raise SetupError(f"{said} must be a list, each {KINDS[self.kind]}")
            return [self._one(x, key) for x in given]
        *ends, count = given.split(":")
        if not ends:
            numbers = self._parsed(given.split(","), said, form) if given else []
        elif len(ends) != 2 or not count.strip().isdigit():
            raise SetupError(f"{said} must {form}")
        elif int(count) < 1:
            raise SetupError(f"{said} contains no number")
        else:
            low, high = self._parsed(ends, said, form)
            numbers = np.linspace(low, high, int(count)).tolist()
        return [self._checked(number, key) for number in numbers]

    def _parsed(self, texts: Sequence[str], said: str, form: str) -> list[float]:
        """Numbers that are written in one unit, in the declared one; others are refused by their form."""
        matches = [match for match in map(QUANTITY.fullmatch, texts) if match]
        if len(matches) < len(texts):
            raise SetupError(f"{said} must {form}")
        units = list(dict.fromkeys(match[2] for match in matches if match[2]))
        if len(units) > 1:
            raise SetupError(f"{said} must be in one unit, not {' and '.join(units)}")
        scale = multiples(self.unit).get("".join(units) or self.unit)
        if scale is None:
            raise SetupError(f"{said} must {self._expected()}")
        return [float(match[1]) * scale for match in matches]

    def _expected(self) -> str:
        return f"be a number{' in ' * bool(self.unit)}{' or '.join(multiples(self.unit))}"

    def _checked(self, value: Any, key: str) -> Any:
        """The value, unless it is not finite or out of bounds."""
        if self.kind not in (float, int):
            return value
        if math.isfinite(value) and all(HOLDS[word](value, x) for word, x in self.bounds.items()):
            return value
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        limits = " and ".join(f"{word} {bound:g}{unit}" for word, bound in self.bounds.items())
        raise SetupError(f"{key} = {value:g}{unit} must be {KINDS[self.kind]} {limits}".rstrip())


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of every question; values are read and checked when it is made.

    Raises SetupError for a value that an option cannot take.
    """

    start: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, told in declared(type(self)).items():
            object.__setattr__(self, name, told.read(getattr(self, name)))
        object.__setattr__(self, "start", parse_starts(self.start))


@dataclass(frozen=True, kw_only=True)
class Run(Options):
    """The options of every question of one certified run."""

    stop: float = option(1.0, "simulated time", "s", above=0.0)
    step: float = option("0.2ms", "finest of three communication steps", "s", above=0.0)
    algorithm: str = option("strang", "coupling algorithm", choices=cosim.ALGORITHMS)


Chosen = TypeVar("Chosen", bound=Options)


def declared(kind: type[Options]) -> dict[str, Option]:
    """The options of a question by name, its own first."""
    hints = get_type_hints(kind)
    found = {}
    for one in sorted(fields(kind), key=lambda one: one.name in Run.__annotations__):
        if "option" in one.metadata:
            hint = hints[one.name]
            if NoneType in get_args(hint):
                (hint,) = (x for x in get_args(hint) if x is not NoneType)
            many = get_origin(hint) is tuple
            bare = get_args(hint)[0] if many else hint
            if bare not in KINDS:
                raise SetupError(
                    f"option {one.name!r} must be a float, int, str or bool, or a tuple of one of them"
                )
            found[one.name] = replace(one.metadata["option"], name=one.name, kind=bare, many=many)
    return found


def quoted(value: object) -> str:
    """A value in a message."""
    return "nothing" if value is None else repr(value)


def unknown_option(name: str, known: Iterable[str], who: str) -> SetupError:
    """The error for an option that a question does not have, with the closest that it has."""
    near = get_close_matches(name, list(known), 1)
    hint = f": did you mean {near[0]!r}?" if near else f", only {', '.join(known)}"
    return SetupError(f"{who} has no option {name!r}{hint}")


def parse_options(kind: type[Chosen], given: Mapping[str, Any], who: str) -> Chosen:
    """The options of these names; raises SetupError for what they cannot be."""
    known = [*declared(kind), "start"]
    for name in given:
        if name not in known:
            raise unknown_option(name, known, who)
    return kind(**given)


def add_arguments(parser: ArgumentParser, kind: type[Options]) -> None:
    """The options on a command line, whose values stay texts; what is not given is left out."""
    for name, told in declared(kind).items():
        flag = f"--{name.replace('_', '-')}"
        if told.kind is bool:
            parser.add_argument(flag, action=BooleanOptionalAction, help=told.words())
        elif told.kind is str and told.many:
            parser.add_argument(flag, action="append", metavar="TEXT", help=told.words())
        else:
            placeholder = "|".join(told.choices) or {float: "NUMBER", int: "N"}.get(
                told.kind, "TEXT"
            )
            parser.add_argument(
                flag, metavar="LIST" if told.many else placeholder, help=told.words()
            )
    parser.add_argument(
        "--start",
        action="append",
        metavar="NAME=VALUE",
        help="start value of an FMU, which overrides other options (repeatable)",
    )


def parse_starts(given: Mapping[str, Value] | Iterable[str]) -> Start:
    """Start values by name, from a mapping or from texts, ["motor.T=0.05"]."""
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, str) or not isinstance(given, Iterable):
        form = 'a dictionary, {"motor.T": 0.05}'
        raise SetupError(f"start = {quoted(given)} must be start values by name, {form}")
    return {name: literal(text) for name, text in map(assignment, given)}


def check_fixed_starts(start: Mapping[str, Value], own: Iterable[str]) -> None:
    """Raise SetupError for a start value that a question sets itself."""
    for name in own:
        if name in start:
            raise SetupError(f"start value {name}: this question sets it itself")


def at_least(name: str, value: int, least: int) -> None:
    """Refuse a count that is too small."""
    if value < least:
        raise SetupError(f"{name} = {value} must be at least {least}")
