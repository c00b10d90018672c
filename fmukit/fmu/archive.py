"""Identical FMUs for identical content: one rule for guids, fixed order and times of files."""

import hashlib
import os
import uuid
import zipfile
from collections.abc import Collection, Iterable
from pathlib import Path
from xml.etree import ElementTree

from ..declare.interface import Interface
from ..trace.modules import source_files
from . import page, terminals
from .load import project_metadata

EPOCH = (1980, 1, 1, 0, 0, 0)
KIT_FOLDER = Path(__file__).resolve().parents[1]
LICENSE = next(
    path for path in (KIT_FOLDER / "LICENSE", KIT_FOLDER.parent / "LICENSE") if path.is_file()
)


def digest_of(interface: Interface, flavour: str, makers: Iterable[Path]) -> str:
    """The hash of all that an FMU is made from.

    That is the model with the files that it imports and its page, the whole kit, and these files of others. Nothing is
    traced for it.
    """
    sources = source_files(Path(interface.model.__file__ or ""))
    kit = (file for pattern in ("*.py", "*.c", "*.zig") for file in KIT_FOLDER.rglob(pattern))
    hash_parts = (flavour, page.html(interface), repr(terminals.files_of_terminals(interface)),
            repr(project_metadata(interface.model)), os.environ.get("SOURCE_DATE_EPOCH", ""))  # fmt: skip
    digest = hashlib.sha256("\0".join(hash_parts).encode())
    for file in (*sources, LICENSE, *sorted(kit), *makers):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def guid_of(digest: str) -> str:
    """The guid of an FMU made from what has this hash."""
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest)}}}"


def write_archive(contents: dict[str, bytes], fmu: Path) -> None:
    """Write these files, given by their path, as a zip archive; its comment is the hash of them all."""
    with zipfile.ZipFile(fmu, "w") as target:
        for name in sorted(contents):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            target.writestr(entry, contents[name], compresslevel=9)
        target.comment = _hash_of(contents)


def is_current(guid: str, members: Collection[str], fmu: Path) -> bool:
    """Whether a file is the build of this guid, undamaged, with these members among others."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            contents = {name: archive.read(name) for name in archive.namelist()}
            undamaged = archive.comment == _hash_of(contents)
        root = ElementTree.fromstring(contents["modelDescription.xml"])
    except Exception:  # noqa: BLE001 (what cannot be read, for whatever reason, is built again)
        return False
    has_guid = guid in (root.get("guid"), root.get("instantiationToken"))
    return undamaged and has_guid and contents.keys() >= set(members)


def _hash_of(contents: dict[str, bytes]) -> bytes:
    digest = hashlib.sha256()
    for name in sorted(contents):
        digest.update(f"{name}\0{len(contents[name])}\0".encode() + contents[name])
    return digest.hexdigest().encode()


#: A custom section of WebAssembly without its content: of 39 bytes, with a name of 6 bytes.
MODULE_HASH = b"\0\x27\x06sha256"


def with_hash_section(module: bytes) -> bytes:
    """A module for WebAssembly with the hash of all that is before it in a last section."""
    return module + MODULE_HASH + hashlib.sha256(module).digest()


def is_current_wasm(guid: str, file: Path) -> bool:
    """Whether a file is the module for WebAssembly of this guid, undamaged."""
    try:
        content = file.read_bytes()
    except OSError:
        return False
    original = content.rpartition(MODULE_HASH)[0]
    return guid.encode() in content and content == with_hash_section(original)
