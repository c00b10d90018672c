"""What the bits of a result depend on: versions, code, FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatch
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cosim
from cosim.system import describe_fmu

from .bundle import digest
from .syntax import code_digest

SOURCES = ("cosim", "workbench")
#: Files that only show results, or make what runs are given; no pattern is without a file.
PRESENTATION = (
    "cosim/__main__.py",
    "cosim/cli/commands/*",
    "cosim/picture.py",
    "workbench/charts/*",
    "workbench/cli.py",
    "workbench/export.py",
    "workbench/live/__init__.py",
    "workbench/live/build.py",
    "workbench/live/encoder.py",
    "workbench/live/drawing.py",
    "workbench/live/still.py",
    "workbench/page/*",
    "workbench/study/*",
    "*/__main__.py",
    "*/live_*.py",
    "*/motion.py",
    "*/overview.py",
    "*/papers.py",
)
#: Files that contain a question each, of which no question knows another.
QUESTIONS = "*/questions/*"


def computation(where: str, fmus: Mapping[str, Path], *packages: str) -> dict[str, Any]:
    """Return what the runs of a question depend on besides their options.

    The question is the one that `where` loads, with these FMUs by part; `packages` are those that it lies
    in.
    """
    is_file = where.endswith(".py")
    known, own = facts(*packages), f"{where.replace('.', '/')}.py"
    code = {
        name: text
        for name, text in known["code"].items()
        if name == own or not fnmatch(name, QUESTIONS)
    }
    return {
        "question": _code_digest(Path(where), is_question=True) if is_file else where,
        "fmus": {part: describe_fmu(part, path).guid for part, path in fmus.items()},
        "contents": {part: digest(path.read_bytes()) for part, path in fmus.items()},
        **known,
        "code": code,
    }


def facts(*packages: str) -> dict[str, dict[str, str]]:
    """Code and versions, which are the same on all machines that work together."""
    versions = cosim.versions()
    needed = {name: versions[name] for name in ("python", "numpy", "scipy", "fmpy")}
    return {"code": code(*SOURCES, *packages), "versions": needed}


@cache
def code(*packages: str) -> dict[str, str]:
    """A hash of what each source file of these packages computes, but for those that only show results.

    Comments and docstrings are not in it. Of a study, what its runs are given is hashed instead of the code
    that makes it.
    """
    hashes = {}
    for package in packages:
        spec = find_spec(package)
        assert spec is not None
        for folder in map(Path, spec.submodule_search_locations or ()):
            for path in sorted(folder.rglob("*")):
                name = f"{package}/{path.relative_to(folder).as_posix()}"
                is_presentation = any(fnmatch(name, pattern) for pattern in PRESENTATION)
                if path.suffix in (".py", ".c") and not is_presentation:
                    hashes[name] = _code_digest(path, is_question=fnmatch(name, QUESTIONS))
    return hashes


def _code_digest(path: Path, *, is_question: bool) -> str:
    """The digest of what a file computes; of one that is no Python, that of its bytes."""
    content = path.read_bytes()
    try:
        return (
            digest(content)
            if path.suffix != ".py"
            else code_digest(content, is_question=is_question)
        )
    except (SyntaxError, ValueError):
        return digest(content)
