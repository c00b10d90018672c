"""Which arguments each result of a traced function is computed from, through all its paths.

A result depends on the arguments of its operations, and on those of a condition whose two answers give it
different values. It does not depend on whether an operation fails. Loops of a length known only at run time, which have no
derivatives, are not followed: outputs have none.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from .graph import (
    Argument,
    Branch,
    Call,
    Function,
    Join,
    Node,
    Operation,
    Result,
    Tree,
    key,
    operands_of,
    size,
)

#: Arguments of a function: the name of the parameter and the place of a number in it.
Arguments = frozenset[tuple[str, int]]
#: What a constant depends on.
NOTHING: Arguments = frozenset()


class Dependency(NamedTuple):
    """What a value depends on, and what makes it the same as another one."""

    arguments: Arguments
    identity: Any


def arguments_of(function: Function) -> list[Arguments]:
    """The arguments that each number of a function's result is computed from."""
    results = Dependencies().along(function.tree) or []
    return [result.arguments for result in results]


class Dependencies:
    """What the nodes of one function depend on; those of the functions that it calls are kept."""

    def __init__(self, functions: dict[str, list[Arguments]] | None = None) -> None:
        self.functions: dict[str, list[Arguments]] = {} if functions is None else functions
        self.arguments_by_node: dict[int, Arguments] = {}
        self.arguments_by_call: dict[int, list[Arguments]] = {}

    def along(self, tree: Tree) -> list[Dependency] | None:
        """The results at the end of a tree; None where all its paths fail."""
        for node in tree.nodes:
            if isinstance(node, Join):
                ends = [self.along(arm) for arm in node.arms]
                results = self.merge_unless_failing(node.condition, *ends) or []
                self.arguments_by_node |= {
                    phi.number: result.arguments for phi, result in zip(node.phis, results)
                }
            elif isinstance(node, Call):
                self.arguments_by_call[node.number] = self.of_call(node)
            else:
                operands = operands_of(node) if isinstance(node, Operation) else ()
                self.arguments_by_node[node.number] = self.of_any(operands)
        if isinstance(tree, Branch):
            ends = [self.along(tree.true), self.along(tree.false)]
            return self.merge_unless_failing(tree.condition, *ends)
        if tree.error is not None:
            return None
        return [Dependency(self.of(value), key(value)) for value in tree.values]

    def merge_unless_failing(
        self, condition: Operation, true: list[Dependency] | None, false: list[Dependency] | None
    ) -> list[Dependency] | None:
        """The results of two paths, of which the condition selects one: those of the other where one fails."""
        if true is None or false is None:
            return false if true is None else true
        decides = self.of(condition)
        return [
            a
            if a.identity == b.identity
            else Dependency(
                decides | a.arguments | b.arguments, (condition.number, a.identity, b.identity)
            )
            for a, b in zip(true, false, strict=True)
        ]

    def of_call(self, node: Call) -> list[Arguments]:
        """The results of a call, in terms of the arguments of the calling function."""
        function, groups = node.function, node.groups
        if function.name not in self.functions:
            inner = Dependencies(self.functions).along(function.tree) or []
            self.functions[function.name] = [result.arguments for result in inner]
        names = [name for name, shape in function.parameters.items() if size(shape)]
        arguments_of_parameter = {
            (name, index): self.of(value)
            for name, group in zip(names, groups, strict=True)
            for index, value in enumerate(group)
        }
        return [
            NOTHING.union(*(arguments_of_parameter[argument] for argument in arguments))
            for arguments in self.functions[function.name]
        ]

    def of_any(self, values: Iterable[Any]) -> Arguments:
        """What at least one of the values depends on."""
        return NOTHING.union(*(self.of(value) for value in values))

    def of(self, value: Any) -> Arguments:
        """What a value depends on that is computed from the nodes so far."""
        if not isinstance(value, Node):
            return NOTHING
        if isinstance(value, Argument):
            return frozenset({(value.name, value.index or 0)})
        if isinstance(value, Result):
            return self.arguments_by_call[value.call.number][value.index]
        if isinstance(value, Operation) and value.is_comparison:
            arguments = self.arguments_by_node.get(value.number)
            return self.of_any(value.operands) if arguments is None else arguments
        return self.arguments_by_node[value.number]
