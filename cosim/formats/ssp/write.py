"""Write a System as .ssp, for other tools."""

from __future__ import annotations

import logging
import zipfile
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from urllib.parse import quote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ...errors import SetupError
from ...system import (
    Connection,
    Network,
    Port,
    System,
    Value,
    Wire,
    connect_for_export,
    enumeration,
)
from .files import BOND, FMU, NAMESPACES, ROOT_SSD, qualified

OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"

#: A convention of OMSimulator: its Python API gives this name to the master of all parts that name none.
OMS_MASTER = "oms_ma_default"

#: A convention of OMSimulator: the relative tolerance of a system that states none.
OMS_TOLERANCE = 1e-4

#: A convention of SSP 2.0, which defines the two of each pair alike; OMSimulator's program knows the older.
OLDER = {"Float64": "Real", "Int32": "Integer"}

Enumerations = dict[str, dict[str, int]]
log = logging.getLogger("cosim")


def write_ssp(
    system: System,
    path: Path,
    stop: float | None = None,
    start: float = 0.0,
    step: float | None = None,
) -> None:
    """Write a system with its FMUs, wires, start values and bonds as an .ssp.

    A system with an FMU of FMI 3.0 is written as SSP 2.0, any other as SSP 1.0. Factors, offsets and
    unit conversions of the wires become linear transformations, which replace the reading tool's own
    unit conversion. A dotted part name is written unchanged as the name of a component. The step is
    annotated for libcosim and OMSimulator, the bonds in an annotation of our own.

    Parameters
    ----------
    system : System
        What is written.
    path : Path
        The file.
    stop : float, optional
        The stop time of the default experiment [s].
    start : float
        Its start time [s].
    step : float, optional
        The communication step [s]. OMSimulator needs one: without it, it gets the shortest step that
        an FMU prefers.

    Raises
    ------
    SetupError
        What `connect` raises, and for sums of wires, inputs over time, an enumeration value that has no
        name, and a Binary start value. No file is written then.
    """
    network = connect_for_export(system, "an .ssp")
    files = archived(network)
    has_fmi3 = any(d.fmiVersion == "3.0" for d in network.descriptions.values())
    task = SspContent(network, files, "2.0" if has_fmi3 else "1.0")
    structure = _structure(task, path.stem, (start, stop, step))
    with TemporaryDirectory(dir=path.parent, prefix=f".{path.stem}_") as folder:
        package = Path(folder) / path.name
        with zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(ROOT_SSD, structure)
            for fmu, name in files.items():
                archive.write(fmu, f"resources/{name}")
        package.replace(path)


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


class SspContent(NamedTuple):
    """What is written: a network and its files, in the types of which version."""

    network: Network
    files: dict[Path, str]
    version: str

    def element(self, port: Port) -> WrittenVariable:
        """The variable of the FMU that a port is or is an element of."""
        name = port.variable.name
        base, _, indices = name.rpartition("[")
        shape = self.network.fmus[port.part].shapes.get(base)
        if shape is None:
            return WrittenVariable(port.part, name)
        return WrittenVariable(
            port.part, base, shape, tuple(map(int, indices.rstrip("]").split(",")))
        )


class WrittenVariable(NamedTuple):
    """A variable of an FMU and, of an array, its dimensions and the indices of one element from 1."""

    part: str
    name: str
    shape: tuple[int, ...] = ()
    indices: tuple[int, ...] = ()

    @property
    def unindexed(self) -> WrittenVariable:
        """The variable without the indices."""
        return self._replace(indices=())


def _structure(
    task: SspContent, name: str, times: tuple[float, float | None, float | None]
) -> bytes:
    for prefix, uri in {**NAMESPACES, "osp": OSP, "oms": OMS, "cosim": "urn:cosim"}.items():
        ElementTree.register_namespace(prefix, uri)
    network, (start, stop, step) = task.network, times
    root = Element(qualified("ssd:SystemStructureDescription"), name=name, version=task.version)
    system = SubElement(root, qualified("ssd:System"), name=name)
    enumerations: Enumerations = {}
    if network.system.connectors:
        outer = SubElement(system, qualified("ssd:Connectors"))
        for connector in network.system.connectors:
            port = network.behind(connector)[0][0]
            kind = {"name": connector, "kind": str(port.variable.causality)}
            SubElement(outer, qualified("ssd:Connector"), kind).append(
                _type("ssc", port, enumerations)
            )
    elements = SubElement(system, qualified("ssd:Elements"))
    for part in network.system.parts:
        _component(elements, task, part, enumerations)
    if network.wires or network.system.connectors:
        connections = SubElement(system, qualified("ssd:Connections"))
        _connections(connections, task)
        for connector, wires in network.system.connectors.items():
            for wire in wires:
                sides = (
                    connector if name == connector else task.element(network.port(name))
                    for name in wire[:2]
                )
                _connection(connections, wire, *sides, converts=False)
    notes = Element(qualified("ssd:Annotations"))
    _omsimulator(notes, network, step)
    if network.system.bonds:
        note = SubElement(notes, qualified("ssc:Annotation"), type="cosim")
        for bond in network.system.bonds:
            SubElement(note, BOND).text = bond
    if len(notes):
        system.append(notes)
    _enumerations(root, "ssd", enumerations)
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


