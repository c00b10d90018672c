"""The FMI shell: pythonfmu's slave over one list of values that is also the whole FMU state.

pythonfmu's C wrapper turns any exception into fmi2Fatal and then drops its references to the
class, the instance and the log queue once too often; `Failure` gives them back, so that after a
failure the instance can still be reset, rolled back and freed.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import json
import math
import os
import sys
import threading
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, ClassVar, NamedTuple, NoReturn, TypeVar

from pythonfmu import Fmi2Slave

from ...declare import bounds
from ...declare.record import Value, fill
from ...declare.variables import Interface, Variable, class_name, complete
from ...step import hybrid

INSTANTIATED, INITIALIZING, STEPPING, TERMINATED, FAILED = range(5)
PHASES = (
    "before initialisation",
    "in initialisation mode",
    "after initialisation",
    "after terminate",
    "after a failure (reset the instance first)",
)
HIDDEN = ("time", "past", "stale", "phase", "guid")
WARNING = 1

_adopted = threading.local()
_stepped: deque[int] = deque(maxlen=64)


class Message(NamedTuple):
    """A log message as pythonfmu's wrapper reads it."""

    status: int
    category: str
    msg: str


class Failure(Exception):
    """Why an FMI call failed; its repr is the text that the wrapper logs."""

    def __repr__(self) -> str:
        return printable(str(self))


def printable(text: str) -> str:
    """FMI loggers take the message as a printf format."""
    return text.replace("%", "%%")


def adopt_thread() -> None:
    """Keep the Python thread state of a host's thread alive from its second step on.

    Without it CPython makes and destroys one at every FMI call from a thread it does not know;
    with it at the first step, a host that starts a thread per step would pile them up.
    """
    thread = threading.get_native_id()
    if thread in _stepped:
        ctypes.pythonapi.PyGILState_Ensure()
        _adopted.done = True
    _stepped.append(thread)


def forget_path(resources: str) -> None:
    """Take off sys.path what pythonfmu's wrapper, not its builder, puts there per instance."""
    while resources in sys.path:
        sys.path.remove(resources)


@functools.cache
def let_go_at_exit(resources: str, model: str) -> None:
    """Have pythonfmu's wrapper release the interpreter before its process ends.

    On Linux the first wrapper of a process stays loaded whatever its host does, for its symbols are
    unique. At exit it would release the interpreter twice, the second time by a write to memory that
    is free by then.
    """
    wrapper = f"/{resources.lstrip('/')}/../binaries/linux64/{model}.so"

    def let_go() -> None:
        with contextlib.suppress(OSError):  # unloaded
            ctypes.CDLL(
                os.path.normpath(wrapper), os.RTLD_NOLOAD | os.RTLD_NOW
            ).finalizePythonInterpreter()

    if sys.platform == "linux":
        atexit.register(let_go)


Method = TypeVar("Method", bound=Callable[..., Any])


def guarded(method: Method) -> Method:
    """No exception leaves a callback but a Failure that the wrapper survives."""

    @functools.wraps(method)
    def call(self: ModelSlave, *args: Any) -> Any:
        try:
            return method(self, *args)
        except BaseException as error:  # noqa: BLE001
            self.fail(error)

    return call  # type: ignore[return-value]


