"""Members of an ensemble, one after the other, by one instance of each FMU, as it is shown that this may be done."""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from multiprocessing import RawArray, RawValue
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .engine.control import Adaptive
from .engine.driver import KnownSteps
from .engine.energy import NOTICEABLE, bond_warnings, is_noticeable
from .engine.member_layout import EXACT, NeedsPythonError, SystemLayout
from .engine.members import LEFT, Block, Members, Place, StepAndStop
from .engine.process_guard import ProcessGuard
from .engine.settings import RunSettings
from .engine.snapshot import SystemState
from .ensemble import Array, Case, Cases, Ensemble, Facts, Numbers
from .errors import FmuError, SetupError
from .fmu.instance import CoSimulation
from .series import TIME
from .simulation import Simulation
from .system import Network, Value, connect, declared_start
from .system.start_values import checked_start

#: Members of a chunk. Chosen: of members without rows, it is the work of a tenth of a second.
MOST_IN_CHUNK = 4096
#: Time [s] after which a worker gives what it has done of a chunk, so that a kill costs no more. Chosen: a person waits so long.
LONGEST_BLOCK = 1.0
#: The tools whose FMUs have no variables besides those of their instances, so that each thread may have instances of
#: its own and a reset leaves nothing behind: their binaries have neither .data nor .bss, which a test shows of every FMU
#: that is built here. Others may differ after a reset at times, which no number of trials can rule out.
KNOWN_TOOLS = ("build_fmus.py",)
#: In the place of a member: none is worked on, or instances are freed.
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

    network: Network
    settings: RunSettings
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


class Desk(NamedTuple):
    """Where others can see which member a worker has come to: its place among these numbers."""

    place: Place
    numbers: Any

    @classmethod
    def private(cls) -> Desk:
        """In the memory of this process."""
        return cls(Place(-1, -1), (ctypes.c_longlong * MOST_IN_CHUNK)())

    @classmethod
    def shared(cls) -> Desk:
        """In memory that a child process may be given."""
        return cls(RawValue(Place, -1, -1), RawArray(ctypes.c_longlong, MOST_IN_CHUNK))


@dataclass(frozen=True)
class Member:
    """What a run by the driver gives: rows, shape (rows, columns), why it failed, warnings, energy over bonds [J]."""

    rows: Array
    reason: str
    warnings: Sequence[str] = ()
    energy: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    facts: Facts | None = None


def is_reset_trusted(network: Network) -> bool:
    """Whether all FMUs are of tools whose instances keep nothing over a reset."""
    descriptions = network.descriptions.values()
    return all((d.generationTool or "").startswith(KNOWN_TOOLS) for d in descriptions)


def with_case(network: Network, case: Case) -> Network:
    """A checked system with other start values, or those of a state; raises SetupError for those that it cannot have."""
    if not isinstance(case, Case):
        raise SetupError(
            f"a run takes a Case, not a {type(case).__name__}: write Case(start) for start values by name, "
            "or Case(begin=state) for the state that run_until hands out"
        )
    if case.begin is not None:
        if not isinstance(case.begin, SystemState):
            raise SetupError(
                "begin must be the state that run_until hands out: write begin=paused.state"
            )
        if case.start:
            names = ", ".join(case.start)
            raise SetupError(
                f"a case has start values or a begin, and this one has both: leave out start ({names}), "
                "since the state brings all values"
            )
        theirs, ours = (", ".join(sorted(x)) for x in (case.begin.parts, network.descriptions))
        if theirs != ours:
            raise SetupError(f"the state has the parts {theirs}; this system has {ours}")
        return _with_start_values_of(network, case.begin)
    if not case.start:
        return network
    return connect(replace(network.system, start={**network.system.start, **case.start}))


def _with_start_values_of(network: Network, state: SystemState) -> Network:
    """The system with the start values of a state; raises SetupError for one of its own that the state does not have."""
    begun = connect(replace(network.system, start=state.start_values))
    begun_with = {port.name: value for port, value in begun.start}
    for name, value in network.system.start.items():
        port, ours = checked_start(network, network.port(name), value)
        theirs = begun_with.get(port.name, declared_start(port.variable))
        if ours == theirs or state.system_start.get(name) == value:
            continue
        change = f"changes=['at {state.time!r} s {name} = {value!r}']"
        can_change = port.variable.causality == "input" or port.variable.variability == "tunable"
        raise SetupError(
            f"{name} = {ours!r} in the system, and {theirs!r} at the start of the run that handed the state out: "
            f"leave it out{f', or change it with {change}' if can_change else ''}"
        )
    return begun


