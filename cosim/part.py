"""One running FMU: fmpy loads and instantiates it, prepared ctypes calls exchange and step."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from fmpy import calloc, free
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy
from fmpy.model_description import ModelDescription, ScalarVariable
from numpy.typing import NDArray

from .errors import PartFailure
from .system import Value

WARNING = 1
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
CELL: dict[str, Any] = {
    "Real": ctypes.c_double,
    "Integer": ctypes.c_int,
    "Enumeration": ctypes.c_int,
    "Boolean": ctypes.c_int,
}
CALL = {"Enumeration": "Integer"}


PARTS: WeakValueDictionary[bytes, Part] = WeakValueDictionary()


def _message(_: Any, instance: bytes, status: int, __: bytes, message: bytes) -> None:
    """Hand a log message to the part of that name; fmpy's proxy has room for one logger only."""
    part = PARTS.get(instance)
    if part is not None:
        part.hear(status, message.decode("utf-8", "replace"))


CALLBACKS = fmi2CallbackFunctions(
    fmi2CallbackLoggerTYPE(_message),
    fmi2CallbackAllocateMemoryTYPE(calloc),
    fmi2CallbackFreeMemoryTYPE(free),
)
addLoggerProxy(ctypes.byref(CALLBACKS))


class Block:
    """Variables of one type that are read or written in one call, and their buffer."""

    def __init__(self, part: Part, action: str, variables: Sequence[ScalarVariable]) -> None:
        kind = variables[0].type
        count = len(variables)
        self.real = kind == "Real"
        self.names = [f"{part.name}.{v.name}" for v in variables]
        self.cells = (CELL[kind] * count)()
        self.part = part
        self.call = f"{action}{CALL.get(kind, kind)}"
        references = (ctypes.c_uint * count)(*(v.valueReference for v in variables))
        function = getattr(part.library, f"fmi2{self.call}")
        self._move = partial(
            function, part.component, references, ctypes.c_size_t(count), self.cells
        )

    def __call__(self) -> None:
        """Move the buffer's values; raises PartFailure."""
        status = self._move()
        if status > WARNING:
            raise self.part.failure(self.call, status)

    def require_finite(self) -> None:
        """Raise PartFailure for a value that no wire may carry."""
        if isfinite(sum(self.cells)):
            return
        for cell, name in zip(self.cells, self.names):
            if not isfinite(cell):
                raise PartFailure(f"{name} = {cell!r} must be a finite number")


