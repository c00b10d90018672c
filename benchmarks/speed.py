"""What steps, runs, answers and studies cost: here, in another checkout, by other masters and by hand.

A line of the table is a piece of work in a process of its own: the median of its processor time, child processes
included, after a first time, for one of what it makes many of, and the most memory of the process. `--against` names
a folder with a checkout, its own environment and built FMUs, where the same work is done for the ratio. Other masters
take what `pip install libcosimpy ecospy tbb` installs. Lines of two threads and of two
programs have the wall time, which needs two idle cores.
"""

from __future__ import annotations

import argparse
import importlib
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import count, islice
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import masters_clients
from fmukit.fmu.native.package import OPTIONS

#: The page that this backs, and its heading.
CLAIM = ("docs/speed.md", "What a communication step costs")

#: Step of the pair of motor and conveyor [s]. Chosen: that of the FMUs' default experiment.
H = 1e-3
#: Step of the runs of an ensemble [s]. Chosen: the resonance's angle step at 512 steps per turn.
FINE = 3e-4
#: Steps of a run, and members of an ensemble. Chosen: what members share is a thousandth of each.
STEPS = MEMBERS = 1000
#: Steps of a long run by Python FMUs, and by native ones: chosen, about a second.
LONG, LONGER = 20_000, 1_000_000
#: Relative and absolute tolerance of the drive as one differential equation: a convention, which limits its speed.
EXACT_TOLERANCE = 1e-10
PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
WIRES = (("motor", "tau", "conveyor", "tau"), ("conveyor", "w", "motor", "w"))
COLUMNS = ["motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod"]
STUDY = """
scenario = "resonance"
[fixed]
speeds = "30:52:7"
steps_per_rev = 512
[grid]
"motor.T" = { from = 0.055, to = 0.07, number = 4 }
"""
Work = Callable[[], object]


def seconds() -> float:
    """Processor time of this process and of its children that ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(x.ru_utime + x.ru_stime for x in used)


class Line(NamedTuple):
    """What a line says, what makes its work in a checkout, how many of what it says the work holds, arguments, and the time."""

    words: str
    make: Callable[..., Work]
    count: int = 1
    arguments: tuple[Any, ...] = ()
    clock: Callable[[], float] = seconds


def pairs(fmus: Path, number: int = 1) -> Any:
    """So many motors and conveyors, wired two by two."""
    from cosim import System

    marks = [""] if number == 1 else [str(k) for k in range(number)]
    parts = {f"{part}{k}": fmus / f"{name}.fmu" for k in marks for part, name in PARTS.items()}
    return System(parts, [f"{a}{k}.{x} -> {b}{k}.{y}" for k in marks for a, x, b, y in WIRES])


def wired(root: Path, flavour: str) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """The parts and the wires of one pair, as other masters take them."""
    parts = {part: str(root / "fmus" / flavour / f"{name}.fmu") for part, name in PARTS.items()}
    return parts, [(f"{a}.{x}", f"{b}.{y}") for a, x, b, y in WIRES]


def steps_of_the_master(root: Path, flavour: str, steps: int, number: int = 1) -> Work:
    """Jacobi with hardly a row."""
    from cosim import run

    system = pairs(root / "fmus" / flavour, number)
    settings: dict[str, Any] = {"step": H, "algorithm": "jacobi", "output_step": H * STEPS}
    first = [f"{x}.tau" for x in system.parts][:1]
    return lambda: run(system, stop=steps * H, record=first, **settings)


def fmpy_methods(root: Path, flavour: str, steps: int) -> Work:
    """Jacobi as FMPy's examples do it."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    slaves, references = {}, {}
    for part, name in PARTS.items():
        path = str(root / "fmus" / flavour / f"{name}.fmu")
        description = read_model_description(path)
        slaves[part] = slave = FMU2Slave(
            guid=description.guid, unzipDirectory=extract(path, tempfile.mkdtemp()),
            modelIdentifier=description.coSimulation.modelIdentifier, instanceName=part,
        )  # fmt: skip
        references |= {(part, v.name): v.valueReference for v in description.modelVariables}
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()

    numbers = count()

    def loop() -> None:
        for n in islice(numbers, steps):
            values = [slaves[a].getReal([references[a, x]]) for a, x, *_ in WIRES]
            for value, (*_, b, y) in zip(values, WIRES):
                slaves[b].setReal([references[b, y]], value)
            for slave in slaves.values():
                slave.doStep(n * H, H)

    return loop


