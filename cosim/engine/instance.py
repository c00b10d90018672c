"""One running FMU: fmpy loads and instantiates it, prepared ctypes calls exchange and step."""

from __future__ import annotations

import ctypes
import logging
import math
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count
from math import isfinite
from typing import Any
from weakref import WeakValueDictionary

from fmpy import calloc, free
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy

from ..errors import FmuError, NonFiniteValueError, SimulationTerminated, StepDiscarded
from ..fmu.buffers import Slot, address
from ..fmu.library import Library
from ..fmu.operations import NOT_FINITE, Code, Layout, Operation
from ..system import Value
from ..system.description import ModelDescription, Variable

#: Statuses, a convention of FMI.
OK = 0
WARNING = 1
DISCARD = 2
ERROR = 3
FATAL = 4
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
#: Kinds of fmi2StatusKind, a convention of FMI 2.0.
LAST_SUCCESSFUL_TIME = 2
TERMINATED = 3
#: Sentences that a part may add to a result. A convention: more are the same fault again.
MOST_WARNINGS = 100
CELL: dict[str, Any] = {"Real": ctypes.c_double, "String": ctypes.c_char_p}
CELL |= dict.fromkeys(("Integer", "Enumeration", "Boolean"), ctypes.c_int)
CALL = {"Enumeration": "Integer"}

log = logging.getLogger("cosim")


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the warnings of FMUs out of the log; they are still in the results."""
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


INSTANCES: WeakValueDictionary[int, Instance] = WeakValueDictionary()
NUMBERS = count(1)


def _message(environment: int | None, _: bytes, status: int, __: bytes, message: bytes) -> None:
    """Hand a log message to the part of that number."""
    part = INSTANCES.get(environment or 0)
    if part is not None:
        part.on_log(status, (message or b"").decode("utf-8", "replace"))


FUNCTIONS = (
    fmi2CallbackLoggerTYPE(_message),
    fmi2CallbackAllocateMemoryTYPE(calloc),
    fmi2CallbackFreeMemoryTYPE(free),
)


def _callbacks(number: int) -> fmi2CallbackFunctions:
    """What the part of that number may call.

    Made anew for each: the proxy of fmpy, which formats the messages, has room for one logger, and
    others in this process may have put theirs there. The functions themselves stay for good, since
    the proxy goes on calling the logger for those that come later.
    """
    callbacks = fmi2CallbackFunctions(*FUNCTIONS, componentEnvironment=number)
    addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


class VariableBlock(Operation):
    """Variables of one type that are read or written in one call, and their buffer.

    With `orders`, one for each variable, these are derivatives of Real outputs or inputs. What is
    read must be finite where the block is called, not where its values are only moved.
    """

    def __init__(
        self,
        part: Instance,
        action: str,
        variables: Sequence[Variable],
        orders: Sequence[int] = (),
    ) -> None:
        kind = variables[0].type
        count = len(variables)
        self.part, self.variables = part, variables
        self.real, self.reads, self._text = kind == "Real", action == "Get", kind == "String"
        self.names = [f"{part.name}.{v.name}" for v in variables]
        self.cells = (CELL[kind] * count)()
        self.call = f"{action}{CALL.get(kind, kind)}"
        if orders:
            self.call += "OutputDerivatives" if self.reads else "InputDerivatives"
        self.references = (ctypes.c_uint * count)(*(v.valueReference for v in variables))
        self.function = getattr(part.library, f"fmi2{self.call}")
        arguments = [self.references, ctypes.c_size_t(count)]
        arguments += [(ctypes.c_int * count)(*orders)] if orders else []
        self._call: Callable[[], int] = partial(
            self.function, part.component, *arguments, self.cells
        )

    def __call__(self, t: float, h: float = 0.0) -> None:
        self.move()
        if self.reads and self.real and not all(map(isfinite, self.cells)):
            self.answered(t, h, NOT_FINITE)

    def move(self) -> None:
        """Move the buffer's values; raises FmuError."""
        status = self._call()
        if status != OK:
            self.part.answered(self.call, status)
        if self._text:  # lasts in the FMU's memory only until its next call
            self.cells[:] = [text or b"" for text in self.cells]

    def slots(self) -> dict[str, Slot]:
        """The slots of its variables by name."""
        return {name: Slot(name, self.cells, i) for i, name in enumerate(self.names)}

    def nominals(self) -> list[float]:
        """The sizes of its variables; 1 where the FMU gives none above 0."""
        return [abs(float(v.nominal or 0.0)) or 1.0 for v in self.variables]

    def put(self, i: int, value: Any) -> None:
        """Put a value into a cell."""
        self.cells[i] = value.encode() if isinstance(value, str) else value

    def layout(self) -> Layout | None:
        """None for texts."""
        if self._text:
            return None
        return Layout(
            Code.EXCHANGE,
            len(self.references),
            len(self.cells) if self.reads and self.real else 0,
            function=ctypes.cast(self.function, ctypes.c_void_p).value,
            component=self.part.component.value,
            references=address(self.references),
            cells=address(self.cells),
        )

    def answered(self, t: float, h: float, status: int) -> None:
        if status != NOT_FINITE:
            self.part.answered(self.call, status)
            return
        name, value = next(pair for pair in zip(self.names, self.cells) if not isfinite(pair[1]))
        raise NonFiniteValueError(f"{name} = {value!r} at t = {t!r} s must be a finite number")


