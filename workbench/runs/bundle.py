"""The files that runs need, as what they hold: on their way to other machines, and beside the results of a study."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from cosim import SetupError


def digest(content: bytes) -> str:
    """A short name for a content."""
    return hashlib.sha256(content).hexdigest()[:16]


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
                raise SetupError(f"PARTS: two files are called {path.name}")
            files[path.name] = path.read_bytes()
        digests = (file.encode() + digest(files[file]).encode() for file in sorted(files))
        return cls(files, digest(b"".join(digests)))

    def unpacked_folder(self, folder: Path) -> Path:
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
