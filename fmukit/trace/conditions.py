"""Follow both arms of a condition and join them where they end: what rewritten functions call for their conditions."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from types import CellType, FunctionType, ModuleType
from typing import Any, NamedTuple

from . import rewrite
from .execute import Slots, arranged, explore, join_arms
from .graph import Branch, Leaf, Node, Operation, Place, comparison_or_answer, current

Arm = Callable[[], Any]
Relation = Callable[[Any, Any], Any]
#: What a name has that no value was assigned to.
UNBOUND = object()


class Joined(NamedTuple):
    """What follows two arms: the nodes of their join, the result and the names that it assigns, and those it unbinds.

    `survivor` is the answer of the arm that does not fail where the other one does.
    """

    nodes: list[Node]
    shape: Any
    numbers: list[Any]
    unbound: set[str]
    survivor: bool | None


def follow_arms(test: Any, true: Arm, false: Arm, read_later: Sequence[str] = ()) -> Any:
    """What the arm that `test` selects returns; of the names that the arms assign, these are read later."""
    test, true, false = comparison_with_arms(test, true, false)
    if not isinstance(test, Operation):
        return true() if test else false()
    path, joins = current().path, current().joins
    if current().without_joins or test.number in path.facts:
        return true() if path.decide(test) else false()
    place = path.next_place(), test.number
    cells = closure_cells((true, false))
    if place not in joins:
        joins[place] = join_if_possible(place, test, (true, false), cells, read_later)
    made = joins[place]
    if made is None:
        return true() if path.decide(test) else false()
    for node in made.nodes:
        path.record(node)
    if made.survivor is not None:
        path.learn(test, made.survivor)
    for name in made.unbound:
        bind(cells[name], UNBOUND)
    result, *contents = arranged(made.shape, iter(made.numbers))
    for name, content in zip(read_later, contents):
        bind(cells[name], content)
    return result


def comparison_with_arms(test: Any, true: Arm, false: Arm) -> tuple[Any, Arm, Arm]:
    """The comparison that decides whether something is true, or the answer, and the arms for true and false of it."""
    if isinstance(test, Node) and not (isinstance(test, Operation) and test.is_comparison):
        test = comparison_or_answer("!=", test, 0.0)
    if isinstance(test, Operation) and test.op == "!=":
        return comparison_or_answer("==", *test.operands), false, true
    return test, true, false


def join_if_possible(
    place: Place,
    condition: Operation,
    arms: tuple[Arm, Arm],
    cells: dict[str, CellType],
    read_later: Sequence[str],
) -> Joined | None:
    """The join of two arms; None where they cannot be joined, and where they change what they do not assign."""
    before = {name: content(cell) for name, cell in cells.items()}
    objects = Objects([*before.values(), *arms])
    changed: set[str] = set()
    effects = objects.has_iterators

    def run(arm: Arm) -> Slots:
        nonlocal effects
        try:
            result = arm()
            changed.update(n for n, value in before.items() if content(cells[n]) is not value)
            return Slots((result, *(content(cells[name]) for name in read_later)))
        finally:
            effects |= objects.restore()
            for name, value in before.items():
                bind(cells[name], value)

    trees = [
        explore(partial(run, arm), (*place, answer), known=(condition, answer))
        for arm, answer in zip(arms, (True, False))
    ]
    failing = [isinstance(tree, Leaf) and tree.error is not None for tree in trees]
    if effects or all(failing) or (any(failing) and current().path.attempts):
        return None
    merged = join_arms([], condition, trees[0], trees[1])
    if isinstance(merged, Branch):
        return None
    survivor = failing[1] if any(failing) else None
    unbound = changed.difference(read_later)
    return Joined(merged.nodes, merged.shape, merged.values, unbound, survivor)


def closure_cells(arms: Iterable[Arm]) -> dict[str, CellType]:
    """The variables that the arms share with the function around them."""
    cells: dict[str, CellType] = {}
    for arm in arms:
        if isinstance(arm, FunctionType):
            cells |= zip(arm.__code__.co_freevars, arm.__closure__ or ())
    return cells


def content(cell: CellType) -> Any:
    """The value of a variable."""
    try:
        return cell.cell_contents
    except ValueError:
        return UNBOUND


def bind(cell: CellType, value: Any) -> None:
    """Give a variable its value, or none."""
    if value is not UNBOUND:
        cell.cell_contents = value
    elif content(cell) is not UNBOUND:
        del cell.cell_contents


class Objects:
    """The lists, dictionaries, sets and objects that are reached from some values, as they are now."""

    def __init__(self, values: Iterable[Any]) -> None:
        self.copies: list[tuple[Any, Any]] = []
        self.has_iterators = False
        seen: set[int] = set()
        waiting = list(values)
        while waiting:
            value = waiting.pop()
            if isinstance(value, (Node, float, int, str, type, ModuleType)) or id(value) in seen:
                continue
            seen.add(id(value))
            if isinstance(value, (list, dict, set)):
                self.copies.append((value, value.copy()))
            if isinstance(value, (list, tuple, set)):
                waiting.extend(value)
            elif isinstance(value, dict):
                waiting.extend(value.values())
            elif isinstance(value, FunctionType):
                is_of_tracing = value.__module__.startswith(__package__)
                waiting.extend(map(content, () if is_of_tracing else value.__closure__ or ()))
            else:
                self.has_iterators |= isinstance(value, Iterator)
                waiting.extend(getattr(value, name, ()) for name in ("__self__", "__dict__"))

    def restore(self) -> bool:
        """Undo what has happened to them; whether there was something."""
        is_changed = False
        for value, copied in self.copies:
            now, before = (
                [*x, *(x.values() if isinstance(x, dict) else ())] for x in (value, copied)
            )
            if len(now) == len(before) and all(map(operator.is_, now, before)):
                continue
            is_changed = True
            value.clear()
            value.extend(copied) if isinstance(value, list) else value.update(copied)
        return is_changed


def both(value: Any, rest: Arm) -> Any:
    """`value and rest()`."""
    return follow_arms(value, rest, lambda: False if is_boolean_node(value) else value)


def either(value: Any, rest: Arm) -> Any:
    """`value or rest()`."""
    return follow_arms(value, lambda: True if is_boolean_node(value) else value, rest)


def is_boolean_node(value: Any) -> bool:
    """Whether a value is a node that is true or false."""
    return isinstance(value, Node) and value.type.kind == "Boolean"


def compare_chain(left: Any, relation: Relation, right: Arm, *more: Any) -> Any:
    """A chain of comparisons, which evaluates each operand once."""
    between = right()
    answer = relation(left, between)
    return both(answer, lambda: compare_chain(between, *more)) if more else answer


def equal_or_unequal(left: Any, right: Any, relation: Relation) -> Any:
    """`left == right` or, as the relation says, `left != right`: of records and lists, item by item."""
    if not (isinstance(left, (tuple, list)) and isinstance(right, (tuple, list))):
        return relation(left, right)
    if len(left) != len(right) or isinstance(left, list) != isinstance(right, list):
        return relation(left, right)

    def items_from(index: int) -> Any:
        if index == len(left):
            return True
        a, b = left[index], right[index]
        return both(a is b or equal_or_unequal(a, b, operator.eq), lambda: items_from(index + 1))

    is_equality = relation(0, 0)
    return items_from(0) if is_equality else follow_arms(items_from(0), lambda: False, lambda: True)


def extreme(original: Callable[..., Any], is_better: Relation) -> Callable[..., Any]:
    """`min` or `max`, which take the first of equal numbers."""

    def call(*args: Any, **keywords: Any) -> Any:
        numbers = list(args[0]) if len(args) == 1 else args
        if keywords or not any(isinstance(number, Node) for number in numbers):
            return original(*([numbers] if len(args) == 1 else args), **keywords)
        best, *others = numbers
        for other in others:
            best = follow_arms(is_better(other, best), lambda: other, lambda: best)  # noqa: B023
        return best

    return call


HELPERS = {
    rewrite.JOIN: follow_arms,
    rewrite.BOTH: both,
    rewrite.EITHER: either,
    rewrite.COMPARE: compare_chain,
    rewrite.EQUAL: equal_or_unequal,
}
#: Functions of Python that compare numbers.
BUILT_IN = {
    "min": extreme(min, operator.lt),
    "max": extreme(max, operator.gt),
}
