"""The operations that equations are made of: one table, from which all that handles them is made.

A row has a name, the number of operands, how C and Python write it, when it fails, the type of its result
and its derivative. The tracer, both printers, the tangents, the failures and the list of C functions read
this table; no column has a default, so that no row can lack one.

To add a function of `math`, add a row here, and its C function to `fmi2_context.c` if libm has none that
rounds and fails like Python's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol


class Failure(Enum):
    """When Python raises instead of returning a value."""

    NEVER = "never"
    FOR_SOME_OPERANDS = "for some operands"
    FOR_DIVISOR_ZERO = "only where the second operand is zero"


class ResultType(Enum):
    """The type of the result, as FMI names it."""

    REAL = "Real"
    INTEGER = "Integer"
    BOOLEAN = "Boolean"


class Apply(Protocol):
    """Record an operation on operands that are numbers or nodes, and return its node."""

    def __call__(self, name: str, *operands: Any) -> Any:
        """Return the result of the operation with this name."""


#: The tangent of a result: from `Apply`, the result, the operands, and then the tangents of the operands.
Derivative = Callable[..., Any]


@dataclass(frozen=True, kw_only=True)
class Op:
    """One operation.

    Parameters
    ----------
    name
        What nodes carry; the functions of `math` have their name there.
    arity
        The number of operands.
    c
        The C expression, with {0}, {1}, ... for the operands; `c` in it is the context that takes failures.
    c_unchecked
        The C expression where it cannot fail; the same as `c` for most.
    libm
        The function of libm that is called through a pointer, or None.
    python
        The Python expression.
    failure
        When it fails.
    result
        The type of the result.
    derivative
        The rule of the tangent, or None for what has none.
    from_math
        Whether equations call it as a function of `math`.
    """

    name: str
    arity: int
    c: str
    c_unchecked: str
    libm: str | None
    python: str
    failure: Failure
    result: ResultType
    derivative: Derivative | None
    from_math: bool


def is_moving(tangent: Any) -> bool:
    """Whether a tangent is other than the number zero."""
    return not isinstance(tangent, int | float) or tangent != 0.0


def plus(a: Any, b: Any) -> Any:
    """The sum of two tangents, without an operation where one is zero."""
    return a + b if is_moving(a) and is_moving(b) else a if is_moving(a) else b


def minus(tangent: Any) -> Any:
    """A tangent with the other sign, without an operation where it is zero."""
    return -tangent if is_moving(tangent) else 0.0


def times(a: Any, tangent: Any) -> Any:
    """A multiple of a tangent, without an operation where the tangent is zero."""
    return a * tangent if is_moving(tangent) else 0.0


def _of_power(f: Apply, n: Any, base: Any, exponent: Any, tangent: Any, growth: Any) -> Any:
    is_square = isinstance(exponent, int | float) and exponent == 2.0
    slope = exponent * base if is_square else exponent * f("power", base, exponent - 1.0)
    by_exponent = times(n * f("log", base), growth) if is_moving(growth) else 0.0
    return plus(times(slope, tangent), by_exponent)


def _of_fabs(f: Apply, n: Any, a: Any, da: Any) -> Any:
    return f("select", a < 0.0, da, -da)


def _of_modulo(f: Apply, n: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    return plus(da, -times(f("floordiv", a, b), db)) if is_moving(db) else da


def _of_fmod(f: Apply, n: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    return plus(da, -times(f("trunc", a / b), db)) if is_moving(db) else da


def _of_copysign(f: Apply, n: Any, a: Any, b: Any, da: Any, db: Any) -> Any:
    return times(f("copysign", 1.0, a) * f("copysign", 1.0, b), da)


def _zero_derivative(*_: Any) -> float:
    """The derivative of a step function, away from its steps."""
    return 0.0


def _infix(sign: str, derivative: Derivative) -> Op:
    form = f"{{0}} {sign} {{1}}"
    return Op(
        name=sign, arity=2, c=form, c_unchecked=form, libm=None, python=form,
        failure=Failure.NEVER, result=ResultType.REAL, derivative=derivative, from_math=False,
    )  # fmt: skip


def _comparison(sign: str) -> Op:
    form = f"{{0}} {sign} {{1}}"
    return Op(
        name=sign, arity=2, c=form, c_unchecked=form, libm=None, python=form,
        failure=Failure.NEVER, result=ResultType.BOOLEAN, derivative=None, from_math=False,
    )  # fmt: skip


def _by_c_function(
    name: str, c: str, python: str, derivative: Derivative, *, libm: str | None, from_math: bool
) -> Op:
    """An operation of two operands for which `fmi2_context.c` has a function that fails like Python's."""
    form = f"{c}(c, {{0}}, {{1}})"
    return Op(
        name=name, arity=2, c=form, c_unchecked=form, libm=libm, python=python,
        failure=Failure.FOR_SOME_OPERANDS, result=ResultType.REAL, derivative=derivative,
        from_math=from_math,
    )  # fmt: skip


