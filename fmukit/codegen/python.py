"""Print traced functions as Python: straight lines of local floats, for the FMU that needs Python."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from ..trace.graph import (
    AttemptEnd,
    Call,
    Function,
    Leaf,
    Loop,
    Node,
    Note,
    Operation,
    Result,
    Text,
    UntraceableError,
    nodes_in,
    size,
)
from ..trace.ops import OPS
from .printer import Printer, contiguous_start, printed_name, returns_array

#: Functions in the `python` column of the table that need no import.
BUILT_IN = {"abs", "float"}


def imports() -> str:
    """The import of all functions of `math` that the table names, and of what constants are written with."""
    called = {name for op in OPS.values() for name in re.findall(r"(\w+)\(", op.python)}
    names = ", ".join(sorted(called - BUILT_IN | {"inf", "nan"}))
    return f"\nfrom math import ({names})\n\n"


#: Operations that are written where they are read: those that Python evaluates without a call.
NESTED = {"+", "-", "*", "neg"}
#: Largest number of results of a call that become local variables; a convention of this kit.
MOST_LOCAL_RESULTS = 8
#: Limit of the length of an expression that stands where it is read; a convention of this kit.
LONGEST_NESTED = 300


def module(functions: list[Function], entries: tuple[str, ...]) -> str:
    """A module with these entries and all that they call; each takes `note` first."""
    wanted = set(entries)
    for function in reversed(functions):
        if function.name in wanted:
            wanted |= {n.function.name for n in nodes_in(function.tree) if isinstance(n, Call)}
    needed_functions = [function for function in functions if function.name in wanted]
    return imports() + "\n\n".join(definition(function) for function in needed_functions)


def definition(function: Function) -> str:
    """A function in Python, printed twice: only the first print shows what is read once."""
    names = [n for n, shape in function.parameters.items() if size(shape) or function.entry]
    parameters = map(printed_name, names)
    head = f"def {function.name}({', '.join(['note', *parameters])}):"
    draft = PythonPrinter(function, frozenset())
    deque(draft.body_lines(), maxlen=0)
    return "\n".join([head, *PythonPrinter(function, draft.read_once()).body_lines(), ""])


def real(value: float) -> str:
    """Write the `value` of a double, finite or not, as the names that the module imports."""
    if not math.isfinite(value):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan")
    return repr(float(value))


class PythonPrinter(Printer):
    """One function in Python; `nested` are the nodes that stand where they are read, without a name."""

    IF = "if {}:"
    ELSE = "else:"
    END = ""

    def __init__(self, function: Function, nested: frozenset[int]) -> None:
        super().__init__(function)
        self.nested = nested
        self.trying = False
        self.block_of_node: dict[int, int] = {}
        self.nestable: set[int] = set()
        self.readers: dict[int, list[int]] = {}

    def try_to_nest(self, node: Node) -> bool:
        self.block_of_node[node.number] = self.block
        if not isinstance(node, Operation):
            return False
        self.nestable |= {node.number} if node.op in NESTED else set()
        if node.number not in self.nested:
            return False
        text = f"({self.expression(node)})"
        if len(text) < LONGEST_NESTED:
            self.names[node.number] = text
        return len(text) < LONGEST_NESTED

    def read_once(self) -> frozenset[int]:
        """The nodes, of those printed, that are only read once, and on the path that computes them."""
        return frozenset(
            number
            for number, blocks in self.readers.items()
            if number in self.nestable and blocks == [self.block_of_node[number]]
        )

    def depth_of_statement(self, depth: int) -> int:
        return depth + self.trying

    def require_no_attempt(self) -> None:
        if self.trying:
            raise UntraceableError("a condition within what is attempted")

    def condition(self, node: Operation) -> str:
        return self.value(node)

    def negated(self, condition: str) -> str:
        return f"not {condition}"

    def choice(self, name: str, condition: str, yes: str, no: str) -> str:
        return f"{name} = {yes} if {condition} else {no}"

    def assigned(self, names: Sequence[str], values: Sequence[Any], indent: str) -> Iterator[str]:
        yield f"{indent}{', '.join(names)} = {', '.join(map(self.value, values))}"

    def failure(self, error: Text, indent: str) -> Iterator[str]:
        yield f"{indent}raise ValueError({self.text(error)})"

    def returned(self, leaf: Leaf, indent: str) -> Iterator[str]:
        is_tuple = returns_array(self.function) or not leaf.values
        value = self.side_by_side(leaf.values) if is_tuple else self.value(leaf.values[0])
        yield f"{indent}return {value}"

    def loop(self, node: Loop, depth: int) -> Iterator[str]:
        indent = "    " * self.depth_of_statement(depth)
        for index, value in enumerate(node.start):
            yield f"{indent}v{node.loop}_{index} = {self.value(value)}"
        yield f"{indent}while True:"
        yield from self.tree(node.body, depth + 1, node)

    def loop_end(self, leaf: Leaf, loop: Loop, indent: str) -> Iterator[str]:
        done, *values = leaf.values
        names = [f"v{loop.loop}_{index}" for index in range(len(values))]
        moves = {
            name: new for name, value in zip(names, values) if (new := self.value(value)) != name
        }
        if isinstance(done, Node):
            moves["done"] = self.value(done)
        if moves:
            yield f"{indent}{', '.join(moves)} = {', '.join(moves.values())}"
        if isinstance(done, Node):
            yield f"{indent}if done:"
            yield f"{indent}    break"
        yield f"{indent}{'continue' if isinstance(done, Node) or not done else 'break'}"

    def note(self, node: Note, indent: str) -> Iterator[str]:
        yield f"{indent}note({self.text(node.text)})"

    def attempt_start(self, indent: str) -> Iterator[str]:
        yield f"{indent}try:"
        self.trying = True

    def attempt_end(self, node: AttemptEnd, indent: str) -> Iterator[str]:
        self.trying = False
        yield f"{indent}{self.name(node)} = False"
        yield f"{indent[4:]}except (ArithmeticError, ValueError):"
        yield f"{indent}{self.name(node)} = True"

    def call(self, node: Call, indent: str) -> Iterator[str]:
        arguments = ", ".join(["note", *self.arguments(node)])
        name, count = self.name(node), size(node.function.shape)
        parts = [f"{name}_{index}" for index in range(count)]
        has_locals = returns_array(node.function) and count <= MOST_LOCAL_RESULTS
        target = f"{', '.join(parts)}, = {name}" if has_locals else name
        yield f"{indent}{target} = {node.function.name}({arguments})"

    def definition(self, node: Operation, indent: str) -> Iterator[str]:
        yield f"{indent}{self.name(node)} = {self.expression(node)}"

    def expression(self, node: Operation) -> str:
        return OPS[node.op].python.format(*map(self.value, node.operands))

    def value(self, value: Any) -> str:
        text = super().value(value)
        if isinstance(value, Node) and self.names.get(value.number) == text:
            self.readers.setdefault(value.number, []).append(self.block)
        return text

    def constant(self, value: float) -> str:
        return real(value)

    def call_result(self, value: Result) -> str:
        traced, name = value.call.function, self.names[value.call.number]
        if not returns_array(traced):
            return name
        has_locals = size(traced.shape) <= MOST_LOCAL_RESULTS
        return f"{name}_{value.index}" if has_locals else f"{name}[{value.index}]"

    def side_by_side(self, group: Sequence[Any]) -> str:
        first = contiguous_start(group)
        if first is None:
            return f"({''.join(f'{self.value(value)}, ' for value in group)})"
        if isinstance(first, Result):
            name, shape = self.names[first.call.number], first.call.function.shape
        else:
            name, shape = printed_name(first.name), self.function.parameters[first.name]
        start = first.index or 0
        is_complete = shape is not None and size(shape) == len(group)
        return name if is_complete else f"{name}[{start}:{start + len(group)}]"

    def text(self, text: Text) -> str:
        """A text with its values, as an f-string."""
        types = {"Real": "", "Boolean": "bool"}
        pieces = [piece.replace("{", "{{").replace("}", "}}") for piece in text.pieces]
        values = [f"{types.get(node.type.kind, 'int')}({self.value(node)})" for node in text.nodes]
        # the quotes of the f-string are those that repr chooses for all pieces together
        form = repr("\x01".join(pieces)).split("\\x01")
        return "f" + "".join(a + b for a, b in zip(form, [*(f"{{{v}!r}}" for v in values), ""]))
