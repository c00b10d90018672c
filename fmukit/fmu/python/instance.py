"""An FMI slave in Python: a table of variables, and one list of values that is also its whole state.

It computes with the `functions` of a model over plain numbers: those printed for its FMU, or those of
`runtime.equations`.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, NoReturn

from .pythonfmu import Fmi2Slave, guarded, keep_thread_state

INSTANTIATED, INITIALIZING, STEPPING, TERMINATED, FAILED = range(5)
PHASES = (
    "before initialisation",
    "in initialisation mode",
    "after initialisation",
    "after terminate",
    "after a failure (reset the instance first)",
)
HIDDEN = ("time", "past", "stale", "unchecked", "phase", "guid")
DISCRETE = ("Integer", "Boolean", "String")
TYPES: dict[str, Callable[[Any], Any]] = {"Integer": int, "Enumeration": int, "Boolean": bool}


class Variable(NamedTuple):
    """A row of the table, at the place of its value reference; the unit as it follows a number."""

    name: str
    unit: str
    fmi_type: str
    causality: str
    variability: str
    settable: bool
    calculated: bool
    start: Any

    @property
    def access_type(self) -> str:
        """The FMI type that gets and sets it."""
        return "Integer" if self.fmi_type == "Enumeration" else self.fmi_type

    def format_value(self, value: Any) -> str:
        """Name, value and unit: phi = 0.1 rad."""
        return f"{self.name} = {value!r}{self.unit}"

    def require_finite(self, value: Any) -> None:
        """Raise ValueError for NaN and infinity."""
        if self.fmi_type == "Real" and not math.isfinite(value):
            raise ValueError(f"{self.format_value(value)} must be a finite number")


def getter(kind: str) -> Callable[[Slave, list[int]], list[Any]]:
    """The callback that gets values of a type other than Real."""

    @guarded
    def get(self: Slave, vrs: list[int]) -> list[Any]:
        self.refresh_before_reading(kind, vrs)
        return [self.values[i] for i in vrs]

    return get


def setter(kind: str) -> Callable[[Slave, list[int], list[Any]], None]:
    """The callback that sets them; enumerations are checked when initialisation ends."""

    @guarded
    def set_all(self: Slave, vrs: list[int], values: list[Any]) -> None:
        v = self.values
        for i, value in zip(vrs, values):
            if i not in self.settable[kind][v[self.phase]]:
                self.refuse(kind, i, value)
            v[i] = value
        self.mark_stale(vrs)

    return set_all


class Slave(Fmi2Slave):
    """FMI 2.0 co-simulation slave of a model, which a class of its own names.

    `values` holds every FMI variable at the index of its value reference, then the inputs set
    before the last step, the inputs at its end, and the HIDDEN bookkeeping.
    """

    guid: ClassVar[str]
    variables: ClassVar[tuple[Variable, ...]]
    inputs: ClassVar[slice]
    states: ClassVar[slice]
    outputs: ClassVar[slice]
    input_hold: ClassVar[int]
    functions: ClassVar[Any]

    def __init_subclass__(cls) -> None:
        everything = range(len(cls.variables))
        early = {i for i in everything if cls.variables[i].settable}
        tunable = {i for i in everything if cls.variables[i].variability == "tunable"}
        between = set(everything[cls.inputs]) | tunable
        phases = (early, early, between, set[int](), set[int]())
        cls.input_references = frozenset(everything[cls.inputs])
        cls.references = {
            kind: frozenset(i for i in everything if cls.variables[i].access_type == kind)
            for kind in ("Real", *DISCRETE)
        }
        cls.settable = {
            kind: tuple(of_kind & phase for phase in phases)
            for kind, of_kind in cls.references.items()
        }
        assigned = cls.references["Real"].difference(
            everything[cls.states], everything[cls.outputs]
        )
        held = assigned | {i for i in cls.references["Real"] if not cls.variables[i].calculated}
        cls.held_reals = tuple(assigned if phase == INITIALIZING else held for phase in range(5))

    references: ClassVar[dict[str, frozenset[int]]]
    input_references: ClassVar[frozenset[int]]
    settable: ClassVar[dict[str, tuple[frozenset[int], ...]]]
    held_reals: ClassVar[tuple[frozenset[int], ...]]

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        count, width = len(self.variables), self.inputs.stop - self.inputs.start
        self.values: list[Any] = [v.start for v in self.variables]
        self.values += 2 * self.values[self.inputs]
        self.values += [0.0, 0.0, True, False, INSTANTIATED, self.guid]
        self.before = slice(count, count + width)
        self.end = slice(count + width, count + 2 * width)
        hidden = range(len(self.values))[-len(HIDDEN) :]
        self.time, self.past, self.stale, self.unchecked, self.phase, _ = hidden

    def fail(self, error: BaseException) -> NoReturn:
        """End in FAILED, outputs NaN, and raise what the wrapper can report."""
        for index, v in enumerate(self.variables):
            if v.causality == "output" and v.fmi_type == "Real":
                self.values[index] = math.nan
        self.values[self.stale] = False
        self.values[self.phase] = FAILED
        super().fail(error)

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
        v, now = self.values, self.values[self.inputs]
        self.functions.model_check_start(self.warn, v)
        self.functions.model_check(self.warn, v)
        start = self.functions.model_begin(self.warn, v, v[self.time], v[self.states], now)
        self.store(self.states, start)
        v[self.before], v[self.phase], v[self.stale] = now, STEPPING, True

    @guarded
    def terminate(self) -> None:
        self.require("terminate", STEPPING)
        self.values[self.phase] = TERMINATED

    @guarded
    def do_step(self, t: float, h: float) -> bool:
        v = self.values
        keep_thread_state()
        self.require("doStep", STEPPING)
        if not 0.0 < h < math.inf:
            raise ValueError(f"communication step = {h!r} s must be a finite number above 0")
        if not abs(t - v[self.time]) <= 1e-3 * h + 1e-9 * abs(v[self.time]):
            raise ValueError(f"communication point = {t!r} s must be {v[self.time]!r} s, no jump")

        if v[self.unchecked]:
            self.check_changed_parameters()
        x, before, now = v[self.states], v[self.before], v[self.inputs]
        trajectory = self.functions.model_input_trajectory(
            self.warn, v[self.input_hold], before, now, v[self.past], h
        )
        try:
            self.store(
                self.states,
                self.functions.model_step(self.warn, v, t, x, before, now, trajectory),
            )
        except (ArithmeticError, ValueError) as error:
            operands = zip(self.variables[self.inputs] + self.variables[self.states], [*now, *x])
            format_value = ", ".join(variable.format_value(value) for variable, value in operands)
            raise ArithmeticError(f"step from t = {t!r} s: {error}; {format_value}") from None

        v[self.before], v[self.end] = now, trajectory[len(now) : 2 * len(now)]
        v[self.time], v[self.past], v[self.stale] = t + h, h, True
        return True

    def require(self, call: str, phase: int) -> None:
        """Refuse a call out of order."""
        if self.values[self.phase] != phase:
            raise ValueError(
                f"{call} is not allowed {PHASES[self.values[self.phase]]}, only {PHASES[phase]}"
            )

    def store(self, part: slice, numbers: Sequence[Any]) -> None:
        """Store a record, Integers and Booleans as such; raises ValueError for NaN and infinity."""
        typed = []
        for variable, value in zip(self.variables[part], numbers, strict=True):
            variable.require_finite(value)
            typed.append(TYPES[variable.fmi_type](value) if variable.fmi_type in TYPES else value)
        self.values[part] = typed

    def refresh(self) -> None:
        """Calculate the outputs from the state and the inputs at the end of the last step."""
        v, call = self.values, self.functions
        if v[self.phase] == INITIALIZING:
            call.model_check_start(lambda _: None, v)
            call.model_check(lambda _: None, v)
            v[self.end] = v[self.inputs]
            results = call.model_initial(self.warn, v, v[self.time], v[self.states], v[self.end])
            width = self.states.stop - self.states.start
            self.store(self.states, results[:width])
            self.store(self.outputs, results[width:])
        else:
            if v[self.unchecked]:
                self.check_changed_parameters()
            x, u = v[self.states], v[self.end]
            self.store(self.outputs, call.model_outputs(self.warn, v, v[self.time], x, u))
        v[self.stale] = False

    @guarded
    def get_real(self, vrs: list[int]) -> list[float]:
        values = self.values
        if not self.held_reals[values[self.phase]].issuperset(vrs):
            self.refresh_before_reading("Real", vrs)
        return [values[i] for i in vrs]

    get_integer, get_boolean, get_string = map(getter, DISCRETE)
    set_integer, set_boolean, set_string = map(setter, DISCRETE)

    def refresh_before_reading(self, kind: str, vrs: Sequence[int]) -> None:
        """Refuse references that are not of this type; bring the outputs up to date."""
        if not self.references[kind].issuperset(vrs):
            for i in vrs:
                self.variable(kind, i)
        if self.values[self.stale] and self.values[self.phase] != INSTANTIATED:
            self.refresh()

    def variable(self, kind: str, reference: int) -> Variable:
        """The variable of this reference; refuses what is unknown or of another type."""
        if not 0 <= reference < len(self.variables):
            raise ValueError(f"value reference {reference % 2**32} is unknown")
        variable = self.variables[reference]
        if variable.access_type != kind:
            raise ValueError(f"{variable.name} is of type {variable.fmi_type}, not {kind}")
        return variable

    @guarded
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        v = self.values
        settable = self.settable["Real"][v[self.phase]]
        for i, value in zip(vrs, values):
            if i not in settable or value - value != 0.0:
                self.refuse("Real", i, value)
            v[i] = value
        self.mark_stale(vrs)

    def mark_stale(self, vrs: Sequence[int]) -> None:
        """Let what has been set act on the outputs: inputs by the next step, a tunable parameter by itself."""
        v = self.values
        if v[self.phase] != STEPPING:
            v[self.stale] = True
        elif not self.input_references.issuperset(vrs):
            v[self.stale] = v[self.unchecked] = True

    def check_changed_parameters(self) -> None:
        """Check the parameters after some of them have changed in motion."""
        self.functions.model_check(self.warn, self.values)
        self.values[self.unchecked] = False

    def refuse(self, kind: str, reference: int, value: Any) -> NoReturn:
        """Raise ValueError with the reason why this variable cannot take this value now."""
        variable = self.variable(kind, reference)
        variable.require_finite(value)
        raise ValueError(
            f"{variable.format_value(value)} cannot be set: "
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
