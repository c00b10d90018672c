"""Parameter sets (SSV) with their mappings (SSM): values by the name they are applied to."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ...errors import SetupError
from ...numbers import truth
from ...system import READ, Value, enumeration
from ...system.base_units import Unit
from ...system.description import Variable
from .files import Element, children, local_name, qualified, require_root
from .rules import load_valid
from .units import Definitions, Step, definitions

Locate = Callable[[str, str], Path]
log = logging.getLogger("cosim")
TABLE = "MappingTransformation"
TAKES_INTEGERS = ("Real", "Enumeration")


class Parameter(NamedTuple):
    """A value, an enumeration's as item name, and the linear step it takes before it is applied."""

    where: str
    name: str
    type: str
    value: Value
    unit: Unit | None
    step: Step = Step("", None)

    def fit(self, variable: Variable) -> Value:
        """The value for a variable, not yet scaled; raises SetupError for a wrong type or item."""
        kind = str(variable.type)
        scaled = (self.step.factor, self.step.offset) != (1.0, 0.0)
        fitting = self.type == kind or (self.type == "Integer" and kind in TAKES_INTEGERS)
        if not fitting or (scaled and kind != "Real"):
            actual = "a linear transformation" if scaled else self.type
            raise SetupError(f"{self.where}: {actual} does not fit {variable.name} of type {kind}")
        if self.type != "Enumeration":
            return self.value
        items = enumeration(variable)
        if self.value not in items:
            choices = ", ".join(items)
            raise SetupError(f"{self.where}: {self.value!r} must be one of {choices}")
        return items[str(self.value)]


def bound(binding: Element, file: str, outer: Definitions, locate: Locate) -> list[Parameter]:
    """The parameters of a ParameterBinding under the names they are applied to.

    Raises SetupError for what is invalid or not supported.
    """
    _require_type(binding, "application/x-ssp-parameter-set", file)
    inline = children(binding, "ssd:ParameterValues", "*")
    source, values = _content(binding, inline, "ssv:ParameterSet", file, locate)
    defined = definitions(values)
    if source == file:
        defined = defined.over(outer)
    parameters = parameters_of(values, binding.get("prefix", ""), source, defined)
    for mapping in children(binding, "ssd:ParameterMapping"):
        _require_type(mapping, "application/x-ssp-parameter-mapping", file)
        source, entries = _content(
            mapping, children(mapping, "ssm:*"), "ssm:ParameterMapping", file, locate
        )
        return _mapped(parameters, entries, source)
    return list(parameters.values())


def parameters_of(
    values: Element, prefix: str, source: str, defined: Definitions
) -> dict[str, Parameter]:
    """The parameters of a ParameterSet by name."""
    elements = children(values, "ssv:Parameters", "ssv:Parameter")
    parameters = (_parameter(element, prefix, source, defined) for element in elements)
    return {parameter.name: parameter for parameter in parameters}


def _require_type(element: Element, expected: str, file: str) -> None:
    if element.get("type", expected) != expected:
        where = f"{file}, line {element.sourceline}"
        raise SetupError(f"{where}: type {element.get('type')!r} is not supported")


def _content(
    element: Element, inline: list[Element], tag: str, file: str, locate: Locate
) -> tuple[str, Element]:
    """Name of the file and element of what is given by the `source` attribute or inline."""
    if element.get("source"):
        path = locate(element.get("source"), element.get("sourceBase", "SSD"))
        return path.name, load_valid(path, tag)
    where = f"{file}, line {element.sourceline}"
    if len(inline) != 1:
        raise SetupError(f"{where}: one {tag} or a source is needed")
    require_root(inline[0], qualified(tag), where)
    return file, inline[0]


def _parameter(element: Element, prefix: str, source: str, defined: Definitions) -> Parameter:
    name = prefix + element.get("name")
    where = f"{source}, line {element.sourceline}: parameter {name}"
    content = next(element.iterchildren("*"))
    kind = local_name(content)
    if kind not in READ:
        raise SetupError(f"{where}: type {kind} is not supported")
    try:
        value = READ[kind](content.get("value"))
    except ValueError as error:  # what the schema permits, such as 1e400
        raise SetupError(f"{where}: {error}") from None
    items = defined.items.get(content.get("name")) if kind == "Enumeration" else None
    if items and value not in items:
        raise SetupError(f"{where}: {value!r} must be one of {', '.join(items)}")
    return Parameter(where, name, kind, value, defined.unit(content.get("unit")))


def _mapped(parameters: dict[str, Parameter], mapping: Element, source: str) -> list[Parameter]:
    mapped: dict[str, Parameter] = {}
    entries = children(mapping, "ssm:MappingEntry")
    named = [entry for entry in entries if entry.get("source")]
    if len(named) < len(entries):
        log.warning("%s: %d entries without a source", source, len(entries) - len(named))
    for entry in named:
        name, target = entry.get("source"), entry.get("target")
        where = f"{source}, line {entry.sourceline}: mapping {name} -> {target}"
        if name not in parameters:
            raise SetupError(f"{where}: the parameter set has no {name}")
        mapped[target] = _transformed(parameters[name]._replace(name=target), entry, where)
    return list(mapped.values())


def _transformed(parameter: Parameter, entry: Element, where: str) -> Parameter:
    parameter = parameter._replace(step=linear(entry, where))
    for table in children(entry, "ssc:*"):
        tag, kind = local_name(table), local_name(table).removesuffix(TABLE)
        if tag != f"{kind}{TABLE}":
            continue
        if parameter.type != kind:
            raise SetupError(f"{where}: {tag} does not fit a parameter of type {parameter.type}")
        rows = {
            READ[kind](row.get("source")): READ[kind](row.get("target"))
            for row in children(table, "ssc:MapEntry")
        }
        if parameter.value not in rows:
            raise SetupError(f"{where}: there is no entry for {parameter.value!r}")
        return parameter._replace(value=rows[parameter.value])
    return parameter


def linear(element: Element, where: str) -> Step:
    """The linear step of a mapping entry or a connection."""
    suppressed = truth(element.get("suppressUnitConversion", "false"))
    scale = element.find(qualified("ssc:LinearTransformation"))
    coefficients = (
        {} if scale is None else {key: float(value) for key, value in scale.attrib.items()}
    )
    return Step(
        where,
        None,
        not suppressed,
        coefficients.get("factor", 1.0),
        coefficients.get("offset", 0.0),
    )
