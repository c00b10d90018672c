"""Runs on the processes of this machine."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from .bundle import Bundle
from .slots import Slots


def rows(
    cases: Mapping[int, dict[str, Any]],
    bundle: Bundle,
    timeout: float | None,
    jobs: int,
    folder: Path,
) -> Generator[tuple[int, dict[str, Any]]]:
    """Number and row of each case as they are done, so many at a time; the bundle goes to the folder."""
    place = {"folder": str(bundle.unpack(folder))}
    slots = Slots()
    with ThreadPoolExecutor(jobs) as threads:
        futures = {
            threads.submit(slots.run, case | place, timeout): run for run, case in cases.items()
        }
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            slots.close()
            threads.shutdown(wait=False, cancel_futures=True)
