"""The files that a run needs and another machine may not have, in folders named by their content."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from .identity import digest


class Bundle(NamedTuple):
    """Files by name, and a name for all of them that tells their content."""

    name: str
    files: Mapping[str, bytes]

    def unpack(self, folder: Path) -> Path:
        """The folder with the files, in this folder; it may be there already."""
        target = folder.resolve() / self.name
        if not target.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            fresh = Path(tempfile.mkdtemp(dir=folder, prefix=f"{self.name}."))
            for file, content in self.files.items():
                (fresh / file).write_bytes(content)
            try:
                fresh.rename(target)
            except OSError:  # another one was faster
                shutil.rmtree(fresh)
        return target


def collect(paths: Iterable[Path]) -> Bundle:
    """These files."""
    files = {path.name: path.read_bytes() for path in paths}
    told = b"".join(name.encode() + digest(files[name]).encode() for name in sorted(files))
    return Bundle(digest(told), files)
