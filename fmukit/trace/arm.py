"""One arm of a branch that is merged: what is computed on it, and where it is cut into head and tail.

An arm is a `Leaf`: nodes in the order of their computation. It is cut by its *effects*, the nodes that are done
even where nobody reads their value. The last of them, the *tail*, are done after the join, once for both arms;
those before are the *head* and stay. A pure node has no place of its own: it is computed in the arm, after the
join, or in both, wherever its value is read.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .graph import (
    Join,
    Leaf,
    Loop,
    LoopVariable,
    Node,
    Operation,
    Result,
    Tree,
    all_nodes,
    ancestors,
    has_effect,
    joins_of,
    new_join,
    operands_of,
)


def local_numbers(tree: Tree) -> set[int]:
    """The numbers of the nodes in the list of an arm, and of the phis of its joins; not of what is nested in them."""
    numbers = {node.number for node in tree.nodes}
    for node in tree.nodes:
        if isinstance(node, Join):
            numbers |= {phi.number for phi in node.phis}
    return numbers


def loops_of(tree: Tree) -> set[int]:
    """The numbers of the loops on an arm."""
    return {node.loop for node in tree.nodes if isinstance(node, Loop)}


def is_local(value: Any, numbers: set[int], loops: set[int]) -> bool:
    """Whether a value is computed on the arm with these `local_numbers` and loops, not before the branch.

    A result is where its call is, and a variable where its loop is. A comparison is in no list, as it is written
    where it is read: it is local if one of its operands is.
    """
    if not isinstance(value, Node):
        return False
    if isinstance(value, Result):
        return value.call.number in numbers
    if isinstance(value, LoopVariable):
        return value.loop in loops
    if isinstance(value, Operation) and value.is_comparison:
        return any(is_local(operand, numbers, loops) for operand in value.operands)
    return value.number in numbers


def defines(node: Node, wanted: set[int]) -> bool:
    """Whether a node, or one of its phis, is among these numbers."""
    has_phi = isinstance(node, Join) and any(phi.number in wanted for phi in node.phis)
    return has_phi or node.number in wanted


def pruned(node: Node, wanted: set[int]) -> Node:
    """The node itself; a join without the phis that are not wanted, and without the pure nodes for them alone."""
    if not isinstance(node, Join):
        return node
    indices = [index for index, phi in enumerate(node.phis) if phi.number in wanted]
    arms = [
        arm._replace(
            nodes=[pruned(n, wanted) for n in arm.nodes if has_effect(n) or defines(n, wanted)],
            values=[arm.values[index] for index in indices if arm.error is None],
        )
        for arm in node.arms
    ]
    return new_join(node.condition, arms, [node.phis[index] for index in indices])


class Arm:
    """One arm of a branch, whose last `shared` effects are its tail.

    Attributes
    ----------
    joins
        The joins on the arm, by the numbers of their phis.
    numbers, loops
        What `is_local` decides by.
    head, tail
        The effects that stay on the arm, and those that are done after the join.
    needed_by_head
        The numbers of all that the head is computed from, which stays on the arm with it.
    tail_dependent
        The numbers of the tail and of the nodes in the list of the arm that are computed from it.
    """

    def __init__(self, leaf: Leaf, shared: int) -> None:
        self.leaf = leaf
        self.joins = joins_of(leaf)
        self.inside = all_nodes(leaf)
        self.numbers = local_numbers(leaf)
        self.loops = loops_of(leaf)
        effects = [node for node in leaf.nodes if has_effect(node)]
        self.head = effects[: len(effects) - shared]
        self.tail = effects[len(effects) - shared :]
        self.head_operands = [x for node in self.head for x in operands_of(node)]
        self.needed_by_head = self.ancestors(self.head_operands)
        self.tail_dependent = {node.number for node in self.tail}
        self.unclassified = set(self.inside)
        self.classify()

    def ancestors(self, values: Iterable[Any]) -> set[int]:
        """The numbers of all on the arm that these values are computed from."""
        return ancestors(values, self.joins, self.inside)

    def classify(self) -> None:
        """Complete `tail_dependent`, node by node in the order of computation.

        A node depends on the tail if one of its operands does. Operands that stand in the list come earlier in it,
        so their answer is known and what they are computed from need not be followed. What is nested in a join or
        a loop has no answer of its own: it stays `unclassified` and is followed. This makes the work proportional to the
        length of the arm instead of its square.
        """
        for node in self.leaf.nodes:
            if any(map(self.depends_on_tail, operands_of(node))):
                self.tail_dependent.add(node.number)
            self.unclassified.discard(node.number)

    def depends_on_tail(self, value: Any) -> bool:
        """Whether a value is computed from the tail, so that it cannot be known before the join."""
        return not self.tail_dependent.isdisjoint(ancestors([value], self.joins, self.unclassified))

    def is_local(self, value: Any) -> bool:
        """Whether a value is computed on the arm."""
        return is_local(value, self.numbers, self.loops)

    def longest_tail(self, values: list[Any]) -> int:
        """How many effects the tail may have if the arm is to give these values to phis.

        These are the effects after the last one that a value is computed from.
        """
        numbers = self.ancestors(values)
        for index, node in reversed(list(enumerate(self.tail))):
            if node.number in numbers:
                return len(self.tail) - index - 1
        return len(self.tail)

    def without_tail(self, values: list[Any]) -> Leaf:
        """The head with the pure nodes for it and for the values that the arm gives to phis."""
        wanted = self.ancestors([*values, *self.head_operands])
        heads = {node.number for node in self.head}
        nodes = [
            pruned(node, wanted)
            for node in self.leaf.nodes
            if node.number in heads or (not has_effect(node) and defines(node, wanted))
        ]
        return Leaf(nodes, values, None, None)
