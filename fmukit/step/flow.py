"""Loops and failures as functions of functions: what a tracer, too, can follow."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def repeat(body: Callable[[T], tuple[bool, T]], carry: T) -> T:
    """Put `carry` through `body` until it says that it is done."""
    done = False
    while not done:
        done, carry = body(carry)
    return carry


def attempted(function: Callable[[], T], otherwise: T) -> T:
    """What the function returns, or something else where it has no value."""
    try:
        return function()
    except (ArithmeticError, ValueError):
        return otherwise
