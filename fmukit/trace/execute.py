"""Follow functions with symbols for numbers, once for every answer that their conditions allow.

A condition on a symbol ends the run, which then starts again once for either answer. Its two arms are joined where
they end: one list of nodes follows, which reads phis. An *arm* is a `Leaf`: nodes in the order of their computation,
and the values at its end. A value that both arms have from before the condition stays what it is. Any other is a *phi*
of the join, which comes from the arm that was taken: static single assignment. What is read from neither arm stays in
it, as the source has it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..declare.record import Declaration, is_record
from .graph import (
    REAL,
    AttemptEnd,
    AttemptStart,
    Branch,
    FollowedPath,
    Fork,
    Join,
    Leaf,
    Loop,
    LoopVariable,
    Node,
    NumberType,
    Operation,
    Phi,
    Place,
    Result,
    Tree,
    current,
    key,
    new_join,
    new_phi,
    operation_node,
    text_of,
    type_of,
)


class Slots(tuple[Any, ...]):
    """Values that stand side by side, each of an arrangement of its own."""


class Static:
    """Something without numbers, the same wherever it is the same object or text."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Static) and hash(self) == hash(other)

    def __hash__(self) -> int:
        return hash(self.value) if isinstance(self.value, str) else id(self.value)


def flatten(value: Any) -> tuple[Any, list[Any]]:
    """The arrangement of a value, and its numbers in order."""
    if isinstance(value, (Node, int, float)):
        return "number", [value]
    if isinstance(value, (tuple, list)):
        shapes, numbers = [], []
        for item in value:
            shape, some = flatten(item)
            shapes.append(shape)
            numbers += some
        shape = (type(value), tuple(shapes))
        if (
            isinstance(value, Slots)
            or not has_static(shape)
            or any(isinstance(number, Node) for number in numbers)
        ):
            return shape, numbers
    return ("static", Static(value)), []


def has_static(shape: Any) -> bool:
    """Whether the arrangement contains a value that is no number."""
    if shape == "number":
        return False
    return shape[0] == "static" or any(map(has_static, shape[1]))


def arranged(shape: Any, numbers: Iterator[Any]) -> Any:
    """The value of this arrangement with these numbers."""
    if shape == "number":
        return next(numbers)
    cls, parts = shape
    if cls == "static":
        return parts.value
    values = [arranged(part, numbers) for part in parts]
    return cls._make(values) if is_named_tuple(cls) else cls(values)


def is_named_tuple(cls: Any) -> bool:
    """Whether a class takes its items one by one, unlike tuple and list."""
    return hasattr(cls, "_make")


def number_types(shape: Any) -> Iterator[NumberType]:
    """The type of each number of a shape."""
    if shape == "number":
        yield REAL
    elif shape[0] != "static":
        declared = shape[0]._declared.values() if is_record(shape[0]) else shape[1]
        for part, field in zip(shape[1], declared):
            if part == "number" and isinstance(field, Declaration):
                yield NumberType(field.fmi_type, tuple(field.items or ()))
            else:
                yield from number_types(part)


def symbols(shape: Any, make: Callable[[int, NumberType], Node]) -> Any:
    """A value of this shape made of nodes; `make` takes the index and the type of each."""
    return arranged(shape, (make(*numbered) for numbered in enumerate(number_types(shape))))


def explore(
    run: Callable[[], Any],
    start: Place,
    answers: tuple[bool, ...] = (),
    known: tuple[Operation, bool] | None = None,
) -> Tree:
    """All paths through `run` that begin with these answers, joined where they end alike.

    `known` is a condition with its answer on all of them.
    """
    paths = current().paths
    path = FollowedPath(answers, paths[-1] if paths else None, start)
    if known:
        path.learn(*known)
    paths.append(path)
    try:
        shape, values = flatten(run())
        return Leaf(path.nodes, values, shape, None)
    except (ValueError, ArithmeticError) as error:
        return Leaf(path.nodes, [], None, text_of(str(error)))
    except LookupError as error:
        return Leaf(path.nodes, [], None, text_of(type(error).__name__))
    except Fork as fork:
        condition = fork.condition
    finally:
        paths.pop()
    true, false = (explore(run, start, (*answers, answer), known) for answer in (True, False))
    return join_arms(path.nodes, condition, true, false)


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


def leaves(tree: Tree) -> Iterator[Leaf]:
    """The ends of all paths."""
    if isinstance(tree, Branch):
        yield from leaves(tree.true)
        yield from leaves(tree.false)
    else:
        yield tree
