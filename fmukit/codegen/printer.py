"""The traversal that prints a traced function; C and Python only spell what it meets."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

from ..trace.graph import (
    Argument,
    AttemptEnd,
    AttemptStart,
    Branch,
    Call,
    Function,
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
    ancestors,
    directly_needed,
    has_effect,
    joins_by_phi,
    size,
)


def printed_name(name: str) -> str:
    """The printed name of a parameter or of its tangents, which never meets the printer's own names."""
    plain = re.sub(r"\W", lambda letter: f"_{ord(letter[0]):x}_", name.rstrip("'"), flags=re.ASCII)
    return f"{'d' if name.endswith(chr(39)) else 'p'}_{plain}"


def returns_number(function: Function) -> bool:
    """Whether the function returns its one result."""
    return size(function.shape) == 1 and not function.entry


def returns_array(function: Function) -> bool:
    """Whether the results of the function stand side by side."""
    return size(function.shape) > 0 and not returns_number(function)


def contiguous_start(group: Sequence[Any]) -> Argument | Result | None:
    """The first of numbers that already stand side by side: in a parameter, or in a result."""
    first = group[0] if group else None
    if isinstance(first, Argument) and first.index is not None:
        start = first.index
        in_order = all(
            isinstance(v, Argument) and (v.name, v.index) == (first.name, start + offset)
            for offset, v in enumerate(group)
        )
        return first if in_order else None
    if isinstance(first, Result) and returns_array(first.call.function):
        in_order = all(
            isinstance(v, Result) and v.call is first.call and v.index == first.index + offset
            for offset, v in enumerate(group)
        )
        return first if in_order else None
    return None


