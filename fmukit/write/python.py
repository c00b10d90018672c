"""Print traced functions as Python: straight lines of local floats, for the FMU that needs Python."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any

from ..trace.tracer import COMPARISONS, NODES, Branch, Function, Leaf, Node, Tree, Untraceable, size
from .c import MARK, acts, has_array, in_place, marked, needed, parameter, used

HEAD = '''"""The step of a component in straight lines, written by build_fmus.py from its equations."""

from math import acos, atan, atan2, cos, exp, expm1, inf, nan, sin, sqrt, tan

'''
INFIX = {"+", "-", "*", "/", *COMPARISONS} | {"power", "modulo"}
SIGNS = {"power": "**", "modulo": "%", "fabs": "abs"}
NESTED = {"+", "-", "*", "neg"}
SMALL, LONG = 8, 300


def module(functions: list[Function], entries: tuple[str, ...]) -> str:
    """A module with these entries and all that they call; each takes `note` first."""
    wanted = set(entries)
    for function in reversed(functions):
        if function.name in wanted:
            wanted |= {node.args[0].name for node in calls(function.tree)}
    kept = [function for function in functions if function.name in wanted]
    return HEAD + "\n\n".join(definition(function) for function in kept)


def calls(tree: Tree) -> Iterator[Node]:
    """All calls in a tree."""
    for node in tree.nodes:
        if node.op == "call":
            yield node
        elif node.op == "loop":
            yield from calls(node.args[2])
    if isinstance(tree, Branch):
        yield from calls(tree.true)
        yield from calls(tree.false)


def definition(function: Function) -> str:
    parameters = [name for name, shape in function.parameters.items() if size(shape)]
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
        self.place = 0
        self.places: dict[int, int] = {}
        self.readers: dict[int, list[int]] = {}
        self.used: set[int] = set()
        waiting = list(needed(function.tree))
        while waiting:
            value = waiting.pop()
            if isinstance(value, Node) and value.number not in self.used:
                self.used.add(value.number)
                waiting += used(value)

    def tree(self, tree: Tree, depth: int, loop: Node | None) -> Iterator[str]:
        for node in tree.nodes:
            self.place = self.places[node.number] = id(tree)
            text = f"({self.expression(node)})" if node.number in self.nested else ""
            if 0 < len(text) < LONG:
                self.names[node.number] = text
            elif node.number in self.used or acts(node):
                yield from self.statement(node, depth)
        self.place = id(tree)
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
            yield from self.turn(tree, loop, indent)
        elif has_array(self.function) or not tree.values:
            yield f"{indent}return {self.array(tree.values)}"
        else:
            yield f"{indent}return {self.value(tree.values[0])}"

    def read_once(self) -> frozenset[int]:
        """The nodes, of those printed, that are only read once, and on the path that computes them."""
        return frozenset(
            number
            for number, places in self.readers.items()
            if NODES[number].op in NESTED and places == [self.places[number]]
        )

    def turn(self, leaf: Leaf, loop: Node, indent: str) -> Iterator[str]:
        """The end of a loop's body: the next values of its variables."""
        done, *values = leaf.values
        old = [f"v{loop.args[0]}_{place}" for place in range(len(values))]
        moves = {
            name: new for name, value in zip(old, values) if (new := self.value(value)) != name
        }
        if moves:
            yield f"{indent}{', '.join(moves)} = {', '.join(moves.values())}"
        yield f"{indent}{'break' if done else 'continue'}"

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
            for place, value in enumerate(start):
                yield f"{indent}v{number}_{place} = {self.value(value)}"
            yield f"{indent}while True:"
            yield from self.tree(body, depth + 1, node)
        elif node.op == "call":
            yield f"{indent}{self.call(node)}"
        else:
            yield f"{indent}{self.name(node)} = {self.expression(node)}"

    def name(self, node: Node) -> str:
        return self.names.setdefault(node.number, f"n{len(self.names)}")

    def call(self, node: Node) -> str:
        traced, groups = node.args
        shapes = [shape for shape in traced.parameters.values() if size(shape)]
        arguments = ["note"]
        for shape, group in zip(shapes, groups, strict=True):
            arguments.append(self.value(group[0]) if shape == "number" else self.array(group))
        name, count = self.name(node), size(traced.shape)
        parts = [f"{name}_{place}" for place in range(count)]
        small = has_array(traced) and count <= SMALL
        target = f"{', '.join(parts)}, = {name}" if small else name
        return f"{target} = {traced.name}({', '.join(arguments)})"

    def array(self, group: list[Any]) -> str:
        """Numbers side by side: where they already are, or as a new tuple."""
        first = in_place(group)
        if first is not None:
            base, place = first.args
            name, shape = str(base), self.function.parameters.get(str(base))
            if first.op == "result":
                name, shape = self.names[base], NODES[base].args[0].shape
            whole = shape is not None and size(shape) == len(group)
            return name if whole else f"{name}[{place}:{place + len(group)}]"
        return f"({''.join(f'{self.value(value)}, ' for value in group)})"

    def value(self, value: Any) -> str:
        """A number where it is used."""
        if not isinstance(value, Node):
            return real(value)
        given = parameter(value)
        if given is not None:
            return given
        if value.op == "result":
            call, place = value.args
            traced, name = NODES[call].args[0], self.names[call]
            if not has_array(traced):
                return name
            return f"{name}_{place}" if size(traced.shape) <= SMALL else f"{name}[{place}]"
        if value.op in COMPARISONS:
            return f"({self.expression(value)})"
        self.readers.setdefault(value.number, []).append(self.place)
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
        return f"{sign}({', '.join(values)})"

    def text(self, text: str) -> str:
        """A text with its values, as an f-string."""
        types = {"Real": "", "Boolean": "bool"}
        form = repr(text.replace("{", "{{").replace("}", "}}"))
        values = iter(list(marked(text)))

        def written(_: Any) -> str:
            node = next(values)
            return f"{{{types.get(node.kind, 'int')}({self.value(node)})!r}}"

        return "f" + MARK.sub(written, form.replace("\\x01", "\x01").replace("\\x02", "\x02"))
