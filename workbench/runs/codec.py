"""Answers of runs as JSON and back, the same to the last bit; reading them executes nothing.

===================================  ============================================================
In Python                            In JSON
===================================  ============================================================
None, truth value, text, integer     as it is
float                                as it is, in the shortest digits that give it back; infinity
                                     and nan as `{"!float": "nan"}`
complex                              `{"!complex": [real, imaginary]}`
list                                 as it is
dict                                 as it is if its keys are texts that do not begin with `!`,
                                     else `{"!dict": [[key, value], ...]}`
tuple                                `{"!tuple": [...]}`
number of NumPy                      `{"!scalar": [type, bytes]}`, the bytes in base64
array of NumPy                       `{"!array": [type, shape, order, bytes]}`
named tuple or dataclass             `{"!record": [class, {field: value}]}`; its class is one of
                                     `Records`
===================================  ============================================================
"""

from __future__ import annotations

import base64
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

MARK = "!"
#: The kinds of NumPy that hold nothing but numbers: truth values, integers, floats, complex numbers.
NUMBERS = "biufc"


@dataclass(frozen=True)
class Records:
    """Classes that a text may name: the named tuples and dataclasses of these packages and modules.

    Only what is loaded counts: nothing is imported because a text names it.
    """

    packages: frozenset[str] = frozenset()

    def name(self, kind: type) -> str:
        """The name of a class in texts; raises TypeError for one that is none of these."""
        name = f"{kind.__module__}:{kind.__qualname__}"
        try:
            if self.kind(name) is kind:
                return name
        except ValueError:
            pass
        raise TypeError(f"a value of type {kind.__module__}.{kind.__qualname__}")

    def kind(self, name: str) -> type:
        """The class of a name; raises ValueError if it is none of these."""
        module, _, path = name.partition(":")
        value: Any = sys.modules.get(module)
        if self.packages.isdisjoint((module, module.partition(".")[0])):
            value = None
        for part in path.split("."):
            value = vars(value).get(part) if isinstance(value, type | ModuleType) else None
        if not isinstance(value, type) or _fields(value) is None:
            raise ValueError(f"{name!r} is no known class")
        return value


NONE = Records()


def dumps(value: Any, records: Records = NONE) -> str:
    """The text of a value; raises TypeError, which names the type, for a value of another type."""
    return json.dumps(_encoded(value, records), allow_nan=False, separators=(",", ":"))


def loads(text: str, records: Records = NONE) -> Any:
    """The value of a text; raises ValueError for one that `dumps` does not write."""
    try:
        return _decoded(json.loads(text, parse_constant=_refuse), records)
    except (TypeError, KeyError, AttributeError, RecursionError, OverflowError) as error:
        raise ValueError(f"{type(error).__name__}: {error}") from None


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _fields(kind: type) -> tuple[str, ...] | None:
    """The fields of a named tuple or a dataclass; None of another class."""
    names: Any = vars(kind).get("_fields") if issubclass(kind, tuple) else None
    if is_dataclass(kind):
        names = tuple(field.name for field in fields(kind))
    return names if isinstance(names, tuple) else None


def _encoded(value: Any, records: Records) -> Any:
    """The tree of JSON for a value."""
    kind = type(value)
    if value is None or kind in (bool, int, str):
        return value
    if kind is float:
        return value if math.isfinite(value) else {"!float": repr(value)}
    if kind is complex:
        return {"!complex": [_encoded(part, records) for part in (value.real, value.imag)]}
    if kind in (list, tuple):
        items = [_encoded(item, records) for item in value]
        return items if kind is list else {"!tuple": items}
    if kind is dict:
        if all(type(key) is str and not key.startswith(MARK) for key in value):
            return {key: _encoded(item, records) for key, item in value.items()}
        pairs = [[_encoded(key, records), _encoded(x, records)] for key, x in value.items()]
        return {"!dict": pairs}
    if kind is np.ndarray and value.dtype.kind in NUMBERS:
        order = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
        return {"!array": [value.dtype.str, list(value.shape), order, _packed(value, order)]}
    if isinstance(value, np.generic) and value.dtype.kind in NUMBERS:
        return {"!scalar": [value.dtype.str, _packed(value, "C")]}
    name, names = records.name(kind), _fields(kind) or ()
    return {"!record": [name, {field: _encoded(getattr(value, field), records) for field in names}]}


def _packed(value: Any, order: Any) -> str:
    return base64.b64encode(value.tobytes(order)).decode()


def _decoded(tree: Any, records: Records) -> Any:
    """The value of a tree of JSON."""
    if isinstance(tree, list):
        return [_decoded(item, records) for item in tree]
    if not isinstance(tree, dict):
        return tree
    marks = [key for key in tree if key.startswith(MARK)]
    if not marks:
        return {key: _decoded(item, records) for key, item in tree.items()}
    if len(tree) > 1 or marks[0] not in READERS:
        raise ValueError(f"{marks[0]!r} marks no value")
    return READERS[marks[0]](tree[marks[0]], records)


def _numbers(kind: str, shape: tuple[int, ...], order: Any, text: str) -> Any:
    """An array of numbers that may be changed."""
    dtype = np.dtype(kind)
    if dtype.kind not in NUMBERS or dtype.str != kind:
        raise ValueError(f"{kind!r} is no type of numbers")
    data = base64.b64decode(text, validate=True)
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy(order="K")


def _record(name: str, items: Mapping[str, Any], records: Records) -> Any:
    """A named tuple or a dataclass with these fields; none of its own functions is called."""
    kind = records.kind(name)
    names = _fields(kind) or ()
    if set(items) != set(names):
        raise ValueError(f"{name} has other fields")
    values = {field: _decoded(items[field], records) for field in names}
    if issubclass(kind, tuple):
        return tuple.__new__(kind, values.values())
    value = object.__new__(kind)
    for field, item in values.items():
        object.__setattr__(value, field, item)
    return value


def _float(text: str, _records: Records) -> float:
    if text not in ("nan", "inf", "-inf"):
        raise ValueError(f"{text!r} is neither nan nor infinity")
    return float(text)


def _complex(parts: Any, records: Records) -> complex:
    real, imaginary = (_decoded(part, records) for part in parts)
    return complex(real, imaginary)


READERS: Mapping[str, Callable[[Any, Records], Any]] = {
    "!float": _float,
    "!complex": _complex,
    "!tuple": lambda items, records: tuple(_decoded(item, records) for item in items),
    "!dict": lambda pairs, records: {
        _decoded(key, records): _decoded(item, records) for key, item in pairs
    },
    "!scalar": lambda parts, _: _numbers(parts[0], (1,), "C", parts[1])[0],
    "!array": lambda parts, _: _numbers(parts[0], tuple(parts[1]), parts[2], parts[3]),
    "!record": lambda parts, records: _record(parts[0], parts[1], records),
}
