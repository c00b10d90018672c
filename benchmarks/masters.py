"""Error and time of co-simulation masters over the step size: python benchmarks/masters.py.

Five systems of FMUs run in the masters of the package index, each in an environment of its own that uv makes
(`--environments` takes ready ones instead). All get the same FMUs, start values, wires and steps, and hold
their inputs over a step unless their name says otherwise. The truth is one differential equation, made of the
model-exchange sides of all FMUs and integrated by `oracle`.

The error of a run is the largest difference from the truth of any exchanged signal at any row, as a share of
the signal's range. Some masters label a row with the time at which its step began: rows are taken as labelled
or one step later, whichever is closer to the truth. The time is that of the processor for the steps alone.
Writes results/masters.json, results/masters.png, and a table for each system.

With --referee, `cosim referee` judges the results of the others instead, and an integration without any FMU judges the
referee. Writes results/masters_referee.json and a table.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.masters_referee import LARGEST_SHARE, Judgement, judge, summary
from benchmarks.masters_referee import table as judgement_table
from benchmarks.masters_systems import Case, cases, exchanged, wire_ends
from cosim import Result, SimulationError, certify, oracle, run, write_ssp
from fmukit.fmu.make import make_all

CLIENTS = Path(__file__).with_name("masters_clients.py")
#: what uv installs for each master; FMPy is needed in the version that CoFMuPy asks for
REQUIREMENTS = {
    "fmpy": ("fmpy==0.3.32",),
    "pathsim-cs": ("pathsim==0.27.1", "pathsim-fmi==0.1.1"),
    "pathsim-me": ("pathsim==0.27.1", "pathsim-fmi==0.1.1"),
    "cofmupy-jacobi": ("cofmupy==1.0.0",),
    "cofmupy-gauss-seidel": ("cofmupy==1.0.0",),
    "ecos": ("ecospy==0.7.2", "tbb"),
    "libcosim": ("libcosimpy==0.0.6",),
}
#: algorithms of the master of this project, by what the table calls them
OURS: dict[str, dict[str, Any]] = {
    "cosim-jacobi": {"algorithm": "jacobi"},
    "cosim-gauss-seidel": {"algorithm": "gauss-seidel"},
    "cosim-strang": {"algorithm": "strang"},
    "cosim-gauss-seidel-order-2": {"algorithm": "gauss-seidel", "input_order": 2},
}
TITLES = {
    "fmpy": "FMPy, SSP", "pathsim-cs": "PathSim, co-simulation",
    "pathsim-me": "PathSim, model exchange (RK4)", "cofmupy-jacobi": "CoFMuPy, Jacobi",
    "cofmupy-gauss-seidel": "CoFMuPy, Gauss-Seidel", "ecos": "Ecos", "libcosim": "libcosim", "omsimulator": "OMSimulator",
    "cosim-jacobi": "this project, Jacobi", "cosim-gauss-seidel": "this project, Gauss-Seidel",
    "cosim-strang": "this project, Strang",
    "cosim-gauss-seidel-order-2": "this project, Gauss-Seidel, inputs of order 2",
}  # fmt: skip
#: the step that the short table shows [s]
TABLE_STEP = 1e-3
#: Steps with which the others run for the referee [s]: chosen, so that each master has results that agree and results
#: that differ.
JUDGED_STEPS = (2e-3, 1e-3, 5e-4)
#: how many times as long a second run is, whose longer time tells what the steps take without the set-up
LONGER = 20
#: Seed of the hashes of texts in the programs of the others: chosen. CoFMuPy 1.0.0 steps the parts of a loop in the order
#: of a set of their names (`GraphEngine._get_order`), which without a seed is another one in each process.
HASH_SEED = "0"
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """One run: its error in ranges of the signals, the processor time of its steps [s], or why not."""

    system: str
    master: str
    step: float
    error: float = math.nan
    seconds: float = math.nan
    failure: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


class Client:
    """A program that runs a master of others, as long as the benchmark needs it."""

    def __init__(self, tool: str, environments: Path | None) -> None:
        if environments:
            python = [str(environments / REQUIREMENTS[tool][0].split("==")[0] / "bin" / "python")]
        else:
            packages = [x for name in REQUIREMENTS[tool] for x in ("--with", name)]
            uv = [sys.executable, "-m", "uv", "run", "-q", "--no-project", "--isolated"]
            python = [*uv, "--python", "3.11", *packages, "python"]
        self.program = subprocess.Popen(
            [*python, str(CLIENTS), tool], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, env={**os.environ, "PYTHONHASHSEED": HASH_SEED},
        )  # fmt: skip

    def ask(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a task; a failure where the program ended."""
        assert self.program.stdin and self.program.stdout
        try:
            print(json.dumps(task), file=self.program.stdin, flush=True)
        except BrokenPipeError:
            return {"failure": "the program ended"}
        for line in self.program.stdout:
            if line.startswith("ANSWER "):
                answer: dict[str, Any] = json.loads(line.removeprefix("ANSWER "))
                return answer
        return {"failure": "the program ended"}

    def close(self) -> None:
        """End the program."""
        assert self.program.stdin
        self.program.stdin.close()
        self.program.wait()


