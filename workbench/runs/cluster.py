"""Runs on a Dask cluster: FMUs travel with them, a lost worker's runs are done again.

A worker does its runs in child processes, so that it outlives them. What kills a worker comes from
outside; Dask gives up on a run after some lost workers, and then it is submitted anew.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import pickle
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from types import MappingProxyType
from typing import Any, NamedTuple

from cosim import SetupError
from cosim.journal import differences

from .bundle import Bundle
from .fingerprint import facts
from .journal import Key
from .runner import Outcomes, RunFailedError, Runner
from .worker import MAX_DEATHS, CallWorker, Outcome

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
ADDRESS = re.compile(r"(\w+://)?\S+:\d+")
#: Child processes of this worker that have nothing to do.
_idle: SimpleQueue[CallWorker] = SimpleQueue()


class Shipment(NamedTuple):
    """What all runs need: the question's page, its files, and the packages with what their code must be."""

    page: str
    bundle: Bundle
    packages: Sequence[str]
    facts: Mapping[str, Any]


class _Sealer(pickle.Pickler):
    files: Sequence[Path]

    def persistent_id(self, value: Any) -> str | None:
        return value.name if isinstance(value, Path) and value in self.files else None


class _Opener(pickle.Unpickler):
    folder: Path

    def persistent_load(self, name: str) -> Path:
        return self.folder / name


def sealed(function: Callable[[Any], Any], task: Any, files: Sequence[Path]) -> bytes:
    """function(task) for a machine where these files are in another folder."""
    content = io.BytesIO()
    sealer = _Sealer(content)
    sealer.files = files
    sealer.dump((function, task))
    return content.getvalue()


def run_sealed(call: tuple[bytes, Path]) -> Any:
    """function(task) of what was `sealed`, with its files in a folder."""
    content, folder = call
    opener = _Opener(io.BytesIO(content))
    opener.folder = folder
    function, task = opener.load()
    return function(task)


@dataclass(frozen=True)
class ClusterRunner(Runner):
    """Does runs on the workers of a Dask scheduler, "tcp://host:8786", whose code must be that of this process.

    Raises
    ------
    SetupError
        For what is no address.
    """

    scheduler: str

    def __post_init__(self) -> None:
        if not ADDRESS.fullmatch(self.scheduler):
            raise SetupError(f"scheduler = {self.scheduler!r} must read tcp://HOST:PORT")

    def stream(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[Key, Any],
        limits: Mapping[Key, float] = MappingProxyType({}),
        *,
        is_isolated: bool = True,  # noqa: ARG002
    ) -> Outcomes:
        """Give key and outcome of each task; they are always isolated.

        Raises
        ------
        SetupError
            For a scheduler that cannot be reached, has no workers, or workers whose code or versions are not
            those of this process.
        SimulationError
            If all workers are gone for a minute.
        """
        if not tasks:
            return
        with _connect(self.scheduler) as client:
            shipment = Shipment(
                self.page, Bundle.of(self.files), self.packages, facts(*self.packages)
            )
            _check(client, self.scheduler, shipment)
            calls = {key: sealed(function, task, self.files) for key, task in tasks.items()}
            submissions = _Submissions(client, self.scheduler, shipment, calls, limits)
            try:
                yield from submissions.outcomes()
            finally:
                with contextlib.suppress(OSError, TimeoutError):
                    client.cancel(list(submissions.key_of))
                    client.run(_end_idle_children, on_error="ignore")


def _connect(scheduler: str) -> Any:
    """Return a client of a scheduler."""
    try:
        from distributed import Client, Security
    except ImportError:
        raise SetupError(
            '--scheduler needs the package distributed: write pip install "drive-fmus[cluster]"'
        ) from None
    if scheduler.startswith(TLS) and not Security().get_connection_args("client")["ssl_context"]:
        raise SetupError(
            f"scheduler = {scheduler!r} needs the certificates of this side; Dask reads their files "
            "from DASK_DISTRIBUTED__COMM__TLS__CA_FILE, __CLIENT__CERT and __CLIENT__KEY"
        )
    try:
        return Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from None


