"""Directional derivatives of traced functions, by the rules of differentiation, in forward mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .tracer import (
    COMPARISONS,
    NODES,
    PATHS,
    Branch,
    Function,
    Node,
    Tracer,
    Tree,
    Untraceable,
    called,
    function,
    kinds,
    operation,
    symbol,
)


def forward(
    tracer: Tracer, traced: Function, groups: Sequence[Any], tangents: Sequence[Sequence[Any]]
) -> list[Any]:
    """How the results change when the numbers that are its arguments change so."""
    active = tuple(any(map(changes, group)) for group in tangents)
    if not any(active):
        return [0.0 for _ in kinds(traced.shape)]
    given = [tuple(group) for group, is_active in zip(tangents, active) if is_active]
    return called(derived(tracer, traced, active), [*map(tuple, groups), *given])


def changes(tangent: Any) -> bool:
    return isinstance(tangent, Node) or tangent != 0.0


def derived(tracer: Tracer, traced: Function, active: tuple[bool, ...]) -> Function:
    """The function of the arguments, and of the tangents of the active ones, that gives tangents."""
    identity = (derived, traced.name, active)
    if identity not in tracer.functions:
        names = [name for name, shape in traced.parameters.items() if list(kinds(shape))]
        moving = {f"d_{name}" for name, is_active in zip(names, active, strict=True) if is_active}
        shapes = {f"d_{name}": plain(shape) for name, shape in traced.parameters.items()}
        shapes = traced.parameters | {name: shapes[name] for name in shapes if name in moving}
        name = f"d_{traced.name}_{len(tracer.functions)}"
        tracer.functions[identity] = None
        made = function(name, lambda **_: Tangents(tracer, moving).along(traced.tree), shapes)
        if made is None:
            raise Untraceable(f"the derivative of {traced.name}")
        del tracer.functions[identity]
        tracer.functions[identity] = made
    found = tracer.functions[identity]
    assert found is not None
    return found


def plain(shape: Any) -> Any:
    """As many numbers, without their types."""
    if shape == "number":
        return shape
    return tuple, tuple("number" for _ in kinds(shape))


class Tangents:
    """The tangents of the nodes on a path through a tree."""

    def __init__(self, tracer: Tracer, moving: set[str]) -> None:
        self.tracer, self.moving = tracer, moving
        self.known: dict[int, Any] = {}

    def along(self, tree: Tree) -> list[Any]:
        for node in tree.nodes:
            PATHS[-1].visit(node)
            self.known[node.number] = self.rule(node)
        if isinstance(tree, Branch):
            return self.along(tree.true if tree.condition else tree.false)
        if tree.error is not None:
            raise ValueError(tree.error)
        return [self.of(value) for value in tree.values]

    def of(self, value: Any) -> Any:
        if not isinstance(value, Node) or value.op in COMPARISONS:
            return 0.0
        if value.op in ("symbol", "element"):
            name, *place = value.args
            return symbol(value.op, f"d_{name}", *place) if f"d_{name}" in self.moving else 0.0
        if value.op == "result":
            call, place = value.args
            return self.known[NODES[call].number][place]
        return self.known[value.number]

    def rule(self, node: Node) -> Any:
        if node.op == "call":
            traced, groups = node.args
            tangents = [[self.of(value) for value in group] for group in groups]
            return forward(self.tracer, traced, groups, tangents)
        if node.op not in RULES:
            raise Untraceable(f"the derivative of {node.op}")
        tangents = [self.of(arg) for arg in node.args]
        if not any(map(changes, tangents)):
            return 0.0
        return RULES[node.op](node, *node.args, *tangents)


def plus(a: Any, b: Any) -> Any:
    return a + b if changes(a) and changes(b) else a if changes(a) else b


def times(a: Any, tangent: Any) -> Any:
    return a * tangent if changes(tangent) else 0.0


def power(_: Node, base: Any, exponent: float, tangent: Any, __: Any) -> Any:
    slope = exponent * base if exponent == 2.0 else exponent * base ** (exponent - 1.0)
    return times(slope, tangent)


def magnitude(_: Node, a: Any, tangent: Any) -> Any:
    return -tangent if a < 0.0 else tangent


def cosine(a: Any) -> Any:
    return operation("cos", a)


RULES: dict[str, Callable[..., Any]] = {
    "+": lambda n, a, b, da, db: plus(da, db),
    "-": lambda n, a, b, da, db: plus(da, -db if changes(db) else 0.0),
    "*": lambda n, a, b, da, db: plus(times(b, da), times(a, db)),
    "/": lambda n, a, b, da, db: plus(da, -times(n, db) if changes(db) else 0.0) / b,
    "neg": lambda n, a, da: -da,
    "fabs": magnitude,
    "power": power,
    "modulo": lambda n, a, b, da, db: da,
    "sin": lambda n, a, da: cosine(a) * da,
    "cos": lambda n, a, da: -operation("sin", a) * da,
    "tan": lambda n, a, da: (1.0 + n * n) * da,
    "acos": lambda n, a, da: -da / operation("sqrt", 1.0 - a * a),
    "atan": lambda n, a, da: da / (1.0 + a * a),
    "atan2": lambda n, y, x, dy, dx: (
        plus(times(x, dy), -times(y, dx) if changes(dx) else 0.0) / (x * x + y * y)
    ),
    "sqrt": lambda n, a, da: da / (2.0 * n),
    "exp": lambda n, a, da: n * da,
    "expm1": lambda n, a, da: (n + 1.0) * da,
}
