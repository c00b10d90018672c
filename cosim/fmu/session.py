"""One instance of an FMU as a component of its C library: calls with their statuses, and saved states."""

from __future__ import annotations

import ctypes
import re
from contextlib import suppress
from typing import Any, NamedTuple

from fmpy.fmi1 import FMICallException

from ..errors import FmuError, SimulationTerminated
from ..system.description import ModelDescription
from .clocks import EventState
from .library import Library
from .messages import DISCARD, ERROR, FATAL, OK, STATUS, WARNING, MessageLog

#: The interfaces of an FMU, by the names of the model description.
CO_SIMULATION = "coSimulation"
MODEL_EXCHANGE = "modelExchange"


#: What to do where a call is refused or answered so.
HINTS = {
    "Pending": "; a step that goes on after doStep has returned is not supported",
    "SetRealInputDerivatives": "; run without --input-order",
}


class SerializedState(NamedTuple):
    """The state of an FMU as bytes, which any instance of it may take, and what the master keeps of its events."""

    content: bytes
    events: EventState | None


class SavedState:
    """A place for the state of an FMU, and for what the master keeps of its events."""

    def __init__(self) -> None:
        self.pointer = ctypes.c_void_p()
        self.events: EventState | None = None


class Session:
    """An instance of an FMU from its instantiation to `close`; raises FmuError where a call fails.

    `component` is the instance for functions of `library`, `binding` the same for those of FMPy. It `is_stepping` from its
    initialisation until it is terminated. One that `is_told_stop` does not initialise without a stop time. How a version of
    FMI names what both have stands in the class: functions of the C library come after the `prefix`; `deserialize` and `update` are methods of FMPy.
    """

    prefix = state_name = deserialize = derivatives = update = ""

    def __init__(
        self,
        messages: MessageLog,
        description: ModelDescription,
        fmu: Library,
        side: str,
        **options: object,
    ) -> None:
        """Instantiate with these options of FMPy; raises FmuError, and then releases the library."""
        self.name, self.messages = messages.name, messages
        messages.describe(description)
        self.description, self.interface = description, description.offered_interface(side)
        self.fmu, self.side = fmu, side
        self.closed = False
        self._states: list[SavedState] = []
        self._worst = OK
        self.is_stepping = self.is_told_stop = False
        if side == MODEL_EXCHANGE:
            self.binding = fmu.new_model(self.name, description)
            self.library = ctypes.PyDLL(None, handle=self.binding.dll._handle)
        else:
            self.binding, self.library = fmu.new_slave(self.name), fmu.functions
        try:
            self.binding.instantiate(**options)
        except Exception as error:
            fmu.forget()
            fmu.release()
            raise FmuError(f"{self.name}: instantiate failed: {self._reason()}") from error
        self.component = ctypes.c_void_p(self.binding.component)

    def _reason(self) -> str:
        """Why a call failed, and until initialisation is over the tool that the FMU needs."""
        module = re.match(
            r"ModuleNotFoundError: No module named '([\w.]+)'", self.messages.reason()
        )
        if module is not None:
            return f"{self.messages.reason()}: install {module[1]}"
        is_needed = self.interface.needsExecutionTool and not self.is_stepping
        tool = self.description.generationTool or "its tool"
        return self.messages.reason() + (f"; it needs {tool} to run" if is_needed else "")

    def function(self, name: str) -> Any:
        """The C function of this name after the prefix of the version."""
        return getattr(self.library, self.prefix + name)

    def call(self, method: str, *arguments: Any) -> Any:
        """A method of FMPy with its status checked; for what is not called every step."""
        try:
            return getattr(self.binding, method)(*arguments)
        except FMICallException as error:
            self._remember(error.status)
            raise FmuError(f"{self.name}: {method}: {self._reason()}") from error

    def answered(self, call: str, status: int) -> None:
        """Keep a warning that the FMU did not put in words; raise FmuError for what is worse."""
        if status != WARNING:
            raise self.failure(call, status)
        if not self.messages.warnings:
            self.messages.keep_warning(f"{call} returned Warning")

    def failure(self, call: str, status: int) -> FmuError:
        """The error for a call that returned this status."""
        is_status = OK < status < len(STATUS)
        self._remember(status if status in (DISCARD, FATAL) else ERROR)
        answer = STATUS[status] if is_status else f"the unknown status {status}"
        hint = next((text for word, text in HINTS.items() if word in (call, answer)), "")
        return FmuError(f"{self.name}: {call} returned {answer}: {self._reason()}{hint}")

    def terminated(self, reached: float) -> SimulationTerminated:
        """The end of the simulation that the FMU asks for at a time [s], with its reason if it gives any."""
        message = self.messages.last()
        return SimulationTerminated(
            f"{self.name} ended the simulation at t = {reached!r} s"
            + (f": {message}" if message else ""),
            reached,
        )

    def _remember(self, status: int) -> None:
        """Remember the worst status; after Fatal, no instance of the FMU may be called."""
        self._worst = max(self._worst, status)
        if status == FATAL:
            self.fmu.abandon()

    def leave_initialisation(self) -> None:
        """Leave initialisation mode for the first step."""
        self.call("exitInitializationMode")
        self.is_stepping = True

    def reset(self) -> None:
        """Be as if made anew; saved states are freed."""
        self.is_stepping = False
        self.messages.clear()
        while self._states:
            self.drop(self._states.pop())
        self.call("reset")
        self._worst = OK

    def new_state(self) -> SavedState:
        """A place for a state of the FMU, freed with it."""
        self._states.append(SavedState())
        return self._states[-1]

    def save(self, state: SavedState) -> None:
        """Put the FMU's state into a place, instead of what was there."""
        self.drop(state)
        status = self.function(f"Get{self.state_name}")(self.component, ctypes.byref(state.pointer))
        if status != OK:
            self.answered("GetFMUstate", status)

    def restore(self, state: SavedState) -> None:
        """Return to a saved state."""
        status = self.function(f"Set{self.state_name}")(self.component, state.pointer)
        if status != OK:
            self.answered("SetFMUstate", status)
        self.is_stepping = True

    def serialized(self, state: SavedState) -> SerializedState:
        """A saved state as bytes."""
        content = self.call(f"serialize{self.state_name}", state.pointer)
        return SerializedState(content, state.events)

    def deserialized(self, state: SerializedState) -> SavedState:
        """A place with a state of another instance."""
        place = self.new_state()
        self.call(self.deserialize, state.content, place.pointer)
        place.events = state.events
        return place

    def drop(self, state: SavedState) -> None:
        """Free what is in a place."""
        if state.pointer:
            free = self.function(f"Free{self.state_name}")
            free(self.component, ctypes.byref(state.pointer))
            state.pointer.value = None

    def terminate(self) -> None:
        """Terminate; the last values can still be got."""
        self.is_stepping = False
        self.call("terminate")

    def close(self) -> None:
        """Terminate and free as far as the worst status of the FMU allows, the first time it is called."""
        if self.closed:
            return
        self.closed = True
        if not self.fmu.abandoned:
            for state in self._states:
                with suppress(Exception):
                    self.drop(state)
            if self.is_stepping and self._worst < ERROR:
                with suppress(Exception):
                    self.terminate()
            with suppress(Exception):
                free = getattr(self.binding, f"{self.prefix}FreeInstance")
                free(self.binding.component)
        self.fmu.release()
        if self.side == MODEL_EXCHANGE and not self.fmu.abandoned:
            self.binding.freeLibrary()
