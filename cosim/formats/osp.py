"""Read and write a System as an OSP system structure, the format of libcosim and its tools."""

from __future__ import annotations

import logging
import math
import shutil
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import count, takewhile
from os.path import normpath
from pathlib import Path
from urllib.parse import quote, unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..engine.energy import declared_bond
from ..errors import SetupError, pluralize
from ..files import replacement
from ..numbers import real, whole
from ..system import (
    READ,
    Connection,
    Network,
    Port,
    System,
    Value,
    Wire,
    connect,
    connect_for_export,
    describe_fmu,
    require_fmi2,
)
from .ssp.files import LINK, Budget, load, local_name, locate, require_root
from .ssp.files import Element as SourceElement
from .ssp.parameters import Parameter
from .ssp.plan import Connector, FlatSystem, Flow, Node, dotted
from .ssp.read import Package
from .ssp.units import Step, chain
from .ssp.write import archived, scaled

NAMESPACE = "http://opensimulationplatform.com/MSMI/OSPSystemStructure"
FILE = "OspSystemStructure.xml"
TIMES = ("StartTime", "EndTime", "BaseStepSize")
HOLDERS = ("OspSystemStructure", "Simulators", "InitialValues", "Functions", "Connections")
CONTENTS = (
    "Algorithm", "Real", "Integer", "Boolean", "String", "Variable", "Signal", "VariableGroup",
    "SignalGroup",
)  # fmt: skip
GROUPS = "{}_OspModelDescription.xml"
SOURCES = ("output", "calculatedParameter")

#: Derived from decimals: the quotient of two steps in seconds is whole within a few of their last bits.
ROUNDING = 1e-9
log = logging.getLogger("cosim")


def read_osp(path: Path) -> Package:
    """Read the system of an OspSystemStructure.xml, or of the folder that contains one.

    Wires pass numbers on unchanged, since libcosim converts no units. Inputs that nothing drives keep
    the start value of their FMU. The connections of a `powerBond` become a bond, and a sum becomes
    several wires into one input. Two groups of variables, defined by a
    MODEL_OspModelDescription.xml next to the FMU or the structure, are connected one by one in their
    order. A simulator whose `stepSize` is shorter than the base step gets sub-steps, no longer than that;
    a longer one takes the base step, with a logged warning. FMUs are files in the folder of the structure.

    Parameters
    ----------
    path : Path
        The file or its folder.

    Returns
    -------
    Package
        The system, its times and step [s], and the sub-steps of its parts.

    Raises
    ------
    SetupError
        With file and line for what is invalid or not supported, such as FMUs that are not files.
    """
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    root, reader = load(file), _Reader(file)
    require_root(root, f"{{{NAMESPACE}}}OspSystemStructure", file.name)
    for element in root.iterfind("{*}EccoConfiguration"):
        root.remove(element)
    for element in root.iter("*"):
        try:
            reader.take(element)
        except KeyError as error:
            raise SetupError(f"{reader.at(element)}: there is no {error.args[0]!r}") from None
        except ValueError as error:
            raise SetupError(f"{reader.at(element)}: {error}") from None
    plan = reader.plan
    for node in plan.variables.keys() & plan.into.keys():
        for source in reader.terms(node):
            if source not in plan.variables:
                raise SetupError(
                    f"{file.name}: nothing drives {dotted(source)}, which drives {dotted(node)}"
                )
    bonds = [" * ".join(map(dotted, sources)) for sources in reader.bonds.values()]
    system = System(plan.fmus, [*plan.wires(), *reader.sums()], plan.starts(), bonds)
    connect(system)
    start, stop, step = map(reader.times.get, TIMES)
    return Package(system, start, stop, step=step, substeps=dict(reader.substeps()))