def _omsimulator(notes: Element, network: Network, step: float | None) -> None:
    """The master with a fixed step, without which OMSimulator reads no file.

    Its C++ program reads the child element, its Python API the attributes of the parent.
    """
    stated = [d.defaultExperiment for d in network.descriptions.values()]
    if step is None:
        preferred = [x.step for x in stated if x.step]
        if not preferred:
            log.warning("no step is given and no FMU prefers one: OMSimulator cannot read the .ssp")
            return
        step = min(preferred)
    tolerances = [x.tolerance for x in stated if x.tolerance]
    tolerance = repr(min(tolerances, default=OMS_TOLERANCE))
    note = SubElement(notes, qualified("ssc:Annotation"), type="org.openmodelica")
    information = SubElement(
        SubElement(note, f"{{{OMS}}}Annotations"),
        f"{{{OMS}}}SimulationInformation",
        {"name": OMS_MASTER, "method": "oms_ma", "fixedStepSize": repr(step)},
        relativeTolerance=tolerance,
    )
    master = {"description": "oms-ma", "stepSize": repr(step), "relativeTolerance": tolerance}
    SubElement(information, f"{{{OMS}}}FixedStepMaster", master)


def _component(elements: Element, task: SspContent, part: str, enumerations: Enumerations) -> None:
    network = task.network
    source = f"resources/{quote(task.files[network.fmus[part].path])}"
    component = SubElement(elements, qualified("ssd:Component"), name=part, type=FMU, source=source)
    ends = [port for wire in network.wires for port in wire[:2] if port.part == part]
    outer = (end[0] for name in network.system.connectors for end in network.behind(name))
    ends += [port for port in outer if port.part == part]
    if ports := {task.element(port).unindexed: port for port in reversed(ends)}:
        connectors = SubElement(component, qualified("ssd:Connectors"))
        for variable, port in reversed(ports.items()):
            kind = {"name": variable.name, "kind": str(port.variable.causality)}
            connector = SubElement(connectors, qualified("ssd:Connector"), kind)
            connector.append(_type("ssc", port, enumerations))
            _dimensions(connector, variable)
    _start_values(component, task, part)


def _start_values(component: Element, task: SspContent, part: str) -> None:
    """The start values of a part as a parameter set; raises SetupError for a Binary."""
    variables: dict[WrittenVariable, list[tuple[Port, Value]]] = {}
    for port, value in task.network.start:
        if port.part != part:
            continue
        if port.type != "Binary":
            variables.setdefault(task.element(port).unindexed, []).append((port, value))
        elif value != port.variable.start:
            raise SetupError(f"{port} = {value!r}: a Binary cannot be written to an .ssp")
    if not variables:
        return
    bindings = SubElement(component, qualified("ssd:ParameterBindings"))
    binding = SubElement(bindings, qualified("ssd:ParameterBinding"))
    values = SubElement(binding, qualified("ssd:ParameterValues"))
    version = {"name": "start", "version": task.version}
    settings = SubElement(values, qualified("ssv:ParameterSet"), version)
    parameters = SubElement(settings, qualified("ssv:Parameters"))
    named: Enumerations = {}
    for variable, start in variables.items():
        _parameter(parameters, task, variable, start, named)
    _enumerations(settings, "ssv", named)


def _type(prefix: str, port: Port, enumerations: Enumerations) -> Element:
    """The element of a port's type; an enumeration becomes known, under a name of its own."""
    element = Element(qualified(f"{prefix}:{OLDER.get(port.native, port.native)}"))
    if port.type == "Enumeration":
        declared = port.variable.declaredType
        name, items = declared.name if declared else "", enumeration(port.variable)
        while enumerations.setdefault(name, items) != items:
            name += "_"
        element.set("name", name)
    return element


