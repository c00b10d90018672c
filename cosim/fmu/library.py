"""The FMUs of this process: each is unpacked and loaded once, and goes when the process ends."""

from __future__ import annotations

import copy
import ctypes
import os
from multiprocessing.util import Finalize
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from threading import RLock
from typing import Any
from zipfile import ZipFile

import fmpy
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import _FMU3, FMU3Model, FMU3Slave

from ..errors import FmuError
from ..files import too_large, unpacked_bytes
from ..scratch import scratch
from ..system import time_and_size
from ..system.description import ModelDescription

#: FMUs that stay loaded when nothing uses them. A convention: more than a system of different machines has.
MOST_LOADED = 32
KINDS: dict[str, Any] = {"2.0": (FMU2Slave, FMU2Model), "3.0": (FMU3Slave, FMU3Model)}

LOADED: dict[Path, Library] = {}
LOCK = RLock()


class Library:
    """An unpacked and loaded FMU, from `borrow` to `release`.

    `functions` are called with the interpreter locked, which is quick; those of `free` let other
    threads run, such as those of an FMU that log, and are for what takes its time.
    """

    def __init__(self, path: Path, description: ModelDescription) -> None:
        self.path, self.version = path, time_and_size(path)
        interface = description.offered_interface()
        self.once = bool(interface.canBeInstantiatedOnlyOncePerProcess)
        self.users = 0
        self.abandoned = False
        self.folder = Path(mkdtemp(dir=scratch()))
        try:
            unpack_for_platform(path, self.folder)
            kind = KINDS[description.fmiVersion][interface is description.modelExchange]
            self._slave = _loaded(kind, self.folder, description.guid, interface)
        except BaseException:
            rmtree(self.folder)
            raise
        handle = self._slave.dll._handle
        self.functions = ctypes.PyDLL(None, handle=handle)
        self.free = ctypes.CDLL(None, handle=handle)
        self._unload_once = Finalize(None, self._unload_now, exitpriority=0)

    def new_slave(self, name: str) -> FMU2Slave | FMU3Slave:
        """What makes an instance of this name and calls it."""
        slave = copy.copy(self._slave)
        slave.instanceName = name
        return slave

    def new_model(self, name: str, description: ModelDescription) -> FMU2Model | FMU3Model:
        """The same for model exchange; whoever takes it frees its library."""
        kind = KINDS[description.fmiVersion][1]
        model = _loaded(kind, self.folder, description.guid, description.modelExchange)
        model.instanceName = name
        return model

    def release(self) -> None:
        """One user less; what is not kept goes with the last one."""
        with LOCK:
            self.users -= 1
            if self.once:
                self.forget()
            self._unload_if_unused()

    def forget(self) -> None:
        """Let the next user load the FMU anew."""
        with LOCK:
            if LOADED.get(self.path) is self:
                del LOADED[self.path]
            self._unload_if_unused()

    def abandon(self) -> None:
        """After fmi2Fatal: call nothing in the library any more, not even to unload it."""
        self.abandoned = True
        self.forget()

    def _unload_if_unused(self) -> None:
        if not self.users and LOADED.get(self.path) is not self:
            self._unload_once()

    def _unload_now(self) -> None:
        """Unload the FMU.

        pythonfmu's wrapper stays loaded on Linux whatever its host does, for its symbols are unique.
        At exit it releases the interpreter twice, the second time in memory that is free by then,
        unless it has already been made to release it.
        """
        if not self.abandoned:
            if hasattr(self.free, "finalizePythonInterpreter"):
                self.free.finalizePythonInterpreter()
            self._slave.freeLibrary()
        rmtree(self.folder, ignore_errors=True)


def borrow(path: Path, description: ModelDescription) -> Library:
    """The library of an FMU as its file is now; raises FmuError if it cannot be loaded."""
    path = path.absolute()
    with LOCK:
        library = LOADED.get(path)
        if library is None or library.version != time_and_size(path) or not library.folder.is_dir():
            if library is not None:
                library.forget()
            library = Library(path, description)
        library.users += 1
        LOADED.pop(path, None)
        LOADED[path] = library
        for other in list(LOADED.values())[:-MOST_LOADED]:
            other.forget()
    return library


def unpack_for_platform(path: Path, folder: Path) -> None:
    """Unpack of an FMU what this platform runs: not its documentation, sources, other binaries."""
    platforms = {fmpy.platform, fmpy.platform_tuple}
    try:
        with ZipFile(path) as archive:
            size, needed = 0, []
            for entry in archive.infolist():
                top, _, rest = entry.filename.partition("/")
                runs = top == "binaries" and rest.split("/")[0] in platforms
                if top == "resources" or not rest or runs:
                    needed.append(entry)
                    size += entry.file_size
            if size > (most := unpacked_bytes(path.stat().st_size)):
                raise FmuError(too_large(str(path), most))
            archive.extractall(folder, needed)
    except FmuError:
        raise
    except Exception as error:
        raise FmuError(f"{path} cannot be unpacked: {error}") from error


def _loaded(kind: Any, folder: Path, guid: str, interface: Any) -> Any:
    """The binary of one of an FMU's interfaces, by its absolute path.

    What FMPy does to load it changes the working directory of the whole process, where other threads may
    be writing files: this makes the same object without.
    """
    platform = fmpy.platform_tuple if issubclass(kind, _FMU3) else fmpy.platform
    binary = (
        folder / "binaries" / platform / f"{interface.modelIdentifier}{fmpy.sharedLibraryExtension}"
    )
    fmu = kind.__new__(kind)
    fmu.guid, fmu.modelIdentifier, fmu.unzipDirectory = guid, interface.modelIdentifier, str(folder)
    fmu.instanceName, fmu.fmiCallLogger, fmu.requireFunctions = None, None, True
    vars(fmu).update(_functions={}, component=None, callbacks=None)
    try:
        fmu.dll = ctypes.CDLL(str(binary.absolute()))
        fmu._loadFunctions()  # noqa: SLF001
    except (OSError, AttributeError) as error:
        raise FmuError(f"Failed to load shared library {binary}: {error}") from error
    return fmu


def _forget_after_fork() -> None:
    """In a forked child nothing is loaded yet, and no thread of the parent holds the lock."""
    global LOCK
    LOCK = RLock()
    LOADED.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_after_fork)
