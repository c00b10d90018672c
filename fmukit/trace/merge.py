"""Merge the two arms of a branch: what both do, with the same values or with others, is written once after them.

Tracing starts again for each answer to a condition and goes on to the end of the function, so that code after n
conditions in sequence is traced, and without merging would be printed, 2**n times. A merge turns a condition
and its two *arms* into a *join*, a form of static single assignment: what remains of either arm, and *phis*, the
values that come from the arm that was taken. One list of nodes follows it. As `execute.explore` merges the
innermost branch first, the arms themselves are lists, whose joins come from merges before.

What has an *effect* keeps its order on either path; these nodes cut an arm into head and tail, see `arm.py`.
Pure nodes are computed where they are read. One question remains. Each *pair* that is read after the join, a value
`a` on the arm for true and a value `b` on that for false, is one value there: a phi, or a *common* value without a
phi for the pair. `Merge.value` decides by these rules:

* The same value, computed before the branch, stays what it is.
* Two of the same operation are computed by one node after the join, unless phis are better: `common_operation`.
  What is computed from the tail has no choice, as the arms end before the tail.
* Two phis of inner joins that do the same are one phi of a common join: `common_phi`.
* Two results of calls that the tails paired are one result of the common call.
* Every other pair is a phi.

A pair computed from the tail that can only be a phi contradicts the cut: the merge is tried again with a
shorter tail. Without a tail it always succeeds.

The three passes of a merge are shown with pictures in `docs/tracing.md`:

1. *Tail matching*: the effects of both tails are paired, and each pair becomes one node.
2. *Value numbering*: the results of the arms are paired, and with them all that they are computed from.
3. *Dead code*: what no one reads any more goes from the arms and from what follows the join.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .arm import Arm, defines, is_local, local_numbers, loops_of, pruned
from .context import current
from .graph import (
    Argument,
    AttemptEnd,
    AttemptStart,
    Branch,
    Call,
    Join,
    Leaf,
    LoopVariable,
    Node,
    Note,
    Operation,
    Phi,
    Result,
    Text,
    Tree,
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
    operation_node,
    size,
)

#: What makes a pair of values one: `Merge.value` after a join, `ArmPair.value` within one.
Value = Callable[[Any, Any], Any]


class MismatchError(Exception):
    """The arms differ in their tails: at most their last `shared` effects can be done once."""

    def __init__(self, shared: int) -> None:
        self.shared = shared


def merge_arms(nodes: list[Node], condition: Operation, true: Tree, false: Tree) -> Tree:
    """The tree that goes on after these nodes with one of two arms: merged where that is possible, else a branch.

    An arm that ends in an error needs no merge: a join fails there, and the other arm follows it. Arms are
    merged if both end with values of the same shape and no attempt begins on one of them without ending there.
    The longest tail is tried first, and shortened as far as the arms differ.
    """
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


class Merge:
    """Two arms, of which the last `shared` effects are done once.

    Attributes
    ----------
    after_join
        The nodes that follow the join.
    merged
        The value after the join of each pair that was asked for, by the keys of both.
    phis
        The pair that each new phi stands for, by the number of the phi.
    """

    def __init__(self, condition: Operation, leaves: tuple[Leaf, Leaf], shared: int) -> None:
        self.condition, self.shared = condition, shared
        self.arms = (Arm(leaves[0], shared), Arm(leaves[1], shared))
        self.after_join: list[Node] = []
        self.merged: dict[tuple[Any, Any], Any] = {}
        self.phis: dict[int, tuple[Any, Any]] = {}

    def merged_arms(self) -> tuple[list[Node], Leaf]:
        """The join, if it does anything, and what follows it; raises MismatchError for a tail that is too long."""
        self.match_tails()
        true, false = (arm.leaf for arm in self.arms)
        values = [self.value(a, b) for a, b in zip(true.values, false.values, strict=True)]
        return self.without_dead_code(Leaf(self.after_join, values, true.shape, None))

    def match_tails(self) -> None:
        """Merge the tails, effect by effect; raises MismatchError for the first pair that differs."""
        for index, (a, b) in enumerate(zip(self.arms[0].tail, self.arms[1].tail)):
            node = self.common_node(a, b, self.value)
            if node is None:
                raise MismatchError(self.shared - index - 1)
            self.merged[a.number, b.number] = node
            self.after_join.append(node)

    def without_dead_code(self, rest: Leaf) -> tuple[list[Node], Leaf]:
        """The join and what follows it, with the nodes and phis alone that are read.

        Raises MismatchError if a phi that is read needs the tail, which comes after it.
        """
        wanted = ancestors(needed(rest), joins_of(rest))
        nodes = {
            n.number: pruned(n, wanted)
            for n in self.after_join
            if has_effect(n) or defines(n, wanted)
        }
        every = current().nodes
        phis: list[Any] = [every[number] for number in self.phis if number in wanted]
        values = [[self.phis[phi.number][side] for phi in phis] for side in (0, 1)]
        for arm, phi_values in zip(self.arms, values):
            possible = arm.longest_tail(phi_values)
            if possible < self.shared:
                raise MismatchError(possible)
        arms = [arm.without_tail(phi_values) for arm, phi_values in zip(self.arms, values)]
        rest = rest._replace(nodes=list(nodes.values()))
        if not phis and not any(arm.nodes for arm in arms):
            return [], rest
        return [new_join(self.condition, arms, phis)], rest

    def value(self, a: Any, b: Any) -> Any:
        """The value after the join of what is `a` on the arm for true and `b` on that for false."""
        pair = key(a), key(b)
        if pair not in self.merged:
            value = self.common_value(a, b)
            self.merged[pair] = self.phi_of(a, b) if value is None else value
        return self.merged[pair]

    def phi_of(self, a: Any, b: Any) -> Phi:
        """A new phi for a pair: of the type that both have, else a Real."""
        kinds = {kind_of(a), kind_of(b)}
        phi = new_phi(kinds.pop() if len(kinds) == 1 else "Real")
        self.phis[phi.number] = (a, b)
        return phi

    def common_value(self, a: Any, b: Any) -> Any:
        """A value for a pair without a new phi for it; None if it needs one.

        Two Booleans that differ are the condition or its negation. Operations that may fail are common only where the
        tails pair them, which `merged` then knows; loops and attempts never are.
        """
        true, false = self.arms
        if key(a) == key(b) and not (true.is_local(a) or false.is_local(b)):
            return a
        if isinstance(a, bool) and isinstance(b, bool):
            return self.condition if a else operation_node("==", (self.condition, 0.0))
        if not (isinstance(a, Node) and may_match(a, b)):
            return None
        match a:
            case Result():
                return self.common_result(a, b, self.merged)
            case Phi():
                return self.common_phi(a, b)
            case Argument() | LoopVariable():
                return None
            case Operation() if not has_effect(a):
                return self.common_operation(a, b)
        return None

    def common_operation(self, a: Operation, b: Operation) -> Node | None:
        """The same operation of both arms, computed after the join; None where a phi of its results is better.

        A phi is better where it saves work or costs none:

        * One of the two was computed before the branch: only one arm has to compute the other.
        * Both heads need their result: the arms compute it whether or not it is read later.
        * More than one operand needs a new phi: one phi of the result replaces them all.

        The last rule does not hold for what is computed from the tail, which the arms do not have. The phis of the
        operands that are not read then go as dead code. The first two do not hold for comparisons, which the arms
        do not compute: they are written where they are read.
        """
        true, false = self.arms
        if not a.is_comparison:
            if not (true.is_local(a) and false.is_local(b)):
                return None
            if a.number in true.needed_by_head and b.number in false.needed_by_head:
                return None
        phis_before = len(self.phis)
        node = self.common_node(a, b, self.value)
        takes_phis = len(self.phis) > phis_before + 1
        if takes_phis and not (true.depends_on_tail(a) or false.depends_on_tail(b)):
            return None
        if node is not None and not a.is_comparison:
            self.after_join.append(node)
        return node

    def common_result(
        self, a: Result, b: Result, merged: dict[tuple[Any, Any], Any]
    ) -> Node | None:
        """The result of a call that is done once; None if the calls were not merged."""
        call = merged.get((a.call.number, b.call.number))
        if a.index != b.index or call is None:
            return None
        return call_result(call, a.index, a.kind, a.items)

    def common_phi(self, a: Phi, b: Phi) -> Any:
        """The phi of a join that is done once for the inner joins of both phis; None if it cannot be.

        The phis come from joins on the arms. If these do the same, one join follows the outer one, and its phis are
        the values of all pairs of theirs. Joins with effects are merged as part of the tails or not at all, so that
        their phis are known by then. Phis at different places of their joins are no pair.
        """
        joins = [arm.joins.get(phi.number, []) for arm, phi in zip(self.arms, (a, b))]
        if [len(alternatives) for alternatives in joins] != [1, 1]:
            return self.merged.get((a.number, b.number))
        (join_a,), (join_b,) = joins
        pair = join_a.number, join_b.number
        if pair not in self.merged and not has_effect(join_a) and not has_effect(join_b):
            join = self.common_node(join_a, join_b, self.value)
            if join is not None:
                self.after_join.append(join)
                self.merged[pair] = join
        return self.merged.get((a.number, b.number))

    def common_node(self, a: Node, b: Any, value: Value) -> Node | None:
        """One node for two that do the same; None if they do not. `value` makes one value of a pair of operands."""
        if not may_match(a, b):
            return None
        match a:
            case Join():
                return self.common_join(a, b, value)
            case Note():
                text = merged_text(a.text, b.text, value)
                identity = ("note", ("joined", a.number, b.number))
                if text is None:
                    return None
                return current().unique(identity, lambda n: Note(n, "Real", (), text))
            case Call():
                return self.common_call(a, b, value)
            case Operation():
                operands = [value(x, y) for x, y in zip(a.operands, b.operands, strict=True)]
                return operation_node(a.op, operands)
        return None

    def common_call(self, a: Call, b: Call, value: Value) -> Call | None:
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

    def common_join(self, a: Join, b: Join, value: Value) -> Join | None:
        """One join for two whose arms do the same, node by node; `merged` then has the pairs of their phis."""
        if a.condition.op != b.condition.op:
            return None
        if [phi.kind for phi in a.phis] != [phi.kind for phi in b.phis]:
            return None
        pairs = zip(a.condition.operands, b.condition.operands)
        condition = operation_node(a.condition.op, [value(x, y) for x, y in pairs])
        arms = [arm for x, y in zip(a.arms, b.arms) if (arm := self.common_arm(x, y, value))]
        if len(arms) < 2:
            return None
        phis = [new_phi(phi.kind) for phi in a.phis]
        for x, y, phi in zip(a.phis, b.phis, phis):
            self.merged[x.number, y.number] = phi
        return new_join(condition, arms, phis)

    def common_arm(self, a: Leaf, b: Leaf, value: Value) -> Leaf | None:
        """One arm of a common join for two that do the same, node by node, down to an error and its text."""
        if len(a.nodes) != len(b.nodes) or (a.error is None) != (b.error is None):
            return None
        pair = ArmPair(self, (a, b), value)
        nodes = []
        for x, y in zip(a.nodes, b.nodes):
            node = self.common_node(x, y, pair.value)
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
    """The arms of two inner joins that become one arm of a common join.

    Attributes
    ----------
    inner
        The value in the common arm of each pair of nodes of the arms, by the keys of both.
    differs
        Whether a pair was met that is local to the arms and is not the same: phis cannot be within an arm.
    """

    def __init__(self, merge: Merge, arms: tuple[Leaf, Leaf], outer: Value) -> None:
        self.merge, self.outer = merge, outer
        self.insides = [(local_numbers(arm), loops_of(arm)) for arm in arms]
        self.inner: dict[tuple[Any, Any], Any] = {}
        self.differs = False

    def value(self, x: Any, y: Any) -> Any:
        """The value in the common arm of what is `x` in one and `y` in the other."""
        pair, merged = (key(x), key(y)), self.merge.merged
        if pair in self.inner or pair in merged:
            return self.inner.get(pair, merged.get(pair))
        are_inside = [is_local(v, *inside) for v, inside in zip((x, y), self.insides)]
        if not any(are_inside):
            return self.outer(x, y)
        node = self.unlisted(x, y) if all(are_inside) else None
        if node is not None:
            return node
        self.differs = True
        return x

    def unlisted(self, x: Any, y: Any) -> Node | None:
        """The common result or comparison, which stand in no list of nodes; None for other pairs."""
        if isinstance(x, Result) and isinstance(y, Result):
            return self.merge.common_result(x, y, self.inner)
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
