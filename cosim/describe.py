"""Describe in plain words what a system is made of and what may prevent a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache

from fmpy import supported_platforms

from .engine.algorithms import find_algorithm
from .engine.energy import find_bonds
from .engine.settings import RunSettings
from .json_values import Json
from .system import ANGLE, Connection, Network, Port, run_obstacles, unit_exponents
from .system.graph import algebraic_loops, describe_loop, stepping_order

ABILITIES = {
    "canGetAndSetFMUstate": "restores its state",
    "canHandleVariableCommunicationStepSize": "varies its step",
    "canInterpolateInputs": "interpolates inputs",
    "providesDirectionalDerivative": "gives directional derivatives",
    "hasEventMode": "has event mode",
    "mightReturnEarlyFromDoStep": "returns early at events",
    "providesIntermediateUpdate": "shows values within a step",
    "canRunAsynchronuously": "may step asynchronously, which is not supported",
    "needsExecutionTool": "needs its tool",
}


def info(network: Network) -> Iterator[str]:
    """Parts with their inputs and outputs, wires, start values, power bonds."""
    platforms = cache(supported_platforms)

    def facts(provenance: Mapping[str, Json]) -> str:
        return ", ".join(f"{key} {value}" for key, value in provenance.items())

    first = {wire.target: wire for wire in reversed(network.wires)}
    for name, description in network.descriptions.items():
        path = network.fmus[name].path
        version = "" if description.fmiVersion == "2.0" else f", FMI {description.fmiVersion}"
        yield f"{name}: {description.modelName}, {path.name}{version}"
        if description.description:
            yield f"  {description.description}"
        side = description.coSimulation
        can = [text for flag, text in ABILITIES.items() if side and getattr(side, flag)]
        abilities = (
            ", ".join(can) or "fixed steps forward only" if side else "for model exchange only"
        )
        if not side and not description.modelExchange:
            abilities = "for scheduled execution only"
        if description.generationTool:
            yield f"  made by {description.generationTool}"
        yield f"  for {', '.join(platforms(str(path))) or 'no platform'}; {abilities}"
        variables = description.modelVariables
        for causality in ("input", "output", "parameter"):
            for port in (Port(name, v) for v in variables if v.causality == causality):
                note = f", {port.variable.description}" if port.variable.description else ""
                start = f" = {port.variable.start}" if causality == "parameter" else ""
                yield f"  {causality:<7} {port}{start}: {port.native}{note}"
        for terminal, members in network.fmus[name].terminals.items():
            yield f"  terminal {name}.{terminal}: {', '.join(members)}"
    for title, lines in (
        ("wires", [_wire(wire, adds=first[wire.target] is not wire) for wire in network.wires]),
        ("start values", [f"{port} = {value!r}" for port, value in network.start]),
        ("inputs over time", [f"{port}: {facts(p.provenance())}" for port, p in network.inputs]),
        ("power bonds", [bond.name for bond in find_bonds(network)]),
    ):
        if lines:
            yield title
            yield from (f"  {line}" for line in lines)
    for obstacle in run_obstacles(network):
        yield f"cannot run here: {obstacle}"


def _wire(wire: Connection, *, adds: bool = False) -> str:
    scaled = "" if wire.factor == 1.0 else f" * {wire.factor:.12g}"
    shifted = "" if wire.offset == 0.0 else f" {wire.offset:+.12g}"
    return f"{wire.source}{scaled}{shifted} {'+' if adds else '-'}> {wire.target}"


def notes(network: Network, settings: RunSettings) -> Iterator[str]:
    """What is worth knowing about a run of the system, whether it is possible or not."""
    yield from settings.foreseen_warnings(network, in_full=True)
    for name, description in network.descriptions.items():
        if description.coSimulation and description.coSimulation.canRunAsynchronuously:
            yield f"{name}: a step that goes on after doStep has returned is not supported"
    for port, value in network.open:
        yield f"input {port} is open and keeps the start value of its FMU, {value!r}"
    yield f"order of steps: {', '.join(stepping_order(network, settings.order))}"
    for loop in algebraic_loops(network):
        yield f"algebraic loop: {describe_loop(loop)}"
    silent = [
        name
        for name, description in network.descriptions.items()
        if any(unknown.dependencies is None for unknown in description.outputs)
    ]
    if silent:
        yield f"{', '.join(silent)}: output dependencies not declared; loops may go unnoticed"
    for wire in network.wires:
        if wire.source.type != "Real":
            continue
        if not wire.source.unit or not wire.target.unit:
            yield f"{_wire(wire)}: units are not checked unless both ends have one"
        unit = network.base_unit(wire.source)
        if unit is not None and unit_exponents(unit) == ANGLE:
            yield (
                f"{_wire(wire)}: an angle held over a step pushes a stiff shaft ahead of itself; "
                "exchange the speed and let the other side integrate it"
            )
    for bond in find_bonds(network):
        yield f"power bond: {bond.name}"
    if preferred := preferred_steps(network):
        part = min(preferred, key=preferred.__getitem__)
        yield f"recommended step: {preferred[part]!r} s, preferred by {part}"
    else:
        yield "recommended step: no FMU prefers one; use diagnose to measure what a step does"
    algorithm = find_algorithm(settings.algorithm)
    if algorithm.delays_every_wire([*network.descriptions]) and find_bonds(network):
        yield (
            f"{algorithm.name} delays every loop by a step, which reduces the damping of its oscillations: "
            "use diagnose to measure by how much"
        )


def preferred_steps(network: Network) -> dict[str, float]:
    """The communication step that each FMU prefers [s], as far as they say."""
    steps = {name: d.defaultExperiment.step for name, d in network.descriptions.items()}
    return {name: step for name, step in steps.items() if step is not None}


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows in aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip()