class Printer(ABC):
    """One function in one language: `lines` follows its tree, the abstract methods spell the lines."""

    #: How a condition begins and ends, and what stands between its arms.
    IF: ClassVar[str]
    ELSE: ClassVar[str]
    END: ClassVar[str]

    def __init__(self, function: Function) -> None:
        self.function = function
        self.names: dict[int, str] = {}
        self.block = 0
        self.used = ancestors(directly_needed(function.tree), joins_by_phi(function.tree))

    def body_lines(self) -> Iterator[str]:
        """The body of the function."""
        yield from self.tree(self.function.tree, 1, None)

    def tree(self, tree: Tree, depth: int, loop: Loop | None) -> Iterator[str]:
        """Nodes, and then a condition or an end; in a `loop`, the end of its body."""
        yield from self.nodes(tree.nodes, depth, id(tree))
        self.require_no_attempt()
        indent = "    " * depth
        if isinstance(tree, Branch):
            condition, short, long = self.condition(tree.condition), tree.true, tree.false
            if isinstance(long, Leaf) and isinstance(short, Branch):
                condition, short, long = self.negated(condition), long, short
            yield indent + self.IF.format(condition)
            yield from self.tree(short, depth + 1, loop)
            yield from self.block_end(indent)
            yield from self.tree(long, depth, loop)
        elif tree.error is not None:
            yield from self.failure(tree.error, indent)
        elif loop is not None:
            yield from self.loop_end(tree, loop, indent)
        else:
            yield from self.returned(tree, indent)

    def nodes(self, nodes: Sequence[Node], depth: int, block: int) -> Iterator[str]:
        """The nodes of a block that are read, or have an effect."""
        for node in nodes:
            self.block = block
            if not self.try_to_nest(node) and self.is_needed(node):
                yield from self.statement(node, depth)
        self.block = block

    def is_needed(self, node: Node) -> bool:
        """Whether a node has to be printed."""
        return node.number in self.used or has_effect(node) or bool(self.used_phis(node))

    def used_phis(self, node: Node) -> list[tuple[Phi, int]]:
        """The phis of a join that are read, with their indices."""
        phis = node.phis if isinstance(node, Join) else ()
        return [(phi, index) for index, phi in enumerate(phis) if phi.number in self.used]

    def statement(self, node: Node, depth: int) -> Iterator[str]:
        """The lines of one node."""
        indent = "    " * self.depth_of_statement(depth)
        match node:
            case Note():
                yield from self.note(node, indent)
            case AttemptStart():
                yield from self.attempt_start(indent)
            case AttemptEnd():
                yield from self.attempt_end(node, indent)
            case Loop():
                yield from self.loop(node, depth)
            case Call():
                yield from self.call(node, indent)
            case Join():
                yield from self.join(node, self.depth_of_statement(depth))
            case Operation():
                yield from self.definition(node, indent)

    def join(self, node: Join, depth: int) -> Iterator[str]:
        """A condition, and the values that either arm gives to the phis."""
        indent = "    " * depth
        condition, phis, block = self.condition(node.condition), self.used_phis(node), self.block
        names = [self.name(phi, "j") for phi, _ in phis]
        true, false = node.arms
        if not true.nodes and not false.nodes and true.error is false.error is None:
            for name, (_, index) in zip(names, phis):
                yes, no = self.value(true.values[index]), self.value(false.values[index])
                yield f"{indent}{self.choice(name, condition, yes, no)}"
            return
        yield from self.declared(names, indent)
        arms = [list(self.arm(arm, names, phis, depth + 1)) for arm in (true, false)]
        self.block = block
        if not arms[0]:
            condition, arms = self.negated(condition), arms[::-1]
        yield indent + self.IF.format(condition)
        yield from arms[0]
        if arms[1]:
            yield indent + self.ELSE
            yield from arms[1]
        yield from self.block_end(indent)

    def arm(
        self, arm: Leaf, names: Sequence[str], phis: Sequence[tuple[Phi, int]], depth: int
    ) -> Iterator[str]:
        """One arm of a join."""
        indent = "    " * depth
        yield from self.nodes(arm.nodes, depth, id(arm))
        if arm.error is not None:
            yield from self.failure(arm.error, indent)
        elif names:
            yield from self.assigned(names, [arm.values[index] for _, index in phis], indent)

    def block_end(self, indent: str) -> Iterator[str]:
        """The end of a condition, where the language writes one."""
        if self.END:
            yield indent + self.END

    def name(self, node: Node, letter: str = "n") -> str:
        """The name of a node."""
        return self.names.setdefault(node.number, f"{letter}{len(self.names)}")

    def value(self, value: Any) -> str:
        """A number where it is read."""
        if not isinstance(value, Node):
            return self.constant(value)
        if isinstance(value, Argument):
            name = printed_name(value.name)
            return name if value.index is None else f"{name}[{value.index}]"
        if isinstance(value, LoopVariable):
            return f"v{value.loop}_{value.index}"
        if isinstance(value, Result):
            return self.call_result(value)
        if isinstance(value, Operation) and value.is_comparison:
            return f"({self.expression(value)})"
        return self.names[value.number]

    def arguments(self, node: Call) -> Iterator[str]:
        """The arguments of a call: a number, or numbers side by side."""
        shapes = [shape for shape in node.function.parameters.values() if size(shape)]
        for shape, group in zip(shapes, node.groups, strict=True):
            yield self.value(group[0]) if shape == "number" else self.side_by_side(group)

    def try_to_nest(self, node: Node) -> bool:
        """Have a node written where it is read, if that can be; whether it is, so that it needs no statement."""
        return False

    def depth_of_statement(self, depth: int) -> int:
        """How deep a statement stands; what is attempted may stand deeper."""
        return depth

    def require_no_attempt(self) -> None:
        """Raise UntraceableError at the end of a block within an attempt that the language cannot write."""
        return

    def declared(self, names: Sequence[str], indent: str) -> Iterator[str]:
        """The declaration of phis, where the language has one."""
        yield from ()

    @abstractmethod
    def condition(self, node: Operation) -> str:
        """A condition as `IF` takes it."""

    @abstractmethod
    def negated(self, condition: str) -> str:
        """The opposite of a condition."""

    @abstractmethod
    def choice(self, name: str, condition: str, yes: str, no: str) -> str:
        """A phi of two values that need no statement."""

    @abstractmethod
    def assigned(self, names: Sequence[str], values: Sequence[Any], indent: str) -> Iterator[str]:
        """The values that an arm gives to phis."""

    @abstractmethod
    def failure(self, error: Text, indent: str) -> Iterator[str]:
        """The end of the function with an error."""

    @abstractmethod
    def returned(self, leaf: Leaf, indent: str) -> Iterator[str]:
        """The end of the function with its results."""

    @abstractmethod
    def loop(self, node: Loop, depth: int) -> Iterator[str]:
        """A loop, whose body ends with `loop_end`."""

    @abstractmethod
    def loop_end(self, leaf: Leaf, loop: Loop, indent: str) -> Iterator[str]:
        """The end of a loop's body: the next values of its variables."""

    @abstractmethod
    def note(self, node: Note, indent: str) -> Iterator[str]:
        """A sentence for the log."""

    @abstractmethod
    def attempt_start(self, indent: str) -> Iterator[str]:
        """The start of an attempt."""

    @abstractmethod
    def attempt_end(self, node: AttemptEnd, indent: str) -> Iterator[str]:
        """The end of an attempt, with whether it failed."""

    @abstractmethod
    def call(self, node: Call, indent: str) -> Iterator[str]:
        """A call of a traced function."""

    @abstractmethod
    def definition(self, node: Operation, indent: str) -> Iterator[str]:
        """An operation with a name for its value."""

    @abstractmethod
    def expression(self, node: Operation) -> str:
        """What an operation computes."""

    @abstractmethod
    def constant(self, value: float) -> str:
        """A constant."""

    @abstractmethod
    def call_result(self, value: Result) -> str:
        """A number that a call has returned."""

    @abstractmethod
    def side_by_side(self, group: Sequence[Any]) -> str:
        """Numbers side by side: where they already are, or copied."""