def _libm(
    name: str,
    derivative: Derivative,
    *,
    check: str | None,
    arity: int = 1,
    through_pointer: bool = True,
) -> Op:
    """A function of libm whose value `check` tests; one without a check never fails."""
    operands = ", ".join(f"{{{k}}}" for k in range(arity))
    call = f"{'libm_' if through_pointer else ''}{name}({operands})"
    form = call if check is None else f"{check}(c, {{0}}, {call})"
    return Op(
        name=name, arity=arity, c=form, c_unchecked=form, libm=name if through_pointer else None,
        python=f"{name}({operands})",
        failure=Failure.NEVER if check is None else Failure.FOR_SOME_OPERANDS,
        result=ResultType.REAL, derivative=derivative, from_math=True,
    )  # fmt: skip


def _rounding(name: str) -> Op:
    form = f"checked_integer(c, {{0}}, {name}({{0}}))"
    return Op(
        name=name, arity=1, c=form, c_unchecked=form, libm=None, python=f"float({name}({{0}}))",
        failure=Failure.FOR_SOME_OPERANDS, result=ResultType.INTEGER, derivative=_zero_derivative,
        from_math=True,
    )  # fmt: skip


DIVISION = Op(
    name="/", arity=2, c="quotient(c, {0}, {1})", c_unchecked="{0} / {1}", libm=None,
    python="{0} / {1}", failure=Failure.FOR_DIVISOR_ZERO, result=ResultType.REAL,
    derivative=lambda f, n, a, b, da, db: plus(da, -times(n, db) if is_moving(db) else 0.0) / b,
    from_math=False,
)  # fmt: skip
NEGATION = Op(
    name="neg", arity=1, c="-{0}", c_unchecked="-{0}", libm=None, python="-{0}",
    failure=Failure.NEVER, result=ResultType.REAL, derivative=lambda f, n, a, da: -da,
    from_math=False,
)  # fmt: skip
FABS = Op(
    name="fabs", arity=1, c="fabs({0})", c_unchecked="fabs({0})", libm=None, python="abs({0})",
    failure=Failure.NEVER, result=ResultType.REAL, derivative=_of_fabs, from_math=True,
)  # fmt: skip
COPYSIGN = Op(
    name="copysign", arity=2, c="copysign({0}, {1})", c_unchecked="copysign({0}, {1})", libm=None,
    python="copysign({0}, {1})", failure=Failure.NEVER, result=ResultType.REAL,
    derivative=_of_copysign, from_math=True,
)  # fmt: skip
#: The third operand where the first is true, else the second: what follows a failed attempt.
SELECT = Op(
    name="select", arity=3, c="{0} ? {2} : {1}", c_unchecked="{0} ? {2} : {1}", libm=None,
    python="{2} if {0} else {1}", failure=Failure.NEVER, result=ResultType.REAL, derivative=None,
    from_math=False,
)  # fmt: skip

