"""Directional derivatives of traced functions, by the rules of the table of operations, in forward mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from .execute import explore
from .graph import (
    Argument,
    Branch,
    Call,
    Function,
    Join,
    Leaf,
    Node,
    Operation,
    Result,
    Tree,
    UntraceableError,
    argument,
    current,
    new_join,
    new_phi,
    operation,
    size,
)
from .ops import OPS, is_moving
from .tracer import Tracer, record_call, trace_function


def forward(
    tracer: Tracer, traced: Function, groups: Sequence[Any], tangents: Sequence[Sequence[Any]]
) -> list[Any]:
    """Tangents of the results for given tangents of the arguments."""
    names = [name for name, shape in traced.parameters.items() if size(shape)]
    moving = {
        n: group for n, group in zip(names, tangents, strict=True) if any(map(is_moving, group))
    }
    if not moving:
        return [0.0] * size(traced.shape)
    return record_call(derived(tracer, traced, tuple(moving)), [*groups, *moving.values()])


def derived(tracer: Tracer, traced: Function, moving: tuple[str, ...]) -> Function:
    """The function of the arguments, and of tangents of the moving ones, that gives tangents."""
    identity = (derived, traced.name, moving)
    if identity not in tracer.functions:
        shapes = {tangent_of(name): untyped_shape(traced.parameters[name]) for name in moving}
        tracer.functions[identity] = None
        derivative = trace_function(
            f"d_{traced.name}_{len(tracer.functions)}",
            lambda **_: Tangents(tracer, {*shapes}).along(traced.tree),
            traced.parameters | shapes,
        )
        if derivative is None:
            raise UntraceableError(f"the derivative of {traced.name}")
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
    return tuple, ("number",) * size(shape)


class Tangents:
    """The tangents of the nodes on a path through a tree."""

    def __init__(
        self, tracer: Tracer, moving: set[str], tangents_by_node: Mapping[int, Any] | None = None
    ) -> None:
        self.tracer, self.moving = tracer, moving
        self.tangents_by_node: dict[int, Any] = dict(tangents_by_node or {})

    def along(self, tree: Tree) -> list[Any]:
        """The tangents of the results at the end of a path."""
        for node in tree.nodes:
            if isinstance(node, Join):
                self.join(node)
                continue
            current().path.record(node)
            self.tangents_by_node[node.number] = self.rule(node)
        if isinstance(tree, Branch):
            return self.along(tree.true if tree.condition else tree.false)
        if tree.error is not None:
            raise ValueError(tree.error.with_marks())
        return [self.of(value) for value in tree.values]

    def join(self, node: Join) -> None:
        """A join that has phis for the tangents too, the same whenever this place is run through."""
        place = current().path.next_place()

        def both(arm: Leaf) -> Any:
            inner = Tangents(self.tracer, self.moving, self.tangents_by_node)
            return [*arm.values, *inner.along(arm)]

        joins = self.tracer.joins
        if place not in joins:
            arms: list[Any] = [
                explore(partial(both, arm), (*place, index)) for index, arm in enumerate(node.arms)
            ]
            phis = (*node.phis, *(new_phi() for _ in node.phis))
            joins[place] = new_join(node.condition, arms, phis)
        current().path.record(joins[place])
        of_tangents = joins[place].phis[len(node.phis) :]
        pairs = zip(node.phis, of_tangents)
        self.tangents_by_node |= {phi.number: tangent for phi, tangent in pairs}

    def of(self, value: Any) -> Any:
        """The tangent of a value."""
        if not isinstance(value, Node) or (isinstance(value, Operation) and value.is_comparison):
            return 0.0
        if isinstance(value, Argument):
            tangent = tangent_of(value.name)
            return argument(tangent, value.index) if tangent in self.moving else 0.0
        if isinstance(value, Result):
            return self.tangents_by_node[value.call.number][value.index]
        return self.tangents_by_node[value.number]

    def rule(self, node: Node) -> Any:
        """The tangent of an operation, those of the results of a call."""
        if isinstance(node, Call):
            groups = [[self.of(value) for value in group] for group in node.groups]
            return forward(self.tracer, node.function, node.groups, groups)
        rule = OPS[node.op].derivative if isinstance(node, Operation) else None
        if rule is None or not isinstance(node, Operation):
            what = node.op if isinstance(node, Operation) else type(node).__name__
            raise UntraceableError(f"the derivative of {what}")
        tangents = [self.of(operand) for operand in node.operands]
        if not any(map(is_moving, tangents)):
            return 0.0
        return rule(operation, node, *node.operands, *tangents)
