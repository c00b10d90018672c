"""Sine and cosine of an angle near one whose sine and cosine are known.

An integrator asks for them at every stage of a step over which a shaft turns by some hundredths of a
radian; in C the series are much quicker than the functions of libm.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

NEAR = 0.1


class Direction(NamedTuple):
    """An angle with its sine and its cosine."""

    angle: float
    sin: float
    cos: float


def turned(near: Direction, angle: float) -> Direction:
    """The direction of an angle, to 3e-15: from the series about one that is less than NEAR away."""
    d = angle - near.angle
    square = d * d
    if square > NEAR * NEAR:
        return Direction(angle, sin(angle), cos(angle))
    fourth = square * square
    s = d * ((1.0 - square * (1 / 6)) + fourth * (1 / 120 - square * (1 / 5040)))
    c = (1.0 - square * 0.5) + fourth * ((1 / 24 - square * (1 / 720)) + fourth * (1 / 40320))
    return Direction(angle, near.sin * c + near.cos * s, near.cos * c - near.sin * s)
