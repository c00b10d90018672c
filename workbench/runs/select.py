"""Which runner does the runs."""

from __future__ import annotations

from collections.abc import Sequence

from cosim import SetupError

from .cluster import ClusterRunner
from .local import LocalRunner
from .runner import Runner, Setup


def select_runner(
    jobs: int | None = None, scheduler: str | None = None, packages: Sequence[str] = ()
) -> Runner:
    """Return a runner in so many processes of this machine, or on the cluster of a Dask scheduler.

    Parameters
    ----------
    jobs : int, optional
        Processes, by default as many as there are cores.
    scheduler : str, optional
        Its address, "tcp://host:8786".
    packages : sequence of str
        Packages whose code must be the same on all machines.

    Raises
    ------
    SetupError
        For jobs together with a scheduler, and for what neither can be.
    """
    if jobs is not None and scheduler is not None:
        raise SetupError("jobs are processes of this machine; the scheduler has its own workers")
    if scheduler is not None:
        return ClusterRunner(scheduler, setup=Setup(packages))
    return LocalRunner(jobs, setup=Setup(packages))