class _Reader:
    """The plan of a system, in which a function is a connector that drives another."""

    def __init__(self, file: Path) -> None:
        self.file, self.plan = file, FlatSystem(Budget(0), {"": {}})
        self.times: dict[str, float] = {}
        self.bonds: dict[str, list[Node]] = defaultdict(list)
        self.added: dict[Node, list[Node]] = {}
        self.steps: dict[str, float] = {}

    def at(self, element: SourceElement) -> str:
        """File, line, kind and name of an element."""
        name = element.get("name") or element.get("variable") or ""
        return f"{self.file.name}, line {element.sourceline}: {local_name(element)} {name}".rstrip()

    def take(self, element: SourceElement) -> None:
        """Take one element; raises KeyError or ValueError for what it lacks or has wrong."""
        tag, attributes = local_name(element), element.attrib
        if tag in TIMES:
            self.times[tag] = real(element.text or "")
        elif tag == "Simulator":
            self._simulator(attributes["name"], attributes["source"], attributes.get("stepSize"))
        elif tag == "InitialValue":
            simulator = element.getparent().getparent().attrib["name"]
            self._initial(self.plan.elements[""][simulator], element)
        elif tag == "LinearTransformation":
            entry, leave = self._add_function(attributes["name"], ["in"], ["out"])
            factor = real(attributes.get("factor", "1"))
            offset = real(attributes.get("offset", "0"))
            step = Step(tag, None, convert=False, factor=factor, offset=offset)
            self.plan.add_arrow(Flow(entry, leave, step))
        elif tag in ("Sum", "VectorSum"):
            inputs, width = whole(attributes["inputCount"]), whole(attributes.get("dimension", "1"))
            if min(inputs, width) < 1:
                raise ValueError("inputCount and dimension must be at least 1")
            self.plan.budget.take(self.at(element), LINK * inputs * width)
            for suffix in [f"[{j}]" for j in range(width)] if tag == "VectorSum" else [""]:
                entries = [f"in[{k}]{suffix}" for k in range(inputs)]
                *added, leave = self._add_function(attributes["name"], entries, [f"out{suffix}"])
                self.added[leave] = added
        elif tag in ("VariableConnection", "SignalConnection"):
            self._connection(element, map(self._end, element.iterchildren("*")))
        elif tag in ("VariableGroupConnection", "SignalGroupConnection"):
            groups = [[*self._group(end)] for end in element.iterchildren("*")]
            match [len(group) for group in groups]:
                case [first, second] if first == second:
                    for ends in zip(*groups):
                        self._connection(element, ends)
                case sizes:
                    text = " and ".join(map(str, sizes)) or "no"
                    raise ValueError(f"groups of {text} variables, not two of the same size")
        elif tag == "Algorithm" and element.text != "fixedStep":
            log.warning("algorithm %s is ignored", element.text)
        elif tag not in HOLDERS + CONTENTS:
            raise ValueError("is not supported")

    def _add_function(self, name: str, entries: list[str], leaves: list[str]) -> list[Node]:
        """The connectors of a function."""
        function = f"function {name}"
        self.plan.elements[""][function] = function
        nodes = [(function, signal) for signal in entries + leaves]
        kinds = ["input"] * len(entries) + ["output"] * len(leaves)
        self.plan.connectors.update({n: Connector(k, "Real", None) for n, k in zip(nodes, kinds)})
        return nodes

    def terms(self, node: Node, through: tuple[Node, ...] = ()) -> dict[Node, tuple[float, float]]:
        """Factor and offset of each output whose sum a connector has; raises SetupError for a circle."""
        source, steps = self.plan.origin(node)
        factor, offset = chain(None, steps)
        if source not in self.added:
            return {source: (factor, offset)}
        if source in through:
            raise SetupError(f"{self.file.name}: {dotted(source)} is added to itself")
        total: dict[Node, tuple[float, float]] = {}
        for entry in self.added[source]:
            for origin, (f, o) in self.terms(entry, (*through, source)).items():
                sum_so_far = total.get(origin, (0.0, 0.0))
                total[origin] = sum_so_far[0] + factor * f, sum_so_far[1] + factor * o + offset
                offset = 0.0
        return total

    def sums(self) -> Iterator[Wire]:
        """The wires into the inputs that sums drive."""
        for node in self.plan.into:
            if node in self.plan.variables and self.plan.origin(node)[0] in self.added:
                for k, (source, scale) in enumerate(self.terms(node).items()):
                    yield Wire(source, node, *scale, converts=False, adds=k > 0)

    def _simulator(self, name: str, source: str, step: str | None) -> None:
        if normpath(unquote(source)).startswith(("..", "/")):
            raise ValueError(f"source {source!r} points outside the folder of the structure")
        fmu = locate(source, self.file.parent, Path(self.file.absolute().anchor))
        part = self.plan.add_element("", name)
        self.plan.add_fmu(part, fmu, describe_fmu(part, fmu))
        if step is not None:
            self.steps[part] = real(step)

    def substeps(self) -> Iterator[tuple[str, int]]:
        """The sub-steps of the parts with a step of their own, none longer than that.

        libcosim rounds such steps to whole base steps. A step that is longer than the base step, or
        shorter but no whole part of it, is therefore no reason to refuse a structure that runs there.
        """
        base = self.times.get("BaseStepSize")
        for part, step in self.steps.items():
            if not 0.0 < step < math.inf:
                raise SetupError(
                    f"{self.file.name}: stepSize {step!r} s of {part} must be above 0 and finite"
                )
            if base is None:
                log.warning("%s: stepSize %r s is ignored: there is no BaseStepSize", part, step)
                continue
            count = math.ceil(base / step * (1.0 - ROUNDING))
            if count > 1:
                yield part, count
            if not math.isclose(base, count * step, rel_tol=ROUNDING):
                log.warning(
                    "%s: stepSize %r s becomes %r s, the BaseStepSize of %r s in %s",
                    part, step, base / count, base, pluralize(count, "step"),
                )  # fmt: skip

    def _initial(self, part: str, element: SourceElement) -> None:
        name, (content,) = element.attrib["variable"], element.iterchildren("*")
        kind = local_name(content)
        value = READ[kind](content.attrib["value"])
        if not self.plan.bind(part, Parameter(f"{part}.{name}", name, kind, value, None)):
            raise KeyError(f"{part}.{name}")

    def _end(self, element: SourceElement) -> Node:
        """The connector that a variable or a signal of a connection names."""
        end = element.attrib
        owner = end.get("simulator") or f"function {end['function']}"
        return self.plan.elements[""][owner], end["name"]

    def _group(self, element: SourceElement) -> Iterator[Node]:
        """The variables of a group, in their order; those of groups within it, too."""
        part, name = self._end(element)
        if "function" in element.attrib:
            elements = (f"{name}[{j}]" for j in count())
            yield from takewhile(
                self.plan.connectors.__contains__, ((part, signal) for signal in elements)
            )
            return
        file = GROUPS.format(self.plan.descriptions[part].modelName)
        candidates = [folder / file for folder in (self.plan.fmus[part].parent, self.file.parent)]
        path = next((path for path in candidates if path.is_file()), None)
        if path is None:
            raise ValueError(f"there is no file {file} to define the groups")
        groups = load(path).iterfind("{*}VariableGroups//*[@name]")
        group = next((group for group in groups if group.get("name") == name), None)
        if group is None:
            raise KeyError(f"{part}.{name}")
        for variable in group.iter("{*}Variable"):
            yield part, variable.attrib["ref"]

    def _connection(self, element: SourceElement, nodes: Iterable[Node]) -> None:
        """A connection, which may be written from either end."""
        ends = [*nodes]
        if missing := [dotted(end) for end in ends if end not in self.plan.connectors]:
            raise KeyError(missing[0])
        kinds = [self.plan.connectors[end].kind for end in ends]
        sources = [end for end, kind in zip(ends, kinds) if kind in SOURCES]
        sinks = [end for end in ends if end not in sources]
        if len(sources) != 1 or len(sinks) != 1:
            named = " and ".join(f"{kind} {dotted(end)}" for kind, end in zip(kinds, ends))
            raise ValueError(f"{named} cannot be connected")
        self.plan.add_arrow(
            Flow(sources[0], sinks[0], Step(local_name(element), None, convert=False))
        )
        if "powerBond" in element.attrib:
            self.bonds[element.get("powerBond")].extend(sources)


