"""Jets: a value with its first and second derivative along one coordinate.

Equations of motion need the derivatives of a geometry; with jets, the formulas of the geometry are enough.
The functions also take numbers, so that one formula serves both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar


class Jet(NamedTuple):
    """A function at a point: its value, and its derivatives per unit of the coordinate."""

    value: float
    first: float
    second: float

    def along(self, x: Jet) -> Jet:
        """A function of x as one of what x depends on: the chain rule."""
        bent = self.second * (x.first * x.first) + self.first * x.second
        return Jet(self.value, self.first * x.first, bent)

    @property
    def derivative(self) -> Jet:
        """The first derivative; its own second derivative is not known, and is nan."""
        return Jet(self.first, self.second, math.nan * self.second)

    def __add__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value + other, self.first, self.second)
        return Jet(self.value + other.value, self.first + other.first, self.second + other.second)

    def __sub__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value - other, self.first, self.second)
        return Jet(self.value - other.value, self.first - other.first, self.second - other.second)

    def __rsub__(self, other: Any) -> Jet:
        return Jet(other - self.value, -self.first, -self.second)

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.first * other, self.second * other)
        (a, a_1, a_2), (b, b_1, b_2) = self, other
        if other is self:
            return Jet(a * a, 2.0 * (a * a_1), 2.0 * (a_1 * a_1 + a * a_2))
        return Jet(a * b, a_1 * b + a * b_1, a_2 * b + 2.0 * (a_1 * b_1) + a * b_2)

    def __truediv__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            per = 1.0 / other
            return Jet(self.value / other, self.first * per, self.second * per)
        (a, a_1, a_2), (b, b_1, b_2) = self, other
        q, q_1 = a / b, (a_1 * b - a * b_1) / (b * b)
        return Jet(q, q_1, (a_2 - 2.0 * (q_1 * b_1) - q * b_2) / b)

    def __pow__(self, n: int) -> Jet:
        return self * (self if n == 2 else self ** (n - 1))

    def __radd__(self, other: float) -> Jet:
        return self.__add__(other)

    def __rmul__(self, other: Any) -> Jet:
        return self.__mul__(other)


Number = TypeVar("Number", float, Jet)


def function(
    name: str, slopes: Callable[[float], tuple[float, float]]
) -> Callable[[Number], Number]:
    """The function of `math` with this name, and with these derivatives."""

    def of(x: Any) -> Any:
        value = getattr(math, name)
        return Jet(value(x.value), *slopes(x.value)).along(x) if isinstance(x, Jet) else value(x)

    return of


sin = function("sin", lambda x: (math.cos(x), -math.sin(x)))
cos = function("cos", lambda x: (-math.sin(x), -math.cos(x)))
sqrt = function("sqrt", lambda x: (0.5 / math.sqrt(x), -0.25 / (x * math.sqrt(x))))
acos = function("acos", lambda x: (-1.0 / (c := math.sqrt(1.0 - x * x)), -x / (c * c * c)))


def atan2(y: Number | float, x: Number) -> Number:
    """The angle of the point x, y; of jets, y alone may be a number."""
    if not isinstance(x, Jet):
        return math.atan2(y, x)
    y = y if isinstance(y, Jet) else constant(y)
    square = x.value * x.value + y.value * y.value
    angular = (x.value * y.first - y.value * x.first) / square
    radial = x.value * x.first + y.value * y.first
    bent = x.value * y.second - y.value * x.second - 2.0 * (radial * angular)
    return Jet(math.atan2(y.value, x.value), angular, bent / square)


def constant(value: float) -> Jet:
    """What does not change, with derivatives in its unit."""
    return Jet(value, 0.0 * value, 0.0 * value)
