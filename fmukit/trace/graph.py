"""Traced numbers: nodes of a graph, each of a kind of its own, trees of them, and the path that is being followed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar, dataclass_transform

from .ops import COMPARISONS, OPS, Failure

#: Limit of the conditions on one path that are followed answer by answer: more are a loop that does not end.
MOST_CONDITIONS = 100
#: Limit of the paths through one function, which may double with each such condition: 2**10 take some seconds.
MOST_PATHS = 1024
N = TypeVar("N", bound="Node")
#: What tells a place on a path from all others, the same whenever the path is followed.
Place = tuple[Any, ...]
MARK = re.compile("\x01(\\d+)\x02")


class UntraceableError(TypeError):
    """What C cannot compute as Python does."""


class UnknownChoiceError(UntraceableError):
    """A number as a key, an index or a length, which is known only where its conditions have an answer."""


class NumberType(NamedTuple):
    """The type of a number as FMI names it, with all values that one of an enumeration can have."""

    kind: str = "Real"
    enumeration: tuple[int, ...] = ()


REAL = NumberType()


@dataclass(frozen=True, eq=False, repr=False)
class Node:
    """A number known only at run time.

    Attributes
    ----------
    number
        Its position in the order in which nodes were made; nodes are the same if their numbers are.
    type
        Its type: Real, Integer, Boolean or Enumeration.
    """

    number: int
    type: NumberType

    def __pos__(self) -> Any:
        return self

    def __eq__(self, other: object) -> Any:
        return comparison_or_answer("==", self, other)

    def __ne__(self, other: object) -> Any:
        return comparison_or_answer("!=", self, other)

    def __bool__(self) -> bool:
        return bool(self != 0.0)

    def __hash__(self) -> int:
        return hash(self.value_on_path())

    def __index__(self) -> int:
        return int(self.value_on_path())

    def __float__(self) -> float:
        raise UntraceableError("float() of a number known only at run time: leave it out")

    def __int__(self) -> int:
        raise UntraceableError("int() of a number known only at run time: write trunc(x) of math")

    def __round__(self, digits: int = 0) -> float:
        raise UntraceableError("round() of a number known only at run time: write floor(x + 0.5)")

    def __repr__(self) -> str:
        """Return a mark in a text, for a value that the FMU will know."""
        return f"\x01{self.number}\x02"

    def __format__(self, spec: str) -> str:
        if spec:
            raise UntraceableError(f"the format {spec!r} of a number in a text: write {{x!r}}")
        return repr(self)

    def value_on_path(self) -> int:
        """Return the value of its enumeration that it has on this path; raises UnknownChoiceError without one."""
        for value in self.type.enumeration:
            if self == value:
                return value
        raise UnknownChoiceError(
            "a number known only at run time used as a key, an index or a choice, "
            "which only an enumeration can be: write conditions"
        )


def _binary(op: str, turned: bool = False) -> Callable[[Node, Any], Any]:
    if turned:
        return lambda self, other: operation(op, other, self)
    return lambda self, other: operation(op, self, other)


def _unary(op: str) -> Callable[[Node], Any]:
    return lambda self: operation(op, self)


def _compared(op: str) -> Callable[[Node, Any], Any]:
    return lambda self, other: comparison_or_answer(op, self, other)


for _name, _op in {"add": "+", "sub": "-", "mul": "*", "truediv": "/", "floordiv": "floordiv",
                   "mod": "modulo", "pow": "power"}.items():  # fmt: skip
    setattr(Node, f"__{_name}__", _binary(_op))
    setattr(Node, f"__r{_name}__", _binary(_op, turned=True))
for _name, _op in {"neg": "neg", "abs": "fabs"}.items():
    setattr(Node, f"__{_name}__", _unary(_op))
for _name, _op in {"lt": "<", "le": "<=", "gt": ">", "ge": ">="}.items():
    setattr(Node, f"__{_name}__", _compared(_op))


def _refuse(what: str) -> Callable[..., Any]:
    def refused(*_: Any) -> Any:
        raise UntraceableError(f"{what}")

    return refused


for _names, _what in {
    "and rand": "& between conditions: write 'and'",
    "or ror": "| between conditions: write 'or'",
    "xor rxor": "^ between conditions: write !=",
    "invert": "~ of a condition: write 'not'",
    "lshift rlshift": "<< of a number: write x * 2.0 ** n",
    "rshift rrshift": ">> of a number: write x * 0.5 ** n",
    "matmul rmatmul": "@ of numbers: write the sum of products",
    "divmod rdivmod": "divmod() of a number known only at run time: write x // y and x % y",
    "len": "len() of a number known only at run time: take that of its State or Inputs",
    "call": "a number known only at run time is called like a function: a * is missing",
}.items():
    for _name in _names.split():
        setattr(Node, f"__{_name}__", _refuse(_what))


@dataclass_transform(frozen_default=True, eq_default=False)
def node(kind: type[N]) -> type[N]:
    """Make a kind of nodes of its fields, compared as numbers are."""
    return dataclass(frozen=True, eq=False, repr=False)(kind)


@node
class Operation(Node):
    """An operation of the table `OPS` on numbers and nodes."""

    op: str
    operands: tuple[Any, ...]

    def __bool__(self) -> bool:
        if self.op == "!=":
            return not comparison_or_answer("==", *self.operands)
        return current().path.decide(self) if self.op in COMPARISONS else bool(self != 0.0)

    @property
    def is_comparison(self) -> bool:
        """Whether the result is true or false."""
        return self.op in COMPARISONS


@node
class Argument(Node):
    """A parameter of a traced function, or the number at an index of one that is a record."""

    name: str
    index: int | None


@node
class LoopVariable(Node):
    """A number that a loop carries on, by the number of the loop."""

    loop: int
    index: int


@node
class Call(Node):
    """A call of a traced function, with a group of numbers for each parameter that has any."""

    function: Function
    groups: tuple[tuple[Any, ...], ...]


@node
class Result(Node):
    """One of the numbers that a call returns."""

    call: Call
    index: int


@node
class Loop(Node):
    """A loop of unknown length: the start of its variables; its body ends with `done` and their next values."""

    loop: int
    start: tuple[Any, ...]
    body: Tree


@node
class Phi(Node):
    """A value after a join, which comes from one of its arms: phi of static single assignment."""


@node
class Join(Node):
    """A condition with an arm for either answer, after which one path goes on with the values in `phis`."""

    condition: Operation
    true: Leaf
    false: Leaf
    phis: tuple[Phi, ...]

    @property
    def arms(self) -> tuple[Leaf, Leaf]:
        """The arms for true and for false."""
        return self.true, self.false


@node
class Note(Node):
    """A sentence for the log of the host."""

    text: Text


@node
class AttemptStart(Node):
    """The start of what may fail without an end of the function; what failed before ends it."""


@node
class AttemptEnd(Node):
    """The end of an attempt, which forgets its failure: true if there was one."""


@dataclass(frozen=True, eq=False)
class Text:
    """A text with the values of nodes in it: pieces around them."""

    pieces: tuple[str, ...]
    nodes: tuple[Node, ...]

    @property
    def identity(self) -> tuple[Any, ...]:
        """What makes it the same as another text."""
        return self.pieces, tuple(node.number for node in self.nodes)

    def with_marks(self) -> str:
        """Return the text with marks for the values, from which `text_of` makes it again."""
        values = [*map(repr, self.nodes), ""]
        return "".join(piece + value for piece, value in zip(self.pieces, values))


class Leaf(NamedTuple):
    """Nodes in the order of their computation, then the end: values, or the text of an error."""

    nodes: list[Node]
    values: list[Any]
    shape: Any
    error: Text | None


class Branch(NamedTuple):
    """Nodes in the order of their computation, then one of two trees."""

    nodes: list[Node]
    condition: Operation
    true: Tree
    false: Tree


Tree = Branch | Leaf


class Function(NamedTuple):
    """A traced function: parameters by name with the shape of each, and the shape of the result.

    The runtime calls an `entry`, with all its parameters; from others those without numbers are
    left out.
    """

    name: str
    parameters: dict[str, Any]
    tree: Tree
    shape: Any
    entry: bool = False


class Fork(BaseException):
    """The end of a run at a condition that is still open."""

    def __init__(self, condition: Operation) -> None:
        self.condition = condition


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


class TraceContext:
    """All that tracing keeps: the nodes by what makes them unique, the loops, and the path that is being followed.

    Operators of nodes have no argument for it, so that one context is the current one while functions are traced.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.node_by_identity: dict[Any, Node] = {}
        self.loop_numbers: dict[Any, int] = {}
        self.loop_bodies: dict[Any, Tree] = {}
        self.paths: list[FollowedPath] = []
        self.joins: dict[Any, Any] = {}
        self.forks, self.without_joins = 0, False

    def unique(self, identity: tuple[Any, ...], cls: type[N], *fields: Any) -> N:
        """Return the node of this identity, with these fields after its number where it is made now."""
        if identity not in self.node_by_identity:
            node = cls(len(self.nodes), *fields)
            self.node_by_identity[identity] = node
            self.nodes.append(node)
        return self.node_by_identity[identity]  # type: ignore[return-value]

    @property
    def path(self) -> FollowedPath:
        """The path that is being followed."""
        return self.paths[-1]

    @contextmanager
    def separate_function(self, without_joins: bool) -> Iterator[None]:
        """Follow a function from its start, whatever path calls it, each path to its end if `without_joins`."""
        saved = self.paths, self.joins, self.forks, self.without_joins
        self.paths, self.joins, self.forks, self.without_joins = [], {}, 0, without_joins
        try:
            yield
        finally:
            self.paths, self.joins, self.forks, self.without_joins = saved


