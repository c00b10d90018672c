"""What many runs cost beside single ones, in processor time, here and in another checkout of this project.

    .venv/bin/python benchmarks/answers.py [--against FOLDER] [--members N] [--memory N]

Both run the drive of motor and conveyor, native FMUs, in fixed steps. `--against` names a folder with a checkout of its
own environment and built FMUs, whose `run` in a loop is what the members are compared with.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cosim import Prepared, RunSettings, System
from cosim.ensemble import Ensemble

ROOT = Path(__file__).resolve().parents[1]
#: Steps of a run, and their size [s].
STEPS, H = 1000, 3e-4
#: Rounds whose median counts.
ROUNDS = 5
COLUMNS = ["motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod"]
WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
#: What the other checkout does: the same runs, one after the other; it prints seconds of processor time per run.
LOOP = """
import sys, time
from pathlib import Path
from cosim import System, run
fmus, steps, every, runs = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
def one(a):
    drive = System(parts, ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"], {"motor.A": a})
    run(drive, stop=steps * 3e-4, step=3e-4, output_step=every * 3e-4,
        record=["motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod"])
one(8000.0)
for _ in range(int(sys.argv[5])):
    began = time.process_time()
    for k in range(runs):
        one(7000.0 + k)
    print((time.process_time() - began) / runs)
"""


def drive(fmus: Path) -> System:
    """Motor and conveyor."""
    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    return System(parts, WIRES)


def seconds(action: Callable[[], Any]) -> float:
    """The processor time of an action [s]."""
    began = time.process_time()
    action()
    return time.process_time() - began


def cases(n: int) -> dict[str, Any]:
    """As many values of the motor's characteristic."""
    return {"motor.A": np.linspace(7000.0, 8000.0, n)}


def per_member(steps: int, every: int, n: int) -> float:
    """The processor time of a member [s] whose rows are every so many steps, in pieces whose memory is used again."""
    settings = RunSettings(steps * H, H, output_step=every * H, record=COLUMNS)
    with Prepared.open(drive(ROOT / "fmus" / "native"), settings) as prepared:

        def blocks() -> None:
            for block in prepared.blocks(cases(n)):
                assert not len(block.failed)

        blocks()
        return median(seconds(blocks) for _ in range(ROUNDS)) / n


def single_runs(steps: int, every: int, runs: int, folder: Path) -> float:
    """The processor time of a run [s] in a checkout."""
    command = [folder / ".venv" / "bin" / "python", "-c", LOOP, folder / "fmus" / "native"]
    arguments = [steps, every, runs, ROUNDS]
    done = subprocess.run(
        [*map(str, (*command, *arguments))], check=True, capture_output=True, text=True, cwd=folder
    )
    return median(map(float, done.stdout.split()))


def compare(folder: Path, members: int) -> None:
    """Print what members cost beside single runs of a checkout."""
    print(f"{'':34}{'run':>12}{'member':>12}{'ratio':>8}")
    for name, steps, every in (
        ("one step", 1, 1),
        (f"{STEPS} steps, all rows", STEPS, 1),
        (f"{STEPS} steps, two rows", STEPS, STEPS),
    ):
        n = members if steps > 1 else 10 * members
        before = single_runs(steps, every, 200 if steps == 1 else 50, folder)
        now = per_member(steps, every, n)
        print(f"{name:34}{before * 1e6:9.1f} us{now * 1e6:9.1f} us{before / now:8.2f}")


def memory(members: int) -> None:
    """Print by how much the memory of this process grows from a hundredth of so many members to all."""
    settings = RunSettings(10 * H, H, record=COLUMNS)
    with Prepared.open(drive(ROOT / "fmus" / "native"), settings) as prepared:

        def largest(n: int) -> float:
            for block in prepared.blocks(cases(n)):
                assert isinstance(block, Ensemble) and not len(block.failed)
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0

        few, all_ = largest(members // 100), largest(members)
    print(f"memory after {members // 100} members {few:.0f} MB, after {members} {all_:.0f} MB")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--against", type=Path, default=ROOT)
    parser.add_argument("--members", type=int, default=1000)
    parser.add_argument("--memory", type=int, default=100_000)
    options = parser.parse_args()
    compare(options.against.resolve(), options.members)
    memory(options.memory)
    return 0


if __name__ == "__main__":
    sys.exit(main())
