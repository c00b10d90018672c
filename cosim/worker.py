"""Members of an ensemble, one after the other, by one instance of each FMU, as it is shown that this may be done."""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .engine.control import Adaptive
from .engine.energy import NOTICEABLE, energies, is_noticeable
from .engine.process_guard import ProcessGuard
from .engine.settings import StepAndStop
from .engine.setup import Setup
from .engine.snapshot import Case, SystemState
from .engine.system_instance import SystemInstance
from .ensemble import Cases, Ensemble, Facts, Member, Numbers
from .errors import SetupError
from .simulation import Simulation, run_setup
from .system import Value

#: Members of a chunk. Chosen: of members without rows, it is the work of a tenth of a second.
MOST_IN_CHUNK = 4096
#: Time [s] after which a worker gives what it has done of a chunk, so that a kill costs no more. Chosen: a person waits so long.
LONGEST_BLOCK = 1.0
#: Time [s] between two calls of who is told of the progress. Chosen: a person notices a tenth of a second.
PATIENCE = 0.05
#: In place of the number of a member: none runs, or instances are freed.
NOBODY, CLOSING = -1, -2
#: Said of an ensemble whose instances cannot be used again.
FRESH = "every run has new instances: not all FMUs are known to be as new after a reset"


class Chunk(NamedTuple):
    """Members that one worker runs one after the other, each for its span; rows of the same distance [s]."""

    numbers: Numbers
    spans: Sequence[StepAndStop]
    output_step: float | None

    def part(self, which: Numbers) -> Chunk:
        """The members at these positions."""
        return self._replace(
            numbers=self.numbers[which], spans=[self.spans[k] for k in which.tolist()]
        )


#: What a worker makes of a chunk: its ensemble, or one with figures in place of rows.
Evaluate = Callable[["Worker", Cases, Chunk, Callable[[int], None]], Ensemble]


@dataclass
class Batch:
    """Members that wait for workers, and what workers look at meanwhile.

    `report` is called with the share that is done; `interrupts` fills with signals that ask to stop; `timeout` is the
    longest time that a worker in another process may be silent [s]; `evaluate` is what a worker does with a chunk.
    """

    setup: Setup
    cases: Cases
    waiting: list[Chunk]
    jobs: int
    report: Callable[[float], None]
    interrupts: Sequence[int]
    timeout: float
    evaluate: Evaluate

    def __post_init__(self) -> None:
        self.members = sum(len(chunk.numbers) for chunk in self.waiting)

    def return_undone(self, chunk: Chunk, block: Ensemble) -> None:
        """Let the members wait that a worker has not done of a chunk."""
        rest = np.flatnonzero(~np.isin(chunk.numbers, block.members))
        if len(rest):
            self.waiting.insert(0, chunk.part(rest))


@dataclass
class Alike:
    """What members with the same fixed steps have in common, and what the last of them has said of its run."""

    setup: Setup
    said: dict[str, Any] | None = None
    facts: Facts | None = None
    breaks: Sequence[tuple[float, float]] = ()


