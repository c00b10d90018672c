"""What a large system costs, and many small runs.

First, systems of 2 to 1 000 parts, pairs of native motor and conveyor under Jacobi: milliseconds to
describe, check, connect and start them, microseconds per step, per part and against two parts.
All is processor time.
Then 3 000 parts with 10 000 wires, described, checked and connected, and one FMU with 100 000
variables. Then runs of 100 steps of the pair, all included, after the first; and runs in two
threads against one after the other: in wall time, which other programs spoil, and the share of
processor time that only one thread at a time can have, for rows at every step and at every tenth.
`--certify` does none of this and backs the last paragraph of *What answers and many runs cost*.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import System, certify, describe, run
from cosim.engine import loop
from cosim.engine.settings import RunSettings
from cosim.requirements import setup_problems
from cosim.system import connect

#: The page that this backs, and its heading.
CLAIM = ("docs/speed.md", "Large systems")

FMUS, NATIVE = ROOT / "fmus", ROOT / "fmus" / "native"
#: Communication step [s]. Chosen: that of the FMUs' default experiment.
H = 1e-3
#: Steps of parts that a measurement takes in all. Chosen: a second or two.
DOSTEPS = 1_000_000
#: Repetitions, of which the fastest counts. Chosen: the rest of the machine is quiet in one of them.
ROUNDS = 5
DESCRIPTION = "modelDescription.xml"


def paired_parts(count: int) -> System:
    """So many parts, an even number: motors and conveyors that are wired to and fro, two by two."""
    parts: dict[str, Path] = {}
    wires: list[str] = []
    for k in range(count // 2):
        parts |= {f"m{k}": NATIVE / "DriveMotor.fmu", f"c{k}": NATIVE / "CrankConveyor.fmu"}
        wires += [f"m{k}.tau -> c{k}.tau", f"c{k}.w -> m{k}.w"]
    return System(parts, wires)


def ring(count: int) -> System:
    """So many parts in a ring, with up to four wires from each to the next."""
    parts = {f"line.p{k}": FMUS / "LinearSystem.fmu" for k in range(count)}
    outputs = [(k, i) for k in range(count) for i in range(1, 5)]
    wired = outputs[: 10 * count // 3]
    wires = [f"line.p{k}.y[{i}] -> line.p{(k + 1) % count}.u[{i}]" for k, i in wired]
    start = {f"line.p{(k + 1) % count}.u[{i}]": 0.0 for k, i in outputs[len(wired) :]}
    return System(parts, wires, start)


def one_part_with_variables(count: int, folder: Path) -> System:
    """A motor with so many variables more."""
    with ZipFile(NATIVE / "DriveMotor.fmu") as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    line = '<ScalarVariable name="v[{0}]" valueReference="1{0:06}" causality="local"><Real/>'
    lines = "".join(f"{line.format(k)}</ScalarVariable>" for k in range(count))
    text = files[DESCRIPTION].decode()
    files[DESCRIPTION] = text.replace("</ModelVariables>", f"{lines}</ModelVariables>").encode()
    with ZipFile(folder / "wide.fmu", "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return System({"motor": folder / "wide.fmu"}, start={"motor.w": 1.0})


def processor_time(work: Callable[[], Any]) -> float:
    """Processor time, which other programs do not lengthen."""
    began = time.process_time()
    work()
    return time.process_time() - began


def set_up(system: System) -> None:
    """Describe, check and connect."""
    network = connect(system)
    list(describe.info(network))
    settings = RunSettings(1.0, H, algorithm="jacobi")
    list(setup_problems(network, settings)), list(describe.notes(network, settings))


def costs(count: int) -> tuple[float, float]:
    """Seconds per part to set up and start a system, and to take a step; the best of some rounds."""
    system, steps = paired_parts(count), DOSTEPS // count
    settings: dict[str, Any] = {"step": H, "algorithm": "jacobi", "output_step": 1.0}

    def go(steps: int) -> Any:
        return run(system, stop=H * steps, record=["m0.tau"], **settings)

    go(1)
    tasks: list[Callable[[], Any]] = [lambda: set_up(system), lambda: go(1), lambda: go(steps + 1)]
    rounds = [[processor_time(task) for task in tasks] for _ in range(ROUNDS)]
    described, started, total = map(min, zip(*rounds))
    return (described + started) / count, (total - started) / steps / count


def compare_threads(every: int) -> tuple[float, float]:
    """Two threads against one after the other; the share of processor time under Python's lock."""
    tasks = [
        partial(run, paired_parts(2), stop=100.0, step=H, output_step=every * H) for _ in range(2)
    ]
    advance, free = loop.compiled_library().take_steps, [0.0]

    class Timed:
        """The compiled loop, which runs without the lock."""

        @staticmethod
        def take_steps(*arguments: Any) -> int:
            began = time.thread_time()
            count: int = advance(*arguments)
            free[0] += time.thread_time() - began
            return count

    with ThreadPoolExecutor(2) as pool:
        rounds = []
        for _ in range(4 * ROUNDS):
            began = time.perf_counter()
            for task in tasks:
                task()
            middle = time.perf_counter()
            list(pool.map(lambda task: task(), tasks))
            rounds.append((middle - began, time.perf_counter() - middle))
    original, loop.compiled_library = loop.compiled_library, lambda: Timed
    total = processor_time(tasks[0])
    loop.compiled_library = original
    sequential, parallel = map(min, zip(*rounds))
    return parallel / sequential, 1.0 - free[0] / total


def certify_rows(count: int) -> None:
    """Certify the pair with so many rows of the finest run, 1000 of them in the result; prints the memory [GB]."""
    system, stop = paired_parts(2), count * H / 4.0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    got = certify(system, stop=stop, step=H, output_step=max(H, stop / 1000.0))
    took, peak = time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    columns, stated = (
        len(got.result.columns),
        [e for e in got.figures.values() if e.error is not None],
    )
    print(
        f"{count} rows of {columns} columns certified: {took:.1f} s, {peak / 1e6:.2f} GB at most, "
        f"{before / 1e6:.2f} GB before; {len(stated)} of {len(got.figures)} errors stated"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--certify", type=int, metavar="ROWS",
        help="only certify a run whose finest has so many rows of 14 columns, and print the memory that this takes",
    )  # fmt: skip
    options = parser.parse_args()
    if options.certify is not None:
        certify_rows(options.certify)
        return
    print(f"{'parts':>6}{'start ms/part':>15}{'ratio':>7}{'step us/part':>14}{'ratio':>7}")
    first = costs(2)
    for count in (2, 4, 10, 20, 50, 100, 200, 500, 1000):
        start, step = costs(count)
        print(
            f"{count:>6}{1e3 * start:>15.3f}{start / first[0]:>7.2f}"
            f"{1e6 * step:>14.3f}{step / first[1]:>7.2f}"
        )
    print(f"3 000 parts, 10 000 wires: {processor_time(lambda: set_up(ring(3000))):.1f} s")
    with tempfile.TemporaryDirectory() as folder:
        system = one_part_with_variables(100_000, Path(folder))
        print(f"100 000 variables: {processor_time(lambda: set_up(system)):.1f} s")
    short = partial(run, paired_parts(2), stop=0.1, step=H)
    times = [processor_time(short) for _ in range(50)]
    print(f"100 steps of the pair, all included: {1e3 * statistics.median(times):.2f} ms")
    for every in (1, 10):
        ratio, locked = compare_threads(every)
        print(f"two threads, a row every {every}: {ratio:.2f} of the time, {locked:.2f} locked")


if __name__ == "__main__":
    main()
