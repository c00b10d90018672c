"""What can go wrong: a system that cannot be run, or a run that stops half-way."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .result import Result


class SetupError(ValueError):
    """The system or the settings are refused before the first step."""


class PartFailure(RuntimeError):
    """A call into an FMU failed; the text names the part, the call and the FMU's reason."""


class Discarded(PartFailure):
    """A part computed a step only to the time `reached` [s]."""

    def __init__(self, message: str, reached: float) -> None:
        super().__init__(message)
        self.reached = reached


class Ended(PartFailure):
    """A part ended the simulation of its own accord."""


class SimulationError(RuntimeError):
    """A part failed on the way; `result` holds every row up to there."""

    def __init__(self, message: str, result: Result) -> None:
        super().__init__(message)
        self.result = result


class Interrupted(KeyboardInterrupt):
    """Ctrl-C; `result` holds every row up to there."""

    def __init__(self, message: str, result: Result) -> None:
        super().__init__(message)
        self.result = result
