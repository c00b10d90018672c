"""What a study studies: a question, its options, the FMUs behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType

from cosim.system import Network, System, describe_fmu

from ..options import declared


def network(fmus: Mapping[str, Path]) -> Network:
    """FMUs by part, to look up variables in; not wired."""
    descriptions = {part: describe_fmu(part, path) for part, path in fmus.items()}
    return Network(System(dict(fmus)), descriptions, [], [])


def units(
    page: ModuleType, fmus: Mapping[str, Path], varied: Sequence[str], fixed: Iterable[str]
) -> dict[str, str]:
    """The units of the varied inputs.

    Raises SetupError for a start value, varied or fixed, that no FMU of the question has.
    """
    known, by_name = declared(page.Options), network(fmus)
    for name in fixed:
        if "." in name:
            by_name.port(name)
    return {name: known[name].unit if name in known else by_name.port(name).unit for name in varied}
