"""The variables of FMI 3.0 as the master knows all others: each one number, truth value or text."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from itertools import product
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

from fmpy.model_description import ModelDescription, ScalarVariable

from ..errors import SetupError

WIDTHS = {f"{sign}Int{bits}": (bits, not sign) for bits in (8, 16, 32, 64) for sign in ("", "U")}
KINDS = dict.fromkeys(("Float32", "Float64"), "Real") | dict.fromkeys(WIDTHS, "Integer")
TRUE = ("true", "1")
#: Elements that the arrays of an FMU may have in all: a convention. Each takes about a kilobyte here.
MOST_ELEMENTS = 1_000_000


class Element:
    """An FMI 3.0 variable, or an element of one that is an array.

    It has the attributes of a variable of FMI 2.0. `type` is Real, Integer, Enumeration, Boolean,
    String, Binary or Clock; `native` that of FMI 3.0. `family` are the elements that are got and set
    together, in FMI's order.
    """

    name: str
    type: str
    causality: str
    variability: str
    derivative: Any
    intervalVariability: str
    valueReference: int
    start: str | None
    family: Sequence[Element]

    def __init__(self, variable: ScalarVariable, place: str, start: str | None, said: Any) -> None:
        self.__dict__.update((a.name, getattr(variable, a.name)) for a in variable.__attrs_attrs__)
        self.native = str(variable.type)
        self.name, self.type = variable.name + place, KINDS.get(self.native, self.native)
        self.start, self.min, self.max = start, said.get("min"), said.get("max")
        self.intermediateUpdate = said.get("intermediateUpdate") in TRUE
        self.interval = _seconds(said, "interval")
        self.shift = _seconds(said, "shift") or 0.0


def _seconds(said: Any, what: str) -> float | None:
    """What a clock says of its interval or shift [s], as a decimal or a fraction."""
    if f"{what}Decimal" in said.attrib:
        return float(said.get(f"{what}Decimal"))
    counter, resolution = said.get(f"{what}Counter"), said.get("resolution")
    return float(counter) / float(resolution) if counter and resolution else None


def expand_arrays(path: Path, description: ModelDescription) -> dict[str, tuple[int, ...]]:
    """Put elements in place of the variables of an FMI 3.0 description; the shapes of its arrays.

    Element [1] is the first, as in the names that FMI 3.0 gives elements.
    """
    with ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    said = {each.get("name"): each for each in root.iterfind("ModelVariables/*")}
    _require_countable(description)
    families = {id(v): _family(v, said[(v.alias or v).name]) for v in description.modelVariables}
    shapes = {v.name: v.shape for v in description.modelVariables if v.shape}
    for rates in families.values():
        if (state := rates[0].derivative) is not None:
            for rate, element in zip(rates, families[id(state)]):
                rate.derivative = element
    for tag, side in (("CoSimulation", "coSimulation"), ("ModelExchange", "modelExchange")):
        for told in root.iterfind(tag):
            slopes = told.get("providesDirectionalDerivatives") in TRUE
            getattr(description, side).providesDirectionalDerivative = slopes
    description.modelVariables = [e for family in families.values() for e in family]
    structure = description.outputs, description.derivatives, description.initialUnknowns
    for unknowns in (*structure, description.eventIndicators):
        whole, unknowns[:] = list(unknowns), []
        for unknown in whole:
            if unknown.dependencies is not None:
                unknown.dependencies = [e for v in unknown.dependencies for e in families[id(v)]]
            for element in families[id(unknown.variable)]:
                unknowns.append(copy(unknown))
                unknowns[-1].variable = element
    return shapes


def _require_countable(description: ModelDescription) -> None:
    """Raise SetupError for arrays that are too large to name each element."""
    count = 0
    for v in description.modelVariables:
        count += (size := prod(v.shape or ()))
        if count > MOST_ELEMENTS:
            raise SetupError(
                f"has too many variables: {v.name} has {size} elements, and all arrays together may have "
                f"{MOST_ELEMENTS}"
            )


def _family(variable: ScalarVariable, said: Any) -> list[Element]:
    count = prod(variable.shape)
    places = [""]
    if variable.shape:
        indices = product(*(range(1, n + 1) for n in variable.shape))
        places = [f"[{','.join(map(str, index))}]" for index in indices]
    if variable.type in ("String", "Binary"):
        starts = [start.get("value", "") for start in said.findall("Start")]
    else:
        starts = (variable.start or "").split()
    starts = starts * count if len(starts) == 1 else starts or [None] * count
    if len(starts) != count:
        raise SetupError(
            f"is not a valid FMU: {variable.name} has {count} elements and {len(starts)} start values"
        )
    family = [Element(variable, *each, said) for each in zip(places, starts)]
    for element in family:
        element.family = family
    return family