#: The contexts that are active, the current one last.
_ACTIVE: list[TraceContext] = []


def current() -> TraceContext:
    """Return the current context; raises RuntimeError outside of tracing."""
    if not _ACTIVE:
        raise RuntimeError("a traced number was used after tracing")
    return _ACTIVE[-1]


@contextmanager
def active(context: TraceContext) -> Iterator[TraceContext]:
    """Make a context the current one."""
    _ACTIVE.append(context)
    try:
        yield context
    finally:
        _ACTIVE.pop()


def key(value: Any) -> Any:
    """Return what makes a value the same as another: its number, or its bits."""
    return value.number if isinstance(value, Node) else float(value).hex()


def type_of(value: Any) -> NumberType:
    """Return the type of a number; a constant is of no enumeration."""
    if isinstance(value, Node):
        return value.type
    return NumberType({bool: "Boolean", int: "Integer"}.get(type(value), "Real"))


def argument(name: str, index: int | None, type: NumberType = REAL) -> Argument:
    """Return the node of a parameter, or of the number at an index of one."""
    return current().unique(("argument", name, index, type), Argument, type, name, index)


def loop_variable(loop: int, index: int, type: NumberType) -> LoopVariable:
    """Return the node of a number that a loop carries on."""
    return current().unique(("variable", loop, index, type), LoopVariable, type, loop, index)


