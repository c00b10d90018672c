"""The FMUs in hosts that are not ours: libcosim, Ecos, and programs without Python."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cosim import System, run, write_osp, write_ssp
from tests.fmukit.test_native import built

HOSTS = Path(__file__).parent
STEPS, STEP = 200, 1e-3
RECORD = ["motor.tau", "conveyor.w", "conveyor.phi"]
START = {"rotor.J": 0.6, "tau": 12.0}


@dataclass(frozen=True)
class Case:
    """A system that all hosts can run: components by part, wires, start values, what to compare.

    `clock` is what a host's clock, which adds up steps, may do to durations that are compared.
    """

    parts: dict[str, str]
    wires: list[tuple[str, str]]
    start: dict[str, float | bool]
    record: list[str]
    steps: int = 200
    step: float = 1e-3
    clock: float = 0.0

    def task(self, fmus: Path) -> str:
        """The case as the scripts of the hosts take it."""
        parts = {name: str(fmus / f"{fmu}.fmu") for name, fmu in self.parts.items()}
        return json.dumps(asdict(self) | {"parts": parts})

    def system(self, fmus: Path) -> System:
        """The case as our master takes it."""
        return System(
            parts={name: fmus / f"{fmu}.fmu" for name, fmu in self.parts.items()},
            wires=[f"{source} -> {target}" for source, target in self.wires],
            start=self.start,
        )

    def ours(self, fmus: Path) -> np.ndarray:
        """The recorded values of our Jacobi master, a row per communication point."""
        settings: dict[str, Any] = {"stop": self.steps * self.step, "step": self.step}
        result = run(self.system(fmus), **settings, algorithm="jacobi", record=self.record)
        return np.column_stack([result[name] for name in self.record])


PAIR = Case(
    {"motor": "DriveMotor", "conveyor": "CrankConveyor"},
    [("motor.tau", "conveyor.tau"), ("conveyor.w", "motor.w")],
    {},
    RECORD,
)
CASES = {
    "conveyor": PAIR,
    "iron drive": Case(
        {"motor": "DriveMotor", "iron": "IronDrive"},
        [("motor.tau", "iron.tau"), ("iron.w", "motor.w")],
        {"motor.A": 4.0, "motor.B": 0.025, "motor.T": 0.012, "motor.tau": 0.0},
        ["motor.tau", "iron.phi", "iron.w_cam", "iron.w", "iron.E_friction", "iron.N"],
        steps=1200,
    ),
    "bouncing follower": Case(
        {"motor": "DriveMotor", "iron": "IronDrive"},
        [("motor.tau", "iron.tau"), ("iron.w", "motor.w")],
        {
            "motor.A": 8.0,
            "motor.B": 0.025,
            "motor.T": 0.012,
            "motor.tau": 0.0,
            "iron.phi": 0.0,
            "iron.w_cam": 8.0,
            "iron.follower.lifts": True,
        },
        [f"iron.{name}" for name in ("phi", "w_cam", "gap", "t_flight", "E_landing", "S_landing")],
        steps=600,
    ),
    "orientator": Case(
        {"orientator": "GravityOrientator"},
        [],
        {"orientator.w": 4.0, "orientator.release": True, "orientator.chute.mu": 0.5},
        [
            f"orientator.{name}"
            for name in ("phi1", "phi2", "xc", "yc", "w2", "t_joint", "orientation_time")
        ],
        steps=300,
        clock=1e-14,
    ),
}


@pytest.fixture(scope="module")
def starter(both: Path, fmus: Path) -> list[str]:
    """What comes before a program without Python, as the FMU's own documentation says."""
    if both != fmus:
        return []
    library = Path(*map(str, sysconfig.get_config_vars("LIBDIR", "INSTSONAME")))
    if ".so" not in library.name or not library.is_file():
        pytest.skip(f"this Python has no shared library, {library}")
    with zipfile.ZipFile(fmus / "CrankConveyor.fmu") as archive:
        text = archive.read("documentation/externalDependencies.txt").decode()
    (line,) = re.findall(r"^ +(LD_PRELOAD=.*) HOST$", text, re.MULTILINE)
    return ["sh", "-c", f'{line} "$@"', "sh"]


