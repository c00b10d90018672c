"""Time per communication step of motor and conveyor: python benchmarks/coupling.py [--steps N].

All ways of running the same FMUs with Jacobi and 1 ms steps, side by side: every way in a process
of its own, round after round, free and pinned to one core. Shown are medians of the wall time per
step, start-up taken off, the ratio to a loop over fmpy's methods, and what remains above the bare
slaves over what remains of that loop.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

H = 1e-3
PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
WIRES = (("motor", "tau", "conveyor", "tau"), ("conveyor", "w", "motor", "w"))


def fmpy_methods(steps: int, fmus: Path) -> Callable[[], object]:
    """Jacobi as fmpy's examples do it."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    slaves = {}
    references = {}
    for part, name in PARTS.items():
        path = str(fmus / f"{name}.fmu")
        description = read_model_description(path)
        slaves[part] = slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=extract(path, tempfile.mkdtemp()),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=part,
        )
        references |= {(part, v.name): v.valueReference for v in description.modelVariables}
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
    motor, conveyor = slaves.values()

    def loop() -> None:
        for n in range(steps):
            tau = motor.getReal([references["motor", "tau"]])
            w = conveyor.getReal([references["conveyor", "w"]])
            motor.setReal([references["motor", "w"]], w)
            conveyor.setReal([references["conveyor", "tau"]], tau)
            motor.doStep(n * H, H)
            conveyor.doStep(n * H, H)

    return loop


def master(steps: int, fmus: Path) -> Callable[[], object]:
    """Our master, hardly recording."""
    import cosim

    wires = [f"{a}.{x} -> {b}.{y}" for a, x, b, y in WIRES]
    system = cosim.System({part: fmus / f"{name}.fmu" for part, name in PARTS.items()}, wires)
    settings = {"step": H, "algorithm": "jacobi", "record": ["motor.tau"], "output_step": H * 1000}
    return lambda: cosim.run(system, stop=steps * H, **settings)


def master_in_python(steps: int, fmus: Path) -> Callable[[], object]:
    """Our master without its compiled loop."""
    from cosim import stepping

    def missing(*_: object) -> None:
        raise OSError("not wanted")

    stepping.Loop = missing
    return master(steps, fmus)


def libcosim(steps: int, fmus: Path) -> Callable[[], object]:
    """libcosim's fixed-step algorithm."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_step_size(round(H * 1e9))
    slaves, references = {}, {}
    for part, name in PARTS.items():
        slaves[part] = execution.add_local_slave(CosimLocalSlave(str(fmus / f"{name}.fmu"), part))
        for variable in execution.slave_variables(slaves[part]):
            references[part, variable.name.decode()] = variable.reference
    for a, x, b, y in WIRES:
        execution.connect_real_variables(slaves[a], references[a, x], slaves[b], references[b, y])
    execution.step()
    return lambda: execution.simulate_until(round((steps + 1) * H * 1e9))


def ecos(steps: int, fmus: Path) -> Callable[[], object]:
    """Ecos' fixed-step algorithm."""
    ctypes.CDLL(sys.prefix + "/lib/libtbb.so.12", ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    for part, name in PARTS.items():
        structure.add_model(part, str(fmus / f"{name}.fmu"))
    for a, x, b, y in WIRES:
        structure.make_real_connection(f"{a}::{x}", f"{b}::{y}")
    simulation = EcosSimulation(H, structure=structure)
    simulation.init()
    simulation.step()
    return lambda: simulation.step(steps)


def bare_slaves(steps: int, _: Path) -> Callable[[], object]:
    """The Python slaves' steps without any FMI."""
    from components import crank_conveyor, drive_motor
    from components.kit.slave import slave_class

    slaves = []
    for model in (drive_motor, crank_conveyor):
        slave = slave_class(model, "benchmark")(instance_name=model.__name__)
        slave.setup_experiment(0.0, None, None)
        slave.enter_initialization_mode()
        slave.exit_initialization_mode()
        slaves.append(slave)

    def loop() -> None:
        for n in range(steps):
            for slave in slaves:
                slave.do_step(n * H, H)

    return loop


WAYS = {
    "fmpy methods": fmpy_methods,
    "our master": master,
    "our master, Python loop": master_in_python,
    "libcosim": libcosim,
    "Ecos": ecos,
    "bare slaves": bare_slaves,
}


def seconds(way: str, steps: int) -> float:
    """Wall time of so many steps."""
    task = WAYS[way](steps, ROOT / "fmus")
    began = time.perf_counter()
    task()
    return time.perf_counter() - began


def measure(way: str, steps: int, pinned: bool) -> float:
    """Seconds per step of one way, in a process of its own."""
    command = [sys.executable, __file__, "--way", way, "--steps", str(steps)]
    done = subprocess.run(
        command + ["--pinned"] * pinned, capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    parser.add_argument("--pinned", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        if options.pinned:
            os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        start_up, whole = (seconds(options.way, steps) for steps in (1, options.steps))
        print((whole - start_up) / (options.steps - 1), flush=True)
        os._exit(0)
    subprocess.run([sys.executable, ROOT / "build_fmus.py"], check=True, capture_output=True)
    for pinned in (False, True):
        rounds = [
            {way: measure(way, options.steps, pinned) for way in WAYS}
            for _ in range(options.rounds)
        ]
        median = {way: statistics.median(times[way] for times in rounds) for way in WAYS}
        base, slaves = median["fmpy methods"], median["bare slaves"]
        print(
            f"{'pinned to one core' if pinned else 'free':<26}{'us/step':>9}{'ratio':>8}{'overhead':>10}"
        )
        for way, value in median.items():
            share = (value - slaves) / (base - slaves)
            print(f"{way:<26}{value * 1e6:>9.2f}{value / base:>8.3f}{share:>10.3f}")


if __name__ == "__main__":
    main()