class OmSimulator:
    """The program OMSimulator, which takes the SSP of a system and writes a table."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program, self.folder = program.absolute(), folder
        done = subprocess.run(
            [self.program, "--version"], check=True, capture_output=True, text=True
        )
        self.version = done.stdout.strip().removeprefix("OMSimulator ")

    def ask(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a task, in which each row is there once, with what follows from an event at its time."""
        result = self.folder / "omsimulator.csv"
        result.unlink(missing_ok=True)
        began = time.process_time()
        subprocess.run(
            [self.program, f"--stepSize={task['step']}", f"--stopTime={task['step'] * task['steps']}",
             f"--resultFile={result}", Path(task["ssp"]).name],
            check=False, cwd=Path(task["ssp"]).parent, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        if not result.is_file():
            return {"failure": "no result"}
        table = pd.read_csv(result, skipinitialspace=True).drop_duplicates("time", keep="last")
        columns = [
            next(x for x in map(str, table) if x.endswith(f".{port}")) for port in task["record"]
        ]
        return {
            "rows": table[["time", *columns]].to_numpy().tolist(),
            "seconds": time.process_time() - began, "versions": {"omsimulator": self.version},
        }  # fmt: skip

    def close(self) -> None:
        """Nothing runs on."""


def distance(rows: Array, step: float, truth: Result, ports: list[str]) -> float:
    """The largest error of the rows in ranges of the signals, as labelled or one step later."""

    def largest_error(shift: int) -> float:
        at = np.rint(rows[:, 0] / step).astype(int) + shift
        inside = (at >= 0) & (at < len(truth.data))
        differences = [
            np.abs(rows[inside, 1 + k] - truth[port][at[inside]]).max() / np.ptp(truth[port])
            for k, port in enumerate(ports)
        ]
        return float(max(differences))

    return min(largest_error(0), largest_error(1)) if np.isfinite(rows).all() else math.inf


def ours(name: str, case: Case, step: float) -> tuple[Array, float]:
    """The rows of a run with this project's master, and the processor time of its steps, without the set-up."""
    ports = exchanged(case.system)

    def measured(stop: float) -> tuple[Result, float]:
        began = time.process_time()
        result = run(case.system, stop=stop, step=step, record=ports, **OURS[name])
        return result, time.process_time() - began

    result, once = measured(case.stop)
    try:
        _, longer = measured(LONGER * case.stop)
    except SimulationError:  # a coupling that grows lets an FMU refuse its step in the end
        longer = math.nan
    columns = [result[port] for port in ports]
    return np.column_stack([result["time"], *columns]), (longer - once) / (LONGER - 1)


def task_for(case: Case, step: float, truth: Result, ssp: Path) -> dict[str, Any]:
    """What a client is asked: a run of a system with this step [s]; `truth` has the start values of wired inputs."""
    wires = wire_ends(case.system)
    return {
        "inputs": {target: float(truth[source][0]) for source, target in wires},
        "parts": {part: str(fmu) for part, fmu in case.system.parts.items()},
        "wires": wires,
        "start": dict(case.system.start),
        "step": step, "steps": round(case.stop / step), "record": exchanged(case.system), "ssp": str(ssp),
    }  # fmt: skip


def written_ssp(key: str, case: Case, step: float, folder: Path) -> Path:
    """The SSP of a system with this step [s], which OMSimulator takes from there."""
    ssp = folder / f"{key.replace(' ', '_')}.ssp"
    write_ssp(case.system, ssp, stop=case.stop, step=step)
    return ssp


def points(
    key: str, case: Case, clients: Mapping[str, Client | OmSimulator], folder: Path
) -> Iterable[Point]:
    """All runs of a system."""
    ports = exchanged(case.system)
    for step in case.steps:
        ssp = written_ssp(key, case, step, folder)
        truth = oracle(case.system, stop=case.stop, output_step=step, record=ports)
        for name in OURS:
            try:
                rows, seconds = ours(name, case, step)
                yield Point(key, name, step, distance(rows, step, truth, ports), seconds)
            except SimulationError as failure:
                yield Point(key, name, step, failure=str(failure))
        task = task_for(case, step, truth, ssp)
        for name, client in clients.items():
            answer = client.ask(task)
            if "failure" in answer:
                yield Point(key, name, step, failure=answer["failure"])
                continue
            error = distance(np.array(answer["rows"]), step, truth, ports)
            yield Point(key, name, step, error, answer["seconds"], versions=answer["versions"])


def judgements(
    key: str, case: Case, clients: Mapping[str, Client | OmSimulator], folder: Path
) -> Iterable[Judgement]:
    """What the referee says of each run of the others."""
    for step in case.steps:
        ssp = written_ssp(key, case, step, folder)
        truth = oracle(case.system, stop=step, output_step=step)
        task = task_for(case, step, truth, ssp)
        for name, client in clients.items():
            answer = client.ask(task)
            if "failure" in answer:
                yield Judgement(key, name, step, failure=answer["failure"])
            else:
                yield judge(key, case, name, step, np.array(answer["rows"], float))


def certified(case: Case) -> dict[str, float]:
    """What `certify` states for the signal at the end with TABLE_STEP, and how far that is from the truth."""
    port = case.figure

    def last(result: Result) -> dict[str, float]:
        return {"last": float(result[port][-1])}

    estimate = certify(
        case.system, last, step=TABLE_STEP / 4, stop=case.stop, record=[port], algorithm="strang"
    ).figures["last"]
    truth = oracle(case.system, stop=case.stop, record=[port])
    return {
        "value": estimate.value, "stated": estimate.error, "true": float(truth[port][-1]),
        "range": float(np.ptp(truth[port])),
    }  # fmt: skip


def cell(point: Point) -> str:
    """The cell of a table."""
    if point.failure:
        return "refused" if point.master.startswith("cosim") else "fails"
    return f"{100 * point.error:.2g} %" if point.error < LARGEST_SHARE else "grows"


def table(measured: Sequence[Point], systems: Iterable[str]) -> str:
    """Masters by systems at the step TABLE_STEP."""
    names = list(systems)
    lines = [
        f"| master, step {1e3 * TABLE_STEP:g} ms | {' | '.join(names)} |",
        "|---" * (len(names) + 1) + "|",
    ]
    for master, title in TITLES.items():
        cells = {p.system: cell(p) for p in measured if p.master == master and p.step == TABLE_STEP}
        if cells:
            row = " | ".join(cells.get(name, "") for name in names)
            lines.append(f"| {title} | {row} |")
    return "\n".join(lines)


def draw(measured: Sequence[Point], systems: Mapping[str, Case], path: Path) -> None:
    """Error over step, a picture for each system."""
    figure = Figure(figsize=(15, 6), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for axis, (key, case) in zip(axes, systems.items()):
        for k, (master, title) in enumerate(TITLES.items()):
            plotted = [
                p for p in measured
                if (p.system, p.master) == (key, master) and p.error < LARGEST_SHARE
            ]  # fmt: skip
            style = "-o" if master in OURS else "--s"
            axis.loglog(
                [1e3 * p.step for p in plotted], [100 * p.error for p in plotted], style,
                color=f"C{k % 10}", markersize=3, label=title,
            )  # fmt: skip
        axis.set(title=case.title, xlabel="step (ms)", ylabel="largest error (% of range)")
        axis.grid(alpha=0.3)
    axes[-1].axis("off")
    axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center")
    figure.savefig(path, dpi=110)


def measure(
    systems: Mapping[str, Case],
    clients: Mapping[str, Client | OmSimulator],
    folder: Path,
    out: Path,
) -> None:
    """Run all masters on these systems, and write their errors and times."""
    measured: list[Point] = []
    stated = {}
    for key, case in systems.items():
        for point in points(key, case, clients, folder):
            measured.append(point)
            print(f"{key:12} {point.master:28} {1e3 * point.step:5g} ms {cell(point):>9} "
                  f"{1e3 * point.seconds:8.2f} ms {point.failure}", flush=True)  # fmt: skip
        stated[key] = certified(case)
        print(f"{key:12} certify, {case.figure}: {stated[key]}", flush=True)
    report = {"points": [asdict(point) for point in measured], "certified": stated}
    (out / "masters.json").write_text(json.dumps(report, indent=1), encoding="utf-8")
    draw(measured, systems, out / "masters.png")
    print(f"\n{table(measured, systems)}")


def judge_all(
    systems: Mapping[str, Case],
    clients: Mapping[str, Client | OmSimulator],
    folder: Path,
    out: Path,
) -> None:
    """Let the referee judge the results of the others, and an integration the judgements."""
    judged: list[Judgement] = []
    for key, case in systems.items():
        for j in judgements(key, case, clients, folder):
            judged.append(j)
            print(f"{key:12} {j.master:22} {1e3 * j.step:5g} ms {j.verdict:>8} {100 * j.deviation:9.3g} % "
                  f"{j.seconds:6.1f} s {'; '.join(j.wrong) or 'confirmed'} | {j.failure or j.cause}", flush=True)  # fmt: skip
    lines = [asdict(judgement) for judgement in judged]
    (out / "masters_referee.json").write_text(json.dumps(lines, indent=1), encoding="utf-8")
    print(f"\n{judgement_table(judged, TITLES)}\n\n{summary(judged)}")


def main() -> None:
    """Read the options, start the masters, and measure or judge."""
    parser = argparse.ArgumentParser(description="Compare co-simulation masters.")
    parser.add_argument("--environments", type=Path, help="folder of ready environments by package")
    parser.add_argument("--masters", default=",".join(REQUIREMENTS), help="which of the others")
    parser.add_argument(
        "--omsimulator",
        type=Path,
        help="the program OMSimulator, which is not on the package index",
    )
    parser.add_argument("--systems", default="", help="which systems (default: all)")
    parser.add_argument(
        "--steps", default="", help="steps in ms (default: 4,2,1,0.5,0.25; with --referee 2,1,0.5)"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "results")
    parser.add_argument(
        "--referee", action="store_true", help="let cosim referee judge the results of the others"
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    masters = [name for name in options.masters.split(",") if name]
    clients: dict[str, Client | OmSimulator] = {
        name: Client(name, options.environments) for name in masters
    }
    steps = tuple(1e-3 * float(x) for x in options.steps.split(",") if x)
    if options.referee:
        steps = steps or JUDGED_STEPS
    with TemporaryDirectory() as folder:
        if options.omsimulator:
            clients["omsimulator"] = OmSimulator(options.omsimulator, Path(folder))
        models = Path(__file__).with_name("models")
        make_all([models / "wheel.py", models / "chassis.py"], "native", Path(folder))
        wanted = [name for name in options.systems.split(",") if name]
        systems = {
            key: replace(case, steps=steps or case.steps)
            for key, case in cases(Path(folder)).items() if not wanted or key in wanted
        }  # fmt: skip
        (judge_all if options.referee else measure)(systems, clients, Path(folder), options.out)
    for client in clients.values():
        client.close()


if __name__ == "__main__":
    main()
