"""Join the two arms of a condition where they end: one list of nodes follows, which reads phis.

An *arm* is a `Leaf`: nodes in the order of their computation, and the values at its end. A value that both arms have
from before the condition stays what it is. Any other is a *phi* of the join, which comes from the arm that was
taken: static single assignment. What is read from neither arm stays in it, as the source has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .graph import (
    AttemptEnd,
    AttemptStart,
    Branch,
    Join,
    Leaf,
    Loop,
    LoopVariable,
    Node,
    NumberType,
    Operation,
    Phi,
    Result,
    Tree,
    key,
    new_join,
    new_phi,
    operation_node,
    type_of,
)


def join_arms(before: Sequence[Node], condition: Operation, true: Tree, false: Tree) -> Tree:
    """The tree that goes on after these nodes with one of two arms: joined where that is possible, else a branch.

    An arm that ends in an error leaves no value: a join fails there, and the other arm follows it. Arms are joined if
    both end with values of the same shape and no attempt begins on one of them without ending there.
    """
    branch = Branch([*before], condition, true, false)
    if not (ends_its_attempts(true) and ends_its_attempts(false)):
        return branch
    nothing = Leaf([], [], None, None)
    if isinstance(true, Leaf) and true.error is not None:
        join = new_join(condition, (true, nothing), ())
        return false._replace(nodes=[*before, join, *false.nodes])
    if isinstance(false, Leaf) and false.error is not None:
        join = new_join(condition, (nothing, false), ())
        return true._replace(nodes=[*before, join, *true.nodes])
    if isinstance(true, Branch) or isinstance(false, Branch) or true.shape != false.shape:
        return branch
    joins, values = joined(condition, true, false)
    return Leaf([*before, *joins], values, true.shape, None)


def joined(condition: Operation, true: Leaf, false: Leaf) -> tuple[list[Join], list[Any]]:
    """The join of two arms, if it does anything, and the values after it.

    Two Booleans that differ are the condition or its negation.
    """
    computed_on_true, computed_on_false = ComputedOnArm(true), ComputedOnArm(false)
    phis: dict[Any, tuple[Phi, Any, Any]] = {}
    values: list[Any] = []
    for a, b in zip(true.values, false.values, strict=True):
        pair = key(a), key(b)
        if pair[0] == pair[1] and not (a in computed_on_true or b in computed_on_false):
            values.append(a)
        elif isinstance(a, bool) and isinstance(b, bool):
            values.append(condition if a else operation_node("==", (condition, 0.0)))
        else:
            if pair not in phis:
                phis[pair] = phi_of(a, b), a, b
            values.append(phis[pair][0])
    if not (phis or true.nodes or false.nodes):
        return [], values
    arms = (
        true._replace(values=[a for _, a, _ in phis.values()], shape=None),
        false._replace(values=[b for _, _, b in phis.values()], shape=None),
    )
    return [new_join(condition, arms, [phi for phi, _, _ in phis.values()])], values


def phi_of(a: Any, b: Any) -> Phi:
    """A new value for two: of the type that both have, else a Real; one of their values where those are known."""
    kinds, values = {type_of(a).kind, type_of(b).kind}, [values_by_type(x) for x in (a, b)]
    all_values = tuple(sorted({*values[0], *values[1]})) if all(values) else ()
    return new_phi(NumberType(kinds.pop() if len(kinds) == 1 else "Real", all_values))


def values_by_type(number: Any) -> tuple[int, ...]:
    """What a number can be by its type: itself, or the values of its enumeration."""
    is_integer = isinstance(number, int) and not isinstance(number, bool)
    return (number,) if is_integer else type_of(number).enumeration


def ends_its_attempts(tree: Tree) -> bool:
    """Whether what is attempted begins and ends on this arm."""
    starts = sum(isinstance(node, AttemptStart) for node in tree.nodes)
    return starts == sum(isinstance(node, AttemptEnd) for node in tree.nodes)


class ComputedOnArm:
    """What is computed on an arm: its nodes, the phis of its joins, the variables of its loops."""

    def __init__(self, arm: Leaf) -> None:
        joins = [node for node in arm.nodes if isinstance(node, Join)]
        self.numbers = {node.number for node in arm.nodes}
        self.numbers |= {phi.number for join in joins for phi in join.phis}
        self.loops = {node.loop for node in arm.nodes if isinstance(node, Loop)}

    def __contains__(self, value: Any) -> bool:
        """Whether a value is computed on the arm, not before the condition.

        A result is where its call is. A comparison is in no list, as it is written where it is read: it is local if
        one of its operands is.
        """
        match value:
            case Result():
                return value.call.number in self.numbers
            case LoopVariable():
                return value.loop in self.loops
            case Operation() if value.is_comparison:
                return any(operand in self for operand in value.operands)
            case Node():
                return value.number in self.numbers
        return False