def libcosim(root: Path, flavour: str, steps: int) -> Work:
    """The fixed-step algorithm of libcosim."""
    execution, _ = masters_clients.libcosim_execution(*wired(root, flavour), H)
    done = iter(range(steps, 10**12, steps))
    return lambda: execution.simulate_until(round(next(done) * H * 1e9))


def ecos(root: Path, flavour: str, steps: int) -> Work:
    """Ecos' fixed-step algorithm."""
    simulation = masters_clients.ecos_simulation(*wired(root, flavour), H, {})
    simulation.init()
    return lambda: simulation.step(steps)


def dop853(_: Path) -> Work:
    """The drive as one system in SciPy, as precise as the FMUs; no communication at all."""
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

    accuracy = {"rtol": EXACT_TOLERANCE, "atol": EXACT_TOLERANCE, "max_step": 1.0}
    return lambda: solve_ivp(rates, (0.0, LONG * H), [0.0, 40.0, 8.0], "DOP853", **accuracy)


def bare_slaves(root: Path) -> Work:
    """The steps of the slaves in the Python FMUs without any FMI."""
    from fmukit.fmu.load import load
    from fmukit.fmu.python.package import hashed_build

    slaves = []
    for name in ("drive_motor", "crank_conveyor"):
        build = hashed_build(load(root / "components" / name / "model.py"))
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
    motor, conveyor = slaves
    (tau, w), (w_in, tau_in) = (
        [[v.name for v in x.variables].index(name) for name in names]
        for x, names in ((motor, ("tau", "w")), (conveyor, ("w", "tau")))
    )

    numbers = count()

    def loop() -> None:
        for n in islice(numbers, LONG):
            heard = motor.values[tau]
            motor.values[w], conveyor.values[tau_in] = conveyor.values[w_in], heard
            motor.do_step(n * H, H)
            conveyor.do_step(n * H, H)

    return loop


def by_hand(_: Path, options: Sequence[str]) -> Work:
    """The drive as one program in C, with as many evaluations as the FMUs need."""
    command = [str(compiled(options)), str(10 * LONGER), "1"]
    return lambda: subprocess.run(command, check=True, capture_output=True)


def compiled(options: Sequence[str] = ()) -> Path:
    """The program of limit.c; for this processor where no options say more."""
    program = Path(tempfile.mkdtemp()) / "limit"
    words = [*(options or ["-O2"]), "-o", str(program), str(ROOT / "benchmarks" / "limit.c"), "-lm"]
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *words], check=True)
    return program


def members(root: Path, steps: int, every: int, number: int) -> Work:
    """Members of an ensemble of runs, with a row at every so many steps."""
    from cosim import Prepared, RunSettings

    system = pairs(root / "fmus" / "native")
    settings = RunSettings(steps * FINE, FINE, output_step=every * FINE, record=COLUMNS)
    cases = {"motor.A": [7000.0 + k / number for k in range(number)]}

    def work() -> None:
        with Prepared.open(system, settings) as prepared:
            for block in prepared.blocks(cases):
                assert not len(block.failed)

    return work


def threads(root: Path, jobs: int) -> Work:
    """Members of many steps and two rows, in so many threads."""
    from cosim import Prepared, RunSettings

    stop = 10 * STEPS * FINE
    settings = RunSettings(stop, FINE, output_step=stop, record=COLUMNS)
    cases = {"motor.A": [7000.0 + k / MEMBERS for k in range(MEMBERS)]}

    def work() -> None:
        with Prepared.open(pairs(root / "fmus" / "native"), settings) as prepared:
            prepared.map(cases, jobs=jobs)

    return work


def programs(_: Path, number: int) -> Work:
    """So many programs in C at a time."""
    command = [str(compiled()), str(5 * LONGER), "1"]

    def work() -> None:
        running = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(number)]
        for process in running:
            process.wait()

    return work


def single_run(
    root: Path, stop: float, step: float | None, output_step: float | None = None
) -> Work:
    """A run, by a tolerance where there is no step; with all rows where nothing else is said."""
    from cosim import Adaptive, run

    system = pairs(root / "fmus" / "native")
    settings: dict[str, Any] = {"step": step or Adaptive(1e-6), "output_step": output_step}
    return lambda: run(system, stop=stop, record=COLUMNS, **settings)


