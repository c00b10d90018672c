"""Time per communication step of motor and conveyor.

All ways of running the same drive with Jacobi and 1 ms steps, side by side: every way in a process
of its own, round after round, free and pinned to one core. Shown are medians of the wall time per
step, start-up taken off, the ratio to a loop over fmpy's methods on Python FMUs, and what remains
above the bare Python slaves over what remains of that loop. Then the resonance sweep of 31 speeds
at 256 steps per revolution, start-up included, on one core.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import importlib
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

#: The page that this backs, and its heading.
CLAIM = ("docs/speed.md", "What a communication step costs")

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

#: Communication step [s]. Chosen: that of the FMUs' default experiment.
H = 1e-3
#: Relative and absolute tolerance of the drive as one differential equation: a convention, which limits its speed.
EXACT_TOLERANCE = 1e-10
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
    from cosim.engine import driver

    def missing(*_: object) -> None:
        raise OSError("not wanted")

    vars(driver)["Loop"] = missing
    return master(steps, fmus)


def libcosim(steps: int, fmus: Path) -> Callable[[], object]:
    """The fixed-step algorithm of libcosim."""
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


def dop853(steps: int, _: Path) -> Callable[[], object]:
    """The drive as one system in scipy, as precise as the FMUs; no communication at all."""
    from scipy.integrate import solve_ivp

    from components.crank_conveyor import model as conveyor
    from components.drive_motor import model as motor
    from fmukit.declare.record import start

    p, q = start(motor.Parameters), start(conveyor.Parameters)

    def rates(t: float, y: Sequence[float]) -> list[float]:
        phi, w, tau = y
        x, u = conveyor.State(phi, w), conveyor.Inputs(tau)
        lag = motor.derivatives(p, t, motor.State(tau), motor.Inputs(w))
        return [*conveyor.derivatives(q, t, x, u), *lag]

    start_values = [0.0, 40.0, 8.0]
    settings = {
        "method": "DOP853",
        "rtol": EXACT_TOLERANCE,
        "atol": EXACT_TOLERANCE,
        "max_step": 1.0,
    }
    return lambda: solve_ivp(rates, (0.0, steps * H), start_values, **settings)


def resonance_sweep(_: int, fmus: Path) -> Callable[[], object]:
    """The 31 speeds of set A by our master, Strang with 256 steps per revolution."""
    import numpy as np

    from scenarios.conveyor.drive_orbits import Drive
    from scenarios.conveyor.first_order import SETS
    from scenarios.conveyor.speed_sweep import SPEEDS
    from workbench import Context

    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    drive = Drive(Context(parts), "strang", 256)
    speeds = np.array([[float(nu) for nu in SPEEDS["A"].split(",")]])
    return lambda: drive.orbits(SETS["A"], speeds, "sweep")


def bare_slaves(steps: int, _: Path) -> Callable[[], object]:
    """The steps of the slaves in the Python FMUs without any FMI."""
    from fmukit.fmu.load import load
    from fmukit.fmu.python.package import hashed_build

    slaves = []
    for name in ("drive_motor", "crank_conveyor"):
        build = hashed_build(load(ROOT / "components" / name / "model.py"))
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / f"{build.module}.py"
            source.write_bytes(build.resources[source.name])
            sys.path.insert(0, folder)
            slave = importlib.import_module(build.module).slave_class(instance_name=name)
            sys.path.remove(folder)
        slave.setup_experiment(0.0, None, None)
        slave.enter_initialization_mode()
        slave.exit_initialization_mode()
        slaves.append(slave)

    gc.collect()
    gc.freeze()
    motor, conveyor = slaves
    references = [
        (b, [v.name for v in b.variables].index(y), a, [v.name for v in a.variables].index(x))
        for b, y, a, x in ((conveyor, "tau", motor, "tau"), (motor, "w", conveyor, "w"))
    ]
    (b, j, a, i), (d, m, c, k) = references

    def loop() -> None:
        for n in range(steps):
            b.values[j], d.values[m] = a.values[i], c.values[k]
            motor.do_step(n * H, H)
            conveyor.do_step(n * H, H)

    return loop


PYTHON, NATIVE = ROOT / "fmus", ROOT / "fmus" / "native"
METHODS: dict[str, tuple[Callable[[int, Path], Callable[[], object]], Path]] = {
    "fmpy methods, Python FMUs": (fmpy_methods, PYTHON),
    "our master, Python FMUs": (master, PYTHON),
    "  its loop in Python": (master_in_python, PYTHON),
    "libcosim, Python FMUs": (libcosim, PYTHON),
    "Ecos, Python FMUs": (ecos, PYTHON),
    "bare Python slaves": (bare_slaves, PYTHON),
    "fmpy methods, native FMUs": (fmpy_methods, NATIVE),
    "our master, native FMUs": (master, NATIVE),
    "  its loop in Python, native": (master_in_python, NATIVE),
    "libcosim, native FMUs": (libcosim, NATIVE),
    "Ecos, native FMUs": (ecos, NATIVE),
    "DOP853, one system": (dop853, PYTHON),
}
SWEEPS = {
    "sweep, Python FMUs": (resonance_sweep, PYTHON),
    "sweep, native FMUs": (resonance_sweep, NATIVE),
}
NAIVE, BARE = "fmpy methods, Python FMUs", "bare Python slaves"
#: How many times more steps the fast programs take. Chosen: their runs then take a second too.
MANY = 10


def seconds(method: str, steps: int) -> float:
    """Wall time of so many steps."""
    make, fmus = (METHODS | SWEEPS)[method]
    task = make(steps, fmus)
    began = time.perf_counter()
    task()
    return time.perf_counter() - began


def measure(method: str, steps: int, *, pinned: bool) -> float:
    """What a way prints in a process of its own: seconds per step, or of a sweep."""
    command = [sys.executable, __file__, "--way", method, "--steps", str(steps)]
    done = subprocess.run(
        command + ["--pinned"] * pinned, capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


def compiled(folder: Path) -> dict[str, Path]:
    """The program in limit.c, compiled for this processor and as portable as the FMUs are: there every
    operation is rounded, so that flavours and processors agree to the last bit.
    """
    from fmukit.fmu.native.package import OPTIONS

    portable = ["-target", f"{platform.machine()}-linux-gnu.2.17", *OPTIONS]
    variants = {"one program in C, by hand": ["-O2"], "  compiled as the FMUs are": portable}
    programs = {method: folder / f"limit_{k}" for k, method in enumerate(variants)}
    for method, options in variants.items():
        command = [sys.executable, "-m", "ziglang", "cc", *options, "-o", programs[method]]
        subprocess.run([*command, ROOT / "benchmarks" / "limit.c", "-lm"], check=True)
    return programs


def by_hand(program: Path, steps: int, *, pinned: bool) -> float:
    """Seconds per step of the program in limit.c, with as many evaluations as the FMUs need."""
    command = [str(program), str(steps * MANY), "1"]
    if pinned:
        core = min(os.sched_getaffinity(0))
        command = ["taskset", "-c", str(core), *command]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def child(method: str, steps: int) -> None:
    """Print the figure of one way and leave without tidying up."""
    if method in SWEEPS:
        print(seconds(method, 1), flush=True)
    else:
        many = steps * MANY if "our master, native" in method else steps
        _, start_up, total = (seconds(method, count) for count in (1, 1, many))
        print((total - start_up) / (many - 1), flush=True)
    os._exit(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--way", dest="method", help=argparse.SUPPRESS)
    parser.add_argument("--pinned", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.pinned:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    if options.method:
        child(options.method, options.steps)
    build = [sys.executable, ROOT / "build_fmus.py", "--flavour", "both"]
    subprocess.run([*build, "drive_motor", "crank_conveyor"], check=True, capture_output=True)
    with tempfile.TemporaryDirectory() as folder:
        programs = compiled(Path(folder))
        for pinned in (False, True):
            rounds = [
                {method: measure(method, options.steps, pinned=pinned) for method in METHODS}
                | {
                    method: by_hand(x, options.steps, pinned=pinned)
                    for method, x in programs.items()
                }
                for _ in range(options.rounds)
            ]
            show("pinned to one core" if pinned else "free", rounds)
    for method in SWEEPS:
        times = [measure(method, 1, pinned=True) for _ in range(options.rounds)]
        print(f"{method:<30}{statistics.median(times):>9.2f} s")


def show(title: str, rounds: list[dict[str, float]]) -> None:
    """The table of medians."""
    median = {method: statistics.median(times[method] for times in rounds) for method in rounds[0]}
    base, slaves = median[NAIVE], median[BARE]
    print(f"{title:<30}{'us/step':>9}{'faster':>9}{'overhead':>10}")
    for method, value in median.items():
        share = (value - slaves) / (base - slaves)
        print(f"{method:<30}{value * 1e6:>9.3f}{base / value:>9.2f}{share:>10.3f}")


if __name__ == "__main__":
    main()
