"""Read an .ssp, or its folder, as a System: systems flattened, connectors resolved, parameters bound."""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import unquote, urldefrag

from ...errors import SetupError, pluralize
from ...system import System, connect, describe_fmu, types_match
from ...system.description import ModelDescription
from .files import (
    BOND,
    FMU,
    NAMESPACES,
    ROOT_SSD,
    Budget,
    Element,
    children,
    local_name,
    locate,
    unpack,
)
from .parameters import bound, linear
from .plan import Connector, FlatSystem, Flow, Node, dotted, same_variable
from .rules import End, load_valid, sinks_of
from .units import Definitions, definitions, same

DEFINITION = "application/x-ssp-definition"
PACKAGE = "application/x-ssp-package"
PARAMETERS = ("parameter", "calculatedParameter")
TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
STEPS = {"FixedStepAlgorithm": "baseStepSize", "FixedStepMaster": "stepSize"}
FILE_AND_LINE = re.compile(r".+, line \d+")
log = logging.getLogger("cosim")


class Package(NamedTuple):
    """The content of a file: the system, its default experiment and step [s], its outer connectors.

    `substeps` are the sub-steps of parts within a step, for `run`, where the file gives them steps of their own.
    `connectors` gives the dotted port of every connector of the outermost system that stands for
    one variable unchanged, without a factor, an offset or a conversion of units.
    """

    system: System
    start: float | None = None
    stop: float | None = None
    connectors: Mapping[str, str] = MappingProxyType({})
    step: float | None = None
    substeps: Mapping[str, int] = MappingProxyType({})


class Document(NamedTuple):
    """An open SSD file, which may name files in `root`; what is packed is unpacked in `scratch`.

    `nesting` names what it is nested in, by identity.
    """

    path: Path
    root: Path
    scratch: Path
    content: Element
    definitions: Definitions
    nesting: dict[tuple[str, str], str]

    @classmethod
    def open(
        cls, path: Path, root: Path, scratch: Path, nesting: dict[tuple[str, str], str]
    ) -> Document:
        """An SSD file; raises SetupError if it is none."""
        content = load_valid(path, "ssd:SystemStructureDescription")
        return cls(path, root, scratch, content, definitions(content), nesting)

    def at(self, element: Element) -> str:
        """File and line of an element, and its name if it has one."""
        name = f": {element.get('name')}" if element.get("name") else ""
        return f"{self.path.name}, line {element.sourceline}{name}"

    @contextmanager
    def placed(self, element: Element) -> Iterator[None]:
        """Begin errors that name no file and line with those of an element."""
        try:
            yield
        except SetupError as error:
            if FILE_AND_LINE.match(str(error)):
                raise
            raise SetupError(f"{self.at(element)}: {error}") from None

    def nested(self, key: tuple[str, str], name: str) -> Document:
        """The same document one level deeper; raises SetupError if it is nested in itself."""
        if key in self.nesting:
            chain = " -> ".join([*self.nesting.values(), name])
            raise SetupError(f"cyclic nesting: {chain}")
        return self._replace(nesting=self.nesting | {key: name})


