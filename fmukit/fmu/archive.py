"""Identical FMUs for identical content: one rule for guids, fixed order and times of files."""

import hashlib
import os
import uuid
import zipfile
from collections.abc import Iterable
from pathlib import Path

from fmpy.model_description import read_model_description

from ..declare.interface import Interface
from ..trace.modules import source_files
from . import page, terminals
from .load import project_metadata

EPOCH = (1980, 1, 1, 0, 0, 0)
KIT = Path(__file__).resolve().parents[1]
LICENSE = next(path for path in (KIT / "LICENSE", KIT.parent / "LICENSE") if path.is_file())


def digest_of(interface: Interface, flavour: str, makers: Iterable[Path]) -> str:
    """The hash of all that an FMU is made from.

    That is the model with the files that it imports and its page, the whole kit, and these files of others. Nothing is
    traced for it.
    """
    sources = source_files(Path(interface.model.__file__ or ""))
    kit = (file for pattern in ("*.py", "*.c", "*.zig") for file in KIT.rglob(pattern))
    hash_parts = (flavour, page.html(interface), repr(terminals.entries(interface)),
            repr(project_metadata(interface.model)), os.environ.get("SOURCE_DATE_EPOCH", ""))  # fmt: skip
    digest = hashlib.sha256("\0".join(hash_parts).encode())
    for file in (*sources, LICENSE, *sorted(kit), *makers):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def guid_of(digest: str) -> str:
    """The guid of an FMU made from what has this hash."""
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest)}}}"


def write_archive(contents: dict[str, bytes], fmu: Path) -> None:
    """Write these files, given by their path, as a zip archive."""
    with zipfile.ZipFile(fmu, "w") as target:
        for name in sorted(contents):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            target.writestr(entry, contents[name], compresslevel=9)


def is_current(guid: str, fmu: Path) -> bool:
    """Whether this file is already the build of this guid."""
    if not zipfile.is_zipfile(fmu):
        return False
    with zipfile.ZipFile(fmu) as archive:
        if "modelDescription.xml" not in archive.namelist():
            return False
    return bool(read_model_description(str(fmu), validate=False).guid == guid)
