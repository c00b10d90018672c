"""Members of an ensemble in C: one system again and again with other start values, by members.c."""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..fmu.buffers import address
from ..fmu.messages import FATAL, WARNING
from ..fmu.operations import Layout
from ..system import Network, Port, Value
from ..system.description import Variable
from .changes import continuous_profiles
from .control import Adaptive
from .initialise import START_ROUNDING, is_set_again, keeps, start_values
from .loop import Column, Loop, library
from .part import Part
from .settings import RunSettings
from .sources import InputSource

Array = NDArray[np.float64]
#: Statuses of a member: it is done; done, with a warning that an FMU returned; left to Python, to which the status
#: of the FMU is added that ended it.
DONE, WARNED, LEFT = range(3)
#: Longest time in C [s], after which signals and progress are looked at.
PATIENCE = 0.05
#: The whole numbers that a double holds exactly.
EXACT = 2**53
#: Means of inputs over time that are kept for all members. Chosen: 80 MB of them.
MOST_MEANS = 10**7
INT, LONG, DOUBLE, PLACE = ctypes.c_int, ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p


class NeedsPythonError(Exception):
    """The members of this system take the way through Python, with the reason."""


class InstanceLayout(ctypes.Structure):
    """struct instance of members.c."""

    _fields_ = [
        *((name, INT) for name in ("version", "has_tolerance", "has_stop")),
        *((name, PLACE) for name in ("component", "reset", "set_up", "initialise", "leave")),
        *((name, PLACE) for name in ("update", "enter_steps")),
        ("tolerance", DOUBLE),
        ("due", PLACE),
    ]


class SpanLayout(ctypes.Structure):
    """struct span of members.c."""

    _fields_ = [
        *((name, DOUBLE) for name in ("h", "stop")),
        *((name, LONG) for name in ("count", "every")),
        ("means", PLACE),
    ]


class Setting(ctypes.Structure):
    """struct setting of members.c."""

    _fields_ = [("cell", PLACE), ("type", INT), ("number", INT)]


class Memory(ctypes.Structure):
    """struct memory of members.c."""

    _fields_ = [("cells", PLACE), ("initial", PLACE), ("size", INT), ("real", INT)]


class Listener(ctypes.Structure):
    """struct listener of members.c."""

    _fields_ = [
        *((name, PLACE) for name in ("links", "exchanges", "inputs")),
        *((name, INT) for name in ("n_links", "n_exchanges", "n_inputs")),
    ]


class Promise(ctypes.Structure):
    """struct promise of members.c."""

    _fields_ = [("cell", Column), ("number", INT), ("real", INT)]


class Side(ctypes.Structure):
    """struct side of members.c."""

    _fields_ = [("totals", PLACE), ("output", PLACE)]


class EnsembleLayout(ctypes.Structure):
    """struct ensemble of members.c."""

    _fields_ = [
        *((name, PLACE) for name in ("instances", "starts", "again", "outputs", "kept")),
        *((name, PLACE) for name in ("settings", "settings_again", "initial", "entered")),
        *((name, PLACE) for name in ("listeners", "promises", "sides", "program", "feeds")),
        *((name, PLACE) for name in ("columns", "shared", "scratch", "warned")),
        *((name, INT) for name in ("n_instances", "n_starts", "n_again", "n_outputs", "n_kept")),
        *((name, INT) for name in ("n_initial", "n_entered", "n_listeners", "n_promises")),
        *((name, INT) for name in ("n_sides", "n_feeds", "length", "row_begin", "width")),
        *((name, INT) for name in ("n_values", "most_exchanges")),
        *((name, DOUBLE) for name in ("start", "share_kept")),
    ]


class Place(ctypes.Structure):
    """struct place of members.c: the member that is worked on, and the steps of it that are done."""

    _fields_ = [("member", LONG), ("steps", LONG)]


class Span(NamedTuple):
    """The communication step of a member and its stop [s]."""

    step: float | Adaptive
    stop: float


@dataclass(frozen=True)
class Block:
    """Some members, in memory that C fills: n of them.

    Attributes
    ----------
    numbers
        Those of the members, shape (n,).
    values
        What they differ in, shape (n, names).
    spans
        How long each runs, n of SpanLayout.
    rows
        Shape (n, rows, columns), the time first.
    counts
        How many of the rows each has, shape (n,).
    work
        Energy given and exchanged [J] over each side of a bond, shape (n, sides, 2).
    status
        DONE, WARNED, or LEFT and more, shape (n,).
    """

    numbers: NDArray[np.int64]
    values: Array
    spans: Any
    rows: Array
    counts: NDArray[np.int64]
    work: Array
    status: NDArray[np.int32]


