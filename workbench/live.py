"""The live part of a page: a question asked again in the browser, with the modules of its FMUs.

A page declares `LIVE`, sliders over its options and start values. Its functions are translated, along
with all they use of the workbench. A `solve` may yield functions without parameters, each of which makes
a Show of what is known so far. An option without a value of its own takes the value of that name from
the data of the findings.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim import SetupError
from cosim.system import Network, connect

from .figure import whole
from .limit import certified
from .options import Options, declared
from .report.html import motion
from .report.plot import figure
from .translate import script

if TYPE_CHECKING:
    from .answer import Findings, Parameter

FOLDER = Path(__file__).with_name("report") / "live"
ENGINE = ("numbers.js", "master.js", "python.js")
ASKED = ("solve", "system", "figures", "verdict", "show", "Options")


class Slider(NamedTuple):
    """An option or a start value of an FMU, "motor.T", and the range of its slider, which is widened to
    include a requested value outside it.
    """

    name: str
    low: float
    high: float


class Live(NamedTuple):
    """What the browser gets: modules by part, the worker's script, and data, sliders among them."""

    modules: Mapping[str, bytes]
    script: str
    data: dict[str, Any]


@cache
def script_of(page: ModuleType) -> str:
    """What a worker runs to answer a page; raises SetupError for what cannot be translated."""
    roots = {name: getattr(page, name, None) for name in ASKED}
    roots |= {"record": getattr(page, "RECORD", None), "certified": certified, "whole": whole}
    roots |= {"picture": figure, "moving": motion}
    runtime = "\n".join(_read(FOLDER / name) for name in ENGINE)
    made = script(roots, [page.__name__.partition(".")[0]])
    for name in sorted(set(re.findall(r"\b(?:np|math|lib)\.(\w+)", made))):
        if not re.search(rf"\b{name}\b", runtime):
            raise SetupError(f"LIVE cannot use {name}, which report/live/python.js does not have")
    return "\n".join(
        [runtime, made, *(_read(FOLDER / name) for name in ("answer.js", "worker.js"))]
    )


@cache
def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8").replace('"use strict";\n', "", 1)


def of(
    page: ModuleType,
    o: Options,
    found: Findings,
    parameters: Mapping[str, Parameter],
    modules: Mapping[str, Path],
    command: str,
) -> Live | None:
    """The live part of an answer; None where the page has none or a module of its parts is not there.

    `command` is the start of the command line that asked for it. Raises SetupError for a slider that
    moves nothing, and for what cannot be translated.
    """
    sliders: tuple[Slider, ...] = getattr(page, "LIVE", ())
    if not sliders or found.system is None or not set(found.system.parts) <= set(modules):
        return None
    network = connect(found.system)
    told = declared(type(o))
    options = {name: getattr(o, name) for name in told}
    changed = {name: x for name, x in options.items() if x != told[name].read(told[name].default)}
    words = []
    for name, low, high in sliders:
        if name not in told and name not in parameters:
            raise SetupError(f"LIVE: {name!r} is neither an option nor a start value")
        known = told.get(name) or parameters[name]
        value = parameters[name].value if name in parameters else options[name]
        value = getattr(found.data, name, None) if value is None else value
        if value is None:
            raise SetupError(f"LIVE: {name!r} has no value of its own, and none in the data")
        value = float(value)
        words.append({
            "name": name, "meaning": _heading(known.meaning), "unit": known.unit, "value": value,
            "low": min(low, value), "high": max(high, value), "option": name in told,
        })  # fmt: skip
    data = {
        "sliders": words,
        "options": options,
        "machine": {
            "order": found.provenance.get("convergence_order"),
            "late": found.provenance.get("first_order", []),
            "outputs": _variables(network, "output"),
            "parameters": _variables(network, "parameter"),
            "units": {
                part: {x.name: network.port(f"{part}.{x.name}").unit for x in told.modelVariables}
                for part, told in network.descriptions.items()
            },
        },
        "command": [command, *(_words(name, x) for name, x in changed.items())],
        "asked": {port.name: value for port, value in network.start if port.name in o.start},
    }
    taken = {part: modules[part].read_bytes() for part in network.descriptions}
    return Live(taken, script_of(page), data)


def _variables(network: Network, causality: str) -> dict[str, list[str]]:
    """Names by part, of what is no text."""
    return {
        part: [x.name for x in d.modelVariables if x.causality == causality and x.type != "String"]
        for part, d in network.descriptions.items()
    }


def _heading(meaning: str) -> str:
    """A meaning above a slider: without what is said of its default."""
    first = meaning.partition(", ")[0]
    return first[:1].upper() + first[1:]


def _words(name: str, value: Any) -> str:
    """An option as a command line has it."""
    flag = f"--{name.replace('_', '-')}"
    if isinstance(value, bool):
        return flag if value else f"--no-{flag[2:]}"
    if isinstance(value, tuple):
        value = ",".join(map(str, value))
    return f"{flag} {value}"