def read_ssp(path: Path, folder: Path) -> Package:
    """Read the system of an .ssp (1.0, or 2.0 as far as that is the same), an .ssd or its folder.

    Inputs that nothing drives keep the start value of their FMU. A parameter that fits no variable is
    ignored with a logged warning, as the standard requires.

    Parameters
    ----------
    path : Path
        The file or folder.
    folder : Path
        Where packages are unpacked; it must be empty or not exist. All files that they name must be inside
        them.

    Returns
    -------
    Package
        The system, its default experiment and what else the file says.

    Raises
    ------
    SetupError
        For what is invalid, too large or not supported; the folder is then left as it was.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from cosim import System, read_ssp, write_ssp
    >>> with TemporaryDirectory() as name:
    ...     write_ssp(System({"motor": Path("fmus/DriveMotor.fmu")}), Path(name, "drive.ssp"))
    ...     package = read_ssp(Path(name, "drive.ssp"), Path(name, "unpacked"))
    >>> list(package.system.parts)
    ['motor']
    """
    path, folder = Path(path), Path(folder)
    existed = folder.exists()
    if existed and (not folder.is_dir() or any(folder.iterdir())):
        raise SetupError(f"{folder} must be an empty folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return _read(path, folder)
    except BaseException as error:
        shutil.rmtree(folder)
        if existed:
            folder.mkdir()
        if not isinstance(error, SetupError):
            raise
        if str(error).startswith(path.name) or str(error).endswith(str(path)):  # named already
            raise
        raise SetupError(f"{path.name}: {error}") from error


def _read(path: Path, folder: Path) -> Package:
    ssd = path / ROOT_SSD if path.is_dir() else path
    plan = FlatSystem(Budget(path.stat().st_size if path.is_file() else 0))
    if ssd.suffix == ".ssd":
        document = Document.open(ssd.resolve(), Path(ssd.absolute().anchor), folder, {})
        document = document.nested((str(document.path), ""), path.name)
    else:
        unpack(path, folder, plan.budget)
        document = Document.open(folder / ROOT_SSD, folder, folder, {})
        document = document.nested((_digest(path), ROOT_SSD), path.name)
    (outermost,) = children(document.content, "ssd:System")
    _system(plan, document, outermost, "")
    interface = plan.interface()
    system = System(plan.fmus, plan.wires(), plan.starts(), plan.bonds, connectors=interface)
    connect(system)
    outer = {name: same for name, w in interface.items() if (same := same_variable(name, w))}
    others = sorted(f.name for f in document.path.parent.glob("*.ssd") if f != document.path)
    if others and document.path.name == ROOT_SSD:
        names = ", ".join(others)
        log.warning("%s is read; the package has %s, too: unpack it to run that", ROOT_SSD, names)
    experiment = document.content.find("ssd:DefaultExperiment", NAMESPACES)
    attributes = {} if experiment is None else experiment.attrib
    start, stop = (
        float(attributes[key]) if key in attributes else None for key in ("startTime", "stopTime")
    )
    if plan.exchange:
        names = ", ".join(plan.exchange)
        log.warning("the file asks for model exchange of %s: run steps by co-simulation", names)
    return Package(system, start, stop, outer, _step(document))


def _step(document: Document) -> float | None:
    """The shortest communication step [s] that annotations of OSP or OMSimulator give."""
    steps = []
    for tag, key in STEPS.items():
        for element in document.content.iter(f"{{*}}{tag}"):
            text = element.get(key, "")
            try:
                steps.append(float(text))
            except ValueError:
                raise SetupError(
                    f"{document.at(element)}: {key} {text!r} is not a number"
                ) from None
    return min(steps, default=None)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _system(plan: FlatSystem, document: Document, system: Element, path: str) -> None:
    """Add a system and all that is in it to the plan, then apply its parameters."""
    if system.get("id"):
        document = document.nested((str(document.path), system.get("id")), system.get("name"))
    plan.elements[path] = {}
    for name, connector in _connectors(document, system).items():
        plan.budget.take(document.at(system), 1)
        plan.connectors[path, name] = connector
    for dictionary in children(system, "ssd:SignalDictionaries", "*"):
        raise SetupError(f"{document.at(dictionary)}: SignalDictionary is not supported")
    for element in children(system, "ssd:Elements", "*"):
        with document.placed(element):
            inner = plan.add_element(path, element.get("name"))
            match local_name(element):
                case "System":
                    _system(plan, document, element, inner)
                case "Component":
                    _component(plan, document, element, inner)
                case other:
                    raise SetupError(f"{other} is not supported")
    for connection in children(system, "ssd:Connections", "ssd:Connection"):
        with document.placed(connection):
            _connection(plan, document, connection, path)
    _bind(plan, document, system, path, None)
    inside = f"{path}." if path else ""
    for note in children(system, "ssd:Annotations", "ssc:Annotation", BOND):
        plan.bonds.append(" * ".join(inside + x.strip() for x in (note.text or "").split("*")))


def _component(plan: FlatSystem, document: Document, component: Element, path: str) -> None:
    kind, source = component.get("type", FMU), component.get("source")
    if kind == FMU:
        base = locate(source, document.path.parent, document.root)
        description = describe_fmu(path, base)
        _require_offer(plan, path, component.get("implementation", "any"), description)
        plan.add_fmu(path, base, description)
    elif kind in (DEFINITION, PACKAGE):
        inner, system = _nested(plan, document, kind, *urldefrag(source))
        _system(plan, inner, system, path)
        base = inner.path.parent
    else:
        raise SetupError(f"component type {kind!r} is not supported")
    unknown = []
    for name, connector in _connectors(document, component).items():
        if connector.kind in PARAMETERS and (path, name) not in plan.connectors:
            unknown.append(name)
        else:
            _merge_declared(plan, (path, name), connector)
    if unknown:
        ignored = pluralize(len(unknown), "parameter connector")
        log.warning("%s: its FMU has no %s; %s ignored", path, " and no ".join(unknown), ignored)
    _bind(plan, document, component, path, base)


def _require_offer(
    plan: FlatSystem, path: str, implementation: str, description: ModelDescription
) -> None:
    """Refuse a kind of FMU that the FMU is not; note where model exchange is asked for."""
    offers = {
        "CoSimulation": description.coSimulation,
        "ModelExchange": description.modelExchange,
        "any": description,
    }
    if offers[implementation] is None:
        raise SetupError(f"implementation is {implementation}, which its FMU does not offer")
    if implementation == "ModelExchange" and description.coSimulation is not None:
        plan.exchange.append(path)


def _nested(
    plan: FlatSystem, document: Document, kind: str, source: str, fragment: str
) -> tuple[Document, Element]:
    """The document and the system that a component stands for."""
    name = unquote(fragment)
    if not source:
        matches = document.content.xpath("//*[@id=$id]", id=name)
        if len(matches) != 1 or local_name(matches[0]) != "System":
            raise SetupError(f"there is no System with the id {name!r}")
        return document, matches[0]
    file = locate(source, document.path.parent, document.root)
    if kind == PACKAGE:
        key, scratch = (_digest(file), name or ROOT_SSD), Path(mkdtemp(dir=document.scratch))
        nesting = document.nested(key, file.name).nesting
        unpack(file, scratch, plan.budget)
        inner = Document.open(locate(name or ROOT_SSD, scratch, scratch), scratch, scratch, nesting)
    elif fragment:
        raise SetupError(f"an id in another file, {name!r}, is not supported")
    else:
        nesting = document.nested((str(file), ""), file.name).nesting
        inner = Document.open(file, document.root, document.scratch, nesting)
    (system,) = children(inner.content, "ssd:System")
    return inner, system


def _connectors(document: Document, element: Element) -> dict[str, Connector]:
    """The connectors that an element declares."""
    connectors: dict[str, Connector] = {}
    for declared in children(element, "ssd:Connectors", "ssd:Connector"):
        name, where = declared.get("name"), document.at(declared)
        if declared.get("kind") == "inout":
            raise SetupError(f"{where}: connector kind inout is not supported")
        kind, unit, items = None, None, None
        for content in children(declared, "ssc:*"):
            kind = local_name(content)
            if kind not in TYPES:
                raise SetupError(f"{where}: connector type {kind} is not supported")
            items = document.definitions.items.get(content.get("name"))
            unit = document.definitions.unit(content.get("unit"))
        connectors[name] = Connector(declared.get("kind"), kind, unit, items)
    return connectors


def _merge_declared(plan: FlatSystem, node: Node, declared: Connector) -> None:
    """Compare the connector of a component with what it stands for."""
    actual, connector = plan.connectors.get(node), f"connector {node[1]}"
    if actual is None:
        raise SetupError(f"{connector}: {node[0]} has no {node[1]}")
    if declared.kind != actual.kind:
        raise SetupError(f"{connector} must be of kind {actual.kind}, not {declared.kind}")
    if declared.type and actual.type and declared.type != actual.type:
        raise SetupError(f"{connector} must be of type {actual.type}, not {declared.type}")
    if declared.unit and actual.unit and not same(declared.unit, actual.unit):
        raise SetupError(
            f"{connector} must be in {actual.unit.name}, not {declared.unit.name}: {actual.unit}, "
            f"{declared.unit}"
        )
    if declared.items and actual.items and declared.items != actual.items:
        raise SetupError(f"{connector}: its Enumeration differs from that of {node[0]}")
    unit = actual.unit or declared.unit
    plan.connectors[node] = actual._replace(type=actual.type or declared.type, unit=unit)
    plan.declared.add(node)


def _connection(plan: FlatSystem, document: Document, connection: Element, path: str) -> None:
    ends: list[tuple[End, Node]] = []
    for end in ("start", "end"):
        element, name = connection.get(f"{end}Element") or "", connection.get(f"{end}Connector")
        node = (plan.elements[path][element] if element else path, name)
        if node not in plan.connectors or (node in plan.variables and node not in plan.declared):
            raise SetupError(f"there is no connector {dotted(node)}")
        ends.append((End(element, name, plan.connectors[node].kind), node))
    (first, second), (source, sink) = zip(*ends)
    if first in sinks_of(first, second):
        source, sink = sink, source
    source_connector, sink_connector = plan.connectors[source], plan.connectors[sink]
    if (
        source_connector.type
        and sink_connector.type
        and not types_match(source_connector.type, sink_connector.type)
    ):
        raise SetupError(
            f"{source_connector.type} {dotted(source)} cannot drive {sink_connector.type}"
        )
    for content in children(connection, "ssc:*"):
        if local_name(content) != "LinearTransformation":
            raise SetupError(f"{local_name(content)} of a connection is not supported")
    plan.add_arrow(Flow(source, sink, linear(connection, document.at(connection))))


def _bind(
    plan: FlatSystem, document: Document, element: Element, path: str, component: Path | None
) -> None:
    """Apply the parameter bindings of an element, the later ones over the earlier ones."""

    def find(source: str, base: str) -> Path:
        """The file that a binding names, beside the SSD or in the component."""
        if base == "SSD":
            return locate(source, document.path.parent, document.root)
        if component is None:
            raise SetupError("a system has no files of its own")
        folder = component
        if component.is_file():
            folder = Path(mkdtemp(dir=document.scratch))
            with zipfile.ZipFile(component) as archive:
                for entry in archive.infolist():
                    if entry.filename == unquote(source):
                        plan.budget.take(source, 1, entry.file_size)
                        archive.extract(entry, folder)
        return locate(source, folder, folder)

    for binding in children(element, "ssd:ParameterBindings", "ssd:ParameterBinding"):
        with document.placed(binding):
            for parameter in bound(binding, document.path.name, document.definitions, find):
                if not plan.bind(path, parameter):
                    log.warning("%s fits no variable and is ignored", parameter.where)
