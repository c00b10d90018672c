"""Print traced functions as C: one operation a statement, which compilers do not fuse with the next."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any

from ..trace.graph import (
    Argument,
    AttemptEnd,
    Call,
    Function,
    Leaf,
    Loop,
    LoopVariable,
    Node,
    Note,
    Operation,
    Result,
    Text,
    may_fail,
    size,
)
from ..trace.ops import OPS
from .printer import Printer, contiguous_start, printed_name, returns_array, returns_number

#: Largest number of lines of a C function that is always inlined; a convention of this kit.
MOST_INLINED_LINES = 60
#: Width of the lines of definitions; a convention of this kit.
WIDTH = 98
PACKED = re.compile(
    r" *(const double (?=n)|double (?=v\w+ =)|(?=(j\d+|v\d+_\d+|result\[\d+\]) = ))"
)
CONVERSIONS = {"Real": "%r", "Boolean": "%b"}


def declaration(function: Function) -> str:
    """The head of a C function: context, parameters, and the place for more than one result."""
    parameters = ["Context *c"]
    for name, shape in function.parameters.items():
        if shape == "number":
            parameters.append(f"double {printed_name(name)}")
        elif size(shape) or function.entry:
            parameters.append(f"const double *{printed_name(name)}")
    if returns_array(function) or (function.entry and function.shape[0] != "static"):
        parameters.append("double *result")
    returned = "double" if returns_number(function) else "void"
    return f"{returned} {function.name}({', '.join(parameters)})"


def definition(function: Function) -> str:
    """The C function."""
    lines = list(CPrinter(function).body_lines())
    kind = "INLINE" if len(lines) <= MOST_INLINED_LINES else "static inline"
    return "\n".join([f"{kind} {declaration(function)} {{", *with_fuller_lines(lines), "}\n"])


def statement_prefix(line: str) -> str | None:
    """What lines begin with that may be one statement; None for any other line."""
    match = PACKED.match(line)
    return match[0] if match else None


def with_fuller_lines(lines: Iterable[str]) -> Iterator[str]:
    """Definitions that follow each other as one statement: each stays an expression of its own."""
    for start, group in groupby(lines, statement_prefix):
        if start is None:
            yield from group
            continue
        line = ""
        for definition in group:
            more = definition.removeprefix(start)[:-1]
            if line and len(line) + len(more) > WIDTH:
                yield f"{line};"
                line = ""
            line = f"{line}, {more}" if line else start + more
        yield f"{line};"


def real(value: float) -> str:
    """A constant.

    Parameters
    ----------
    value : float
        Any double, finite or not.
    """
    if not math.isfinite(value):
        return {math.inf: "INFINITY", -math.inf: "-INFINITY"}.get(value, "NAN")
    return f"({value!r})" if math.copysign(1.0, value) < 0 else repr(value)


def wrapped(indent: str, text: str) -> Iterator[str]:
    """A long declaration in lines."""
    yield from textwrap.wrap(text, 100, initial_indent=indent, subsequent_indent=indent + "    ")


class CPrinter(Printer):
    """One function in C."""

    IF = "if ({}) {{"
    ELSE = "} else {"
    END = "}"

    def condition(self, node: Operation) -> str:
        return self.expression(node)

    def negated(self, condition: str) -> str:
        return f"!({condition})"

    def choice(self, name: str, condition: str, yes: str, no: str) -> str:
        return f"const double {name} = {condition} ? {yes} : {no};"

    def declared(self, names: Sequence[str], indent: str) -> Iterator[str]:
        if names:
            yield from wrapped(indent, f"double {', '.join(names)};")

    def assigned(self, names: Sequence[str], values: Sequence[Any], indent: str) -> Iterator[str]:
        for name, value in zip(names, values):
            yield f"{indent}{name} = {self.value(value)};"

    def failure(self, error: Text, indent: str) -> Iterator[str]:
        yield f"{indent}fail({self.text(error)});"
        yield f"{indent}{self.return_without_results()}"

    def return_without_results(self) -> str:
        """The end of a function that has failed."""
        if returns_number(self.function):
            return "return NAN;"
        count = size(self.function.shape)
        return f"fill_nan(result, {count}); return;" if count else "return;"

    def returned(self, leaf: Leaf, indent: str) -> Iterator[str]:
        if returns_number(self.function):
            yield f"{indent}return {self.value(leaf.values[0])};"
            return
        for index, value in enumerate(leaf.values):
            yield f"{indent}result[{index}] = {self.value(value)};"
        if len(indent) > 4:
            yield f"{indent}return;"

    def loop(self, node: Loop, depth: int) -> Iterator[str]:
        indent = "    " * depth
        for index, value in enumerate(node.start):
            yield f"{indent}double v{node.loop}_{index} = {self.value(value)};"
        yield f"{indent}for (;;) {{"
        yield f"{indent}    if (c->failed) {{ {self.return_without_results()} }}"
        yield from self.tree(node.body, depth + 1, node)
        yield f"{indent}}}"

    def loop_end(self, leaf: Leaf, loop: Loop, indent: str) -> Iterator[str]:
        number = loop.loop
        done, *values = leaf.values
        if isinstance(done, Node):
            yield f"{indent}const int done{number} = {self.value(done)};"

        def is_of_loop(value: Any) -> bool:
            return isinstance(value, LoopVariable) and value.loop == number

        new = {
            f"v{number}_{index}": value
            for index, value in enumerate(values)
            if not (is_of_loop(value) and value.index == index)
        }
        for name, value in new.items():
            if is_of_loop(value):
                yield f"{indent}const double next_{name} = {self.value(value)};"
        for name, value in new.items():
            yield f"{indent}{name} = {f'next_{name}' if is_of_loop(value) else self.value(value)};"
        if isinstance(done, Node):
            yield f"{indent}if (done{number}) break;"
        yield f"{indent}{'continue' if isinstance(done, Node) or not done else 'break'};"

    def note(self, node: Note, indent: str) -> Iterator[str]:
        yield f"{indent}note({self.text(node.text)});"

    def attempt_start(self, indent: str) -> Iterator[str]:
        yield f"{indent}if (c->failed) {{ {self.return_without_results()} }}"

    def attempt_end(self, node: AttemptEnd, indent: str) -> Iterator[str]:
        target = f"const int {self.name(node)} = " if node.number in self.used else ""
        yield f"{indent}{target}clear_failure(c);"

    def call(self, node: Call, indent: str) -> Iterator[str]:
        arguments = ["c", *self.arguments(node)]
        target = ""
        if returns_array(node.function):
            yield f"{indent}double {self.name(node)}[{size(node.function.shape)}];"
            arguments.append(self.name(node))
        elif node.number in self.used:
            target = f"const double {self.name(node)} = "
        yield f"{indent}{target}{node.function.name}({', '.join(arguments)});"

    def definition(self, node: Operation, indent: str) -> Iterator[str]:
        expression = self.expression(node)
        target = f"const double {self.name(node)} = " if node.number in self.used else ""
        yield f"{indent}{target}{expression};"

    def expression(self, node: Operation) -> str:
        op = OPS[node.op]
        form = op.c if may_fail(node) else op.c_unchecked
        return form.format(*map(self.value, node.operands))

    def constant(self, value: float) -> str:
        return real(float(value))

    def call_result(self, value: Result) -> str:
        name = self.names[value.call.number]
        return f"{name}[{value.index}]" if returns_array(value.call.function) else name

    def side_by_side(self, group: Sequence[Any]) -> str:
        first = contiguous_start(group)
        if first is None:
            return f"(const double[]){{{', '.join(map(self.value, group))}}}"
        name = (
            printed_name(first.name)
            if isinstance(first, Argument)
            else self.names[first.call.number]
        )
        return f"{name} + {first.index}" if first.index else name

    def text(self, text: Text) -> str:
        """A text as the arguments of the functions that print it."""
        conversions = [CONVERSIONS.get(node.type.kind, "%d") for node in text.nodes]
        pieces = [piece.replace("%", "%%") for piece in text.pieces]
        form = "".join(a + b for a, b in zip(pieces, [*conversions, ""]))
        return ", ".join(["c", json.dumps(form, ensure_ascii=False), *map(self.value, text.nodes)])
