"""Formulas of a live page: one text of arithmetic that Python and JavaScript compute alike.

A formula contains numbers, names with dots, `+ - * / **`, one comparison, and the functions of `FUNCTIONS`.
It is written out with all its parentheses, and every name as `v["name"]`. This text means the same in both
languages, so nothing is translated. Both compute as IEEE 754 says, with infinities and nan: nothing is raised.
"""

from __future__ import annotations

import ast
import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache, reduce
from types import CodeType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import Result, SetupError
from cosim.errors import pluralize
from cosim.series import Column


def _mod(x: Any, y: Any) -> Any:
    return np.fmod(np.fmod(x, y) + y, y)


def _power(x: Any, y: Any) -> Any:
    """JavaScript has no value for a 1 to an infinite power, or to nan; C has 1."""
    return np.where((np.abs(x) == 1.0) & ~np.isfinite(y), math.nan, x**y)


def _where(condition: Any, yes: Any, no: Any) -> Any:
    return np.where((condition == 0.0) | np.isnan(condition), no, yes)


def _folded(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *x: reduce(function, x)


class Function(NamedTuple):
    """A function of a formula, of so many arguments; 0 are any number from 1 on."""

    call: Callable[..., Any]
    arguments: int = 1


#: a name alone, such as that of a column
DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
#: the functions of a formula; those that JavaScript's Math lacks are in js/formula.js
FUNCTIONS: Mapping[str, Function] = {
    "abs": Function(np.abs), "atan2": Function(np.arctan2, 2), "cos": Function(np.cos), "exp": Function(np.exp),
    "hypot": Function(lambda *x: reduce(np.hypot, x, 0.0), 0), "log": Function(np.log),
    "max": Function(_folded(np.maximum), 0), "min": Function(_folded(np.minimum), 0),
    "mod": Function(_mod, 2), "sin": Function(np.sin), "sqrt": Function(np.sqrt), "where": Function(_where, 3),
}  # fmt: skip
OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==",
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
    @cache
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
        if not isinstance(text, str | int | float):
            raise SetupError(
                f"a formula is a text, such as the name of an option, or a number, not {type(text).__name__}"
            )
        text = text if isinstance(text, str) else repr(float(text))
        try:
            tree = ast.parse(text.strip(), mode="eval").body
        except SyntaxError as error:
            raise SetupError(f"the formula {text!r} is not valid: {error.msg}") from error
        except (ValueError, RecursionError, MemoryError) as error:
            raise SetupError(f"the formula {text!r} is not valid: {error}") from error
        names: set[str] = set()
        source = _written(tree, text, names)
        ieee = ast.fix_missing_locations(_Ieee().visit(ast.parse(source, mode="eval")))
        return cls(text, source, frozenset(names), compile(ieee, "<formula>", "eval"))

    def __call__(self, values: Mapping[str, float]) -> float:
        """Compute the formula with values by name."""
        return float(self.over(values))

    def numbers(self) -> list[float]:
        """Return the numbers that it contains, in their order; pi is one."""
        constants = (x for x in ast.walk(ast.parse(self.source)) if isinstance(x, ast.Constant))
        ordered = sorted(constants, key=lambda x: x.col_offset)
        return [x.value for x in ordered if isinstance(x.value, float)]

    def over(
        self, values: Mapping[str, Any], numbers: Iterable[Any] | None = None
    ) -> NDArray[np.float64]:
        """Compute the formula with values and columns by name; raises SetupError for a name that there is not.

        Other `numbers` take the place of its own.
        """
        calls = {name: function.call for name, function in FUNCTIONS.items()}
        known: dict[str, Any] = {"__builtins__": {}, "truth": np.float64, "pow": _power, **calls}
        other = iter(numbers or ())
        known["number"] = np.float64 if numbers is None else lambda _: next(other)
        for name in sorted(self.names - values.keys()):
            near = get_close_matches(name, list(values), 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; it may use {', '.join(values)}"
            raise SetupError(
                f"the formula {self.text!r} uses {name!r}, which is no option, start value, column or figure{hint}"
            )
        with np.errstate(all="ignore"):
            v = {name: np.float64(values[name]) for name in self.names}
            return np.asarray(eval(self._code, known, {"v": v}), float)


def with_formulas(result: Result, units: Mapping[str, str], values: Mapping[str, float]) -> Result:
    """Return a result with a column for each formula of columns, by its text, in these units.

    Parameters
    ----------
    result
        The rows.
    units
        Units by formula. Names of columns stand for them already.
    values
        What formulas may name besides columns.
    """
    more = {}
    used = set[str]()
    for text, unit in units.items():
        if text not in result.names:
            formula = Formula.read(text)
            names = formula.names & {*result.names}
            used |= names
            scope = {**values, **{name: np.asarray(result[name], float) for name in result.names}}
            more[Column(text, unit)] = formula.over(scope)
            if not unit:
                raise SetupError(f"the formula {text!r} needs a unit, as in unit='N.m'")
    return result.with_columns(more, sorted(used)) if more else result


class _Ieee(ast.NodeTransformer):
    """Makes numbers and comparisons floats of NumPy, which divide by zero."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Wrap a node where Python has a type of its own."""
        node = super().generic_visit(node)
        if isinstance(node, ast.Constant) and isinstance(node.value, float):
            return ast.Call(ast.Name("number", ast.Load()), [node], [])
        if isinstance(node, ast.Compare):
            return ast.Call(ast.Name("truth", ast.Load()), [node], [])
        return node


def _written(node: ast.AST, text: str, names: set[str]) -> str:
    """The source of a node; adds the names that it uses."""

    def inside(part: ast.AST) -> str:
        return _written(part, text, names)

    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return _float_text(number, text)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        return f"pow({inside(node.left)},{inside(node.right)})"
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return f"({inside(node.left)}{OPERATORS[type(node.op)]}{inside(node.right)})"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return f"(-{inside(node.operand)})"
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        return f"({inside(node.left)}{OPERATORS[type(node.ops[0])]}{inside(node.comparators[0])})"
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        _check_call(node.func.id, len(node.args), text)
        return f"{node.func.id}({','.join(map(inside, node.args))})"
    name = _dotted(node)
    if name == "pi":
        return repr(math.pi)
    if name is None:
        raise SetupError(
            f"the formula {text!r} must be arithmetic with names, + - * / **, a comparison, and "
            f"the functions {', '.join(FUNCTIONS)}"
        )
    names.add(name)
    return f'v["{name}"]'


def _float_text(number: float, text: str) -> str:
    """A number, which both languages can hold."""
    if abs(number) > sys.float_info.max:
        raise SetupError(f"the formula {text!r} has a number that is too large")
    return repr(float(number))


def _check_call(name: str, given: int, text: str) -> None:
    """Refuse a function that is none of `FUNCTIONS`, or with other arguments."""
    if name not in FUNCTIONS:
        raise SetupError(
            f"the formula {text!r} uses the function {name!r}, which is none of {', '.join(FUNCTIONS)}"
        )
    wanted = FUNCTIONS[name].arguments
    if given != (wanted or max(given, 1)):
        raise SetupError(
            f"the formula {text!r} gives {pluralize(given, 'argument')} to {name}, which takes "
            f"{wanted or 'one or more'}"
        )


def _dotted(node: Any) -> str | None:
    """The name "motor.B" of a node; None if it is no name."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        before = _dotted(node.value)
        return before and f"{before}.{node.attr}"
    return None
