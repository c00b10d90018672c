"""Runs on a Dask cluster: FMUs travel with them, a lost worker's runs are done again.

A worker does its runs in child processes, so that it outlives them. What kills a worker comes from
outside; Dask gives up on a run after some lost workers, and then it is submitted anew.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cosim import SetupError

from .bundle import Bundle
from .slots import LOST, Slots
from .source import sources, versions

CONNECT = 10.0
WORKERS = 30.0
SLOTS = Slots()


def facts() -> dict[str, str]:
    """What must be the same on client and workers: versions and source files."""
    return versions() | sources()


def _release() -> None:
    """End the child processes of this worker that have nothing to do."""
    SLOTS.rest()


class Shipped(NamedTuple):
    """What all runs of a study need: their files, and what their workers must be."""

    bundle: Bundle
    facts: dict[str, str]


def _ship(shipped: Shipped) -> Shipped:
    """A task of its own, which Dask computes again when the workers that hold its result die."""
    return shipped


def _run(case: dict[str, Any], shipped: Shipped, timeout: float | None) -> dict[str, Any]:
    """The row of a case, on a worker; raises SetupError on one that joined with other code."""
    from distributed import get_worker

    worker = get_worker()
    problem = _difference(shipped.facts, facts())
    if problem:
        raise SetupError(f"worker {worker.address} differs: {problem}")
    folder = shipped.bundle.unpack(Path(worker.local_directory) / "studies")
    return SLOTS.run(case | {"folder": str(folder)}, timeout)


def _difference(client: Mapping[str, str], worker: Mapping[str, str]) -> str | None:
    """The first things that differ between the client and a worker, and how many do."""
    names = [name for name in {**client, **worker} if client.get(name) != worker.get(name)]
    if not names:
        return None
    shown = "; ".join(
        f"{name} is {worker.get(name, 'not there')} there and {client.get(name, 'not there')} here"
        for name in names[:2]
    )
    return shown + (f" and {len(names) - 2} more" if len(names) > 2 else "")


def rows(
    cases: Mapping[int, dict[str, Any]],
    bundle: Bundle,
    timeout: float | None,
    scheduler: str,
) -> Generator[tuple[int, dict[str, Any]]]:
    """Number and row of each case as they are done on the workers of a scheduler.

    Raises SetupError for a scheduler that cannot be reached, has no workers, or workers whose code
    or versions are not those of this process.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise SetupError("--scheduler needs the package distributed, the extra `dask`") from None
    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    with client:
        _check(client, scheduler)
        needed = Shipped(bundle, facts())
        shipped = client.submit(_ship, needed, pure=False)
        lost: dict[int, int] = {}
        submitted: dict[Any, int] = {}

        def submit(run: int) -> Any:
            nonlocal shipped
            if shipped.status == "error":
                shipped = client.submit(_ship, needed, pure=False)
            future = client.submit(_run, cases[run], shipped, timeout, pure=False)
            submitted[future] = run
            return future

        under_way = as_completed([submit(run) for run in cases], loop=client.loop)
        try:
            for future in under_way:
                run = submitted.pop(future)
                if future.status == "cancelled":
                    raise SetupError(f"the scheduler at {scheduler} is gone or cancelled the runs")
                try:
                    yield run, future.result()
                except KilledWorker as killed:
                    lost[run] = lost.get(run, 0) + 1
                    if lost[run] < LOST:
                        under_way.add(submit(run))
                    else:
                        yield run, _given_up(str(killed))
        finally:
            with contextlib.suppress(OSError, TimeoutError):
                client.cancel(list(submitted))
                client.run(_release, on_error="ignore")


def _given_up(reason: str) -> dict[str, Any]:
    return {
        "status": "crashed",
        "message": "its workers were lost again and again",
        "figures": {},
        "seconds": 0.0,
        "trace": reason,
    }


def _check(client: Any, scheduler: str) -> None:
    """Refuse workers that would compute something else."""
    try:
        client.wait_for_workers(1, timeout=WORKERS)
    except TimeoutError:
        raise SetupError(f"the scheduler at {scheduler} has no workers") from None
    call: Callable[[], dict[str, str]] = facts
    for worker, told in client.run(call, on_error="return").items():
        if isinstance(told, BaseException):
            raise SetupError(
                f"worker {worker} cannot do runs: {told}; start it in the project's folder"
            )
        problem = _difference(facts(), told)
        if problem:
            raise SetupError(f"worker {worker} differs: {problem}")
