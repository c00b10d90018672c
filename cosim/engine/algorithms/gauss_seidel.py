"""One part steps after the other."""

from __future__ import annotations

from collections.abc import Sequence

from .base import Algorithm, Stage, Turn


class GaussSeidel(Algorithm):
    """Every part steps with the newest values of the parts before it."""

    name = "gauss-seidel"
    summary = "One part steps after the other, each with the newest values of those before it."

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        """A stage for each part, in the order of the parts."""
        return [(Turn(part),) for part in parts]
