"""FMI 2.0: a part that steps."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from functools import partial

from ..errors import StepDiscarded
from ..system.description import ModelDescription, Variable
from .instance import CoSimulation
from .library import Library
from .messages import DISCARD, OK, WARNING
from .operations import Code, COperation
from .session import CO_SIMULATION
from .session2 import Session2

#: Asks how far a step came: fmi2LastSuccessfulTime of fmi2StatusKind, a convention of FMI 2.0.
LAST_SUCCESSFUL_TIME = 2
#: Asks whether an FMU wants to end: fmi2Terminated of fmi2StatusKind, a convention of FMI 2.0.
TERMINATED = 3


class CoSimulation2(CoSimulation):
    """A part of FMI 2.0 that steps; its events stay within its steps."""

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        _: Sequence[Variable] = (),
    ) -> None:
        session = Session2(name, description, fmu, CO_SIMULATION)
        super().__init__(session, ctypes.c_int())
        arguments = session.component, self._begin, self._size, self._forward
        self._step = partial(fmu.free.fmi2DoStep, *arguments)

    def stepped(self, t: float, h: float, status: int) -> None:
        """Keep a warning of a step from t by h [s]; raise FmuError for a worse status.

        For Discard it raises SimulationTerminated if the FMU asks for the end, else StepDiscarded.
        """
        call = f"doStep(t = {t!r} s, h = {h!r} s)"
        if status != DISCARD:
            self.session.answered(call, status)
            return
        failure = self.session.failure(call, status)
        answer, time, ended = self.last_success()
        reached = time if answer in (OK, WARNING) and not math.isnan(time) else t
        if ended:
            raise self.session.terminated(reached)
        raise StepDiscarded(str(failure), reached)

    def last_success(self) -> tuple[int, float, bool]:
        """Of a discarded step: the status of the answer, the time reached [s], whether that is the end."""
        library, component = self.session.library, self.session.component
        time, ended = ctypes.c_double(math.nan), ctypes.c_int()
        kind = ctypes.c_int(LAST_SUCCESSFUL_TIME)
        status = library.fmi2GetRealStatus(component, kind, ctypes.byref(time))
        kind = ctypes.c_int(TERMINATED)
        answer = library.fmi2GetBooleanStatus(component, kind, ctypes.byref(ended))
        return status, time.value, answer in (OK, WARNING) and bool(ended.value)

    def step_c_operation(self) -> COperation:
        """The same step as `advance`, for the loop in cosim/engine/loop.c."""
        function = ctypes.cast(self.session.library.fmi2DoStep, ctypes.c_void_p).value
        return COperation(Code.STEP, function=function, component=self.session.component.value)
