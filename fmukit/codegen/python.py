"""Print traced functions as Python: straight lines of local floats, for the FMU that needs Python."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any

from ..trace.graph import (
    COMPARISONS,
    MARK,
    NODES,
    Branch,
    Function,
    Leaf,
    Node,
    Tree,
    Untraceable,
    ancestors,
    has_effect,
    joins_of,
    needed,
    nodes_in_text,
    size,
)
from .c import contiguous_start, has_array
from .names import parameter_name, printed_name

HEAD = """
from math import acos, acosh, asin, asinh, atan, atan2, atanh, ceil, copysign, cos, cosh, erf, erfc
from math import exp, expm1, floor, fmod, inf, log, log1p, log2, log10, nan, pow, sin, sinh, sqrt
from math import tan, tanh, trunc

"""
INFIX = {"+", "-", "*", "/", "power", "modulo", "floordiv", *COMPARISONS}
SIGNS = {"power": "**", "modulo": "%", "floordiv": "//", "fabs": "abs"}
ROUNDING = {"floor", "ceil", "trunc"}
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
            wanted |= {node.args[0].name for node in calls(function.tree)}
    needed_functions = [function for function in functions if function.name in wanted]
    return HEAD + "\n\n".join(definition(function) for function in needed_functions)


def calls(tree: Tree) -> Iterator[Node]:
    """All calls in a tree."""
    for node in tree.nodes:
        if node.op == "call":
            yield node
        elif node.op in ("loop", "join"):
            for part in node.args[1:3] if node.op == "join" else node.args[2:]:
                yield from calls(part)
    if isinstance(tree, Branch):
        yield from calls(tree.true)
        yield from calls(tree.false)


def definition(function: Function) -> str:
    names = [n for n, shape in function.parameters.items() if size(shape) or function.entry]
    parameters = map(printed_name, names)
    head = f"def {function.name}({', '.join(['note', *parameters])}):"
    draft = Printer(function, frozenset())
    deque(draft.tree(function.tree, 1, None), maxlen=0)
    return "\n".join([head, *Printer(function, draft.read_once()).tree(function.tree, 1, None), ""])


def real(value: float) -> str:
    if not math.isfinite(value):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan")
    return repr(float(value))


class Printer:
    """One function in Python; `nested` are the nodes that stand where they are read, without a name."""

    def __init__(self, function: Function, nested: frozenset[int]) -> None:
        self.function, self.nested = function, nested
        self.names: dict[int, str] = {}
        self.trying = False
        self.block = 0
        self.block_of_node: dict[int, int] = {}
        self.readers: dict[int, list[int]] = {}
        self.used = ancestors(needed(function.tree), joins_of(function.tree))

    def nodes(self, nodes: list[Node], depth: int, block: int) -> Iterator[str]:
        for node in nodes:
            self.block = self.block_of_node[node.number] = block
            text = f"({self.expression(node)})" if node.number in self.nested else ""
            if 0 < len(text) < LONGEST_NESTED:
                self.names[node.number] = text
            elif node.number in self.used or has_effect(node) or self.used_phis(node):
                yield from self.statement(node, depth)
        self.block = block

    def used_phis(self, node: Node) -> list[tuple[Node, int]]:
        """The values that a join hands on to where they are used, with their places."""
        phis = node.args[3] if node.op == "join" else ()
        return [(phi, index) for index, phi in enumerate(phis) if phi.number in self.used]

    def tree(self, tree: Tree, depth: int, loop: Node | None) -> Iterator[str]:
        yield from self.nodes(tree.nodes, depth, id(tree))
        if self.trying:
            raise Untraceable("a condition within what is attempted")
        indent = "    " * depth
        if isinstance(tree, Branch):
            condition, short, long = self.value(tree.condition), tree.true, tree.false
            if isinstance(long, Leaf) and isinstance(short, Branch):
                condition, short, long = f"not {condition}", long, short
            yield f"{indent}if {condition}:"
            yield from self.tree(short, depth + 1, loop)
            yield from self.tree(long, depth, loop)
        elif tree.error is not None:
            yield f"{indent}raise ValueError({self.text(tree.error)})"
        elif loop is not None:
            yield from self.loop_end(tree, loop, indent)
        elif has_array(self.function) or not tree.values:
            yield f"{indent}return {self.array(tree.values)}"
        else:
            yield f"{indent}return {self.value(tree.values[0])}"

    def read_once(self) -> frozenset[int]:
        """The nodes, of those printed, that are only read once, and on the path that computes them."""
        return frozenset(
            number
            for number, blocks in self.readers.items()
            if NODES[number].op in NESTED and blocks == [self.block_of_node[number]]
        )

    def loop_end(self, leaf: Leaf, loop: Node, indent: str) -> Iterator[str]:
        """The end of a loop's body: the next values of its variables."""
        done, *values = leaf.values
        old = [f"v{loop.args[0]}_{index}" for index in range(len(values))]
        moves = {
            name: new for name, value in zip(old, values) if (new := self.value(value)) != name
        }
        if isinstance(done, Node):
            moves["done"] = self.value(done)
        if moves:
            yield f"{indent}{', '.join(moves)} = {', '.join(moves.values())}"
        if isinstance(done, Node):
            yield f"{indent}if done:"
            yield f"{indent}    break"
        yield f"{indent}{'continue' if isinstance(done, Node) or not done else 'break'}"

    def join(self, node: Node, depth: int) -> Iterator[str]:
        """A condition, and what either arm hands on."""
        indent = "    " * depth
        condition, used_phis, block = self.value(node.args[0]), self.used_phis(node), self.block
        true, false = node.args[1:3]
        names = [self.name(phi, "j") for phi, _ in used_phis]
        if not true.nodes and not false.nodes and true.error is false.error is None:
            for name, (_, index) in zip(names, used_phis):
                yes, no = self.value(true.values[index]), self.value(false.values[index])
                yield f"{indent}{name} = {yes} if {condition} else {no}"
            return
        arms = [list(self.arm(arm, names, used_phis, depth + 1)) for arm in (true, false)]
        self.block = block
        if not arms[0]:
            condition, arms = f"not {condition}", arms[::-1]
        yield f"{indent}if {condition}:"
        yield from arms[0]
        if arms[1]:
            yield f"{indent}else:"
            yield from arms[1]

    def arm(
        self, arm: Leaf, names: list[str], used_phis: list[tuple[Node, int]], depth: int
    ) -> Iterator[str]:
        """One arm of a join."""
        indent = "    " * depth
        yield from self.nodes(arm.nodes, depth, id(arm))
        if arm.error is not None:
            yield f"{indent}raise ValueError({self.text(arm.error)})"
            return
        if names:
            values = ", ".join(self.value(arm.values[index]) for _, index in used_phis)
            yield f"{indent}{', '.join(names)} = {values}"

    def statement(self, node: Node, depth: int) -> Iterator[str]:
        indent = "    " * (depth + self.trying)
        if node.op == "note":
            yield f"{indent}note({self.text(node.args[0])})"
        elif node.op == "leave if failed":
            yield f"{indent}try:"
            self.trying = True
        elif node.op == "forget failure":
            self.trying = False
            yield f"{indent}{self.name(node)} = False"
            yield f"{indent[4:]}except (ArithmeticError, ValueError):"
            yield f"{indent}{self.name(node)} = True"
        elif node.op == "loop":
            number, start, body = node.args
            for index, value in enumerate(start):
                yield f"{indent}v{number}_{index} = {self.value(value)}"
            yield f"{indent}while True:"
            yield from self.tree(body, depth + 1, node)
        elif node.op == "call":
            yield f"{indent}{self.call(node)}"
        elif node.op == "join":
            yield from self.join(node, depth + self.trying)
        else:
            yield f"{indent}{self.name(node)} = {self.expression(node)}"

    def name(self, node: Node, letter: str = "n") -> str:
        return self.names.setdefault(node.number, f"{letter}{len(self.names)}")

    def call(self, node: Node) -> str:
        traced, groups = node.args
        shapes = [shape for shape in traced.parameters.values() if size(shape)]
        arguments = ["note"]
        for shape, group in zip(shapes, groups, strict=True):
            arguments.append(self.value(group[0]) if shape == "number" else self.array(group))
        name, count = self.name(node), size(traced.shape)
        parts = [f"{name}_{index}" for index in range(count)]
        small = has_array(traced) and count <= MOST_LOCAL_RESULTS
        target = f"{', '.join(parts)}, = {name}" if small else name
        return f"{target} = {traced.name}({', '.join(arguments)})"

    def array(self, group: list[Any]) -> str:
        """Numbers side by side: where they already are, or as a new tuple."""
        first = contiguous_start(group)
        if first is not None:
            base, index = first.args
            if first.op == "result":
                name, shape = self.names[base], NODES[base].args[0].shape
            else:
                name, shape = printed_name(base), self.function.parameters[base]
            is_complete = shape is not None and size(shape) == len(group)
            return name if is_complete else f"{name}[{index}:{index + len(group)}]"
        return f"({''.join(f'{self.value(value)}, ' for value in group)})"

    def value(self, value: Any) -> str:
        """A number where it is used."""
        if not isinstance(value, Node):
            return real(value)
        name = parameter_name(value)
        if name is not None:
            return name
        if value.op == "result":
            call, index = value.args
            traced, name = NODES[call].args[0], self.names[call]
            if not has_array(traced):
                return name
            return (
                f"{name}_{index}"
                if size(traced.shape) <= MOST_LOCAL_RESULTS
                else f"{name}[{index}]"
            )
        if value.op in COMPARISONS:
            return f"({self.expression(value)})"
        self.readers.setdefault(value.number, []).append(self.block)
        return self.names[value.number]

    def expression(self, node: Node) -> str:
        """What a node computes."""
        values = [self.value(arg) for arg in node.args]
        sign = SIGNS.get(node.op, node.op)
        if node.op == "select":
            return f"{values[2]} if {values[0]} else {values[1]}"
        if node.op in INFIX:
            return f"{values[0]} {sign} {values[1]}"
        if node.op == "neg":
            return f"-{values[0]}"
        if node.op in ROUNDING:
            return f"float({sign}({values[0]}))"
        return f"{sign}({', '.join(values)})"

    def text(self, text: str) -> str:
        """A text with its values, as an f-string."""
        types = {"Real": "", "Boolean": "bool"}
        form = repr(text.replace("{", "{{").replace("}", "}}"))
        values = iter(list(nodes_in_text(text)))

        def written(_: Any) -> str:
            node = next(values)
            return f"{{{types.get(node.kind, 'int')}({self.value(node)})!r}}"

        return "f" + MARK.sub(written, form.replace("\\x01", "\x01").replace("\\x02", "\x02"))
