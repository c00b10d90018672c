"""A folder of results belongs to one run, from its first row to its last file; files that runs need, as what they hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from cosim import SetupError

LOCK = ".lock"
_reserved: ContextVar[frozenset[Path]] = ContextVar("reserved", default=frozenset())


@contextmanager
def reservation(folder: Path | None) -> Iterator[None]:
    """Make a folder, and keep all other runs out of it until the end; without a folder do nothing.

    Within a reservation of the same folder nothing happens either, so that whoever writes reserves.
    The operating system ends the reservation of a process that ends in any way. A folder that is new
    and stays empty is removed.

    Raises
    ------
    SetupError
        If another run uses the folder, if it cannot be made, or if its file system has no locks.
    """
    if folder is None or folder.resolve() in _reserved.get():
        yield
        return
    from filelock import FileLock, SoftFileLock, Timeout

    new = [path for path in (folder, *folder.parents) if not path.exists()]
    lock = FileLock(folder / LOCK, timeout=0.0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise SetupError(
            f"{folder}: another process is using this folder; wait until it ends, or choose another "
            "folder with --out"
        ) from None
    except OSError as error:
        _remove_empty(new)
        raise SetupError(f"{folder} cannot be written: {error.strerror}") from error
    before = _reserved.set(_reserved.get() | {folder.resolve()})
    try:
        if isinstance(lock, SoftFileLock):  # it would outlive a process that is killed
            raise SetupError(
                f"{folder}: its file system has no locks; choose a folder on another one with --out"
            )
        yield
    finally:
        _reserved.reset(before)
        with suppress(OSError):  # Windows removes it with the lock
            (folder / LOCK).unlink()
        lock.release()
        _remove_empty(new)


def contents(paths: Iterable[Path]) -> dict[str, bytes]:
    """What files hold, by name; raises SetupError for two of one name."""
    files: dict[str, bytes] = {}
    for path in dict.fromkeys(paths):
        if path.name in files:
            raise SetupError(f"PARTS: two files are called {path.name}")
        files[path.name] = path.read_bytes()
    return files


def unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files into a folder, but for those that are there."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        path = folder / name
        if path.is_symlink() or not path.is_file() or path.read_bytes() != content:
            path.unlink(missing_ok=True)
            path.write_bytes(content)


def _remove_empty(folders: list[Path]) -> None:
    """Remove those of these folders that are empty, innermost first."""
    with suppress(OSError):
        for path in folders:
            path.rmdir()
