"""Follow pure functions with symbols for numbers: every path that their conditions allow, as a tree.

Operations stay in the order of the source, so that C repeats every bit; what is computed twice on
a path is one node. A condition on a symbol ends the run, which then starts again once for either
answer. Functions of `boundaries` become functions of their own, called; all others are followed
where they are called.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from ..declare.record import Declaration
from ..step import flow

COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")


class Untraceable(TypeError):
    """What cannot be told in C."""


class Fork(BaseException):
    """The end of a run at a condition that is still open."""

    def __init__(self, condition: Node) -> None:
        self.condition = condition


class Node:
    """A value that is known when the FMU runs; `items` are all that it can be, if it is a choice."""

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

    def __mod__(self, other: Any) -> Any:
        return operation("modulo", self, other)

    def __pow__(self, other: Any) -> Any:
        if isinstance(other, Node):
            raise Untraceable("a power whose exponent is not a constant")
        return operation("power", self, other)

    def __neg__(self) -> Any:
        return operation("neg", self)

    def __abs__(self) -> Any:
        return operation("fabs", self)

    def __lt__(self, other: Any) -> Any:
        return compared("<", self, other)

    def __le__(self, other: Any) -> Any:
        return compared("<=", self, other)

    def __gt__(self, other: Any) -> Any:
        return compared(">", self, other)

    def __ge__(self, other: Any) -> Any:
        return compared(">=", self, other)

    def __eq__(self, other: object) -> Any:
        return compared("==", self, other)

    def __ne__(self, other: object) -> Any:
        return compared("!=", self, other)

    def __bool__(self) -> bool:
        if self.op == "!=":
            return not compared("==", *self.args)
        return PATHS[-1].decide(self) if self.op in COMPARISONS else bool(self != 0.0)

    def __hash__(self) -> int:
        return hash(self.choice())

    def __index__(self) -> int:
        return int(self.choice())

    def __repr__(self) -> str:
        """A mark in a text, for a value that the FMU will know."""
        return f"\x01{self.number}\x02"

    def __format__(self, spec: str) -> str:
        if spec:
            raise Untraceable(f"the format {spec!r} of a number in a text")
        return repr(self)

    def choice(self) -> Any:
        """The one of its items that it is on this path."""
        for item in self.items:
            if self == item:
                return item
        raise Untraceable(f"{describe(self)} used as a key, an index or a choice")


class Branch(NamedTuple):
    """Nodes in the order of their computation, then one of two trees."""

    nodes: list[Node]
    condition: Node
    true: Tree
    false: Tree


class Leaf(NamedTuple):
    """The end of a path: its last nodes, and the values returned or the reason for having none."""

    nodes: list[Node]
    values: list[Any]
    shape: Any
    error: str | None


Tree = Branch | Leaf


class Function(NamedTuple):
    """A traced function: shapes of the parameters by name, its paths, how its values are arranged."""

    name: str
    parameters: dict[str, Any]
    tree: Tree
    shape: Any


class Static:
    """Something without numbers, the same wherever it is the same object or text."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Static) and hash(self) == hash(other)

    def __hash__(self) -> int:
        return hash(self.value) if isinstance(self.value, str) else id(self.value)


class Path:
    """What is known on the way through a function: answers given, and nodes already computed."""

    def __init__(self, answers: tuple[bool, ...], outer: Path | None, token: tuple[Any, ...]):
        self.answers, self.token, self.given, self.marks = answers, token, 0, 0
        self.seen: set[int] = set(outer.seen) if outer else set()
        self.facts: dict[int, bool] = dict(outer.facts) if outer else {}
        self.choices: dict[int, list[int]] = dict(outer.choices) if outer else {}
        self.nodes: list[Node] = []

    def mark(self) -> tuple[Any, ...]:
        """A name for a place on this path, the same whenever it is run through."""
        self.marks += 1
        return (*self.token, self.answers[: self.given], self.marks)

    def visit(self, node: Node) -> Node:
        if node.number not in self.seen:
            self.seen.add(node.number)
            self.nodes.append(node)
        return node

    def decide(self, condition: Node) -> bool:
        if condition.number not in self.facts:
            if self.given == len(self.answers):
                raise Fork(condition)
            self.learn(condition, self.answers[self.given])
            self.given += 1
            self.nodes = []
        return self.facts[condition.number]

    def learn(self, condition: Node, answer: bool) -> None:
        self.facts[condition.number] = answer
        left, right = condition.args
        if condition.op == "==" and left.items and not isinstance(right, Node):
            known = self.choices.get(left.number, left.items)
            self.choices[left.number] = [item for item in known if (item == right) == answer]


