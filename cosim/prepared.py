"""One system made ready once and run many times: by itself, or as an ensemble whose members differ in start values."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .engine.control import Adaptive
from .engine.process_state import ProcessState
from .engine.row_file import RowFile
from .engine.settings import RunSettings
from .ensemble import Case, Cases, Ensemble, Numbers, joined
from .errors import SetupError, pluralize
from .fmu.messages import quiet
from .pool import in_processes
from .requirements import require_runnable
from .result import Interrupted, Result, SimulationError
from .series import TIME
from .signals import collect_interrupts
from .simulation import Simulation
from .system import Network, System, connect
from .threads import in_order, in_threads
from .worker import MOST_IN_CHUNK, Batch, Chunk, Evaluate, Worker, keeps_nothing, with_case

NO_CASE = Case()
#: Memory for the rows of a chunk of members [bytes]. Chosen: what a chunk costs besides its members is a thousandth.
CHUNK_BYTES = 1 << 24


@dataclass(frozen=True)
class How:
    """How members are run.

    Attributes
    ----------
    jobs
        Threads if FMUs of fmukit are all that runs, else processes.
    isolated
        Whether all members run in other processes. The reason of one whose process dies is that.
    numbers
        The members that are run, by default all.
    steps
        The communication step of each member [s].
    timeout
        The longest time that an isolated worker may take for a step [s].
    progress
        Called with the share of the members that is done.
    evaluate
        What is done with a chunk in place of `Worker.run`, where the chunk gets a `share` of the memory.
    """

    jobs: int = 1
    isolated: bool = False
    numbers: Numbers | None = None
    steps: Sequence[float | Adaptive] | None = None
    timeout: float = math.inf
    progress: Callable[[float], None] | None = None
    evaluate: Evaluate | None = None
    share: float = 1.0


PLAIN = How()


class Prepared:
    """A system that has been checked, with how it is run; instances of its FMUs are used again.

    `columns` are what a run records, the time first.
    """

    def __init__(self, network: Network, settings: RunSettings, stack: ExitStack) -> None:
        self.network, self.settings = network, settings
        self.columns = (TIME, *(port.column for port in settings.ports(network)))
        self._stack, self._workers = stack, list[Worker]()

    @classmethod
    @contextmanager
    def open(cls, system: System, settings: RunSettings) -> Iterator[Prepared]:
        """Check a system and how it is run; at the end of the context all instances are freed.

        Raises
        ------
        SetupError
            For a system or settings that cannot be run.
        """
        network = connect(system)
        if settings.tolerance is None and isinstance(settings.step, Adaptive):
            settings = replace(settings, tolerance=settings.step.tolerance)
        require_runnable(network, settings)
        with ExitStack() as stack:
            yield cls(network, settings, stack)

    def run(
        self,
        case: Case = NO_CASE,
        *,
        csv: Path | str | None = None,
        progress: Callable[[float], None] | None = None,
        all_rows: Path | None = None,
    ) -> Result:
        """Run once with new instances, with the start values of a case over those of the system.

        Parameters and exceptions are those of `cosim.run`.
        """
        network = with_case(self.network, case)
        began = clock.perf_counter()
        with ExitStack() as stack:
            interrupts, process = stack.enter_context(collect_interrupts()), ProcessState()
            stack.callback(process.restore)
            simulation = Simulation(network, self.settings, stack, process)
            if all_rows is not None:
                simulation.all_rows = RowFile(all_rows)
                stack.callback(simulation.all_rows.close)
            path = None if csv is None else Path(csv).absolute()
            result = simulation.finish(interrupts, began, csv=path, progress=progress)
        assert result.report is not None
        outcome = result.report.outcome
        stopped = (
            f"{outcome.reason}; stopped at t = {outcome.reached!r} s, "
            f"{pluralize(outcome.rows, 'row')} kept"
        )
        if outcome.status == "failed":
            raise SimulationError(stopped, result)
        if outcome.status == "interrupted":
            raise Interrupted(stopped, result)
        return result

    def begin(self) -> None:
        """Bring new instances to the start, and end them there; raises SetupError."""
        with ExitStack() as stack:
            process = ProcessState()
            stack.callback(process.restore)
            Simulation(self.network, self.settings, stack, process)

    def map(
        self,
        cases: Any,
        *,
        jobs: int = 1,
        steps: Sequence[float | Adaptive] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Ensemble:
        """Run a member for each case; the rows are those of single runs, bit for bit.

        Instances of FMUs that are known to keep nothing are reset from member to member, if the first one shows that
        this gives the same bits; all others are made anew. A member
        that fails has its rows and the reason. What FMUs warn of is in the ensemble, not logged.

        Parameters
        ----------
        cases : mapping, pandas frame, Cases or int
            Columns of start values by name, a row for each member; or how many members there are, if only their
            steps differ.
        jobs : int
            Threads if FMUs of fmukit are all that runs, else processes, in which a crash costs one member.
        steps : sequence of float or Adaptive, optional
            The communication step of each member [s]. Rows are at the times that all have: `output_step` of the
            settings must be a multiple of each.
        progress : callable, optional
            Called with the share of the members that is done.

        Raises
        ------
        SetupError
            For cases that are no columns of start values, and for steps without common rows.
        Interrupted
            With the members that are done, after Ctrl-C.
        """
        read = Cases.of(cases, self.network)
        blocks = list(self.blocks(read, How(jobs, steps=steps, progress=progress)))
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
        with quiet(), collect_interrupts() as interrupts:
            batch = Batch(
                self.network, self.settings, cases, self._chunks(cases, how), how.jobs,
                how.progress or (lambda _: None), interrupts, how.timeout, how.evaluate,
            )  # fmt: skip
            if not how.isolated and how.jobs == 1:
                yield from in_order(batch, self._of_workers(batch)[0])
            elif not how.isolated and self._is_threaded():
                yield from in_threads(batch, self._of_workers(batch))
            if any(worker.abandoned for worker in self._workers):
                self._workers.clear()
            if batch.waiting and not interrupts:
                yield from in_processes(batch)
            batch.report(1.0)

    def _of_workers(self, batch: Batch) -> list[Worker]:
        """A worker for each job, which lives until the context ends."""
        while len(self._workers) < batch.jobs:
            worker = Worker(self.network, self.settings)
            self._stack.callback(worker.close)
            self._workers.append(worker)
        for worker in self._workers:
            worker.interrupts = batch.interrupts
        return self._workers[: batch.jobs]

    def _is_threaded(self) -> bool:
        """Whether each thread may have instances of its own."""
        return keeps_nothing(self.network) and not any(
            d.interface("coSimulation").needsExecutionTool
            for d in self.network.descriptions.values()
        )

    def _chunks(self, cases: Cases, how: How) -> list[Chunk]:
        """The members in pieces of the same step that fit into memory, at least one for each job."""
        settings = self.settings
        numbers = np.arange(cases.members) if how.numbers is None else how.numbers
        groups: dict[str, tuple[float | Adaptive, list[int]]] = {}
        steps = [settings.step] * cases.members if how.steps is None else list(how.steps)
        if len(steps) != cases.members:
            raise SetupError(f"there are {len(steps)} steps for {cases.members} cases")
        for k in numbers.tolist():
            groups.setdefault(repr(steps[k]), (steps[k], []))[1].append(k)
        chunks = []
        for step, members in groups.values():
            some = np.array(members)
            if step != settings.step:
                self._require_step(step)
            most = max(1, min(self._most_in_chunk(step, how.share), -(-len(some) // how.jobs)))
            chunks += [
                Chunk(some[k : k + most], step, settings.output_step)
                for k in range(0, len(some), most)
            ]
        return chunks

    def _require_step(self, step: float | Adaptive) -> None:
        """Raise SetupError for a step that gives no rows at the times of the others."""
        settings = replace(self.settings, step=step)
        require_runnable(self.network, settings)
        if settings.every() is None and not isinstance(step, Adaptive):
            apart = settings.output_step
            raise SetupError(
                f"step = {step!r} s: rows must be a multiple of it apart, not {apart!r} s"
            )

    def _most_in_chunk(self, step: float | Adaptive, share: float) -> int:
        """How many members of this step a chunk may have, whose rows get a share of the memory."""
        if isinstance(step, Adaptive):
            return MOST_IN_CHUNK
        settings = replace(self.settings, step=step)
        rows = 2 + settings.number() // (settings.every() or 1)
        most = share * CHUNK_BYTES / (8 * rows * len(self.columns))
        return min(MOST_IN_CHUNK, int(most))
