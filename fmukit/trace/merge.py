"""Merge the two arms of a branch: what both do after it, with other values, is done once.

The merged form is that of static single assignment: a join has a condition, an arm for either answer, and
phis, the values that come from one of the arms. What fails or has an effect keeps its order on either
path; a pure operation is computed where its value is needed.

A branch is merged in three passes, each of which `docs/tracing.md` shows with a picture:

1. *Tail matching*: the last nodes with effects of both arms are paired while they do the same.
2. *Value numbering*: a pair of values is one value after the join if it is computed alike; else it becomes a phi.
3. *Dead code*: what no one reads any more goes from the arms and from what follows the join.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from .context import current
from .graph import (
    Argument,
    AttemptEnd,
    AttemptStart,
    Branch,
    Call,
    Join,
    Leaf,
    Loop,
    LoopVariable,
    Node,
    Note,
    Operation,
    Phi,
    Result,
    Text,
    Tree,
    all_nodes,
    ancestors,
    as_reals,
    call_result,
    has_effect,
    joins_of,
    key,
    kind_of,
    needed,
    new_join,
    new_phi,
    operands_of,
    operation_node,
    size,
)

Value = Callable[[Any, Any], Any]


class MismatchError(Exception):
    """The arms differ where they were to be merged; at most their last `shared` effects match."""

    def __init__(self, shared: int) -> None:
        self.shared = shared


def merge_arms(nodes: list[Node], condition: Operation, true: Tree, false: Tree) -> Tree:
    """The tree that takes one of two arms after these nodes."""
    nothing = Leaf([], [], None, None)
    if (fails(true) or fails(false)) and closed(true) and closed(false):
        other = false if fails(true) else true
        arms = [true, nothing] if fails(true) else [nothing, false]
        join = new_join(condition, arms, ())  # type: ignore[arg-type]
        return other._replace(nodes=[*nodes, join, *other.nodes])
    if isinstance(true, Branch) or isinstance(false, Branch) or true.shape != false.shape:
        return Branch(nodes, condition, true, false)
    if not (closed(true) and closed(false)):
        return Branch(nodes, condition, true, false)
    shared = min(sum(map(has_effect, arm.nodes)) for arm in (true, false))
    while True:
        try:
            join_nodes, rest = Merge(condition, (true, false), shared).merged_arms()
            return rest._replace(nodes=[*nodes, *join_nodes, *rest.nodes])
        except MismatchError as mismatch:
            shared = mismatch.shared


def fails(tree: Tree) -> bool:
    """Whether this is the end of a function, and an error."""
    return isinstance(tree, Leaf) and tree.error is not None


def closed(tree: Tree) -> bool:
    """Whether what is attempted begins and ends on this arm."""
    starts = sum(isinstance(node, AttemptStart) for node in tree.nodes)
    return starts == sum(isinstance(node, AttemptEnd) for node in tree.nodes)


def local_numbers(tree: Tree) -> set[int]:
    """The numbers of all that is computed on an arm."""
    numbers = {node.number for node in tree.nodes}
    for node in tree.nodes:
        if isinstance(node, Join):
            numbers |= {phi.number for phi in node.phis}
    return numbers


def loops_of(tree: Tree) -> set[int]:
    """The numbers of the loops on an arm."""
    return {node.loop for node in tree.nodes if isinstance(node, Loop)}


def is_local(value: Any, numbers: set[int], loops: set[int]) -> bool:
    """Whether a value is computed on the arm with these nodes and loops."""
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
    """Whether a node, or one of its phis, is among these."""
    has_phi = isinstance(node, Join) and any(phi.number in wanted for phi in node.phis)
    return has_phi or node.number in wanted


def pruned(node: Node, wanted: set[int]) -> Node:
    """A node without what nobody wants of it: phis of a join, and what computes them."""
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
    """One arm of a branch: what it computes before the merge, its head, and its effects after it, its tail."""

    def __init__(self, leaf: Leaf, shared: int) -> None:
        self.leaf = leaf
        self.joins = joins_of(leaf)
        self.inside = all_nodes(leaf)
        self.numbers = local_numbers(leaf)
        self.loops = loops_of(leaf)
        effects = [node for node in leaf.nodes if has_effect(node)]
        self.head = effects[: len(effects) - shared]
        self.tail = effects[len(effects) - shared :]
        self.needed = self.ancestors(self.needs())
        self.ahead = set(self.inside)
        self.after_merge = self.numbers_after_merge()

    def ancestors(self, values: Iterable[Any]) -> set[int]:
        """The numbers of all on the arm that these values are computed from."""
        return ancestors(values, self.joins, self.inside)

    def needs(self) -> list[Any]:
        """The values that the effects of the head need."""
        return [x for node in self.head for x in operands_of(node)]

    def numbers_after_merge(self) -> set[int]:
        """The numbers of the tail, and of what is computed from it.

        Only what lies `ahead` is followed: whether a node that was passed is after the merge is known.
        """
        numbers = {node.number for node in self.tail}
        for node in self.leaf.nodes:
            if not numbers.isdisjoint(ancestors(operands_of(node), self.joins, self.ahead)):
                numbers.add(node.number)
            self.ahead.discard(node.number)
        return numbers

    def is_after_merge(self, value: Any) -> bool:
        """Whether a value is computed from the tail."""
        return not self.after_merge.isdisjoint(ancestors([value], self.joins, self.ahead))

    def is_local(self, value: Any) -> bool:
        """Whether a value is computed on the arm."""
        return is_local(value, self.numbers, self.loops)

    def effects_before(self, values: list[Any]) -> int | None:
        """How many of the last effects may be merged if these values are phis; None if all of the tail may."""
        numbers = self.ancestors(values)
        for index, node in reversed(list(enumerate(self.tail))):
            if node.number in numbers:
                return len(self.tail) - index - 1
        return None

    def without_tail(self, values: list[Any]) -> Leaf:
        """What is left of the arm, and the values that it gives to the phis."""
        wanted = self.ancestors([*values, *self.needs()])
        heads = {node.number for node in self.head}
        nodes = [
            pruned(node, wanted)
            for node in self.leaf.nodes
            if node.number in heads or (not has_effect(node) and defines(node, wanted))
        ]
        return Leaf(nodes, values, None, None)


class Merge:
    """Two arms of which the last `shared` effects are done once."""

    def __init__(self, condition: Operation, leaves: tuple[Leaf, Leaf], shared: int) -> None:
        self.condition, self.shared = condition, shared
        self.arms = (Arm(leaves[0], shared), Arm(leaves[1], shared))
        self.rest: list[Node] = []
        self.merged: dict[tuple[Any, Any], Any] = {}
        self.phis: dict[int, tuple[Any, Any]] = {}

    def merged_arms(self) -> tuple[list[Node], Leaf]:
        """The join, if it does anything, and what follows it; raises MismatchError."""
        self.match_tails()
        true, false = (arm.leaf for arm in self.arms)
        values = [self.value(a, b) for a, b in zip(true.values, false.values, strict=True)]
        return self.without_dead_code(Leaf(self.rest, values, true.shape, None))

    def match_tails(self) -> None:
        """Merge the tails, effect by effect; raises MismatchError for the first pair that differs."""
        for index, (a, b) in enumerate(zip(self.arms[0].tail, self.arms[1].tail)):
            node = self.rebuilt(a, b, self.value)
            if node is None:
                raise MismatchError(self.shared - index - 1)
            self.merged[a.number, b.number] = node
            self.rest.append(node)

    def without_dead_code(self, rest: Leaf) -> tuple[list[Node], Leaf]:
        """The join and what follows it, with the nodes and phis alone that are read."""
        wanted = ancestors(needed(rest), joins_of(rest))
        nodes = {
            n.number: pruned(n, wanted) for n in self.rest if has_effect(n) or defines(n, wanted)
        }
        every = current().nodes
        phis: list[Any] = [every[number] for number in self.phis if number in wanted]
        values = [[self.phis[phi.number][side] for phi in phis] for side in (0, 1)]
        for arm, phi_values in zip(self.arms, values):
            possible = arm.effects_before(phi_values)
            if possible is not None:
                raise MismatchError(possible)
        arms = [arm.without_tail(phi_values) for arm, phi_values in zip(self.arms, values)]
        rest = rest._replace(nodes=list(nodes.values()))
        if not phis and not any(arm.nodes for arm in arms):
            return [], rest
        return [new_join(self.condition, arms, phis)], rest

    def value(self, a: Any, b: Any) -> Any:
        """The value after the join of what is a on one arm and b on the other."""
        pair = key(a), key(b)
        if pair not in self.merged:
            value = self.same_value(a, b)
            self.merged[pair] = self.phi_of(a, b) if value is None else value
        return self.merged[pair]

    def phi_of(self, a: Any, b: Any) -> Phi:
        """A new phi for a pair of values."""
        kinds = {kind_of(a), kind_of(b)}
        phi = new_phi(kinds.pop() if len(kinds) == 1 else "Real")
        self.phis[phi.number] = (a, b)
        return phi

    def same_value(self, a: Any, b: Any) -> Any:
        """A value for a pair that needs no phi of its own; None if there is none."""
        true, false = self.arms
        if key(a) == key(b) and not (true.is_local(a) or false.is_local(b)):
            return a
        if isinstance(a, bool) and isinstance(b, bool):
            return self.condition if a else operation_node("==", (self.condition, 0.0))
        if not (isinstance(a, Node) and may_match(a, b)):
            return None
        match a:
            case Result():
                return self.result(a, b, self.merged)
            case Phi():
                return self.merged_phi(a, b)
            case Argument() | LoopVariable():
                return None
            case Operation() if not has_effect(a):
                return self.same_operation(a, b)
        return None

    def same_operation(self, a: Operation, b: Operation) -> Node | None:
        """An operation after the join for two alike; None where phis cost less, or nothing."""
        true, false = self.arms
        if not a.is_comparison:
            if not (true.is_local(a) and false.is_local(b)):
                return None
            if a.number in true.needed and b.number in false.needed:
                return None
        before = len(self.phis)
        node = self.rebuilt(a, b, self.value)
        if len(self.phis) > before + 1 and not (true.is_after_merge(a) or false.is_after_merge(b)):
            return None
        if node is not None and not a.is_comparison:
            self.rest.append(node)
        return node

    def result(self, a: Result, b: Result, merged: dict[tuple[Any, Any], Any]) -> Node | None:
        """A result of a call that is done once."""
        call = merged.get((a.call.number, b.call.number))
        if a.index != b.index or call is None:
            return None
        return call_result(call, a.index, a.kind, a.items)

    def merged_phi(self, a: Phi, b: Phi) -> Any:
        """A phi of joins that are alike, and are done once."""
        joins = [arm.joins.get(phi.number, []) for arm, phi in zip(self.arms, (a, b))]
        if [len(alternatives) for alternatives in joins] != [1, 1]:
            return self.merged.get((a.number, b.number))
        (join_a,), (join_b,) = joins
        pair = join_a.number, join_b.number
        if pair not in self.merged and not has_effect(join_a) and not has_effect(join_b):
            join = self.rebuilt(join_a, join_b, self.value)
            if join is not None:
                self.rest.append(join)
                self.merged[pair] = join
        return self.merged.get((a.number, b.number))

    def rebuilt(self, a: Node, b: Any, value: Value) -> Node | None:
        """One node for two that do the same with other values; None if they do not."""
        if not may_match(a, b):
            return None
        match a:
            case Join():
                return self.rejoined(a, b, value)
            case Note():
                text = merged_text(a.text, b.text, value)
                identity = ("note", ("joined", a.number, b.number))
                if text is None:
                    return None
                return current().unique(identity, lambda n: Note(n, "Real", (), text))
            case Call():
                return self.recalled(a, b, value)
            case Operation():
                operands = [value(x, y) for x, y in zip(a.operands, b.operands, strict=True)]
                return operation_node(a.op, operands)
        return None

    def recalled(self, a: Call, b: Call, value: Value) -> Call | None:
        """One call for two of the same function; None if the functions differ."""
        if a.function is not b.function:
            return None
        groups = [
            tuple(value(x, y) for x, y in zip(*pair, strict=True))
            for pair in zip(a.groups, b.groups)
        ]
        identity: tuple[Any, ...] = ("call", a.function.name, *(tuple(map(key, g)) for g in groups))
        identity += () if size(a.function.shape) else (("joined", a.number, b.number),)
        numbers = tuple(as_reals(group) for group in groups)
        return current().unique(identity, lambda n: Call(n, "Real", (), a.function, numbers))

    def rejoined(self, a: Join, b: Join, value: Value) -> Join | None:
        """One join for two whose arms do the same, node by node."""
        if a.condition.op != b.condition.op:
            return None
        if [phi.kind for phi in a.phis] != [phi.kind for phi in b.phis]:
            return None
        pairs = zip(a.condition.operands, b.condition.operands)
        condition = operation_node(a.condition.op, [value(x, y) for x, y in pairs])
        arms = [arm for x, y in zip(a.arms, b.arms) if (arm := self.retraced(x, y, value))]
        if len(arms) < 2:
            return None
        phis = [new_phi(phi.kind) for phi in a.phis]
        for x, y, phi in zip(a.phis, b.phis, phis):
            self.merged[x.number, y.number] = phi
        return new_join(condition, arms, phis)

    def retraced(self, a: Leaf, b: Leaf, value: Value) -> Leaf | None:
        """One arm for two that do the same, node by node."""
        if len(a.nodes) != len(b.nodes) or (a.error is None) != (b.error is None):
            return None
        pair = ArmPair(self, (a, b), value)
        nodes = []
        for x, y in zip(a.nodes, b.nodes):
            node = self.rebuilt(x, y, pair.value)
            if node is None or pair.differs:
                return None
            pair.inner[x.number, y.number] = node
            nodes.append(node)
        values = [pair.value(x, y) for x, y in zip(a.values, b.values, strict=True)]
        error = a.error and merged_text(a.error, b.error or a.error, pair.value)
        if pair.differs or (a.error is not None and error is None):
            return None
        return Leaf(nodes, values, None, error)


class ArmPair:
    """The arms of two joins that are rebuilt as one: their inner values, and whether they differ."""

    def __init__(self, merge: Merge, arms: tuple[Leaf, Leaf], outer: Value) -> None:
        self.merge, self.outer = merge, outer
        self.insides = [(local_numbers(arm), loops_of(arm)) for arm in arms]
        self.inner: dict[tuple[Any, Any], Any] = {}
        self.differs = False

    def value(self, x: Any, y: Any) -> Any:
        """The value in the rebuilt arm of what is x in one and y in the other."""
        pair, merged = (key(x), key(y)), self.merge.merged
        if pair in self.inner or pair in merged:
            return self.inner.get(pair, merged.get(pair))
        are_inside = [is_local(v, *inside) for v, inside in zip((x, y), self.insides)]
        if not any(are_inside):
            return self.outer(x, y)
        node = self.between(x, y) if all(are_inside) else None
        if node is not None:
            return node
        self.differs = True
        return x

    def between(self, x: Any, y: Any) -> Node | None:
        """A result or a comparison, which stand in no list of nodes."""
        if isinstance(x, Result) and isinstance(y, Result):
            return self.merge.result(x, y, self.inner)
        if (
            isinstance(x, Operation)
            and isinstance(y, Operation)
            and x.is_comparison
            and x.op == y.op
        ):
            pairs = zip(x.operands, y.operands)
            return operation_node(x.op, [self.value(p, q) for p, q in pairs])
        return None


def may_match(a: Node, b: Any) -> bool:
    """Whether two values are nodes that may do the same: of one sort, one operation and one type."""
    if type(a) is not type(b) or a.kind != b.kind:
        return False
    return not (isinstance(a, Operation) and isinstance(b, Operation)) or a.op == b.op


def merged_text(a: Text, b: Text, value: Value) -> Text | None:
    """One text for two that differ in the values in them."""
    if a.pieces != b.pieces:
        return None
    nodes = []
    for x, y in zip(a.nodes, b.nodes):
        if x.kind != y.kind:
            return None
        node = value(x, y)
        nodes.append(node)
    return Text(a.pieces, tuple(nodes))
