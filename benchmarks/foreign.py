"""Anybody's FMUs in the master and in FMPy.

Every FMI 2.0 co-simulation FMU below the folder is run alone over its default experiment, at most 1000
steps, by the master and by FMPy's class of FMUs, each in a process of its own. The table tells the largest deviation of an
output at a communication point, of the largest value of that output. Both hand over the tolerance that
an FMU states, set inputs to their declared start, and tell it no stop time.
"""

from __future__ import annotations

import argparse
import json
import logging
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import System, run

#: The page that this backs, and its heading.
CLAIM = ("docs/foreign.md", "Third-party FMUs")

#: Longest time of an FMU in one of both [s]. Chosen: far above what a run takes.
PATIENCE = 60.0
#: Most steps of a run. Chosen: a table of hundreds of FMUs is made in minutes.
MOST = 1000
#: Share of a step that may be left at the stop without a step of its own. Derived: the product of a number of steps up
#: to MOST and the step is rounded by 2^-53 of it, 1e-13 of a step.
LEFT_OVER = 1e-9
#: Least size that a difference is compared with. Chosen: near the smallest double, so that outputs of zero are compared.
LEAST_SCALE = 1e-300
Columns = dict[str, list[float]]
Task = tuple[str, float, float, list[str]]


def experiment(path: Path) -> tuple[str, Task]:
    """The tool of an FMU, and what is run of it: step, stop and outputs."""
    description = fmpy.read_model_description(path, validate=False)
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        raise ValueError(f"FMI {description.fmiVersion}, or no co-simulation")
    stated = description.defaultExperiment
    stop = float(stated.stopTime) if stated and stated.stopTime else 1.0
    step = float(stated.stepSize) if stated and stated.stepSize else stop / 100
    outputs = [
        v.name for v in description.modelVariables if v.causality == "output" and v.type == "Real"
    ]
    task = (str(path), step, min(1.0 if stop <= 0.0 else stop, MOST * step), outputs)
    return description.generationTool or "", task


def by_master(task: Task) -> Columns:
    path, step, stop, outputs = task
    names = [f"fmu.{name}" for name in outputs]
    result = run(System({"fmu": Path(path)}), stop=stop, step=step, record=names)
    return {name.removeprefix("fmu."): result[name].tolist() for name in ("time", *names)}


def by_fmpy(task: Task) -> Columns:
    path, step, stop, outputs = task
    description = fmpy.read_model_description(path, validate=False)
    refs = {v.name: v.valueReference for v in description.modelVariables}
    with TemporaryDirectory() as folder:
        fmpy.extract(path, folder)
        unit = FMU2Slave(
            guid=description.guid, unzipDirectory=folder, instanceName="fmu",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        unit.instantiate()
        stated = description.defaultExperiment
        tolerance = float(stated.tolerance) if stated and stated.tolerance else None
        unit.setupExperiment(tolerance=tolerance, startTime=0.0)
        unit.enterInitializationMode()
        for v in description.modelVariables:
            if v.causality == "input" and v.type == "Real" and v.start is not None:
                unit.setReal([v.valueReference], [float(v.start)])
        unit.exitInitializationMode()
        samples = [unit.getReal([refs[name] for name in outputs])]
        times = [0.0]
        while times[-1] < stop - LEFT_OVER * step:
            unit.doStep(times[-1], min(step, stop - times[-1]))
            times.append(min(len(times) * step, stop))
            samples.append(unit.getReal([refs[name] for name in outputs]))
        unit.terminate()
        unit.freeInstance()
    return {"time": times, **{n: list(x) for n, x in zip(outputs, zip(*samples))}}


def isolated(method: str, task: Task) -> Columns | str:
    """The columns that a method of METHODS computes in a separate process, or why it computes none."""
    with TemporaryDirectory() as folder:
        result_path = Path(folder) / "found.json"
        command = [
            sys.executable,
            __file__,
            str(result_path),
            "--way",
            method,
            "--task",
            json.dumps(task),
        ]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, errors="replace",
                timeout=PATIENCE, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"no answer after {PATIENCE:g} s"
        if result_path.is_file():
            columns: Columns = json.loads(result_path.read_text())
            return columns
        last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        return last[0].replace(f"{folder}/", "")[:160]


def largest_relative_difference(ours: Columns, theirs: Columns) -> float:
    """The largest difference at the points that both have, over the largest value of its output."""
    points = min(len(ours["time"]), len(theirs["time"]))
    worst = 0.0
    for name in set(ours) - {"time"}:
        a, b = np.array(ours[name][:points]), np.array(theirs[name][:points])
        scale = max(float(np.abs(a).max()), float(np.abs(b).max()), LEAST_SCALE)
        worst = max(worst, float(np.nanmax(np.abs(a - b), initial=0.0)) / scale)
    return worst


METHODS = {"master": by_master, "FMPy": by_fmpy}


def row(path: Path, folder: Path) -> list[str]:
    """What stands of an FMU in the table."""
    label = f"{path.relative_to(folder).parts[0]}: {path.name}"
    try:
        tool, task = experiment(path)
    except Exception as error:  # noqa: BLE001
        return [label, "", f"not tried: {str(error).splitlines()[0][:120]}"]
    ours, theirs = isolated("master", task), isolated("FMPy", task)
    if isinstance(ours, str):
        peer = "refused too" if isinstance(theirs, str) else "runs"
        return [label, tool, f"refused: {ours}; FMPy {peer}"]
    if isinstance(theirs, str):
        return [label, tool, f"runs; FMPy: {theirs}"]
    worst = largest_relative_difference(ours, theirs)
    return [label, tool, f"{worst:.1e}" if task[3] else "no output to compare"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of FMUs")
    parser.add_argument("--out", type=Path, help="write the table there")
    parser.add_argument("--way", dest="method", choices=METHODS, help=argparse.SUPPRESS)
    parser.add_argument("--task", type=json.loads, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.method:
        options.folder.write_text(json.dumps(METHODS[options.method](options.task)))
        return
    logging.getLogger("cosim").setLevel(logging.ERROR)
    table = []
    for path in sorted(options.folder.rglob("*.fmu")):
        table.append(row(path, options.folder))
        print(" | ".join(table[-1]), flush=True)
    if options.out is not None:
        head = ["| FMU | Tool | Deviation from FMPy |", "|---|---|---|"]
        lines = [f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |" for cells in table]
        options.out.write_text("\n".join([*head, *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
