"""What can go wrong: a system that cannot be run, or a call into an FMU."""

from __future__ import annotations


class SetupError(ValueError):
    """The system or the settings are refused before the first step."""


class PartFailure(RuntimeError):
    """A call into an FMU failed; the text names the part, the call and the FMU's reason."""


class Discarded(PartFailure):
    """A part computed a step only to the time `reached` [s]."""

    def __init__(self, message: str, reached: float) -> None:
        super().__init__(message)
        self.reached = reached


class Met(Discarded):
    """A part met an event at the time `reached` [s], where the others are to stop too."""


class NotFinite(PartFailure):
    """A value that a wire or a row was to carry is not a finite number."""


class Ended(PartFailure):
    """A part ended the simulation of its own accord."""


def counted(number: int, noun: str) -> str:
    """The number and the noun in a message: "1 row", "2 rows"."""
    return f"{number} {noun}{'s' * (number != 1)}"
