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
    acts,
    computed,
    everything,
    joins_of,
    key,
    kind_of,
    needed,
    plain,
    reach,
    size,
    symbol,
    unique,
    used,
)

SYMBOLS = {"symbol", "element", "variable"}
ATTEMPTS = {"leave if failed": 1, "forget failure": -1}
Value = Callable[[Any, Any], Any]


class Unlike(Exception):
    """The two ways differ where they were to be done once; at most their last `shared` acting nodes match."""

    def __init__(self, shared: int) -> None:
        self.shared = shared


def joined(nodes: list[Node], condition: Node, true: Tree, false: Tree) -> Tree:
    """The tree that goes one of two ways after these nodes."""
    nothing = Leaf([], [], None, None)
    if (fails(true) or fails(false)) and closed(true) and closed(false):
        other = false if fails(true) else true
        ways = [true, nothing] if fails(true) else [nothing, false]
        return other._replace(nodes=[*nodes, join(condition, ways, ()), *other.nodes])
    if isinstance(true, Branch) or isinstance(false, Branch) or true.shape != false.shape:
        return Branch(nodes, condition, true, false)
    if not (closed(true) and closed(false)):
        return Branch(nodes, condition, true, false)
    shared = min(sum(map(acts, way.nodes)) for way in (true, false))
    while True:
        try:
            made, rest = Merge(condition, (true, false), shared).joined()
            return rest._replace(nodes=[*nodes, *made, *rest.nodes])
        except Unlike as unlike:
            shared = unlike.shared


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
    found = {node.number for node in tree.nodes}
    for node in tree.nodes:
        if node.op == "join":
            found |= {phi.number for phi in node.args[3]}
    return found


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
    places = [place for place, phi in enumerate(phis) if phi.number in wanted]
    kept = [
        arm._replace(
            nodes=[pruned(n, wanted) for n in arm.nodes if acts(n) or defines(n, wanted)],
            values=[arm.values[place] for place in places if arm.error is None],
        )
        for arm in arms
    ]
    return join(condition, kept, [phis[place] for place in places])


