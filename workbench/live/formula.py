"""Formulas of a live page: one text of arithmetic that Python and JavaScript compute alike.

A formula contains numbers, names with dots, `+ - * / **`, one comparison, and the functions of `FUNCTIONS`.
It is written out with all its parentheses, and every name as `v["name"]`. This text means the same in both
languages, so nothing is translated.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import CodeType
from typing import Any

from cosim import SetupError


def _mod(x: float, y: float) -> float:
    return x % y


def _where(condition: float, yes: float, no: float) -> float:
    return yes if condition else no


#: the functions of a formula; those that JavaScript's Math lacks are in js/formula.js
FUNCTIONS: Mapping[str, Callable[..., float]] = {
    "abs": abs, "atan2": math.atan2, "cos": math.cos, "exp": math.exp, "hypot": math.hypot,
    "log": math.log, "max": max, "min": min, "mod": _mod, "sin": math.sin, "sqrt": math.sqrt,
    "where": _where,
}  # fmt: skip
OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.Lt: "<",
    ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==",
}  # fmt: skip


@dataclass(frozen=True)
class Formula:
    """A formula that was read.

    Attributes
    ----------
    text : str
        The formula as it was declared.
    source : str
        The same with all parentheses and with names as `v["motor.B"]`, for both languages.
    names : frozenset of str
        The names that it uses, such as "motor.B".
    """

    text: str
    source: str
    names: frozenset[str]
    _code: CodeType

    @classmethod
    def read(cls, text: str | float) -> Formula:
        """Read a formula.

        Parameters
        ----------
        text : str or float
            Arithmetic such as "motor.B * speed", or a number.

        Raises
        ------
        SetupError
            If the text is more than such arithmetic.
        """
        text = text if isinstance(text, str) else repr(float(text))
        try:
            tree = ast.parse(text.strip(), mode="eval").body
        except SyntaxError as error:
            raise SetupError(f"LIVE: the formula {text!r} is not valid: {error.msg}") from error
        names: set[str] = set()
        source = _written(tree, text, names)
        return cls(text, source, frozenset(names), compile(source, "<formula>", "eval"))

    def __call__(self, values: Mapping[str, float]) -> float:
        """Compute the formula with values by name; nan where it has no finite value."""
        try:
            value = eval(self._code, {"__builtins__": {}, **FUNCTIONS}, {"v": values})
            return float(value)
        except (ArithmeticError, ValueError):
            return math.nan


def _written(node: ast.AST, text: str, names: set[str]) -> str:
    """The source of a node; adds the names that it uses."""

    def inside(part: ast.AST) -> str:
        return _written(part, text, names)

    number = getattr(node, "value", None) if isinstance(node, ast.Constant) else None
    if isinstance(number, (int, float)) and not isinstance(number, bool):
        return repr(float(number))
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return f"({inside(node.left)}{OPERATORS[type(node.op)]}{inside(node.right)})"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return f"(-{inside(node.operand)})"
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        return f"({inside(node.left)}{OPERATORS[type(node.ops[0])]}{inside(node.comparators[0])})"
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        if node.func.id not in FUNCTIONS:
            raise SetupError(
                f"LIVE: the formula {text!r} uses the function {node.func.id!r}, which is none of "
                f"{', '.join(FUNCTIONS)}"
            )
        return f"{node.func.id}({','.join(map(inside, node.args))})"
    name = _dotted(node)
    if name == "pi":
        return repr(math.pi)
    if name is None:
        raise SetupError(
            f"LIVE: the formula {text!r} must be arithmetic with names, + - * / **, a comparison, and "
            f"the functions {', '.join(FUNCTIONS)}"
        )
    names.add(name)
    return f'v["{name}"]'


def _dotted(node: Any) -> str | None:
    """The name "motor.B" of a node; None if it is no name."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        before = _dotted(node.value)
        return before and f"{before}.{node.attr}"
    return None
