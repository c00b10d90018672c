"""Declare a variable in one line: type, start, meaning, bounds. A record is a named tuple of them."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast, get_type_hints

from .si import Quantity

if TYPE_CHECKING:
    from typing import dataclass_transform
else:

    def dataclass_transform(**_: Any) -> Any:
        return lambda decorated: decorated


Value = float | int | bool | str


class Declaration(NamedTuple):
    """What a component says of one variable; bounds are inclusive, but 0 is not `positive`."""

    start: Value
    meaning: str
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    feedthrough: tuple[str, ...] = ()
    held: bool = False
    positive: bool = False
    quantity: Quantity | None = None

    @property
    def kind(self) -> str:
        """Real, Integer, Boolean, String or Enumeration."""
        if isinstance(self.start, IntEnum):
            return "Enumeration"
        names = {bool: "Boolean", int: "Integer", str: "String"}
        return names.get(type(self.start), "Real")

    @property
    def items(self) -> type[IntEnum] | None:
        """The enumeration, where there is one."""
        return type(self.start) if isinstance(self.start, IntEnum) else None


def real(
    start: float,
    meaning: str,
    *,
    min: float | None = None,
    max: float | None = None,
    nominal: float | None = None,
    feedthrough: tuple[str, ...] = (),
    held: bool = False,
    positive: bool = False,
) -> Any:
    """Declare a Real; `positive` is min = 0 without the 0 itself.

    `feedthrough` names the inputs that act on an output without delay; a `held` one is part of a
    State and changes only at events.
    """
    low = 0.0 if positive else min
    return Declaration(float(start), meaning, low, max, nominal, feedthrough, held, positive)


def discrete(start: int | bool | str, meaning: str, feedthrough: tuple[str, ...] = ()) -> Any:
    """Declare an Integer, Boolean, String or, with an IntEnum member, an Enumeration."""
    return Declaration(start, meaning, feedthrough=feedthrough)


R = TypeVar("R")


@dataclass_transform(field_specifiers=(real, discrete))
def record(cls: type[R]) -> type[R]:
    """Make a named tuple of the declared fields; a field that is itself a record nests."""
    fields: dict[str, Any] = {}
    for name, annotation in get_type_hints(cls, include_extras=True).items():
        if hasattr(annotation, "_declared"):
            fields[name] = annotation
        else:
            quantity = next(iter(getattr(annotation, "__metadata__", ())), None)
            fields[name] = getattr(cls, name)._replace(quantity=quantity)
    body = {"__slots__": (), "__doc__": cls.__doc__, "__module__": cls.__module__}
    made = type(cls.__name__, (namedtuple(cls.__name__, fields),), body)
    made._declared = fields  # type: ignore[attr-defined]
    return cast(type[R], made)


def declarations(cls: Any, prefix: str = "") -> Iterator[tuple[str, Declaration]]:
    """Every variable of a record class with its dotted name, depth first."""
    for name, field in cls._declared.items():
        if isinstance(field, Declaration):
            yield prefix + name, field
        else:
            yield from declarations(field, f"{prefix}{name}.")


def fill(cls: Any, values: Sequence[Value]) -> Any:
    """The record of these values, given in the order of `declarations`."""
    return _fill(cls, iter(values))


def _fill(cls: Any, values: Iterator[Value]) -> Any:
    return cls._make(
        next(values) if isinstance(field, Declaration) else _fill(field, values)
        for field in cls._declared.values()
    )


def replace(record: R, **changes: Value) -> R:
    """The record with some fields changed."""
    return cast(R, cast(Any, record)._replace(**changes))


def start(cls: Any, **changes: Value) -> Any:
    """The record of the start values, with some changed: `start(Parameters, **{"crank.r": 0.02})`."""
    known = dict(declarations(cls))
    unknown = changes.keys() - known.keys()
    if unknown:
        raise KeyError(f"{cls.__name__} has no {', '.join(sorted(unknown))}")
    return fill(cls, [changes.get(name, field.start) for name, field in known.items()])
