"""All parts step side by side."""

from __future__ import annotations

from collections.abc import Sequence

from .base import Algorithm, Stage, Turn


class Jacobi(Algorithm):
    """Every part steps with what the others have shown at the beginning of the step."""

    name = "jacobi"
    summary = "All parts step side by side, with the values of the step's beginning."

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        """One stage in which all parts step."""
        return [tuple(Turn(part) for part in parts)]
