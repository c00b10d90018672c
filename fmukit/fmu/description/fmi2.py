"""modelDescription.xml from the declarations of a component."""

from __future__ import annotations

import os
from datetime import datetime, timezone
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from ... import VERSION
from ...declare.interface import Interface, Variable, class_name, title
from ...declare.record import Declaration
from ..load import project_metadata


class Flavour(NamedTuple):
    """What one way to make an FMU of a component can do, and how it reports failures."""

    tool: str
    needs_tool: bool
    derivatives: bool
    failure: str

    @property
    def stepping(self) -> dict[str, str]:
        """The attributes of CoSimulation."""
        return self.abilities | {
            "canHandleVariableCommunicationStepSize": "true",
            "canInterpolateInputs": boolean(self.derivatives),
            "maxOutputDerivativeOrder": str(int(self.derivatives)),
            "canRunAsynchronuously": "false",
        }

    @property
    def abilities(self) -> dict[str, str]:
        """The attributes of CoSimulation and of ModelExchange."""
        return {
            "needsExecutionTool": boolean(self.needs_tool),
            "canBeInstantiatedOnlyOncePerProcess": "false",
            "canNotUseMemoryManagementFunctions": boolean(self.needs_tool),
            "canGetAndSetFMUstate": "true",
            "canSerializeFMUstate": "true",
            "providesDirectionalDerivative": boolean(self.derivatives),
        }

    @property
    def log_categories(self) -> dict[str, str]:
        """The categories of messages and their meaning."""
        return {
            "logStatusWarning": "Unusual, but it can be simulated",
            self.failure: "Why a call failed",
            "logAll": "All messages",
        }


def boolean(value: bool) -> str:
    """A Boolean as XML writes it."""
    return "true" if value else "false"


PYTHON = Flavour("PythonFMU 0.7.0", True, False, "logStatusFatal")
NATIVE = Flavour(f"build_fmus.py {VERSION}", False, True, "logStatusError")


def to_xml(
    interface: Interface, guid: str, flavour: Flavour, indicators: int | None = None
) -> Element:
    """The FMI 2.0 model description of a component with this guid.

    With a number of event `indicators` it is for model exchange, too.
    """
    model, exchange = interface.model, indicators is not None
    attributes = {
        "fmiVersion": "2.0",
        "modelName": class_name(model),
        "guid": guid,
        "description": title(model),
        **project_metadata(model),
        "generationTool": flavour.tool,
        "variableNamingConvention": "structured",
    }
    root = Element("fmiModelDescription", attributes)
    variables = interface.variables + (interface.rates if exchange else [])
    if "SOURCE_DATE_EPOCH" in os.environ:
        date = datetime.fromtimestamp(int(os.environ["SOURCE_DATE_EPOCH"]), timezone.utc)
        root.set("generationDateAndTime", date.strftime("%Y-%m-%dT%H:%M:%SZ"))
    identifier = {"modelIdentifier": class_name(model)}
    if exchange:
        root.set("numberOfEventIndicators", str(indicators))
        needless = {"completedIntegratorStepNotNeeded": boolean(not indicators)}
        SubElement(root, "ModelExchange", identifier | flavour.abilities | needless)
    SubElement(root, "CoSimulation", identifier | flavour.stepping)
    _units(root, variables)
    _types(root, interface)
    categories = SubElement(root, "LogCategories")
    for name, meaning in flavour.log_categories.items():
        SubElement(categories, "Category", name=name, description=meaning)
    experiment = model.EXPERIMENT
    SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(experiment.stop),
        stepSize=repr(experiment.step),
    )
    elements = SubElement(root, "ModelVariables")
    for variable in variables:
        elements.append(_scalar_variable(variable))
    if exchange:
        for state, element in zip(interface.continuous, elements[interface.derivatives]):
            element[0].set("derivative", str(state.reference + 1))
    _structure(root, interface, exchange)
    return root