def call_result(call: Call, index: int, type: NumberType) -> Result:
    """Return the node of a number that a call returns."""
    return current().unique(("result", call.number, index, type), Result, type, call, index)


def new_phi(type: NumberType = REAL) -> Phi:
    """Return a new value after a join."""
    return current().unique(("phi", len(current().nodes)), Phi, type)


def new_join(condition: Operation, arms: Sequence[Leaf], phis: Sequence[Phi]) -> Join:
    """Return a new join of the arms for true and for false."""
    identity = ("join", len(current().nodes))
    return current().unique(identity, Join, REAL, condition, *arms, tuple(phis))


def call_node(function: Function, groups: Sequence[Sequence[Any]], place: Place) -> Call:
    """Return the node of a call; one without results is the same only at the same place."""
    identity: tuple[Any, ...] = ("call", function.name, *(tuple(map(key, g)) for g in groups))
    identity += () if size(function.shape) else (place,)
    numbers = tuple(with_float_constants(group) for group in groups)
    return current().unique(identity, Call, REAL, function, numbers)


def operation_node(op: str, operands: Sequence[Any]) -> Operation:
    """Return the node of an operation, wherever it stands."""
    identity, type = (op, *map(key, operands)), NumberType(OPS[op].result.value)
    return current().unique(identity, Operation, type, op, with_float_constants(operands))


def operation(op: str, *operands: Any) -> Any:
    """Return the result of an operation, computed at this point of the path."""
    if not all(isinstance(operand, (int, float, Node)) for operand in operands):
        return NotImplemented
    return current().path.record(operation_node(op, operands))


def with_float_constants(operands: Sequence[Any]) -> tuple[Any, ...]:
    """Return numbers as floats, and nodes as they are."""
    return tuple(x if isinstance(x, Node) else float(x) for x in operands)


