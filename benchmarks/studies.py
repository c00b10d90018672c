"""How studies scale from one worker to two: python benchmarks/studies.py [--runs N] [--rounds N].

The same study, resonances of the conveyor's drive that take a second or more each on native FMUs, on
one and two processes of the pool and on one and two workers of a Dask cluster on this machine, one
after the other, round after round. Shown are medians of the wall time of the whole study, start-up
of the processes and pictures included, and the ratio of one to two.
The machine must be idle.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from distributed import LocalCluster

from scenarios.project import PROJECT
from workbench import study

STUDY = """
scenario = "resonance"
[fixed]
speeds = "30:52:7"
steps_per_rev = 512
[grid]
"motor.T" = {{ from = 0.055, to = 0.07, number = {runs} }}
"""
WORKERS = (1, 2)


def pool(path: Path, out: Path, workers: int) -> float:
    """Wall time of the study on so many processes."""
    began = time.perf_counter()
    study.run(study.load(path, PROJECT), out=out, jobs=workers, flavour="native")
    return time.perf_counter() - began


def dask(path: Path, out: Path, workers: int) -> float:
    """Wall time of the study on so many workers that are there already."""
    settings = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=workers, processes=True, **settings) as cluster:
        began = time.perf_counter()
        plan = study.load(path, PROJECT)
        study.run(plan, out=out, scheduler=cluster.scheduler_address, flavour="native")
        return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=80)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    times: dict[tuple[str, int], list[float]] = {}
    tables: set[bytes] = set()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.toml"
        path.write_text(STUDY.format(runs=options.runs))
        pool(path, Path(folder) / "warm", WORKERS[-1])
        for k in range(options.rounds):
            for runner in (pool, dask):
                for workers in WORKERS:
                    out = Path(folder) / f"{runner.__name__}_{workers}_{k}"
                    times.setdefault((runner.__name__, workers), []).append(
                        runner(path, out, workers)
                    )
                    tables.add((out / "table.csv").read_bytes())
    assert len(tables) == 1, "the tables differ"
    fewer, more = WORKERS
    print(f"{options.runs} runs, {options.rounds} rounds, medians")
    print(f"{'':<6}{fewer:>8} worker{more:>8} workers{'ratio':>8}")
    for runner in ("pool", "dask"):
        single, double = (statistics.median(times[runner, workers]) for workers in WORKERS)
        print(f"{runner:<6}{single:>13.2f} s{double:>14.2f} s{single / double:>8.2f}")


if __name__ == "__main__":
    main()