class Members:
    """The members of a system whose parts are wired, initialised and laid out once.

    They differ in the values of `names`; the start values of the network must have these. `place` is the one that is
    worked on, among the `numbers` of a block. Messages of the parts
    go to `warnings`: by the sentence, the numbers of the members. Raises NeedsPythonError where a member needs Python.
    """

    def __init__(
        self,
        network: Network,
        settings: RunSettings,
        parts: Mapping[str, Part],
        loop: Loop,
        names: Sequence[str],
    ) -> None:
        """The `parts` are in their stepping order, and `loop` has their steps."""
        self._parts, self._settings, self._loop = parts, settings, loop
        self._keep: list[Any] = []
        self._index = {name: k for k, name in enumerate(names)}
        self._shared: list[float] = []
        self.place = Place(0, -1)
        self.numbers: Any = [0]
        self.warnings: dict[str, list[int]] = {}
        self.layout = EnsembleLayout(
            program=ctypes.addressof(loop.layouts),
            columns=ctypes.addressof(loop.columns),
            length=len(loop.layouts),
            row_begin=loop.row_begin,
            width=len(loop.columns),
            n_values=len(names),
            start=settings.start,
            share_kept=START_ROUNDING,
        )
        self._spans: dict[tuple[float, float, float | None], SpanLayout] = {}
        self._feeds = [
            k for k, timed in enumerate(loop.operations) if isinstance(timed.operation, InputSource)
        ]
        self._array("feeds", INT, self._feeds, counted=True)
        self._warned = (LONG * max(1, len(loop.layouts)))()
        self.layout.warned = ctypes.addressof(self._warned)
        self._lay_out_instances(network)
        self._lay_out_starts(network)
        self._lay_out_promises(network)
        self._lay_out_coupling(network)
        self._array("shared", DOUBLE, self._shared)

    def energy(self, block: Block) -> dict[str, Array]:
        """Energy given, taken and exchanged [J] over each power bond, shape (n, 3)."""
        pairs: dict[str, list[int]] = {}
        for k, side in enumerate(self._bond_sides):
            pairs.setdefault(side.bond, []).append(k)
        energy = {}
        for bond, pair in pairs.items():
            first, second = sorted(pair, key=lambda k: self._bond_sides[k].side)
            exchanged = np.maximum(block.work[:, first, 1], block.work[:, second, 1])
            energy[bond] = np.stack(
                [block.work[:, first, 0], block.work[:, second, 0], exchanged], 1
            )
        return energy

    def _span(self, h: float, stop: float, output_step: float | None) -> SpanLayout:
        """Steps of h [s] to the stop, with rows so far apart [s]; raises NeedsPythonError."""
        key = h, stop, output_step
        if key not in self._spans:
            settings = replace(self._settings, step=h, stop=stop, output_step=output_step)
            every, count = settings.every(), settings.number()
            if every is None:
                raise NeedsPythonError("rows lie between steps")
            means = self._means(count, h, stop) if self._feeds else None
            self._spans[key] = SpanLayout(h, stop, count, every, means)
        return self._spans[key]

    def _means(self, count: int, h: float, stop: float) -> int:
        """Where the means of the inputs over time in each of the steps stand."""
        start, last = self._settings.start, count - 1
        feeds = [self._loop.operations[k] for k in self._feeds]
        if len(feeds) * count > MOST_MEANS:
            raise NeedsPythonError("the means of inputs over time do not fit into memory")
        t_last = start + last * h
        h_last = h if t_last + h == stop else stop - t_last
        addresses = []
        for feed, at, size in feeds:
            assert isinstance(feed, InputSource)
            times = [start + n * h + at * h for n in range(last)]
            means = [feed.profile.mean(t, size * h) for t in times]
            means.append(feed.profile.mean(t_last + at * h_last, size * h_last))
            addresses.append(self._kept((DOUBLE * count)(*means)))
        return self._kept((PLACE * len(addresses))(*addresses))

    def block(
        self,
        numbers: NDArray[np.int64],
        values: Array,
        spans: Sequence[Span],
        output_step: float | None,
    ) -> Block:
        """Memory for members of these numbers with these values; raises NeedsPythonError."""
        layouts = [self._span(float(h), stop, output_step) for h, stop in spans]  # type: ignore[arg-type]
        n, most = len(values), max((2 + (x.count - 1) // x.every for x in layouts), default=0)
        return Block(
            numbers,
            np.ascontiguousarray(values, np.float64),
            (SpanLayout * n)(*layouts),
            np.empty((n, most, self.layout.width + 1)),
            np.zeros(n, np.int64),
            np.zeros((n, self.layout.n_sides, 2)),
            np.zeros(n, np.int32),
        )

    def run(self, block: Block) -> Iterator[int]:
        """Run the members; how many are done, every PATIENCE or so. It ends early after the status Fatal."""
        place, n, most = self.place, len(block.values), 1 << 10
        self.numbers[:n] = block.numbers.tolist()
        place.member, place.steps = 0, -1
        self._resume()
        while place.member < n:
            began = clock.perf_counter()
            library().run_members(
                ctypes.byref(self.layout), ctypes.byref(place), block.spans, n, most, block.values.ctypes,
                block.rows.ctypes, block.rows.shape[1], block.counts.ctypes, block.work.ctypes,
                block.status.ctypes,
            )  # fmt: skip
            most = most * 2 if clock.perf_counter() - began < PATIENCE else max(most // 2, 1)
            last = int(block.status[place.member - 1]) if place.steps < 0 else DONE
            if last == WARNED:
                self._warn(block.spans[place.member - 1].h)
            yield place.member
            if last == LEFT + FATAL:
                return

    def _warn(self, h: float) -> None:
        """Let the parts warn of what calls of the last member, whose steps are h [s], have returned."""
        self.place.member -= 1
        for k, n in enumerate(self._warned):
            if n:
                operation, at, size = self._loop.operations[k]
                t = self._settings.start + (n - 1) * h
                operation.answered(t + at * h, size * h, WARNING)
        self.place.member += 1

    def _resume(self) -> None:
        """Let the instances be those of these members again, after others have used them."""
        for part in self._parts.values():
            part.instance.connect_inputs(part.inputs)
            part.instance.go_forward_only(forward=True)
            part.instance.stop_at_events(stops=False)
            part.messages.on_warning = self._note

    def _note(self, part: str, sentence: str) -> None:
        """Keep a warning of a part for the present member."""
        number = int(self.numbers[self.place.member])
        members = self.warnings.setdefault(f"{part}: {sentence}", [])
        if members[-1:] != [number]:
            members.append(number)

    def _kept(self, array: Any) -> int:
        """Where an array stands, which lives as long as this."""
        self._keep.append(array)
        return ctypes.addressof(array)

    def _array(self, field: str, kind: Any, items: Sequence[Any], *, counted: bool = False) -> None:
        """Set a field of the layout to an array, and if it is `counted` another one to its length."""
        setattr(self.layout, field, self._kept((kind * max(1, len(items)))(*items)))
        if counted:
            setattr(self.layout, f"n_{field}", len(items))

    def _number(self, port: Port, value: Value) -> int:
        """The number of a start value."""
        if isinstance(value, str):
            raise NeedsPythonError(f"{port} is a {port.type}")
        if abs(value) > EXACT and port.type != "Real":
            raise NeedsPythonError(f"{port} = {value!r} is no double")
        if port.name in self._index:
            return self._index[port.name]
        self._shared.append(float(value))
        return len(self._index) + len(self._shared) - 1

    def _lay_out_instances(self, network: Network) -> None:
        """How instances are reset and initialised, in the order of the system."""
        layouts = []
        for name in network.system.parts:
            session = self._parts[name].instance.session
            tolerance = self._settings.tolerance
            if tolerance is None:
                tolerance = session.description.defaultExperiment.tolerance
            has_stop = self._settings.stop_time_defined or session.is_told_stop
            clocks = [v for v in session.description.modelVariables if v.type == "Clock"]
            if any(v.causality == "input" for v in clocks):
                raise NeedsPythonError(f"{name} has clocks")
            is_fmi3 = session.description.fmiVersion == "3.0"
            names = {"reset": "Reset", "initialise": "EnterInitializationMode"}
            names |= {"leave": "ExitInitializationMode"}
            if not is_fmi3:
                names["set_up"] = "SetupExperiment"
            elif session.interface.hasEventMode:
                names |= {"update": "UpdateDiscreteStates", "enter_steps": "EnterStepMode"}
            functions = {k: ctypes.cast(session.function(v), PLACE).value for k, v in names.items()}
            layouts.append(
                InstanceLayout(
                    version=3 if is_fmi3 else 2,
                    has_tolerance=tolerance is not None,
                    tolerance=tolerance or 0.0,
                    has_stop=has_stop,
                    component=session.component.value,
                    due=self._parts[name].instance.due_address(),
                    **functions,
                )
            )
        self._array("instances", InstanceLayout, layouts, counted=True)

    def _lay_out_starts(self, network: Network) -> None:
        """The start values that are set before an instance is initialised, and again while it is."""
        starts = start_values(network, self._settings.start).values()
        by_part = [s for name in network.system.parts for s in starts if s[0].part == name]
        again = [(port, value) for port, value in starts if is_set_again(port)]
        for field, settings, some in (
            ("starts", "settings", by_part),
            ("again", "settings_again", again),
        ):
            pairs = [pair for port, value in some for pair in self._start(port, value)]
            self._array(field, Layout, [layout for layout, _ in pairs], counted=True)
            self._array(settings, Setting, [setting for _, setting in pairs])

    def _start(self, port: Port, value: Value) -> Iterator[tuple[Layout, Setting]]:
        """What sets a start value: of an element of an array, after the others have been read."""
        access = self._parts[port.part].instance.access
        [block] = access.blocks("Set", [port.variable])
        layout = block.exchange_layout()
        if layout is None:
            raise NeedsPythonError(f"{port} is not set by one call in C")
        self._keep.append(block)
        if len(block.cells) > 1:
            [present] = access.blocks("Get", [port.variable])
            reading = present.exchange_layout()
            assert reading is not None
            self._keep.append(present)
            reading.cells = layout.cells
            yield reading, Setting(number=-1)
        index, kind = block.variables.index(port.variable), block.cells._type_
        cell = address(block.cells, index)
        yield layout, Setting(cell=cell, type=ord(kind._type_), number=self._number(port, value))

    def _lay_out_promises(self, network: Network) -> None:
        """The start values that instances are to keep."""
        by_part: dict[str, dict[str, tuple[Port, Value]]] = {}
        for port, value in start_values(network, self._settings.start).values():
            if port.variable.causality != "input" and keeps(port):
                by_part.setdefault(port.part, {})[port.variable.name] = (port, value)
        reads, promises = [], []
        for name, ports in by_part.items():
            variables: list[Variable] = [port.variable for port, _ in ports.values()]
            for block in self._parts[name].instance.access.blocks("Get", variables):
                reads.append(self._layout(block))
                for slot, variable in zip(block.slots().values(), block.variables):
                    if variable.name in ports:
                        port, value = ports[variable.name]
                        column = Column(slot.address, ord(slot.kind._type_))
                        number = self._number(port, value)
                        promises.append(Promise(column, number, port.type == "Real"))
        self._array("kept", Layout, reads, counted=True)
        self._array("promises", Promise, promises, counted=True)

    def _layout(self, operation: Any) -> Layout:
        """An operation in C; raises NeedsPythonError if it needs Python."""
        exchange = getattr(operation, "exchange_layout", operation.layout)
        layout: Layout | None = exchange()
        if layout is None:
            raise NeedsPythonError("a value is moved by Python")
        self._keep.append(operation)
        return layout

    def _lay_out_coupling(self, network: Network) -> None:
        """How the inputs begin and settle, and the sides of bonds."""
        moving = [port for port, _ in continuous_profiles(network)]
        for port, _ in network.inputs:
            if port not in moving:
                raise NeedsPythonError(f"{port} changes between steps")
        initial, entered, listeners, outputs, cells = [], [], [], [], 0
        most = 1
        for part in self._parts.values():
            inputs = []
            for block, begin in zip(part.inputs, part.initial_inputs):
                copy = self._kept(ctypes.create_string_buffer(begin, max(1, len(begin))))
                where = ctypes.addressof(block.cells)
                inputs.append(Memory(where, copy, len(begin), block.real))
                if block.entered is not None:
                    entered.append(
                        Memory(ctypes.addressof(block.entered), where, len(begin), block.real)
                    )
                cells += len(block.cells)
            initial += inputs
            for feed in part.feeds:
                value = DOUBLE(float(feed.profile.at(self._settings.start)))
                initial.append(Memory(ctypes.addressof(feed.cell), self._kept(value), 8, 1))
            most = max(most, sum(memory.size for memory in inputs))
            reads = [self._layout(block) for block in part.outputs]
            outputs += reads
            links = [self._layout(link) for link in part.links]
            exchanges = [*map(self._layout, part.inputs), *reads]
            listeners.append(
                Listener(
                    self._kept((Layout * max(1, len(links)))(*links)),
                    self._kept((Layout * max(1, len(exchanges)))(*exchanges)),
                    self._kept((Memory * max(1, len(inputs)))(*inputs)),
                    len(links),
                    len(exchanges),
                    len(inputs),
                )
            )
        self._array("initial", Memory, initial, counted=True)
        self._array("entered", Memory, entered, counted=True)
        self._array("listeners", Listener, listeners, counted=True)
        self._array("outputs", Layout, outputs, counted=True)
        self.layout.scratch = self._kept(ctypes.create_string_buffer(most))
        self.layout.most_exchanges = 2 + cells
        self._bond_sides = [side for part in self._parts.values() for side in part.bond_sides]
        sides = [Side(address(side.totals), side.output.address) for side in self._bond_sides]
        self._array("sides", Side, sides, counted=True)
