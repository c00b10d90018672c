"""Calls and files on their way to other processes and machines; needs nothing but Python."""

from __future__ import annotations

import hashlib
import io
import pickle
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

Function = Callable[[Any], Any]


def digest(content: bytes) -> str:
    """A short name for a content."""
    return hashlib.sha256(content).hexdigest()[:16]


class _Sealer(pickle.Pickler):
    files: Sequence[Path]

    def persistent_id(self, value: Any) -> str | None:
        return value.name if isinstance(value, Path) and value in self.files else None


class _Opener(pickle.Unpickler):
    folder: Path

    def persistent_load(self, name: str) -> Path:
        return self.folder / name


def pickled_call(function: Function, task: Any, files: Sequence[Path] = ()) -> bytes:
    """function(task), pickled; the paths of these files may lead elsewhere where it is opened."""
    content = io.BytesIO()
    sealer = _Sealer(content)
    sealer.files = files
    sealer.dump((function, task))
    return content.getvalue()


class Call(NamedTuple):
    """A call that was `sealed`, the page to load before it is opened, and where its files are."""

    content: bytes
    page: str = ""
    folder: Path = Path()

    def opened(self) -> tuple[Function, Any]:
        """The function and its task."""
        if self.page:
            from ..catalog import load_cached

            load_cached(self.page)
        opener = _Opener(io.BytesIO(self.content))
        opener.folder = self.folder
        function, task = opener.load()
        return function, task


class Bundle(NamedTuple):
    """Files by name, and a name for all their contents."""

    files: Mapping[str, bytes]
    name: str

    @classmethod
    def of(cls, paths: Sequence[Path]) -> Bundle:
        """What these files hold; raises SetupError for two of one name."""
        files: dict[str, bytes] = {}
        for path in dict.fromkeys(paths):
            if path.name in files:
                from cosim import SetupError

                raise SetupError(f"PARTS: two files are called {path.name}")
            files[path.name] = path.read_bytes()
        digests = (file.encode() + digest(files[file]).encode() for file in sorted(files))
        return cls(files, digest(b"".join(digests)))

    def unpacked(self, folder: Path) -> Path:
        """The files in a folder of their own, in this folder; they may be there already, whole."""
        target = folder.resolve() / self.name
        if target.is_symlink():
            target.unlink()
        present = {file: target / file for file in self.files if (target / file).is_file()}
        if {file: path.read_bytes() for file, path in present.items()} != self.files:
            shutil.rmtree(target, ignore_errors=True)
            folder.mkdir(parents=True, exist_ok=True)
            fresh = Path(tempfile.mkdtemp(dir=folder, prefix=f"{self.name}."))
            for file, content in self.files.items():
                (fresh / file).write_bytes(content)
            try:
                fresh.rename(target)
            except OSError:  # another one was faster
                shutil.rmtree(fresh)
        return target
