"""A flattened SSP system: connectors, the arrows between them, and what flows along the arrows."""

from __future__ import annotations

import logging
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from ...errors import SetupError
from ...system import Value, Wire, enumeration, legal_part_name
from ...system.base_units import Unit
from ...system.description import ModelDescription, Variable
from .files import ELEMENT, LINK, Budget
from .parameters import Parameter
from .units import Step, chain, unit_of, with_definition

Node = tuple[str, str]
DOWNWARD = ("input", "parameter")
IDENTITY = (1.0, 0.0)
#: Deepest nesting of systems. Chosen: far above real ones, and below the limit of recursion.
DEEPEST = 50
#: Most connectors that values may pass on their way. Chosen: likewise.
LONGEST = 200
log = logging.getLogger("cosim")


class Connector(NamedTuple):
    """A connector of a system or a variable of an FMU; `items` are those of an enumeration."""

    kind: str
    type: str | None
    unit: Unit | None
    items: dict[str, int] | None = None


@lru_cache(maxsize=64)
def _connectors_of(description: ModelDescription) -> dict[str, Connector]:
    """The variables of an FMU as connectors."""
    return {
        v.name: Connector(v.causality, v.type, unit_of(v, description), enumeration(v))
        for v in description.modelVariables
    }


class Flow(NamedTuple):
    """Flow of values from one connector to another."""

    source: Node
    target: Node
    step: Step