def finish(
    *command: Any, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end; its exit code must be 0."""
    path = os.pathsep.join((str(HOSTS / "bin"), f"{sys.prefix}/bin", os.environ["PATH"]))
    done = subprocess.run(
        [*map(str, command)],
        cwd=cwd,
        env={**os.environ, "PATH": path, **environment},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, f"exit code {done.returncode}: {done.stdout}{done.stderr}"
    return done


#: Cases with their flavour: of Python FMUs one, since both have the same bits.
HOSTED = pytest.mark.parametrize(
    ("name", "flavour"), [("conveyor", "."), *((name, "native") for name in CASES)]
)


@pytest.mark.parametrize("host", ["libcosim", "ecos"])
@HOSTED
def test_a_host_reproduces_our_jacobi_master(
    host: str, name: str, flavour: str, fmus: Path
) -> None:
    """libcosim steps by a difference of times, hence not to the bit; Ecos does, from the initial values on,
    although it steps the FMUs in several threads.
    """
    case, folder = CASES[name], fmus / flavour
    done = finish(sys.executable, HOSTS / f"{host}_system.py", case.task(folder))
    time, *values = np.transpose(json.loads(done.stdout))
    first, unit, rel, abs_ = (
        (1, 1e9, 1e-10, 1e-12) if host == "libcosim" else (0, 1.0, 0.0, case.clock)
    )
    assert_allclose(time, unit * case.step * np.arange(first, case.steps + 1), rtol=1e-12)
    assert_allclose(np.transpose(values), case.ours(folder)[first:], rtol=rel, atol=abs_)


@pytest.mark.parametrize("kind", ["ssp", "osp"])
def test_libcosim_runs_types_and_wires(fmus: Path, echo: Path, kind: str, tmp_path: Path) -> None:
    """Parts of subsystems, factors, offsets, unconverted numbers, Integer, Boolean and String."""
    system = System(
        {
            "line.motor": fmus / "DriveMotor.fmu",
            "line.conveyor": fmus / "CrankConveyor.fmu",
            "echo": echo,
        },
        [
            "line.motor.tau * 1.25 - 0.5 -> line.conveyor.tau",
            "line.conveyor.w -> line.motor.w",
            "line.conveyor.w => echo.u",
        ],
        {
            "line.motor.T": 0.05,
            "line.conveyor.rod.finite": True,
            "echo.i": 3,
            "echo.b": True,
            "echo.s": "B",
            "echo.r": 0.5,
        },
    )
    record = ["line.motor.tau", "line.conveyor.w", "line.conveyor.x", "echo.y"]
    system_path = tmp_path / f"system.{kind}"
    if kind == "ssp":
        write_ssp(system, system_path)
    else:
        write_osp(system, system_path, step=STEP)
    parts = {name: str(fmu).removesuffix(".fmu") for name, fmu in system.parts.items()}
    task = Case(parts, [], {}, record).task(fmus)
    done = finish(sys.executable, HOSTS / "libcosim_system.py", task, system_path)
    _, *values = np.transpose(json.loads(done.stdout))
    result = run(system, stop=STEPS * STEP, step=STEP, algorithm="jacobi", record=record)
    ours = [result[name][1:] for name in record]
    assert_allclose(values, ours, rtol=1e-10, atol=1e-12)
    assert ours[-1][0] > 1e4 * ord("B") + 1030.5


@pytest.mark.slow
@pytest.mark.parametrize("folders", [("fmi3", "fmi3"), ("fmi3", "native"), ("native", "fmi3")])
def test_ecos_reproduces_our_jacobi_master_with_fmi_3(folders: tuple[str, str], fmus: Path) -> None:
    """Alone and mixed, to the bits of FMI 2.0."""
    parts = {
        part: f"{folder}/{built(name).stem if folder == 'fmi3' else name}"
        for folder, (part, name) in zip(folders, PAIR.parts.items())
    }
    case = replace(PAIR, parts=parts)
    done = finish(sys.executable, HOSTS / "ecos_system.py", case.task(fmus))
    values = np.transpose(np.transpose(json.loads(done.stdout.splitlines()[-1]))[1:])
    assert_array_equal(values, case.ours(fmus))
    assert_array_equal(values, PAIR.ours(fmus / "native"))


@pytest.mark.parametrize(
    ("opened", "created", "closed"),
    [("AB", *orders) for orders in product(("AB", "BA"), ("AB", "BA"))]
    + [("ABC", "CBA", "ABC"), ("ABC", "CAB", "C")],
    ids="-".join,
)
def test_a_host_without_python_may_close_libraries_in_any_order(
    opened: str, created: str, closed: str, both: Path, starter: list[str], tmp_path: Path
) -> None:
    """It steps the FMUs that are still open after each one that it closes, and ends."""
    arguments = []
    for letter, name in zip(opened, ("CrankConveyor", "DriveMotor", "Gearbox"), strict=False):
        guid = fmpy.read_model_description(both / f"{name}.fmu").guid
        folder = Path(fmpy.extract(both / f"{name}.fmu", tmp_path / letter))
        library = folder / "binaries" / "linux64" / f"{name}.so"
        arguments += [library, (folder / "resources").as_uri(), guid]
    program = compile_host("closing.c", tmp_path)
    done = finish(*starter, program, opened, created, closed, *arguments)
    assert done.stdout == "end of main\n"


def compile_host(source: str, folder: Path) -> Path:
    """A program made of one of the C files here."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no gcc")
    headers, program = Path(fmpy.__file__).with_name("c-code"), folder / Path(source).stem
    gcc = ["gcc", "-Wall", "-Wextra", "-Werror", f"-I{headers}"]
    finish(*gcc, HOSTS / source, "-ldl", "-o", program)
    return program