class ModelSlave(Fmi2Slave):  # type: ignore[misc]
    """FMI 2.0 co-simulation slave of the component `interface.model`.

    `values` holds every FMI variable at the index of its value reference, then the inputs set
    before the last step, the inputs at its end, and the HIDDEN bookkeeping.
    """

    interface: ClassVar[Interface]
    guid: ClassVar[str]
    references: ClassVar[dict[str, frozenset[int]]]
    settable: ClassVar[dict[str, tuple[frozenset[int], ...]]]
    held_reals: ClassVar[frozenset[int]]

    def __init__(self, **kwargs: Any) -> None:
        self.instance_name = kwargs["instance_name"]
        self.modelName = type(self).__name__
        self.log_queue: list[Message] = []
        if "logger" in kwargs:
            forget_path(kwargs["resources"])
            let_go_at_exit(kwargs["resources"], self.modelName)

        interface = self.interface
        count, inputs = len(interface.variables), interface.inputs
        width = inputs.stop - inputs.start
        self.values: list[Any] = [v.declaration.start for v in interface.variables]
        self.values += 2 * self.values[inputs]
        self.values += [0.0, 0.0, True, INSTANTIATED, self.guid]
        self.before = slice(count, count + width)
        self.end = slice(count + width, count + 2 * width)
        self.time, self.past, self.stale, self.phase, _ = range(len(self.values))[-len(HIDDEN) :]
        self.parameters: Any = None

    def _get_log_queue(self) -> list[Message]:
        return self.log_queue

    def fail(self, error: BaseException) -> NoReturn:
        """End in FAILED, outputs NaN, and raise what the wrapper can report."""
        reason = str(error) or type(error).__name__
        if not isinstance(error, ValueError | ArithmeticError):
            reason = f"{type(error).__name__}: {reason}"
        reasons = [*(message.msg.replace("%%", "%") for message in self.log_queue), reason]
        self.log_queue.clear()
        for v in self.interface.variables:
            if v.causality == "output" and v.declaration.kind == "Real":
                self.values[v.reference] = math.nan
        self.values[self.stale] = False
        self.values[self.phase] = FAILED
        for owner in (type(self), self, self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(owner))
        raise Failure(f"{self.instance_name}: {'; '.join(reasons)}") from None

    def warn(self, sentence: str) -> None:
        """Queue a warning for the host's log; never once per step, the wrapper leaks on it."""
        text = printable(f"{self.instance_name}: {sentence}")
        self.log_queue.append(Message(WARNING, "logStatusWarning", text))

    @guarded
    def setup_experiment(self, start: float, stop: float | None, tolerance: float | None) -> None:
        self.require("setupExperiment", INSTANTIATED)
        if not math.isfinite(start):
            raise ValueError(f"start time = {start!r} s must be a finite number")
        self.values[self.time] = start

    @guarded
    def enter_initialization_mode(self) -> None:
        self.require("enterInitializationMode", INSTANTIATED)
        self.values[self.phase] = INITIALIZING

    @guarded
    def exit_initialization_mode(self) -> None:
        self.require("exitInitializationMode", INITIALIZING)
        self.refresh()
        for sentence in self.check():
            self.warn(sentence)
        v, model = self.values, self.interface.model
        x = model.State._make(v[self.interface.states])
        now = model.Inputs._make(v[self.interface.inputs])
        v[self.interface.states] = hybrid.sample(
            model, self.parameters, v[self.time], x, None, now, self.warn
        )
        v[self.before] = now
        v[self.phase], v[self.stale] = STEPPING, True

    @guarded
    def terminate(self) -> None:
        self.require("terminate", STEPPING)
        self.values[self.phase] = TERMINATED

    @guarded
    def do_step(self, t: float, h: float) -> bool:
        v, interface = self.values, self.interface
        if not hasattr(_adopted, "done"):
            adopt_thread()
        self.require("doStep", STEPPING)
        if not 0.0 < h < math.inf:
            raise ValueError(f"communication step = {h!r} s must be a finite number above 0")
        if not abs(t - v[self.time]) <= 1e-3 * h + 1e-9 * abs(v[self.time]):
            raise ValueError(f"communication point = {t!r} s must be {v[self.time]!r} s, no jump")

        model = interface.model
        x = model.State._make(v[interface.states])
        now = model.Inputs._make(v[interface.inputs])
        before = model.Inputs._make(v[self.before])
        inputs = hybrid.course(v[interface.input_hold], before, now, v[self.past], h)
        try:
            end = self.step(t, x, before, now, inputs)
            for state, value in zip(interface.variables[interface.states], end):
                bounds.finite(state, value)
        except (ArithmeticError, ValueError) as error:
            known = interface.variables[interface.inputs] + interface.variables[interface.states]
            raise ArithmeticError(
                f"step from t = {t!r} s: {error}; {named(known, (*now, *x))}"
            ) from None

        v[interface.states] = end
        v[self.before], v[self.end] = now, inputs.end
        v[self.time], v[self.past], v[self.stale] = t + h, h, True
        return True

    def require(self, call: str, phase: int) -> None:
        """Refuse a call out of order."""
        if self.values[self.phase] != phase:
            raise ValueError(
                f"{call} is not allowed {PHASES[self.values[self.phase]]}, only {PHASES[phase]}"
            )

    def step(self, t: float, x: Any, before: Any, now: Any, inputs: hybrid.Course) -> Any:
        """The state at the end of a communication step."""
        p = self.parameters or self.read_parameters()
        return hybrid.step(self.interface.model, p, t, x, before, now, inputs, self.warn)

    def outputs(self, t: float, x: Any, u: Any) -> Sequence[Value]:
        """The outputs of a state."""
        p = self.parameters or self.read_parameters()
        outputs: Sequence[Value] = self.interface.model.outputs(p, t, x, u)
        return outputs

    def read_parameters(self) -> Any:
        """The record of the parameters as they stand in the list."""
        self.parameters = fill(
            self.interface.model.Parameters, self.values[self.interface.parameters]
        )
        return self.parameters

    def check(self) -> list[str]:
        """Warnings about the start values; raises ValueError for the impossible."""
        return list(bounds.start_values(self.interface, self.read_parameters(), self.values))

    def refresh(self) -> None:
        """Calculate the outputs from the state and the inputs at the end of the last step."""
        v, interface = self.values, self.interface
        model = interface.model
        if v[self.phase] == INITIALIZING:
            self.check()
            v[self.end] = v[interface.inputs]
        x, u = model.State._make(v[interface.states]), model.Inputs._make(v[self.end])
        if v[self.phase] == INITIALIZING:
            x = v[interface.states] = hybrid.settle(model, self.parameters, x)
        outputs = self.outputs(v[self.time], x, u)
        for output, value in zip(interface.variables[interface.outputs], outputs):
            bounds.finite(output, value)
        v[interface.outputs] = outputs
        v[self.stale] = False

    @guarded
    def get_real(self, vrs: list[int]) -> list[float]:
        values = self.values
        if not self.held_reals.issuperset(vrs):
            self.prepare("Real", vrs)
        return [values[i] for i in vrs]

    @guarded
    def get_integer(self, vrs: list[int]) -> list[int]:
        self.prepare("Integer", vrs)
        return [int(self.values[i]) for i in vrs]

    @guarded
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        self.prepare("Boolean", vrs)
        return [self.values[i] for i in vrs]

    @guarded
    def get_string(self, vrs: list[int]) -> list[str]:
        self.prepare("String", vrs)
        return [self.values[i] for i in vrs]

    def prepare(self, kind: str, vrs: Sequence[int]) -> None:
        """Refuse references that are not of this type; bring the outputs up to date."""
        if not self.references[kind].issuperset(vrs):
            for i in vrs:
                self.variable(kind, i)
        if self.values[self.stale] and self.values[self.phase] != INSTANTIATED:
            self.refresh()

    def variable(self, kind: str, reference: int) -> Variable:
        """The variable of this reference; refuses what is unknown or of another type."""
        if not 0 <= reference < len(self.interface.variables):
            raise ValueError(f"value reference {reference % 2**32} is unknown")
        variable = self.interface.variables[reference]
        if reference not in self.references[kind]:
            raise ValueError(f"{variable.name} is of type {variable.declaration.kind}, not {kind}")
        return variable

    @guarded
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        v = self.values
        settable = self.settable["Real"][v[self.phase]]
        for i, value in zip(vrs, values):
            if i not in settable or value - value != 0.0:
                self.refuse("Real", i, value)
            v[i] = value
        if v[self.phase] != STEPPING:
            v[self.stale] = True

    @guarded
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        self.set_discrete("Integer", vrs, values)

    @guarded
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        self.set_discrete("Boolean", vrs, values)

    @guarded
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        self.set_discrete("String", vrs, values)

    def set_discrete(self, kind: str, vrs: list[int], values: Sequence[Value]) -> None:
        """Store values that are not Real; enumerations are checked when initialisation ends."""
        v = self.values
        settable = self.settable[kind][v[self.phase]]
        for i, value in zip(vrs, values):
            if i not in settable:
                self.refuse(kind, i, value)
            v[i] = value
        if v[self.phase] != STEPPING:
            v[self.stale] = True

    def refuse(self, kind: str, reference: int, value: Value) -> NoReturn:
        """Raise ValueError with the reason why this variable cannot take this value now."""
        variable = self.variable(kind, reference)
        bounds.finite(variable, value)
        raise ValueError(
            f"{variable.name} = {bounds.number(value, variable.unit)} cannot be set: "
            f"{variable.variability} {variable.causality}, {PHASES[self.values[self.phase]]}"
        )

    @guarded
    def _get_fmu_state(self) -> tuple[Any, ...]:
        return tuple(self.values)

    @guarded
    def _set_fmu_state(self, state: Any) -> None:
        if not isinstance(state, tuple) or state[-1:] != (self.guid,):
            raise ValueError(
                f"FMU state is damaged or not of this build {self.guid}: {state!r:.80}"
            )
        self.values[:] = state
        self.parameters = None

    @staticmethod
    def _fmu_state_to_bytes(state: Any) -> bytes:
        """The state as text and its checksum."""
        text = json.dumps(state, default=repr).encode()
        return text + b"%08x" % zlib.crc32(text)

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> Any:
        """The state of these bytes; anything else comes back as it is, for setFMUstate to refuse."""
        text = state[:-8]
        return tuple(json.loads(text)) if state[-8:] == b"%08x" % zlib.crc32(text) else state


