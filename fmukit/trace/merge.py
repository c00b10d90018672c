"""Join the two ways of a branch: what both do after it, with other values, is done once.

A join is a node with a condition, an arm for either answer, and the values that the arms hand on
(`phi`). What fails or acts keeps its order on either way; a pure operation is computed where its
value is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from .graph import (
    COMPARISONS,
    MARK,
    NODES,
    Branch,
    Leaf,
    Node,
    Tree,
    all_nodes,
    ancestors,
    as_reals,
    has_effect,
    joins_of,
    key,
    kind_of,
    needed,
    operands,
    operation_node,
    size,
    symbol,
    unique,
)

SYMBOLS = {"symbol", "element", "variable"}
ATTEMPTS = {"leave if failed": 1, "forget failure": -1}
Value = Callable[[Any, Any], Any]


class Mismatch(Exception):
    """The two ways differ where they were to be done once; at most their last `shared` acting nodes match."""

    def __init__(self, shared: int) -> None:
        self.shared = shared


def merge_arms(nodes: list[Node], condition: Node, true: Tree, false: Tree) -> Tree:
    """The tree that goes one of two ways after these nodes."""
    nothing = Leaf([], [], None, None)
    if (fails(true) or fails(false)) and closed(true) and closed(false):
        other = false if fails(true) else true
        arms = [true, nothing] if fails(true) else [nothing, false]
        return other._replace(nodes=[*nodes, join(condition, arms, ()), *other.nodes])
    if isinstance(true, Branch) or isinstance(false, Branch) or true.shape != false.shape:
        return Branch(nodes, condition, true, false)
    if not (closed(true) and closed(false)):
        return Branch(nodes, condition, true, false)
    shared = min(sum(map(has_effect, arm.nodes)) for arm in (true, false))
    while True:
        try:
            join_nodes, rest = Merge(condition, (true, false), shared).merge_arms()
            return rest._replace(nodes=[*nodes, *join_nodes, *rest.nodes])
        except Mismatch as mismatch:
            shared = mismatch.shared


def fails(tree: Tree) -> bool:
    """Whether this is the end of a function, and an error."""
    return isinstance(tree, Leaf) and tree.error is not None


def closed(tree: Tree) -> bool:
    """Whether what is attempted begins and ends on this way."""
    return not sum(ATTEMPTS.get(node.op, 0) for node in tree.nodes)


def join(condition: Node, arms: Sequence[Tree], phis: Sequence[Node]) -> Node:
    """A new join of the arms for true and for false."""
    return unique(("join", len(NODES)), (condition, *arms, tuple(phis)))


def local(tree: Tree) -> set[int]:
    """The numbers of all that is computed on a way."""
    numbers = {node.number for node in tree.nodes}
    for node in tree.nodes:
        if node.op == "join":
            numbers |= {phi.number for phi in node.args[3]}
    return numbers


def is_local(value: Any, numbers: set[int], loops: set[int]) -> bool:
    """Whether a value is computed on the way with these nodes and loops."""
    if not isinstance(value, Node):
        return False
    if value.op == "result":
        return value.args[0] in numbers
    if value.op == "variable":
        return value.args[0] in loops
    if value.op in COMPARISONS:
        return any(is_local(arg, numbers, loops) for arg in value.args)
    return value.number in numbers


def defines(node: Node, wanted: set[int]) -> bool:
    """Whether a node, or a value that it joins, is among these."""
    joins = node.op == "join" and any(phi.number in wanted for phi in node.args[3])
    return joins or node.number in wanted


def pruned(node: Node, wanted: set[int]) -> Node:
    """A node without what nobody wants of it: values that a join hands on, and what makes them."""
    if node.op != "join":
        return node
    condition, *arms, phis = node.args
    indices = [index for index, phi in enumerate(phis) if phi.number in wanted]
    pruned_arms = [
        arm._replace(
            nodes=[pruned(n, wanted) for n in arm.nodes if has_effect(n) or defines(n, wanted)],
            values=[arm.values[index] for index in indices if arm.error is None],
        )
        for arm in arms
    ]
    return join(condition, pruned_arms, [phis[index] for index in indices])


class Merge:
    """Two ways of which the last `shared` acting nodes are done once."""

    def __init__(self, condition: Node, arms: tuple[Leaf, Leaf], shared: int) -> None:
        self.condition, self.arms, self.shared = condition, arms, shared
        self.joins = [joins_of(arm) for arm in arms]
        self.inside = [all_nodes(arm) for arm in arms]
        self.numbers = [local(arm) for arm in arms]
        self.loops = [{node.args[0] for node in arm.nodes if node.op == "loop"} for arm in arms]
        acting = [[node for node in arm.nodes if has_effect(node)] for arm in arms]
        self.heads = [nodes[: len(nodes) - shared] for nodes in acting]
        self.tails = [nodes[len(nodes) - shared :] for nodes in acting]
        self.needed_by_arm = [self.ancestors(side, self.needs(side)) for side in (0, 1)]
        self.ahead = [set(inside) for inside in self.inside]
        self.after_merge = [self.after(side) for side in (0, 1)]
        self.rest: list[Node] = []
        self.merged: dict[tuple[Any, Any], Any] = {}
        self.phis: dict[int, tuple[Any, Any]] = {}

    def merge_arms(self) -> tuple[list[Node], Leaf]:
        """The join, if it does anything, and what follows it."""
        for index, (a, b) in enumerate(zip(*self.tails)):
            node = self.rebuilt(a, b, self.value)
            if node is None:
                raise Mismatch(self.shared - index - 1)
            self.merged[a.number, b.number] = node
            self.rest.append(node)
        true, false = self.arms
        values = [self.value(a, b) for a, b in zip(true.values, false.values, strict=True)]
        rest = Leaf(self.rest, values, true.shape, None)
        wanted = ancestors(needed(rest), joins_of(rest))
        needed_nodes = {
            n.number: pruned(n, wanted) for n in self.rest if has_effect(n) or defines(n, wanted)
        }
        live_phis = [NODES[number] for number in self.phis if number in wanted]
        for side in (0, 1):
            self.require_early([self.phis[phi.number][side] for phi in live_phis], side)
        arms = [
            self.arm(side, [self.phis[phi.number][side] for phi in live_phis]) for side in (0, 1)
        ]
        rest = rest._replace(nodes=list(needed_nodes.values()))
        if not live_phis and not any(arm.nodes for arm in arms):
            return [], rest
        return [join(self.condition, arms, live_phis)], rest

    def after(self, side: int) -> set[int]:
        """The numbers of what is computed from the acting nodes that are done after the join.

        Only what lies `ahead` is followed: a node that was passed is known to be late or not.
        """
        numbers, ahead = {node.number for node in self.tails[side]}, self.ahead[side]
        for node in self.arms[side].nodes:
            if not numbers.isdisjoint(ancestors(operands(node), self.joins[side], ahead)):
                numbers.add(node.number)
            ahead.discard(node.number)
        return numbers

    def is_after_merge(self, side: int, value: Any) -> bool:
        return not self.after_merge[side].isdisjoint(
            ancestors([value], self.joins[side], self.ahead[side])
        )

    def ancestors(self, side: int, values: Iterable[Any]) -> set[int]:
        """The numbers of all on a way that these values are computed from."""
        return ancestors(values, self.joins[side], self.inside[side])

    def needs(self, side: int) -> list[Any]:
        """The values that the acting nodes of an arm need."""
        return [arg for node in self.heads[side] for arg in operands(node)]

    def require_early(self, values: list[Any], side: int) -> None:
        """Raise Unlike if values handed on are computed from what is done after the join."""
        numbers = self.ancestors(side, values)
        for index, node in reversed(list(enumerate(self.tails[side]))):
            if node.number in numbers:
                raise Mismatch(self.shared - index - 1)

    def arm(self, side: int, values: list[Any]) -> Leaf:
        """What is left of a way, and the values that it hands on."""
        wanted = self.ancestors(side, [*values, *self.needs(side)])
        head_numbers = {node.number for node in self.heads[side]}
        nodes = [
            pruned(node, wanted)
            for node in self.arms[side].nodes
            if node.number in head_numbers or (not has_effect(node) and defines(node, wanted))
        ]
        return Leaf(nodes, values, None, None)

    def local(self, side: int, value: Any) -> bool:
        return is_local(value, self.numbers[side], self.loops[side])

    def value(self, a: Any, b: Any) -> Any:
        """The value after the join of what is a on one way and b on the other."""
        pair = key(a), key(b)
        if pair not in self.merged:
            shared_value = self.same_value(a, b)
            self.merged[pair] = self.new_phi(a, b) if shared_value is None else shared_value
        return self.merged[pair]

    def new_phi(self, a: Any, b: Any) -> Node:
        """A value that the join hands on."""
        kinds = {kind_of(a), kind_of(b)}
        phi = symbol("phi", len(NODES), kind=kinds.pop() if len(kinds) == 1 else "Real")
        self.phis[phi.number] = (a, b)
        return phi

    def same_value(self, a: Any, b: Any) -> Any:
        """A value that need not be handed on; None if there is none."""
        if key(a) == key(b) and not (self.local(0, a) or self.local(1, b)):
            return a
        if isinstance(a, bool) and isinstance(b, bool):
            return self.condition if a else operation_node("==", (self.condition, 0.0))
        if not (isinstance(a, Node) and isinstance(b, Node)) or a.op != b.op or a.kind != b.kind:
            return None
        if a.op == "result":
            return self.result(a, b, self.merged)
        if a.op == "phi":
            return self.phi(a, b)
        if has_effect(a) or a.op in SYMBOLS:
            return None
        if a.op not in COMPARISONS:
            if not (self.local(0, a) and self.local(1, b)):
                return None
            if a.number in self.needed_by_arm[0] and b.number in self.needed_by_arm[1]:
                return None
        phis_before = len(self.phis)
        node = self.rebuilt(a, b, self.value)
        if len(self.phis) > phis_before + 1 and not (
            self.is_after_merge(0, a) or self.is_after_merge(1, b)
        ):
            return None
        if node is not None and a.op not in COMPARISONS:
            self.rest.append(node)
        return node

    def result(self, a: Node, b: Node, merged: dict[tuple[Any, Any], Any]) -> Node | None:
        """A result of a call that is done once."""
        (call_a, index), (call_b, other) = a.args, b.args
        call = merged.get((call_a, call_b))
        if index != other or call is None:
            return None
        return symbol("result", call.number, index, kind=a.kind, items=a.items)

    def phi(self, a: Node, b: Node) -> Any:
        """A value handed on by joins that are alike, and are done once."""
        candidates = [joins.get(node.number, []) for joins, node in zip(self.joins, (a, b))]
        if [len(joins) for joins in candidates] != [1, 1]:
            return self.merged.get((a.number, b.number))
        (join_a,), (join_b,) = candidates
        if (
            (join_a.number, join_b.number) not in self.merged
            and not has_effect(join_a)
            and not has_effect(join_b)
        ):
            node = self.rebuilt(join_a, join_b, self.value)
            if node is not None:
                self.rest.append(node)
                self.merged[join_a.number, join_b.number] = node
        return self.merged.get((a.number, b.number))

    def rebuilt(self, a: Node, b: Node, value: Value) -> Node | None:
        """One node for two that do the same with other values; None if they do not."""
        if a.op != b.op or a.kind != b.kind or a.op == "loop" or a.op in ATTEMPTS:
            return None
        if a.op == "join":
            return self.rejoined(a, b, value)
        if a.op == "note":
            text = self.text(a.args[0], b.args[0], value)
            identity: tuple[Any, ...] = ("note", ("joined", a.number, b.number))
            return None if text is None else unique(identity, (text,))
        if a.op != "call":
            args = [value(x, y) for x, y in zip(a.args, b.args, strict=True)]
            return operation_node(a.op, args)
        (called, groups), (other_function, other_groups) = a.args, b.args
        if called is not other_function:
            return None
        numbers = [
            tuple(value(x, y) for x, y in zip(*pair, strict=True))
            for pair in zip(groups, other_groups)
        ]
        identity = ("call", called.name, *(tuple(map(key, g)) for g in numbers))
        identity += () if size(called.shape) else (("joined", a.number, b.number),)
        return unique(identity, (called, [as_reals(group) for group in numbers]))

    def rejoined(self, a: Node, b: Node, value: Value) -> Node | None:
        """One join for two whose arms do the same, node by node."""
        (if_a, *arms, phis), (if_b, *other_arms, other_phis) = a.args, b.args
        if if_a.op != if_b.op or [x.kind for x in phis] != [y.kind for y in other_phis]:
            return None
        condition = operation_node(if_a.op, [value(x, y) for x, y in zip(if_a.args, if_b.args)])
        merged_arms = [arm for x, y in zip(arms, other_arms) if (arm := self.retraced(x, y, value))]
        if len(merged_arms) < 2:
            return None
        new_phis = [symbol("phi", len(NODES), kind=phi.kind) for phi in phis]
        for x, y, phi in zip(phis, other_phis, new_phis):
            self.merged[x.number, y.number] = phi
        return join(condition, merged_arms, new_phis)

    def retraced(self, a: Leaf, b: Leaf, value: Value) -> Leaf | None:
        """One arm for two that do the same, node by node."""
        if len(a.nodes) != len(b.nodes) or (a.error is None) != (b.error is None):
            return None
        inner: dict[tuple[Any, Any], Any] = {}
        insides = [(local(arm), {n.args[0] for n in arm.nodes if n.op == "loop"}) for arm in (a, b)]
        unlike: list[bool] = []

        def inside(x: Any, y: Any) -> Any:
            pair = key(x), key(y)
            if pair in inner or pair in self.merged:
                return inner.get(pair, self.merged.get(pair))
            is_inside = [is_local(v, *inside) for v, inside in zip((x, y), insides)]
            if not any(is_inside):
                return value(x, y)
            if all(is_inside) and x.op == y.op and x.op in (*COMPARISONS, "result"):
                node = (
                    self.result(x, y, inner)
                    if x.op == "result"
                    else operation_node(x.op, [inside(p, q) for p, q in zip(x.args, y.args)])
                )
                if node is not None:
                    return node
            unlike.append(True)
            return x

        nodes = []
        for x, y in zip(a.nodes, b.nodes):
            node = self.rebuilt(x, y, inside)
            if node is None or unlike:
                return None
            inner[x.number, y.number] = node
            nodes.append(node)
        values = [inside(x, y) for x, y in zip(a.values, b.values, strict=True)]
        error = a.error and self.text(a.error, b.error or "", inside)
        if unlike or (a.error is not None and error is None):
            return None
        return Leaf(nodes, values, None, error)

    def text(self, a: str, b: str, value: Value) -> str | None:
        """One text for two that differ in the values in them."""
        pieces, other_pieces = MARK.split(a), MARK.split(b)
        if pieces[::2] != other_pieces[::2]:
            return None
        for index in range(1, len(pieces), 2):
            x, y = NODES[int(pieces[index])], NODES[int(other_pieces[index])]
            if x.kind != y.kind:
                return None
            pieces[index] = repr(value(x, y))
        return "".join(pieces)
