"""The step is repeated until all parts agree at its end."""

from __future__ import annotations

from collections.abc import Sequence

from .base import Algorithm, Stage, Turn


class Iterated(Algorithm):
    """Every part steps with what the others show at the end of the step: an implicit Euler method of the coupling."""

    name = "iterated"
    summary = "All parts repeat the step until the outputs at its end are those that the inputs were made of."
    end_weight = 1.0

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        """One stage with all parts; an iteration repeats it until its outputs agree."""
        return [tuple(Turn(part) for part in parts)]