def named(variables: Sequence[Variable], values: Sequence[Value]) -> str:
    """Variables and their values as text: phi = 0.1 rad, w = 40.0 rad/s."""
    return ", ".join(
        f"{v.name} = {bounds.number(value, v.unit)}" for v, value in zip(variables, values)
    )


class StraightSlave(ModelSlave):
    """The slave that steps by the functions that build_fmus.py has written in straight lines."""

    straight: ClassVar[ModuleType]
    types: ClassVar[dict[str, list[tuple[int, type]]]]

    def step(self, t: float, x: Any, before: Any, now: Any, inputs: hybrid.Course) -> Any:
        course = (*inputs.start, *inputs.end, inputs.h, inputs.degree)
        end = self.straight.model_step(self.warn, self.values, t, x, before, now, course)
        return self.typed("states", end)

    def outputs(self, t: float, x: Any, u: Any) -> Sequence[Value]:
        return self.typed("outputs", self.straight.model_outputs(self.warn, self.values, t, x, u))

    def typed(self, part: str, numbers: Sequence[float]) -> Sequence[Value]:
        """The numbers of a record, Integers and Booleans as such."""
        types = self.types[part]
        if not types:
            return numbers
        values: list[Value] = list(numbers)
        for place, kind in types:
            values[place] = kind(values[place])
        return values


