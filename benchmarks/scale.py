"""What a large system costs: python benchmarks/scale.py.

First, systems of 2 to 1 000 parts, pairs of native motor and conveyor under Jacobi: milliseconds to
describe, check, connect and start them, microseconds per step, per part and against two parts.
All is processor time.
Then 3 000 parts with 10 000 wires, described, checked and connected, and one FMU with 100 000
variables.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import System, run
from cosim.judge import describe
from cosim.master import Settings
from cosim.system import connect

FMUS, NATIVE = ROOT / "fmus", ROOT / "fmus" / "native"
H, DOSTEPS, ROUNDS = 1e-3, 1_000_000, 5
DESCRIPTION = "modelDescription.xml"


def pairs(count: int) -> System:
    """So many parts: motors and conveyors that are wired to and fro, two by two."""
    parts: dict[str, Path] = {}
    wires: list[str] = []
    for k in range(count // 2):
        parts |= {f"m{k}": NATIVE / "DriveMotor.fmu", f"c{k}": NATIVE / "CrankConveyor.fmu"}
        wires += [f"m{k}.tau -> c{k}.tau", f"c{k}.w -> m{k}.w"]
    return System(parts, wires)


def grid(count: int) -> System:
    """So many parts in a ring, with up to four wires from each to the next."""
    parts = {f"line.p{k}": FMUS / "LinearSystem.fmu" for k in range(count)}
    places = [(k, i) for k in range(count) for i in range(1, 5)]
    wired = places[: 10 * count // 3]
    wires = [f"line.p{k}.y[{i}] -> line.p{(k + 1) % count}.u[{i}]" for k, i in wired]
    start = {f"line.p{(k + 1) % count}.u[{i}]": 0.0 for k, i in places[len(wired) :]}
    return System(parts, wires, start)


def wide(count: int, folder: Path) -> System:
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


def seconds(work: Callable[[], Any]) -> float:
    """Processor time, which other programs do not lengthen."""
    began = time.process_time()
    work()
    return time.process_time() - began


def set_up(system: System) -> None:
    """Describe, check and connect."""
    network = connect(system)
    list(describe.info(network))
    describe.check(network, Settings(1.0, H, algorithm="jacobi"))


def costs(count: int) -> tuple[float, float]:
    """Seconds per part to set up and start a system, and to take a step; the best of some rounds."""
    system, steps = pairs(count), DOSTEPS // count
    settings: dict[str, Any] = {"step": H, "algorithm": "jacobi", "output_step": 1.0}

    def go(steps: int) -> Any:
        return run(system, stop=H * steps, record=["m0.tau"], **settings)

    go(1)
    ways: list[Callable[[], Any]] = [lambda: set_up(system), lambda: go(1), lambda: go(steps + 1)]
    rounds = [[seconds(way) for way in ways] for _ in range(ROUNDS)]
    described, started, whole = map(min, zip(*rounds))
    return (described + started) / count, (whole - started) / steps / count


def main() -> None:
    print(f"{'parts':>6}{'start ms/part':>15}{'ratio':>7}{'step us/part':>14}{'ratio':>7}")
    first = costs(2)
    for count in (2, 4, 10, 20, 50, 100, 200, 500, 1000):
        start, step = costs(count)
        print(
            f"{count:>6}{1e3 * start:>15.3f}{start / first[0]:>7.2f}"
            f"{1e6 * step:>14.3f}{step / first[1]:>7.2f}"
        )
    print(f"3 000 parts, 10 000 wires: {seconds(lambda: set_up(grid(3000))):.1f} s")
    with tempfile.TemporaryDirectory() as folder:
        system = wide(100_000, Path(folder))
        print(f"100 000 variables: {seconds(lambda: set_up(system)):.1f} s")


if __name__ == "__main__":
    main()