class First(NamedTuple):
    """The first member that has come to its end, as a chunk of its own, and its rows, shape (rows, columns)."""

    cases: Cases
    chunk: Chunk
    rows: Array
    simulation: Simulation
    facts: Facts | None


class Worker:
    """Runs members with one instance of each FMU, in C where that gives the same bits.

    Instances are reset if all FMUs are known to keep nothing, and the first member that comes to its end shows it: it
    runs with new instances, and again after they have been reset. Otherwise each member has new ones. `abandoned` says
    that an FMU may not be called any more, `stopped` that the user has interrupted.
    """

    def __init__(self, network: Network, settings: RunSettings, desk: Desk | None = None) -> None:
        self.network, self.settings = network, settings
        self._desk = Desk.private() if desk is None else desk
        self.interrupts: Sequence[int] = ()
        self.columns = (TIME, *(port.column for port in settings.ports(network)))
        self._stack, self._process = ExitStack(), ProcessGuard()
        self._instances: dict[str, CoSimulation] = {}
        self._members: Members | None = None
        self._names: list[str] | None = None
        self._first: First | None = None
        self._is_fresh = not is_reset_trusted(network)
        self._deadline = 0.0
        self._facts: dict[StepAndStop, Facts | None] = {}
        self.abandoned = self.stopped = False

    def close(self) -> None:
        """Free the instances."""
        self._stack.close()
        self._process.restore()

    def run(
        self, cases: Cases, chunk: Chunk, progress: Callable[[int], None] = lambda _: None
    ) -> Ensemble:
        """The members of a chunk, or as many as it does in LONGEST_BLOCK, until it is abandoned or the user interrupts.

        `progress` is called with how many are done.
        """
        self._deadline = clock.monotonic() + LONGEST_BLOCK
        values, wrong = cases.checked(self.network, chunk.numbers.tolist())
        driven = {k: Member(self._no_rows, reason) for k, reason in wrong.items()}
        if self._names != cases.names:
            self._run_first(cases, chunk, driven)
        if self._first is not None and len(driven) < len(values) and not self.interrupts:
            self._find_out_about_reset(self._first)
        in_c, kept = None, np.zeros(len(values), bool)
        if self._members is not None and self._names == cases.names:
            inside = np.array(
                [
                    k
                    for k, row in enumerate(values)
                    if k not in wrong
                    and _is_exact(row)
                    and self._shared_facts(chunk.spans[k]) is not None
                ],
                np.intp,
            )
            if len(inside):
                numbers, spans, output_step = chunk.part(inside)
                block = self._members.allocate(
                    numbers, [values[k] for k in inside], spans, output_step
                )
                kept[inside] = self._in_c(block, lambda done: progress(len(driven) + done))
                in_c = inside, block
            driven = {k: member for k, member in driven.items() if not kept[k]}
        for k in range(len(values)):
            if self.abandoned or self.interrupts or (self.is_late() and (kept.any() or driven)):
                break
            if not kept[k] and k not in driven:
                driven[k] = self._drive(cases, chunk, k)[0]
                progress(int(kept.sum()) + len(driven))
        return self._ensemble(cases, chunk, driven, kept, in_c)

    def is_late(self) -> bool:
        """Whether it has worked so long that it gives what is done."""
        return clock.monotonic() > self._deadline

    @property
    def _no_rows(self) -> Array:
        return np.empty((0, len(self.columns)))

    def _run_first(self, cases: Cases, chunk: Chunk, driven: dict[int, Member]) -> None:
        """Run the first member that comes to its end, with new instances."""
        self._members, self._first, self._is_fresh = None, None, not is_reset_trusted(self.network)
        for k in range(len(chunk.numbers)):
            if k in driven or self.abandoned or self.interrupts:
                continue
            self._free_instances()
            driven[k], simulation = self._drive(cases, chunk, k)
            if simulation is not None and not driven[k].reason:
                self._names, self._facts = cases.names, {}
                if not self._is_fresh:
                    self._first = First(
                        cases,
                        chunk.part(np.array([k])),
                        driven[k].rows,
                        simulation,
                        driven[k].facts,
                    )
                return

    def _find_out_about_reset(self, first: First) -> None:
        """Find out how the others may run: the first member again, with instances that are reset."""
        self._first, expected = None, first.rows.tobytes()
        values, _ = first.cases.checked(self.network, first.chunk.numbers.tolist())
        simulation, loop = first.simulation, first.simulation.driver.compiled_loop
        self._of_first = first
        try:
            if loop is None:
                raise NeedsPythonError("its steps are made in Python")
            parts = {name: simulation.parts[name] for name in simulation.sequence}
            layout = SystemLayout(
                simulation.network, simulation.settings, parts, loop, first.cases.names
            )
            members = Members(layout, *self._desk)
            if _is_exact(values[0]) and self._shared_facts(first.chunk.spans[0]) is not None:
                numbers, spans, output_step = first.chunk
                block = members.allocate(numbers, values, spans, output_step)
                for _ in members.run(block):
                    self._process.restore()
                members.warnings = {}
                if block.status[0] < LEFT and block.rows[0].tobytes() == expected:
                    self._members = members
                    return
        except (NeedsPythonError, OSError):
            pass
        again, _ = self._drive(first.cases, first.chunk, 0)
        self._is_fresh = again.rows.tobytes() != expected and not self.interrupts
        if self._is_fresh:
            self._free_instances()

    def _in_c(self, block: Block, progress: Callable[[int], None]) -> NDArray[np.bool_]:
        """Run the members of a block in C; which of them are done, and need not be taken by the driver.

        Members for whose numbers FMUs have changed the arithmetic of the process are not.
        """
        assert self._members is not None
        done = 0
        block.status[:] = LEFT
        for now in self._members.run(block):
            try:
                self._process.require_unchanged_arithmetic()
            except FmuError:
                block.status[done:now] = LEFT
            done = now
            progress(done)
            if self.interrupts or (done and self.is_late()):
                break
        kept: NDArray[np.bool_] = (block.status < LEFT) & (np.arange(len(block.status)) < done)
        return kept

    def _free_instances(self) -> None:
        """Free the instances; new ones will be made."""
        place, member = self._desk.place, self._desk.place.member
        place.member = CLOSING
        self._stack.close()
        self._instances = {}
        place.member = member

    def _drive(self, cases: Cases, chunk: Chunk, k: int) -> tuple[Member, Simulation | None]:
        """What the driver makes of the member at position k, with instances that are reset or, if need be, new ones."""
        number = int(chunk.numbers[k])
        self._desk.numbers[0], self._desk.place.member = number, 0
        settings = self._settings_of(chunk.spans[k], chunk.output_step)
        began = clock.perf_counter()
        if self._is_fresh:
            self._free_instances()
        try:
            for instance in self._instances.values():
                instance.session.messages.on_warning = None
                instance.reset()
        except FmuError:
            self._free_instances()
        try:
            network = with_case(self.network, cases.case(number))
            used = self._instances
            simulation = Simulation(network, settings, self._stack, self._process, used=used)
        except SetupError as error:
            self._note_abandoned_fmus()
            return Member(self._no_rows, str(error)), None
        self._instances = {name: part.instance for name, part in simulation.parts.items()}
        result = simulation.run(self.interrupts, began)
        self._note_abandoned_fmus()
        ran, of_bonds = result.provenance, set(bond_warnings(result.energy))
        reason = "" if ran["status"] == "complete" else ran["reason"]
        warnings = [text for text in result.warnings if text not in of_bonds]
        energy = {b: (e["given"], e["taken"], e["exchanged"]) for b, e in result.energy.items()}
        facts = Facts(ran, result.breaks, {})
        return Member(result.data, reason, warnings, energy, facts), simulation

    def _settings_of(self, span: StepAndStop, output_step: float | None) -> RunSettings:
        """Those of a member; the FMUs' tolerance is that of its adaptive steps, unless the user has given one."""
        step, given = span.step, self.settings.tolerance
        if isinstance(self.settings.step, Adaptive) and given == self.settings.step.tolerance:
            given = None
        if given is None and isinstance(step, Adaptive):
            given = step.tolerance
        return replace(
            self.settings, step=step, stop=span.stop, output_step=output_step, tolerance=given
        )

    def _shared_facts(self, span: StepAndStop) -> Facts | None:
        """What members of a span say of themselves alike that C may run all steps of; None if it may not.

        Known from the first member, which has come to its end, and from what inputs do until then.
        """
        if isinstance(span.step, Adaptive):
            return None
        if span not in self._facts:
            self._facts[span] = self._found_facts(span)
        return self._facts[span]

    def _found_facts(self, span: StepAndStop) -> Facts | None:
        first, settings = self._of_first, self._settings_of(span, self.settings.output_step)
        told = first.simulation.settings
        if isinstance(told.step, Adaptive) or first.facts is None:
            return None
        steps = KnownSteps(settings, first.simulation.jumps(span.stop))
        if settings.tolerance != told.tolerance or steps.interrupted():
            return None
        ran = first.facts.provenance
        count, before = steps.count, ran["steps"]
        provenance = {
            **ran,
            "stop": span.stop,
            "communication": settings.stepping_text(),
            "steps": count,
            "do_steps": {part: count * (n // before) for part, n in ran["do_steps"].items()},
        }
        breaks = [
            (begin, min(end, span.stop)) for begin, end in steps.breaks() if begin < span.stop
        ]
        shown = {name: self._showing(name) for name in first.cases.names}
        return Facts(provenance, np.array(breaks, float).reshape(-1, 2), shown)

    def _showing(self, name: str) -> list[tuple[str, str]]:
        """The parameters that show a start value, aliases too, with their part."""
        port = self.network.port(name)
        variables = self.network.descriptions[port.part].modelVariables
        return [
            (port.part, v.name)
            for v in variables
            if v.causality == "parameter"
            and v.valueReference == port.variable.valueReference
            and v.type == port.variable.type
        ]

    def _note_abandoned_fmus(self) -> None:
        """Note that an FMU may not be called any more."""
        instances = self._instances.values()
        self.abandoned = self.abandoned or any(i.session.fmu.abandoned for i in instances)

    def _ensemble(
        self,
        cases: Cases,
        chunk: Chunk,
        driven: Mapping[int, Member],
        kept: NDArray[np.bool_],
        in_c: tuple[NDArray[np.intp], Block] | None,
    ) -> Ensemble:
        """What is known of the members of a chunk."""
        n, warnings = len(chunk.numbers), {}
        most = max((len(member.rows) for member in driven.values()), default=0)
        counts, energy = np.zeros(n, np.int64), dict[str, Array]()
        if in_c is None:
            rows = np.full((n, most, len(self.columns)), np.nan)
        else:
            inside, block = in_c
            rows, counts[inside] = block.rows, block.counts
            if len(inside) < n or most > rows.shape[1]:
                rows = np.full((n, max(most, block.rows.shape[1]), len(self.columns)), np.nan)
                rows[inside, : block.rows.shape[1]] = block.rows
            assert self._members is not None
            for bond, values in self._members.bond_energy(block).items():
                energy[bond] = np.full((n, 3), np.nan)
                energy[bond][inside] = values
            numbers = set(chunk.numbers[kept].tolist())
            warnings = {
                text: [k for k in members if k in numbers]
                for text, members in self._members.warnings.items()
            }
            self._members.warnings = {}
        reasons = [""] * n
        facts: list[Facts | None] = [
            self._shared_facts(span) if is_kept else None
            for span, is_kept in zip(chunk.spans, kept)
        ]
        for k, member in driven.items():
            counts[k], reasons[k], facts[k] = len(member.rows), member.reason, member.facts
            rows[k, : counts[k]], rows[k, counts[k] :] = member.rows, np.nan
            for text in member.warnings:
                warnings.setdefault(text, []).append(int(chunk.numbers[k]))
            for bond, carried in member.energy.items():
                energy.setdefault(bond, np.full((n, 3), np.nan))[k] = carried
        done = kept.copy()
        done[list(driven)] = True
        for bond, values in energy.items():
            text = (
                f"bond {bond}: the coupling created or removed more than {NOTICEABLE:.0%} of the energy "
                "carried: use smaller steps or another algorithm; see diagnose"
            )
            where = is_noticeable(*values.T) & done
            warnings.setdefault(text, []).extend(chunk.numbers[where].tolist())
        for text in self.network.flaw_texts():
            warnings[text] = chunk.numbers[done].tolist()
        if not done.all():
            rows, counts = rows[done], counts[done]
            energy = {bond: values[done] for bond, values in energy.items()}
            reasons = [reason for reason, is_done in zip(reasons, done) if is_done]
            facts = [fact for fact, is_done in zip(facts, done) if is_done]
        return Ensemble(
            cases, chunk.numbers[done], self.columns, rows, counts, reasons,
            {text: sorted(members) for text, members in warnings.items() if members}, energy, facts,
            (FRESH,) if self._is_fresh else (),
        )  # fmt: skip


def _is_exact(values: Sequence[Value]) -> bool:
    """Whether doubles hold these values."""
    return not any(isinstance(x, str) or (isinstance(x, int) and abs(x) > EXACT) for x in values)
