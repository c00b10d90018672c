"""Follow functions with symbols for numbers, once for every answer that their conditions allow.

A condition on a symbol ends the run, which then starts again once for either answer.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from ..declare.record import Declaration, is_record
from .context import Place, current
from .graph import (
    REAL,
    Branch,
    Leaf,
    Node,
    NumberType,
    Operation,
    Tree,
    UntraceableError,
    text_of,
)
from .joins import join_arms

#: Limit of the conditions on one path that are followed answer by answer: more are a loop that does not end.
MOST_CONDITIONS = 100
#: Limit of the paths through one function, which may double with each such condition: 2**10 take some seconds.
MOST_PATHS = 1024


class Fork(BaseException):
    """The end of a run at a condition that is still open."""

    def __init__(self, condition: Operation) -> None:
        self.condition = condition


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


class FollowedPath:
    """What is known on the way through a function: answers given, and nodes already computed."""

    def __init__(self, answers: tuple[bool, ...], outer: FollowedPath | None, start: Place):
        self.answers, self.start, self.decided, self.places = answers, start, 0, 0
        self.attempts: int = outer.attempts if outer else 0
        self.recorded: set[int] = set(outer.recorded) if outer else set()
        self.facts: dict[int, bool] = dict(outer.facts) if outer else {}
        self.possible_values: dict[int, tuple[int, ...]] = (
            dict(outer.possible_values) if outer else {}
        )
        self.nodes: list[Node] = []

    def next_place(self) -> Place:
        """A place of its own for each call, by the start, the answers so far and the number of the call."""
        self.places += 1
        return (*self.start, self.answers[: self.decided], self.places)

    def record(self, node: Node) -> Node:
        """The node itself, which is listed when the path first comes to it."""
        if node.number not in self.recorded:
            self.recorded.add(node.number)
            self.nodes.append(node)
        return node

    def decide(self, condition: Operation) -> bool:
        """The truth of a condition on this path; raises Fork where it has not been answered."""
        if condition.number not in self.facts:
            if self.decided == MOST_CONDITIONS:
                raise UntraceableError(
                    "a loop whose end is known only at run time: write repeat(body, x)"
                )
            if self.decided == len(self.answers):
                self.count_path()
                raise Fork(condition)
            self.learn(condition, self.answers[self.decided])
            self.decided += 1
            self.nodes = []
        return self.facts[condition.number]

    def count_path(self) -> None:
        """Count one more path through the function that is followed; raises UntraceableError for too many."""
        context = current()
        context.forks += 1
        if context.forks >= MOST_PATHS:
            function_name = re.sub(r"_\d+$", "", context.paths[0].start[0])
            raise UntraceableError(
                f"more than {MOST_PATHS} paths through {function_name}, which cannot be joined: move "
                "some of its conditions into a function of their own that returns numbers"
            )

    def learn(self, condition: Operation, answer: bool) -> None:
        """Note the answer, and which values are left for an enumeration that is compared with one."""
        self.facts[condition.number] = answer
        left, right = condition.operands
        if condition.op == "==" and left.type.enumeration and not isinstance(right, Node):
            possible = self.possible_values.get(left.number, left.type.enumeration)
            self.possible_values[left.number] = tuple(
                value for value in possible if (value == right) == answer
            )


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


def leaves(tree: Tree) -> Iterator[Leaf]:
    """The ends of all paths."""
    if isinstance(tree, Branch):
        yield from leaves(tree.true)
        yield from leaves(tree.false)
    else:
        yield tree