def _dimensions(parent: Element, variable: WrittenVariable) -> None:
    for size in variable.shape:
        SubElement(parent, qualified("ssc:Dimension"), size=str(size))


def _enumerations(parent: Element, prefix: str, items_by_name: Enumerations) -> None:
    if not items_by_name:
        return
    container = SubElement(parent, qualified(f"{prefix}:Enumerations"))
    for name, items in items_by_name.items():
        enumeration = SubElement(container, qualified("ssc:Enumeration"), name=name)
        for item, value in items.items():
            SubElement(enumeration, qualified("ssc:Item"), name=item, value=str(value))


def _parameter(
    parameters: Element,
    task: SspContent,
    variable: WrittenVariable,
    start: list[tuple[Port, Value]],
    enumerations: Enumerations,
) -> None:
    """The start value of a variable; the elements of an array that have none keep that of the FMU."""
    parameter = SubElement(parameters, qualified("ssv:Parameter"), name=variable.name)
    parameter.append(_type("ssv", start[0][0], enumerations))
    if not variable.shape:
        parameter[0].set("value", _text(*start[0]))
        return
    values = {port.name: (port, value) for port, value in start}
    _, elements = task.network.array((variable.part, variable.name))
    texts = [
        _text(*values[port.name]) if port.name in values else str(port.variable.start)
        for port in elements
    ]
    if start[0][0].type in ("String", "Enumeration"):
        for text in texts:
            SubElement(parameter[0], qualified("ssv:Value"), value=text)
    else:
        parameter[0].set("value", " ".join(texts))
    _dimensions(parameter, variable)


def _text(port: Port, value: Value) -> str:
    """A start value as a parameter set spells it; raises SetupError for an item without a name."""
    if port.type != "Enumeration":
        return port.xml_text(value)
    for item, number in enumeration(port.variable).items():
        if number == value:
            return item
    declared = port.variable.declaredType
    raise SetupError(f"{port} = {value!r} has no name in {declared.name if declared else 'it'}")


def scaled(wire: Connection | Wire) -> bool:
    """Whether it changes the numbers that it carries."""
    return (wire.factor, wire.offset) != (1.0, 0.0)


def _connections(connections: Element, task: SspContent) -> None:
    """The wires, those between all elements of two arrays as one connection."""
    arrays: dict[tuple[WrittenVariable, WrittenVariable, float, float], list[Connection]] = {}
    for wire in task.network.wires:
        source, target = task.element(wire.source), task.element(wire.target)
        key = (source.unindexed, target.unindexed, wire.factor, wire.offset)
        arrays.setdefault(key, []).append(wire)
    for (source, target, *_), wires in arrays.items():
        elements = [(task.element(wire.source), task.element(wire.target)) for wire in wires]
        straight = all(start.indices == end.indices for start, end in elements)
        if straight and source.shape == target.shape and len(wires) == prod(source.shape):
            wires, elements = wires[:1], [(source, target)]
        else:
            log.warning(
                "%s -> %s: the indices of elements count from 1; SSP 2.0 does not say where to begin",
                *(f"{variable.part}.{variable.name}" for variable in (source, target)),
            )
        for wire, ends in zip(wires, elements):
            converts = not scaled(wire) and wire.source.unit == wire.target.unit
            _connection(connections, wire, *ends, converts=converts)


def _connection(
    connections: Element,
    wire: Connection | Wire,
    start: WrittenVariable | str,
    end: WrittenVariable | str,
    *,
    converts: bool,
) -> None:
    """Numbers as our master makes them, between variables or connectors of the system, which are texts."""
    ends: dict[str, str] = {}
    for word, of in (("start", start), ("end", end)):
        if isinstance(of, str):
            ends[f"{word}Connector"] = of
            continue
        ends |= {f"{word}Element": of.part, f"{word}Connector": of.name}
        if of.indices:
            ends[f"{word}Indices"] = " ".join(map(str, of.indices))
    if not converts:
        ends["suppressUnitConversion"] = "true"
    connection = SubElement(connections, qualified("ssd:Connection"), ends)
    if scaled(wire):
        factor, offset = repr(wire.factor), repr(wire.offset)
        SubElement(connection, qualified("ssc:LinearTransformation"), factor=factor, offset=offset)