def _units(root: Element, variables: list[Variable]) -> None:
    quantities = {
        v.declaration.quantity.unit: v.declaration.quantity
        for v in variables
        if v.declaration.quantity
    }
    if not quantities:
        return
    definitions = SubElement(root, "UnitDefinitions")
    for unit, quantity in quantities.items():
        element = SubElement(definitions, "Unit", name=unit)
        exponents = {base: str(power) for base, power in quantity.exponents.items()}
        SubElement(element, "BaseUnit", exponents)
        if quantity.display:
            SubElement(
                element,
                "DisplayUnit",
                name=quantity.display.unit,
                factor=repr(quantity.display.factor),
            )


def _types(root: Element, interface: Interface) -> None:
    enumerations = {e for v in interface.variables if (e := v.declaration.items)}
    if not enumerations:
        return
    definitions = SubElement(root, "TypeDefinitions")
    for items in sorted(enumerations, key=lambda e: e.__name__):
        simple = SubElement(
            definitions,
            "SimpleType",
            name=items.__name__,
            description=_enumeration_description(items),
        )
        enumeration = SubElement(simple, "Enumeration")
        for item in items:
            SubElement(enumeration, "Item", name=item.name, value=str(item.value))


def _enumeration_description(items: type) -> str:
    lines = (items.__doc__ or "").strip().splitlines()
    if not lines:
        raise TypeError(f'{items.__name__} has no docstring: write """What its values are""" in it')
    return lines[0].rstrip(".")


def _scalar_variable(variable: Variable) -> Element:
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.declaration.meaning,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.initial:
        attributes["initial"] = variable.initial
    element = Element("ScalarVariable", attributes)
    SubElement(element, variable.declaration.fmi_type, _typed(variable, variable.declaration))
    return element


def _typed(variable: Variable, declaration: Declaration) -> dict[str, str]:
    attributes: dict[str, str] = {}
    if declaration.items:
        attributes["declaredType"] = declaration.items.__name__
    quantity = declaration.quantity
    if quantity:
        attributes |= {"quantity": quantity.name, "unit": quantity.unit}
        if quantity.display:
            attributes["displayUnit"] = quantity.display.unit
    for name in ("min", "max", "nominal"):
        bound = getattr(declaration, name)
        if bound is not None:
            attributes[name] = repr(float(bound))
    if declaration.items:
        attributes["min"], attributes["max"] = (
            str(min(declaration.items)),
            str(max(declaration.items)),
        )
    if variable.settable_before_start:
        attributes["start"] = start_text(declaration)
    return attributes


def start_text(declaration: Declaration) -> str:
    """The start value as XML writes it; floats with all their digits."""
    value = declaration.start
    if declaration.fmi_type == "Boolean":
        return boolean(bool(value))
    return str(int(value)) if declaration.items else str(value)


def _structure(root: Element, interface: Interface, exchange: bool) -> None:
    structure = SubElement(root, "ModelStructure")
    states, rates = (interface.continuous, interface.rates) if exchange else ([], [])
    inputs = interface.variables[interface.inputs]
    outputs = [(v, interface.feedthrough(v)) for v in interface.variables[interface.states]]
    calculated = [(v, interface.feedthrough(v)) for v in interface.variables[interface.outputs]]
    exact = [v for v in interface.variables if v.initial == "exact"]
    unknowns = [*outputs, *calculated, *((v, inputs) for v in rates)]
    for name, entries in (
        ("Outputs", outputs + [(v, causes + states) for v, causes in calculated]),
        ("Derivatives", [(v, inputs + states) for v in rates]),
        (
            "InitialUnknowns",
            [(v, exact + causes) for v, causes in unknowns if v.initial == "calculated"],
        ),
    ):
        part = SubElement(structure, name) if entries else structure
        for variable, causes in entries:
            indices = " ".join(str(index) for index in sorted(v.reference + 1 for v in causes))
            element = {"index": str(variable.reference + 1), "dependencies": indices}
            SubElement(part, "Unknown", element)
