"""The model-exchange side of an FMU of either version: continuous states, their rates, event indicators."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError
from ..system import Port, is_continuous_input
from ..system.description import ModelDescription, Variable
from .instance import Instance
from .library import Library
from .messages import DISCARD, OK
from .session import MODEL_EXCHANGE
from .session2 import Session2
from .session3 import Session3

Array = NDArray[np.float64]
#: The change of a variable over its size by which differences give derivatives. Derived: the cube root of
#: the rounding error 2.2e-16 of a double is best for central differences.
DIFFERENCE = 6e-6


class EvaluationError(FmuError):
    """A part cannot compute with the state that was tried."""


class Perturbation(NamedTuple):
    """A variable to differentiate by, the cell of its value, and what hands the cell to the FMU."""

    variable: Variable
    cells: Any
    element: int
    hand_over: Callable[[], None]


class ModelExchange(Instance):
    """A part by model exchange: continuous states `x`, rates `dx`, event indicators `z`.

    `is_started` once continuous-time mode has been entered; `next_time` is the next event that the FMU
    knows in advance [s].
    """

    def __init__(self, name: str, description: ModelDescription, fmu: Library) -> None:
        if description.fmiVersion == "2.0":
            super().__init__(Session2(name, description, fmu, MODEL_EXCHANGE))
        else:
            super().__init__(Session3(name, description, fmu, MODEL_EXCHANGE, event_mode=True))
        self.rates: list[Variable] = [u.variable for u in description.derivatives]
        self.states: list[Variable] = [
            rate.derivative for rate in self.rates if rate.derivative is not None
        ]
        self.x = (ctypes.c_double * len(self.states))()
        self.dx = (ctypes.c_double * len(self.states))()
        self.z = (ctypes.c_double * (description.numberOfEventIndicators or 0))()
        self.is_started = False
        self.next_time = math.inf

    def array(self, function: str, cells: Any) -> None:
        """Call "SetContinuousStates" and the like with this array; raises EvaluationError, FmuError."""
        if len(cells):
            session = self.session
            status = session.function(function)(
                session.component, cells, ctypes.c_size_t(len(cells))
            )
            if status == DISCARD:
                raise EvaluationError(str(session.failure(function, status)))
            if status != OK:
                session.answered(function, status)

    def set_states(self) -> None:
        """Hand over the states."""
        self.array("SetContinuousStates", self.x)

    def get_states(self) -> None:
        """Get the states, which an event may have changed."""
        self.array("GetContinuousStates", self.x)

    def get_rates(self) -> None:
        """Get the rates of the states."""
        self.array(self.session.derivatives, self.dx)

    def update(self) -> tuple[bool, bool]:
        """Iterate event mode once, and learn when the next event is due.

        Returns whether it is to be iterated again, and whether the FMU wants to end the simulation.
        """
        again, end, _, _, timed, time = self.session.call(self.session.update)
        self.next_time = time if timed else math.inf
        return bool(again), bool(end)

    def enter_continuous_time(self) -> None:
        """Leave event mode, and get the states."""
        self.session.call("enterContinuousTimeMode")
        self.is_started = True
        self.get_states()

    def continuous_inputs(self) -> list[Variable]:
        """The Real inputs; by FMI 3.0 those that are continuous."""
        variables = self.session.description.modelVariables
        return [v for v in variables if is_continuous_input(Port(self.session.name, v))]

    def real_outputs(self) -> list[Variable]:
        """The Real outputs."""
        variables = self.session.description.modelVariables
        return [v for v in variables if v.causality == "output" and v.type == "Real"]

    def jacobian(self) -> tuple[Array, Array]:
        """Derivatives of rates and outputs by the states and by the continuous inputs.

        They are those that the FMU gives, or central differences.
        """
        unknown = [*self.rates, *self.real_outputs()]
        perturbations = self._perturbations()
        self.get_states()
        columns: list[Array] = []
        if unknown and self.session.interface.providesDirectionalDerivative:
            slopes = (self.session.slopes(unknown, p.variable) for p in perturbations)
            columns = [np.array(column) for column in slopes]
        elif unknown:
            columns = [self._difference(unknown, p) for p in perturbations]
        derivatives = np.array(columns).reshape(len(perturbations), len(unknown)).T
        return derivatives[:, : len(self.states)], derivatives[:, len(self.states) :]

    def _perturbations(self) -> list[Perturbation]:
        """What to differentiate by: the states, then the continuous inputs."""
        perturbations = [
            Perturbation(v, self.x, i, self.set_states) for i, v in enumerate(self.states)
        ]
        inputs = self.continuous_inputs()
        for block in self.session.blocks("Set", inputs):
            block.cells[:] = list(self.session.values(block.variables).values())
            elements = {v.name: i for i, v in enumerate(block.variables)}
            perturbations += [
                Perturbation(v, block.cells, elements[v.name], block.move) for v in inputs
            ]
        return perturbations

    def _difference(self, unknown: Sequence[Variable], by: Perturbation) -> Array:
        """The derivatives of variables by one, by central differences."""
        value = by.cells[by.element]
        h = DIFFERENCE * max(abs(value), abs(float(by.variable.nominal or 1.0)) or 1.0)
        sides = []
        for side in (value - h, value + h):
            by.cells[by.element] = side
            by.hand_over()
            values = self.session.values(unknown)
            sides.append(np.array([values[v.name] for v in unknown]))
        by.cells[by.element] = value
        by.hand_over()
        derivatives: Array = (sides[1] - sides[0]) / (2 * h)
        return derivatives
