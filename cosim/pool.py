"""Members of an ensemble in child processes: what crashes, hangs or is killed costs one member."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import RawValue
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from pickle import PicklingError
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .child import GRACE, Child, Death, death, progress_sender
from .engine.settings import RunSettings
from .engine.setup import Setup
from .engine.snapshot import SystemState
from .ensemble import NO_CASES, Cases, Ensemble, Member
from .errors import SetupError
from .fmu.messages import log
from .series import Column
from .system import System, connect
from .worker import CLOSING, NOBODY, Batch, Chunk, Evaluate, Worker

#: Longest wait for a message before signals and time limits are looked at [s].
PATIENCE = 0.05
#: What is said of a process that died where no member ran.
CLOSED, BETWEEN = "when it closed them", "between two runs"


class Task(NamedTuple):
    """What a process does with each chunk, the columns of the cases by name or their number, and how they begin."""

    evaluate: Evaluate
    cases: dict[str, NDArray[Any]] | int
    begin: SystemState | None


@dataclass
class Job:
    """A child process, the chunk that it works on, and how many of its members are done.

    Besides, how many blocks it has given.
    """

    child: Child
    member: Any
    chunk: Chunk
    columns: tuple[Column, ...]
    done: int = 0
    given: int = 0
    is_ready: bool = False

    def give(self, chunk: Chunk) -> None:
        """Let the process work on a chunk."""
        self.chunk, self.done, self.member.value = chunk, 0, NOBODY
        self.child.give(ForkingPickler.dumps(chunk))


def in_processes(batch: Batch) -> Iterator[Ensemble]:
    """The members that wait, by processes; it ends early if the user interrupts.

    A member whose process dies while it runs, or is silent for too long, fails with that reason. If the process dies
    between members, as where an instance is freed, other processes do the rest. Raises SetupError for a system that no
    process can be given, and if a process dies before it is ready.
    """
    running: list[Job] = []
    told: set[str] = set()
    finished = batch.members - sum(len(chunk.numbers) for chunk in batch.waiting)
    try:
        while (batch.waiting or running) and not batch.interrupts:
            while batch.waiting and len(running) < batch.jobs:
                running.append(_start(batch))
            wait([job.child.pipe for job in running], PATIENCE)
            for job in running:
                is_closing = job.member.value == CLOSING
                job.child.limit = min(batch.timeout, GRACE) if is_closing else batch.timeout
                for block in _answers(job, running, batch, told):
                    finished += len(block)
                    yield replace(block, cases=batch.cases)
            batch.report((finished + sum(job.done for job in running)) / batch.members)
    finally:
        for job in running:
            job.child.end()
    for text in sorted(told):
        log.error("%s; no run is lost", text)


def _answers(job: Job, running: list[Job], batch: Batch, told: set[str]) -> Iterator[Ensemble]:
    """What a process has done; it gets the next chunk, or ends."""
    for message in job.child.messages():
        if isinstance(message, Death):
            running.remove(job)
            _end(job)
            if not job.is_ready:
                raise SetupError(f"the process that was to run the members {message.how}")
            yield from _failed_members(job, batch.waiting, message.how, told)
            return
        kind, content = message
        if kind == "ready":
            job.is_ready = True
        elif kind == "progress":
            job.done = content
        elif kind == "error":
            raise content
        else:
            block, goes_on = content
            job.given += 1
            yield block
            batch.return_undone(job.chunk, block)
            if batch.waiting and goes_on:
                job.give(batch.waiting.pop(0))
                continue
            running.remove(job)
            _end(job)
            if job.child.process.exitcode:
                told.add(f"a process that ran the parts {death(job.child.process)} {CLOSED}")
            return


def _failed_members(
    job: Job, waiting: list[Chunk], reason: str, told: set[str]
) -> Iterator[Ensemble]:
    """The member that a process ran when it died; the others of its chunk wait again, those before it by themselves.

    Where it ran none, all wait again, one by one, and one that was alone has failed if it was the first of its process.
    """
    numbers, number = job.chunk.numbers, job.member.value
    if number in numbers:
        rests = [np.flatnonzero(numbers < number), np.flatnonzero(numbers > number)]
    elif job.given or len(numbers) > 1:
        number, rests = NOBODY, [np.array([k]) for k in range(len(numbers))]
        told.add(
            f"a process that ran the parts {reason} {CLOSED if job.member.value == CLOSING else BETWEEN}"
        )
    else:
        number, rests = int(numbers[0]), []
    waiting[:0] = [job.chunk.part(rest) for rest in rests if len(rest)]
    if number in numbers:
        failed = Member(
            number, np.empty((0, len(job.columns))), f"the process that ran the parts {reason}"
        )
        yield Ensemble(NO_CASES, job.columns, [failed])


def _start(batch: Batch) -> Job:
    """A new process that works on the next chunk."""
    member = RawValue(ctypes.c_longlong, NOBODY)
    columns = dict(zip(batch.cases.names, batch.cases.columns))
    try:
        task = Task(batch.evaluate, columns or batch.cases.members, batch.cases.begin)
        child = Child(_serve, member, batch.setup.network.system, batch.setup.settings, task)
    except (PicklingError, AttributeError, TypeError) as error:
        raise SetupError(
            f"this system cannot be given to another process: {error}; functions of inputs must "
            "be at the top of a module"
        ) from error
    chunk = batch.waiting.pop(0)
    job = Job(child, member, chunk, batch.setup.columns)
    job.give(chunk)
    return job


def _end(job: Job) -> None:
    """End a process that has nothing to do."""
    with suppress(OSError):
        job.child.pipe.send(None)
    job.child.end(GRACE)


def _serve(
    pipe: Connection, member: Any, system: System, settings: RunSettings, task: Task
) -> None:
    """Run chunks in the child and tell the parent of the progress and the end of each."""
    log.setLevel(logging.ERROR)
    progress = progress_sender(pipe)
    with suppress(BrokenPipeError, EOFError, ConnectionResetError):
        try:
            setup = Setup(connect(system), settings)
            cases = replace(Cases.of(task.cases, setup.network), begin=task.begin)
            worker = Worker(setup, member)
            pipe.send(("ready", None))
            while (chunk := pipe.recv()) is not None:
                pipe.send(("progress", 0))
                block = task.evaluate(worker, cases, chunk, progress)
                pipe.send(("block", (replace(block, cases=NO_CASES), not worker.abandoned)))
                if worker.abandoned:
                    return
            worker.close()
        except SetupError as error:
            pipe.send(("error", error))
        except (BrokenPipeError, ConnectionResetError):
            raise
        except OSError as error:  # no room, no open files: what the runs before have left of them
            member.value = NOBODY
            pipe.send(Death(f"could not go on: {error}"))