class Part:
    """An instance of an FMU from instantiation to `close`; raises PartFailure where a call fails."""

    def __init__(self, name: str, description: ModelDescription, folder: Path) -> None:
        self.name = name
        self.description = description
        self.log: deque[str] = deque(maxlen=20)
        self.warnings: list[str] = []
        self.inputs: list[Block] = []
        self.outputs: list[Block] = []
        self.copies: list[tuple[Any, int, Any, int]] = []
        self.scaled: list[tuple[Any, int, Any, int, float, float]] = []
        PARTS[name.encode()] = self
        try:
            self.slave = FMU2Slave(
                guid=description.guid,
                unzipDirectory=str(folder),
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=name,
            )
            self.slave.instantiate(callbacks=CALLBACKS, loggingOn=True)
        except Exception as error:
            raise PartFailure(f"{name}: instantiate failed: {self.reason() or error}") from error
        self.library = ctypes.PyDLL(None, handle=self.slave.dll._handle)
        self.component = ctypes.c_void_p(self.slave.component)
        self._time, self._size = ctypes.c_double(), ctypes.c_double()
        self._state = ctypes.c_void_p()
        self._do_step = partial(
            self.library.fmi2DoStep, self.component, self._time, self._size, ctypes.c_int(1)
        )

    def hear(self, status: int, message: str) -> None:
        """Keep the last line of a log message."""
        text = message.strip().splitlines()[-1:]
        self.log.extend(text)
        if status == WARNING:
            self.warnings.extend(text)

    def reason(self) -> str:
        """The FMU's last log message."""
        return self.log[-1] if self.log else ""

    def failure(self, call: str, status: int) -> PartFailure:
        """The error for a call that returned this status."""
        return PartFailure(f"{self.name}: {call} returned {STATUS[status]}: {self.reason()}")

    def call(self, function: str, *arguments: Any) -> None:
        """An fmpy method with its status checked; for what is not called every step."""
        try:
            getattr(self.slave, function)(*arguments)
        except Exception as error:
            raise PartFailure(f"{self.name}: {function}: {self.reason() or error}") from error

    def set(self, variable: ScalarVariable, value: Value) -> None:
        """Set one variable."""
        kind = CALL.get(variable.type, variable.type)
        self.call(f"set{kind}", [variable.valueReference], [value])

    def get(self, variable: ScalarVariable) -> Value:
        """Get one variable."""
        kind = CALL.get(variable.type, variable.type)
        value: Value = getattr(self.slave, f"get{kind}")([variable.valueReference])[0]
        return value.decode() if isinstance(value, bytes) else value

    def blocks(self, action: str, variables: Sequence[ScalarVariable]) -> list[Block]:
        """One Block per type, in the order of the variables."""
        kinds = dict.fromkeys(v.type for v in variables)
        return [Block(self, action, [v for v in variables if v.type == kind]) for kind in kinds]

    def read(self) -> None:
        """Fetch the wired outputs."""
        for block in self.outputs:
            block()
            block.require_finite()

    def wire(self, target: Any, i: int, source: Any, j: int, factor: float, offset: float) -> None:
        """Let input cell `target[i]` follow factor * source[j] + offset."""
        if (factor, offset) == (1.0, 0.0):
            self.copies.append((target, i, source, j))
        else:
            self.scaled.append((target, i, source, j, factor, offset))

    def listen(self) -> bool:
        """Bring the values of the wires; whether any has changed."""
        before = [bytes(block.cells) for block in self.inputs]
        self._bring()
        return before != [bytes(block.cells) for block in self.inputs]

    def _bring(self) -> None:
        for target, i, source, j in self.copies:
            target[i] = source[j]
        for target, i, source, j, factor, offset in self.scaled:
            target[i] = factor * source[j] + offset

    def send(self) -> None:
        """Hand the inputs over as they stand in the buffers."""
        for block in self.inputs:
            block()

    def write(self) -> None:
        """Bring the values of the wires and hand them over."""
        self._bring()
        self.send()

    def real_inputs(self) -> NDArray[np.float64]:
        """The wired Real inputs as they stand in the buffers, shape (n,)."""
        blocks = [np.array(b.cells) for b in self.inputs if b.real]
        return np.concatenate(blocks) if blocks else np.empty(0)

    def real_input_names(self) -> list[str]:
        """The names of `real_inputs`."""
        return [name for block in self.inputs if block.real for name in block.names]

    def take_reals(self, values: NDArray[np.float64]) -> int:
        """Fill the wired Real inputs from the beginning of `values`; how many there were."""
        count = 0
        for block in self.inputs:
            if block.real:
                size = len(block.cells)
                block.cells[:] = values[count : count + size].tolist()
                count += size
        return count

    def save(self) -> None:
        """Remember the FMU's state in place of the one saved before."""
        self.forget()
        status = self.library.fmi2GetFMUstate(self.component, ctypes.byref(self._state))
        if status > WARNING:
            raise self.failure("getFMUstate", status)

    def restore(self) -> None:
        """Return to the state saved last."""
        status = self.library.fmi2SetFMUstate(self.component, self._state)
        if status > WARNING:
            raise self.failure("setFMUstate", status)

    def forget(self) -> None:
        """Free the saved state."""
        if self._state:
            self.library.fmi2FreeFMUstate(self.component, ctypes.byref(self._state))
            self._state = ctypes.c_void_p()

    def step(self, time: float, size: float) -> None:
        """Advance from `time` by `size` seconds."""
        self._time.value, self._size.value = time, size
        status = self._do_step()
        if status > WARNING:
            raise self.failure(f"doStep(t = {time!r} s, h = {size!r} s)", status)

    def close(self) -> None:
        """Terminate if possible, free in any case."""
        with suppress(Exception):
            self.forget()
        with suppress(Exception):
            self.slave.terminate()
        with suppress(Exception):
            self.slave.freeInstance()