@dataclass(frozen=True)
class FlatSystem:
    """Elements by dotted path, the outermost system by ""; connectors by path and name.

    `exchange` are the parts for which the file asks for model exchange.
    """

    budget: Budget
    elements: dict[str, dict[str, str]] = field(default_factory=dict)
    exchange: list[str] = field(default_factory=list)
    connectors: dict[Node, Connector] = field(default_factory=dict)
    fmus: dict[str, Path] = field(default_factory=dict)
    descriptions: dict[str, ModelDescription] = field(default_factory=dict)
    variables: dict[Node, Variable] = field(default_factory=dict)
    into: dict[Node, Flow] = field(default_factory=dict)
    declared: set[Node] = field(default_factory=set)
    out: dict[Node, list[Flow]] = field(default_factory=lambda: defaultdict(list))
    start: dict[Node, Value] = field(default_factory=dict)
    bonds: list[str] = field(default_factory=list)

    def add_element(self, outer: str, name: str) -> str:
        """The path of a new element, a name for a part; raises SetupError for one that is taken."""
        if (part := legal_part_name(name)) != name:
            log.warning("element %r becomes %s", name, part)
        path = f"{outer}.{part}" if outer else part
        self.budget.take(path, ELEMENT)
        if path.count(".") > DEEPEST:
            raise SetupError(f"systems are nested more than {DEEPEST} deep")
        if path in self.elements or path in self.fmus:
            raise SetupError(f"there are two elements {path}")
        self.elements.setdefault(outer, {})[name] = path
        return path

    def add_fmu(self, path: str, file: Path, description: ModelDescription) -> None:
        """An element that is an FMU, with all its variables as connectors."""
        self.budget.take(f"part {path}", len(description.modelVariables))
        self.fmus[path], self.descriptions[path] = file, description
        self.variables.update({(path, v.name): v for v in description.modelVariables})
        self.connectors.update(
            {(path, name): connector for name, connector in _connectors_of(description).items()}
        )

    def add_arrow(self, arrow: Flow) -> None:
        """A connection; raises SetupError if its target has one already or is its own source."""
        self.budget.take(arrow.step.where, LINK)
        if arrow.target in self.into:
            other = dotted(self.into[arrow.target].source)
            raise SetupError(
                f"{arrow.step.where}: {dotted(arrow.target)} is also driven by {other}"
            )
        self.into[arrow.target] = arrow
        self.out[arrow.source].append(arrow)
        if any(before.source == arrow.target for before in self._back(arrow.target)):
            raise SetupError(f"{arrow.step.where}: {dotted(arrow.target)} is connected to itself")

    def _back(self, node: Node) -> Iterator[Flow]:
        """The arrows that lead to a connector, the last one first."""
        for _ in range(LONGEST):
            if node not in self.into:
                return
            yield self.into[node]
            node = self.into[node].source
        raise SetupError(f"{dotted(node)}: values pass more than {LONGEST} connectors")

    def origin(self, node: Node) -> tuple[Node, list[Step]]:
        """Where the values of a connector come from, and the steps they take."""
        arrows = [*self._back(node)][::-1]
        steps = [a.step._replace(unit=self.connectors[a.target].unit) for a in arrows]
        return (arrows[0].source if arrows else node), steps

    def leaves(self, node: Node, steps: tuple[Step, ...] = ()) -> Iterator[tuple[Node, list[Step]]]:
        """The variables that the values of a connector reach, and the steps they take."""
        if node in self.variables:
            yield node, list(steps)
            return
        if len(steps) > LONGEST:
            raise SetupError(f"{dotted(node)}: values pass more than {LONGEST} connectors")
        for arrow in self.out[node]:
            step = arrow.step._replace(unit=self.connectors[arrow.target].unit)
            yield from self.leaves(arrow.target, (*steps, step))

    def bind(self, path: str, parameter: Parameter) -> bool:
        """Apply a parameter to all variables and connectors of its name; whether there are any."""
        self.budget.take(parameter.where, LINK)
        reached = [self._assign(node, parameter) for node in self.named(path, parameter.name)]
        return any(reached)

    def named(self, path: str, name: str) -> Iterator[Node]:
        """The connectors and variables that a dotted name means in an element."""
        if (path, name) in self.connectors:
            yield path, name
        for dot in re.finditer(r"\.", name):
            if (inner := self.elements.get(path, {}).get(name[: dot.start()])) is not None:
                yield from self.named(inner, name[dot.end() :])

    def _assign(self, node: Node, parameter: Parameter) -> bool:
        """Give the variables behind a connector a start value; whether there are any."""
        connector = self.connectors[node]
        first = parameter.step._replace(unit=connector.unit, where=parameter.where)
        if node in self.variables or connector.kind in DOWNWARD:
            leaves = list(self.leaves(node))
            for leaf, steps in leaves:
                unit = self._with_definition(parameter.unit, leaf)
                relative = self.variables[leaf].relativeQuantity
                self._set(leaf, parameter, chain(unit, [first, *steps], relative=relative))
            return bool(leaves)
        source, steps = self.origin(node)
        if source not in self.variables:
            return False
        unit = self._with_definition(parameter.unit, source)
        last = Step(parameter.where, connector.unit or unit)
        relative = self.variables[source].relativeQuantity
        factor, offset = chain(self.connectors[source].unit, [*steps, last], relative=relative)
        scale, shift = chain(unit, [first], relative=relative)
        if factor == 0.0:
            raise SetupError(f"{parameter.where}: the factor of the connection is zero")
        self._set(source, parameter, (scale / factor, (shift - offset) / factor))
        return True

    def _with_definition(self, unit: Unit | None, node: Node) -> Unit | None:
        if unit is None:
            return None
        return with_definition(unit, self.descriptions[node[0]], self.variables[node].unit)

    def _set(self, node: Node, parameter: Parameter, scale: tuple[float, float]) -> None:
        self.budget.take(parameter.where, LINK)
        value = parameter.fit(self.variables[node])
        if scale != IDENTITY:
            if self.variables[node].type != "Real":
                raise SetupError(
                    f"{parameter.where}: {dotted(node)} is not a Real and cannot be scaled"
                )
            value = scale[0] * float(value) + scale[1]
        self.start[node] = value

    def wires(self) -> list[Wire]:
        """The connections between FMUs as wires of a System."""
        wires = []
        for node in self.into:
            source, steps = self.origin(node)
            if node not in self.variables or source not in self.variables:
                continue
            if self.connectors[node].kind != "input" or self.connectors[source].kind != "output":
                raise SetupError(
                    f"{steps[-1].where}: a connection from {self.connectors[source].kind} {dotted(source)} to "
                    f"{self.connectors[node].kind} {dotted(node)} is not supported, only one from an output to an input: "
                    "give the other a start value"
                )
            wires.append(self._wire(source, node, steps))
        return wires

    def _wire(self, source: Node, target: Node, steps: list[Step]) -> Wire:
        where = steps[-1].where
        ends = [(self.variables[node], self.descriptions[node[0]]) for node in (source, target)]
        relative = all(variable.relativeQuantity for variable, _ in ends)
        factor, offset = chain(self.connectors[source].unit, steps, relative=relative)
        if not math.isfinite(factor + offset):
            raise SetupError(f"{where}: factor {factor!r} and offset {offset!r} must be finite")
        source_unit, target_unit = (unit_of(*end) for end in ends)
        try:
            plain = chain(source_unit, [Step(where, target_unit)])
        except SetupError:
            plain = None
        if (factor, offset) == plain:
            return Wire(source, target)
        return Wire(source, target, factor, offset, plain == IDENTITY)

    def starts(self) -> dict[str, Value]:
        """The start values that are bound."""
        return {dotted(node): value for node, value in self.start.items()}

    def interface(self) -> dict[str, tuple[Wire, ...]]:
        """The wires between the connectors of the outermost system and the variables behind them, by connector."""
        wires: dict[str, tuple[Wire, ...]] = {}
        for (path, name), connector in self.connectors.items():
            if path:
                continue
            if connector.kind in DOWNWARD:
                ends = [
                    (name, dotted(leaf), connector.unit, steps)
                    for leaf, steps in self.leaves((path, name))
                ]
            else:
                source, steps = self.origin((path, name))
                ends = [(dotted(source), name, self.connectors[source].unit, steps)]
                if source not in self.variables:
                    continue
            if ends:
                wires[name] = tuple(
                    Wire(a, b, *chain(unit, steps), converts=False) for a, b, unit, steps in ends
                )
        return wires


def same_variable(name: str, wires: Sequence[Wire]) -> str:
    """The variable that a connector stands for as it is; "" if there is none."""
    if len(wires) != 1 or wires[0][2:4] != IDENTITY:
        return ""
    ends = str(wires[0].source), str(wires[0].target)
    return ends[1] if ends[0] == name else ends[0]


def dotted(node: Node) -> str:
    """The name of a connector with its element's path."""
    return ".".join(filter(None, node))