def prepared_runs(root: Path, number: int) -> Work:
    """So many runs of what is prepared once."""
    from cosim import Prepared, RunSettings

    system = pairs(root / "fmus" / "native")
    settings = RunSettings(STEPS * FINE, FINE, record=COLUMNS)

    def work() -> None:
        with Prepared.open(system, settings) as prepared:
            for _ in range(number):
                prepared.run()

    return work


def sweep_runs(root: Path) -> Work:
    """Runs of a sweep with a figure."""
    from cosim import sweep
    from cosim.metrics import Largest

    system = pairs(root / "fmus" / "native")
    cases = {"motor.A": [7000.0 + k for k in range(MEMBERS)]}
    settings: dict[str, Any] = {"stop": STEPS * FINE, "step": FINE, "record": COLUMNS}
    return lambda: sweep(system, cases, {"torque": Largest("motor.tau")}, **settings)


def certified(root: Path, rows: int, step: float = FINE) -> Work:
    """A certified run whose finest has so many rows."""
    from cosim import certify

    system = pairs(root / "fmus" / "native")
    stop = rows * step / 4.0
    settings = {"stop": stop, "step": step, "output_step": max(step, stop / STEPS)}
    return lambda: certify(system, record=COLUMNS, **settings)


def ask_question(_: Path, name: str) -> Work:
    """A question of the scenarios, again in a process."""
    from scenarios import ask

    return lambda: ask(name, jobs=1)


def run_study(_: Path) -> Work:
    """A study with its own start-up."""
    import scenarios

    def work() -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "study.toml"
            file.write_text(STUDY)
            scenarios.study(file, out=Path(folder) / "out", jobs=1, flavour="native")

    return work


