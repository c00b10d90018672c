"""modelDescription.xml of FMI 3.0 from that of FMI 2.0: the same variables under the same references."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree.ElementTree import Element, SubElement

TYPES = {"Real": "Float64", "Integer": "Int32"}
STRUCTURE = {
    "Outputs": "Output",
    "Derivatives": "ContinuousStateDerivative",
    "InitialUnknowns": "InitialUnknown",
}


def to_fmi3(old: Element) -> Element:
    """The description of a native FMU, with its event indicators as variables, and time."""
    root = Element("fmiModelDescription", old.attrib | {"fmiVersion": "3.0"})
    root.set("instantiationToken", root.attrib.pop("guid"))
    indicators = int(root.attrib.pop("numberOfEventIndicators", "0"))
    for part in old:
        if part.tag in ("ModelExchange", "CoSimulation"):
            SubElement(root, part.tag, _abilities(part, indicators))
        elif part.tag == "TypeDefinitions":
            types = SubElement(root, part.tag)
            for simple in part:
                SubElement(types, "EnumerationType", simple.attrib).extend(simple[0])
        elif part.tag == "ModelVariables":
            first = len(part)
            variables = SubElement(root, part.tag)
            variables.extend(_variable(scalar) for scalar in part)
            variables.extend(_indicators_and_time(first, indicators))
        elif part.tag == "ModelStructure":
            structure = SubElement(root, part.tag)
            for group in part:
                for unknown in group:
                    SubElement(structure, STRUCTURE[group.tag], _unknown(unknown))
            for index in range(indicators):
                SubElement(structure, "EventIndicator", valueReference=str(first + index))
        else:
            root.append(part)
    return root


def _abilities(kind: Element, indicators: int) -> dict[str, str]:
    """What either kind of instance can do."""
    events = str(indicators > 0).lower()
    copied = ("modelIdentifier", "needsExecutionTool", "canBeInstantiatedOnlyOncePerProcess")
    same = {name: kind.attrib[name] for name in copied}
    same |= dict.fromkeys(
        ("canGetAndSetFMUState", "canSerializeFMUState", "providesDirectionalDerivatives"), "true"
    )
    if kind.tag == "ModelExchange":
        return same | {"needsCompletedIntegratorStep": events}
    return same | {
        "canHandleVariableCommunicationStepSize": "true",
        "maxOutputDerivativeOrder": kind.attrib["maxOutputDerivativeOrder"],
        "providesIntermediateUpdate": "true",
        "mightReturnEarlyFromDoStep": events,
        "canReturnEarlyAfterIntermediateUpdate": "true",
        "hasEventMode": "true",
    }


def _variable(scalar: Element) -> Element:
    typed = scalar[0]
    element = Element(TYPES.get(typed.tag, typed.tag), scalar.attrib | typed.attrib)
    moves = scalar.get("variability", "continuous") == "continuous"
    if typed.tag == "Real" and moves and scalar.get("causality") == "output":
        element.set("intermediateUpdate", "true")
    if "derivative" in element.attrib:
        element.set("derivative", _reference_of_index(element.attrib["derivative"]))
    return element


def _indicators_and_time(first: int, indicators: int) -> Iterator[Element]:
    """The event indicators and time, which FMI 2.0 does not count as variables."""
    for index in range(indicators):
        yield Element(
            "Float64",
            name=f"event_indicator_{index + 1}",
            valueReference=str(first + index),
            description="Event where it falls below zero",
            causality="local",
            variability="continuous",
            initial="calculated",
        )
    yield Element(
        "Float64",
        name="time",
        valueReference=str(first + indicators),
        description="Time in s",
        causality="independent",
        variability="continuous",
    )


def _unknown(unknown: Element) -> dict[str, str]:
    causes = map(_reference_of_index, unknown.attrib["dependencies"].split())
    return {
        "valueReference": _reference_of_index(unknown.attrib["index"]),
        "dependencies": " ".join(causes),
    }


def _reference_of_index(index: str) -> str:
    """The value reference of the variable with this index."""
    return str(int(index) - 1)