_ROWS: Sequence[Op] = (
    _infix("+", lambda f, n, a, b, da, db: plus(da, db)),
    _infix("-", lambda f, n, a, b, da, db: plus(da, minus(db))),
    _infix("*", lambda f, n, a, b, da, db: plus(times(b, da), times(a, db))),
    DIVISION,
    NEGATION,
    *map(_comparison, ("<", "<=", ">", ">=", "==", "!=")),
    SELECT,
    FABS,
    COPYSIGN,
    _by_c_function("power", "power", "{0} ** {1}", _of_power, libm="pow", from_math=False),
    _libm(
        "atan2",
        lambda f, n, y, x, dy, dx: (
            plus(times(x, dy), -times(y, dx) if is_moving(dx) else 0.0) / (x * x + y * y)
        ),
        check=None,
        arity=2,
    ),
    _by_c_function("modulo", "modulo", "{0} % {1}", _of_modulo, libm="fmod", from_math=False),
    _by_c_function(
        "floordiv", "floor_quotient", "{0} // {1}", _zero_derivative, libm="fmod", from_math=False
    ),
    _by_c_function("pow", "math_pow", "pow({0}, {1})", _of_power, libm="pow", from_math=True),
    _by_c_function("fmod", "math_fmod", "fmod({0}, {1})", _of_fmod, libm="fmod", from_math=True),
    *map(_rounding, ("floor", "ceil", "trunc")),
    _libm("sin", lambda f, n, a, da: f("cos", a) * da, check="defined"),
    _libm("cos", lambda f, n, a, da: -f("sin", a) * da, check="defined"),
    _libm("tan", lambda f, n, a, da: (1.0 + n * n) * da, check="defined"),
    _libm("asin", lambda f, n, a, da: da / f("sqrt", 1.0 - a * a), check="defined"),
    _libm("acos", lambda f, n, a, da: -da / f("sqrt", 1.0 - a * a), check="defined"),
    _libm("atan", lambda f, n, a, da: da / (1.0 + a * a), check=None),
    _libm("sinh", lambda f, n, a, da: f("cosh", a) * da, check="checked"),
    _libm("cosh", lambda f, n, a, da: f("sinh", a) * da, check="checked"),
    _libm("tanh", lambda f, n, a, da: (1.0 - n * n) * da, check=None),
    _libm("asinh", lambda f, n, a, da: da / f("sqrt", a * a + 1.0), check=None),
    _libm("acosh", lambda f, n, a, da: da / f("sqrt", a * a - 1.0), check="defined"),
    _libm("atanh", lambda f, n, a, da: da / (1.0 - a * a), check="defined"),
    _libm("sqrt", lambda f, n, a, da: da / (2.0 * n), check="defined", through_pointer=False),
    _libm("exp", lambda f, n, a, da: n * da, check="checked"),
    _libm("expm1", lambda f, n, a, da: (n + 1.0) * da, check="checked"),
    _libm("log", lambda f, n, a, da: da / a, check="defined"),
    _libm("log10", lambda f, n, a, da: da / (a * math.log(10.0)), check="defined"),
    _libm("log2", lambda f, n, a, da: da / (a * math.log(2.0)), check="defined"),
    _libm("log1p", lambda f, n, a, da: da / (1.0 + a), check="defined"),
    _libm(
        "erf",
        lambda f, n, a, da: 2.0 / math.sqrt(math.pi) * f("exp", -(a * a)) * da,
        check=None,
    ),
    _libm(
        "erfc",
        lambda f, n, a, da: -2.0 / math.sqrt(math.pi) * f("exp", -(a * a)) * da,
        check=None,
    ),
)

#: All operations by name.
OPS: dict[str, Op] = {op.name: op for op in _ROWS}
#: The signs of comparisons.
COMPARISONS = frozenset(op.name for op in _ROWS if op.result is ResultType.BOOLEAN)


def libm_functions() -> dict[str, int]:
    """The functions of libm that are called through pointers, with the number of their operands."""
    return {op.libm: op.arity for op in _ROWS if op.libm is not None}
