"""An input over time on its way into a running part."""

from __future__ import annotations

import ctypes
import math

import numpy as np
from numpy.typing import NDArray

from ..errors import NonFiniteValueError
from ..fmu.buffers import Slot, address
from ..fmu.operations import NOT_FINITE, Code, COperation, Operation
from ..system.inputs import FunctionInput, TableInput

Array = NDArray[np.float64]


class InputSource(Operation):
    """A Real input that follows a table or a function: `cell` holds its mean over the last step, `slot` is the same by name."""

    def __init__(self, name: str, profile: TableInput | FunctionInput, t: float) -> None:
        self.name, self.profile = name, profile
        self.cell = (ctypes.c_double * 1)(float(profile.at(t)))
        self.slot = Slot(name, self.cell, 0)

    def __call__(self, t: float, h: float) -> None:
        """Take the mean over the step from t by h [s]; raises NonFiniteValueError."""
        self.cell[0] = self.profile.mean(t, h)
        if not math.isfinite(self.cell[0]):
            self.answered(t, h, NOT_FINITE)

    def c_operation(self) -> COperation:
        """The means stand in a list, which is laid out with the steps."""
        return COperation(Code.FEED, checked=1, cells=address(self.cell))

    def answered(self, t: float, h: float, status: int) -> None:
        """Raise NonFiniteValueError with the mean that is not finite."""
        value = self.cell[0]
        raise NonFiniteValueError(f"{self.name} = {value!r} at t = {t!r} s must be a finite number")

    def taylor(self, begin: float, h: float) -> list[float]:
        """Coefficients of the line with the mean and the rise of the step from `begin` by h [s]."""
        self(begin, h)
        slope = self.profile.rise(begin, h) / h
        return [self.cell[0] - 0.5 * slope * h, slope]
