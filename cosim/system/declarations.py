"""What a model description declares, as XML: what in it cannot be read, and what the standard forbids."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from typing import Any

from ..numbers import real, truth, whole
from .base_units import BASES

#: The widths in bits of the types of whole numbers, and whether they have a sign.
WIDTHS = {f"{sign}Int{bits}": (bits, not sign) for bits in (8, 16, 32, 64) for sign in ("", "U")}
#: What the types of FMI 2.0 and the items of enumerations are in those words, by type and version.
NATIVE = {"Integer": "Int32", ("Enumeration", "2.0"): "Int32", ("Enumeration", "3.0"): "Int64"}
REALS = ("Real", "Float32", "Float64")
#: The elements of a model structure by FMI 2.0, and those of them that FMI 3.0 has.
LISTS = {"2.0": ("Outputs", "Derivatives", "DiscreteStates", "InitialUnknowns"), "3.0": ()}
UNKNOWNS = (
    "Output",
    "ContinuousStateDerivative",
    "ClockedState",
    "InitialUnknown",
    "EventIndicator",
)
#: What a variable that is set by its environment is.
SETTABLE = ("input", "parameter", "structuralParameter")
Reader = Callable[[str], Any]
Element = Any


def integer(text: str, native: str) -> int:
    """A whole number that a type, such as Int8, holds; raises ValueError for others."""
    number, (bits, signed) = whole(text), WIDTHS[native]
    lowest, highest = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if signed else (0, 2**bits)
    if not lowest <= number < highest:
        raise ValueError(f"{text.strip()!r} is not {integer_text(native)}")
    return number


def integer_text(native: str) -> str:
    """A type of whole numbers in words."""
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
    """A variable: the element that names it, and the one that says its type, which are one in FMI 3.0."""

    def __init__(self, element: Any, typed: Any) -> None:
        self.element, self.typed = element, typed
        self.name, self.kind = str(element.get("name") or ""), str(typed.tag)
        self.causality = str(element.get("causality", "local"))
        usual = "continuous" if self.kind in REALS else "discrete"
        if self.causality in ("parameter", "calculatedParameter", "structuralParameter"):
            usual = "fixed"
        self.variability = str(element.get("variability") or usual)
        is_exact = self.causality in SETTABLE or self.variability == "constant"
        self.initial = str(element.get("initial") or ("exact" if is_exact else "calculated"))


class Declarations:
    """The declarations of a model description of FMI 2.0 or 3.0, of which `root` is the XML."""

    def __init__(self, root: Any) -> None:
        self.root = root
        self.version = "3.0" if str(root.get("fmiVersion", "")).startswith("3") else "2.0"
        holders = list(root.iterfind("ModelVariables/*"))
        types: Iterator[Any] = iter(holders)
        if self.version == "2.0":
            types = (
                next((x for x in h.iterfind("*") if x.tag != "Annotations"), h) for h in holders
            )
        self.variables = [Declared(holder, kind) for holder, kind in zip(holders, types)]
        self.types = {str(x.get("name")): x for x in self.type_elements()}
        # what the model structure calls them: an index in FMI 2.0, a value reference in FMI 3.0
        self.by_reference = {str(n): v for n, v in enumerate(self.variables, 1)}
        if self.version == "3.0":
            references = (plain(v.element.get("valueReference", "")) for v in self.variables)
            self.by_reference = dict(zip(references, self.variables))

    def type_elements(self) -> Iterator[Any]:
        """The elements that name types."""
        path = "TypeDefinitions/SimpleType" if self.version == "2.0" else "TypeDefinitions/*"
        return iter(self.root.iterfind(path))

    def content(self, named: Any) -> Any:
        """The element that says what a type is: in FMI 2.0 the one inside, in FMI 3.0 itself."""
        if self.version == "3.0":
            return named
        return next(iter(named.iterfind("*")), named)

    def declared(self, variable: Declared, attribute: str) -> str | None:
        """An attribute of a variable, or of its type."""
        text = variable.typed.get(attribute)
        if (
            text is None
            and (named := self.types.get(variable.typed.get("declaredType"))) is not None
        ):
            text = self.content(named).get(attribute)
        return None if text is None else str(text)

    def items(self, variable: Declared) -> dict[str, str]:
        """The values of the items of a variable's enumeration with their names."""
        named = self.types.get(variable.typed.get("declaredType"))
        if variable.kind != "Enumeration" or named is None:
            return {}
        items = self.content(named).iterfind("Item")
        return {str(item.get("value")): str(item.get("name")) for item in items}

    def structure_entries(self) -> Iterator[tuple[str, Element]]:
        """The elements of the model structure, each with the name of its list."""
        for group in LISTS[self.version]:
            for element in self.root.iterfind(f"ModelStructure/{group}/Unknown"):
                yield group, element
        if self.version == "3.0":
            for element in self.root.iterfind("ModelStructure/*"):
                if element.tag in UNKNOWNS:
                    yield str(element.tag), element

    def named(self, element: Any) -> Declared | None:
        """The variable that an element of the model structure means."""
        text = element.get("index" if self.version == "2.0" else "valueReference", "")
        return self.by_reference.get(plain(text))


