"""What the checker of the SSP standard finds, and how it is printed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from ...describe import table
from .files import Element

#: Entries that the root of a package may have, beside .ssd files: a clause of the standard.
ALLOWED_ROOTS = ("resources", "extra", "documentation")


T = TypeVar("T")


class Severity(StrEnum):
    """How bad a finding is."""

    ERROR = "error"
    MISSING = "missing"
    ADVICE = "advice"
    TOOL = "tool"
    UNCHECKED = "not checked"


CLAUSES = {
    "package": "3 System Structure Package",
    "xml": "5, 6, 7, 8: file format and schema",
    "version": "5.1 SystemStructureDescription",
    "enumerations": "4.4.1 Enumerations",
    "units": "4.4.2 Units",
    "name": "5.2 Common Model Element Type",
    "connectors": "5.2.1 Connectors",
    "bindings": "5.2.3 ParameterBindings",
    "mapping": "5.2.3.2 ParameterMapping",
    "connections": "5.3.2 Connections",
    "allowed": "5.3.2.1 Allowed Connections",
    "geometry": "5.3.4 SystemGeometry",
    "dictionaries": "5.3.3 SignalDictionaries",
    "component": "5.4 Component",
    "reference": "5.5 SignalDictionaryReference",
    "parameters": "6.2 Parameters",
    "entries": "7.1.1 MappingEntry",
    "OMSimulator": "OMSimulator",
    "libcosim": "libcosim",
    "Ecos": "Ecos",
}


@dataclass(frozen=True)
class Finding:
    """A clause that a file breaks, or a tool that cannot read it; line 0 stands for all of the file."""

    clause: str
    severity: Severity
    file: str
    line: int
    text: str


def finding_in(
    file: str, clause: str, where: Element | int, text: str, severity: Severity = Severity.ERROR
) -> Finding:
    """A clause that an element of a file, or a line of it, breaks."""
    line = where if isinstance(where, int) else where.sourceline
    return Finding(CLAUSES[clause], severity, file, line, text)


def doubled(names: Iterable[T]) -> dict[T, int]:
    """The names that there are several times, and how often."""
    return {name: count for name, count in Counter(names).items() if count > 1}


@dataclass(frozen=True)
class StandardReport:
    """What was found in a package or file."""

    source: str
    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether no clause of the standard is broken."""
        return all(finding.severity is not Severity.ERROR for finding in self.findings)

    def summary(self) -> str:
        """The verdict in a line."""
        counts = Counter(str(finding.severity) for finding in self.findings)
        numbers = ", ".join(f"{counts[s]} {s}" for s in map(str, Severity) if counts[s])
        verdict = "keeps the SSP standard" if self.passed else "breaks the SSP standard"
        return f"{self.source} {verdict}" + (f": {numbers}" if numbers else "")

    def text(self) -> str:
        """A line for each finding, and the verdict."""
        rows = [
            (str(f.severity), f.clause, f"{f.file}, line {f.line}" if f.line else f.file, f.text)
            for f in self.findings
        ]
        return "\n".join([*table(rows), self.summary()])
