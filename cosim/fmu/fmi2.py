"""FMI 2.0: its variables, and a part that steps."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from typing import Any
from weakref import WeakValueDictionary

from fmpy import calloc, free
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy

from ..errors import StepDiscarded
from ..system.description import ModelDescription, Value, Variable
from .blocks import CALL, VariableBlock, block2
from .library import Library
from .messages import DISCARD, OK, WARNING, MessageLog
from .operations import Code, Layout
from .session import CO_SIMULATION, FMI2, SavedState, Session

#: Asks how far a step came: fmi2LastSuccessfulTime of fmi2StatusKind, a convention of FMI 2.0.
LAST_SUCCESSFUL_TIME = 2
#: Asks whether an FMU wants to end: fmi2Terminated of fmi2StatusKind, a convention of FMI 2.0.
TERMINATED = 3

#: The logs of the instances in this process, by the number that their messages carry.
LOGS: WeakValueDictionary[int, MessageLog] = WeakValueDictionary()
NUMBERS = count(1)


def _message(environment: int | None, _: bytes, status: int, __: bytes, message: bytes) -> None:
    """Pass a log message to the log whose number the instance carries as its environment."""
    messages = LOGS.get(environment or 0)
    if messages is not None:
        messages.on_log(status, message)


FUNCTIONS = (
    fmi2CallbackLoggerTYPE(_message),
    fmi2CallbackAllocateMemoryTYPE(calloc),
    fmi2CallbackFreeMemoryTYPE(free),
)


def _callbacks(messages: MessageLog) -> fmi2CallbackFunctions:
    """What an instance with this log may call.

    Made anew for each instance, because fmpy's proxy, which formats the messages, keeps only one logger, and
    other code in this process may have replaced it. FUNCTIONS is never freed, because the proxy may call its
    logger for any later instance.
    """
    number = next(NUMBERS)
    LOGS[number] = messages
    # FMI passes this pointer back unread, so that a number can stand in its place.
    callbacks = fmi2CallbackFunctions(*FUNCTIONS, componentEnvironment=number)
    addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


def open2(name: str, description: ModelDescription, fmu: Library, side: str) -> Session:
    """A new instance of an FMU of FMI 2.0 by one of its interfaces; raises FmuError."""
    messages = MessageLog(name)
    options = {"callbacks": _callbacks(messages), "loggingOn": True}
    return Session(messages, description, fmu, side, FMI2, options=options)


class Access2:
    """The variables of an instance of FMI 2.0."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def set_up(self, tolerance: float | None, start: float, stop: float | None) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.session.call("setupExperiment", tolerance, start, stop)
        self.session.call("enterInitializationMode")

    def blocks(self, action: str, variables: Sequence[Variable]) -> list[VariableBlock]:
        """One block per type, in the order of the variables."""
        kinds = dict.fromkeys(v.type for v in variables)
        return [
            block2(self.session, action, [v for v in variables if v.type == kind]) for kind in kinds
        ]

    def derivative_block(
        self, action: str, variables: Sequence[Variable], orders: Sequence[int]
    ) -> VariableBlock:
        """A block of derivatives of Real outputs or inputs over time, with an order for each."""
        return block2(self.session, action, variables, orders)

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable."""
        kind = CALL.get(variable.type, variable.type)
        self.session.call(f"set{kind}", [variable.valueReference], [value])

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, by their names and in their order."""
        return read_blocks(self.blocks("Get", variables), variables, self.session.name)

    def slopes(self, unknown: Sequence[Variable], by: Variable) -> list[float]:
        """The directional derivatives of variables by one, as the FMU has them."""
        references = [v.valueReference for v in unknown]
        call = self.session.call
        return list(call("getDirectionalDerivative", references, [by.valueReference], [1.0]))


def read_blocks(
    blocks: Sequence[VariableBlock], variables: Sequence[Variable], part: str
) -> dict[str, Value]:
    """The values of variables of a part, read by blocks that have them all."""
    by_name: dict[str, Any] = {}
    for block in blocks:
        block.move()
        by_name |= zip(block.names, block.cells)
    values = [by_name[f"{part}.{v.name}"] for v in variables]
    texts = (x.decode("utf-8", "replace") if isinstance(x, bytes) else x for x in values)
    return dict(zip((v.name for v in variables), texts))


class CoSimulation2:
    """A part of FMI 2.0 that steps; its events stay within its steps."""

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        within: Sequence[Variable] = (),
    ) -> None:
        self.session = open2(name, description, fmu, CO_SIMULATION)
        self.access = Access2(self.session)
        self.watched: Sequence[str] = ()
        self.intermediate_values: list[tuple[float, list[float]]] = []
        self._forward = ctypes.c_int()
        self._begin, self._size = ctypes.c_double(), ctypes.c_double()
        times = (self._begin, self._size)
        function = fmu.free.fmi2DoStep
        self._step: Callable[[], int] = partial(
            function, self.session.component, *times, self._forward
        )

    def set_up(self, tolerance: float | None, start: float, stop: float | None) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.access.set_up(tolerance, start, stop)

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable."""
        self.access.set(variable, value)

    def connect_inputs(self, blocks: Sequence[VariableBlock]) -> None:
        """Nothing: all inputs are set before a step."""

    def begin(self) -> None:
        """Leave initialisation mode for the first step."""
        self.session.begin()

    def reset(self) -> None:
        """Be as if made anew."""
        self.session.reset()

    @property
    def forward(self) -> bool:
        """Whether the master has promised never to return to an earlier time."""
        return bool(self._forward.value)

    def go_forward_only(self, *, forward: bool) -> None:
        """Promise never to return to an earlier time, or withdraw the promise."""
        self._forward.value = forward

    def step_status(self, t: float, h: float) -> int:
        """The status of a step from t by h [s], whatever it is."""
        self._begin.value, self._size.value = t, h
        return self._step()

    def advance(self, t: float, h: float) -> None:
        """Step from t by h [s]; raises FmuError, StepDiscarded, SimulationTerminated."""
        self._begin.value, self._size.value = t, h
        status = self._step()
        if status != OK:
            self.stepped(t, h, status)

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

    def step_layout(self) -> Layout:
        """The same step as `advance`, for the loop in cosim/engine/loop.c."""
        function = ctypes.cast(self.session.library.fmi2DoStep, ctypes.c_void_p).value
        return Layout(Code.STEP, function=function, component=self.session.component.value)

    def due_address(self) -> int | None:
        """None: no event is known in advance."""
        return None

    def shows_events(self, outputs: Sequence[VariableBlock]) -> bool:
        """No: a step does not end at an event."""
        return False

    def stop_at_events(self, *, stops: bool) -> None:
        """Nothing, since no event is shown."""

    def take_inputs(self, t: float) -> None:
        """Nothing: all inputs are set before a step."""

    def input_layout(self, block: VariableBlock) -> Layout | None:
        """None: no input is held."""
        return None

    def state(self) -> SavedState:
        """A place for a state of the FMU, freed with it."""
        return self.session.state()

    def save(self, state: SavedState) -> None:
        """Put the FMU's state into a place, instead of what was there."""
        self.session.save(state)

    def restore(self, state: SavedState) -> None:
        """Return to a saved state."""
        self.session.restore(state)
