"""What an FMU needs of a model's functions: they must be pure and return records of numbers."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any

from ..declare.model import Model
from ..declare.record import is_record, start
from .execute import leaves
from .graph import Argument, Node, Tree, UntraceableError, key
from .tracer import Tracer

REFUSED: dict[type[ast.AST], str] = {
    ast.Try: "try cannot go into the FMU, where nothing is raised: test with if",
    ast.Global: "global cannot go into the FMU: what a function keeps must be in the State",
    ast.MatchSingleton: "case True, False or None cannot go into the FMU: write if",
    ast.Assert: "assert cannot go into the FMU: write if not ...: raise ValueError(...)",
}


def require(model: Model, tracer: Tracer) -> None:
    """Raise SyntaxError or UntraceableError for a function that the FMU could not repeat.

    Such a function catches errors, returns something that is not a number, or returns another value for
    the same numbers.
    """
    for module in tracer.modules:
        refuse_statements(module)
    p, x, u = (start(cls) for cls in (model.Parameters, model.State, model.Inputs))
    results = {"derivatives": model.State, "outputs": model.Outputs}
    if model.event_indicators:
        results |= {"event_indicators": tuple, "event_update": model.State}
    for name, result in results.items():
        with_checks = with_result_checked(model, name, result)
        examples = {"p": p, "t": 0.0, "x": x, "u": u} | (
            {"which": 0} if name == "event_update" else {}
        )
        try:
            once, again = (tracer.trace(name, with_checks, **examples) for _ in range(2))
        except RecursionError as error:
            raise UntraceableError(f"{name} calls itself without end") from error
        if results_of_paths(once.tree) != results_of_paths(again.tree):
            raise UntraceableError(
                f"{name} returns another value when it is called again with the same numbers: "
                "it may only use its arguments and constants"
            )


def refuse_statements(module: ModuleType) -> None:
    """Raise SyntaxError for a statement of `REFUSED` in a function of this module."""
    for node in (
        inner
        for outer in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(outer, ast.FunctionDef)
        for inner in ast.walk(outer)
    ):
        if isinstance(node, ast.stmt | ast.pattern) and (reason := REFUSED.get(type(node))):
            raise SyntaxError(reason, (module.__file__, node.lineno, None, None))


def with_result_checked(model: Model, name: str, result: Any) -> Callable[..., Any]:
    """The function of a model with this name, which refuses to return anything but this record, of numbers."""

    def call(**arguments: Any) -> Any:
        returned = getattr(model, name)(*arguments.values())
        if not isinstance(returned, result):
            form = "(..., ...)" if result is tuple else f"{result.__name__}(...)"
            raise UntraceableError(f"{name} returns {_describe(returned)}: write return {form}")
        declarations = result._declared.items() if is_record(result) else ()
        for (field, declared), value in zip(declarations, returned):
            is_boolean = declared.fmi_type == "Real" and is_true_or_false(value)
            if is_boolean or not isinstance(value, (Node, float, int)):
                raise UntraceableError(
                    f"in {name} {result.__name__}.{field} is {_describe(value)}, which is not a number"
                    + (": write 1.0 if ... else 0.0" if is_boolean else "")
                )
        return (
            0.0 if result is tuple else returned
        )  # the number of indicators may depend on the state

    return call


def is_true_or_false(value: Any) -> bool:
    """Whether a value is true or false, but no variable."""
    if isinstance(value, Node):
        return value.type.kind == "Boolean" and not isinstance(value, Argument)
    return isinstance(value, bool)


def _describe(value: Any) -> str:
    if isinstance(value, Node) and is_true_or_false(value):
        return "a condition"
    if value is None or isinstance(value, bool):
        return repr(value)
    return "a number" if isinstance(value, Node) else f"a {type(value).__name__}"


def results_of_paths(tree: Tree) -> list[tuple[Any, ...]]:
    """What tells the values at the ends of all paths apart."""
    return [(leaf.error and leaf.error.identity, *map(key, leaf.values)) for leaf in leaves(tree)]
