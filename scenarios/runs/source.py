"""What code runs here: versions, and a hash of every source file."""

from __future__ import annotations

import hashlib
from functools import cache

import cosim

from ..fmus import ROOT

SOURCES = ("cosim", "scenarios")


def versions() -> dict[str, str]:
    """The versions that the bits of a result depend on."""
    found = cosim.versions()
    return {name: found[name] for name in ("python", "numpy", "scipy", "fmpy")}


@cache
def sources() -> dict[str, str]:
    """A hash of each source file of the master and the scenarios."""
    files = [
        path
        for folder in SOURCES
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in (".py", ".c")
    ]
    return {str(path.relative_to(ROOT).as_posix()): digest(path.read_bytes()) for path in files}


def digest(content: bytes) -> str:
    """A short name for a content."""
    return hashlib.sha256(content).hexdigest()[:16]
