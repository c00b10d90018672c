"""A System as OSP system structure, for libcosim and the tools around it."""

from __future__ import annotations

import shutil
from pathlib import Path
from urllib.parse import quote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..errors import SetupError
from ..system import Connection, Network, Port, System, Value, still
from .ssp.write import archived

NAMESPACE = "http://opensimulationplatform.com/MSMI/OSPSystemStructure"
FILE = "OspSystemStructure.xml"


def write_osp(
    system: System, folder: Path, *, step: float, start: float = 0.0, stop: float | None = None
) -> None:
    """Write OspSystemStructure.xml and the FMUs into `folder`; step, start and stop in s.

    Factors, offsets and unit conversions of wires become linear transformations. Raises what
    `connect` raises, and SetupError for what libcosim cannot do: enumerations that differ from the
    FMU's start value, and enumerations on wires. Then nothing is written.
    """
    if not 0.0 < step < float("inf"):
        raise SetupError(f"step = {step!r} s must be above 0")
    network = still(system, "an OSP system structure")
    files = archived(network)
    structure = _structure(network, files, step, start, stop)
    folder.mkdir(parents=True, exist_ok=True)
    for fmu, name in files.items():
        shutil.copyfile(fmu, folder / name)
    (folder / FILE).write_bytes(structure)


def _structure(
    network: Network, files: dict[Path, str], step: float, start: float, stop: float | None
) -> bytes:
    root = Element("OspSystemStructure", xmlns=NAMESPACE, version="0.1")
    SubElement(root, "StartTime").text = repr(start)
    if stop is not None:
        SubElement(root, "EndTime").text = repr(stop)
    SubElement(root, "BaseStepSize").text = repr(step)
    SubElement(root, "Algorithm").text = "fixedStep"
    simulators = SubElement(root, "Simulators")
    for part, fmu in network.system.parts.items():
        simulator = SubElement(simulators, "Simulator", name=part, source=quote(files[Path(fmu)]))
        initial = SubElement(simulator, "InitialValues")
        for port, value in network.start:
            if port.part == part:
                _initial(initial, port, value)
    functions, connections = Element("Functions"), Element("Connections")
    for number, wire in enumerate(network.wires, 1):
        _connection(functions, connections, wire, f"wire{number}")
    root.extend(group for group in (functions, connections) if len(group))
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _initial(values: Element, port: Port, value: Value) -> None:
    if port.type == "Enumeration":
        if str(value) == port.variable.start:
            return
        raise SetupError(f"{port} = {value!r}: libcosim cannot set an Enumeration")
    initial = SubElement(values, "InitialValue", variable=port.variable.name)
    text = ("true" if value else "false") if port.type == "Boolean" else str(value)
    SubElement(initial, port.type, value=text)


def _connection(functions: Element, connections: Element, wire: Connection, name: str) -> None:
    if wire.source.type == "Enumeration":
        raise SetupError(f"{wire.source} -> {wire.target}: libcosim cannot wire an Enumeration")
    if (wire.factor, wire.offset) == (1.0, 0.0):
        connection = SubElement(connections, "VariableConnection")
        for port in (wire.source, wire.target):
            _variable(connection, port)
        return
    factor, offset = repr(wire.factor), repr(wire.offset)
    SubElement(functions, "LinearTransformation", name=name, factor=factor, offset=offset)
    for port, signal in ((wire.source, "in"), (wire.target, "out")):
        connection = SubElement(connections, "SignalConnection")
        SubElement(connection, "Signal", function=name, name=signal)
        _variable(connection, port)


def _variable(connection: Element, port: Port) -> None:
    SubElement(connection, "Variable", simulator=port.part, name=port.variable.name)