def slave_class(
    model: ModuleType, guid: str, straight: ModuleType | None = None
) -> type[ModelSlave]:
    """The class that pythonfmu's wrapper instantiates for a component.

    `straight` is the module that `fmukit.write.python` makes of it, if there is one.
    """
    complete(model)
    interface = Interface(model)
    references = {
        kind: frozenset(v.reference for v in interface.variables if v.kind == kind)
        for kind in ("Real", "Integer", "Boolean", "String")
    }
    everything = range(len(interface.variables))
    early = {v.reference for v in interface.variables if v.settable_before_start}
    phases = (early, early, set(everything[interface.inputs]), set[int](), set[int]())
    body = {
        "interface": interface,
        "guid": guid,
        "references": references,
        "settable": {
            kind: tuple(of_kind & phase for phase in phases) for kind, of_kind in references.items()
        },
        "held_reals": references["Real"]
        - {v.reference for v in interface.variables if v.initial == "calculated"},
    }
    if straight is None:
        return type(class_name(model), (ModelSlave,), body)
    types = {
        part: [
            (place, bool if v.kind == "Boolean" else int)
            for place, v in enumerate(interface.variables[getattr(interface, part)])
            if v.kind != "Real"
        ]
        for part in ("states", "outputs")
    }
    body |= {"straight": straight, "types": types}
    return type(class_name(model), (StraightSlave,), body)
