"""A part of FMI 3.0: its types and arrays, events and clocks within a step, values within a step."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, groupby
from typing import Any

from ..errors import EventReached, FmuError, StepDiscarded
from ..fmu.library import Library
from ..system import Value
from ..system.arrays import WIDTHS
from ..system.description import ModelDescription, Variable
from .buffers import address
from .instance import CELL, DISCARD, OK, WARNING, Instance, VariableBlock
from .operations import Code, Layout, Operation
from .part import Part
from .times import coincide

UNCHANGED, CHANGED = 1, 2
RAISED, MOST_AT_ONCE = -1, 100
NEAR, PAST = 1e-6, 1e-9
NATIVE: dict[str, Any] = {name: getattr(ctypes, f"c_{name.lower()}") for name in WIDTHS} | {
    "Float32": ctypes.c_float,
    "Float64": ctypes.c_double,
    "Enumeration": ctypes.c_int64,
    "Boolean": ctypes.c_bool,
    "String": ctypes.c_char_p,
}
FINISH = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_int)


class Answer(ctypes.Structure):
    """struct answer of loop.c: the time [s] that a step has reached, and whether it met an event, the
    end of the simulation, or its own end early.
    """

    _fields_ = [
        ("reached", ctypes.c_double),
        *((name, ctypes.c_bool) for name in ("event", "ended", "early")),
    ]


class VariableBlock3(VariableBlock):
    """Variables of one type of FMI 2.0 with all elements of their arrays; Float32 are Reals too.

    Inputs that an FMU takes only in event mode, not before a step, are `held`; `entered` are the values
    that it took last.
    """

    def __init__(
        self, part: Part3, action: str, variables: Sequence[Variable], orders: Sequence[int] = ()
    ) -> None:
        families = {id(v.family): v.family for v in variables}.values()
        self.part: Part3 = part
        self.variables = sorted((v for f in families for v in f), key=lambda v: v.native)
        kind = self.variables[0].type
        self.reads, self._text = action == "Get", kind == "String"
        self.held = not self.reads and part.events and self.variables[0].variability != "continuous"
        self.real = kind == "Real" and not self.held
        self.names = [f"{part.name}.{v.name}" for v in self.variables]
        native = CELL["Real"] if kind == "Real" else NATIVE[self.variables[0].native]
        self.cells, self.entered = ((native * len(self.names))() for _ in range(2))
        self._pieces: list[tuple[Callable[[], int], Any, Any]] = []
        first = 0
        groups: Iterable[tuple[str, Iterable[Variable]]]
        groups = groupby(self.variables, lambda v: v.native)
        groups = [("OutputDerivatives", self.variables)] if orders else groups
        for name, members in groups:
            group = list(members)
            n = len(group)
            own = (native * n).from_buffer(self.cells, first * ctypes.sizeof(native))
            buffer = (ctypes.c_float * n)() if name == "Float32" else own
            references = dict.fromkeys((id(v.family), v.valueReference) for v in group)
            self.references = (ctypes.c_uint * len(references))(*(r for _, r in references))
            places = [self.references, ctypes.c_size_t(len(references))]
            if orders:
                places.append((ctypes.c_int32 * len(references))(*[orders[0]] * len(references)))
            self.call = f"{action}{'Int64' if name == 'Enumeration' else name}"
            self.function = getattr(part.library, f"fmi3{self.call}")
            call = partial(self.function, part.component, *places, buffer, ctypes.c_size_t(n))
            self._pieces.append((call, buffer, own))
            first += n
        self._plain = len(self._pieces) == 1 and self._pieces[0][1] is self._pieces[0][2]
        self._call = self._pieces[0][0] if self._plain else self._piecewise

    def _piecewise(self) -> int:
        """All pieces, those of Float32 by way of their own buffer; the worst status."""
        worst = OK
        for call, buffer, own in self._pieces:
            if not self.reads and buffer is not own:
                buffer[:] = own[:]
            status = call()
            if not OK <= status <= WARNING:
                return status
            worst = max(worst, status)
            if self.reads and buffer is not own:
                own[:] = buffer[:]
        return worst

    def layout(self) -> Layout | None:
        """None for texts, Float32, and what takes event mode."""
        layout = super().layout() if self._plain and not self.held else None
        if layout is not None:
            layout.code, layout.values = Code.EXCHANGE3, len(self.cells)
        return layout


def _reached(time: float, t: float) -> bool:
    """Whether a time [s] is not after t, but for rounding."""
    return time <= t or (time < math.inf and coincide(time, t))


class IntervalClock:
    """A clock with an interval, and the time at which it ticks next [s]."""

    def __init__(self, variable: Variable, begin: float, interval: float) -> None:
        self.variable, self.interval = variable, interval
        self.kind = variable.intervalVariability
        self.begin, self.count = begin, 0

    @property
    def due(self) -> float:
        return self.begin + self.count * self.interval if self.count else self.begin

    def tick(self) -> None:
        """Go on to the next tick; a countdown waits for a new interval."""
        if self.kind == "countdown":
            self.begin = math.inf
        else:
            self.count += 1

    def restart(self, t: float, interval: float) -> None:
        """Tick an interval [s] after the time t [s], and from there on."""
        self.begin, self.interval, self.count = t, interval, 1


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
        can = description.interface(self.SIDE)
        self.events = self.SIDE == "modelExchange" or bool(can.hasEventMode)
        shown = within if within and can.providesIntermediateUpdate else ()
        self.within = [v for v in shown if v.intermediateUpdate and v.type == "Real"]
        self.clocks: list[IntervalClock] = []
        self.due = ctypes.c_double(math.inf)
        self._kept: dict[int, Any] = {}
        self._answer = Answer()
        self._raised: Exception | None = None
        self._finish = FINISH(  # for loop.c: the events of a step, or all of one that must stop
            lambda t, h, stepped: self._status(lambda: self.advance(t, h, stepped=bool(stepped)))
        )
        self.taking = FINISH(lambda t, _, __: self._status(lambda: self.enter(t)))  # changed inputs
        super().__init__(name, description, fmu)
        if self.within:
            self._glass = VariableBlock3(self, "Get", self.within)
            self._looked = [self._glass.variables.index(v) for v in self.within]
            self.watched = [f"{name}.{v.name}" for v in self.within]

    def instantiate(self, number: int) -> None:
        def log(_: Any, status: int, __: Any, text: bytes | None) -> None:
            self.hear(status, (text or b"").decode("utf-8", "replace"))

        options: dict[str, Any] = {"loggingOn": True, "logMessage": log}
        if self.SIDE == "coSimulation":
            early = bool(self.description.interface("coSimulation").mightReturnEarlyFromDoStep)
            options |= {"eventModeUsed": self.events, "earlyReturnAllowed": early}
        if self.within:
            references = dict.fromkeys(v.valueReference for v in self.within)
            options["intermediateUpdate"] = self._look
            options["requiredIntermediateVariables"] = list(references)
        self.slave.instantiate(**options)

    def step_call(self) -> Callable[[], int]:
        a = self._answer
        fields = [getattr(Answer, name) for name in ("event", "ended", "early", "reached")]
        places = [ctypes.byref(a, field.offset) for field in fields]
        function = self.fmu.free.fmi3DoStep

        def call() -> int:
            forward = ctypes.c_bool(self.forward.value)
            times = self.begin_of_step, self.size_of_step
            status: int = function(self.component, *times, forward, *places)
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
        held = self.events and action == "Set"
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
            own = VariableBlock3(self, "Get", [variable])
            own.move()
            block.cells[:] = own.cells
        place = block.variables.index(variable)
        block.put(place, value)
        if block.held and self._initialised:
            self._event(self._now, [block])
        else:
            block.move()
        for other in self.inputs:  # which hand the whole array over once more
            if block.names[place] in other.names:
                other.put(other.names.index(block.names[place]), value)
        self._keep()

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, Binary ones as hexadecimal digits."""
        found = super().values([v for v in variables if v.type not in ("Binary", "Clock")])
        for v in variables:
            if v.type == "Binary":
                found[v.name] = self._binaries(v)[v.family.index(v)].hex()
        return {v.name: found[v.name] for v in variables if v.name in found}

    def _binaries(self, variable: Variable) -> list[bytes]:
        """All elements of a Binary."""
        found = self.call("getBinary", [variable.valueReference], len(variable.family))
        return [each or b"" for each in found]

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
        self._keep()
        if self.events:
            self._update(self._now)
            self.call("enterStepMode")
            self._happen(self._now, event=False)

    def _ticking(self, clock: Variable) -> IntervalClock:
        """A clock as it starts, with the interval of the description or what the FMU says."""
        counts = clock.intervalVariability == "countdown"
        interval, known = clock.interval, UNCHANGED
        if interval is None or counts:
            interval, known = self._interval(clock)
        if not known:
            raise FmuError(f"{self.name}.{clock.name}: the interval of the clock is not known")
        made = IntervalClock(clock, math.inf if counts else self._now + clock.shift, interval)
        if counts and known == CHANGED:
            made.restart(self._now, interval)
        return made

    def shows_events(self) -> bool:
        shown = (v for block in self.outputs for v in block.variables)
        return self.events and any(v.variability != "continuous" for v in shown)

    def step_operations(self) -> Iterator[Operation]:
        held = self._held()
        *moves, step = super().step_operations()
        yield from (move for move in moves if move not in held)
        yield from (EventModeEntry(self, block) for block in held)
        yield step

    def advance(self, t: float, h: float, *, stepped: bool = False) -> None:
        begin, end, at_once = t, t + h, 0
        while self.seen and self.seen[-1][0] > t:
            self.seen.pop()
        if not stepped and _reached(self.due.value, t):
            self._happen(t, event=False)
        while True:
            due = self.due.value
            size = h if _reached(end, due) else due - t
            if size < h:
                self._require_stop(due, begin, end)
            if not stepped:
                self.begin_of_step.value, self.size_of_step.value = t, size
                status = self.do_step()
                if status != OK:
                    self.stepped(t, size, status)
            stepped, told = False, self._answer
            reached = min(told.reached if told.early else t + size, end)
            at_once = at_once + 1 if _reached(reached, t) else 0
            if told.ended:
                raise self.ended(reached)
            if told.event:
                self._require_stop(reached, begin, end, PAST)
            if at_once > MOST_AT_ONCE:
                raise FmuError(f"{self.name}: its steps make no progress from t = {t!r} s")
            self._now = t = end if coincide(reached, end) else reached
            self._happen(t, event=told.event)
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
        self._kept[id(state)] = (self.due.value, self._now), entered, clocks

    def restore(self, state: ctypes.c_void_p) -> None:
        super().restore(state)
        (self.due.value, self._now), entered, clocks = self._kept[id(state)]
        for block, cells in zip(self._held(), entered):
            block.entered[:] = cells
        for clock, kept in zip(self.clocks, clocks):
            vars(clock).update(kept)

    def carried(self, state: ctypes.c_void_p, other: Instance) -> tuple[ctypes.c_void_p, int]:
        copy, size = super().carried(state, other)
        assert isinstance(other, Part3)
        other._kept[id(copy)] = self._kept[id(state)]
        return copy, size

    def slopes(self, unknown: Sequence[Variable], known: Variable) -> list[float]:
        families = list({id(v.family): v.family for v in unknown}.values())
        references = [family[0].valueReference for family in families]
        seed, count = [float(v is known) for v in known.family], sum(map(len, families))
        given = references, [known.valueReference], seed, count
        found = self.call("getDirectionalDerivative", *given)
        by_element = dict(zip(map(id, chain.from_iterable(families)), found))
        return [by_element[id(v)] for v in unknown]

    def enter(self, t: float) -> None:
        """Enter the inputs that event mode takes, if one has changed."""
        held = self._held()
        if any(list(block.cells) != list(block.entered) for block in held):
            self._event(t, held)
            self._keep()

    def _keep(self) -> None:
        for block in self._held():
            block.entered[:] = list(block.cells)

    def _held(self) -> list[VariableBlock3]:
        return [b for b in self.inputs if isinstance(b, VariableBlock3) and b.held]

    def _happen(self, t: float, *, event: bool) -> None:
        """Event mode at time t [s], if an event is due there, until none is; the clocks tick."""
        for _ in range(MOST_AT_ONCE):
            if not event and not _reached(self.due.value, t):
                return
            clocks = [c for c in self.clocks if _reached(c.due, t)]
            for clock in clocks:
                clock.tick()
            self._see(t)
            self._event(t, clocks=[c.variable.valueReference for c in clocks])
            self._see(t)
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

    def _look(
        self, _: Any, t: float, __: bool, may: bool, ___: bool, ____: bool, *early: Any
    ) -> None:
        """What the FMU calls within a step, when values may be got."""
        early[0][0] = False
        if may:
            with suppress(FmuError):
                self._see(t)

    def _see(self, t: float) -> None:
        """Keep what is watched as it stands at time t [s]."""
        if self.watched:
            self._glass.move()
            self.seen.append((t, [self._glass.cells[k] for k in self._looked]))

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
        places = {"cells": address(cells), "source": address(self.block.entered)}
        return Layout(Code.ENTER, size, function=entry, **places)

    def answered(self, t: float, h: float, status: int) -> None:
        self.part.stepped(t, h, status)