def comparison_or_answer(op: str, left: Node, right: Any) -> Any:
    """Return a comparison, or its answer where the path knows it."""
    if not isinstance(right, (int, float, Node)):
        return NotImplemented
    possible = current().path.possible_values.get(left.number, left.type.enumeration)
    if possible and not isinstance(right, Node) and op in ("==", "!="):
        if right not in possible:
            return op == "!="
        if len(possible) == 1:
            return op == "=="
    return operation_node(op, (left, right))


def text_of(sentence: str) -> Text:
    """Return a sentence with the marks of nodes replaced by the nodes."""
    pieces = MARK.split(sentence)
    nodes = current().nodes
    return Text(tuple(pieces[::2]), tuple(nodes[int(number)] for number in pieces[1::2]))


def size(shape: Any) -> int:
    """Return how many numbers a value of this shape has."""
    return 1 if shape == "number" else 0 if shape[0] == "static" else sum(map(size, shape[1]))


def operands_of(node: Any) -> Iterator[Any]:
    """Yield the values that a node is computed from."""
    match node:
        case Operation():
            yield from node.operands
        case Result():
            yield node.call
        case Call():
            for group in node.groups:
                yield from group
        case Loop():
            yield from node.start
            yield from directly_needed(node.body)
        case Join():
            yield from node.condition.operands
            for arm in node.arms:
                yield from directly_needed(arm._replace(values=[]))
        case Note():
            yield from node.text.nodes


def directly_needed(tree: Tree) -> Iterator[Any]:
    """Yield the values a tree needs, without what they need: results, conditions, texts, operands of effects."""
    yield from (x for node in tree.nodes if has_effect(node) for x in operands_of(node))
    if isinstance(tree, Branch):
        yield from tree.condition.operands
        yield from directly_needed(tree.true)
        yield from directly_needed(tree.false)
    else:
        yield from tree.values
        yield from tree.error.nodes if tree.error else ()


def ancestors(values: Iterable[Any], joins: dict[int, list[Join]]) -> set[int]:
    """Return the numbers of all nodes that these values are computed from; `joins` from `joins_by_phi`."""
    numbers: set[int] = set()
    waiting = list(values)
    while waiting:
        value = waiting.pop()
        if isinstance(value, Node) and value.number not in numbers:
            numbers.add(value.number)
            waiting += operands_of(value)
            for join in joins.get(value.number, ()):
                index = next(n for n, phi in enumerate(join.phis) if phi is value)
                waiting += [join, *(arm.values[index] for arm in join.arms)]
    return numbers


def subtrees(node: Node) -> tuple[Tree, ...]:
    """Return the trees within a node: the arms of a join, the body of a loop."""
    if isinstance(node, Join):
        return node.arms
    return (node.body,) if isinstance(node, Loop) else ()


def joins_by_phi(tree: Tree) -> dict[int, list[Join]]:
    """Return the joins of a tree, by the numbers of their phis."""
    joins: dict[int, list[Join]] = {}
    for node in nodes_in(tree):
        if isinstance(node, Join):
            for phi in node.phis:
                joins.setdefault(phi.number, []).append(node)
    return joins


def nodes_in(tree: Tree) -> Iterator[Node]:
    """Yield all nodes of a tree, those of the trees within nodes after the node."""
    for node in tree.nodes:
        yield node
        for part in subtrees(node):
            yield from nodes_in(part)
    if isinstance(tree, Branch):
        yield from nodes_in(tree.true)
        yield from nodes_in(tree.false)


def has_effect(node: Node) -> bool:
    """Whether a node does something even where its value is not used."""
    if isinstance(node, Join):
        return any(arm.error is not None or any(map(has_effect, arm.nodes)) for arm in node.arms)
    if isinstance(node, (Call, Loop, Note, AttemptStart, AttemptEnd)):
        return True
    return may_fail(node)


def may_fail(node: Node) -> bool:
    """Whether Python may raise here."""
    if not isinstance(node, Operation):
        return False
    failure = OPS[node.op].failure
    if failure is Failure.FOR_DIVISOR_ZERO:
        return isinstance(node.operands[1], Node) or node.operands[1] == 0.0
    return failure is Failure.FOR_SOME_OPERANDS
