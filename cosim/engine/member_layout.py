"""How a system is laid out for members.c: what its parts begin with, keep and listen to, and how long members run."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..fmu.buffers import address
from ..fmu.operations import COperation
from ..system import Network, Port, Value
from .changes import continuous_profiles
from .compiler import MEMBERS
from .initialise import start_values
from .loop import Column, Loop
from .part import Part
from .settings import RunSettings
from .sources import InputSource
from .structures import DOUBLE, INT, LONG, PLACE, structures

#: The whole numbers that a double holds exactly.
EXACT = 2**53
#: Means of inputs over time that are kept for all members. Chosen: 80 MB of them.
MOST_MEANS = 10**7
STRUCTURES = structures(MEMBERS.read_text(), column=Column)
InstanceLayout, SpanLayout, Setting, Memory, Listener, Side, EnsembleLayout = (
    STRUCTURES[name]
    for name in ("instance", "span", "setting", "memory", "listener", "side", "ensemble")
)


class NeedsPythonError(Exception):
    """The members of this system take the way through Python, with the reason."""


class SystemLayout:
    """A system whose parts are wired and initialised, as members.c reads it.

    Members differ in the values of `names`; the start values of the network must have these. `warned`
    takes the step after which an operation of the `loop` has returned a warning last. Raises NeedsPythonError where a member needs Python.
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
        self.parts, self.settings, self.loop = parts, settings, loop
        self._keep: list[Any] = []
        self._index = {name: k for k, name in enumerate(names)}
        self._shared: list[float] = []
        self.ensemble = EnsembleLayout(
            program=ctypes.addressof(loop.c_operations),
            columns=ctypes.addressof(loop.columns),
            length=len(loop.c_operations),
            row_begin=loop.row_begin,
            width=len(loop.columns),
            n_values=len(names),
            start=settings.start,
        )
        self._known: dict[tuple[float, float, float | None], Any] = {}
        self._feeds = [
            k for k, timed in enumerate(loop.operations) if isinstance(timed.operation, InputSource)
        ]
        self._array("feeds", INT, self._feeds, counted=True)
        self.warned = (LONG * max(1, len(loop.c_operations)))()
        self.ensemble.warned = ctypes.addressof(self.warned)
        self._lay_out_resets(network)
        self._lay_out_starts(network)
        self._lay_out_inputs_and_bonds(network)
        self._array("shared", DOUBLE, self._shared)

    def span(self, h: float, stop: float, output_step: float | None) -> Any:
        """Steps of h [s] to the stop, with rows so far apart [s]; raises NeedsPythonError."""
        key = h, stop, output_step
        if key not in self._known:
            settings = replace(self.settings, step=h, stop=stop, output_step=output_step)
            every, count = settings.steps_per_row(), settings.number()
            if every is None:
                raise NeedsPythonError("rows lie between steps")
            means = self._address_of_means(count, h, stop) if self._feeds else None
            self._known[key] = SpanLayout(h, stop, count, every, means)
        return self._known[key]

    def _address_of_means(self, count: int, h: float, stop: float) -> int:
        """Where the means of the inputs over time in each of the steps stand."""
        start, last = self.settings.start, count - 1
        feeds = [self.loop.operations[k] for k in self._feeds]
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
            addresses.append(self._address_of((DOUBLE * count)(*means)))
        return self._address_of((PLACE * len(addresses))(*addresses))

    def _address_of(self, array: Any) -> int:
        """Where an array stands, which lives as long as this."""
        self._keep.append(array)
        return ctypes.addressof(array)

    def _array(self, field: str, kind: Any, items: Sequence[Any], *, counted: bool = False) -> None:
        """Set a field of the layout to an array, and if it is `counted` another one to its length."""
        setattr(self.ensemble, field, self._address_of((kind * max(1, len(items)))(*items)))
        if counted:
            setattr(self.ensemble, f"n_{field}", len(items))

    def _index_of_value(self, port: Port, value: Value) -> int:
        """The number of a start value."""
        if isinstance(value, str):
            raise NeedsPythonError(f"{port} is a {port.type}")
        if abs(value) > EXACT and port.type != "Real":
            raise NeedsPythonError(f"{port} = {value!r} is no double")
        if port.name in self._index:
            return self._index[port.name]
        self._shared.append(float(value))
        return len(self._index) + len(self._shared) - 1

    def _lay_out_resets(self, network: Network) -> None:
        """How instances are reset and initialised, in the order of the system."""
        layouts = []
        for name in network.system.parts:
            session = self.parts[name].instance.session
            tolerance = self.settings.tolerance
            if tolerance is None:
                tolerance = session.description.defaultExperiment.tolerance
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
                    has_stop=self.settings.stop_time_defined,
                    component=session.component.value,
                    due=self.parts[name].instance.next_event_address(),
                    **functions,
                )
            )
        self._array("instances", InstanceLayout, layouts, counted=True)

    def _lay_out_starts(self, network: Network) -> None:
        """The start values, which are set before an instance is initialised."""
        starts = start_values(network, self.settings.start).values()
        operations, settings = [], []
        for name in network.system.parts:
            for port, value in (start for start in starts if start[0].part == name):
                [block] = self.parts[name].instance.session.blocks("Set", [port.variable])
                operations.append(self._c_operation(block))
                kind, number = ord(block.cells._type_._type_), self._index_of_value(port, value)
                settings.append(Setting(address(block.cells), kind, number))
        self._array("starts", COperation, operations, counted=True)
        self._array("settings", Setting, settings)

    def _c_operation(self, operation: Any) -> COperation:
        """An operation in C; raises NeedsPythonError if it needs Python."""
        exchange = getattr(operation, "exchange_c_operation", operation.c_operation)
        c_operation: COperation | None = exchange()
        if c_operation is None:
            raise NeedsPythonError("a value is moved by Python")
        self._keep.append(operation)
        return c_operation

    def _lay_out_inputs_and_bonds(self, network: Network) -> None:
        """How the inputs begin and settle, and the sides of bonds."""
        moving = [port for port, _ in continuous_profiles(network)]
        for port, _ in network.inputs:
            if port not in moving:
                raise NeedsPythonError(f"{port} changes between steps")
        initial, entered, listeners, outputs, cells = [], [], [], [], 0
        most = 1
        for part in self.parts.values():
            inputs = []
            for block, begin in zip(part.inputs, part.initial_inputs):
                copy = self._address_of(ctypes.create_string_buffer(begin, max(1, len(begin))))
                where = ctypes.addressof(block.cells)
                inputs.append(Memory(where, copy, len(begin), block.real))
                if block.entered is not None:
                    entered.append(
                        Memory(ctypes.addressof(block.entered), where, len(begin), block.real)
                    )
                cells += len(block.cells)
            initial += inputs
            for feed in part.feeds:
                value = DOUBLE(float(feed.profile.at(self.settings.start)))
                initial.append(Memory(ctypes.addressof(feed.cell), self._address_of(value), 8, 1))
            most = max(most, sum(memory.size for memory in inputs))
            reads = [self._c_operation(block) for block in part.outputs]
            outputs += reads
            links = [self._c_operation(link) for link in part.links]
            exchanges = [*map(self._c_operation, part.inputs), *reads]
            listeners.append(
                Listener(
                    self._address_of((COperation * max(1, len(links)))(*links)),
                    self._address_of((COperation * max(1, len(exchanges)))(*exchanges)),
                    self._address_of((Memory * max(1, len(inputs)))(*inputs)),
                    len(links),
                    len(exchanges),
                    len(inputs),
                )
            )
        self._array("initial", Memory, initial, counted=True)
        self._array("entered", Memory, entered, counted=True)
        self._array("listeners", Listener, listeners, counted=True)
        self._array("outputs", COperation, outputs, counted=True)
        self.ensemble.scratch = self._address_of(ctypes.create_string_buffer(most))
        self.ensemble.most_exchanges = 2 + cells
        self.bond_sides = [side for part in self.parts.values() for side in part.bond_sides]
        sides = [Side(address(side.totals), side.output.address) for side in self.bond_sides]
        self._array("sides", Side, sides, counted=True)
