"""Turn a page of equations into an FMU; independent of any particular machine."""

from .declare.interface import InputHold
from .declare.model import Experiment
from .declare.record import array, discrete, fill, real, record, replace, start
from .runtime.flow import attempted, repeat

VERSION = "1.0.0"

__all__ = [
    "VERSION",
    "Experiment",
    "InputHold",
    "array",
    "attempted",
    "discrete",
    "fill",
    "real",
    "record",
    "repeat",
    "replace",
    "start",
]