SHORT = 40
PATHS: list[Path] = []
TABLE: dict[Any, Node] = {}
NODES: list[Node] = []


def key(value: Any) -> Any:
    return value.number if isinstance(value, Node) else float(value).hex()


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


def operation(op: str, *args: Any) -> Any:
    """The result of an operation that C knows by this name."""
    if not all(isinstance(arg, int | float | Node) for arg in args):
        return NotImplemented
    return PATHS[-1].visit(unique((op, *map(key, args)), plain(args)))


def plain(args: Sequence[Any]) -> list[Any]:
    """Numbers as Reals."""
    return [arg if isinstance(arg, Node) else float(arg) for arg in args]


def compared(op: str, left: Node, right: Any) -> Any:
    """A comparison, with its answer where the path knows it."""
    if not isinstance(right, int | float | Node):
        return NotImplemented
    known = PATHS[-1].choices.get(left.number, left.items)
    if known and not isinstance(right, Node) and op in ("==", "!="):
        if right not in list(known):
            return op == "!="
        if len(known) == 1:
            return op == "=="
    return unique((op, left.number, key(right)), plain((left, right)), "Boolean")


def describe(node: Node) -> str:
    return f"{node.op} {node.args[0] if node.args else ''}".strip()


def flatten(value: Any) -> tuple[Any, list[Any]]:
    """The arrangement of a value, and its numbers in order."""
    if isinstance(value, Node | int | float):
        return "number", [value]
    if isinstance(value, tuple | list):
        parts = [flatten(item) for item in value]
        numbers = [number for _, numbers in parts for number in numbers]
        shape = (type(value), tuple(shape for shape, _ in parts))
        if not has_static(shape) or any(isinstance(number, Node) for number in numbers):
            return shape, numbers
    return ("static", Static(value)), []


def arranged(shape: Any, numbers: Iterator[Any]) -> Any:
    """The value of this arrangement with these numbers."""
    if shape == "number":
        return next(numbers)
    cls, parts = shape
    if cls == "static":
        return parts.value
    values = [arranged(part, numbers) for part in parts]
    return cls._make(values) if hasattr(cls, "_make") else cls(values)


def size(shape: Any) -> int:
    """How many numbers are arranged so."""
    return 1 if shape == "number" else 0 if shape[0] == "static" else sum(map(size, shape[1]))


def kinds(shape: Any) -> Iterator[tuple[str, Sequence[int]]]:
    """The type of each number of a shape, with all its values if it is an enumeration."""
    if shape == "number":
        yield "Real", ()
    elif shape[0] != "static":
        declared = getattr(shape[0], "_declared", {}).values()
        for part, field in zip(shape[1], declared or shape[1]):
            if part == "number" and isinstance(field, Declaration):
                yield field.kind, tuple(field.items or ())
            else:
                yield from kinds(part)


def symbols(shape: Any, name: Callable[[int], tuple[Any, ...]]) -> Any:
    """A value of this shape made of symbols, each named by its place."""
    numbers = (
        symbol(*name(place), kind=kind, items=items)
        for place, (kind, items) in enumerate(kinds(shape))
    )
    return arranged(shape, iter(list(numbers)))


def grow(run: Callable[[], Any], token: tuple[Any, ...], answers: tuple[bool, ...] = ()) -> Tree:
    """All paths through `run` that begin with these answers."""
    path = Path(answers, PATHS[-1] if PATHS else None, token)
    PATHS.append(path)
    try:
        shape, values = flatten(run())
        return Leaf(path.nodes, values, shape, None)
    except (ValueError, ArithmeticError) as error:
        return Leaf(path.nodes, [], None, str(error))
    except LookupError as error:
        return Leaf(path.nodes, [], None, type(error).__name__)
    except Fork as fork:
        condition = fork.condition
    finally:
        PATHS.pop()
    true, false = (grow(run, token, (*answers, answer)) for answer in (True, False))
    return Branch(path.nodes, condition, true, false)


