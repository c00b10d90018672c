"""Print traced functions as C: one operation a statement, which compilers do not fuse with the next."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any

from ..trace.graph import (
    COMPARISONS,
    FAILING,
    MARK,
    NODES,
    Branch,
    Function,
    Leaf,
    Node,
    Tree,
    ancestors,
    has_effect,
    joins_of,
    may_fail,
    needed,
    nodes_in_text,
    size,
)
from .names import parameter_name, printed_name

INFIX = {"+", "-", "*", *COMPARISONS}
POINTERS = {
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh",
    "atanh", "exp", "expm1", "log", "log10", "log2", "log1p", "erf", "erfc",
}  # fmt: skip
OVERFLOWING = {"cosh", "sinh", "exp", "expm1"}
NAMES = {
    "/": "quotient", "power": "power", "pow": "math_pow", "modulo": "modulo", "fmod": "math_fmod",
    "floordiv": "floor_quotient", "floor": "checked_integer", "ceil": "checked_integer", "trunc": "checked_integer",
}  # fmt: skip
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
    if has_array(function) or (function.entry and not is_static(function.shape)):
        parameters.append("double *result")
    returned = "double" if is_number(function) else "void"
    return f"{returned} {function.name}({', '.join(parameters)})"


def has_array(function: Function) -> bool:
    """Whether the caller provides the place for the results."""
    return size(function.shape) > 0 and not is_number(function)


def is_number(function: Function) -> bool:
    """Whether the function returns its one result."""
    return size(function.shape) == 1 and not function.entry


def is_static(shape: Any) -> bool:
    """Whether this is the shape of None or of another single thing."""
    return bool(shape != "number" and shape[0] == "static")


def definition(function: Function) -> str:
    """The C function."""
    lines = list(Printer(function).lines())
    kind = "INLINE" if len(lines) <= MOST_INLINED_LINES else "static inline"
    return "\n".join([f"{kind} {declaration(function)} {{", *packed(lines), "}\n"])


def statement_prefix(line: str) -> str | None:
    """What lines begin with that may be one statement; None for any other line."""
    match = PACKED.match(line)
    return match[0] if match else None


def packed(lines: Iterable[str]) -> Iterator[str]:
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
    """A constant."""
    if not math.isfinite(value):
        return {math.inf: "INFINITY", -math.inf: "-INFINITY"}.get(value, "NAN")
    return f"({value!r})" if math.copysign(1.0, value) < 0 else repr(value)


def contiguous_start(group: list[Any]) -> Node | None:
    """The first of numbers that already stand side by side: in a parameter, or in a result."""
    first = group[0] if group else None
    if not isinstance(first, Node) or first.op not in ("element", "result"):
        return None
    base, index = first.args
    row = [(first.op, (base, index + offset)) for offset in range(len(group))]
    is_array = first.op == "element" or has_array(NODES[base].args[0])
    operands = [(getattr(v, "op", ""), getattr(v, "args", ())) for v in group]
    return first if is_array and row == operands else None


def wrapped(indent: str, text: str) -> Iterator[str]:
    """A long declaration in lines."""
    yield from textwrap.wrap(text, 100, initial_indent=indent, subsequent_indent=indent + "    ")


class Printer:
    """One function in C."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self.names: dict[int, str] = {}
        self.used = ancestors(needed(function.tree), joins_of(function.tree))

    def lines(self) -> Iterator[str]:
        yield from self.tree(self.function.tree, 1, None)

    def nodes(self, nodes: list[Node], depth: int) -> Iterator[str]:
        for node in nodes:
            if node.number in self.used or has_effect(node) or self.used_phis(node):
                yield from self.statement(node, depth)

    def used_phis(self, node: Node) -> list[tuple[Node, int]]:
        """The values that a join hands on to where they are used, with their places."""
        phis = node.args[3] if node.op == "join" else ()
        return [(phi, index) for index, phi in enumerate(phis) if phi.number in self.used]

    def tree(self, tree: Tree, depth: int, loop: Node | None) -> Iterator[str]:
        indent = "    " * depth
        yield from self.nodes(tree.nodes, depth)
        if isinstance(tree, Branch):
            condition, short, long = self.comparison(tree.condition), tree.true, tree.false
            if isinstance(long, Leaf) and isinstance(short, Branch):
                condition, short, long = f"!({condition})", long, short
            yield f"{indent}if ({condition}) {{"
            yield from self.tree(short, depth + 1, loop)
            yield f"{indent}}}"
            yield from self.tree(long, depth, loop)
        elif tree.error is not None:
            yield f"{indent}fail({self.text(tree.error)});"
            yield f"{indent}{self.leave()}"
        elif loop is not None:
            yield from self.loop_end(tree, loop, indent)
        else:
            yield from self.returned(tree, indent)

    def leave(self) -> str:
        if is_number(self.function):
            return "return NAN;"
        count = size(self.function.shape)
        return f"fill_nan(result, {count}); return;" if count else "return;"

    def returned(self, leaf: Leaf, indent: str) -> Iterator[str]:
        if is_number(self.function):
            yield f"{indent}return {self.value(leaf.values[0])};"
            return
        for index, value in enumerate(leaf.values):
            yield f"{indent}result[{index}] = {self.value(value)};"
        if len(indent) > 4:
            yield f"{indent}return;"

    def loop_end(self, leaf: Leaf, loop: Node, indent: str) -> Iterator[str]:
        """The end of a loop's body: the next values of its variables."""
        number = loop.args[0]
        done, *values = leaf.values
        if isinstance(done, Node):
            yield f"{indent}const int done{number} = {self.value(done)};"
        new = {
            f"v{number}_{index}": value
            for index, value in enumerate(values)
            if not (
                isinstance(value, Node) and value.op == "variable" and value.args == (number, index)
            )
        }
        for name, value in new.items():
            if isinstance(value, Node) and value.op == "variable" and value.args[0] == number:
                yield f"{indent}const double next_{name} = {self.value(value)};"
        for name, value in new.items():
            is_carried = (
                isinstance(value, Node) and value.op == "variable" and value.args[0] == number
            )
            yield f"{indent}{name} = {f'next_{name}' if is_carried else self.value(value)};"
        if isinstance(done, Node):
            yield f"{indent}if (done{number}) break;"
        yield f"{indent}{'continue' if isinstance(done, Node) or not done else 'break'};"

    def join(self, node: Node, depth: int) -> Iterator[str]:
        """A condition, and what either arm hands on."""
        indent = "    " * depth
        condition, used_phis = self.comparison(node.args[0]), self.used_phis(node)
        true, false = node.args[1:3]
        names = [self.name(phi, "j") for phi, _ in used_phis]
        if not true.nodes and not false.nodes and true.error is false.error is None:
            for name, (_, index) in zip(names, used_phis):
                yes, no = self.value(true.values[index]), self.value(false.values[index])
                yield f"{indent}const double {name} = {condition} ? {yes} : {no};"
            return
        if names:
            yield from wrapped(indent, f"double {', '.join(names)};")
        arms = [list(self.arm(arm, names, used_phis, depth + 1)) for arm in (true, false)]
        if not arms[0]:
            condition, arms = f"!({condition})", arms[::-1]
        yield f"{indent}if ({condition}) {{"
        yield from arms[0]
        if arms[1]:
            yield f"{indent}}} else {{"
            yield from arms[1]
        yield f"{indent}}}"

    def arm(
        self, arm: Leaf, names: list[str], used_phis: list[tuple[Node, int]], depth: int
    ) -> Iterator[str]:
        """One arm of a join."""
        indent = "    " * depth
        yield from self.nodes(arm.nodes, depth)
        if arm.error is not None:
            yield f"{indent}fail({self.text(arm.error)});"
            yield f"{indent}{self.leave()}"
            return
        for name, (_, index) in zip(names, used_phis):
            yield f"{indent}{name} = {self.value(arm.values[index])};"

    def statement(self, node: Node, depth: int) -> Iterator[str]:
        indent = "    " * depth
        if node.op == "note":
            yield f"{indent}note({self.text(node.args[0])});"
        elif node.op == "leave if failed":
            yield f"{indent}if (c->failed) {{ {self.leave()} }}"
        elif node.op == "loop":
            number, start, body = node.args
            for index, value in enumerate(start):
                yield f"{indent}double v{number}_{index} = {self.value(value)};"
            yield f"{indent}for (;;) {{"
            yield f"{indent}    if (c->failed) {{ {self.leave()} }}"
            yield from self.tree(body, depth + 1, node)
            yield f"{indent}}}"
        elif node.op == "call":
            yield from self.call(node, indent)
        elif node.op == "join":
            yield from self.join(node, depth)
        else:
            expression = self.expression(node)
            kind = "int" if node.op == "forget failure" else "double"
            target = f"const {kind} {self.name(node)} = " if node.number in self.used else ""
            yield f"{indent}{target}{expression};"

    def name(self, node: Node, letter: str = "n") -> str:
        """The name of a node in C."""
        return self.names.setdefault(node.number, f"{letter}{len(self.names)}")

    def call(self, node: Node, indent: str) -> Iterator[str]:
        traced, groups = node.args
        shapes = [shape for shape in traced.parameters.values() if size(shape)]
        arguments = ["c"]
        for shape, group in zip(shapes, groups, strict=True):
            arguments.append(self.value(group[0]) if shape == "number" else self.array(group))
        target = ""
        if has_array(traced):
            yield f"{indent}double {self.name(node)}[{size(traced.shape)}];"
            arguments.append(self.name(node))
        elif node.number in self.used:
            target = f"const double {self.name(node)} = "
        yield f"{indent}{target}{traced.name}({', '.join(arguments)});"

    def array(self, group: list[Any]) -> str:
        """Numbers side by side: where they already are, or copied."""
        first = contiguous_start(group)
        if first is not None:
            base, index = first.args
            name = printed_name(base) if first.op == "element" else self.names[base]
            return f"{name} + {index}" if index else name
        return f"(const double[]){{{', '.join(map(self.value, group))}}}"

    def value(self, value: Any) -> str:
        """A number where it is used."""
        if not isinstance(value, Node):
            return real(float(value))
        name = parameter_name(value)
        if name is not None:
            return name
        if value.op == "result":
            call, index = value.args
            is_array = has_array(NODES[call].args[0])
            return f"{self.names[call]}[{index}]" if is_array else self.names[call]
        if value.op in COMPARISONS:
            return f"({self.comparison(value)})"
        return self.names[value.number]

    def comparison(self, node: Node) -> str:
        left, right = map(self.value, node.args)
        return f"{left} {node.op} {right}"

    def expression(self, node: Node) -> str:
        """What a node computes."""
        if node.op == "forget failure":
            return "clear_failure(c)"
        values = [self.value(arg) for arg in node.args]
        if node.op == "select":
            return f"{values[0]} ? {values[2]} : {values[1]}"
        if node.op in INFIX or (node.op == "/" and not may_fail(node)):
            return f"{values[0]} {node.op} {values[1]}"
        if node.op == "neg":
            return f"-{values[0]}"
        if node.op in POINTERS or node.op == "sqrt":
            called = f"{'' if node.op == 'sqrt' else 'libm_'}{node.op}({', '.join(values)})"
            if node.op not in FAILING:
                return called
            check = "checked" if node.op in OVERFLOWING else "defined"
            return f"{check}(c, {values[0]}, {called})"
        if node.op == "copysign":
            return f"copysign({', '.join(values)})"
        if NAMES.get(node.op) == "checked_integer":
            return f"checked_integer(c, {values[0]}, {node.op}({values[0]}))"
        if node.op == "fabs":
            return f"fabs({values[0]})"
        return f"{NAMES[node.op]}(c, {', '.join(values)})"

    def text(self, text: str) -> str:
        """A text as the arguments of the functions that print it."""
        values = [self.value(node) for node in nodes_in_text(text)]
        form = text.replace("%", "%%")
        form = MARK.sub(lambda m: CONVERSIONS.get(NODES[int(m[1])].kind, "%d"), form)
        return ", ".join(["c", json.dumps(form, ensure_ascii=False), *values])