class Worker:
    """Runs members one after the other, by instances that begin again where this is known to give the same bits.

    `member` is where others can see the number of the member that runs, NOBODY or CLOSING. `abandoned` says that an FMU may not
    be called any more.
    """

    def __init__(self, setup: Setup, member: Any = None) -> None:
        self.setup = setup
        self._member = ctypes.c_longlong(NOBODY) if member is None else member
        self.interrupts: Sequence[int] = ()
        self.columns = setup.columns
        self._instance = SystemInstance(setup)
        self._deadline = 0.0
        self._names: list[str] = []
        self._state: SystemState | None = None
        self._shown: dict[str, list[tuple[str, str]]] = {}
        self._no_rows = np.empty((0, len(self.columns)))
        self._begins: Setup | None = None
        self._varies_inputs = False
        self._known: dict[tuple[StepAndStop, float | None], Alike] = {}
        self.abandoned = False

    def close(self) -> None:
        """Free the instances."""
        self._member.value = CLOSING
        self._instance.close()
        self._member.value = NOBODY

    def run(
        self, cases: Cases, chunk: Chunk, progress: Callable[[int], None] = lambda _: None
    ) -> Ensemble:
        """The members of a chunk, or as many as it does in LONGEST_BLOCK, until it is abandoned or the user interrupts.

        `progress` is called with how many are done.
        """
        self._deadline = clock.monotonic() + LONGEST_BLOCK
        if self._names != cases.names or self._state is not cases.begin:
            self._names, self._begins, self._known, self._shown = cases.names, None, {}, {}
            self._state = cases.begin
            self._varies_inputs = any(p.name in self._names for p, _ in self.setup.network.inputs)
        self._instance.process = process = ProcessGuard()
        values, wrong = cases.checked(self.setup.network, chunk.numbers.tolist())
        done: list[Member] = []
        told = clock.monotonic()
        for k, row in enumerate(values):
            if self.abandoned or self.interrupts or (done and self.is_late()):
                break
            done.append(
                Member(int(chunk.numbers[k]), self._no_rows, wrong[k])
                if k in wrong
                else self._run(cases, chunk, k, row)
            )
            if clock.monotonic() > told + PATIENCE:
                told = clock.monotonic()
                progress(len(done))
        progress(len(done))
        process.restore()
        notes = () if self._instance.is_reset_trusted else (FRESH,)
        return Ensemble(cases, self.columns, done, notes)

    def is_late(self) -> bool:
        """Whether it has worked so long that it gives what is done."""
        return clock.monotonic() > self._deadline

    def _run(self, cases: Cases, chunk: Chunk, k: int, values: tuple[Value, ...]) -> Member:
        """Run the member at position k of a chunk, with these values of the cases."""
        began, instance, number = clock.perf_counter(), self._instance, int(chunk.numbers[k])
        self._member.value = CLOSING
        instance.rest()
        self._member.value = number
        try:
            if self._begins is None or self._varies_inputs:
                case = cases.case(number)
                self._begins = self.setup if case.begin else self.setup.with_case(case)
                self._known = {}
            alike = self._alike(self._begins, chunk.spans[k], chunk.output_step)
            instance.begin(alike.setup, self._state, dict(zip(self._names, values)))
        except SetupError as error:
            self.abandoned = instance.is_abandoned
            return Member(number, self._no_rows, str(error))
        if alike.said is None:
            alike.said = run_setup(instance)
        simulation = Simulation(instance, began, setup=alike.said)
        simulation.drive(self.interrupts)
        self.abandoned = instance.is_abandoned
        energy = {bond: energies(sides) for bond, sides in instance.bonds.items()}
        return Member(
            number,
            np.frombuffer(simulation.recorder.rows).reshape(-1, len(self.columns)),
            "" if simulation.status == "complete" else simulation.reason,
            [*simulation.warnings(), *_bond_warnings(energy)],
            energy,
            self._facts(alike, simulation),
        )

    def _alike(self, setup: Setup, span: StepAndStop, output_step: float | None) -> Alike:
        """What is known of members with such fixed steps; of one with others, nothing."""
        key, is_fixed = (span, output_step), not isinstance(span.step, Adaptive)
        if is_fixed and key in self._known:
            return self._known[key]
        alike = Alike(setup.with_span(*span, output_step).with_case(Case(begin=self._state)))
        if is_fixed:
            self._known[key] = alike
        return alike

    def _facts(self, alike: Alike, simulation: Simulation) -> Facts:
        """What a run says of itself, shared with the one before it that is alike if it says the same."""
        breaks, known = simulation.march.breaks, alike.facts
        ran = {"reason": simulation.reason, **simulation.march.statistics()}
        if (
            known is None
            or breaks != alike.breaks
            or any(known.provenance[name] != value for name, value in ran.items())
        ):
            self._shown = self._shown or {name: self._showing(name) for name in self._names}
            intervals = np.array(breaks, float).reshape(-1, 2)
            alike.facts = known = Facts(simulation.provenance(), intervals, self._shown)
            alike.breaks = breaks
        return known

    def _showing(self, name: str) -> list[tuple[str, str]]:
        """The parameters that show a start value, aliases too, with their part."""
        port = self.setup.network.port(name)
        variables = self.setup.network.descriptions[port.part].modelVariables
        return [
            (port.part, v.name)
            for v in variables
            if v.causality == "parameter"
            and v.valueReference == port.variable.valueReference
            and v.type == port.variable.type
        ]


def _bond_warnings(energy: Mapping[str, tuple[float, float, float]]) -> Iterator[str]:
    """A sentence for every bond on which the coupling changed a noticeable share of the energy, the same for all members."""
    for bond, carried in energy.items():
        if is_noticeable(*carried):
            yield (
                f"bond {bond}: the coupling created or removed more than {NOTICEABLE:.0%} of the energy "
                "carried: use smaller steps or another algorithm; see diagnose"
            )