class Merge:
    """Two ways of which the last `shared` acting nodes are done once."""

    def __init__(self, condition: Node, ways: tuple[Leaf, Leaf], shared: int) -> None:
        self.condition, self.ways, self.shared = condition, ways, shared
        self.joins = [joins_of(way) for way in ways]
        self.inside = [everything(way) for way in ways]
        self.numbers = [local(way) for way in ways]
        self.loops = [{node.args[0] for node in way.nodes if node.op == "loop"} for way in ways]
        acting = [[node for node in way.nodes if acts(node)] for way in ways]
        self.heads = [nodes[: len(nodes) - shared] for nodes in acting]
        self.tails = [nodes[len(nodes) - shared :] for nodes in acting]
        self.busy = [self.reach(side, self.needs(side)) for side in (0, 1)]
        self.ahead = [set(inside) for inside in self.inside]
        self.late = [self.after(side) for side in (0, 1)]
        self.rest: list[Node] = []
        self.known: dict[tuple[Any, Any], Any] = {}
        self.phis: dict[int, tuple[Any, Any]] = {}

    def joined(self) -> tuple[list[Node], Leaf]:
        """The join, if it does anything, and what follows it."""
        for place, (a, b) in enumerate(zip(*self.tails)):
            found = self.rebuilt(a, b, self.value)
            if found is None:
                raise Unlike(self.shared - place - 1)
            self.known[a.number, b.number] = found
            self.rest.append(found)
        true, false = self.ways
        values = [self.value(a, b) for a, b in zip(true.values, false.values, strict=True)]
        rest = Leaf(self.rest, values, true.shape, None)
        wanted = reach(needed(rest), joins_of(rest))
        kept = {n.number: pruned(n, wanted) for n in self.rest if acts(n) or defines(n, wanted)}
        handed = [NODES[number] for number in self.phis if number in wanted]
        for side in (0, 1):
            self.require_early([self.phis[phi.number][side] for phi in handed], side)
        arms = [self.arm(side, [self.phis[phi.number][side] for phi in handed]) for side in (0, 1)]
        rest = rest._replace(nodes=list(kept.values()))
        if not handed and not any(arm.nodes for arm in arms):
            return [], rest
        return [join(self.condition, arms, handed)], rest

    def after(self, side: int) -> set[int]:
        """The numbers of what is computed from the acting nodes that are done after the join.

        Only what lies `ahead` is followed: a node that was passed is known to be late or not.
        """
        found, ahead = {node.number for node in self.tails[side]}, self.ahead[side]
        for node in self.ways[side].nodes:
            if not found.isdisjoint(reach(used(node), self.joins[side], ahead)):
                found.add(node.number)
            ahead.discard(node.number)
        return found

    def is_late(self, side: int, value: Any) -> bool:
        return not self.late[side].isdisjoint(reach([value], self.joins[side], self.ahead[side]))

    def reach(self, side: int, values: Iterable[Any]) -> set[int]:
        """The numbers of all on a way that these values are computed from."""
        return reach(values, self.joins[side], self.inside[side])

    def needs(self, side: int) -> list[Any]:
        """The values that the acting nodes of an arm need."""
        return [arg for node in self.heads[side] for arg in used(node)]

    def require_early(self, values: list[Any], side: int) -> None:
        """Raise Unlike if values handed on are computed from what is done after the join."""
        found = self.reach(side, values)
        for place, node in reversed(list(enumerate(self.tails[side]))):
            if node.number in found:
                raise Unlike(self.shared - place - 1)

    def arm(self, side: int, values: list[Any]) -> Leaf:
        """What is left of a way, and the values that it hands on."""
        wanted = self.reach(side, [*values, *self.needs(side)])
        kept = {node.number for node in self.heads[side]}
        nodes = [
            pruned(node, wanted)
            for node in self.ways[side].nodes
            if node.number in kept or (not acts(node) and defines(node, wanted))
        ]
        return Leaf(nodes, values, None, None)

    def local(self, side: int, value: Any) -> bool:
        return is_local(value, self.numbers[side], self.loops[side])

    def value(self, a: Any, b: Any) -> Any:
        """The value after the join of what is a on one way and b on the other."""
        pair = key(a), key(b)
        if pair not in self.known:
            found = self.alike(a, b)
            self.known[pair] = self.handed(a, b) if found is None else found
        return self.known[pair]

    def handed(self, a: Any, b: Any) -> Node:
        """A value that the join hands on."""
        kinds = {kind_of(a), kind_of(b)}
        phi = symbol("phi", len(NODES), kind=kinds.pop() if len(kinds) == 1 else "Real")
        self.phis[phi.number] = (a, b)
        return phi

    def alike(self, a: Any, b: Any) -> Any:
        """A value that need not be handed on; None if there is none."""
        if key(a) == key(b) and not (self.local(0, a) or self.local(1, b)):
            return a
        if isinstance(a, bool) and isinstance(b, bool):
            return self.condition if a else computed("==", (self.condition, 0.0))
        if not (isinstance(a, Node) and isinstance(b, Node)) or a.op != b.op or a.kind != b.kind:
            return None
        if a.op == "result":
            return self.result(a, b, self.known)
        if a.op == "phi":
            return self.phi(a, b)
        if acts(a) or a.op in SYMBOLS:
            return None
        if a.op not in COMPARISONS:
            if not (self.local(0, a) and self.local(1, b)):
                return None
            if a.number in self.busy[0] and b.number in self.busy[1]:
                return None
        before = len(self.phis)
        found = self.rebuilt(a, b, self.value)
        if len(self.phis) > before + 1 and not (self.is_late(0, a) or self.is_late(1, b)):
            return None
        if found is not None and a.op not in COMPARISONS:
            self.rest.append(found)
        return found

    def result(self, a: Node, b: Node, known: dict[tuple[Any, Any], Any]) -> Node | None:
        """A result of a call that is done once."""
        (call_a, place), (call_b, other) = a.args, b.args
        call = known.get((call_a, call_b))
        if place != other or call is None:
            return None
        return symbol("result", call.number, place, kind=a.kind, items=a.items)

    def phi(self, a: Node, b: Node) -> Any:
        """A value handed on by joins that are alike, and are done once."""
        ways = [joins.get(node.number, []) for joins, node in zip(self.joins, (a, b))]
        if [len(joins) for joins in ways] != [1, 1]:
            return self.known.get((a.number, b.number))
        (way,), (other,) = ways
        if (way.number, other.number) not in self.known and not acts(way) and not acts(other):
            found = self.rebuilt(way, other, self.value)
            if found is not None:
                self.rest.append(found)
                self.known[way.number, other.number] = found
        return self.known.get((a.number, b.number))

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
            return computed(a.op, args)
        (called, groups), (other, others) = a.args, b.args
        if called is not other:
            return None
        numbers = [
            tuple(value(x, y) for x, y in zip(*pair, strict=True)) for pair in zip(groups, others)
        ]
        identity = ("call", called.name, *(tuple(map(key, g)) for g in numbers))
        identity += () if size(called.shape) else (("joined", a.number, b.number),)
        return unique(identity, (called, [plain(group) for group in numbers]))

    def rejoined(self, a: Node, b: Node, value: Value) -> Node | None:
        """One join for two whose arms do the same, node by node."""
        (if_a, *arms, phis), (if_b, *others, other_phis) = a.args, b.args
        if if_a.op != if_b.op or [x.kind for x in phis] != [y.kind for y in other_phis]:
            return None
        condition = computed(if_a.op, [value(x, y) for x, y in zip(if_a.args, if_b.args)])
        made = [arm for x, y in zip(arms, others) if (arm := self.retraced(x, y, value))]
        if len(made) < 2:
            return None
        handed = [symbol("phi", len(NODES), kind=phi.kind) for phi in phis]
        for x, y, phi in zip(phis, other_phis, handed):
            self.known[x.number, y.number] = phi
        return join(condition, made, handed)

    def retraced(self, a: Leaf, b: Leaf, value: Value) -> Leaf | None:
        """One arm for two that do the same, node by node."""
        if len(a.nodes) != len(b.nodes) or (a.error is None) != (b.error is None):
            return None
        inner: dict[tuple[Any, Any], Any] = {}
        insides = [(local(arm), {n.args[0] for n in arm.nodes if n.op == "loop"}) for arm in (a, b)]
        unlike: list[bool] = []

        def inside(x: Any, y: Any) -> Any:
            pair = key(x), key(y)
            if pair in inner or pair in self.known:
                return inner.get(pair, self.known.get(pair))
            places = [is_local(v, *inside) for v, inside in zip((x, y), insides)]
            if not any(places):
                return value(x, y)
            if all(places) and x.op == y.op and x.op in (*COMPARISONS, "result"):
                found = (
                    self.result(x, y, inner)
                    if x.op == "result"
                    else computed(x.op, [inside(p, q) for p, q in zip(x.args, y.args)])
                )
                if found is not None:
                    return found
            unlike.append(True)
            return x

        nodes = []
        for x, y in zip(a.nodes, b.nodes):
            found = self.rebuilt(x, y, inside)
            if found is None or unlike:
                return None
            inner[x.number, y.number] = found
            nodes.append(found)
        values = [inside(x, y) for x, y in zip(a.values, b.values, strict=True)]
        error = a.error and self.text(a.error, b.error or "", inside)
        if unlike or (a.error is not None and error is None):
            return None
        return Leaf(nodes, values, None, error)

    def text(self, a: str, b: str, value: Value) -> str | None:
        """One text for two that differ in the values in them."""
        pieces, others = MARK.split(a), MARK.split(b)
        if pieces[::2] != others[::2]:
            return None
        for place in range(1, len(pieces), 2):
            x, y = NODES[int(pieces[place])], NODES[int(others[place])]
            if x.kind != y.kind:
                return None
            pieces[place] = repr(value(x, y))
        return "".join(pieces)
