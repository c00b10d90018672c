"""What a model description declares, as XML."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

from ..numbers import real, truth, whole

#: The widths in bits of the types of whole numbers, and whether they have a sign.
WIDTHS = {f"{sign}Int{bits}": (bits, not sign) for bits in (8, 16, 32, 64) for sign in ("", "U")}
#: What the types of FMI 2.0 and the items of enumerations are in those words, by type and version.
NATIVE = {"Integer": "Int32", ("Enumeration", "2.0"): "Int32", ("Enumeration", "3.0"): "Int64"}
REALS = ("Real", "Float32", "Float64")
#: The types of variables by version of FMI.
TYPES = {
    "2.0": ("Real", "Integer", "Boolean", "String", "Enumeration"),
    "3.0": ("Float32", "Float64", *WIDTHS, "Boolean", "String", "Binary", "Enumeration", "Clock"),
}
#: The entries of a model structure: those of all lists of FMI 2.0, and those of FMI 3.0, which has no lists.
UNKNOWNS = (
    "Unknown",
    "Output",
    "ContinuousStateDerivative",
    "ClockedState",
    "InitialUnknown",
    "EventIndicator",
)
#: What a variable that is set by its environment is, and what does not change on its own.
SETTABLE = ("input", "parameter", "structuralParameter")
PARAMETERS = ("parameter", "calculatedParameter", "structuralParameter")
#: What `initial` may be by causality and variability, the first by default: the tables of FMI 2.0.4, 2.2.7,
#: and of FMI 3.0.2, 2.4.7.5.
INITIALS: dict[tuple[str, str], tuple[str, ...]] = {
    pair: initials
    for causalities, variabilities, initials in (
        (("parameter", "structuralParameter"), ("fixed", "tunable"), ("exact",)),
        (("calculatedParameter", "local"), ("fixed", "tunable"), ("calculated", "approx")),
        (("input",), ("discrete", "continuous"), ("exact",)),
        (("output", "local"), ("constant",), ("exact",)),
        (("output", "local"), ("discrete", "continuous"), ("calculated", "exact", "approx")),
        (("independent",), ("continuous",), ()),
    )
    for pair in product(causalities, variabilities)
}
#: What a variable has of its type where it does not state it itself.
INHERITED = ("unit", "min", "max", "nominal", "relativeQuantity")
Reader = Callable[[str], Any]
Element = Any


def integer(text: str, native: str) -> int:
    """A whole number that a type, such as Int8, holds; raises ValueError for others."""
    number = whole(text)
    if not fits(number, native):
        raise ValueError(f"{text.strip()!r} is not {describe_integer_type(native)}")
    return number


def fits(number: float, native: str) -> bool:
    """Whether a type of whole numbers, such as Int8, reaches as far as a number."""
    bits, signed = WIDTHS[native]
    lowest, highest = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if signed else (0, 2**bits)
    return bool(lowest <= number < highest)


def describe_integer_type(native: str) -> str:
    """A type of whole numbers in words, "an 8-bit integer"."""
    bits, signed = WIDTHS[native]
    article = "an" if str(bits).startswith("8") else "a"
    return f"{article} {bits}-bit {'' if signed else 'unsigned '}integer"


def float32(text: str) -> float:
    """A number that a 32-bit floating-point number holds but for rounding; raises ValueError for others."""
    number = real(text)
    if math.isfinite(number) and math.isinf(ctypes.c_float(number).value):
        raise ValueError(f"{text.strip()!r} is too large for a 32-bit floating-point number")
    return number


def value_reader(kind: str, version: str) -> Reader | None:
    """What reads a value of a type of a version of FMI; None for texts."""
    native = NATIVE.get(kind) or NATIVE.get((kind, version), kind)
    if native in WIDTHS:
        return lambda text: integer(text, str(native))
    return {"Float32": float32, "Float64": real, "Real": real, "Boolean": truth}.get(kind)


class Declared:
    """A variable as XML.

    Attributes
    ----------
    attributes
        Those of its element and of the one within that says its type by FMI 2.0, and where they are not stated, those
        of its declared type that it inherits.
    kind
        Its type by FMI's name, such as Real or Int8.
    element, typed
        Its element, which by FMI 3.0 has dimensions, start values and other names in it; the one that says its type.
    type
        The element that says what its declared type is; None if it has none, or one that is not defined.
    """

    __slots__ = (
        "attributes", "causality", "element", "initial", "kind", "name", "reference", "type", "typed", "variability",
    )  # fmt: skip

    def __init__(
        self, element: Element, typed: Element, named: Element | None, inherited: dict[str, str]
    ) -> None:
        is_fmi3 = typed is element
        self.element, self.typed, self.type = element, typed, named
        self.attributes = {**inherited, **dict(typed.items())}
        if not is_fmi3:
            self.attributes |= element.items()
        state, self.kind = self.attributes.get, str(typed.tag)
        self.name, self.reference = state("name", ""), canonical(state("valueReference", ""))
        self.causality, usual = state("causality", "local"), "continuous"
        if is_fmi3 and self.causality in PARAMETERS:
            usual = "fixed"
        elif is_fmi3 and self.kind not in REALS:
            usual = "discrete"
        self.variability = state("variability", usual)
        initials = INITIALS.get((self.causality, self.variability), ("calculated",))
        self.initial = state("initial", next(iter(initials), None))

    @property
    def where(self) -> str:
        """The line of its element in the file, "line 7"."""
        return line_of(self.element)


class Declarations:
    """The declarations of a model description of FMI 2.0 or 3.0, of which `root` is the XML.

    Attributes
    ----------
    types
        By name, the element that says what a type is: in FMI 2.0 the one inside the one that names it.
    reference
        The attribute by which the model structure means variables: an index in FMI 2.0, a value reference in FMI 3.0.
    by_reference
        The variables by it.
    """

    def __init__(self, root: Element) -> None:
        self.root, self.version = root, str(root.get("fmiVersion"))
        self.is_fmi3 = self.version == "3.0"
        elements = list(
            root.iterfind("TypeDefinitions/*" if self.is_fmi3 else "TypeDefinitions/SimpleType")
        )
        self.types = {str(x.get("name")): self._content(x) for x in elements}
        self._inherited = {
            name: {key: content.get(key) for key in INHERITED if content.get(key) is not None}
            for name, content in self.types.items()
        }
        self.variables = [self._declared(x) for x in root.iterfind("ModelVariables/*")]
        self.reference = "valueReference" if self.is_fmi3 else "index"
        self.by_reference = {str(n): v for n, v in enumerate(self.variables, 1)}
        if self.is_fmi3:
            self.by_reference = {v.reference: v for v in self.variables}

    def _content(self, named: Element) -> Element:
        """The element that says what a type or a variable is: in FMI 2.0 the first one inside, in FMI 3.0 itself."""
        for child in () if self.is_fmi3 else named:
            if child.tag != "Annotations" and isinstance(child.tag, str):
                return child
        return named

    def _declared(self, element: Element) -> Declared:
        typed = self._content(element)
        name = typed.get("declaredType")
        return Declared(element, typed, self.types.get(name), self._inherited.get(name, {}))

    def structure_entries(self) -> Iterator[tuple[str, Element]]:
        """The elements of the model structure, each with the name of its list."""
        for structure in self.root.iterfind("ModelStructure"):
            for element in structure.iter(*UNKNOWNS):
                yield str((element if self.is_fmi3 else element.getparent()).tag), element

    def referenced(self, element: Element, name: str) -> list[Declared]:
        """The variables that an attribute of an element means; raises ValueError with its line for one that there is not."""
        found = []
        for text in element.get(name, "").split():
            variable = self.by_reference.get(canonical(text))
            if variable is None:
                owner = name_of(element) or str(
                    (element if self.is_fmi3 else element.getparent()).tag
                )
                why = f"indices are 1 to {len(self.variables)}"
                why = "no variable has it" if self.is_fmi3 else why
                raise ValueError(
                    f"{line_of(element)}: {name} {text} of {owner} is not a variable: {why}"
                )
            found.append(variable)
        return found


def canonical(text: str) -> str:
    """A whole number as it is usually written, 7 for 007, and another text as it is."""
    try:
        return str(whole(text))
    except ValueError:
        return text


def name_of(element: Element) -> str:
    """The name of an element, or of the nearest around it that has one; empty if there is none."""
    while element is not None and not element.get("name"):
        element = element.getparent()
    return "" if element is None else str(element.get("name"))


def line_of(element: Element) -> str:
    """Where an element begins in its file, "line 7"."""
    return f"line {element.sourceline}"
