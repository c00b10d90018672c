"""A part of FMI 3.0: its types and arrays, events and clocks within a step, values within a step."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from typing import Any

from ..errors import EventReached, FmuError, StepDiscarded
from ..fmu.buffers import address
from ..fmu.clocks import IntervalClock, is_reached
from ..fmu.library import Library
from ..fmu.operations import Code, Layout, Operation
from ..fmu.times import coincide
from ..system import Value
from ..system.description import ModelDescription, Variable
from .blocks3 import VariableBlock3
from .instance import DISCARD, OK, Instance, VariableBlock
from .part import Part

#: Whether an FMU knows the interval of a clock, or has changed it: fmi3IntervalQualifier, a convention of FMI 3.0.
UNCHANGED = 1
CHANGED = 2
#: The status of a function of ours that raised, for loop.c. A convention: FMI has none below 0.
RAISED = -1
#: Events at one time after which a part makes no progress. A convention: cascades of a few are real.
MOST_AT_ONCE = 100
#: Share of a step at its ends within which an event belongs to the end. Derived: FMUs locate events to about that.
NEAR = 1e-6
#: Share of a step by which the others stop past an event, so that they are on its far side. Derived: far
#: below NEAR, far above rounding.
PAST = 1e-9
FINISH = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_int)


class Answer(ctypes.Structure):
    """The structure `answer` of loop.c: the time [s] that a step has reached, and why it ended there.

    It may have met an event, the end of the simulation, or its own end early.
    """

    _fields_ = [
        ("reached", ctypes.c_double),
        *((name, ctypes.c_bool) for name in ("event", "ended", "early")),
    ]


class Part3(Part):
    """A coupled part of FMI 3.0.

    A step that meets an event ends there, goes through event mode, and goes on to its end; so it does
    where a clock ticks.
    """

    BLOCK, FMI = VariableBlock3, "fmi3"
    SERIALIZE, DESERIALIZE = "serializeFMUState", "deserializeFMUState"
    FREE, GET_STATE, SET_STATE, FREE_STATE = (
        f"fmi3{call}" for call in ("FreeInstance", "GetFMUState", "SetFMUState", "FreeFMUState")
    )

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        within: Sequence[Variable] = (),
    ) -> None:
        super().__init__(name, description, fmu)
        interface = description.interface(self.SIDE)
        self.has_event_mode = self.SIDE == "modelExchange" or interface.hasEventMode
        shows = interface.providesIntermediateUpdate
        self.within = [v for v in within if shows and v.intermediateUpdate and v.type == "Real"]
        self.clocks: list[IntervalClock] = []
        self.due = ctypes.c_double(math.inf)
        self._saved: dict[int, Any] = {}
        self._answer = Answer()
        self._raised: Exception | None = None
        self._finish = FINISH(  # for loop.c: the events of a step, or all of one that must stop
            lambda t, h, stepped: self._status(lambda: self.advance(t, h, stepped=bool(stepped)))
        )
        self.taking = FINISH(lambda t, _, __: self._status(lambda: self.enter(t)))  # changed inputs

    def open(self) -> None:
        super().open()
        if self.within:
            self._observer = VariableBlock3(self, "Get", self.within)
            self._observed = [self._observer.variables.index(v) for v in self.within]
            self.watched = [f"{self.name}.{v.name}" for v in self.within]

    def instantiate(self, number: int) -> None:
        def log(_: Any, status: int, __: Any, text: bytes | None) -> None:
            self.on_log(status, (text or b"").decode("utf-8", "replace"))

        options: dict[str, Any] = {"loggingOn": True, "logMessage": log}
        if self.SIDE == "coSimulation":
            early = bool(self.description.interface("coSimulation").mightReturnEarlyFromDoStep)
            options |= {"eventModeUsed": self.has_event_mode, "earlyReturnAllowed": early}
        if self.within:
            references = dict.fromkeys(v.valueReference for v in self.within)
            options["intermediateUpdate"] = self._on_intermediate_update
            options["requiredIntermediateVariables"] = list(references)
        self.slave.instantiate(**options)

    def step_call(self) -> Callable[[], int]:
        a = self._answer
        fields = [getattr(Answer, name) for name in ("event", "ended", "early", "reached")]
        results = [ctypes.byref(a, field.offset) for field in fields]
        function = self.fmu.free.fmi3DoStep

        def call() -> int:
            forward = ctypes.c_bool(self.forward.value)
            times = self.begin_of_step, self.size_of_step
            status: int = function(self.component, *times, forward, *results)
            return status

        return call

    def step_layout(self) -> Layout:
        return Layout(
            Code.STEP3,
            function=ctypes.cast(self.library.fmi3DoStep, ctypes.c_void_p).value,
            component=self.component.value,
            cells=ctypes.addressof(self._answer),
            first=ctypes.addressof(self.due),
            source=ctypes.cast(self._finish, ctypes.c_void_p).value,
        )

    def blocks(self, action: str, variables: Sequence[Variable]) -> list[VariableBlock]:
        """One Block per type, or two where event mode takes a share of the inputs."""
        held = self.has_event_mode and action == "Set"
        kinds: dict[Any, list[Variable]] = {}
        for v in variables:
            name = "Real" if v.type == "Real" else v.native
            kinds.setdefault((name, held and v.variability != "continuous"), []).append(v)
        return [VariableBlock3(self, action, some) for some in kinds.values()]

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable, in event mode if steps have begun."""
        if variable.type == "Binary":
            texts = self._binaries(variable)
            texts[variable.family.index(variable)] = bytes.fromhex(str(value))
            self.call("setBinary", [variable.valueReference], texts)
            return
        block = VariableBlock3(self, "Set", [variable])
        if len(block.cells) > 1:
            present = VariableBlock3(self, "Get", [variable])
            present.move()
            block.cells[:] = present.cells
        index = block.variables.index(variable)
        block.put(index, value)
        if block.held and self._initialised:
            self._event(self._now, [block])
        else:
            block.move()
        for other in self.inputs:  # which hand the whole array over once more
            if block.names[index] in other.names:
                other.put(other.names.index(block.names[index]), value)
        self._mark_entered()

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, Binary ones as hexadecimal digits."""
        values = super().values([v for v in variables if v.type not in ("Binary", "Clock")])
        for v in variables:
            if v.type == "Binary":
                values[v.name] = self._binaries(v)[v.family.index(v)].hex()
        return {v.name: values[v.name] for v in variables if v.name in values}

    def _binaries(self, variable: Variable) -> list[bytes]:
        """All elements of a Binary."""
        elements = self.call("getBinary", [variable.valueReference], len(variable.family))
        return [element or b"" for element in elements]

    def set_up(self, tolerance: float | None, start: float, stop: float | None) -> None:
        self._now = start
        self.call("enterInitializationMode", tolerance, start, stop)

    def begin(self) -> None:
        """Leave initialisation mode for the first step, with the events and ticks of the start."""
        self.clocks.clear()
        for v in self.description.modelVariables:
            if v.type == "Clock" and v.causality == "input":
                self.clocks.append(self._ticking(v))
        super().begin()
        self._mark_entered()
        if self.has_event_mode:
            self._update(self._now)
            self.call("enterStepMode")
            self._happen(self._now, event=False)

    def _ticking(self, clock: Variable) -> IntervalClock:
        """A clock as it starts, with the interval of the description or what the FMU says."""
        counts = clock.intervalVariability == "countdown"
        interval, qualifier = clock.interval, UNCHANGED
        if interval is None or counts:
            interval, qualifier = self._interval(clock)
        if not qualifier:
            raise FmuError(f"{self.name}.{clock.name}: the interval of the clock is not known")
        ticking = IntervalClock(clock, math.inf if counts else self._now + clock.shift, interval)
        if counts and qualifier == CHANGED:
            ticking.restart(self._now, interval)
        return ticking

    def shows_events(self) -> bool:
        outputs = (v for block in self.outputs for v in block.variables)
        return self.has_event_mode and any(v.variability != "continuous" for v in outputs)

    def step_operations(self) -> Iterator[Operation]:
        held = self._held()
        *moves, step = super().step_operations()
        yield from (move for move in moves if move not in held)
        yield from (EventModeEntry(self, block) for block in held)
        yield step

    def advance(self, t: float, h: float, *, stepped: bool = False) -> None:
        begin, end, at_once = t, t + h, 0
        while self.intermediate_values and self.intermediate_values[-1][0] > t:
            self.intermediate_values.pop()
        if not stepped and is_reached(self.due.value, t):
            self._happen(t, event=False)
        while True:
            due = self.due.value
            size = h if is_reached(end, due) else due - t
            if size < h:
                self._require_stop(due, begin, end)
            if not stepped:
                self.begin_of_step.value, self.size_of_step.value = t, size
                status = self.do_step()
                if status != OK:
                    self.stepped(t, size, status)
            stepped, answer = False, self._answer
            reached = min(answer.reached if answer.early else t + size, end)
            at_once = at_once + 1 if is_reached(reached, t) else 0
            if answer.ended:
                raise self.ended(reached)
            if answer.event:
                self._require_stop(reached, begin, end, PAST)
            if at_once > MOST_AT_ONCE:
                raise FmuError(f"{self.name}: its steps make no progress from t = {t!r} s")
            self._now = t = end if coincide(reached, end) else reached
            self._happen(t, event=answer.event)
            if t == end:
                return
            h = end - t

    def _require_stop(self, t: float, begin: float, end: float, past: float = 0.0) -> None:
        """Refuse a step in which an event is at time t [s], if all are to stop there or just past it."""
        size = end - begin
        if self.stops and begin + NEAR * size < t < end - NEAR * size:
            raise EventReached(f"{self.name} has an event at t = {t!r} s", t + past * size)

    def stepped(self, t: float, h: float, status: int) -> None:
        if status == RAISED and self._raised is not None:
            raise self._raised
        call = f"doStep(t = {t!r} s, h = {h!r} s)"
        if status == DISCARD:
            reached = self._answer.reached
            raise StepDiscarded(
                str(self.failure(call, status)), reached if t < reached < t + h else t
            )
        self.answered(call, status)

    def save(self, state: ctypes.c_void_p) -> None:
        super().save(state)
        clocks = [vars(clock).copy() for clock in self.clocks]
        entered = [list(block.entered) for block in self._held()]
        self._saved[id(state)] = (self.due.value, self._now), entered, clocks

    def restore(self, state: ctypes.c_void_p) -> None:
        super().restore(state)
        (self.due.value, self._now), entered, clocks = self._saved[id(state)]
        for block, cells in zip(self._held(), entered):
            block.entered[:] = cells
        for clock, saved in zip(self.clocks, clocks):
            vars(clock).update(saved)

    def carried(self, state: ctypes.c_void_p, other: Instance) -> tuple[ctypes.c_void_p, int]:
        copy, size = super().carried(state, other)
        assert isinstance(other, Part3)
        other._saved[id(copy)] = self._saved[id(state)]
        return copy, size

    def slopes(self, unknown: Sequence[Variable], by: Variable) -> list[float]:
        families = list({id(v.family): v.family for v in unknown}.values())
        references = [family[0].valueReference for family in families]
        seed, count = [float(v is by) for v in by.family], sum(map(len, families))
        arguments = references, [by.valueReference], seed, count
        derivatives = self.call("getDirectionalDerivative", *arguments)
        by_element = dict(zip(map(id, chain.from_iterable(families)), derivatives))
        return [by_element[id(v)] for v in unknown]

    def enter(self, t: float) -> None:
        """Enter the inputs that event mode takes, if one has changed."""
        held = self._held()
        if any(list(block.cells) != list(block.entered) for block in held):
            self._event(t, held)
            self._mark_entered()

    def _mark_entered(self) -> None:
        for block in self._held():
            block.entered[:] = list(block.cells)

    def _held(self) -> list[VariableBlock3]:
        return [b for b in self.inputs if isinstance(b, VariableBlock3) and b.held]

    def _happen(self, t: float, *, event: bool) -> None:
        """Event mode at time t [s], if an event is due there, until none is; the clocks tick."""
        for _ in range(MOST_AT_ONCE):
            if not event and not is_reached(self.due.value, t):
                return
            clocks = [c for c in self.clocks if is_reached(c.due, t)]
            for clock in clocks:
                clock.tick()
            self._observe(t)
            self._event(t, clocks=[c.variable.valueReference for c in clocks])
            self._observe(t)
            event = False
        raise FmuError(f"{self.name}: events follow each other without end at t = {t!r} s")

    def _event(
        self, t: float, blocks: Iterable[VariableBlock] = (), clocks: Sequence[int] = ()
    ) -> None:
        """Event mode, in which inputs are set and clocks are active, and back."""
        self.call("enterEventMode")
        for block in blocks:
            block.move()
        if clocks:
            self.call("setClock", clocks, [True] * len(clocks))
        self._update(t)
        self.call("enterStepMode")

    def _update(self, t: float) -> None:
        """Iterate event mode; learn when the next event and the next ticks are due."""
        for _ in range(MOST_AT_ONCE):
            again, end, _, _, timed, time = self.call("updateDiscreteStates")
            if end:
                raise self.ended(t)
            if not again:
                break
        else:
            raise FmuError(f"{self.name}: its discrete states do not settle at t = {t!r} s")
        for clock in self.clocks:
            if clock.kind in ("tunable", "changing", "countdown"):
                interval, qualifier = self._interval(clock.variable)
                if qualifier == CHANGED:
                    clock.restart(t, interval)
        event = time if timed else math.inf
        self.due.value = min([event, *(clock.due for clock in self.clocks)])

    def _interval(self, clock: Variable) -> tuple[float, int]:
        """The interval of a clock [s], and whether the FMU knows it (1) or has changed it (2)."""
        interval, qualifier = (ctypes.c_double * 1)(), (ctypes.c_int * 1)()
        reference = (ctypes.c_uint * 1)(clock.valueReference)
        self.call("getIntervalDecimal", reference, interval, qualifier)
        return interval[0], qualifier[0]

    def _on_intermediate_update(
        self, _: Any, t: float, __: bool, may: bool, ___: bool, ____: bool, *early: Any
    ) -> None:
        """What the FMU calls within a step, when values may be got."""
        early[0][0] = False
        if may:
            with suppress(FmuError):
                self._observe(t)

    def _observe(self, t: float) -> None:
        """Keep what is watched as it stands at time t [s]."""
        if self.watched:
            self._observer.move()
            self.intermediate_values.append((t, [self._observer.cells[k] for k in self._observed]))

    def _status(self, act: Callable[[], None]) -> int:
        try:
            act()
        except Exception as error:  # noqa: BLE001
            self._raised = error
            return RAISED
        return OK


class EventModeEntry(Operation):
    """Enters the inputs of a part that take event mode, if one of a block has changed."""

    def __init__(self, part: Part3, block: VariableBlock3) -> None:
        self.part, self.block = part, block

    def __call__(self, t: float, h: float) -> None:
        self.part.enter(t)

    def layout(self) -> Layout | None:
        """None for texts, whose memory is Python's."""
        cells = self.block.cells
        if cells._type_ is ctypes.c_char_p:
            return None
        entry, size = ctypes.cast(self.part.taking, ctypes.c_void_p).value, ctypes.sizeof(cells)
        source = address(self.block.entered)
        return Layout(Code.ENTER, size, function=entry, cells=address(cells), source=source)

    def answered(self, t: float, h: float, status: int) -> None:
        self.part.stepped(t, h, status)
