"""Loops and failures as functions of functions, which a tracer can follow too."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def repeat(body: Callable[[T], tuple[bool, T]], carry: T) -> T:
    """Apply `body` to `carry` again and again until it returns that it is done."""
    done = False
    while not done:
        done, carry = body(carry)
    return carry


def attempted(function: Callable[[], T], otherwise: T) -> T:
    """What the function returns, or `otherwise` where it has no value.

    Parameters
    ----------
    function : callable
        Takes no argument; it may fail by an ArithmeticError or a ValueError.
    otherwise : object
        The result where it fails.

    Examples
    --------
    >>> import math
    >>> attempted(lambda: math.sqrt(-1.0), 0.0)
    0.0
    """
    try:
        return function()
    except (ArithmeticError, ValueError):
        return otherwise