class _Submissions:
    """The runs that a client has submitted; those of lost workers are submitted again."""

    def __init__(
        self,
        client: Any,
        scheduler: str,
        shipment: Shipment,
        calls: Mapping[Key, bytes],
        limits: Mapping[Key, float],
    ) -> None:
        self._client, self._scheduler, self._shipment = client, scheduler, shipment
        self._calls, self._limits = calls, limits
        self._shipped = client.submit(_keep_on_worker, self._shipment, pure=False)
        self._deaths: Counter[Key] = Counter()
        self._done: SimpleQueue[Any] = SimpleQueue()
        self.key_of: dict[Any, Key] = {}

    def submit(self, key: Key) -> None:
        """Submit a run, and what all runs need again if its workers were lost."""
        if self._shipped.status == "error":
            self._shipped = self._client.submit(_keep_on_worker, self._shipment, pure=False)
        future = self._client.submit(
            _run, self._calls[key], self._shipped, self._limits.get(key), pure=False
        )
        self.key_of[future] = key
        future.add_done_callback(self._done.put)

    def outcomes(self) -> Outcomes:
        """Give key and outcome of each run as they are done."""
        for key in self._calls:
            self.submit(key)
        last_contact = time.monotonic()
        while self.key_of:
            try:
                future = self._done.get(timeout=POLL)
            except Empty:
                last_contact = _last_contact(self._client, self._scheduler, last_contact)
                continue
            try:
                outcome = self._outcome(future)
            except TimeoutError:  # its worker was lost before the answer was fetched
                self._done.put(future)
                last_contact = _last_contact(self._client, self._scheduler, last_contact)
                continue
            if outcome is not None:
                last_contact = time.monotonic()
                yield self.key_of.pop(future), outcome

    def _outcome(self, future: Any) -> Outcome | None:
        """Return what became of a run; None where its workers were lost and it is submitted again."""
        from distributed import KilledWorker

        if future.status == "cancelled":
            raise SetupError(f"the scheduler at {self._scheduler} is gone or has ended the runs")
        try:
            outcome: Outcome = future.result(timeout=POLL)
        except KilledWorker as killed:
            key = self.key_of[future]
            self._deaths[key] += 1
            if self._deaths[key] < MAX_DEATHS:
                del self.key_of[future]
                self.submit(key)
                return None
            return Outcome(
                "crashed", None, "its workers were lost again and again", 0.0, str(killed)
            )
        return outcome


def _check(client: Any, scheduler: str, shipment: Shipment) -> None:
    """Refuse workers that would compute something else; one without our code would die of a run."""
    try:
        client.wait_for_workers(1, timeout=WORKERS)
    except TimeoutError:
        raise SetupError(f"the scheduler at {scheduler} has no workers") from None
    remote = client.run(facts, *shipment.packages, on_error="return")
    for worker, remote_facts in remote.items():
        if isinstance(remote_facts, BaseException):
            raise SetupError(
                f"worker {worker} cannot do runs: {remote_facts}; start it in the project's folder"
            )
        _check_same(worker, remote_facts, shipment.facts)


def _check_same(
    worker: str, remote_facts: Mapping[str, Any], local_facts: Mapping[str, Any]
) -> None:
    if remote_facts != local_facts:
        raise SetupError(
            f"worker {worker} differs: {differences(remote_facts, local_facts)} on this side"
        )


def _last_contact(client: Any, scheduler: str, previous: float) -> float:
    """Return when there were workers last; give up when there have been none for a while."""
    with contextlib.suppress(OSError, TimeoutError):
        if client.nthreads():
            return time.monotonic()
    if time.monotonic() < previous + GRACE:
        return previous
    raise RunFailedError(
        f"the scheduler at {scheduler} has had no workers for {GRACE:g} s; what was computed is kept, "
        "and the same command continues"
    )


def _keep_on_worker(shipment: Shipment) -> Shipment:
    """A task of its own, which Dask computes again when the workers that hold its result die."""
    return shipment


def _run(call: bytes, shipment: Shipment, timeout: float | None) -> Outcome:
    """Return what becomes of a call, on a worker; raise SetupError on one whose code is another."""
    from distributed import get_worker

    worker = get_worker()
    _check_same(worker.address, facts(*shipment.packages), shipment.facts)
    folder = shipment.bundle.unpacked_folder(Path(worker.local_directory) / "runs")
    copy = folder / Path(shipment.page).name
    page = str(copy) if copy.is_file() else shipment.page
    multiprocessing.current_process().daemon = False  # a nanny's worker may have no children else
    try:
        child = _idle.get_nowait()
    except Empty:
        child = CallWorker()
    outcome = child.do(run_sealed, (call, folder), timeout, page)
    _idle.put(child)
    return outcome


def _end_idle_children() -> None:
    """End the child processes of this worker that have nothing to do."""
    while not _idle.empty():
        _idle.get_nowait().close()
