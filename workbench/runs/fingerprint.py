"""What the bits of a result depend on: the files of the code and of the FMUs, and versions."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cosim

SOURCES = ("cosim", "workbench")


def digest(content: bytes) -> str:
    """A short name for a content."""
    return hashlib.sha256(content).hexdigest()[:16]


def computation(where: str, fmus: Mapping[str, Path], *packages: str) -> dict[str, Any]:
    """Return what the runs of a question depend on besides their options.

    The question is the one that `where` loads, with these FMUs by part; `packages` are those that it lies
    in.
    """
    return {
        "question": digest(Path(where).read_bytes()) if where.endswith(".py") else where,
        "fmus": {part: digest(path.read_bytes()) for part, path in fmus.items()},
        **facts(*packages),
    }


def facts(*packages: str) -> dict[str, dict[str, str]]:
    """Code and versions, which are the same on all machines that work together."""
    versions = cosim.versions()
    needed = {name: versions[name] for name in ("python", "numpy", "scipy", "fmpy")}
    return {"code": code(*SOURCES, *packages), "versions": needed}


@cache
def code(*packages: str) -> dict[str, str]:
    """A hash of each source file of these packages."""
    hashes = {}
    for package in packages:
        spec = find_spec(package)
        assert spec is not None
        for folder in map(Path, spec.submodule_search_locations or ()):
            for path in sorted(folder.rglob("*")):
                if path.suffix in (".py", ".c"):
                    name = f"{package}/{path.relative_to(folder).as_posix()}"
                    hashes[name] = digest(path.read_bytes())
    return hashes
