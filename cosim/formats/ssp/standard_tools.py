"""What OMSimulator, libcosim and Ecos cannot read although the standard allows it.

Each rule was read from the source of the tool, in the state of 2026: libcosim's `ssp_parser.cpp`, Ecos's `ssp.cpp`,
OMSimulator's `System.cpp`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from .files import Element, children, plain
from .standard_report import CLAUSES, Finding, Severity

LITERAL_PREFIXES = {
    "http://ssp-standard.org/SSP1/SystemStructureDescription": "ssd",
    "http://ssp-standard.org/SSP1/SystemStructureCommon": "ssc",
    "http://ssp-standard.org/SSP1/SystemStructureParameterValues": "ssv",
}


def check_tools(root: Element, path: Path) -> Iterator[Finding]:
    """What of a system structure description a tool cannot read."""

    def note(tool: str, element: Element, text: str) -> Finding:
        return Finding(CLAUSES[tool], Severity.TOOL, path.name, element.sourceline, text)

    if root.get("version") == "2.0":
        yield note("Ecos", root, "it reads version 1.0 only")
    prefixes = {(e.prefix, plain_space(e)) for e in root.iter("{*}*")}
    for prefix, space in sorted(prefixes, key=str):
        expected = LITERAL_PREFIXES.get(space)
        if expected is not None and prefix != expected:
            for tool in ("libcosim", "Ecos"):
                yield note(
                    tool, root, f"it reads the prefix {expected}: literally, here it is {prefix!r}"
                )
    for system in children(root, "ssd:System"):
        inner = children(system, "ssd:Elements", "ssd:System")
        for nested in inner:
            for tool in ("libcosim", "Ecos"):
                yield note(
                    tool, nested, f"it reads no systems within systems: {nested.get('name')}"
                )
        if not children(system, "ssd:Elements"):
            yield note("libcosim", system, "it needs the element Elements in the system")
        for connection in children(system, "ssd:Connections", "ssd:Connection"):
            if not connection.get("startElement") or not connection.get("endElement"):
                for tool in ("libcosim", "Ecos"):
                    text = "it reads no connections to connectors of the system itself"
                    yield note(tool, connection, text)
        for connector in children(
            system, "ssd:Elements", "ssd:Component", "ssd:Connectors", "ssd:Connector"
        ):
            if not any(plain_space(e).endswith("Common") for e in connector.iter("{*}*")):
                yield note(
                    "libcosim",
                    connector,
                    f"it needs a type of the connector {connector.get('name')}",
                )
    for component in root.iter("{*}Component"):
        source = component.get("source") or ""
        if source and not source.endswith((".fmu", ".csv", ".mat", ".ssd", ".ssp")):
            yield note("OMSimulator", component, f"it takes .fmu, .csv and .mat only, not {source}")


def plain_space(element: Element) -> str:
    """The namespace of an element."""
    return str(element.tag).rpartition("}")[0][1:] if plain(element.tag) != element.tag else ""
