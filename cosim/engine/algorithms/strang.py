"""Half a step forwards, half a step backwards.

The symmetric splitting of G. Strang, On the construction and comparison of difference schemes, SIAM
Journal on Numerical Analysis 5 (1968), with one part in place of each operator.
"""

from __future__ import annotations

from collections.abc import Sequence

from .base import Algorithm, Stage, Turn


class Strang(Algorithm):
    """All parts but the last take half a step, the last a full one, the others half a step in reverse.

    The schedule is symmetric in time, which removes the error terms of odd order.
    """

    name = "strang"
    summary = "All parts but the last take half a step, the last a full one, the others the other half in reverse."
    held_order = 2

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        """Half steps of the parts before the last, its whole step, the other halves in reverse."""
        *first, last = parts
        forwards: list[Stage] = [(Turn(part, 0.0, 0.5),) for part in first]
        backwards: list[Stage] = [(Turn(part, 0.5, 0.5),) for part in reversed(first)]
        return [*forwards, (Turn(last),), *backwards]
