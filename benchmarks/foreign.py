"""Anybody's FMUs in the master and in FMPy.

Every FMI 2.0 co-simulation FMU below the folder is run alone over its default experiment, at most 1000
steps, by the master and by FMPy's class of FMUs, each in a process of its own. The table tells the largest deviation of an
output at a communication point, of the largest value of that output. Both hand over the tolerance that
an FMU states, set inputs to their declared start, and tell it no stop time.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import fmpy
import numpy as np
import pandas as pd
from fmpy.fmi2 import FMU2Slave

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import System, run
from cosim.calls import OK, Caller, Outcome

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


class Task(NamedTuple):
    """An FMU, its step and stop [s], and outputs."""

    path: Path
    step: float
    stop: float
    outputs: list[str]


def experiment(path: Path) -> tuple[str, Task]:
    """The tool of an FMU, and what is run of it."""
    description = fmpy.read_model_description(path, validate=False)
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        raise ValueError(f"FMI {description.fmiVersion}, or no co-simulation")
    stated = description.defaultExperiment
    stop = float(stated.stopTime) if stated and stated.stopTime else 1.0
    step = float(stated.stepSize) if stated and stated.stepSize else stop / 100
    outputs = [
        v.name for v in description.modelVariables if v.causality == "output" and v.type == "Real"
    ]
    task = Task(path, step, min(1.0 if stop <= 0.0 else stop, MOST * step), outputs)
    return description.generationTool or "", task


def by_master(task: Task) -> pd.DataFrame:
    """The outputs at each communication point."""
    logging.getLogger("cosim").setLevel(logging.ERROR)
    names = [f"fmu.{name}" for name in task.outputs]
    result = run(System({"fmu": task.path}), stop=task.stop, step=task.step, record=names)
    return pd.DataFrame({name: result[f"fmu.{name}"] for name in task.outputs})


def by_fmpy(task: Task) -> pd.DataFrame:
    """The same by FMPy."""
    description = fmpy.read_model_description(task.path, validate=False)
    refs = {v.name: v.valueReference for v in description.modelVariables}
    with TemporaryDirectory() as folder:
        fmpy.extract(task.path, folder)
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
        rows, time = [unit.getReal([refs[name] for name in task.outputs])], 0.0
        while time < task.stop - LEFT_OVER * task.step:
            unit.doStep(time, min(task.step, task.stop - time))
            time = min(len(rows) * task.step, task.stop)
            rows.append(unit.getReal([refs[name] for name in task.outputs]))
        unit.terminate()
        unit.freeInstance()
    return pd.DataFrame(rows, columns=task.outputs)


def largest_relative_difference(ours: pd.DataFrame, theirs: pd.DataFrame) -> float:
    """The largest difference at the points that both have, over the largest value of its output."""
    points = min(len(ours), len(theirs))
    a, b = ours[:points].to_numpy(float), theirs[:points].to_numpy(float)
    scale = np.maximum(np.maximum(np.abs(a).max(0), np.abs(b).max(0)), LEAST_SCALE)
    return float(np.nanmax(np.abs(a - b) / scale, initial=0.0))


def row(caller: Caller, path: Path, folder: Path) -> list[str]:
    """What stands of an FMU in the table."""
    label = f"{path.relative_to(folder).parts[0]}: {path.name}"
    try:
        tool, task = experiment(path)
    except Exception as error:  # noqa: BLE001
        return [label, "", f"not tried: {str(error).splitlines()[0][:120]}"]
    ours, theirs = (caller.do(method, task, PATIENCE) for method in (by_master, by_fmpy))
    if ours.status != OK:
        peer = "runs" if theirs.status == OK else "refused too"
        return [label, tool, f"refused: {reason(ours)}; FMPy {peer}"]
    if theirs.status != OK:
        return [label, tool, f"runs; FMPy: {reason(theirs)}"]
    worst = largest_relative_difference(ours.answer, theirs.answer)
    return [label, tool, f"{worst:.1e}" if task.outputs else "no output to compare"]


def reason(outcome: Outcome) -> str:
    """Why there are no rows, in a line."""
    return outcome.message.splitlines()[0][:160]


def main() -> None:
    """Compare all FMUs of a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of FMUs")
    parser.add_argument("--out", type=Path, help="write the table there")
    options = parser.parse_args()
    table, caller = [], Caller()
    for path in sorted(options.folder.rglob("*.fmu")):
        table.append(row(caller, path, options.folder))
        print(" | ".join(table[-1]), flush=True)
    caller.close()
    if options.out is not None:
        head = ["| FMU | Tool | Deviation from FMPy |", "|---|---|---|"]
        lines = [f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |" for cells in table]
        options.out.write_text("\n".join([*head, *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    from benchmarks.foreign import main  # under a name that child processes find

    main()
