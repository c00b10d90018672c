"""Runs on a Dask cluster: files travel once to each worker, and Dask does the runs of a lost worker again.

A worker does its runs in child processes, so that it outlives them.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import pickle
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from distributed import Client, KilledWorker, Security, Worker, WorkerPlugin, get_worker

from cosim import SetupError
from cosim.calls import Caller, Outcome
from cosim.journal import RunFailedError, differences

from ..catalog import load_cached
from .folder import contents, unpack
from .identity import facts

#: Time to reach the scheduler [s], a convention of this project.
CONNECT = 10.0
#: Time to wait for the first worker [s], a convention of this project; a worker starts in a few seconds.
WORKERS = 30.0
#: Time without any worker before the runs are given up [s], a convention of this project; a restarted worker takes
#: a few seconds.
GRACE = 60.0
#: Time between two checks of whether there still are workers [s], chosen: far less than GRACE.
POLL = 1.0
TLS = "tls://"
Outcomes = Generator[tuple[int, Outcome]]
KEPT = "what was computed is kept, and the same command continues"


class Files(WorkerPlugin):  # type: ignore[misc]
    """The files of one study's runs on a worker, what of its code is another, and its child processes that have nothing to do."""

    def __init__(self, files: Mapping[str, bytes], packages: Sequence[str]) -> None:
        self.name, self._files = uuid4().hex, files
        self._packages, self._needed = packages, facts(*packages)

    def setup(self, worker: Worker) -> None:
        """Compare the code, and write the files where this worker may write."""
        self.differences = differences(facts(*self._packages), self._needed)
        self.folder = Path(worker.local_directory) / "runs" / self.name
        unpack(self._files, self.folder)
        self.idle: SimpleQueue[Caller] = SimpleQueue()
        multiprocessing.current_process().daemon = (
            False  # a nanny's worker may have no children else
        )

    def teardown(self, worker: Worker) -> None:  # noqa: ARG002
        """End the children."""
        while not self.idle.empty():
            self.idle.get_nowait().close()


class _Pickler(pickle.Pickler):
    files: Sequence[Path]

    def persistent_id(self, value: Any) -> str | None:
        return value.name if isinstance(value, Path) and value in self.files else None


class _Unpickler(pickle.Unpickler):
    folder: Path

    def persistent_load(self, name: str) -> Path:
        return self.folder / name


def _pickled(call: tuple[Callable[[Any], Any], Any], files: Sequence[Path]) -> bytes:
    """A function and its task for a machine where these files are in another folder."""
    content = io.BytesIO()
    pickler = _Pickler(content)
    pickler.files = files
    pickler.dump(call)
    return content.getvalue()


def _call(call: tuple[bytes, Path]) -> Any:
    """function(task) of what was pickled, with its files in a folder."""
    unpickler = _Unpickler(io.BytesIO(call[0]))
    unpickler.folder = call[1]
    function, task = unpickler.load()
    return function(task)


def _run(call: bytes, timeout: float | None, *, plugin: str, page: str) -> Outcome:
    """Return what becomes of a call, on a worker; raise SetupError on one whose code is another."""
    worker = get_worker()
    shipped = worker.plugins[plugin]
    if shipped.differences:
        raise SetupError(f"worker {worker.address} differs: {shipped.differences} on this side")
    copy = shipped.folder / Path(page).name
    try:
        child = shipped.idle.get_nowait()
    except Empty:
        child = Caller()
    prepare = partial(load_cached, str(copy) if copy.is_file() else page) if page else None
    outcome: Outcome = child.do(_call, (call, shipped.folder), timeout, prepare)
    shipped.idle.put(child)
    return outcome


def stream(
    scheduler: str,
    calls: Mapping[int, tuple[Callable[[Any], Any], Any, float | None]],
    page: str,
    files: Sequence[Path],
    packages: Sequence[str],
) -> Outcomes:
    """Give key and outcome of each call of a function of a task within a time [s], by workers whose code is this one's.

    Raises
    ------
    SetupError
        For a scheduler that cannot be reached, has no workers, or workers whose code or versions are not
        those of this process.
    SimulationError
        If all workers are gone for a minute, or if Dask gives up on a run whose workers were lost.
    """
    if not calls:
        return
    with _connect(scheduler) as client:
        plugin = Files(contents(files), packages)
        try:
            client.wait_for_workers(1, timeout=WORKERS)
            client.register_plugin(plugin)
        except TimeoutError:
            raise SetupError(f"the scheduler at {scheduler} has no workers") from None
        except Exception as error:  # noqa: BLE001 Dask raises no other
            raise SetupError(
                f"a worker cannot do runs: {error}; start it in the project's folder"
            ) from None
        sent = [_pickled((function, task), files) for function, task, _ in calls.values()]
        limits = [limit for *_, limit in calls.values()]
        futures = client.map(_run, sent, limits, plugin=plugin.name, page=page, pure=False)
        try:
            yield from _outcomes(client, scheduler, dict(zip(futures, calls)))
        finally:
            with contextlib.suppress(OSError, TimeoutError):
                client.cancel(futures)
                client.unregister_worker_plugin(plugin.name)


def _connect(scheduler: str) -> Any:
    """Return a client of a scheduler."""
    if scheduler.startswith(TLS) and not Security().get_connection_args("client")["ssl_context"]:
        raise SetupError(
            f"scheduler = {scheduler!r} needs the certificates of this side; Dask reads their files "
            "from DASK_DISTRIBUTED__COMM__TLS__CA_FILE, __CLIENT__CERT and __CLIENT__KEY"
        )
    try:
        return Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from None


def _outcomes(client: Any, scheduler: str, key_of: dict[Any, int]) -> Outcomes:
    """Give key and outcome of each run as they are done."""
    done: SimpleQueue[Any] = SimpleQueue()
    for future in key_of:
        future.add_done_callback(done.put)
    last_contact = time.monotonic()
    while key_of:
        future = None
        try:
            future = done.get(timeout=POLL)
            if future.status == "cancelled":
                raise SetupError(f"the scheduler at {scheduler} is gone or has ended the runs")
            outcome = future.result(timeout=POLL)
        except (Empty, TimeoutError):
            if future is not None:  # its worker was lost before the answer was fetched
                done.put(future)
            last_contact = _last_contact(client, scheduler, last_contact)
        except KilledWorker as killed:
            raise RunFailedError(f"run {key_of[future]}: {killed}; {KEPT}") from None
        else:
            last_contact = time.monotonic()
            yield key_of.pop(future), outcome


def _last_contact(client: Any, scheduler: str, previous: float) -> float:
    """Return when there were workers last; give up when there have been none for a while."""
    with contextlib.suppress(OSError, TimeoutError):
        if client.nthreads():
            return time.monotonic()
    if time.monotonic() < previous + GRACE:
        return previous
    raise RunFailedError(f"the scheduler at {scheduler} has had no workers for {GRACE:g} s; {KEPT}")
