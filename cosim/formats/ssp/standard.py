"""Does a package or a file keep the SSP standard? Each finding names the clause, the file and the line.

The clauses are those of SSP 2.0; rules that 1.0 does not have are applied to files of version 2.0 only. Beside the
standard, the checker knows what OMSimulator, libcosim and Ecos cannot read although it is allowed.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import unquote, urlsplit
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

from ...errors import SetupError
from .files import (
    ROOT_SSD,
    SCHEMAS,
    Budget,
    Element,
    load,
    load_schema,
    local_name,
    unpack,
    without_namespaces,
)
from .second import downgrade_to_1_0
from .standard_report import ALLOWED_ROOTS, Finding, Severity, StandardReport, doubled, finding_in
from .standard_structure import check_structure
from .standard_tools import check_tools

SSP_SUFFIXES = (".ssd", ".ssv", ".ssm", ".ssb")
VERSIONS = ("1.0", "2.0")
#: Highest version of the ZIP format that an entry may need, times ten: a clause of the standard.
HIGHEST_ZIP_VERSION = 20
#: Bit of an entry that says that it is encrypted: a definition of the ZIP format.
ENCRYPTED = 0x1
#: Most errors of the schema that are listed of a file: a convention; later ones follow from the first.
MOST_SCHEMA_ERRORS = 20


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
    for entry in entries:
        needed = f"needs version {entry.extract_version / 10:.1f} of ZIP, above 2.0"
        flaws = {
            "is neither stored nor deflated": entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED),
            "is encrypted": entry.flag_bits & ENCRYPTED,
            needed: entry.extract_version > HIGHEST_ZIP_VERSION,
        }
        for text, is_so in flaws.items():
            if is_so:
                yield finding_in(path.name, "package", 0, f"{entry.filename} {text}")
    for name, count in doubled(entry.filename for entry in entries).items():
        yield finding_in(path.name, "package", 0, f"{name} is in the archive {count} times")


def _check_folder(folder: Path) -> Iterator[Finding]:
    """The rules for the entries of a package, and for each file of SSP in it."""
    if not (folder / ROOT_SSD).is_file():
        yield finding_in(ROOT_SSD, "package", 0, f"there is no {ROOT_SSD} at the root")
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
            yield finding_in(file.name, "package", root, text)
        names.setdefault(name, file.name)
    documentation = folder / "documentation"
    if has_version_2 and documentation.is_dir() and not (documentation / "index.html").is_file():
        text = "documentation/ has no index.html"
        yield finding_in("documentation", "package", 0, text)
    for entry in sorted(folder.iterdir()):
        if entry.name not in ALLOWED_ROOTS and entry.suffix != ".ssd":
            text = "only resources/, extra/, documentation/ and .ssd files are at the root; others are reserved"
            yield finding_in(entry.name, "package", 0, text, Severity.ADVICE)


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
            yield finding_in(path.name, "xml", 0, str(error))
            continue
        yield from _check_document(root, path)
        if local_name(root) == "SystemStructureDescription":
            yield from check_structure(root, path)
            yield from check_tools(root, path)
        pending += _references(root, path)


def _references(root: Element, path: Path) -> Iterator[Path]:
    """The files of SSP that a file names and that are there."""
    for element in root.iter(
        "{*}ParameterBinding", "{*}ParameterMapping", "{*}SignalDictionary", "{*}Component"
    ):
        source = element.get("source")
        parts = urlsplit(source or "")
        if source and not parts.scheme and parts.path.endswith(SSP_SUFFIXES):
            target = path.parent / unquote(parts.path)
            if target.is_file():
                yield target


def _check_document(root: Element, path: Path) -> Iterator[Finding]:
    """Encoding, namespace, version and schema of a file; units and enumerations that it refers to."""
    encoding = (root.getroottree().docinfo.encoding or "UTF-8").upper()
    if encoding not in ("UTF-8", "ASCII", "US-ASCII"):
        yield finding_in(path.name, "xml", 1, f"the encoding is {encoding}, not UTF-8")
    space, version = root.tag.rpartition("}")[0][1:] or "none", root.get("version")
    if root.tag not in SCHEMAS:
        text = f"{local_name(root)} in the namespace {space} is not the root of an SSP file"
        yield finding_in(path.name, "xml", root, text)
        return
    if version not in VERSIONS:
        yield finding_in(path.name, "version", root, f"the version is {version!r}, not 1.0 or 2.0")
        return
    candidate = deepcopy(root)
    try:
        if version == "2.0":
            downgrade_to_1_0(candidate, path.name)
        schema = load_schema(SCHEMAS[root.tag])
        if not schema.validate(candidate):
            for error in list(schema.error_log)[:MOST_SCHEMA_ERRORS]:
                yield finding_in(path.name, "xml", error.line, without_namespaces(error.message))
    except SetupError as error:
        text = f"the schema is not checked: {error}"
        yield finding_in(path.name, "xml", 0, text, Severity.UNCHECKED)
    yield from _check_definitions(path.name, root)


def _check_definitions(file: str, root: Element) -> Iterator[Finding]:
    """Units and enumerations have distinct names and are defined where they are referred to."""
    inner = (e for e in root.iter("{*}ParameterSet", "{*}SignalDictionary") if e is not root)
    scopes = [root, *inner]
    references = {
        "Unit": [(e, e.get("unit")) for e in root.iter("{*}*")],
        "Enumeration": [
            (e, e.get("name"))
            for e in root.iter("{*}Enumeration")
            if e.getparent() is not None and local_name(e.getparent()) != "Enumerations"
        ],
    }
    for kind, referring in references.items():
        clause, defined = f"{kind.lower()}s", set[str]()
        for scope in scopes:
            names = [e.get("name") for e in scope.iterfind(f"{{*}}{kind}s/{{*}}{kind}")]
            defined.update(names)
            for name, count in doubled(names).items():
                text = f"{kind} {name!r} is defined {count} times"
                yield finding_in(file, clause, scope, text)
        for element, name in referring:
            if name and name not in defined:
                text = f"the {kind.lower()} {name!r} is not defined in the file"
                yield finding_in(file, clause, element, text)
