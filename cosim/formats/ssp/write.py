"""Write a System as .ssp, for other tools."""

from __future__ import annotations

import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ...errors import SetupError
from ...system import Connection, Network, Port, System, Value, enumeration, still
from .files import BOND, NAMESPACES, qualified

OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
Enumerations = dict[str, dict[str, int]]


def write_ssp(
    system: System,
    path: Path,
    stop: float | None = None,
    start: float = 0.0,
    step: float | None = None,
) -> None:
    """Write the system with its FMUs, wires and start values; `start` and `stop` [s] as experiment.

    The communication step [s] goes into an OSP annotation, where libcosim finds it, and the bonds into
    one of our own.

    Factors, offsets and unit conversions of the wires become linear transformations, which replace the
    reading tool's own unit conversion. A dotted part name is written unchanged as the name of a
    component. Raises what `connect` raises, and SetupError for an enumeration value that has no name
    and for a Binary start value. No file is written then.
    """
    network = still(system, "an .ssp")
    files = archived(network)
    structure = _structure(network, files, path.stem, (start, stop, step))
    with TemporaryDirectory(dir=path.parent, prefix=f".{path.stem}_") as folder:
        whole = Path(folder) / path.name
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("SystemStructure.ssd", structure)
            for fmu, name in files.items():
                archive.write(fmu, f"resources/{name}")
        whole.replace(path)


def archived(network: Network) -> dict[Path, str]:
    """A file name of its own for each FMU."""
    files: dict[Path, str] = {}
    for fmu in dict.fromkeys(map(Path, network.system.parts.values())):
        name, count = fmu.name, 1
        while name in files.values():
            count += 1
            name = f"{fmu.stem}_{count}{fmu.suffix}"
        files[fmu] = name
    return files


def _structure(
    network: Network,
    files: dict[Path, str],
    name: str,
    times: tuple[float, float | None, float | None],
) -> bytes:
    for prefix, uri in {**NAMESPACES, "osp": OSP, "cosim": "urn:cosim"}.items():
        ElementTree.register_namespace(prefix, uri)
    root = Element(qualified("ssd:SystemStructureDescription"), name=name, version="1.0")
    whole = SubElement(root, qualified("ssd:System"), name=name)
    elements = SubElement(whole, qualified("ssd:Elements"))
    known: Enumerations = {}
    for part, fmu in network.system.parts.items():
        _component(elements, network, part, f"resources/{quote(files[Path(fmu)])}", known)
    if network.wires:
        connections = SubElement(whole, qualified("ssd:Connections"))
        for wire in network.wires:
            _connection(connections, wire)
    if network.system.bonds:
        notes = SubElement(whole, qualified("ssd:Annotations"))
        note = SubElement(notes, qualified("ssc:Annotation"), type="cosim")
        for bond in network.system.bonds:
            SubElement(note, BOND).text = bond
    _enumerations(root, "ssd", known)
    start, stop, step = times
    if (stop, step) != (None, None):
        ends = {"startTime": repr(start)} | ({} if stop is None else {"stopTime": repr(stop)})
        experiment = SubElement(root, qualified("ssd:DefaultExperiment"), ends)
        if step is not None:
            notes = SubElement(experiment, qualified("ssd:Annotations"))
            note = SubElement(notes, qualified("ssc:Annotation"), type="com.opensimulationplatform")
            algorithm = SubElement(note, f"{{{OSP}}}Algorithm")
            SubElement(algorithm, f"{{{OSP}}}FixedStepAlgorithm", baseStepSize=repr(step))
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _component(
    elements: Element, network: Network, part: str, source: str, known: Enumerations
) -> None:
    component = SubElement(elements, qualified("ssd:Component"), name=part, source=source)
    ports = dict.fromkeys(port for wire in network.wires for port in wire[:2] if port.part == part)
    if ports:
        connectors = SubElement(component, qualified("ssd:Connectors"))
        for port in ports:
            kind = str(port.variable.causality)
            given = {"name": port.variable.name, "kind": kind}
            connector = SubElement(connectors, qualified("ssd:Connector"), given)
            connector.append(_type("ssc", port, known))
    start = [(port, value) for port, value in network.start if port.part == part]
    for port, value in start:
        if port.type == "Binary" and value != port.variable.start:
            raise SetupError(f"{port} = {value!r}: a Binary cannot be written to an .ssp")
    start = [(port, value) for port, value in start if port.type != "Binary"]
    if start:
        bindings = SubElement(component, qualified("ssd:ParameterBindings"))
        binding = SubElement(bindings, qualified("ssd:ParameterBinding"))
        values = SubElement(binding, qualified("ssd:ParameterValues"))
        settings = SubElement(values, qualified("ssv:ParameterSet"), name="start", version="1.0")
        parameters = SubElement(settings, qualified("ssv:Parameters"))
        named: Enumerations = {}
        for port, value in start:
            _parameter(parameters, port, value, named)
        _enumerations(settings, "ssv", named)


def _type(prefix: str, port: Port, known: Enumerations) -> Element:
    """The element of a port's type; an enumeration becomes known, under a name of its own."""
    element = Element(qualified(f"{prefix}:{port.type}"))
    if port.type == "Enumeration":
        name, items = str(port.variable.declaredType.name), enumeration(port.variable)
        while known.setdefault(name, items) != items:
            name += "_"
        element.set("name", name)
    return element


def _enumerations(parent: Element, prefix: str, known: Enumerations) -> None:
    if not known:
        return
    enumerations = SubElement(parent, qualified(f"{prefix}:Enumerations"))
    for name, items in known.items():
        enumeration = SubElement(enumerations, qualified("ssc:Enumeration"), name=name)
        for item, value in items.items():
            SubElement(enumeration, qualified("ssc:Item"), name=item, value=str(value))


def _parameter(parameters: Element, port: Port, value: Value, known: Enumerations) -> None:
    parameter = SubElement(parameters, qualified("ssv:Parameter"), name=port.variable.name)
    text = port.text(value)
    if port.type == "Enumeration":
        items = enumeration(port.variable).items()
        names = [item for item, number in items if number == value]
        if not names:
            raise SetupError(f"{port} = {value!r} has no name in {port.variable.declaredType.name}")
        text = names[0]
    parameter.append(_type("ssv", port, known))
    parameter[0].set("value", text)


def scaled(wire: Connection) -> bool:
    """Whether it changes the numbers that it carries."""
    return (wire.factor, wire.offset) != (1.0, 0.0)


def _connection(connections: Element, wire: Connection) -> None:
    """Numbers as our master makes them: no reading tool is to convert units once more."""
    ends = {"startElement": wire.source.part, "startConnector": wire.source.variable.name}
    ends |= {"endElement": wire.target.part, "endConnector": wire.target.variable.name}
    if scaled(wire) or wire.source.unit != wire.target.unit:
        ends["suppressUnitConversion"] = "true"
    connection = SubElement(connections, qualified("ssd:Connection"), ends)
    if scaled(wire):
        factor, offset = repr(wire.factor), repr(wire.offset)
        SubElement(connection, qualified("ssc:LinearTransformation"), factor=factor, offset=offset)
