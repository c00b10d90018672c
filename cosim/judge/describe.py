"""What a system is made of and what stands in the way of a run, in plain words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from fmpy import supported_platforms
from fmpy.model_description import ModelDescription

from ..engine.ledger import bonds
from ..inputs import Course, Table
from ..loops import algebraic_loops, describe
from ..master import Settings, problems, stepping_order
from ..system import Connection, Network, Port, exponents

ANGLE = (0, 0, 0, 0, 0, 0, 0, 1)
ABILITIES = {
    "canGetAndSetFMUstate": "restores its state",
    "canHandleVariableCommunicationStepSize": "varies its step",
    "canInterpolateInputs": "interpolates inputs",
    "providesDirectionalDerivative": "gives directional derivatives",
    "hasEventMode": "has event mode",
    "mightReturnEarlyFromDoStep": "returns early at events",
    "providesIntermediateUpdate": "shows values within a step",
    "needsExecutionTool": "needs its tool",
}


def info(network: Network) -> Iterator[str]:
    """Parts with their inputs and outputs, wires, start values, power bonds."""
    platforms = cache(supported_platforms)
    first = {wire.target: wire for wire in reversed(network.wires)}
    for name, description in network.descriptions.items():
        path = Path(network.system.parts[name])
        yield from _part(name, description, path.name, platforms(str(path)))
        for terminal, members in network.fmus[name].terminals.items():
            yield f"  terminal {name}.{terminal}: {', '.join(members)}"
    for title, lines in (
        ("wires", [_wire(wire, adds=first[wire.target] is not wire) for wire in network.wires]),
        ("start values", [f"{port} = {value!r}" for port, value in network.start]),
        ("inputs over time", [_course(port, profile) for port, profile in network.inputs]),
        ("power bonds", [bond.name for bond in bonds(network)]),
    ):
        if lines:
            yield title
            yield from (f"  {line}" for line in lines)


def _part(
    name: str, description: ModelDescription, file: str, platforms: Sequence[str]
) -> Iterator[str]:
    version = "" if description.fmiVersion == "2.0" else f", FMI {description.fmiVersion}"
    yield f"{name}: {description.modelName}, {file}{version}"
    if description.description:
        yield f"  {description.description}"
    yield f"  for {', '.join(platforms)}; {_abilities(description)}"
    for causality in ("input", "output"):
        ports = [Port(name, v) for v in description.modelVariables if v.causality == causality]
        for port in ports:
            yield f"  {causality:<7} {port}: {port.native}{_said(port)}"
    parameters = [v for v in description.modelVariables if v.causality == "parameter"]
    yield f"  {len(parameters)} parameters"


def _course(port: Port, profile: Table | Course) -> str:
    return f"{port}: {', '.join(f'{what} {value}' for what, value in profile.told().items())}"


def _said(port: Port) -> str:
    return f", {port.variable.description}" if port.variable.description else ""


def _abilities(description: ModelDescription) -> str:
    if description.coSimulation is None:
        return "for model exchange only"
    can = [text for flag, text in ABILITIES.items() if getattr(description.coSimulation, flag)]
    return ", ".join(can) or "fixed steps forward only"


def _wire(wire: Connection, *, adds: bool = False) -> str:
    scaled = "" if wire.factor == 1.0 else f" * {wire.factor:.12g}"
    shifted = "" if wire.offset == 0.0 else f" {wire.offset:+.12g}"
    return f"{wire.source}{scaled}{shifted} {'+' if adds else '-'}> {wire.target}"


def check(network: Network, settings: Settings) -> tuple[list[str], list[str]]:
    """What keeps the system from being run like this, and what is worth knowing about it."""
    return list(problems(network, settings)), list(_notes(network, settings))


def _notes(network: Network, settings: Settings) -> Iterator[str]:
    for name, blemish in network.blemishes.items():
        yield f"{name}: {blemish}"
    for port, value in network.open:
        yield f"input {port} is open and keeps the start of its FMU, {value!r}"
    yield f"order of steps: {', '.join(stepping_order(network, settings.order))}"
    for loop in algebraic_loops(network):
        yield f"algebraic loop: {describe(loop)}"
    silent = [
        name
        for name, description in network.descriptions.items()
        if any(unknown.dependencies is None for unknown in description.outputs)
    ]
    if silent:
        yield f"{', '.join(silent)}: dependencies of outputs not declared; loops may go unseen"
    for wire in network.wires:
        if wire.source.type != "Real":
            continue
        if not wire.source.unit or not wire.target.unit:
            yield f"{_wire(wire)}: without a unit at both ends nothing is checked"
        unit = network.base_unit(wire.source)
        if unit is not None and exponents(unit) == ANGLE:
            yield (
                f"{_wire(wire)}: an angle that is held over a step pushes a stiff shaft ahead of "
                "itself; exchange its speed and let the other side integrate"
            )
    for bond in bonds(network):
        yield f"power bond: {bond.name}"
    yield from _steps(network)
    if settings.algorithm == "jacobi" and bonds(network):
        yield (
            "jacobi delays every loop by a step, which takes damping away from its oscillations: "
            "see what it does with diagnose"
        )


def preferred_steps(network: Network) -> dict[str, float]:
    """The communication step that each FMU prefers [s], as far as they say."""
    return {
        name: float(description.defaultExperiment.stepSize)
        for name, description in network.descriptions.items()
        if description.defaultExperiment and description.defaultExperiment.stepSize
    }


def _steps(network: Network) -> Iterator[str]:
    preferred = preferred_steps(network)
    if preferred:
        part = min(preferred, key=lambda name: preferred[name])
        yield f"recommended step: {preferred[part]!r} s, which {part} prefers"
    else:
        yield "recommended step: no FMU prefers one; diagnose measures what a step does"


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows in aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip()
