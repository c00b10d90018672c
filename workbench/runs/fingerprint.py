"""What the bits of a result depend on: versions, code, FMUs; and what differs between two of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatch
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cosim
from cosim.system import describe_fmu

from .transport import digest

SOURCES = ("cosim", "workbench")
PRESENTATION = (
    "workbench/charts/*",
    "workbench/page/*",
    "workbench/study/*",
    "*/show.py",
    "*/mechanism.py",
)
#: Differences that a message lists; chosen: they fit a line.
MAX_DIFFERENCES = 4
DIGEST = re.compile(r"\{?[0-9a-f-]{16,}\}?")


def computation(where: str, fmus: Mapping[str, Path], *packages: str) -> dict[str, Any]:
    """Return what the runs of a question depend on besides their options.

    The question is the one that `where` loads, with these FMUs by part; `packages` are those that it lies
    in.
    """
    is_file = where.endswith(".py")
    return {
        "question": digest(Path(where).read_bytes()) if is_file else where,
        "fmus": {part: describe_fmu(part, path).guid for part, path in fmus.items()},
        "contents": {part: digest(path.read_bytes()) for part, path in fmus.items()},
        **facts(*packages),
    }


def facts(*packages: str) -> dict[str, dict[str, str]]:
    """Code and versions, which are the same on all machines that work together."""
    versions = cosim.versions()
    needed = {name: versions[name] for name in ("python", "numpy", "scipy", "fmpy")}
    return {"code": code(*SOURCES, *packages), "versions": needed}


@cache
def code(*packages: str) -> dict[str, str]:
    """A hash of each source file of these packages but those that only show results.

    Of a study, what its runs are given is hashed instead of the code that makes it.
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
                    hashes[name] = digest(path.read_bytes())
    return hashes


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What is not the same, key by key, in one line; of hashes only that they are not."""
    changes = list(_differences(before, now, ()))
    more = f" and {len(changes) - MAX_DIFFERENCES} more" if len(changes) > MAX_DIFFERENCES else ""
    return "; ".join(changes[:MAX_DIFFERENCES]) + more


def _differences(before: Any, now: Any, keys: Sequence[str]) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*before, *now]):
            yield from _differences(before.get(key), now.get(key), [*keys, key])
    elif before != now:
        name = ".".join(f'"{key}"' if "." in key else key for key in keys)
        if all(isinstance(value, str) and DIGEST.fullmatch(value) for value in (before, now)):
            yield f"{name} has changed"
        else:
            yield f"{name} was {_text(before)} and is {_text(now)}"


def _text(value: object) -> str:
    if value is None:
        return "not there"
    return "there" if isinstance(value, str) and DIGEST.fullmatch(value) else repr(value)