def write_osp(
    system: System, folder: Path, *, step: float, start: float = 0.0, stop: float | None = None
) -> None:
    """Write a system as OspSystemStructure.xml, with its FMUs beside it.

    Factors, offsets and unit conversions of wires become linear transformations. The connections of a
    declared bond become those of a `powerBond`, unless they go through a transformation.

    Parameters
    ----------
    system : System
        What is written.
    folder : Path
        Where it is written; the folder need not exist.
    step : float
        The base step [s].
    start : float
        The start time [s].
    stop : float, optional
        The end time [s].

    Raises
    ------
    SetupError
        What `connect` raises, for a step out of range, and for what libcosim cannot do: enumerations
        that differ from the FMU's start value, and enumerations on wires. Nothing is written then.
    OSError
        If the folder cannot be written.
    """
    if not 0.0 < step < float("inf"):
        raise SetupError(f"step = {step!r} s must be above 0")
    network = connect_for_export(system, "an OSP system structure", sums=True)
    require_fmi2(network.descriptions, "libcosim runs")
    files = archived(network)
    structure = _structure(network, files, step, start, stop)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for fmu, name in files.items():
            with replacement(folder / name) as fresh:
                shutil.copyfile(fmu, fresh)
        with replacement(folder / FILE) as fresh:
            fresh.write_bytes(structure)
    except OSError as error:
        raise OSError(f"{folder} cannot be written: {error.strerror}") from error


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
    named: dict[str, str] = {}
    for bond in (declared_bond(network, text) for text in network.system.bonds):
        if any(scaled(wire) for wire in bond):
            log.warning("bond %s goes through a function and is left out", bond.name)
        else:
            named |= {wire.target.name: bond.name for wire in bond}
    sums = network.sums()
    for number, wire in enumerate(network.wires, 1):
        if wire.target.name not in sums:
            _connection(functions, connections, wire, f"wire{number}", named.get(wire.target.name))
    for number, wires in enumerate(sums.values(), 1):
        _sum(functions, connections, wires, f"sum{number}")
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
    SubElement(initial, port.type, value=port.xml_text(value))


