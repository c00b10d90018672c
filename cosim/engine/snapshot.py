"""The state of a system at a communication point, to come back to in a run, or to begin another run with."""

from __future__ import annotations

from collections.abc import Mapping, MutableSequence, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ..errors import SetupError
from ..fmu.instance import CoSimulation
from ..fmu.session import SavedState, SerializedState
from ..system import Value
from .hermite import Node, SignalHistory
from .part import Part


def _cells(part: Part) -> list[MutableSequence[object]]:
    """The arrays of ctypes that the master keeps of a part from step to step.

    Inputs are among them: an array is handed over whole, with elements that no wire brings anew.
    """
    blocks = [block.cells for block in (*part.inputs, *part.outputs)]
    return blocks + [s.totals for s in part.bond_sides] + [feed.cell for feed in part.feeds]


def _contents(part: Part) -> list[str]:
    """What stands in each of these arrays."""
    blocks = [", ".join(block.names) for block in (*part.inputs, *part.outputs)]
    totals = [f"energy of {side.bond}" for side in part.bond_sides]
    return blocks + totals + [f"mean of {feed.name}" for feed in part.feeds]


def _signals(part: Part) -> list[SignalHistory]:
    """The histories of the outputs that inputs follow within steps."""
    return part.curves.signals if part.curves is not None else []


class Snapshot:
    """One place for the state of the parts; `take` overwrites what was there."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self._states = [(part.instance, part.instance.session.new_state()) for part in parts]
        self._cells = [cells for part in parts for cells in _cells(part)]
        self._signals = [signal for part in parts for signal in _signals(part)]
        self._values: list[list[object]] = []
        self._nodes: list[list[Node]] = []

    def take(self) -> None:
        """Remember the parts as they are now; raises FmuError."""
        for instance, state in self._states:
            instance.save(state)
        self._values = [list(cells) for cells in self._cells]
        self._nodes = [signal.nodes for signal in self._signals]

    def restore_fmus(self) -> None:
        """Bring the FMUs back, not what the master keeps; raises FmuError."""
        for instance, state in self._states:
            instance.restore(state)

    def restore(self, *, keeps_nodes: bool = False) -> None:
        """Bring back everything, or all but the nodes of moving inputs, which then predict; raises FmuError."""
        self.restore_fmus()
        for cells, values in zip(self._cells, self._values):
            cells[:] = values
        if not keeps_nodes:
            for signal, nodes in zip(self._signals, self._nodes):
                signal.nodes = nodes


class StepMemory(NamedTuple):
    """What adaptive steps go on with: their control, the next step [s], the share that the last used, largest values."""

    control: str
    h: float
    before: float
    largest: list[float]


class LiveState(NamedTuple):
    """The state of an FMU that cannot serialise it, and the instance that alone may take it, once.

    A run promises its FMUs that it will not go back, so that no other may begin where it has.
    """

    instance: CoSimulation
    state: SavedState

    @property
    def is_gone(self) -> bool:
        """Whether a run has begun with it, or the instance may not be called any more."""
        session = self.instance.session
        return session.closed or session.fmu.abandoned or not self.state.pointer


class PartState(NamedTuple):
    """A part: the GUID of its FMU, the FMU's state, the values that the master keeps by what they are, and the nodes of its outputs."""

    guid: str
    fmu: SerializedState | LiveState
    values: dict[str, list[object]]
    nodes: list[list[Node]]


@dataclass(frozen=True)
class SystemState:
    """A whole system at a communication point, with which runs may begin.

    It can be pickled, and any number of runs may begin with it. Where an FMU cannot serialise its state, one run may, while
    the `Prepared` that handed it out is open.

    Attributes
    ----------
    time
        When it was there [s].
    start
        The start [s] from which its communication steps are counted.
    stop_told
        The stop time [s] that FMUs know; infinite if none does.
    step
        The communication step of its run [s]; None if steps were adaptive.
    start_values
        The start values of its run, by name.
    system_start
        Those of the system that was run, which a case may have replaced.
    tolerance
        The tolerance that FMUs were told; None where each was told its own.
    inputs_before
        The values just before `time` of inputs over time and of parameters that change, by name.
    broken_until
        The end [s] of a break in which the state lies, see `Result`; `time` if it lies in none.
    parts
        What is known of each part, by name.
    memory
        What the control of adaptive steps goes on with.
    """

    time: float
    start: float
    stop_told: float
    step: float | None
    start_values: Mapping[str, Value]
    system_start: Mapping[str, Value] = field(repr=False)
    tolerance: float | None
    inputs_before: Mapping[str, Value] = field(repr=False)
    broken_until: float
    parts: Mapping[str, PartState] = field(repr=False)
    memory: StepMemory | None = field(repr=False)

    @property
    def is_sound(self) -> bool:
        """Whether it has what `run_until` hands out, which nobody has taken out of it."""
        times = (self.time, self.start, self.stop_told, self.broken_until)
        mappings = (self.start_values, self.system_start, self.inputs_before, self.parts)
        return (
            all(isinstance(x, float | int) for x in times)
            and all(isinstance(x, Mapping) for x in mappings)
            and all(isinstance(x, PartState) for x in self.parts.values())
        )

    @property
    def live(self) -> dict[str, CoSimulation]:
        """The instances that alone may take their state, by part."""
        parts = self.parts.items()
        return {n: part.fmu.instance for n, part in parts if isinstance(part.fmu, LiveState)}


@dataclass(frozen=True)
class Case:
    """Start values of one run, over those of the system, or the state of a paused run to `begin` with: not both."""

    start: Mapping[str, Value] = field(default_factory=dict)
    begin: SystemState | None = None


def part_state(part: Part) -> PartState:
    """The state of a part at a communication point; raises FmuError."""
    instance = part.instance
    instance.save(state := instance.session.new_state())
    values = dict(zip(_contents(part), map(list, _cells(part))))
    nodes = [signal.nodes for signal in _signals(part)]
    can_serialize = instance.session.interface.canSerializeFMUstate
    fmu = instance.session.serialized(state) if can_serialize else LiveState(instance, state)
    return PartState(part.description.guid, fmu, values, nodes)


def require_same_buffers(part: Part, state: PartState) -> None:
    """Raise SetupError for the state of a part with other wires, inputs over time or moving inputs."""
    if other := sorted(set(_contents(part)) ^ state.values.keys()):
        raise SetupError(
            f"{part.name}: the state is of a system with other wires or inputs over time: {other[0]}"
        )
    if len(_signals(part)) != len(state.nodes):
        text = "above 0, and this run has 0" if state.nodes else "= 0: write input_order=0"
        raise SetupError(f"{part.name}: the state was made with input_order {text}")


def resume(part: Part, state: PartState) -> None:
    """Bring a part that has not been initialised to a state with the same buffers; raises FmuError."""
    session = part.instance.session
    if isinstance(state.fmu, LiveState):
        session.messages.clear()
        part.instance.restore(state.fmu.state)
        session.drop(state.fmu.state)
    else:
        part.instance.restore(session.deserialized(state.fmu))
    for name, cells in zip(_contents(part), _cells(part)):
        cells[:] = state.values[name]
    for signal, nodes in zip(_signals(part), state.nodes):
        signal.nodes = nodes
