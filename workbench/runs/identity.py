"""What the bits of a result depend on: the files of the code, of the question and of the FMUs, and versions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cosim
from cosim.journal import code, digest

SOURCES = ("cosim", "workbench")


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
    versions = {name: x for name, x in cosim.versions().items() if name != "platform"}
    return {"code": code(*SOURCES, *packages), "versions": versions}
