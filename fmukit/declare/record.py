"""Declare variables in one line each: type, start, meaning, bounds. A record is a named tuple of them."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator, Sequence
from enum import IntEnum
from functools import cache
from itertools import islice
from math import inf
from operator import itemgetter
from typing import (
    TYPE_CHECKING,
    Any,
    NamedTuple,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from .. import si
from ..si import Quantity

if TYPE_CHECKING:
    from typing import dataclass_transform
else:

    def dataclass_transform(**_: Any) -> Any:
        return lambda decorated: decorated


Value = float | int | bool | str
IDENTIFIER = str.maketrans({"[": "_", ",": "_", "]": None})


class Declaration(NamedTuple):
    """The declaration of one variable; bounds are inclusive, but `positive` excludes 0."""

    start: Value
    meaning: str
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    feedthrough: tuple[str, ...] = ()
    held: bool = False
    positive: bool = False
    quantity: Quantity | None = None
    follows: bool = False
    tunable: bool = False

    @property
    def fmi_type(self) -> str:
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
    follows: bool = False,
    tunable: bool = False,
) -> Any:
    """Declare a Real; `positive` is min = 0 without the 0 itself.

    `feedthrough` names the inputs that act on an output without delay. A `held` variable is part of the
    State and changes only at events. One that `follows` is computed by `complete_state` and cannot be set. A
    `tunable` parameter may be set between communication steps and in event mode.

    Parameters
    ----------
    start : float
        The start value, in the SI unit of the field's quantity.
    meaning : str
        What the variable is; hosts show it as its description.
    min : float, optional
        A lower bound that the value may reach; a value beyond it is refused.
    max : float, optional
        An upper bound, likewise.
    nominal : float, optional
        The order of magnitude, in the unit of the start value.
    feedthrough : tuple of str
        The inputs that act on an output without delay.
    held : bool
        Whether a variable of the State changes only at events.
    positive : bool
        Whether the value must be above 0.
    follows : bool
        Whether `complete_state` computes the variable, which therefore cannot be set.
    tunable : bool
        Whether a parameter may be set between communication steps and in event mode.

    Returns
    -------
    Declaration
        What a class under `@record` takes as the default of a field.

    Examples
    --------
    >>> resistance = real(0.5, "Resistance of the winding", positive=True)
    >>> resistance.start, resistance.min, resistance.meaning
    (0.5, 0.0, 'Resistance of the winding')
    """
    if positive and min is not None:
        raise ValueError(f"positive=True means min = 0 without the 0 itself: leave out min={min!r}")
    low = 0.0 if positive else min
    return Declaration(
        float(start),
        meaning,
        low,
        max,
        nominal,
        feedthrough,
        held,
        positive,
        follows=follows,
        tunable=tunable,
    )


def discrete(
    start: int | bool | str,
    meaning: str,
    feedthrough: tuple[str, ...] = (),
    *,
    tunable: bool = False,
) -> Any:
    """Declare an Integer, Boolean, String or, with an IntEnum member, an Enumeration.

    Parameters
    ----------
    start : int, bool, str or IntEnum
        The start value; its type decides the type of the variable.
    meaning : str
        What the variable is; hosts show it as its description.
    feedthrough : tuple of str
        The inputs that act on an output without delay.
    tunable : bool
        Whether a parameter may be set between communication steps and in event mode.

    Returns
    -------
    Declaration
        What a class under `@record` takes as the default of a field.

    Examples
    --------
    >>> discrete(True, "Whether the rod has a finite length").fmi_type
    'Boolean'
    """
    return Declaration(start, meaning, feedthrough=feedthrough, tunable=tunable)


def array(start: Any, meaning: str, **rest: Any) -> Any:
    """Declare a vector, or a matrix by its rows: a Real A[1,1] for every start value.

    `meaning` may contain the indices: {0} is the row, {1} the column.

    Parameters
    ----------
    start : float or nested sequence of float
        The start values; nested rows declare a matrix.
    meaning : str
        What each element is, with the indices where the text has {0} and {1}.
    **rest
        The options of `real`, the same for each element.

    Examples
    --------
    >>> [[element.start for element in row] for row in array([[1.0, 2.0], [3.0, 4.0]], "A[{0},{1}]")]
    [[1.0, 2.0], [3.0, 4.0]]
    """
    if not isinstance(start, Sequence):
        return real(start, meaning, **rest)
    return [array(item, meaning, **rest) for item in start]


R = TypeVar("R")


@dataclass_transform(field_specifiers=(real, discrete, array))
def record(cls: type[R]) -> type[R]:
    """Make a named tuple of the declared fields; a field that is itself a record nests.

    An array is stored flat in the tuple, element by element, and read as a whole, a matrix as its rows.
    Make a record that has one with `fill`, not with the class itself.
    """
    fields: dict[str, Any] = {}
    body: dict[str, Any] = {"__slots__": (), "__doc__": cls.__doc__, "__module__": cls.__module__}
    body["__getattr__"] = _raise_missing_field
    annotations = _annotations(cls)
    body |= {
        name: value
        for name, value in vars(cls).items()
        if name not in annotations and not name.startswith("__")
    }
    for name, annotation in annotations.items():
        if not name.isascii():
            raise TypeError(
                f"{cls.__name__}.{name} is not a name in FMI: write letters from a to z"
            )
        if is_record(annotation):
            fields[name] = annotation
            continue
        declared, quantity = _declared(cls, name), _quantity(annotation)
        _require_number(f"{cls.__name__}.{name}", annotation, declared)
        if quantity is not None:
            _require_matching_exponents(f"{cls.__name__}.{name}", quantity)
        if isinstance(declared, list):
            body[name] = _array_view(len(fields), declared)
        for index, element in _elements(declared):
            _require_consistent(f"{cls.__name__}.{name}{index}", element)
            fields[name + index] = element._replace(quantity=quantity)
    names = [name.translate(IDENTIFIER) for name in fields]
    record_type = type(cls.__name__, (namedtuple(cls.__name__, names),), body)
    record_type._declared = fields  # type: ignore[attr-defined]
    return cast(type[R], record_type)


def _annotations(cls: Any) -> dict[str, Any]:
    """The types of the fields; raises TypeError for an annotation that is neither a quantity nor a type."""
    try:
        return get_type_hints(cls, include_extras=True)
    except NameError as error:
        choices = f"from fmukit.si import one of {si.list_quantities()}"
        raise TypeError(f"{error.name} in class {cls.__name__} is not a type: {choices}") from None


def _declared(cls: Any, name: str) -> Any:
    """What a class says of a field; raises TypeError where it is not a declaration."""
    value = getattr(cls, name, None)
    innermost = value
    while isinstance(innermost, list) and innermost:
        innermost = innermost[0]
    if not isinstance(innermost, Declaration):
        example = f"{value!r}" if isinstance(value, int | float) else "0.0"
        function_name = "discrete" if isinstance(value, bool | int | str) else "real"
        raise TypeError(
            f'{cls.__name__}.{name} has no declaration: write {name}: ... = {function_name}({example}, "Meaning")'
        )
    return value


def _require_number(variable: str, annotation: Any, declared: Any) -> None:
    """Raise TypeError for a text, which equations cannot carry, and for a number that is annotated as one."""
    if annotation is str or (isinstance(declared, Declaration) and isinstance(declared.start, str)):
        raise TypeError(
            f"{variable} is a text, which no equation can use: write an IntEnum of its values, as in "
            'gear: Gear = discrete(Gear.low, "Gear"), or put the text into the docstring'
        )


def _require_consistent(name: str, d: Declaration) -> None:
    """Raise ValueError or TypeError for what no variable can have, with what to write."""
    if isinstance(d.feedthrough, str):
        raise TypeError(f'{name}: write feedthrough=("{d.feedthrough}",), a tuple of names')
    for bound, value in {"min": d.min, "max": d.max, "nominal": d.nominal}.items():
        if value is not None and not (isinstance(value, int | float) and abs(value) < inf):
            raise ValueError(
                f"{name} has {bound}={value!r}: write a finite number, or leave it out"
            )
    if d.nominal is not None and not d.nominal > 0.0:
        raise ValueError(f"{name} has nominal={d.nominal!r}: write its order of magnitude, above 0")
    if d.min is not None and d.max is not None and not d.min <= d.max:
        raise ValueError(f"{name} has min={d.min!r} above max={d.max!r}")


def _raise_missing_field(self: Any, name: str) -> Any:
    raise AttributeError(f"{type(self).__name__} has no {name}: it has {', '.join(self._fields)}")


def _require_matching_exponents(variable: str, quantity: Quantity) -> None:
    """Raise ValueError, which names the variable, for wrong exponents of a known unit."""
    try:
        si.require_matching_exponents(quantity)
    except ValueError as error:
        raise ValueError(f"{variable}: {error}") from None


def _quantity(annotation: Any) -> Quantity | None:
    """The quantity of a type, or of what a tuple of it is made of."""
    while get_origin(annotation) is tuple:
        annotation = get_args(annotation)[0]
    return next(iter(getattr(annotation, "__metadata__", ())), None)


def _elements(declared: Any, *index: str) -> Iterator[tuple[str, Declaration]]:
    """The declarations of an array with their indices, [1,2]; of anything else, itself."""
    if isinstance(declared, list):
        for i, item in enumerate(declared, 1):
            yield from _elements(item, *index, str(i))
    elif index:
        meaning = declared.meaning.format(*index)
        yield f"[{','.join(index)}]", declared._replace(meaning=meaning)
    else:
        yield "", declared


def _array_view(first: int, declared: list[Any]) -> property:
    """The view of an array whose elements begin at `first`: a tuple, of rows for a matrix."""
    if isinstance(declared[0], Declaration):
        return property(itemgetter(slice(first, first + len(declared))))
    width = len(declared[0])
    rows = [slice(first + i * width, first + (i + 1) * width) for i in range(len(declared))]
    return property(lambda values: tuple([values[row] for row in rows]))


def is_record(cls: Any) -> bool:
    """Whether a class or annotation was made by `record`."""
    return hasattr(cls, "_declared")


def declarations(cls: Any, prefix: str = "") -> Iterator[tuple[str, Declaration]]:
    """Every variable of a record class with its dotted name, depth first."""
    for name, field in cls._declared.items():
        if isinstance(field, Declaration):
            yield prefix + name, field
        else:
            yield from declarations(field, f"{prefix}{name}.")


def fill(cls: type[R], values: Sequence[Value]) -> R:
    """The record of these values, given in the order of `declarations`.

    Parameters
    ----------
    cls : type
        A class under `@record`.
    values : sequence
        One value for each declaration.
    """
    return cast(R, _fill(cls, iter(values)))


@cache
def _is_flat(cls: Any) -> bool:
    """Whether no record is within this one."""
    return all(isinstance(field, Declaration) for field in cls._declared.values())


def _fill(cls: Any, values: Iterator[Value]) -> Any:
    if _is_flat(cls):
        return cls._make(islice(values, len(cls._fields)))
    return cls._make(
        next(values) if isinstance(field, Declaration) else _fill(field, values)
        for field in cls._declared.values()
    )


def replace(record: R, **changes: Value) -> R:
    """The record with some fields changed; raises AttributeError for an unknown one.

    Parameters
    ----------
    record : record
        The record, which stays as it is.
    **changes
        New values by field.
    """
    for name in changes:
        if name not in cast(Any, record)._fields:
            getattr(record, name)
    return cast(R, cast(Any, record)._replace(**changes))


def start(cls: Any, **changes: Value) -> Any:
    """The record of the start values, with some changed: `start(Parameters, **{"crank.r": 0.02})`."""
    fields = dict(declarations(cls))
    unknown = changes.keys() - fields.keys()
    if unknown:
        raise KeyError(f"{cls.__name__} has no {', '.join(sorted(unknown))}")
    return fill(cls, [changes.get(name, field.start) for name, field in fields.items()])
