"""What makes two sessions the same study: what the file says, FMUs, code and versions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .. import fmus
from ..runs.source import digest, sources, versions
from . import subject
from .plan import Study

PRESENTATION = "figures"
SHOWN = 4


def identity(study: Study) -> dict[str, Any]:
    """Everything that the rows of a study depend on."""
    own = study.path.parent / study.scenario
    descriptions = subject.network(study.module).descriptions
    return {
        "file": {key: value for key, value in study.content.items() if key != PRESENTATION},
        "scenario": digest(own.read_bytes()) if own.suffix == ".py" else study.scenario,
        "inputs": study.hash(),
        "flavour": fmus.flavour(),
        "fmus": {part: description.guid for part, description in descriptions.items()},
        "code": {
            name: code
            for name, code in sources().items()
            if not name.startswith("scenarios/study/")
        },
        "versions": versions(),
    }


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What is not the same, key by key, in one line."""
    found = list(_differences(before, now, ()))
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return "; ".join(found[:SHOWN]) + more


def _differences(before: Any, now: Any, keys: Sequence[str]) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*before, *now]):
            yield from _differences(before.get(key), now.get(key), [*keys, key])
    elif before != now:
        name = ".".join(f'"{key}"' if "." in key else key for key in keys)
        yield f"{name} was {_text(before)} and is {_text(now)}"


def _text(value: object) -> str:
    return "not there" if value is None else repr(value)
