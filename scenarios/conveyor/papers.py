"""The formulas of the conveyor's paper that its questions name."""

from __future__ import annotations

PAPER = "Dynamics of a crank-and-rod mechanism loaded by a variable resistance"
LINK = "docs/papers.md#crankconveyor"
FORMULAS = {
    2: "motor with lag", 16: "settling of the mean speed", 17: "rod force", 18: "mean speed", 19: "mean load",
    22: "electromechanical resonance", 24: "mean torque", 26: "motor torque with its ripple",
}  # fmt: skip


def cited(*numbers: int) -> tuple[tuple[str, str], ...]:
    """Return the sources of a question that names the formulas with these numbers."""
    return tuple((f"{PAPER}, formula ({n}): {FORMULAS[n]}", LINK) for n in numbers)
