"""One system made ready once and run many times: by itself, or as an ensemble whose members differ in start values."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .engine.control import Adaptive
from .engine.process_guard import ProcessGuard
from .engine.settings import RunSettings, StepAndStop
from .engine.setup import Setup
from .engine.snapshot import Case, SystemState
from .engine.system_instance import SystemInstance, is_reset_trusted
from .ensemble import Cases, Ensemble, Numbers, joined
from .errors import FmuError, SetupError, pluralize
from .fmu.messages import quiet
from .pool import in_processes
from .result import Interrupted, Result, SimulationError
from .signals import collect_interrupts
from .simulation import Simulation
from .system import Network, System, connect
from .threads import available_cores, in_order, in_threads
from .worker import MOST_IN_CHUNK, Batch, Chunk, Evaluate, Worker

NO_CASE = Case()
#: Memory for the rows of a chunk of members [bytes]. Chosen: what a chunk costs besides its members is a thousandth.
CHUNK_BYTES = 1 << 24
#: Rows of a member with adaptive steps, which nobody knows before. Chosen: a chunk of them is one of MOST_IN_CHUNK.
FEW_ROWS = 1


@dataclass(frozen=True)
class How:
    """How members are run.

    Attributes
    ----------
    jobs
        Threads if FMUs of fmukit are all that runs, else processes; None: as many threads as cores, but no processes.
    isolated
        Whether all members run in other processes. The reason of one whose process dies is that.
    numbers
        The members that are run, by default all.
    steps, stops
        The communication step of each member, and its stop [s].
    timeout
        The longest time that an isolated worker may take for a step [s].
    progress
        Called with the share of the members that is done.
    evaluate
        What is done with a chunk in place of `Worker.run`, where the chunk gets a `share` of the memory.
    """

    jobs: int | None = 1
    isolated: bool = False
    numbers: Numbers | None = None
    steps: Sequence[float | Adaptive] | None = None
    stops: Sequence[float] | None = None
    timeout: float = math.inf
    progress: Callable[[float], None] | None = None
    evaluate: Evaluate | None = None
    share: float = 1.0


PLAIN = How()


class Paused(NamedTuple):
    """The rows of a run up to a communication point, and the state of the system there."""

    result: Result
    state: SystemState


class Prepared:
    """A system that has been checked, with how it is run; instances of its FMUs are used again."""

    def __init__(self, setup: Setup, stack: ExitStack) -> None:
        self.setup = setup
        self._stack, self._workers = stack, list[Worker]()
        self._instance = SystemInstance(setup)
        stack.callback(self._instance.close)

    @property
    def network(self) -> Network:
        """The system that has been checked."""
        return self.setup.network

    @classmethod
    @contextmanager
    def open(cls, system: System, settings: RunSettings) -> Iterator[Prepared]:
        """Check a system and how it is run; at the end of the context all instances are freed.

        Raises
        ------
        SetupError
            For a system or settings that cannot be run.
        """
        setup = Setup.of(connect(system), settings)
        with ExitStack() as stack:
            yield cls(setup, stack)

    def run(
        self,
        case: Case = NO_CASE,
        *,
        csv: Path | str | None = None,
        progress: Callable[[float], None] | None = None,
        all_rows: Path | None = None,
    ) -> Result:
        """Run once, with the start values of a case over those of the system, or from its state on.

        Instances of FMUs that are known to keep nothing over a reset begin again; of others, each run has new ones. With the same settings, a run that begins with a state has the rows, bit for bit, that the run which
        handed it out would have had. Steps are counted from the `start` of the settings, of which
        one must end where the state is. Parameters and exceptions are those of `cosim.run`.
        """
        return self._run(case, None, csv, progress, all_rows)[0]

    def run_until(self, time: float, case: Case = NO_CASE) -> Paused:
        """Run to the first communication point from a time [s] on, and hand out the state there.

        Raises what `run` does, and SetupError where no run can go on from there: all FMUs must be able to save their
        state, and rows must be at communication points.
        """
        result, state = self._run(case, time)
        if state is None:
            raise SimulationError(f"{result.provenance['reason']}: there is no state", result)
        return Paused(result, state)

    def _run(
        self,
        case: Case,
        until: float | None,
        csv: Path | str | None = None,
        progress: Callable[[float], None] | None = None,
        all_rows: Path | None = None,
    ) -> tuple[Result, SystemState | None]:
        setup, state = self.setup.with_case(case), None
        if until is not None:
            begin = setup.settings.start if case.begin is None else case.begin.time
            setup.require_pause(begin, until)
        began, instance = clock.perf_counter(), self._instance
        with collect_interrupts() as interrupts, ExitStack() as stack:
            instance.process = ProcessGuard()
            stack.callback(instance.rest)
            file = None if all_rows is None else stack.enter_context(all_rows.open("wb"))
            path = None if csv is None else Path(csv).absolute()
            instance.begin(setup, case.begin)
            last = math.inf if until is None else until
            simulation = Simulation(instance, began, csv=path, until=last, all_rows=file)
            result = simulation.run(interrupts, progress)
            ran = result.provenance
            if ran["status"] == "complete" and simulation.march.is_paused:
                try:
                    state = simulation.state(self.network.system.start)
                except FmuError as error:
                    raise SimulationError(str(error), result) from error
                if state.live:
                    self._stack.push(instance.detach())
        if ran["status"] == "complete":
            return result, state
        stopped = (
            f"{ran['reason']}; stopped at t = {ran['reached']!r} s, "
            f"{pluralize(ran['rows'], 'row')} kept"
        )
        raise (SimulationError if ran["status"] == "failed" else Interrupted)(stopped, result)

    def map(
        self,
        cases: Any,
        *,
        begin: SystemState | None = None,
        jobs: int = 1,
        steps: Sequence[float | Adaptive] | None = None,
        stops: Sequence[float] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Ensemble:
        """Run a member for each case; the rows are those of single runs, bit for bit.

        Instances of FMUs that are known to keep nothing are reset from member to member; all others are made anew. A member
        that fails has its rows and the reason. What FMUs warn of is in the ensemble, not logged.

        Parameters
        ----------
        cases : mapping, pandas frame, Cases or int
            Columns of start values by name, a row for each member; or how many members there are, if only their
            steps differ.
        begin : SystemState, optional
            The state that `run_until` has handed out, with which all members begin, in place of start values.
        jobs : int
            Threads if FMUs of fmukit are all that runs, else processes, in which a crash costs one member.
        steps : sequence of float or Adaptive, optional
            The communication step of each member [s]. Rows are at the times that all have: `output_step` of the
            settings must be a multiple of each.
        stops : sequence of float, optional
            The stop of each member [s].
        progress : callable, optional
            Called with the share of the members that is done.

        Raises
        ------
        SetupError
            For cases that are no columns of start values, for steps without common rows, for a state with which they
            cannot begin, and for `jobs` below 1.
        Interrupted
            With the members that are done, after Ctrl-C.
        """
        read = replace(Cases.of(cases, self.network), begin=begin)
        blocks = list(self.blocks(read, How(jobs, steps=steps, stops=stops, progress=progress)))
        done = sum(map(len, blocks))
        if done < read.members:
            text = f"interrupted by the user; {done} of {read.members} runs are done"
            raise Interrupted(text, joined(blocks) if blocks else None)
        return joined(blocks)

    def blocks(self, cases: Any, how: How = PLAIN) -> Iterator[Ensemble]:
        """Yield the members in pieces as they are done, so that their rows need not all be in memory.

        After Ctrl-C there are no more of them; exceptions are those of `map`.
        """
        cases = Cases.of(cases, self.network)
        if how.jobs is not None and how.jobs < 1:
            raise SetupError(f"jobs = {how.jobs!r} must be at least 1")
        jobs = (available_cores() if self._is_threaded() else 1) if how.jobs is None else how.jobs
        with quiet(), collect_interrupts() as interrupts:
            batch = Batch(
                self.setup, cases, self._chunks(cases, how, jobs), jobs,
                how.progress or (lambda _: None), interrupts, how.timeout, how.evaluate or Worker.run,
            )  # fmt: skip
            if not how.isolated and jobs == 1:
                yield from in_order(batch, self._workers_for(batch)[0])
            elif not how.isolated and self._is_threaded():
                yield from in_threads(batch, self._workers_for(batch))
            if any(worker.abandoned for worker in self._workers):
                self._workers.clear()
            if batch.waiting and not interrupts:
                yield from in_processes(batch)
            batch.report(1.0)

    def _workers_for(self, batch: Batch) -> list[Worker]:
        """A worker for each job, which lives until the context ends."""
        while len(self._workers) < batch.jobs:
            worker = Worker(self.setup)
            self._stack.callback(worker.close)
            self._workers.append(worker)
        for worker in self._workers:
            worker.interrupts = batch.interrupts
        return self._workers[: batch.jobs]

    def _is_threaded(self) -> bool:
        """Whether each thread may have instances of its own."""
        return is_reset_trusted(self.network) and not any(
            d.offered_interface("coSimulation").needsExecutionTool
            for d in self.network.descriptions.values()
        )

    def _chunks(self, cases: Cases, how: How, jobs: int) -> list[Chunk]:
        """The members in pieces of equally many rows that fit into memory, at least one for each job."""
        n, settings = cases.members, self.setup.settings
        steps = [settings.step] * n if how.steps is None else list(how.steps)
        stops = [settings.stop] * n if how.stops is None else list(how.stops)
        for name, values in (("steps", steps), ("stops", stops)):
            if len(values) != n:
                raise SetupError(f"there are {len(values)} {name} for {n} cases")
        spans = [StepAndStop(*pair) for pair in zip(steps, stops)]
        keys = [repr(span) for span in spans]
        rows = {key: self._group_key(cases, span) for key, span in dict(zip(keys, spans)).items()}
        groups: dict[tuple[int, str], list[int]] = {}
        for k in range(n) if how.numbers is None else how.numbers.tolist():
            groups.setdefault(rows[keys[k]], []).append(k)
        chunks = []
        for (of_each, _), members in groups.items():
            most = min(
                MOST_IN_CHUNK,
                int(how.share * CHUNK_BYTES / (8 * of_each * len(self.setup.columns))),
            )
            most = max(1, min(most, -(-len(members) // jobs)))
            for first in range(0, len(members), most):
                some = members[first : first + most]
                chunks.append(Chunk(np.array(some), [spans[k] for k in some], settings.output_step))
        return chunks

    def _group_key(self, cases: Cases, span: StepAndStop) -> tuple[int, str]:
        """About how many rows a member has, and its steps if they are adaptive; raises SetupError for what makes no run."""
        output_step = self.setup.settings.output_step
        setup = self.setup.with_span(*span, output_step)
        settings = setup.settings
        if cases.begin is not None:
            setup.require_begin_of_many(cases.case(0))
        if isinstance(span.step, Adaptive):
            return FEW_ROWS, repr(span.step)
        every = settings.steps_per_row()
        if every is None and setup is not self.setup:
            raise SetupError(
                f"step = {span.step!r} s: rows must be a multiple of it apart, not {settings.output_step!r} s"
            )
        return 2 + settings.number() // (every or 1), ""
