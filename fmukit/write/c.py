"""Print traced functions as C: one operation a statement, which compilers do not fuse with the next."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from typing import Any

from ..trace.tracer import COMPARISONS, NODES, Branch, Function, Leaf, Node, Tree, size

INFIX = {"+", "-", "*", *COMPARISONS}
FAILING = {"/", "power", "modulo", "sin", "cos", "tan", "acos", "sqrt", "exp", "expm1"}
LIBM = {"sin", "cos", "tan", "acos", "atan", "atan2", "exp", "expm1"}
NAMES = {"/": "quotient", "power": "power", "modulo": "modulo"}
ALWAYS = {"call", "loop", "note", "leave if failed", "forget failure"}
SMALL = 60
MARK = re.compile("\x01(\\d+)\x02")
CONVERSIONS = {"Real": "%r", "Boolean": "%b"}


def declaration(function: Function) -> str:
    """The head of a C function: context, parameters, and the place for more than one result."""
    parameters = ["Context *c"]
    for name, shape in function.parameters.items():
        if shape == "number":
            parameters.append(f"double {name}")
        elif size(shape):
            parameters.append(f"const double *{name}")
    if has_array(function):
        parameters.append("double *result")
    returned = "double" if function.shape == "number" else "void"
    return f"{returned} {function.name}({', '.join(parameters)})"


def has_array(function: Function) -> bool:
    """Whether the caller provides the place for the results."""
    return function.shape != "number" and size(function.shape) > 0


def definition(function: Function) -> str:
    """The C function."""
    lines = list(Printer(function).lines())
    kind = "INLINE" if len(lines) <= SMALL else "static inline"
    return "\n".join([f"{kind} {declaration(function)} {{", *lines, "}\n"])


def real(value: float) -> str:
    """A constant."""
    if not math.isfinite(value):
        return {math.inf: "INFINITY", -math.inf: "-INFINITY"}.get(value, "NAN")
    return f"({value!r})" if math.copysign(1.0, value) < 0 else repr(value)


def used(node: Any) -> Iterator[Any]:
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
    elif node.op == "note":
        yield from marked(node.args[0])
    elif node.op not in ("symbol", "element", "variable"):
        yield from node.args


def marked(text: str) -> Iterator[Node]:
    """The values that stand in a text."""
    for number in MARK.findall(text):
        yield NODES[int(number)]


def needed(tree: Tree) -> Iterator[Any]:
    """What a tree cannot do without: results, conditions, texts, and what may fail or acts."""
    yield from (arg for node in tree.nodes if acts(node) for arg in used(node))
    if isinstance(tree, Branch):
        yield from tree.condition.args
        yield from needed(tree.true)
        yield from needed(tree.false)
    else:
        yield from tree.values
        yield from marked(tree.error or "")


def acts(node: Node) -> bool:
    """Whether a node does something even where its value is not used."""
    return node.op in ALWAYS or failing(node)


def failing(node: Node) -> bool:
    """Whether Python may raise here."""
    if node.op == "/":
        return isinstance(node.args[1], Node) or node.args[1] == 0.0
    return node.op in FAILING


def in_place(group: list[Any]) -> Node | None:
    """The first of numbers that already stand side by side: in a parameter, or in a result."""
    first = group[0] if group else None
    if not isinstance(first, Node) or first.op not in ("element", "result"):
        return None
    base, place = first.args
    row = [(first.op, (base, place + offset)) for offset in range(len(group))]
    is_array = first.op == "element" or has_array(NODES[base].args[0])
    found = [(getattr(v, "op", ""), getattr(v, "args", ())) for v in group]
    return first if is_array and row == found else None


def parameter(node: Node) -> str | None:
    """A number that a function has been given, or carries through a loop; None for any other."""
    if node.op == "symbol":
        return str(node.args[0])
    if node.op == "element":
        return f"{node.args[0]}[{node.args[1]}]"
    return f"v{node.args[0]}_{node.args[1]}" if node.op == "variable" else None


class Printer:
    """One function in C."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self.names: dict[int, str] = {}
        self.used: set[int] = set()
        waiting = list(needed(function.tree))
        seen: set[int] = set()
        while waiting:
            value = waiting.pop()
            if isinstance(value, Node):
                self.used.add(value.number)
            if isinstance(value, Node) and value.number not in seen:
                seen.add(value.number)
                waiting += used(value)

    def lines(self) -> Iterator[str]:
        yield from self.tree(self.function.tree, 1, None)

    def tree(self, tree: Tree, depth: int, loop: Node | None) -> Iterator[str]:
        indent = "    " * depth
        for node in tree.nodes:
            if node.number in self.used or acts(node):
                yield from self.statement(node, depth)
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
            yield from self.turn(tree, loop, indent)
        else:
            yield from self.returned(tree, indent)

    def leave(self) -> str:
        if self.function.shape == "number":
            return "return NAN;"
        count = size(self.function.shape)
        return f"spoil(result, {count}); return;" if count else "return;"

    def returned(self, leaf: Leaf, indent: str) -> Iterator[str]:
        if self.function.shape == "number":
            yield f"{indent}return {self.value(leaf.values[0])};"
            return
        for place, value in enumerate(leaf.values):
            yield f"{indent}result[{place}] = {self.value(value)};"
        yield f"{indent}return;"

    def turn(self, leaf: Leaf, loop: Node, indent: str) -> Iterator[str]:
        """The end of a loop's body: the next values of its variables."""
        number = loop.args[0]
        done, *values = leaf.values
        new = {
            f"v{number}_{place}": value
            for place, value in enumerate(values)
            if not (
                isinstance(value, Node) and value.op == "variable" and value.args == (number, place)
            )
        }
        for name, value in new.items():
            if isinstance(value, Node) and value.op == "variable" and value.args[0] == number:
                yield f"{indent}const double next_{name} = {self.value(value)};"
        for name, value in new.items():
            moved = isinstance(value, Node) and value.op == "variable" and value.args[0] == number
            yield f"{indent}{name} = {f'next_{name}' if moved else self.value(value)};"
        yield f"{indent}{'break' if done else 'continue'};"

    def statement(self, node: Node, depth: int) -> Iterator[str]:
        indent = "    " * depth
        if node.op == "note":
            yield f"{indent}note({self.text(node.args[0])});"
        elif node.op == "leave if failed":
            yield f"{indent}if (c->failed) {{ {self.leave()} }}"
        elif node.op == "loop":
            number, start, body = node.args
            for place, value in enumerate(start):
                yield f"{indent}double v{number}_{place} = {self.value(value)};"
            yield f"{indent}for (;;) {{"
            yield f"{indent}    if (c->failed) {{ {self.leave()} }}"
            yield from self.tree(body, depth + 1, node)
            yield f"{indent}}}"
        elif node.op == "call":
            yield from self.call(node, indent)
        else:
            expression = self.expression(node)
            kind = "int" if node.op == "forget failure" else "double"
            target = f"const {kind} {self.name(node)} = " if node.number in self.used else ""
            yield f"{indent}{target}{expression};"

    def name(self, node: Node) -> str:
        """The name of a node in C."""
        return self.names.setdefault(node.number, f"n{len(self.names)}")

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
        first = in_place(group)
        if first is not None:
            base, place = first.args
            name = str(base) if first.op == "element" else self.names[base]
            return f"{name} + {place}" if place else name
        return f"(const double[]){{{', '.join(map(self.value, group))}}}"

    def value(self, value: Any) -> str:
        """A number where it is used."""
        if not isinstance(value, Node):
            return real(float(value))
        given = parameter(value)
        if given is not None:
            return given
        if value.op == "result":
            call, place = value.args
            is_array = has_array(NODES[call].args[0])
            return f"{self.names[call]}[{place}]" if is_array else self.names[call]
        if value.op in COMPARISONS:
            return f"({self.comparison(value)})"
        return self.names[value.number]

    def comparison(self, node: Node) -> str:
        left, right = map(self.value, node.args)
        return f"{left} {node.op} {right}"

    def expression(self, node: Node) -> str:
        """What a node computes."""
        if node.op == "forget failure":
            return "forget(c)"
        values = [self.value(arg) for arg in node.args]
        if node.op == "select":
            return f"{values[0]} ? {values[2]} : {values[1]}"
        if node.op in INFIX or (node.op == "/" and not failing(node)):
            return f"{values[0]} {node.op} {values[1]}"
        if node.op == "neg":
            return f"-{values[0]}"
        if node.op in LIBM:
            called = f"libm_{node.op}({', '.join(values)})"
            return f"checked(c, {values[0]}, {called})" if len(values) == 1 else called
        if node.op == "sqrt":
            return f"checked(c, {values[0]}, sqrt({values[0]}))"
        if node.op == "fabs":
            return f"fabs({values[0]})"
        return f"{NAMES[node.op]}(c, {', '.join(values)})"

    def text(self, text: str) -> str:
        """A text as the arguments of the functions that print it."""
        values = [self.value(node) for node in marked(text)]
        form = text.replace("%", "%%")
        form = MARK.sub(lambda m: CONVERSIONS.get(NODES[int(m[1])].kind, "%d"), form)
        return ", ".join(["c", json.dumps(form, ensure_ascii=False), *values])