class Instance:
    """An instance of an FMU from instantiation to `close`; raises FmuError where a call fails."""

    BLOCK: type[VariableBlock] = VariableBlock
    SIDE, FMI = "coSimulation", "fmi2"
    SERIALIZE, DESERIALIZE = "serializeFMUstate", "deSerializeFMUstate"
    FREE, GET_STATE, SET_STATE, FREE_STATE = (
        f"fmi2{call}" for call in ("FreeInstance", "GetFMUstate", "SetFMUstate", "FreeFMUstate")
    )

    def __init__(self, name: str, description: ModelDescription, fmu: Library) -> None:
        self.name = name
        self.fmu = fmu
        self.description = description
        self.log: deque[str] = deque(maxlen=20)
        self.warnings: list[str] = []
        self._complaint = ""
        self._states: list[ctypes.c_void_p] = []
        self._worst = 0
        self._initialised = self.closed = False
        self.has_event_mode = False
        self.begin_of_step, self.size_of_step = ctypes.c_double(), ctypes.c_double()
        self._stop = self.nearly = math.inf
        self.forward = ctypes.c_int()

    def open(self) -> None:
        """Make the instance, once, before all other calls; raises FmuError."""
        fmu, description, number = self.fmu, self.description, next(NUMBERS)
        INSTANCES[number] = self
        self.slave, self.library = self.functions(fmu)
        try:
            self.instantiate(number)
        except Exception as error:
            fmu.unload()
            fmu.release()
            tool = description.interface(self.SIDE).needsExecutionTool
            raise FmuError(
                f"{self.name}: instantiate failed: {self.reason()}"
                + (f"; it needs {description.generationTool or 'its tool'} to run" if tool else "")
            ) from error
        self.component = ctypes.c_void_p(self.slave.component)
        self.do_step = self.step_call()

    def functions(self, fmu: Library) -> tuple[Any, ctypes.PyDLL]:
        """What makes the instance and calls it, and the functions of its library."""
        return fmu.slave(self.name), fmu.functions

    def instantiate(self, number: int) -> None:
        """Make the instance, which logs as the part of this number."""
        self.slave.instantiate(callbacks=_callbacks(number), loggingOn=True)

    def step_call(self) -> Callable[[], int]:
        """The prepared call of a step from `begin_of_step` by `size_of_step`."""
        times = (self.begin_of_step, self.size_of_step)
        return partial(self.fmu.free.fmi2DoStep, self.component, *times, self.forward)

    def on_log(self, status: int, message: str) -> None:
        """Keep the last line of a log message, without the name that FMUs may put before it."""
        for line in message.strip().splitlines()[-1:]:
            text = re.sub(rf"(^|; )({re.escape(self.name)}: )+", r"\1", line)
            self.log.append(text)
            if status == WARNING:
                self.warn(text)
            if status in (ERROR, FATAL):
                self._complaint = text

    def warn(self, sentence: str) -> None:
        """Log a warning and keep it for the result, each sentence once."""
        if sentence not in self.warnings and len(self.warnings) < MOST_WARNINGS:
            self.warnings.append(sentence)
            log.warning("%s: %s", self.name, sentence)

    def reason(self) -> str:
        """What the FMU last complained of, or else said."""
        return self._complaint or (self.log[-1] if self.log else "the FMU gives no reason")

    def answered(self, call: str, status: int) -> None:
        """Keep a warning that the FMU did not put in words; raise FmuError for what is worse."""
        if status != WARNING:
            raise self.failure(call, status)
        if not self.warnings:
            self.warn(f"{call} returned Warning")

    def failure(self, call: str, status: int) -> FmuError:
        """The error for a call that returned this status."""
        is_status = OK < status < len(STATUS)
        self._remember(status if status in (DISCARD, FATAL) else ERROR)
        answer = STATUS[status] if is_status else f"the unknown status {status}"
        return FmuError(f"{self.name}: {call} returned {answer}: {self.reason()}")

    def _remember(self, status: int) -> None:
        """Remember the worst status; after Fatal, no instance of the FMU may be called."""
        self._worst = max(self._worst, status)
        if status == FATAL:
            self.fmu.abandon()

    def call(self, function: str, *arguments: Any) -> Any:
        """An fmpy method with its status checked; for what is not called every step."""
        try:
            return getattr(self.slave, function)(*arguments)
        except FMICallException as error:
            self._remember(error.status)
            raise FmuError(f"{self.name}: {function}: {self.reason()}") from error

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable."""
        kind = CALL.get(variable.type, variable.type)
        self.call(f"set{kind}", [variable.valueReference], [value])

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, by their names and in their order."""
        by_name: dict[str, Any] = {}
        for block in self.blocks("Get", variables):
            block.move()
            by_name |= zip(block.names, block.cells)
        values = [by_name[f"{self.name}.{v.name}"] for v in variables]
        texts = (x.decode("utf-8", "replace") if isinstance(x, bytes) else x for x in values)
        return dict(zip((v.name for v in variables), texts))

    def begin(self) -> None:
        """Leave initialisation mode for the first step."""
        self.call("exitInitializationMode")
        self._initialised = True

    def blocks(self, action: str, variables: Sequence[Variable]) -> list[VariableBlock]:
        """One Block per type, in the order of the variables."""
        kinds = dict.fromkeys(v.type for v in variables)
        return [
            self.BLOCK(self, action, [v for v in variables if v.type == kind]) for kind in kinds
        ]

    def set_up(self, tolerance: float | None, start: float, stop: float | None) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.call("setupExperiment", tolerance, start, stop)
        self.call("enterInitializationMode")

    def limit(self, stop: float) -> None:
        """Keep the time [s] beyond which no step may go."""
        self._stop, self.nearly = stop, stop - 64 * math.ulp(stop)

    def reset(self) -> None:
        """Be as if made anew."""
        self._initialised = False
        self.call("reset")

    def slopes(self, unknown: Sequence[Variable], by: Variable) -> list[float]:
        """The directional derivatives of variables by one, as the FMU has them."""
        references = [v.valueReference for v in unknown]
        return list(self.call("getDirectionalDerivative", references, [by.valueReference], [1.0]))

    def rest(self, t: float, h: float) -> float:
        """The step h from t [s], or what is left to the stop time where it differs by rounding."""
        if t + h != self._stop:
            h = self._stop - t
            while t + h > self._stop:
                h = math.nextafter(h, 0.0)
        return h

    def stepped(self, t: float, h: float, status: int) -> None:
        """Keep a warning of a step from t by h [s]; raise FmuError for a worse status."""
        call = f"doStep(t = {t!r} s, h = {h!r} s)"
        if status != DISCARD:
            self.answered(call, status)
            return
        failure = self.failure(call, status)
        answer, time, ended = self.stopped()
        reached = time if answer in (OK, WARNING) and not math.isnan(time) else t
        if ended:
            raise self.ended(reached)
        raise StepDiscarded(str(failure), reached)

    def ended(self, reached: float) -> SimulationTerminated:
        """The end of the simulation that the FMU asks for at a time [s], with its reason if it gives any."""
        message = self._complaint or (self.log[-1] if self.log else "")
        return SimulationTerminated(
            f"{self.name} ended the simulation at t = {reached!r} s"
            + (f": {message}" if message else ""),
            reached,
        )

    def stopped(self) -> tuple[int, float, bool]:
        """Of a discarded step: the status of the answer, the time reached [s], whether that is the end."""
        time, ended = ctypes.c_double(math.nan), ctypes.c_int()
        kind = ctypes.c_int(LAST_SUCCESSFUL_TIME)
        status = self.library.fmi2GetRealStatus(self.component, kind, ctypes.byref(time))
        kind = ctypes.c_int(TERMINATED)
        answer = self.library.fmi2GetBooleanStatus(self.component, kind, ctypes.byref(ended))
        return status, time.value, answer in (OK, WARNING) and bool(ended.value)

    def state(self) -> ctypes.c_void_p:
        """A place for a state of the FMU, freed with it."""
        self._states.append(ctypes.c_void_p())
        return self._states[-1]

    def save(self, state: ctypes.c_void_p) -> None:
        """Put the FMU's state into a place, instead of what was there."""
        self._free(state)
        status = getattr(self.library, self.GET_STATE)(self.component, ctypes.byref(state))
        if status != OK:
            self.answered("GetFMUstate", status)

    def restore(self, state: ctypes.c_void_p) -> None:
        """Return to a saved state."""
        status = getattr(self.library, self.SET_STATE)(self.component, state)
        if status != OK:
            self.answered("SetFMUstate", status)

    def carried(self, state: ctypes.c_void_p, other: Instance) -> tuple[ctypes.c_void_p, int]:
        """A saved state as one of another instance, by way of bytes; how many these are."""
        copy = other.state()
        content = self.call(self.SERIALIZE, state)
        other.call(self.DESERIALIZE, content, copy)
        return copy, len(content)

    def _free(self, state: ctypes.c_void_p) -> None:
        if state:
            getattr(self.library, self.FREE_STATE)(self.component, ctypes.byref(state))
            state.value = None

    def end(self) -> None:
        """Terminate; the last values can still be got."""
        self._initialised = False
        self.call("terminate")

    def close(self) -> None:
        """Terminate and free as far as the worst status of the FMU allows, the first time it is called."""
        if self.closed:
            return
        self.closed = True
        if not self.fmu.abandoned:
            for state in self._states:
                with suppress(Exception):
                    self._free(state)
            if self._initialised and self._worst < ERROR:
                with suppress(Exception):
                    self.end()
            with suppress(Exception):
                getattr(self.slave, self.FREE)(self.slave.component)
        self.fmu.release()
