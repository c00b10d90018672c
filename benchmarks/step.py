"""Time per communication step of the motor-conveyor pair: python benchmarks/step.py [steps].

Side by side in one run, medians of five: a loop over fmpy's methods, our master, and the two
slaves called in Python without any FMI.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from components import crank_conveyor, drive_motor
from components.kit.slave import slave_class
from cosim import run
from scenarios import fmus

H = 1e-3


def naive(steps: int, folder: str) -> None:
    """Jacobi with fmpy's own methods, as its examples do it."""
    slaves = []
    for name in ("DriveMotor", "CrankConveyor"):
        path = str(ROOT / "fmus" / f"{name}.fmu")
        description = read_model_description(path)
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=extract(path, f"{folder}/{name}"),
            modelIdentifier=name,
            instanceName=name,
        )
        slave.vr = {v.name: v.valueReference for v in description.modelVariables}
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slaves.append(slave)
    motor, conveyor = slaves
    for n in range(steps):
        tau = motor.getReal([motor.vr["tau"]])
        w = conveyor.getReal([conveyor.vr["w"]])
        motor.setReal([motor.vr["w"]], w)
        conveyor.setReal([conveyor.vr["tau"]], tau)
        motor.doStep(n * H, H)
        conveyor.doStep(n * H, H)
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()


def master(steps: int, _: str) -> None:
    """Our master, Jacobi, hardly recording."""
    system = fmus.conveyor_drive({})
    run(
        system,
        stop=steps * H,
        step=H,
        algorithm="jacobi",
        record=["motor.tau"],
        output_step=1000 * H,
    )


def direct(steps: int, _: str) -> None:
    """The slaves' do_step alone."""
    slaves = []
    for model in (drive_motor, crank_conveyor):
        slave = slave_class(model, "benchmark")(instance_name=model.__name__)
        slave.setup_experiment(0.0, None, None)
        slave.enter_initialization_mode()
        slave.exit_initialization_mode()
        slaves.append(slave)
    for n in range(steps):
        for slave in slaves:
            slave.do_step(n * H, H)


def seconds(task: Callable[[int, str], None], steps: int) -> float:
    """Wall time of one run with its start-up taken off."""
    times = []
    for count in (steps, 1):
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            task(count, folder)
            times.append(time.perf_counter() - began)
    return times[0] - times[1]


def main() -> None:
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    fmus.build(*fmus.DRIVE.values())
    tasks = {"fmpy methods": naive, "our master": master, "slaves without FMI": direct}
    rounds = [{name: seconds(task, steps) for name, task in tasks.items()} for _ in range(5)]
    median = {name: statistics.median(times[name] for times in rounds) for name in tasks}
    print(f"{'':<20}{'us per step':>12}{'ratio':>8}{'overhead':>10}")
    base = median["slaves without FMI"]
    for name, value in median.items():
        overhead = (value - base) / (median["fmpy methods"] - base)
        print(
            f"{name:<20}{value / steps * 1e6:>12.1f}{value / median['fmpy methods']:>8.2f}"
            f"{overhead:>10.2f}"
        )


if __name__ == "__main__":
    main()
