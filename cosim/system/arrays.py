"""Variables as scalars: those of FMI 2.0, and the elements of the arrays of FMI 3.0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import prod
from typing import Any

from ..errors import SetupError
from ..numbers import real, truth, whole
from .declarations import WIDTHS, Declarations, Declared, Element
from .description import Item, SimpleType, Variable

#: The types of FMI 2.0 that those of FMI 3.0 are.
CLASSIC_TYPES = dict.fromkeys(("Float32", "Float64"), "Real") | dict.fromkeys(WIDTHS, "Integer")
#: Elements that the arrays of an FMU may have in all: a convention. Each takes about a kilobyte here.
MOST_ELEMENTS = 1_000_000


class Scalars:
    """The variables that an FMU declares, and in the place of its arrays their elements.

    Element [1] of an array is the first, as in the names that FMI 3.0 gives elements.

    Attributes
    ----------
    shapes
        The dimensions of the arrays by name.
    variables
        All, those that are other names of variables of FMI 3.0 at the end.
    """

    def __init__(self, declarations: Declarations) -> None:
        self._declarations = declarations
        arrays = [v for v in declarations.variables if declarations.is_fmi3 and len(v.element)]
        aliases = [(v, alias) for v in arrays for alias in v.element.iterfind("Alias")]
        self.shapes = {v.name: shape for v in arrays if (shape := _shape(declarations, v))}
        self.shapes |= {
            alias.get("name"): self.shapes[v.name] for v, alias in aliases if v.name in self.shapes
        }
        _require_countable(self.shapes)
        self._types = {name: _simple_type(name, x) for name, x in declarations.types.items()}
        self._families: dict[Declared, Sequence[Variable]] = {}
        self._open: set[Declared] = set()
        self.variables = [*self.elements_of_all(declarations.variables)]
        for declared, alias in aliases:
            self.variables += self._other_name(declared, alias)

    def elements_of(self, declared: Declared) -> Sequence[Variable]:
        """The elements of a variable, or the one variable that it is."""
        if declared not in self._families:
            if declared in self._open:
                raise ValueError(f"{declared.name} is its own derivative")
            self._open.add(declared)
            self._families[declared] = self._elements(declared)
        return self._families[declared]

    def elements_of_all(self, variables: Iterable[Declared]) -> tuple[Variable, ...]:
        """The elements of several variables, one after the other."""
        return tuple(element for declared in variables for element in self.elements_of(declared))

    def _elements(self, declared: Declared) -> Sequence[Variable]:
        """The elements, states before their derivatives."""
        common = self._common(declared)
        names = element_names(declared.name, common["shape"])
        starts: Sequence[str | None] = [declared.attributes.get("start")]
        if self._declarations.is_fmi3:
            starts = _starts(declared, len(names))
        states: Sequence[Variable | None] = [None] * len(names)
        for of in self._declarations.referenced(declared.typed, "derivative"):
            states = self.elements_of(of)
        family: list[Variable] = []
        for name, start, state in zip(names, starts, states):
            family.append(
                Variable(name=name, start=start, derivative=state, family=family, **common)
            )
        return family

    def _common(self, declared: Declared) -> dict[str, Any]:
        """What all elements of a variable share."""
        stated = declared.attributes.get
        common = {
            "valueReference": whole(declared.reference),
            "type": CLASSIC_TYPES.get(declared.kind, declared.kind),
            "native": declared.kind,
            "causality": declared.causality,
            "variability": declared.variability,
            "initial": declared.initial,
            "description": stated("description"),
            "declaredType": self._types.get(stated("declaredType", "")),
            "shape": self.shapes.get(declared.name, ()),
            "unit": stated("unit"),
            "min": stated("min"),
            "max": stated("max"),
            "nominal": stated("nominal"),
            "relativeQuantity": truth(stated("relativeQuantity", "0")),
        }
        if self._declarations.is_fmi3:
            common |= {
                "intermediateUpdate": truth(stated("intermediateUpdate", "0")),
                "intervalVariability": stated("intervalVariability"),
                "interval": _seconds(declared.attributes, "interval"),
                "shift": _seconds(declared.attributes, "shift") or 0.0,
            }
        return common

    def _other_name(self, declared: Declared, alias: Element) -> Sequence[Variable]:
        """The elements of a variable of FMI 3.0 by another name of it."""
        name, text = alias.get("name"), alias.get("description")
        family: list[Variable] = []
        names = element_names(name, self.shapes.get(name, ()))
        for own, element in zip(names, self.elements_of(declared)):
            description = text or element.description
            family.append(replace(element, name=own, family=family, description=description))
        return family


def _simple_type(name: str, content: Element) -> SimpleType:
    items = tuple(Item(i.get("name"), whole(i.get("value"))) for i in content.iterfind("Item"))
    unit, low, high, nominal = map(content.get, ("unit", "min", "max", "nominal"))
    return SimpleType(name, unit, low, high, nominal, items)


def _shape(declarations: Declarations, array: Declared) -> tuple[int, ...]:
    """The dimensions of a variable, that of a structural parameter as its start value says; empty for a scalar."""
    shape = []
    for dimension in array.element.iterfind("Dimension"):
        text, sizes = dimension.get("start"), declarations.referenced(dimension, "valueReference")
        if text is None and not sizes:
            raise ValueError(f"a Dimension of {array.name} has neither start nor valueReference")
        if text is None:
            (size,) = sizes
            text = size.attributes.get("start", "")
            try:
                whole(text)
            except ValueError:
                raise ValueError(
                    f"{size.name}, a dimension of {array.name}, has the start {text!r}, "
                    "which is not a whole number"
                ) from None
        shape.append(whole(text))
    return tuple(shape)


def _require_countable(shapes: dict[str, tuple[int, ...]]) -> None:
    """Raise SetupError for arrays that are too large to name each element."""
    count = 0
    for name, shape in shapes.items():
        count += prod(shape)
        if count > MOST_ELEMENTS:
            raise SetupError(
                f"has too many variables: {name} has {prod(shape)} elements, and all arrays together may have "
                f"{MOST_ELEMENTS}"
            )


def element_names(name: str, shape: Sequence[int]) -> list[str]:
    """The names of the elements of an array, x[1,1], x[1,2]; of a scalar its own."""
    if not shape:
        return [name]
    indices = product(*(range(1, n + 1) for n in shape))
    return [f"{name}[{','.join(map(str, index))}]" for index in indices]


def _starts(declared: Declared, count: int) -> Sequence[str | None]:
    """The start values of so many elements in FMI 3.0; one that is given alone is that of all."""
    starts: list[str | None] = [*declared.attributes.get("start", "").split()]
    if declared.kind in ("String", "Binary"):
        starts = [x.get("value", "") for x in declared.element.iterfind("Start")]
    starts = starts * count if len(starts) == 1 else starts or [None] * count
    if len(starts) != count:
        raise ValueError(f"{declared.name} has {count} elements and {len(starts)} start values")
    return starts


def _seconds(attributes: Mapping[str, str], name: str) -> float | None:
    """What a clock says of its interval or shift [s], as a decimal or a fraction."""
    decimal, counter, resolution = (
        attributes.get(key) for key in (f"{name}Decimal", f"{name}Counter", "resolution")
    )
    if decimal is not None:
        return real(decimal)
    if not counter or not resolution:
        return None
    if not whole(resolution):
        raise ValueError(f"resolution of {attributes.get('name')}: '0' must be above 0")
    return whole(counter) / whole(resolution)