def leaves(tree: Tree) -> Iterator[Leaf]:
    """The ends of all paths."""
    if isinstance(tree, Branch):
        yield from leaves(tree.true)
        yield from leaves(tree.false)
    else:
        yield tree


def function(
    name: str, run: Callable[..., Any], shapes: dict[str, Any], types: Sequence[str] = ()
) -> Function | None:
    """Trace `run` with symbols of these shapes; None where its paths return unlike things."""
    known = list(zip(shapes.items(), types or ["Real"] * len(shapes)))

    def call() -> Any:
        return run(**{name: parameter_of(name, shape, kind) for (name, shape), kind in known})

    paths, PATHS[:] = PATHS[:], []
    try:
        tree = grow(call, (name,))
    finally:
        PATHS[:] = paths
    found = {leaf.shape for leaf in leaves(tree) if leaf.error is None}
    alike = {unified(shape) for shape in found}
    if len(alike) != 1 or (has_static(*alike) and alike != {flatten(None)[0]}):
        return None
    return Function(name, shapes, tree, next(iter(found)))


def parameter_of(name: str, shape: Any, kind: str) -> Any:
    if shape == "number":
        return symbol("symbol", name, kind=kind)
    return symbols(shape, lambda place: ("element", name, place))


def unified(shape: Any) -> Any:
    """A shape in which a list is as good as a tuple."""
    if shape == "number" or shape[0] == "static":
        return shape
    cls = shape[0] if hasattr(shape[0], "_make") else tuple
    return cls, tuple(unified(part) for part in shape[1])


def has_static(shape: Any) -> bool:
    if shape == "number":
        return False
    return shape[0] == "static" or any(map(has_static, shape[1]))


class Tracer:
    """Everything traced for one component: `functions` in the order in which C needs them."""

    def __init__(self, model: ModuleType, kit: dict[ModuleType, tuple[str, ...]]) -> None:
        self.model, self.kit = model, kit
        for record in (TABLE, NODES, LOOPS, BODIES):
            record.clear()
        self.functions: dict[Any, Function | None] = {}

    def entry(self, name: str, run: Callable[..., Any], **examples: Any) -> Function:
        """Trace a function that the runtime calls, with symbols in the shape of these examples."""
        shapes = {parameter: flatten(value)[0] for parameter, value in examples.items()}
        with self.patched():
            traced = function(name, run, shapes)
        if traced is None:
            raise Untraceable(f"{name} does not return the same record on all paths")
        self.functions[name] = traced
        return traced

    @contextmanager
    def patched(self) -> Iterator[None]:
        """Mathematics, loops and boundaries of component and kit replaced by what records them."""
        kept = []
        for module in (self.model, *self.kit):
            for name, value in list(vars(module).items()):
                new = self.replacement(module, name, value)
                if new is not None:
                    kept.append((module, name, value))
                    setattr(module, name, new)
        try:
            yield
        finally:
            for module, name, value in kept:
                setattr(module, name, value)

    def replacement(self, module: ModuleType, name: str, value: Any) -> Any:
        for original, new in REPLACED.items():
            if value is original:
                return new
        value = getattr(value, "__wrapped__", value)
        own = isinstance(value, FunctionType) and value.__module__ == module.__name__
        wanted = not inspect.isgeneratorfunction(value)
        if module is not self.model:
            wanted = name in self.kit[module]
        return self.boundary(value) if own and wanted else None

    def boundary(self, original: Callable[..., Any]) -> Callable[..., Any]:
        """A function that is called, not followed, where it returns numbers."""
        signature = inspect.signature(original)

        def call(*given: Any, **named: Any) -> Any:
            bound = signature.bind(*given, **named)
            bound.apply_defaults()
            args = bound.args
            flat = [flatten(arg) for arg in args]
            if bound.kwargs or not any(n for _, n in flat):
                return original(*given, **named)
            shapes = {name: unified(shape) for name, (shape, _) in zip(bound.arguments, flat)}
            types = tuple(arg.kind if isinstance(arg, Node) else "Real" for arg in args)
            identity = (original, tuple(shapes.items()), types)
            if identity not in self.functions:
                name = f"{original.__name__}_{len(self.functions)}"
                self.functions[identity] = None
                traced = function(name, original, shapes, types)
                del self.functions[identity]
                self.functions[identity] = None if traced and is_short(traced) else traced
            traced = self.functions[identity]
            if traced is None:
                return original(*args)
            numbers = [tuple(numbers) for _, numbers in flat if numbers]
            result = called(traced, numbers)
            return arranged(traced.shape, iter(result))

        return call


