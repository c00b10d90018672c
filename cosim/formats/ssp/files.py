"""The files of a package: unpacked without leaving its folder, validated against the schemas."""

from __future__ import annotations

import logging
import re
import zipfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

import fmpy
from lxml import etree

from ...errors import SetupError
from .second import downgrade_to_1_0

Element = Any
STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"
NAMESPACES = {
    "ssd": f"{STANDARD}Description",
    "ssc": f"{STANDARD}Common",
    "ssv": f"{STANDARD}ParameterValues",
    "ssm": f"{STANDARD}ParameterMapping",
    "ssb": f"{STANDARD}SignalDictionary",
}
BOND = "{urn:cosim}Bond"
FMU = "application/x-fmu-sharedlibrary"
ROOT_SSD = "SystemStructure.ssd"
SCHEMAS = {
    f"{{{NAMESPACES['ssd']}}}SystemStructureDescription": "SystemStructureDescription.xsd",
    f"{{{NAMESPACES['ssv']}}}ParameterSet": "SystemStructureParameterValues.xsd",
    f"{{{NAMESPACES['ssm']}}}ParameterMapping": "SystemStructureParameterMapping.xsd",
    f"{{{NAMESPACES['ssb']}}}SignalDictionary": "SystemStructureSignalDictionary.xsd",
}
NAMELESS = ""
FOREIGN = "SCHEMAV_CVC_COMPLEX_TYPE_3_2_1"
log = logging.getLogger("cosim")
#: Largest XML file [bytes]. Chosen: far above real packages, and its tree still fits into memory.
LONGEST_XML = 32 * 2**20
#: Items that an element counts as. Chosen: what it takes in memory, over that of a connector.
ELEMENT = 50
#: Items that a connection and a value count as. Chosen: likewise.
LINK = 5
#: Most items of a package. Chosen: read in seconds, and far above real packages.
MOST_ITEMS = 1_000_000
#: Bytes that any package may take on the disk. Chosen: a few large FMUs.
MOST_BYTES = 2**30
#: Bytes that it may take for each byte of the packed file. Chosen: binaries and tables shrink by less.
MOST_EXPANSION = 100


class Budget:
    """What a package may take, so that a hostile one ends soon: bytes on the disk, and items.

    An item is a connector or a variable; an element counts as 50, a connection and a value as 5.
    """

    def __init__(self, size: int) -> None:
        self.bytes, self.items = MOST_BYTES + MOST_EXPANSION * size, MOST_ITEMS

    def take(self, where: str, items: int, size: int = 0) -> None:
        """Raise SetupError, which begins with `where`, when there is no room left."""
        self.items, self.bytes = self.items - items, self.bytes - size
        if self.bytes < 0:
            raise SetupError(f"{where}: unpacked, it would be far larger than it is packed")
        if self.items < 0:
            raise SetupError(f"{where}: the system has too many elements, connections and values")


def unpack(archive: Path, folder: Path, budget: Budget) -> None:
    """Unpack a zip file; raises SetupError if it is none, broken, too large or leaves the folder."""
    try:
        with zipfile.ZipFile(archive) as file:
            for entry in file.infolist():
                name = entry.filename
                parts = PurePosixPath(name.replace("\\", "/")).parts
                if ".." in parts or name.startswith(("/", "\\")) or ":" in name:
                    raise SetupError(
                        f"{archive.name}: {name!r} points outside the folder of the package"
                    )
                budget.take(f"{archive.name}: {name}", 1, entry.file_size)
            file.extractall(folder)
    except FileNotFoundError:
        raise SetupError(f"there is no file {archive}") from None
    except SetupError:
        raise
    except Exception as error:
        raise SetupError(f"{archive.name} is not a readable zip file: {error}") from error


def locate(uri: str, base: Path, root: Path) -> Path:
    """The file of a relative URI; raises SetupError if there is none or it is outside of `root`."""
    try:
        parts = urlsplit(uri)
        path = (base / unquote(parts.path)).resolve()
        exists = path.is_file()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", error)
        raise SetupError(f"source {uri[:60]!r} is not a file name: {reason}") from None
    if not parts.path or any((parts.scheme, parts.netloc, parts.query, parts.fragment)):
        raise SetupError(f"source {uri!r} is not supported, only files inside the package")
    if not path.is_relative_to(root.resolve()):
        raise SetupError(f"source {uri!r} points outside the folder of the package")
    if not exists:
        raise SetupError(f"there is no file {uri!r}")
    return path


