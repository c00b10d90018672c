"""Directional derivatives of traced functions, by the rules of differentiation, in forward mode."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from .execute import explore, kinds
from .graph import (
    COMPARISONS,
    NODES,
    PATHS,
    Branch,
    Function,
    Leaf,
    Node,
    Tree,
    Untraceable,
    operation,
    symbol,
)
from .merge import join
from .tracer import Tracer, call_results, function, logarithm


def forward(
    tracer: Tracer, traced: Function, groups: Sequence[Any], tangents: Sequence[Sequence[Any]]
) -> list[Any]:
    """Tangents of the results for given tangents of the arguments."""
    names = [name for name, shape in traced.parameters.items() if list(kinds(shape))]
    moving = {
        n: group for n, group in zip(names, tangents, strict=True) if any(map(changes, group))
    }
    if not moving:
        return [0.0 for _ in kinds(traced.shape)]
    derivative = derived(tracer, traced, tuple(moving))
    return call_results(derivative, [*map(tuple, groups), *map(tuple, moving.values())])


def changes(tangent: Any) -> bool:
    return isinstance(tangent, Node) or tangent != 0.0


def derived(tracer: Tracer, traced: Function, moving: tuple[str, ...]) -> Function:
    """The function of the arguments, and of tangents of the moving ones, that gives tangents."""
    identity = (derived, traced.name, moving)
    if identity not in tracer.functions:
        shapes = {tangent_of(name): untyped_shape(traced.parameters[name]) for name in moving}
        tracer.functions[identity] = None
        derivative = function(
            f"d_{traced.name}_{len(tracer.functions)}",
            lambda **_: Tangents(tracer, {*shapes}).along(traced.tree),
            traced.parameters | shapes,
        )
        if derivative is None:
            raise Untraceable(f"the derivative of {traced.name}")
        del tracer.functions[identity]
        tracer.functions[identity] = derivative
    derivative_function = tracer.functions[identity]
    assert derivative_function is not None
    return derivative_function


def tangent_of(name: str) -> str:
    """The parameter with the tangents of another, a name that no model can give."""
    return f"{name}'"


def untyped_shape(shape: Any) -> Any:
    """As many numbers, without their types."""
    if shape == "number":
        return shape
    return tuple, tuple("number" for _ in kinds(shape))


class Tangents:
    """The tangents of the nodes on a path through a tree."""

    def __init__(
        self, tracer: Tracer, moving: set[str], tangents_by_node: Mapping[int, Any] | None = None
    ) -> None:
        self.tracer, self.moving = tracer, moving
        self.tangents_by_node: dict[int, Any] = dict(tangents_by_node or {})

    def along(self, tree: Tree) -> list[Any]:
        for node in tree.nodes:
            if node.op == "join":
                self.join(node)
                continue
            PATHS[-1].visit(node)
            self.tangents_by_node[node.number] = self.rule(node)
        if isinstance(tree, Branch):
            return self.along(tree.true if tree.condition else tree.false)
        if tree.error is not None:
            raise ValueError(tree.error)
        return [self.of(value) for value in tree.values]

    def join(self, node: Node) -> None:
        """A join that hands on the tangents too, the same whenever this place is run through."""
        condition, *arms, phis = node.args
        mark = PATHS[-1].mark()

        def both(arm: Leaf) -> Any:
            inner = Tangents(self.tracer, self.moving, self.tangents_by_node)
            return [*arm.values, *inner.along(arm)]

        joins = self.tracer.joins
        if mark not in joins:
            arms_with_tangents = [
                explore(partial(both, arm), (*mark, index)) for index, arm in enumerate(arms)
            ]
            joins[mark] = join(
                condition, arms_with_tangents, (*phis, *(symbol("phi", len(NODES)) for _ in phis))
            )
        PATHS[-1].visit(joins[mark])
        new_phis = joins[mark].args[3][len(phis) :]
        self.tangents_by_node |= {phi.number: tangent for phi, tangent in zip(phis, new_phis)}

    def of(self, value: Any) -> Any:
        if not isinstance(value, Node) or value.op in COMPARISONS:
            return 0.0
        if value.op in ("symbol", "element"):
            name, *index = value.args
            tangent = tangent_of(name)
            return symbol(value.op, tangent, *index) if tangent in self.moving else 0.0
        if value.op == "result":
            call, index = value.args
            return self.tangents_by_node[NODES[call].number][index]
        return self.tangents_by_node[value.number]

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


def power(n: Node, base: Any, exponent: Any, tangent: Any, growth: Any) -> Any:
    square = not isinstance(exponent, Node) and exponent == 2.0
    slope = exponent * base if square else exponent * raised(base, exponent - 1.0)
    return plus(
        times(slope, tangent), times(n * logarithm(base), growth) if changes(growth) else 0.0
    )


def raised(base: Any, exponent: Any) -> Any:
    return operation("power", base, exponent)


def magnitude(_: Node, a: Any, tangent: Any) -> Any:
    return -tangent if a < 0.0 else tangent


def of_base(base: float) -> Callable[..., Any]:
    """The rule of a logarithm."""
    return lambda n, a, da: da / (a * math.log(base))


def remainder(da: Any, db: Any, *rounded_quotient: Any) -> Any:
    return plus(da, -times(operation(*rounded_quotient), db)) if changes(db) else da


def flat(n: Node, *_: Any) -> float:
    """The rule of a step function."""
    return 0.0


RULES: dict[str, Callable[..., Any]] = {
    "+": lambda n, a, b, da, db: plus(da, db),
    "-": lambda n, a, b, da, db: plus(da, -db if changes(db) else 0.0),
    "*": lambda n, a, b, da, db: plus(times(b, da), times(a, db)),
    "/": lambda n, a, b, da, db: plus(da, -times(n, db) if changes(db) else 0.0) / b,
    "neg": lambda n, a, da: -da,
    "fabs": magnitude,
    "copysign": lambda n, a, b, da, db: times(
        operation("copysign", 1.0, a) * operation("copysign", 1.0, b), da
    ),
    "power": power,
    "pow": power,
    "modulo": lambda n, a, b, da, db: remainder(da, db, "floordiv", a, b),
    "fmod": lambda n, a, b, da, db: remainder(da, db, "trunc", a / b) if changes(db) else da,
    "floordiv": flat,
    "floor": flat,
    "ceil": flat,
    "trunc": flat,
    "sin": lambda n, a, da: operation("cos", a) * da,
    "cos": lambda n, a, da: -operation("sin", a) * da,
    "tan": lambda n, a, da: (1.0 + n * n) * da,
    "asin": lambda n, a, da: da / operation("sqrt", 1.0 - a * a),
    "acos": lambda n, a, da: -da / operation("sqrt", 1.0 - a * a),
    "atan": lambda n, a, da: da / (1.0 + a * a),
    "atan2": lambda n, y, x, dy, dx: (
        plus(times(x, dy), -times(y, dx) if changes(dx) else 0.0) / (x * x + y * y)
    ),
    "sinh": lambda n, a, da: operation("cosh", a) * da,
    "cosh": lambda n, a, da: operation("sinh", a) * da,
    "tanh": lambda n, a, da: (1.0 - n * n) * da,
    "asinh": lambda n, a, da: da / operation("sqrt", a * a + 1.0),
    "acosh": lambda n, a, da: da / operation("sqrt", a * a - 1.0),
    "atanh": lambda n, a, da: da / (1.0 - a * a),
    "sqrt": lambda n, a, da: da / (2.0 * n),
    "exp": lambda n, a, da: n * da,
    "expm1": lambda n, a, da: (n + 1.0) * da,
    "log": lambda n, a, da: da / a,
    "log10": of_base(10.0),
    "log2": of_base(2.0),
    "log1p": lambda n, a, da: da / (1.0 + a),
    "erf": lambda n, a, da: 2.0 / math.sqrt(math.pi) * operation("exp", -(a * a)) * da,
    "erfc": lambda n, a, da: -2.0 / math.sqrt(math.pi) * operation("exp", -(a * a)) * da,
}