def connect_ring(root: Path, number: int) -> Work:
    """Describe and connect so many parts in a ring, with up to four wires from each to the next."""
    from cosim import System, describe
    from cosim.system import connect

    parts = {f"line.p{k}": root / "fmus" / "LinearSystem.fmu" for k in range(number)}
    outputs = [(k, i) for k in range(number) for i in range(1, 5)]
    wired = outputs[: 10 * number // 3]
    wires = [f"line.p{k}.y[{i}] -> line.p{(k + 1) % number}.u[{i}]" for k, i in wired]
    start = {f"line.p{(k + 1) % number}.u[{i}]": 0.0 for k, i in outputs[len(wired) :]}
    system = System(parts, wires, start)
    return lambda: list(describe.info(connect(system)))


def connect_wide(root: Path, number: int) -> Work:
    """Describe and connect a motor with so many variables more."""
    from cosim import System, describe
    from cosim.system import connect

    with ZipFile(root / "fmus" / "native" / "DriveMotor.fmu") as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    line = '<ScalarVariable name="v[{0}]" valueReference="1{0:06}" causality="local"><Real/></ScalarVariable>'
    text = files["modelDescription.xml"].decode()
    lines = "".join(line.format(k) for k in range(number))
    files["modelDescription.xml"] = text.replace(
        "</ModelVariables>", f"{lines}</ModelVariables>"
    ).encode()
    wide = Path(tempfile.mkdtemp()) / "wide.fmu"
    with ZipFile(wide, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return lambda: list(describe.info(connect(System({"m": wide}, start={"m.w": 1.0}))))


PYTHON, NATIVE = ".", "native"
#: What makes the program as portable as FMUs are, where every operation is rounded, so that flavours and processors agree.
PORTABLE = ("-target", f"{platform.machine()}-linux-gnu.2.17", *OPTIONS)
LINES = (
    *(
        Line(f"a step, {title} FMUs, {words}", make, steps, (flavour, steps))
        for title, flavour, ours in (("Python", PYTHON, LONG), ("native", NATIVE, LONGER))
        for words, make, steps in (
            ("FMPy's methods", fmpy_methods, LONG), ("this master", steps_of_the_master, ours),
            ("libcosim", libcosim, LONG), ("Ecos", ecos, LONG),
        )
    ),
    Line("a step, Python FMUs, their slaves without FMI", bare_slaves, LONG),
    Line("a step, one system by DOP853", dop853, LONG),
    Line("a step, one program in C", by_hand, 10 * LONGER, ((),)),
    Line("a step, the program compiled as FMUs are", by_hand, 10 * LONGER, (PORTABLE,)),
    *(
        Line(f"{words}, of {2 * n} parts each", steps_of_the_master, 2 * n * steps, (NATIVE, steps, n))
        for n in (1, 5, 25, 100, 500)
        for words, steps in (("set-up", 1), ("a step", LONGER // n))
    ),
    Line("describe and connect 3 000 parts, 10 000 wires", connect_ring, 1, (3000,)),
    Line("describe and connect 100 000 variables", connect_wide, 1, (100_000,)),
    *(
        Line(f"a member of {words}", members, number, (steps, every, number))
        for words, steps, every, number in (
            ("one step", 1, 1, 10 * MEMBERS), (f"{STEPS} steps, all rows", STEPS, 1, MEMBERS),
            (f"{STEPS} steps, two rows", STEPS, STEPS, MEMBERS), ("10 steps, of 100 000", 10, 1, 100_000),
        )
    ),
    *(
        Line(f"{words}, {n} at a time, wall", make, n, (n,), time.perf_counter)
        for words, make in (("threads of members", threads), ("programs in C", programs))
        for n in (1, 2)
    ),
    Line(f"a single run of {STEPS} steps", single_run, 1, (STEPS * FINE, FINE)),
    Line(f"a run of {STEPS} steps, prepared", prepared_runs, 100, (100,)),
    Line("an adaptive run", single_run, 1, (0.3, None)),
    Line("a run of 1e6 steps, rows between them", single_run, 1, (LONGER * 1e-5, 1e-5, 1e-3)),
    Line("a run of a sweep, with its largest torque", sweep_runs, MEMBERS),
    Line(f"certify, {STEPS} steps in the finest run", certified, 1, (STEPS,)),
    Line("certify, 2 000 000 steps in the finest run", certified, 1, (2_000_000,)),
    Line("`resonance`, again in a process", ask_question, 1, ("resonance",)),
    Line("`resonance_map`, again in a process", ask_question, 1, ("resonance_map",)),
    Line("a run of a study of `resonance`, start-up included", run_study, 4),
)  # fmt: skip


def measure_here(number: int, root: Path, rounds: int) -> None:
    """Print the seconds for one of what a line says, and the most memory [MB]."""
    sys.path[:0] = [str(root)]
    line = LINES[number]
    work = line.make(root, *line.arguments)
    work()
    times = []
    for _ in range(rounds):
        began = line.clock()
        work()
        times.append((line.clock() - began) / line.count)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print("\nmeasured", median(times), memory, flush=True)


def measure(number: int, root: Path, rounds: int) -> tuple[float, float] | str:
    """The seconds and the memory [MB] of a line in a checkout, or why there are none."""
    command = [root / ".venv" / "bin" / "python", __file__, "--line", number, "--root", root]
    done = subprocess.run(
        [*map(str, (*command, "--rounds", rounds))], check=False, capture_output=True, text=True, cwd=root
    )  # fmt: skip
    for line in done.stdout.splitlines():
        if line.startswith("measured "):
            time, memory = map(float, line.split()[1:])
            return time, memory
    return (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]


def in_words(time: float) -> str:
    """A time in the unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if time >= size:
            return f"{time / size:.3g} {unit}"
    return f"{time / 1e-6:.3g} us"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, help="folder of another checkout")
    parser.add_argument("--only", default="", help="lines with these words")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--line", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--root", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.root:
        measure_here(options.line, options.root, options.rounds)
    else:
        places = [ROOT] + ([options.against.resolve()] if options.against else [])
        print("| | here | memory | before | ratio |\n|---|---|---|---|---|")
        for number, line in enumerate(LINES):
            if options.only not in line.words:
                continue
            found = [measure(number, place, options.rounds) for place in places]
            cells = [
                (x,) if isinstance(x, str) else (in_words(x[0]), f"{x[1]:.0f} MB") for x in found
            ]
            texts = [*cells[0], *(cells[1][:1] if len(cells) > 1 else [])]
            if len(found) > 1 and not any(isinstance(x, str) for x in found):
                texts.append(f"{found[0][0] / found[1][0]:.3g}")  # type: ignore[operator]
            print(f"| {line.words} | {' | '.join(texts)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