def load(path: Path) -> Element:
    """The root element of an XML file; raises SetupError with the line and the reason."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    try:
        if not path.is_file():
            raise SetupError(f"there is no file {path.name!r}")
        if path.stat().st_size > LONGEST_XML:
            raise SetupError(f"{path.name} is larger than {LONGEST_XML >> 20} MiB")
        tree = etree.parse(str(path), parser)
    except etree.XMLSyntaxError as error:
        reason = str(error.msg).partition("\n")[0]
        raise SetupError(f"{path.name}, line {error.lineno}: {reason}") from None
    except OSError as error:
        raise SetupError(f"{path.name} cannot be read: {error.strerror or error}") from None
    if tree.docinfo.doctype:
        raise SetupError(
            f"{path.name}: a document type, which may define entities, is not supported"
        )
    return tree.getroot()


def load_valid(path: Path, tag: str) -> Element:
    """The root element of a valid XML file, of which `tag` is the expected name (ssd:...).

    Raises SetupError with the line and the reason.
    """
    root = load(path)
    downgrade_and_validate(root, tag, path.name)
    return root


def require_root(element: Element, tag: str, where: str) -> None:
    """Refuse an element of another name or namespace than `tag`, {namespace}name; SetupError."""
    space, name = tag[1:].split("}")
    actual = element.tag.rpartition("}")[0][1:] or "none"
    if element.tag == tag:
        return
    if local_name(element) == name:
        raise SetupError(f"{where}: {name} must be in the namespace {space}, not in {actual}")
    raise SetupError(
        f"{where}: the element must be {name}, not {local_name(element)}; "
        f"its namespace must be {space}, not {actual}"
    )


def downgrade_and_validate(element: Element, tag: str, name: str) -> None:
    """Make an element and what is below it one of SSP 1.0 in place, and check it; raises SetupError with the line and the reason.

    What SSP 2.0 has more is made 1.0 as far as a system can have it; the rest is refused.
    Attributes that are none of SSP are foreign with a logged warning.
    """
    require_root(element, qualified(tag), f"{name}, line {element.sourceline}")
    version, wide = element.get("version"), []
    if version == "2.0":
        wide = downgrade_to_1_0(element, name)
    elif version not in (None, "1.0"):
        raise SetupError(f"{name}: version {version} of SSP is not supported, only 1.0 and 2.0")
    for kind in element.iter(qualified("ssc:Enumeration")):
        if kind.get("name") is None and kind.getparent().tag == qualified("ssd:Connector"):
            log.warning(
                "%s, line %s: connector %s has an Enumeration without a name; that of the FMU is taken",
                name, kind.sourceline, kind.getparent().get("name"),
            )  # fmt: skip
            kind.set("name", NAMELESS)
    schema = load_schema(SCHEMAS[element.tag])
    while not schema.validate(element):
        if not _remove_foreign(element, schema.error_log, name):
            first = schema.error_log[0]
            raise SetupError(f"{name}, line {first.line}: {without_namespaces(first.message)}")
    for value, text in wide:
        value.set("value", text)


def _remove_foreign(element: Element, errors: Iterable[Any], name: str) -> bool:
    """Remove the attributes that errors of the schema call unknown; whether there are any."""
    lines: dict[int, list[Element]] = {}
    for inner in element.iter("*"):
        lines.setdefault(inner.sourceline, []).append(inner)
    foreign: dict[tuple[str, str], list[int]] = {}
    for error in errors:
        if error.type_name != FOREIGN:
            continue
        attribute = error.message.split("'")[3]
        for owner in lines.get(error.line, ()):
            if owner.attrib.pop(attribute, None) is not None:
                foreign.setdefault((without_namespaces(attribute), local_name(owner)), []).append(
                    error.line
                )
    for (attribute, tag), where in foreign.items():
        more = f" and in {len(where) - 1} more places" if len(where) > 1 else ""
        log.warning(
            "%s, line %s%s: attribute %s of %s is not one of SSP and is ignored",
            name, where[0], more, attribute, tag,
        )  # fmt: skip
    return bool(foreign)


@cache
def load_schema(name: str) -> Any:
    """Return the XML schema of this file name."""
    return etree.XMLSchema(file=str(Path(fmpy.__file__).with_name("ssp") / "schema" / name))


def qualified(tag: str) -> str:
    """ssd:System -> {http://...}System."""
    prefix, _, name = tag.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{name}"


def local_name(element: Element) -> str:
    """The tag of an element without its namespace."""
    return str(etree.QName(element).localname)


def without_namespaces(text: str) -> str:
    """A text without the namespaces of its tags."""
    return re.sub(r"\{[^}]*\}", "", text)


def children(element: Element, *path: str) -> list[Element]:
    """The elements below `element` along a path of tags; none if a step of it is missing."""
    return list(element.iterfind("/".join(path), NAMESPACES))
