"""What runs, answers and studies cost here, in another checkout and by other masters.

All drive motor and conveyor by native FMUs in fixed steps; each line is processor time of a process of its own, child
processes included, for one run, answer or study after a first one, the median of some rounds. `--against` names a folder
with a checkout of its own environment and built FMUs. The other masters are driven as benchmarks/coupling.py does it, with
new instances for each run, and change nothing from run to run. `--threads` compares two threads of members with two
processes of limit.c, in wall time, which needs two idle cores.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import coupling
from cosim import Prepared, RunSettings, System

#: The page that this backs, and its heading.
CLAIM = ("docs/speed.md", "What answers and many runs cost")

#: Steps of a run, and their size [s].
STEPS, H = 1000, 3e-4
#: Members of an ensemble. Chosen: what they share is a thousandth of each.
MEMBERS = 1000
COLUMNS = ["motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod"]
WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
#: What a checkout is asked to do once, by the name in the table; `runs` says how many runs that is.
WORK = """
import sys, tempfile, time, resource
from pathlib import Path
name, fmus, steps, h, every, count, rounds = sys.argv[1], Path(sys.argv[2]), *map(eval, sys.argv[3:])
sys.path.insert(0, str(fmus.parents[1]))
import cosim
parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
drive = cosim.System(parts, ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"])
columns = ["motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod"]
settings = dict(stop=steps * h, output_step=every * h, record=columns)
values = [7000.0 + k for k in range(count)]
is_new = hasattr(cosim, "Prepared")
def run():
    for a in values:
        cosim.run(cosim.System(parts, drive.wires, {"motor.A": a}), step=h, **settings)
def member():
    with cosim.Prepared.open(drive, cosim.RunSettings(step=h, **settings)) as prepared:
        for block in prepared.blocks({"motor.A": values}):
            assert not len(block.failed)
def sweep():
    from cosim.metrics import Largest
    if is_new:
        cosim.sweep(drive, {"motor.A": values}, {"torque": Largest("motor.tau")}, step=h, **settings)
        return
    for a in values:
        r = cosim.run(cosim.System(parts, drive.wires, {"motor.A": a}), step=h, **settings)
        r["motor.tau"].max()
def certify():
    cosim.certify(drive, step=h if is_new else 4 * h, **settings)
def question():
    from scenarios import ask
    ask("resonance", jobs=1)
def study():
    import scenarios
    lines = 'scenario = "resonance"\\n[fixed]\\nspeeds = "30:52:7"\\nsteps_per_rev = 512\\n[grid]\\n'
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.toml"
        file.write_text(f'{lines}"motor.T" = {{ from = 0.055, to = 0.07, number = {count} }}\\n')
        scenarios.study(file, out=Path(folder) / "out", jobs=1, flavour="native")
def seconds():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(x.ru_utime + x.ru_stime for x in used)
work = globals()[name]
if name != "study":
    work()
for _ in range(rounds):
    began = seconds()
    work()
    print("seconds", (seconds() - began) / count)
"""
#: Runs of work that is too long for several rounds.
FEW = 4
#: Lines of the table: what it is, the work here and in the other checkout, steps, steps from row to row, how many runs
#: here and there.
LINES = (
    ("a run of one step; a member", "member", "run", 1, 1, 10 * MEMBERS, 100),
    (f"a run of {STEPS} steps, all rows; a member", "member", "run", STEPS, 1, MEMBERS, 50),
    (f"a run of {STEPS} steps, two rows; a member", "member", "run", STEPS, STEPS, MEMBERS, 50),
    (f"a single run of {STEPS} steps, all rows", "run", "run", STEPS, 1, 50, 50),
    ("a run of a sweep, with its largest torque", "sweep", "sweep", STEPS, 1, MEMBERS, 50),
    (f"certify, {STEPS} finest steps, 16 figures", "certify", "certify", STEPS, 1, 1, 1),
    ("`resonance`, again in a process", "question", "question", 1, 1, 1, 1),
    (
        "a run of a study of `resonance`, its own start-up included",
        "study",
        "study",
        1,
        1,
        FEW,
        FEW,
    ),
)
#: Ways to do the runs by another master, in coupling.py.
OTHERS = {
    "FMPy's methods in a loop": "fmpy methods, native FMUs",
    "Ecos": "Ecos, native FMUs",
    "libcosim": "libcosim, native FMUs",
}


def in_checkout(folder: Path, work: str, *numbers: float) -> float:
    """The processor time [s] of a run of some work in a checkout, nan where it has no such work."""
    command = [folder / ".venv" / "bin" / "python", "-c", WORK, work, folder / "fmus" / "native"]
    done = subprocess.run(
        [*map(str, (*command, *numbers))], check=False, capture_output=True, text=True, cwd=folder
    )
    if done.returncode:
        print(done.stderr[-2000:], file=sys.stderr)
        return float("nan")
    lines = [line.split() for line in done.stdout.splitlines()]
    return median(float(line[1]) for line in lines if line[:1] == ["seconds"])


def compare(folder: Path, rounds: int) -> None:
    """Print what answers cost here beside another checkout."""
    print(f"| | {folder.name} | here | ratio |\n|---|---|---|---|")
    for text, here, there, steps, every, now_runs, before_runs in LINES:
        before, now = (
            in_checkout(place, work, steps, H, every, runs, rounds if runs > FEW else 1)
            for place, work, runs in ((folder, there, before_runs), (ROOT, here, now_runs))
        )
        print(
            f"| {text} | {1e3 * before:.4g} ms | {1e3 * now:.4g} ms | {before / now:.3g} |",
            flush=True,
        )


def others(rounds: int) -> None:
    """Print what a run costs by other masters, each in a process of its own."""
    print("| a run of 1 000 steps by | |\n|---|---|")
    for text, way in OTHERS.items():
        command = [sys.executable, __file__, "--way", way, "--rounds", str(rounds)]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        times = [
            line.split()[1] for line in done.stdout.splitlines() if line.startswith("seconds ")
        ]
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        print(
            f"| {text} | {1e3 * float(times[0]):.3g} ms |"
            if times
            else f"| {text} | not run: {reason} |",
            flush=True,
        )


def time_other_master(way: str, rounds: int) -> None:
    """Print the processor time of a run by another master, after a first one."""
    make, fmus = coupling.METHODS[way]
    times = []
    for _ in range(rounds + 1):
        began = time.process_time()
        make(STEPS, fmus)()
        times.append(time.process_time() - began)
    print("\nseconds", median(times[1:]), flush=True)


def drive() -> System:
    """Motor and conveyor."""
    fmus = ROOT / "fmus" / "native"
    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    return System(parts, WIRES)


def memory(members: int) -> None:
    """Print by how much the memory of this process grows from a hundredth of so many members to all."""
    settings = RunSettings(10 * H, H, record=COLUMNS)
    with Prepared.open(drive(), settings) as prepared:

        def largest(n: int) -> float:
            for block in prepared.blocks({"motor.A": np.linspace(7000.0, 8000.0, n)}):
                assert not len(block.failed)
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0

        few, all_ = largest(members // 100), largest(members)
    print(f"memory after {members // 100} members {few:.0f} MB, after {members} {all_:.0f} MB")


def threads(rounds: int) -> None:
    """Print the wall time of two threads of members over that of one, beside two processes of limit.c over one."""
    cases = {"motor.A": np.linspace(7000.0, 8000.0, MEMBERS)}

    def wall(work: Callable[[], Any]) -> float:
        began = time.perf_counter()
        work()
        return time.perf_counter() - began

    with tempfile.TemporaryDirectory() as folder:
        program, *_ = coupling.compiled(Path(folder)).values()

        def by_hand(count: int) -> None:
            command = [str(program), str(MEMBERS * STEPS), "1"]
            running = [
                subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                for _ in range(count)
            ]
            for process in running:
                process.wait()

        settings = RunSettings(STEPS * H, H, output_step=STEPS * H, record=COLUMNS)
        with Prepared.open(drive(), settings) as prepared:
            prepared.map(cases, jobs=2)
            ratios = [
                (
                    wall(lambda: prepared.map(cases, jobs=2)) / wall(lambda: prepared.map(cases)),
                    0.5 * wall(lambda: by_hand(2)) / wall(lambda: by_hand(1)),
                )
                for _ in range(rounds)
            ]
    ours, bare = map(median, zip(*ratios))
    print(f"two threads take {ours:.2f} of the time of one, two processes of limit.c {bare:.2f}")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, default=ROOT)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--memory", type=int, default=100_000)
    parser.add_argument("--threads", action="store_true")
    parser.add_argument("--way", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        time_other_master(options.way, options.rounds)
    elif options.threads:
        threads(options.rounds)
    else:
        compare(options.against.resolve(), options.rounds)
        others(options.rounds)
        memory(options.memory)
    return 0


if __name__ == "__main__":
    sys.exit(main())
