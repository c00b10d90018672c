"""What OMSimulator, libcosim and Ecos cannot read although the standard allows it.

Each rule was read from the source of the tool, in the state of 2026: libcosim's `ssp_parser.cpp`, Ecos's `ssp.cpp`,
OMSimulator's `System.cpp`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from lxml.etree import QName

from .files import NAMESPACES, Element, children
from .standard_report import Finding, Severity, finding_in

LITERAL_PREFIXES = {NAMESPACES[prefix]: prefix for prefix in ("ssd", "ssc", "ssv")}


def check_tools(root: Element, path: Path) -> Iterator[Finding]:
    """What of a system structure description a tool cannot read."""

    def notes(tools: str, element: Element, text: str) -> Iterator[Finding]:
        for tool in tools.split():
            yield finding_in(path.name, tool, element, text, Severity.TOOL)

    if root.get("version") == "2.0":
        yield from notes("Ecos", root, "it reads version 1.0 only")
    prefixes = {(e.prefix, QName(e).namespace) for e in root.iter("{*}*")}
    for prefix, space in sorted(prefixes, key=str):
        expected = LITERAL_PREFIXES.get(space)
        if expected is not None and prefix != expected:
            text = f"it reads the prefix {expected}: literally, here it is {prefix!r}"
            yield from notes("libcosim Ecos", root, text)
    for system in children(root, "ssd:System"):
        for nested in children(system, "ssd:Elements", "ssd:System"):
            text = f"it reads no systems within systems: {nested.get('name')}"
            yield from notes("libcosim Ecos", nested, text)
        if not children(system, "ssd:Elements"):
            text = "it needs the element Elements in the system"
            yield from notes("libcosim", system, text)
        for connection in children(system, "ssd:Connections", "ssd:Connection"):
            if not connection.get("startElement") or not connection.get("endElement"):
                text = "it reads no connections to connectors of the system itself"
                yield from notes("libcosim Ecos", connection, text)
        path_of_connectors = ("ssd:Elements", "ssd:Component", "ssd:Connectors", "ssd:Connector")
        for connector in children(system, *path_of_connectors):
            if not any(str(QName(e).namespace).endswith("Common") for e in connector.iter("{*}*")):
                text = f"it needs a type of the connector {connector.get('name')}"
                yield from notes("libcosim", connector, text)
    for component in root.iter("{*}Component"):
        source = component.get("source") or ""
        if source and not source.endswith((".fmu", ".csv", ".mat", ".ssd", ".ssp")):
            text = f"it takes .fmu, .csv and .mat only, not {source}"
            yield from notes("OMSimulator", component, text)
