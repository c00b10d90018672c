"""Does a package or a file keep the SSP standard? Each finding names the clause, the file and the line.

Beside the standard, the checker knows what OMSimulator, libcosim and Ecos cannot read although it is allowed. Each of
these rules was read from the source of the tool, in the state of 2026: libcosim's `ssp_parser.cpp`, Ecos's `ssp.cpp`,
OMSimulator's `System.cpp`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import unquote, urlsplit
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

from lxml.etree import QName

from ...describe import table
from ...errors import SetupError
from ...system import describe_fmu
from .files import FMU, NAMESPACES, ROOT_SSD, Budget, Element, children, load, local_name, unpack
from .rules import Finding, Severity, breaches_of, check_document

SSP_SUFFIXES = (".ssd", ".ssv", ".ssm", ".ssb")
#: Entries that the root of a package may have, beside .ssd files: a clause of the standard.
ALLOWED_ROOTS = ("resources", "extra", "documentation")
#: Highest version of the ZIP format that an entry may need, times ten: a clause of the standard.
HIGHEST_ZIP_VERSION = 20
#: Bit of an entry that says that it is encrypted: a definition of the ZIP format.
ENCRYPTED = 0x1
#: Kinds of connectors that are causalities of variables.
CAUSALITIES = (
    "input",
    "output",
    "parameter",
    "calculatedParameter",
    "structuralParameter",
    "local",
)
#: What tools cannot read: the tools, the XPath of it, and what is said of it, with its attributes in braces.
TOOLS = (
    ("Ecos", "/ssd:*[@version='2.0']", "it reads version 1.0 only"),
    ("libcosim Ecos", "/*/ssd:System/ssd:Elements/ssd:System", "it reads no systems within systems: {name}"),
    ("libcosim", "/*/ssd:System[not(ssd:Elements)]", "it needs the element Elements in the system"),
    ("libcosim Ecos", "/*/ssd:System/ssd:Connections/ssd:Connection[not(string(@startElement) and string(@endElement))]",
     "it reads no connections to connectors of the system itself"),
    ("libcosim", "/*/ssd:System/ssd:Elements/ssd:Component/ssd:Connectors/ssd:Connector[not(.//ssc:*)]",
     "it needs a type of the connector {name}"),
    ("OMSimulator", "//ssd:Component[string(@source) and not(re:test(@source, '\\.(fmu|csv|mat|ssd|ssp)$'))]",
     "it takes .fmu, .csv and .mat only, not {source}"),
)  # fmt: skip
LITERAL_PREFIXES = {NAMESPACES[prefix]: prefix for prefix in ("ssd", "ssc", "ssv")}


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


def check_standard(path: Path | str) -> StandardReport:
    """Check a package, its folder, or a single file against the SSP standard.

    Parameters
    ----------
    path : path
        An .ssp, a folder with a SystemStructure.ssd, or an .ssd, .ssv, .ssm or .ssb.

    Returns
    -------
    StandardReport
        Each clause that is broken, resources that are missing, and what other tools cannot read.

    Raises
    ------
    SetupError
        If there is no such file, or it is none of these.
    """
    path = Path(path)
    if path.is_dir():
        findings = list(_check_folder(path))
    elif path.suffix in SSP_SUFFIXES:
        findings = list(_check_file(path))
    elif path.suffix == ".ssp":
        findings = list(_check_archive(path))
        with TemporaryDirectory() as scratch:
            unpack(path, Path(scratch), Budget(path.stat().st_size))
            findings += _check_folder(Path(scratch))
    else:
        raise SetupError(
            f"{path} must be an .ssp, a folder with {ROOT_SSD}, or one of {', '.join(SSP_SUFFIXES)}"
        )
    return StandardReport(str(path), tuple(dict.fromkeys(findings)))


def _check_archive(path: Path) -> Iterator[Finding]:
    """The rules for the ZIP file."""
    if not path.is_file():
        raise SetupError(f"there is no file {path}")
    try:
        with ZipFile(path) as archive:
            entries = archive.infolist()
    except BadZipFile as error:
        raise SetupError(f"{path} is not a readable zip file: {error}") from error
    names = Counter(entry.filename for entry in entries)
    for entry in entries:
        needed = f"needs version {entry.extract_version / 10:.1f} of ZIP, above 2.0"
        flaws = {
            "is neither stored nor deflated": entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED),
            "is encrypted": entry.flag_bits & ENCRYPTED,
            needed: entry.extract_version > HIGHEST_ZIP_VERSION,
            f"is in the archive {names[entry.filename]} times": names[entry.filename] > 1,
        }
        for text, is_so in flaws.items():
            if is_so:
                yield Finding("package", path.name, 0, f"{entry.filename} {text}")


def _check_folder(folder: Path) -> Iterator[Finding]:
    """The rules for the entries of a package, and for each file of SSP in it."""
    if not (folder / ROOT_SSD).is_file():
        yield Finding("package", ROOT_SSD, 0, f"there is no {ROOT_SSD} at the root")
    names: dict[str, str] = {}
    has_version_2 = False
    for file in sorted(folder.glob("*.ssd")):
        yield from _check_file(file)
        try:
            root = load(file)
        except SetupError:
            continue
        has_version_2 = has_version_2 or root.get("version") == "2.0"
        name = root.get("name")
        if has_version_2 and name in names:
            text = f"the name {name!r} is also that of {names[name]}"
            yield Finding("package", file.name, root.sourceline, text)
        names.setdefault(name, file.name)
    documentation = folder / "documentation"
    if has_version_2 and documentation.is_dir() and not (documentation / "index.html").is_file():
        yield Finding("package", "documentation", 0, "documentation/ has no index.html")
    for entry in sorted(folder.iterdir()):
        if entry.name not in ALLOWED_ROOTS and entry.suffix != ".ssd":
            text = "only resources/, extra/, documentation/ and .ssd files are at the root; others are reserved"
            yield Finding("reserved", entry.name, 0, text)


def _check_file(file: Path) -> Iterator[Finding]:
    """The rules for a file, and for the files of SSP that it refers to."""
    checked: set[Path] = set()
    pending = [file]
    while pending:
        path = pending.pop()
        if path.resolve() in checked:
            continue
        checked.add(path.resolve())
        try:
            root = load(path)
        except SetupError as error:
            yield Finding("schema", path.name, 0, str(error))
            continue
        elsewhere = [*_check_references(root, path), *_check_dictionaries(root, path)]
        elsewhere += breaches_of(root, path.name, TOOLS)
        prefixes = {(e.prefix, QName(e).namespace) for e in root.iter("{*}*")}
        for prefix, space in sorted(prefixes, key=str):
            expected = LITERAL_PREFIXES.get(space)
            if expected is not None and prefix != expected:
                text = f"it reads the prefix {expected}: literally, here it is {prefix!r}"
                elsewhere += [
                    Finding(tool, path.name, root.sourceline, text) for tool in ("libcosim", "Ecos")
                ]
        pending += _files_of_ssp(root, path)
        yield from check_document(root, path.name)
        yield from elsewhere


def _is_local(source: str) -> bool:
    """Whether it is the name of a file in the package."""
    parts = urlsplit(source)
    return not parts.scheme and not parts.netloc and bool(parts.path)


def _target(element: Element, path: Path) -> Path:
    """The file that an element of another file names."""
    return path.parent / unquote(urlsplit(element.get("source") or "").path)


def _files_of_ssp(root: Element, path: Path) -> Iterator[Path]:
    """The files of SSP that a file names and that are there."""
    for element in root.iter(
        "{*}ParameterBinding", "{*}ParameterMapping", "{*}SignalDictionary", "{*}Component"
    ):
        target = _target(element, path)
        if (
            _is_local(element.get("source") or "")
            and target.suffix in SSP_SUFFIXES
            and target.is_file()
        ):
            yield target


def _check_references(root: Element, path: Path) -> Iterator[Finding]:
    """What a structure says of other files and of systems elsewhere in it.

    Only a file in the package can be told to be missing. A component may also be a folder.
    """
    identifiers = {system.get("id") for system in root.iter("{*}System")}

    def found(rule: str, element: Element, text: str) -> Finding:
        return Finding(rule, path.name, element.sourceline, text)

    for element in root.iter("{*}Component", "{*}ParameterBinding", "{*}ParameterMapping"):
        tag, source = local_name(element), element.get("source") or ""
        target, is_component = _target(element, path), tag == "Component"
        owner = (
            element
            if is_component
            else next(element.iterancestors("{*}Component", "{*}System"), element)
        )
        name = owner.get("name")
        if is_component and source.startswith("#") and unquote(source[1:]) not in identifiers:
            text = f"{name}: no system of this file has the id {source[1:]!r}"
            yield found("component", element, text)
        if not _is_local(source) or element.get("sourceBase", "SSD") != "SSD":
            continue
        if not (target.exists() if is_component else target.is_file()):
            rule = "missing file" if is_component else "missing parameters"
            yield found(rule, element, f"{name}: there is no file {source!r}")
        elif is_component and element.get("type", FMU) == FMU and target.suffix == ".fmu":
            for rule, where, text in _compare_with_fmu(element, target):
                yield found(rule, where, f"{name}: {text}")


def _check_dictionaries(root: Element, path: Path) -> Iterator[Finding]:
    """The entries of dictionaries that connectors of references name, as far as a dictionary is in the file."""
    for reference in root.iter("{*}SignalDictionaryReference"):
        name = reference.get("dictionary")
        inside = "ancestor::*/*/*[local-name()='SignalDictionary' and @name=$name]"
        for dictionary in reference.xpath(inside, name=name)[-1:]:
            entries = {e.get("name") for e in dictionary.iter("{*}DictionaryEntry")}
            for connector in children(reference, "ssd:Connectors", "ssd:Connector"):
                is_elsewhere = dictionary.get("source") is not None and not entries
                if not is_elsewhere and connector.get("name") not in entries:
                    text = f"the dictionary {name!r} has no entry {connector.get('name')!r}"
                    yield Finding("reference", path.name, connector.sourceline, text)


def _compare_with_fmu(component: Element, path: Path) -> Iterator[tuple[str, Element, str]]:
    """What of the connectors of a component its FMU does not have so."""
    try:
        description = describe_fmu("fmu", path.absolute(), runnable=False)
    except SetupError as error:
        yield "unreadable FMU", component, f"its FMU is not read: {error}"
        return
    causalities = {v.name.partition("[")[0]: "" for v in description.modelVariables}
    causalities |= {v.name: v.causality for v in description.modelVariables}
    for connector in children(component, "ssd:Connectors", "ssd:Connector"):
        name, kind = connector.get("name"), connector.get("kind")
        causality = causalities.get(name)
        if causality is None:
            yield "FMU", connector, f"the FMU has no variable {name!r}"
        elif causality and kind in CAUSALITIES and causality != kind:
            yield (
                "FMU",
                connector,
                f"{name} is of kind {kind}, and of causality {causality} in the FMU",
            )