def c_program(fmu: Path, folder: Path, status: int) -> list[Any]:
    """The program host.c and what it is told; `status` is what a refused step returns."""
    program = compile_host("host.c", folder.parent)
    description = fmpy.read_model_description(fmu)
    reference = {v.name: v.valueReference for v in description.modelVariables}
    start_arguments = [text for name, value in START.items() for text in (reference[name], value)]
    library = Path(fmpy.extract(fmu, folder)) / "binaries" / "linux64" / "CrankConveyor.so"
    resources = (folder / "resources").as_uri()
    return [program, library, resources, description.guid, *start_arguments, reference["w"], status]


def test_c_program_without_python_agrees_with_our_master_to_the_bit(
    both: Path, fmus: Path, starter: list[str], tmp_path: Path
) -> None:
    """It also rolls back, survives a refused step, and repeats its run after a reset."""
    fmu = both / "CrankConveyor.fmu"
    nasty = "fmu" if both == fmus else "a 100%s #1 + ærø"
    done = finish(*starter, *c_program(fmu, tmp_path / nasty, 4 if both == fmus else 3))

    assert done.stderr.count("communication step = -0.001 s must be a finite number above 0") == 2
    start = {f"conveyor.{name}": value for name, value in START.items()}
    system = System(parts={"conveyor": fmu}, start=start)
    result = run(system, stop=STEPS * STEP, step=STEP, record=["conveyor.w"])
    assert_array_equal(np.array(done.stdout.split(), float), result["conveyor.w"][1:])


@pytest.mark.parametrize("both", ["python"], indirect=True)
def test_memory_is_sound_to_the_end_of_a_process(
    both: Path, starter: list[str], tmp_path: Path
) -> None:
    """Also after the last line of its host, when libraries that are still loaded leave."""
    if shutil.which("valgrind") is None:
        pytest.skip("there is no valgrind")
    valgrind = ["valgrind", "-q", "--undef-value-errors=no", "--error-exitcode=9"]
    program = c_program(both / "CrankConveyor.fmu", tmp_path / "fmu", 4)
    finish(*starter, *valgrind, *program, PYTHONMALLOC="malloc")
