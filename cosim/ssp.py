"""A System as .ssp (System Structure and Parameterization 1.0), for every other tool."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from .system import Network, Port, System, Value, Wire, connect

STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"
NAMESPACES = {
    "ssd": f"{STANDARD}Description",
    "ssc": f"{STANDARD}Common",
    "ssv": f"{STANDARD}ParameterValues",
}


def write_ssp(system: System, path: Path, stop: float | None = None) -> None:
    """Write the system with its FMUs, wires and start values; `stop` [s] as default experiment.

    Factors, offsets and unit conversions of the wires become linear transformations, which stand in
    for the reading tool's own unit conversion. Raises what `connect` raises.
    """
    network = connect(system)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", _structure(network, path.stem, stop))
        for fmu in dict.fromkeys(map(Path, system.parts.values())):
            archive.write(fmu, f"resources/{fmu.name}")


def _structure(network: Network, name: str, stop: float | None) -> bytes:
    for prefix, uri in NAMESPACES.items():
        ElementTree.register_namespace(prefix, uri)
    root = Element(_tag("ssd", "SystemStructureDescription"), name=name, version="1.0")
    whole = SubElement(root, _tag("ssd", "System"), name=name)
    elements = SubElement(whole, _tag("ssd", "Elements"))
    for part in network.system.parts:
        _component(elements, network, part)
    if network.wires:
        connections = SubElement(whole, _tag("ssd", "Connections"))
        for wire in network.wires:
            _connection(connections, wire)
    if stop is not None:
        SubElement(root, _tag("ssd", "DefaultExperiment"), startTime="0.0", stopTime=repr(stop))
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _tag(prefix: str, name: str) -> str:
    return f"{{{NAMESPACES[prefix]}}}{name}"


def _component(elements: Element, network: Network, part: str) -> None:
    source = f"resources/{Path(network.system.parts[part]).name}"
    component = SubElement(elements, _tag("ssd", "Component"), name=part, source=source)
    ports = dict.fromkeys(port for wire in network.wires for port in wire[:2] if port.part == part)
    if ports:
        connectors = SubElement(component, _tag("ssd", "Connectors"))
        for port in ports:
            kind = str(port.variable.causality)
            connector = SubElement(
                connectors, _tag("ssd", "Connector"), name=port.variable.name, kind=kind
            )
            connector.append(_type("ssc", port))
    start = [(port, value) for port, value in network.start if port.part == part]
    if start:
        bindings = SubElement(component, _tag("ssd", "ParameterBindings"))
        binding = SubElement(bindings, _tag("ssd", "ParameterBinding"))
        values = SubElement(binding, _tag("ssd", "ParameterValues"))
        settings = SubElement(values, _tag("ssv", "ParameterSet"), name="start", version="1.0")
        parameters = SubElement(settings, _tag("ssv", "Parameters"))
        for port, value in start:
            _parameter(parameters, port, value)


def _type(prefix: str, port: Port) -> Element:
    element = Element(_tag(prefix, port.type))
    if port.type == "Enumeration":
        element.set("name", port.variable.declaredType.name)
    return element


def _parameter(parameters: Element, port: Port, value: Value) -> None:
    parameter = SubElement(parameters, _tag("ssv", "Parameter"), name=port.variable.name)
    if port.type == "Boolean":
        text = "true" if value else "false"
    elif port.type == "Enumeration":
        items = port.variable.declaredType.items
        text = next(str(item.name) for item in items if int(item.value) == value)
    else:
        text = str(value)
    parameter.append(_type("ssv", port))
    parameter[0].set("value", text)


def _connection(connections: Element, wire: Wire) -> None:
    ends = {
        "startElement": wire.source.part,
        "startConnector": wire.source.variable.name,
        "endElement": wire.target.part,
        "endConnector": wire.target.variable.name,
    }
    if (wire.factor, wire.offset) == (1.0, 0.0):
        SubElement(connections, _tag("ssd", "Connection"), ends)
        return
    connection = SubElement(
        connections, _tag("ssd", "Connection"), ends | {"suppressUnitConversion": "true"}
    )
    factor, offset = repr(wire.factor), repr(wire.offset)
    SubElement(connection, _tag("ssc", "LinearTransformation"), factor=factor, offset=offset)
