"""Values of traced functions: numbers known only at run time, as nodes of what computes them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from .execute import Path

COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
FAILING = {
    "/", "power", "modulo", "floordiv", "fmod", "pow", "sin", "cos", "tan", "asin", "acos", "sinh",
    "cosh", "acosh", "atanh", "sqrt", "exp", "expm1", "log", "log10", "log2", "log1p", "floor",
    "ceil", "trunc",
}  # fmt: skip
EFFECTS = {"call", "loop", "note", "leave if failed", "forget failure"}
BETWEEN = {"result", *COMPARISONS}
MARK = re.compile("\x01(\\d+)\x02")


class Untraceable(TypeError):
    """What C cannot compute as Python does."""


class Node:
    """A number known only at run time; `items` are its possible values if it is an enumeration."""

    __slots__ = ("args", "items", "kind", "number", "op")

    def __init__(
        self, number: int, op: str, args: tuple[Any, ...], kind: str, items: Sequence[int]
    ) -> None:
        self.number, self.op, self.args, self.kind, self.items = number, op, args, kind, items

    def __add__(self, other: Any) -> Any:
        return operation("+", self, other)

    def __radd__(self, other: Any) -> Any:
        return operation("+", other, self)

    def __sub__(self, other: Any) -> Any:
        return operation("-", self, other)

    def __rsub__(self, other: Any) -> Any:
        return operation("-", other, self)

    def __mul__(self, other: Any) -> Any:
        return operation("*", self, other)

    def __rmul__(self, other: Any) -> Any:
        return operation("*", other, self)

    def __truediv__(self, other: Any) -> Any:
        return operation("/", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return operation("/", other, self)

    def __floordiv__(self, other: Any) -> Any:
        return operation("floordiv", self, other)

    def __rfloordiv__(self, other: Any) -> Any:
        return operation("floordiv", other, self)

    def __mod__(self, other: Any) -> Any:
        return operation("modulo", self, other)

    def __rmod__(self, other: Any) -> Any:
        return operation("modulo", other, self)

    def __pow__(self, other: Any) -> Any:
        return operation("power", self, other)

    def __rpow__(self, other: Any) -> Any:
        return operation("power", other, self)

    def __neg__(self) -> Any:
        return operation("neg", self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return operation("fabs", self)

    def __lt__(self, other: Any) -> Any:
        return comparison("<", self, other)

    def __le__(self, other: Any) -> Any:
        return comparison("<=", self, other)

    def __gt__(self, other: Any) -> Any:
        return comparison(">", self, other)

    def __ge__(self, other: Any) -> Any:
        return comparison(">=", self, other)

    def __eq__(self, other: object) -> Any:
        return comparison("==", self, other)

    def __ne__(self, other: object) -> Any:
        return comparison("!=", self, other)

    def __bool__(self) -> bool:
        if self.op == "!=":
            return not comparison("==", *self.args)
        return PATHS[-1].decide(self) if self.op in COMPARISONS else bool(self != 0.0)

    def __hash__(self) -> int:
        return hash(self.choice())

    def __index__(self) -> int:
        return int(self.choice())

    def __float__(self) -> float:
        raise Untraceable("float() of a number known only at run time: leave it out")

    def __int__(self) -> int:
        raise Untraceable("int() of a number known only at run time: write trunc(x) of math")

    def __round__(self, digits: int = 0) -> float:
        raise Untraceable("round() of a number known only at run time: write floor(x + 0.5)")

    def __repr__(self) -> str:
        """A mark in a text, for a value that the FMU will know."""
        return f"\x01{self.number}\x02"

    def __format__(self, spec: str) -> str:
        if spec:
            raise Untraceable(f"the format {spec!r} of a number in a text: write {{x!r}}")
        return repr(self)

    def choice(self) -> Any:
        """The one of its items that it is on this path."""
        for item in self.items:
            if self == item:
                return item
        raise Untraceable(
            "a number known only at run time used as a key, an index or a choice, "
            "which only an enumeration can be: write conditions"
        )


def _refuse(what: str) -> Callable[..., Any]:
    def refused(*_: Any) -> Any:
        raise Untraceable(f"{what}")

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


class Leaf(NamedTuple):
    """Nodes in the order of their computation, then the end: values, or the text of an error."""

    nodes: list[Node]
    values: list[Any]
    shape: Any
    error: str | None


class Branch(NamedTuple):
    """Nodes in the order of their computation, then one of two trees."""

    nodes: list[Node]
    condition: Node
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


PATHS: list[Path] = []
TABLE: dict[Any, Node] = {}
NODES: list[Node] = []


def key(value: Any) -> Any:
    """What makes a value the same as another: its number, or its bits."""
    return value.number if isinstance(value, Node) else float(value).hex()


def kind_of(value: Any) -> str:
    """The type of a value."""
    if isinstance(value, Node):
        return value.kind
    return {bool: "Boolean", int: "Integer"}.get(type(value), "Real")


def unique(
    identity: tuple[Any, ...], args: Sequence[Any], kind: str = "Real", items: Sequence[int] = ()
) -> Node:
    """The node of this identity, which begins with its operation."""
    if identity not in TABLE:
        TABLE[identity] = Node(len(NODES), identity[0], tuple(args), kind, items)
        NODES.append(TABLE[identity])
    return TABLE[identity]


def symbol(op: str, *args: Any, kind: str = "Real", items: Sequence[int] = ()) -> Node:
    """A symbol that is told from others by its arguments."""
    return unique((op, *args, kind, tuple(items)), args, kind, items)


def operation_node(op: str, args: Sequence[Any]) -> Node:
    """The node of an operation, wherever it stands."""
    kind = "Integer" if op in ("floor", "ceil", "trunc") else "Real"
    return unique((op, *map(key, args)), as_reals(args), "Boolean" if op in COMPARISONS else kind)


def operation(op: str, *args: Any) -> Any:
    """The result of an operation that C knows by this name, computed here."""
    if not all(isinstance(arg, (int, float, Node)) for arg in args):
        return NotImplemented
    return PATHS[-1].visit(operation_node(op, args))


def as_reals(args: Sequence[Any]) -> list[Any]:
    """Numbers as Reals."""
    return [arg if isinstance(arg, Node) else float(arg) for arg in args]


def comparison(op: str, left: Node, right: Any) -> Any:
    """A comparison, with its answer where the path knows it."""
    if not isinstance(right, (int, float, Node)):
        return NotImplemented
    possible = PATHS[-1].choices.get(left.number, left.items)
    if possible and not isinstance(right, Node) and op in ("==", "!="):
        if right not in list(possible):
            return op == "!="
        if len(possible) == 1:
            return op == "=="
    return operation_node(op, (left, right))


def size(shape: Any) -> int:
    """How many numbers are arranged so."""
    return 1 if shape == "number" else 0 if shape[0] == "static" else sum(map(size, shape[1]))


def nodes_in_text(text: str) -> Iterator[Node]:
    """The values that stand in a text."""
    for number in MARK.findall(text):
        yield NODES[int(number)]


def operands(node: Any) -> Iterator[Any]:
    """The values that a node is computed from."""
    if not isinstance(node, Node):
        return
    if node.op == "result":
        yield NODES[node.args[0]]
    elif node.op == "call":
        for group in node.args[1]:
            yield from group
    elif node.op == "loop":
        yield from node.args[1]
        yield from needed(node.args[2])
    elif node.op == "join":
        yield from node.args[0].args
        for arm in node.args[1:3]:
            yield from needed(arm._replace(values=[]))
    elif node.op == "note":
        yield from nodes_in_text(node.args[0])
    elif node.op not in ("symbol", "element", "variable", "phi"):
        yield from node.args


def needed(tree: Tree) -> Iterator[Any]:
    """The values a tree needs: results, conditions, texts, and what may fail or acts."""
    yield from (arg for node in tree.nodes if has_effect(node) for arg in operands(node))
    if isinstance(tree, Branch):
        yield from tree.condition.args
        yield from needed(tree.true)
        yield from needed(tree.false)
    else:
        yield from tree.values
        yield from nodes_in_text(tree.error or "")


def ancestors(
    values: Iterable[Any], joins: dict[int, list[Node]], inside: set[int] | None = None
) -> set[int]:
    """The numbers of all nodes that these values are computed from; `joins` from `joins_of`.

    What is not `inside` is not followed further.
    """
    numbers: set[int] = set()
    waiting = list(values)
    while waiting:
        value = waiting.pop()
        if isinstance(value, Node) and value.number not in numbers:
            numbers.add(value.number)
            if inside is None or value.number in inside or value.op in BETWEEN:
                waiting += operands(value)
            for join in joins.get(value.number, ()):
                _, *arms, phis = join.args
                index = next(n for n, phi in enumerate(phis) if phi is value)
                waiting += [join, *(arm.values[index] for arm in arms)]
    return numbers


def all_nodes(tree: Tree) -> set[int]:
    """The numbers of all nodes of a tree."""
    numbers = set()
    for node in tree.nodes:
        numbers.add(node.number)
        for arm in node.args[1:3] if node.op == "join" else ():
            numbers |= all_nodes(arm)
        if node.op == "loop":
            numbers |= all_nodes(node.args[2])
    if isinstance(tree, Branch):
        numbers |= all_nodes(tree.true) | all_nodes(tree.false)
    return numbers


def joins_of(tree: Tree) -> dict[int, list[Node]]:
    """The joins of a tree, by the numbers of the values that they hand on."""
    joins_by_phi: dict[int, list[Node]] = {}
    for join in joins_in(tree):
        for phi in join.args[3]:
            joins_by_phi.setdefault(phi.number, []).append(join)
    return joins_by_phi


def joins_in(tree: Tree) -> Iterator[Node]:
    """All joins of a tree."""
    for node in tree.nodes:
        if node.op == "join":
            yield node
        for part in node.args[1:3] if node.op == "join" else node.args[2:3]:
            if node.op in ("join", "loop"):
                yield from joins_in(part)
    if isinstance(tree, Branch):
        yield from joins_in(tree.true)
        yield from joins_in(tree.false)


def has_effect(node: Node) -> bool:
    """Whether a node does something even where its value is not used."""
    if node.op == "join":
        return any(
            arm.error is not None or any(map(has_effect, arm.nodes)) for arm in node.args[1:3]
        )
    return node.op in EFFECTS or may_fail(node)


def may_fail(node: Node) -> bool:
    """Whether Python may raise here."""
    if node.op == "/":
        return isinstance(node.args[1], Node) or node.args[1] == 0.0
    return node.op in FAILING
