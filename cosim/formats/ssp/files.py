"""The files of a package: unpacked without leaving its folder, validated against the schemas."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from lxml import etree

from ...errors import SetupError
from ...files import too_large, unpacked_bytes

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
NAMELESS = ""
#: Largest XML file [bytes]. Chosen: far above real packages, and its tree still fits into memory.
LONGEST_XML = 32 * 2**20
#: Items that an element counts as. Chosen: what it takes in memory, over that of a connector.
ELEMENT = 50
#: Items that a connection and a value count as. Chosen: likewise.
LINK = 5
#: Most items of a package. Chosen: read in seconds, and far above real packages.
MOST_ITEMS = 1_000_000


class Budget:
    """What a package may take, so that a hostile one ends soon: bytes on the disk, and items.

    An item is a connector or a variable; an element counts as 50, a connection and a value as 5.
    """

    def __init__(self, size: int) -> None:
        self.bytes = self.most = unpacked_bytes(size)
        self.items = MOST_ITEMS

    def take(self, where: str, items: int, size: int = 0) -> None:
        """Raise SetupError, which begins with `where`, when there is no room left."""
        self.items, self.bytes = self.items - items, self.bytes - size
        if self.bytes < 0:
            raise SetupError(too_large(where, self.most))
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