def _connection(
    functions: Element, connections: Element, wire: Connection, name: str, bond: str | None
) -> None:
    """One connection, or two over a function.

    The connection of a bond states what libcosim's ECCO takes for its ends' causality: a source is an
    input.
    """
    if wire.source.type == "Enumeration":
        raise SetupError(f"{wire.source} -> {wire.target}: libcosim cannot wire an Enumeration")
    if not scaled(wire):
        connection = SubElement(connections, "VariableConnection")
        for port, causality in ((wire.source, "input"), (wire.target, "output")):
            variable = _variable(connection, port)
            if bond is not None:
                connection.set("powerBond", bond)
                variable.set("causality", causality)
        return
    factor, offset = repr(wire.factor), repr(wire.offset)
    SubElement(functions, "LinearTransformation", name=name, factor=factor, offset=offset)
    _signals(connections, name, {"in": wire.source, "out": wire.target})


def _sum(functions: Element, connections: Element, wires: list[Connection], name: str) -> None:
    """A sum of outputs without factors, as libcosim has it: functions are not connected to functions."""
    if scaled_wire := next(filter(scaled, wires), None):
        raise SetupError(
            f"{scaled_wire.source} has a factor, an offset or a unit other than that of {scaled_wire.target}: "
            "libcosim adds outputs only as they are"
        )
    SubElement(functions, "Sum", name=name, inputCount=str(len(wires)))
    entries = {f"in[{k}]": wire.source for k, wire in enumerate(wires)}
    _signals(connections, name, {**entries, "out": wires[0].target})


def _signals(connections: Element, function: str, ports: Mapping[str, Port]) -> None:
    """The connections of the signals of a function to variables."""
    for signal, port in ports.items():
        connection = SubElement(connections, "SignalConnection")
        SubElement(connection, "Signal", function=function, name=signal)
        _variable(connection, port)


def _variable(connection: Element, port: Port) -> Element:
    return SubElement(connection, "Variable", simulator=port.part, name=port.variable.name)
