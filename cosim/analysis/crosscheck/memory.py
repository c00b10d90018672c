"""The check of memory: many steps and many instances leave nothing behind."""

from __future__ import annotations

import gc
from itertools import pairwise
from mmap import PAGESIZE
from pathlib import Path

from ...errors import FmuError
from .subject import CheckFailed, NotOffered, Subject

#: Steps over which resident memory is watched. Chosen: a leak of a double a step is 80 KB.
MANY_STEPS = 10_000
#: Marks at which it is measured. Chosen: the first fifth is that of caches.
MARKS = 5
#: Resident memory that so many steps may take [bytes]. Chosen: below that leak.
STEP_LEAK = 64 * 1024
#: Instances that are made and freed to see what they leave in memory. Chosen: a second's work for most FMUs.
INSTANCES = 60
#: Share of the instances before the first measurement. Chosen: caches of the loader and of the C library are full.
EARLY_SHARE = 0.4
#: Resident memory that an instance may leave [bytes]: a quarter of a page of 64 KiB. Measured on the
#: project's own FMUs, instances leave less than 2 KiB.
INSTANCE_LEAK = 16 * 1024


def resident_after_collection() -> int:
    """The resident memory of this process [bytes]."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGESIZE


def memory(s: Subject) -> str:
    """Resident memory over many steps, ignoring the first ones, and over many instances."""
    if not Path("/proc/self/statm").exists():
        raise NotOffered("the memory of a process cannot be read here")
    sizes: list[int] = []
    taken, life = 0, MANY_STEPS
    while taken < MANY_STEPS:
        with s.running() as part:
            for k in range(min(life, MANY_STEPS - taken)):
                try:
                    part.advance(s.start + k * s.h, s.h)
                except FmuError:
                    life = k
                    break
                taken += 1
                if taken % (MANY_STEPS // MARKS) == 0:
                    sizes.append(resident_after_collection())
        if life <= s.steps // 2 or (s.once and life < MANY_STEPS):
            raise NotOffered(f"it takes no more than {life} steps with constant inputs")
    growths = [current - previous for previous, current in pairwise(sizes)]
    growth = f"{sum(growths) / 1024:.0f} KiB more after {MANY_STEPS} steps than after {MANY_STEPS // MARKS}"
    if sum(growths) > STEP_LEAK and sum(g > 0 for g in growths) > len(growths) / 2:
        raise CheckFailed(growth)
    return growth if s.once else f"{growth}; {_growth_by_instances(s)}"


def _growth_by_instances(s: Subject) -> str:
    """Resident memory over many instances, each initialised, stepped once and freed."""
    early = round(EARLY_SHARE * INSTANCES)
    marks = range(early, INSTANCES + 1, (INSTANCES - early) // (MARKS - 1))
    sizes = []
    for k in range(1, INSTANCES + 1):
        with s.running(1):
            pass
        if k in marks:
            sizes.append(resident_after_collection())
    growths = [current - previous for previous, current in pairwise(sizes)]
    growth = f"{sum(growths) / 1024:.0f} KiB more after {INSTANCES} instances than after {early}"
    if sum(growths) > INSTANCE_LEAK * (INSTANCES - early) and all(g > 0 for g in growths):
        raise CheckFailed(growth)
    return growth
