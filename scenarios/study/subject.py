"""What a study studies: a scenario, its options, the FMUs behind it."""

from __future__ import annotations

import inspect
import re
from argparse import Action, ArgumentParser
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType

from cosim.system import Network, System, describe_fmu

from .. import fmus

UNIT = re.compile(r"\[([^\]]+)\]")
KINDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
OWN = ("start", "jobs", "out", "animate")


class Option:
    """An option of a scenario: its type, what it may be, its unit."""

    def __init__(self, default: object, action: Action | None) -> None:
        self.choices = list(action.choices) if action and action.choices else []
        kind = action.type if action else type(default)
        self.kind = kind if kind in (float, int) else bool if isinstance(default, bool) else str
        if action is None and default in (None, inspect.Parameter.empty):
            self.kind = float
        found = UNIT.search((action.help if action else None) or "")
        self.unit = found[1] if found else ""

    def value(self, value: object) -> float | int | str | bool:
        """The value as the option takes it; raises ValueError with what was expected."""
        if self.choices and value not in self.choices:
            raise ValueError(f"one of {', '.join(map(str, self.choices))}")
        if self.kind is float and isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        if type(value) is not self.kind:
            raise ValueError(KINDS[self.kind])
        assert isinstance(value, int | str | bool)
        return value


def options(module: ModuleType) -> dict[str, Option]:
    """The options of a scenario that a study may set, by keyword."""
    parser = ArgumentParser()
    if hasattr(module, "arguments"):
        module.arguments(parser)
    actions = {action.dest: action for action in parser._actions}
    taken = inspect.signature(module.answer).parameters
    return {
        name: Option(parameter.default, actions.get(name))
        for name, parameter in taken.items()
        if name not in OWN
    }


def takes_start(module: ModuleType) -> bool:
    """Whether a scenario takes start values of FMUs."""
    return "start" in inspect.signature(module.answer).parameters


def parts(module: ModuleType) -> Mapping[str, str]:
    """The components behind a scenario by the name of their part; a file of one's own may have none."""
    found: Mapping[str, str] = getattr(module, "PARTS", {})
    return found


def network(module: ModuleType) -> Network:
    """The built FMUs of a scenario, to look up variables in; not wired."""
    system = System({part: fmus.fmu(component) for part, component in parts(module).items()})
    descriptions = {part: describe_fmu(part, path) for part, path in system.parts.items()}
    return Network(system, descriptions, [], [])


def units(module: ModuleType, varied: Sequence[str], fixed: Iterable[str]) -> dict[str, str]:
    """The units of the varied inputs.

    Raises SetupError for a start value, varied or fixed, that no FMU of the scenario has.
    """
    known, by_name = options(module), network(module)
    for name in fixed:
        if "." in name and by_name.descriptions:
            by_name.port(name)
    found = {}
    for name in varied:
        if "." not in name:
            found[name] = known[name].unit
        else:
            found[name] = by_name.port(name).unit if by_name.descriptions else ""
    return found
