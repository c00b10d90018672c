"""Files that take the place of others when they are complete, and never through a link; and their locks."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Where names are no files of a user: what they lead to is written in place.
DEVICES = ("/dev", "/proc")
#: Bytes that an archive may take on the disk for each byte of its own, beside a few; and at most. Chosen: binaries and
#: tables shrink by less, and no FMU is so large.
MOST_EXPANSION, FREE_BYTES, MOST_BYTES = 100, 2**26, 2**33
#: The byte of a file that Windows locks: derived from its 32 bits of a position, so that others can read the rows.
LOCKED_BYTE = 2**31 - 2


@contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """A path beside another one for a file that takes its place when it is complete.

    A link at the name is replaced, and what it leads to stays as it is. A pipe or a device is written in
    place. Raises OSError with the name of the file if it cannot be written.
    """
    if path.absolute().is_relative_to(DEVICES[0]) or path.absolute().is_relative_to(DEVICES[1]):
        yield path
        return
    if path.exists() and not path.is_file():
        yield path
        return
    fresh = path.with_name(f".partial-{path.name}")
    try:
        fresh.unlink(missing_ok=True)
        yield fresh
        fresh.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        fresh.unlink(missing_ok=True)


def unpacked_bytes(packed: int) -> int:
    """The bytes that an archive may take on the disk, of which it is so many itself."""
    return min(FREE_BYTES + MOST_EXPANSION * packed, MOST_BYTES)


def too_large(archive: str, most: int) -> str:
    """What is said of an archive that takes more bytes unpacked than it may."""
    return f"{archive}: it would take more than {most / 1e6:.4g} MB unpacked, far more than it is packed: leave out what it does not need"


def lock_file(file: int) -> bool:
    """Lock a file until it is closed; False if another has."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(file, LOCKED_BYTE, os.SEEK_SET)  # rows are appended all the same
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True