def is_short(traced: Function) -> bool:
    """Whether a function is better followed than called: one path, and a short one."""
    return (
        isinstance(traced.tree, Leaf) and len(traced.tree.nodes) <= SHORT and size(traced.shape) > 0
    )


def called(traced: Function, numbers: list[tuple[Any, ...]]) -> list[Any]:
    """The numbers that a call of this function returns; one without any is called each time."""
    identity: tuple[Any, ...] = ("call", traced.name, *(tuple(map(key, g)) for g in numbers))
    identity += () if size(traced.shape) else (PATHS[-1].mark(),)
    call = PATHS[-1].visit(unique(identity, (traced, [plain(group) for group in numbers])))
    return [
        symbol("result", call.number, place, kind=kind, items=items)
        for place, (kind, items) in enumerate(kinds(traced.shape))
    ]


def mathematical(original: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `math` that also takes symbols."""

    def call(*args: Any) -> Any:
        if any(isinstance(arg, Node) for arg in args):
            return operation(original.__name__, *args)
        return original(*args)

    return call


def isfinite(x: Any) -> Any:
    """`math.isfinite` that also takes symbols."""
    return abs(x) < math.inf


def effect(op: str, *args: Any) -> Node:
    """Something that happens at this place."""
    path = PATHS[-1]
    return path.visit(unique((op, path.mark()), args))


def note(sentence: str) -> None:
    """Say this to the host's log."""
    effect("note", sentence)


def attempted(run: Callable[[], Any], otherwise: Any) -> Any:
    """`flow.attempted` for symbols."""
    effect("leave if failed")
    try:
        shape, numbers = flatten(run())
    except (ArithmeticError, ValueError):
        return otherwise
    failed = effect("forget failure")
    _, others = flatten(otherwise)
    chosen = [
        operation("select", failed, number, other) if key(number) != key(other) else number
        for number, other in zip(numbers, others, strict=True)
    ]
    return arranged(shape, iter(chosen))


def repeat(body: Callable[[Any], tuple[bool, Any]], carry: Any) -> Any:
    """`flow.repeat` for symbols: the body is followed once, its state is in variables."""
    mark = PATHS[-1].mark()
    shape, start = flatten(carry)
    number = LOOPS.setdefault(mark, len(LOOPS))
    state = symbols(shape, lambda place: ("variable", number, place))
    if mark not in BODIES:
        BODIES[mark] = grow(lambda: finished(*body(state)), (*mark, "body"))
    identity = ("loop", number, *map(key, start))
    PATHS[-1].visit(unique(identity, (number, plain(start), BODIES[mark])))
    return state


def finished(done: Any, carry: Any) -> tuple[bool, Any]:
    return bool(done), carry


LOOPS: dict[Any, int] = {}
BODIES: dict[Any, Tree] = {}

MATHEMATICS = (
    math.sin, math.cos, math.tan, math.acos, math.atan, math.atan2, math.sqrt, math.exp, math.expm1
)  # fmt: skip
REPLACED: dict[Callable[..., Any], Callable[..., Any]] = {
    **{original: mathematical(original) for original in MATHEMATICS},
    math.isfinite: isfinite,
    flow.repeat: repeat,
    flow.attempted: attempted,
}
