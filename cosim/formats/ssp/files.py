"""The files of an .ssp: unpacked without leaving its folder, validated against the schemas."""

from __future__ import annotations

import re
import zipfile
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

import fmpy
from lxml import etree

from ...errors import SetupError

Element = Any
STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"
NAMESPACES = {
    "ssd": f"{STANDARD}Description",
    "ssc": f"{STANDARD}Common",
    "ssv": f"{STANDARD}ParameterValues",
    "ssm": f"{STANDARD}ParameterMapping",
}
SCHEMAS = {
    f"{{{NAMESPACES['ssd']}}}SystemStructureDescription": "SystemStructureDescription.xsd",
    f"{{{NAMESPACES['ssv']}}}ParameterSet": "SystemStructureParameterValues.xsd",
    f"{{{NAMESPACES['ssm']}}}ParameterMapping": "SystemStructureParameterMapping.xsd",
}


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a zip file; raises SetupError if it is none, broken or reaches out of the folder."""
    try:
        with zipfile.ZipFile(archive) as file:
            for name in file.namelist():
                parts = PurePosixPath(name.replace("\\", "/")).parts
                if ".." in parts or name.startswith(("/", "\\")) or ":" in name:
                    raise SetupError(f"{archive.name}: {name!r} leaves the folder of the package")
            file.extractall(folder)
    except FileNotFoundError:
        raise SetupError(f"there is no file {archive}") from None
    except SetupError:
        raise
    except Exception as error:
        raise SetupError(f"{archive.name} is not a readable zip file: {error}") from error


def locate(uri: str, base: Path, root: Path) -> Path:
    """The file of a relative URI; raises SetupError if there is none or it is outside of `root`."""
    parts = urlsplit(uri)
    if not parts.path or any((parts.scheme, parts.netloc, parts.query, parts.fragment)):
        raise SetupError(f"source {uri!r} is not supported, only files inside the package")
    path = (base / unquote(parts.path)).resolve()
    if not path.is_relative_to(root.resolve()):
        raise SetupError(f"source {uri!r} leaves the folder of the package")
    if not path.is_file():
        raise SetupError(f"there is no file {uri!r}")
    return path


def parse(path: Path, tag: str) -> Element:
    """The root element of a valid XML file, of which `tag` is the expected name (ssd:...).

    Raises SetupError with the line and the reason.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    try:
        root = etree.parse(str(path), parser).getroot()
    except etree.XMLSyntaxError as error:
        raise SetupError(f"{path.name}, line {error.lineno}: {error.msg}") from None
    except OSError as error:
        raise SetupError(f"{path.name} cannot be read: {error}") from None
    validate(root, tag, path.name)
    return root


def validate(element: Element, tag: str, name: str) -> None:
    """Check an element and what is below it; raises SetupError with the line and the reason."""
    if element.tag != qualified(tag):
        found = plain(element.tag)
        raise SetupError(f"{name}, line {element.sourceline}: {tag} is needed, not {found}")
    version = element.get("version")
    if version is not None and version != "1.0":
        raise SetupError(f"{name}: version {version} of SSP is not supported, only 1.0")
    schema = _schema(SCHEMAS[element.tag])
    if not schema.validate(element):
        first = schema.error_log[0]
        raise SetupError(f"{name}, line {first.line}: {plain(first.message)}")


@cache
def _schema(name: str) -> Any:
    return etree.XMLSchema(file=str(Path(fmpy.__file__).with_name("ssp") / "schema" / name))


def qualified(tag: str) -> str:
    """ssd:System -> {http://...}System."""
    prefix, _, name = tag.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{name}"


def plain(text: str) -> str:
    """A text without the namespaces of its tags."""
    return re.sub(r"\{[^}]*\}", "", text)


def children(element: Element, *path: str) -> list[Element]:
    """The elements below `element` along a path of tags; none if a step of it is missing."""
    return list(element.iterfind("/".join(path), NAMESPACES))
