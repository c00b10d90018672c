"""Does a package or a file keep the SSP standard? Each finding names the clause, the file and the line.

The clauses are those of SSP 2.0; rules that 1.0 does not have are applied to files of version 2.0 only. Beside the
standard, the checker knows what OMSimulator, libcosim and Ecos cannot read although it is allowed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import unquote, urlsplit
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

from ...errors import SetupError
from .files import SCHEMAS, Budget, Element, load, load_schema, plain, unpack
from .second import make_1_0
from .standard_report import (
    ALLOWED_ROOTS,
    CLAUSES,
    Finding,
    Severity,
    StandardReport,
)
from .standard_structure import check_structure
from .standard_tools import check_tools

ROOT = "SystemStructure.ssd"
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
        return _report(path, list(_check_folder(path)))
    if path.suffix in SSP_SUFFIXES:
        return _report(path, list(_check_file(path)))
    if path.suffix != ".ssp":
        raise SetupError(
            f"{path} must be an .ssp, a folder with {ROOT}, or one of {', '.join(SSP_SUFFIXES)}"
        )
    with TemporaryDirectory() as scratch:
        findings = list(_check_archive(path))
        folder = Path(scratch)
        unpack(path, folder, Budget(path.stat().st_size))
        findings += _check_folder(folder)
    return _report(path, findings)


def _report(path: Path, findings: list[Finding]) -> StandardReport:
    return StandardReport(str(path), tuple(dict.fromkeys(findings)))


def _check_archive(path: Path) -> Iterator[Finding]:
    """The rules for the ZIP file."""
    clause, file = CLAUSES["package"], path.name
    if not path.is_file():
        raise SetupError(f"there is no file {path}")
    try:
        with ZipFile(path) as archive:
            entries = archive.infolist()
    except BadZipFile as error:
        raise SetupError(f"{path} is not a readable zip file: {error}") from error
    for entry in entries:
        if entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            yield Finding(
                clause, Severity.ERROR, file, 0, f"{entry.filename} is neither stored nor deflated"
            )
        if entry.flag_bits & ENCRYPTED:
            yield Finding(clause, Severity.ERROR, file, 0, f"{entry.filename} is encrypted")
        if entry.extract_version > HIGHEST_ZIP_VERSION:
            needed = f"{entry.extract_version / 10:.1f}"
            yield Finding(
                clause,
                Severity.ERROR,
                file,
                0,
                f"{entry.filename} needs version {needed} of ZIP, above 2.0",
            )
    for name, count in Counter(entry.filename for entry in entries).items():
        if count > 1:
            yield Finding(
                clause, Severity.ERROR, file, 0, f"{name} is in the archive {count} times"
            )


def _check_folder(folder: Path) -> Iterator[Finding]:
    """The rules for the entries of a package, and for each file of SSP in it."""
    clause = CLAUSES["package"]
    if not (folder / ROOT).is_file():
        yield Finding(clause, Severity.ERROR, ROOT, 0, f"there is no {ROOT} at the root")
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
            yield Finding(clause, Severity.ERROR, file.name, root.sourceline, text)
        names.setdefault(name, file.name)
    documentation = folder / "documentation"
    if has_version_2 and documentation.is_dir() and not (documentation / "index.html").is_file():
        text = "documentation/ has no index.html"
        yield Finding(clause, Severity.ERROR, "documentation", 0, text)
    for entry in sorted(folder.iterdir()):
        if entry.name not in ALLOWED_ROOTS and entry.suffix != ".ssd":
            text = "only resources/, extra/, documentation/ and .ssd files are at the root; others are reserved"
            yield Finding(clause, Severity.ADVICE, entry.name, 0, text)


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
            yield Finding(CLAUSES["xml"], Severity.ERROR, path.name, 0, str(error))
            continue
        yield from _check_document(root, path)
        if plain(root.tag) == "SystemStructureDescription":
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
    clause, file = CLAUSES["xml"], path.name
    encoding = (root.getroottree().docinfo.encoding or "UTF-8").upper()
    if encoding not in ("UTF-8", "ASCII", "US-ASCII"):
        yield Finding(clause, Severity.ERROR, file, 1, f"the encoding is {encoding}, not UTF-8")
    space = root.tag.rpartition("}")[0][1:]
    if root.tag not in SCHEMAS:
        text = (
            f"{plain(root.tag)} in the namespace {space or 'none'} is not the root of an SSP file"
        )
        yield Finding(clause, Severity.ERROR, file, root.sourceline, text)
        return
    version = root.get("version")
    if version not in VERSIONS:
        text = f"the version is {version!r}, not 1.0 or 2.0"
        yield Finding(CLAUSES["version"], Severity.ERROR, file, root.sourceline, text)
        return
    candidate = root
    if version == "2.0":
        candidate = deepcopy(root)
        try:
            make_1_0(candidate, file)
        except SetupError as error:
            yield Finding(
                clause, Severity.UNCHECKED, file, 0, f"the schema is not checked: {error}"
            )
            candidate = None
    if candidate is not None:
        yield from _check_schema(candidate, root.tag, file)
    yield from _check_definitions(root, file)


def _check_schema(root: Element, tag: str, file: str) -> Iterator[Finding]:
    schema = load_schema(SCHEMAS[tag])
    if not schema.validate(root):
        for error in list(schema.error_log)[:MOST_SCHEMA_ERRORS]:
            text = plain(error.message)
            yield Finding(CLAUSES["xml"], Severity.ERROR, file, error.line, text)


def _check_definitions(root: Element, file: str) -> Iterator[Finding]:
    """Units and enumerations have distinct names and are defined where they are referred to."""
    scopes = [
        root,
        *(e for e in root.iter("{*}ParameterSet", "{*}SignalDictionary") if e is not root),
    ]
    defined: dict[str, set[str]] = {"Unit": set(), "Enumeration": set()}
    for kind, group in (("Unit", "Units"), ("Enumeration", "Enumerations")):
        clause = CLAUSES["units" if kind == "Unit" else "enumerations"]
        for scope in scopes:
            names = [e.get("name") for e in scope.iterfind(f"{{*}}{group}/{{*}}{kind}")]
            defined[kind] |= set(names)
            for name, count in Counter(names).items():
                if count > 1:
                    text = f"{kind} {name!r} is defined {count} times"
                    yield Finding(clause, Severity.ERROR, file, scope.sourceline, text)
    for element in root.iter("{*}*"):
        if (unit := element.get("unit")) and unit not in defined["Unit"]:
            text = f"the unit {unit!r} is not defined in the file"
            yield Finding(CLAUSES["units"], Severity.ERROR, file, element.sourceline, text)
        parent = element.getparent()
        if (
            plain(element.tag) != "Enumeration"
            or parent is None
            or plain(parent.tag) == "Enumerations"
        ):
            continue
        if (name := element.get("name")) and name not in defined["Enumeration"]:
            text = f"the enumeration {name!r} is not defined in the file"
            yield Finding(CLAUSES["enumerations"], Severity.ERROR, file, element.sourceline, text)