def plain(text: str) -> str:
    """A whole number as it is usually written, and another text as it is."""
    try:
        return str(whole(text))
    except ValueError:
        return text


def line(element: Any) -> str:
    """Where an element begins in its file."""
    return f"line {element.sourceline}"


def unsigned(text: str) -> int:
    """A whole number of 32 bits without a sign."""
    return integer(text, "UInt32")


#: The attributes that are numbers or truth values, whatever the type of a variable: path, names and what reads them.
NUMBERS: tuple[tuple[str, tuple[str, ...], Reader], ...] = (
    (".", ("numberOfEventIndicators",), unsigned),
    ("CoSimulation", ("maxOutputDerivativeOrder",), unsigned),
    ("CoSimulation", ("fixedInternalStepSize",), real),
    ("UnitDefinitions/Unit/BaseUnit", BASES, lambda text: integer(text, "Int32")),
    ("UnitDefinitions/Unit/*", ("factor", "offset"), real),
    ("UnitDefinitions/Unit/DisplayUnit", ("inverse",), truth),
    ("DefaultExperiment", ("startTime", "stopTime", "stepSize", "tolerance"), real),
    ("ModelVariables/*", ("valueReference", "derivative", "previous"), unsigned),
    ("ModelVariables/*", ("intermediateUpdate", "canHandleMultipleSetPerTimeInstant"), truth),
    ("ModelVariables/*", ("intervalDecimal", "shiftDecimal"), real),
    ("ModelVariables/*", ("intervalCounter", "shiftCounter", "resolution"), lambda text: integer(text, "UInt64")),
    ("ModelVariables/*/*", ("derivative",), unsigned),
    ("ModelVariables//Dimension", ("start", "valueReference"), lambda text: integer(text, "UInt64")),
    ("ModelStructure/*", ("valueReference", "dependencies"), unsigned),
    ("ModelStructure/*/Unknown", ("index", "dependencies"), unsigned),
)  # fmt: skip
#: How the names of abilities begin, which are true or false.
ABILITIES = ("can", "needs", "provides", "has", "might")
INTERFACES = ("CoSimulation", "ModelExchange", "ScheduledExecution")


def unreadable(declarations: Declarations) -> Iterator[str]:
    """What is none of its type by XML Schema and FMI, and references to nothing, each with its line."""
    root = declarations.root
    for element, name, reader in _numbers(declarations):
        text = element.get(name)
        pieces = [] if text is None else [text]
        if text is not None and (name == "dependencies" or (name == "start" and text.split())):
            pieces = text.split()
        for piece in pieces:
            try:
                reader(piece)
            except ValueError as error:
                yield f"{line(element)}: {name}{_owner(element)}: {error}"
    token = "guid" if declarations.version == "2.0" else "instantiationToken"
    if root.get(token) is None:
        yield f"{line(root)}: there is no {token}, which every instance is given"
    what = "index" if declarations.version == "2.0" else "valueReference"
    references = [
        (element, group, name, text)
        for group, element in declarations.structure_entries()
        for name in (what, "dependencies")
        for text in (element.get(name) or "").split()
    ] + [
        (variable.element, variable.name, name, text)
        for variable in declarations.variables
        for name in ("derivative", "previous")
        for text in (variable.typed.get(name) or "").split()
    ]
    most = f"indices are 1 to {len(declarations.variables)}"
    for element, owner, name, text in references:
        if plain(text) not in declarations.by_reference:
            why = most if declarations.version == "2.0" else "no variable has it"
            yield f"{line(element)}: {name} {text} of {owner} is not a variable: {why}"


def _numbers(declarations: Declarations) -> Iterator[tuple[Any, str, Reader]]:
    """The attributes that are numbers or truth values, each with its element and what reads it."""
    root = declarations.root
    for path, names, reader in NUMBERS:
        for element in root.iterfind(path):
            yield from ((element, name, reader) for name in names)
    for element in (e for tag in INTERFACES for e in root.iterfind(tag)):
        abilities = (str(name) for name in element.attrib if name.startswith(ABILITIES))
        yield from ((element, name, truth) for name in abilities)
    native = NATIVE["Enumeration", declarations.version]
    for item in root.iterfind("TypeDefinitions//Item"):
        yield item, "value", lambda text: integer(text, native)
    contents = map(declarations.content, declarations.types.values())
    typed = [(content, str(content.tag).removesuffix("Type")) for content in contents]
    for element, kind in [*typed, *((v.typed, v.kind) for v in declarations.variables)]:
        if (own := value_reader(kind, declarations.version)) is not None:
            limits = () if kind == "Boolean" else ("min", "max")
            yield from ((element, name, own) for name in ("start", *limits))
        if kind in REALS:
            yield element, "nominal", real
            yield from (
                (element, name, truth) for name in ("relativeQuantity", "unbounded", "reinit")
            )


def _owner(element: Any) -> str:
    """Whose attribute it is, by the next name above."""
    while element is not None and not element.get("name"):
        element = element.getparent()
    return "" if element is None else f" of {element.get('name')}"
