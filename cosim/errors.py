"""The errors: a system that cannot be run, a failed call into an FMU, a run that did not come to its end."""

from __future__ import annotations


class SetupError(ValueError):
    """The system or the settings were refused before the first step."""


class FmuError(RuntimeError):
    """A call into an FMU failed; the text gives the part, the call and the FMU's reason."""


class EndedEarly(FmuError):
    """A part came only up to the time `reached` [s]."""

    def __init__(self, message: str, reached: float) -> None:
        super().__init__(message)
        self.reached = reached

    def __reduce__(self) -> tuple[type[FmuError], tuple[str, float]]:
        return type(self), (str(self), self.reached)


class StepDiscarded(EndedEarly):
    """A part computed a step only up to the time `reached` [s]."""


class EventReached(StepDiscarded):
    """A part met an event at the time `reached` [s], where the others must stop too."""


class NonFiniteValueError(FmuError):
    """A value for a wire or a row is not a finite number."""


class SimulationTerminated(EndedEarly):
    """A part ended the simulation itself, at the time `reached` [s]."""


class RunError(RuntimeError):
    """A run did not come to its end."""


def pluralize(number: int, noun: str) -> str:
    """The number and the noun in a message: "1 row", "2 rows"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
