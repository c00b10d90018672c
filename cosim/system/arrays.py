"""Variables as scalars: those of FMI 2.0, and the elements of the arrays of FMI 3.0."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import prod
from typing import Any

from ..errors import SetupError
from ..numbers import real
from .declarations import WIDTHS
from .description import Item, SimpleType, Variable

#: The types of FMI 2.0 that those of FMI 3.0 are.
CLASSIC_TYPES = dict.fromkeys(("Float32", "Float64"), "Real") | dict.fromkeys(WIDTHS, "Integer")
TRUE = ("true", "1")
#: Elements that the arrays of an FMU may have in all: a convention. Each takes about a kilobyte here.
MOST_ELEMENTS = 1_000_000


class Elements:
    """The variables of an FMU as FMPy has read them, and in their place our scalars.

    Element [1] of an array is the first, as in the names that FMI 3.0 gives elements.
    """

    def __init__(self, root: Any, originals: Sequence[Any], *, is_fmi3: bool) -> None:
        self._root = root if is_fmi3 else None
        self._xml = {x.get("name"): x for x in root.iterfind("ModelVariables/*")}
        if not is_fmi3:
            self._xml = {name: _typed(x) for name, x in self._xml.items()}
        _require_countable(originals)
        self._types: dict[int, SimpleType] = {}
        self._families: dict[int, Sequence[Variable]] = {}
        self._open: set[int] = set()
        self.shapes = {v.name: tuple(v.shape) for v in originals if v.shape}
        for original in originals:
            self.of(original)

    def of(self, original: Any) -> Sequence[Variable]:
        """The elements of a variable, or the one variable that it is."""
        key = id(original)
        if key not in self._families:
            if key in self._open:
                raise SetupError(f"is not a valid FMU: {original.name} is its own derivative")
            self._open.add(key)
            self._families[key] = self._scalars(original)
        return self._families[key]

    def all(self, originals: Iterable[Any]) -> tuple[Variable, ...]:
        """The elements of several variables, one after the other."""
        return tuple(element for original in originals for element in self.of(original))

    def derivatives(self, interface: str) -> bool | None:
        """Whether an interface gives directional derivatives by FMI 3.0; None by FMI 2.0."""
        if self._root is None:
            return None
        return any(
            element.get("providesDirectionalDerivatives") in TRUE
            for element in self._root.iterfind(interface)
        )

    def _scalars(self, original: Any) -> Sequence[Variable]:
        """The elements, states before their derivatives."""
        states: Sequence[Variable | None] = (
            self.of(original.derivative) if original.derivative is not None else ()
        )
        xml = self._xml[original.name if self._root is None else (original.alias or original).name]
        names = _names(original)
        starts = [original.start] if self._root is None else _starts(original, xml)
        states = states or [None] * len(names)
        family: list[Variable] = []
        common = self._common(original, xml)
        for name, start, state in zip(names, starts, states):
            family.append(
                Variable(name=name, start=start, derivative=state, family=family, **common)
            )
        return family

    def _common(self, original: Any, xml: Any) -> dict[str, Any]:
        """What all elements of a variable share."""
        native = str(original.type)
        declared = self._type(original.declaredType)
        common = {
            "valueReference": original.valueReference,
            "type": CLASSIC_TYPES.get(native, native),
            "native": native,
            "causality": str(original.causality),
            "variability": str(original.variability),
            "initial": original.initial,
            "description": original.description,
            "declaredType": declared,
            "shape": tuple(original.shape or ()),
            "unit": original.unit,
            "nominal": original.nominal,
            "min": xml.get("min"),
            "max": xml.get("max"),
        }
        if declared is not None:
            for name in ("unit", "min", "max", "nominal"):
                if common[name] is None:
                    common[name] = getattr(declared, name)
        is_difference = xml.get("relativeQuantity")
        if is_difference is None:
            common["relativeQuantity"] = bool(
                getattr(original.declaredType, "relativeQuantity", False)
            )
        else:
            common["relativeQuantity"] = is_difference.strip() in TRUE
        if self._root is not None:
            common |= {
                "intermediateUpdate": xml.get("intermediateUpdate") in TRUE,
                "intervalVariability": original.intervalVariability,
                "interval": _seconds(xml, "interval"),
                "shift": _seconds(xml, "shift") or 0.0,
            }
        return common

    def _type(self, original: Any) -> SimpleType | None:
        """A declared type, copied once."""
        if original is None:
            return None
        if id(original) not in self._types:
            items = tuple(Item(str(i.name), int(i.value)) for i in original.items or ())
            limits = {name: getattr(original, name) for name in ("unit", "min", "max", "nominal")}
            self._types[id(original)] = SimpleType(str(original.name), items=items, **limits)
        return self._types[id(original)]


def _require_countable(originals: Sequence[Any]) -> None:
    """Raise SetupError for arrays that are too large to name each element."""
    count = 0
    for v in originals:
        count += (size := prod(v.shape or ()))
        if count > MOST_ELEMENTS:
            raise SetupError(
                f"has too many variables: {v.name} has {size} elements, and all arrays together may have "
                f"{MOST_ELEMENTS}"
            )


def _names(original: Any) -> list[str]:
    """The names of the elements."""
    if not original.shape:
        return [original.name]
    indices = product(*(range(1, n + 1) for n in original.shape))
    return [f"{original.name}[{','.join(map(str, index))}]" for index in indices]


def _typed(variable: Any) -> Any:
    """The element of a variable of FMI 2.0 that says its type."""
    return next((x for x in variable.iterchildren("*") if x.tag != "Annotations"), variable)


def _starts(original: Any, xml: Any) -> Sequence[str | None]:
    """The start values of the elements in FMI 3.0; one that is given alone is that of all."""
    count = prod(original.shape)
    if original.type in ("String", "Binary"):
        starts: list[str | None] = [start.get("value", "") for start in xml.findall("Start")]
    else:
        starts = list((original.start or "").split())
    starts = starts * count if len(starts) == 1 else starts or [None] * count
    if len(starts) != count:
        raise SetupError(
            f"is not a valid FMU: {original.name} has {count} elements and {len(starts)} start values"
        )
    return starts


def _seconds(xml: Any, name: str) -> float | None:
    """What a clock says of its interval or shift [s], as a decimal or a fraction."""
    if f"{name}Decimal" in xml.attrib:
        return real(xml.get(f"{name}Decimal"))
    counter, resolution = xml.get(f"{name}Counter"), xml.get("resolution")
    return float(counter) / float(resolution) if counter and resolution else None
