"""FMI 2.0: an instance and its variables."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from weakref import WeakValueDictionary

from fmpy import calloc, free
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy

from ..system.description import ModelDescription, Value, Variable
from .blocks import CALL, VariableBlock, block2, read_blocks
from .library import Library
from .messages import MessageLog
from .session import Session

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


class Session2(Session):
    """An instance of FMI 2.0, and its variables."""

    prefix, state_name, deserialize = "fmi2", "FMUstate", "deSerializeFMUstate"
    derivatives, update = "GetDerivatives", "newDiscreteStates"

    def __init__(self, name: str, description: ModelDescription, fmu: Library, side: str) -> None:
        messages = MessageLog(name)
        super().__init__(
            messages, description, fmu, side, callbacks=_callbacks(messages), loggingOn=True
        )

    def enter_initialisation(
        self, tolerance: float | None, start: float, stop: float | None
    ) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.call("setupExperiment", tolerance, start, stop)
        self.call("enterInitializationMode")

    def blocks(self, action: str, variables: Sequence[Variable]) -> list[VariableBlock]:
        """One block per type, in the order of the variables."""
        kinds = dict.fromkeys(v.type for v in variables)
        return [block2(self, action, [v for v in variables if v.type == kind]) for kind in kinds]

    def derivative_block(
        self, action: str, variables: Sequence[Variable], orders: Sequence[int]
    ) -> VariableBlock:
        """A block of derivatives of Real outputs or inputs over time, with an order for each."""
        return block2(self, action, variables, orders)

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable."""
        kind = CALL.get(variable.type, variable.type)
        self.call(f"set{kind}", [variable.valueReference], [value])

    def reader(self, variables: Sequence[Variable]) -> Callable[[], dict[str, Value]]:
        """What reads the values of variables, by their names and in their order."""
        return partial(read_blocks, self.blocks("Get", variables), variables, self.name)

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, by their names and in their order."""
        return self.reader(variables)()

    def slopes(self, unknown: Sequence[Variable], by: Variable) -> list[float]:
        """The directional derivatives of variables by one, as the FMU has them."""
        references = [v.valueReference for v in unknown]
        return list(self.call("getDirectionalDerivative", references, [by.valueReference], [1.0]))
