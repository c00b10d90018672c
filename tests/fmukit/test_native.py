"""Native FMUs: the Python ones to the last bit, more of FMI than those, and safe in any host."""

import ctypes
import functools
import importlib
import itertools
import math
import random
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from components import MACHINES
from fmukit.declare.interface import Interface, class_name, component_name
from fmukit.declare.model import complete_model
from fmukit.fmu.native import package
from tests.conftest import ROOT, TRIED
from tests.hosts.host import MESSAGES, Equations, Unit

HOSTS = ROOT / "tests" / "hosts"
HEADERS = Path(fmpy.__file__).with_name("c-code")
MODELS = {
    class_name(model): complete_model(model)
    for model in (importlib.import_module(f"components.{name}.model") for name in MACHINES)
}
NAMES = [name for name, model in MODELS.items() if not model.PYTHON_ONLY]
each = pytest.mark.parametrize("name", NAMES)


@functools.cache
def built(name: str) -> Path:
    """The FMU of FMI 3.0 for this machine, made if no session has made it at its start."""
    component = component_name(MODELS[name])
    if component not in TRIED:
        command = [sys.executable, "build_fmus.py", component, "--flavour", "fmi3"]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return ROOT / "fmus" / "fmi3" / f"{name}.fmu"


def only_for(*names: str) -> Any:
    """These machines, and the others in the slow tests: for what only the shared runtime decides."""
    slow = pytest.mark.slow
    every = [n if n in names else pytest.param(n, marks=slow) for n in NAMES]
    return pytest.mark.parametrize("name", every)


sampled = only_for("CrankConveyor", "GravityOrientator")


def wave(**amplitudes: tuple[float, float, float]) -> Callable[[float], dict[str, Any]]:
    """Inputs that swing: mean, amplitude and angular frequency by name."""
    return lambda t: {n: a + b * math.sin(c * t) for n, (a, b, c) in amplitudes.items()}


def drops(rpm: float) -> Callable[[float], dict[str, Any]]:
    """A rotor whose speed swings, and a new product every half second."""
    speed = rpm * math.pi / 30
    return lambda t: {"w": speed * (1 + 0.1 * math.sin(10 * t)), "release": t % 0.5 < 0.2}


TORQUE, SPEED = wave(tau=(8.0, 5.0, 37.0)), wave(w=(40.0, 3.0, 30.0))
SCENARIOS: list[Any] = [
    *(
        ("DriveMotor", {"input_hold": hold, "characteristic": kind}, SPEED, 1e-3, 300)
        for hold in (0, 1, 2)
        for kind in (0, 1)
    ),
    ("CrankConveyor", {}, TORQUE, 1e-3, 1000),
    ("CrankConveyor", {"rod.finite": True, "input_hold": 2}, TORQUE, 1e-3, 500),
    ("CrankConveyor", {"crank.r": 0.05, "rod.l": 0.2, "input_hold": 1}, TORQUE, 0.05, 100),
    *(("SlottedLink", {"link.swings": swings}, TORQUE, 1e-3, 500)
      for swings in (False, True)),
    ("IronDrive", {}, wave(tau=(0.1, 0.0, 0.0)), 1e-3, 400),
    ("IronDrive", {"phi": 0.9, "friction.K_up": 0.6, "friction.K_down": -0.5},
     wave(tau=(0.0, 0.1, 2.0)), 1e-3, 3000),
    *(
        ("IronDrive", {"wrap": w, "spring.side": side, "on_invalid": 1}, wave(tau=(0.1, 0.15, 3.0)),
         1e-3, 1500)
        for w in (0, 1)
        for side in (1, -1)
    ),
    *(
        ("GravityOrientator", {"chute.mu": mu, "input_hold": hold}, drops(rpm), h, round(2.0 / h))
        for mu, rpm in ((0.2, 40), (0.2, 100), (0.35, 75), (0.5, 60), (0.5, 75), (0.5, 100))
        for hold, h in ((0, 1e-3), (2, 0.013))
    ),
    *(("DCMotor", {"input_hold": hold}, wave(v=(24.0, 48.0, 9.0), w=(50.0, 90.0, 30.0)), 1e-3, 300)
      for hold in (0, 1, 2)),
    *(("SpeedController", {"antiwindup": on, "input_hold": 2},
       wave(w_ref=(40.0, 9.0, 5.0), w=(38.0, 20.0, 3.0)), 1e-2, 300) for on in (True, False)),
    *(("Gearbox", {"i": i, "w_a": 1.0}, wave(tau_a=(0.0, 2.0, 30.0), tau_b=(1.0, 9.0, 20.0)), 1e-3,
       1000) for i in (5.0, -3.0)),
    *(("ShaftLink", {"b": b, "input_hold": 1}, wave(w_a=(0.1, 2.0, 40.0), w_b=(0.0, 1.0, 70.0)), 1e-3,
       500) for b in (0.0, 0.02)),
    ("UnbalanceExciter", {}, wave(tau=(0.6, 0.3, 20.0)), 1e-2, 500),
    *(("LinearSystem", {"input_hold": hold, "A[1,2]": 3.0, "A[2,1]": -4.0, "B[2,2]": 1.0, "x[3]": 0.5},
       wave(**{"u[1]": (0.1, 2.0, 4.0), "u[2]": (0.0, 1.0, 7.0)}), 0.03, 30) for hold in (0, 1, 2)),
]  # fmt: skip


def units(name: str, fmus: Path) -> list[Unit]:
    """The equations of a machine, its Python FMU, and its native one if there is one."""
    paths = [fmus / f"{name}.fmu", *([fmus / "native" / f"{name}.fmu"] if name in NAMES else [])]
    return [Equations(MODELS[name]), *map(Unit, paths)]


def rows(unit: Unit, start: dict[str, Any], inputs: Any, h: float, steps: int) -> list[list[Any]]:
    """All outputs after every step."""
    unit.start(**start, **inputs(0.0))
    return [unit.set(**inputs(n * h)).step(n * h, h).outputs() for n in range(steps)]


def take_messages() -> list[str]:
    """What was logged, without what comes before the instance's name, which is then forgotten."""
    texts = [re.sub(r"(?s).*?(unit: )", r"\1", text, count=1) for text in MESSAGES]
    MESSAGES.clear()
    return texts


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(c, id=f"{c[0]}-{c[1]}-{c[3]}", marks=[pytest.mark.slow] if spare else [])
        for k, c in enumerate(SCENARIOS)
        for spare in [
            c[0] in ("IronDrive", "GravityOrientator")
            and (k % 2 or c[4] >= 3000 or c[1].get("wrap"))
        ]
    ],
)
def test_equations_and_both_flavours_agree_to_the_last_bit(case: Any, fmus: Path) -> None:
    """Their outputs; warnings with the values of the event; and the reason of a failure, digit by digit."""
    name, start, inputs, h, steps = case
    equations, *compiled = units(name, fmus)
    expected, texts = rows(equations, start, inputs, h, steps), []
    assert all(map(math.isfinite, itertools.chain(*expected)))
    for unit in compiled:
        MESSAGES.clear()
        assert rows(unit, start, inputs, h, steps) == expected
        texts.append(take_messages())
        unit.refusal(lambda u: u.set(**{reals(u, "input")[0]: 1e300}).step(h * steps, h))
        texts[-1] += take_messages()
    assert all(text == texts[0] for text in texts)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("native", [False, True], ids=["python", "native"])
def test_any_step_can_be_redone_from_a_saved_state(name: str, native: bool, fmus: Path) -> None:
    """In any order, as it is and serialised, also in another instance."""
    _, *compiled = units(name, fmus)
    if native >= len(compiled):
        pytest.skip("it has no native flavour")
    _, start, inputs, h, steps = [case for case in SCENARIOS if case[0] == name][-1]
    start = start | ({"missed": -(2**31)} if name == "GravityOrientator" else {})
    count = min(steps, 150)
    one, other = compiled[native], units(name, fmus)[1 + native]
    one.start(**start, **inputs(0.0))
    saved, expected = [], []
    for n in range(count):
        saved.append(one.fmi.getFMUstate())
        expected.append(one.set(**inputs(n * h)).step(n * h, h).outputs())
    for k in random.Random(1).sample(range(count), count):
        state, unit = saved[k], one
        if k % 2:
            content = one.fmi.serializeFMUstate(state)
            state, unit = other.fmi.deSerializeFMUstate(content), other
        unit.fmi.setFMUstate(state)
        assert unit.set(**inputs(k * h)).step(k * h, h).outputs() == expected[k]


@pytest.mark.parametrize("flavour", ["", "native"])
def test_a_state_read_by_itself_before_the_start_follows_from_the_rest(
    flavour: str, fmus: Path
) -> None:
    observed = []
    for first in ("yc", "N_K"):
        unit = Unit(fmus / flavour / "GravityOrientator.fmu")
        unit.fmi.setupExperiment()
        unit.set(stage=2, phi1=1.0, phi2=5.8, yc=9.0)
        assert unit.get("yc") == 9.0
        unit.fmi.enterInitializationMode()
        unit.get(first)
        observed.append(unit.get("yc"))
    assert observed[0] == observed[1] != 9.0


def derivative(unit: Unit, unknown: list[str], variable_name: str) -> Any:
    """fmi2GetDirectionalDerivative of some variables by one of them."""
    refs = [unit.variables[n].valueReference for n in unknown]
    known = [unit.variables[variable_name].valueReference]
    return np.array(unit.fmi.getDirectionalDerivative(refs, known, [1.0]))


def reals(unit: Unit, *causalities: str) -> list[str]:
    return [n for n, v in unit.variables.items() if v.type == "Real" and v.causality in causalities]


def compare_derivatives(
    unit: Unit, unknowns: list[str], knowns: list[str], put: Callable[[str, float], Any]
) -> None:
    """The directional derivatives of variables, and Richardson's extrapolation of central differences, where
    `put` sets a known variable and leaves all others as they were.
    """
    nonzero = 0
    for known in knowns:
        value = unit.get(known)
        exact = derivative(unit, unknowns, known)

        def difference(step: float, known: str = known, value: float = value) -> Any:
            sides = []
            for side in (value + step, value - step):
                put(known, side)
                sides.append(np.array([unit.get(n) for n in unknowns]))
            return (sides[0] - sides[1]) / (2 * step)

        step = 5e-4 * (abs(value) or 1.0)
        estimate = (4 * difference(step) - difference(2 * step)) / 3
        put(known, value)
        noise = 1e-12 * (1.0 + np.abs([unit.get(n) for n in unknowns])) / step
        assert np.all(np.abs(exact - estimate) <= 1e-6 * np.abs(estimate) + noise), known
        nonzero += np.count_nonzero(exact)
    assert nonzero > len(knowns)


@each
@pytest.mark.parametrize("seed", range(3))
def test_directional_derivatives_at_the_start_match_finite_differences(
    name: str, seed: int, native: Path
) -> None:
    """Of outputs and of the states' derivatives, by every Real parameter, state and input."""
    rng, unit = random.Random(seed), Unit(native / f"{name}.fmu")
    start = {
        "DriveMotor": {"characteristic": seed % 2, "w": rng.uniform(30, 60)},
        "CrankConveyor": {"phi": rng.uniform(0, 6), "w": 35.0, "rod.finite": seed > 0},
        "SlottedLink": {"phi": rng.uniform(0, 6), "w": 35.0, "link.swings": seed > 0},
        "IronDrive": {"phi": [0.6, 3.5, -1.0][seed], "w_cam": [2.0, 3.0, 0.5][seed],
                      "wrap": seed % 2, "direction": int(seed < 2), "gap": 0.05, "w_gap": 0.1,
                      "flying": seed == 1, "follower.lifts": seed == 1, "joints.cam": 0.1,
                      "joints.rocker": 0.1, "joints.link": 0.1, "joints.sprocket": 0.1},
        "DCMotor": {"i": rng.uniform(5, 9)},
        "ShaftLink": {"twist": [0.03, -0.02, 0.012][seed]},
        "UnbalanceExciter": {"phi": rng.uniform(0, 6), "w": 35.0, "x": 0.01, "v": 1.0},
        "GravityOrientator": [
            {"stage": 1, "phi1": 0.7, "w1": 3.0},
            {"stage": 2, "phi1": 1.0, "phi2": 5.8, "w1": 4.0, "w2": 9.0},
            {"stage": 3, "phi1": 0.7, "phi2": 6.9, "w1": -1.0, "w2": 9.0, "vyc": 1.0},
        ][seed] | {"neglected.mu_side": 0.2, "neglected.mu_catcher": 0.2, "neglected.rim": 1e-3,
                   "neglected.anchored": seed > 0},
    }.get(name, {})  # fmt: skip
    unit.fmi.setupExperiment()
    unit.set(**start)
    unit.fmi.enterInitializationMode()
    calculated = next(n for n, v in unit.variables.items() if v.initial == "calculated")
    state = unit.fmi.getFMUstate()

    def put(known: str, value: float) -> None:
        unit.fmi.setFMUstate(state)
        unit.set(**{known: value}).get(calculated)

    reals_to_set = [
        n
        for n in reals(unit, "parameter", "input", "output")
        if unit.variables[n].start is not None
    ]
    rates = [u.variable.name for u in unit.description.derivatives]
    compare_derivatives(unit, reals(unit, "output") + rates, reals_to_set, put)


@each
def test_output_derivatives_are_the_slopes_of_the_outputs(name: str, fmus: Path) -> None:
    """Central differences over two steps of an input that runs on a line."""
    unit = Unit(fmus / "native" / f"{name}.fmu")
    variable_name, *_ = reals(unit, "input")
    unit.start(**({"phi": 0.6, "w_cam": 2.0} if name == "IronDrive" else {}))
    outputs = [n for n in reals(unit, "output") if not n.startswith(("t_", "S_", "P_B", "P_K"))]
    references = [unit.variables[n].valueReference for n in outputs]
    value, h = unit.get(variable_name), 2e-5
    rows = []
    for n in range(41):
        rate(unit, variable_name, 3.0)
        unit.set(**{variable_name: value + 3.0 * n * h}).step(n * h, h)
        rows.append([unit.get(o) for o in outputs])
        if n == 39:
            orders = [1] * len(references)
            slopes = np.array(unit.fmi.getRealOutputDerivatives(references, orders))
    estimate = (np.array(rows[40]) - np.array(rows[38])) / (2 * h)
    scale = np.abs(np.array(rows[40])) / h
    assert np.count_nonzero(slopes) > 2
    assert np.all(np.abs(slopes - estimate) <= 1e-4 * np.abs(estimate) + 1e-12 * scale + 1e-5)


def test_an_output_derivative_without_a_finite_value_is_an_error(fmus: Path) -> None:
    """The torque itself stays finite: 1e308 N.m within the lag of 0.0625 s."""
    unit = Unit(fmus / "native" / "DriveMotor.fmu").start(A=1e308).step(0.0, 1e-3)
    tau = [unit.variables["tau"].valueReference]
    message = unit.refusal(lambda u: u.fmi.getRealOutputDerivatives(tau, [1]))
    assert "the derivative of tau = inf must be a finite number" in message


def rate(unit: Unit, name: str, value: float) -> None:
    """The derivative of one input."""
    unit.fmi.setRealInputDerivatives([unit.variables[name].valueReference], [1], [value])


def test_derivatives_of_other_orders_and_of_other_variables_are_refused(fmus: Path) -> None:
    for name, value, message in (
        ("tau", 1.0, "the derivative of tau cannot be set: continuous output, after init"),
        ("w", math.nan, "the derivative of w = nan must be a finite number"),
    ):
        unit = Unit(fmus / "native" / "DriveMotor.fmu", "unit 7").start()
        refusal = unit.refusal(lambda u, name=name, value=value: rate(u, name, value))
        assert f"unit 7: {message}" in refusal


def test_the_binary_needs_only_the_c_library_of_2012(fmus: Path, tmp_path: Path) -> None:
    if shutil.which("readelf") is None:
        pytest.skip("there is no readelf")
    for name in NAMES:
        folder = Path(fmpy.extract(fmus / "native" / f"{name}.fmu", tmp_path / name))
        library = folder / "binaries" / "linux64" / f"{name}.so"
        message = subprocess.run(
            ["readelf", "-dV", library], check=True, capture_output=True, text=True
        ).stdout
        needed = {
            line.split("[")[1].strip("]") for line in message.splitlines() if "(NEEDED)" in line
        }
        assert needed <= {"libc.so.6", "libm.so.6"}
        versions = {word.strip("(),") for word in message.split() if word.startswith("GLIBC_2")}
        assert max(tuple(map(int, v[6:].split("."))) for v in versions) <= (2, 17)


@only_for("DCMotor")
def test_the_library_for_windows_needs_only_the_c_library_of_windows(
    name: str, tmp_path: Path
) -> None:
    code = library_for("x86_64-windows-gnu", name, tmp_path).read_bytes()
    needed = {x.decode() for x in re.findall(rb"[\w.-]+\.dll\0", code)} - {f"{name}.dll\0"}
    assert needed
    assert all(x.startswith("api-ms-win-crt-") for x in needed), needed


def library_for(target: str, name: str, folder: Path) -> Path:
    """The library of a machine for a target of Zig, which the FMUs of the tests do not contain."""
    build = package.hashed_build(MODELS[name])
    for file, content in package.sources_of(build).items():
        (folder / file).write_bytes(content)
    library = f"{name}.{'dll' if 'windows' in target else 'so'}"
    package.compile_for(target, library, name, folder)
    return folder / library


def compile_c(source: Path, target: Path, *options: Any) -> None:
    command = ["gcc", "-std=gnu99", "-g", "-Wall", "-Wextra", "-Wno-unused-parameter"]
    command += ["-Wno-unused-variable", "-Wno-unused-but-set-variable", "-Werror"]
    subprocess.run([*command, f"-I{HEADERS}", source, "-o", target, *map(str, options)], check=True)


def unpacked(fmu: Path, folder: Path) -> tuple[Path, list[str]]:
    """An FMU's folder, and what the host must know: guid, numbers of variables, states, indicators."""
    description = fmpy.read_model_description(fmu)
    counts = (
        len(description.modelVariables),
        description.numberOfContinuousStates,
        description.numberOfEventIndicators,
    )
    host_arguments = [description.guid, *map(str, counts)]
    return Path(fmpy.extract(fmu, folder)), host_arguments


NUMBERS = """\
#define FMI2_FUNCTION_PREFIX text_
#include "DriveMotor.c"
__attribute__((visibility("default"))) void real(double x, char *text) { format_real(x, text); }
__attribute__((visibility("default"))) void integer(double x, char *text) { format_integer(x, text); }
"""


def test_numbers_in_messages_are_written_as_python_writes_them(tmp_path: Path) -> None:
    """Powers of two and ten, where the distance to the next number changes, their neighbours, any bits."""
    build = package.hashed_build(MODELS["DriveMotor"])
    for file, content in package.sources_of(build).items():
        (tmp_path / file).write_bytes(content)
    (tmp_path / "numbers.c").write_text(NUMBERS)
    library = tmp_path / "numbers.so"
    compile_c(tmp_path / "numbers.c", library, "-shared", "-fPIC", "-Wno-unused-function", "-lm")
    functions, text = ctypes.CDLL(str(library)), ctypes.create_string_buffer(64)

    def write(function: str, x: float) -> str:
        getattr(functions, function)(ctypes.c_double(x), text)
        return text.value.decode()

    bits = random.Random(4)
    numbers = [0.0, -0.0, math.inf, -math.inf, math.nan, 1e16, 123456789012345680.0, 1e-4, 1e-5]
    borders = [2.0**k for k in range(-1074, 1024)] + [10.0**k for k in range(-323, 309)]
    numbers += [
        y for x in borders for y in (x, math.nextafter(x, 0.0), math.nextafter(x, math.inf))
    ]
    numbers += struct.unpack("20000d", bits.randbytes(160_000))
    for x in numbers:
        assert write("real", x) == repr(x)
    for n in (0, 1, -1, 10, 2**31 - 1, -(2**31), 2**53, -(2**63)):
        assert write("integer", float(n)) == str(n)


HOST_TARGET = "x86_64-linux-gnu"
#: A function of a library for any platform, which returns this text.
ANSWER = """\
#ifdef _WIN32
#define OPEN __declspec(dllexport)
#else
#define OPEN __attribute__((visibility("default")))
#endif
OPEN const char *answer(void) {{ return "{}"; }}
"""


@pytest.mark.parametrize("target", ["x86_64-windows-gnu", HOST_TARGET])
def test_a_library_is_made_of_the_sources_in_its_own_folder(target: str, tmp_path: Path) -> None:
    """Also where sources of the same name, compiled before with the same cache, are still in another folder."""
    for text in ("made first", "made last!"):
        folder = tmp_path / text.replace(" ", "_")
        folder.mkdir()
        (folder / "Same.c").write_text(ANSWER.format(text))
        assert text.encode() in package.compile_for(target, "Same.library", "Same", folder)


WINE = next(filter(None, map(shutil.which, ("wine64", "wine", "/usr/lib/wine/wine64"))), None)
ARM = Path("/usr/aarch64-linux-gnu")
EMULATORS: dict[str, list[Any]] = {
    HOST_TARGET: [],
    "x86_64-windows-gnu": [WINE],
    "aarch64-linux-gnu.2.17": [
        shutil.which("qemu-aarch64"),
        "-L",
        str(ARM) if ARM.exists() else None,
    ],
}
EMULATED = [x for x, emulator in EMULATORS.items() if emulator and None not in emulator]


@pytest.fixture(scope="session")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """What a host prints that runs a library where this target runs, by an emulator if there is one."""
    folder = tmp_path_factory.mktemp("hosts")
    quiet = {"WINEDEBUG": "-all", "HOME": str(folder), "PATH": "/usr/bin:/bin"}

    @functools.cache
    def compiled(source: str, target: str) -> Path:
        program, base = folder / f"{source}.{target}.exe", ["-O2", f"-I{HEADERS}", f"-I{HOSTS}"]
        if "windows" not in target:
            package.run_compiler(target, str(HOSTS / source), str(program), folder, base)
            return program
        options, traced = ["-c", *base, f'-DMODEL="{source}"'], f"{source}.obj"
        package.run_compiler(target, str(HOSTS / "windows.c"), traced, folder, options)
        host_parts = ("convert", "runtime", "stdio", "utility")
        libraries = [*package.UCRT, *(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in host_parts)]
        options = ["-nostdlib", *libraries, "-lkernel32"]
        package.run_compiler(
            target, traced, program.name, folder, [*options, "-Wl,-e,mainCRTStartup"]
        )
        return program

    def run(source: str, target: str, library: Path, *arguments: object) -> str:
        emulator = EMULATORS[target]
        if None in emulator:
            pytest.skip(f"there is no emulator of {target} with its C library")
        command = [*emulator, compiled(source, target), library, *map(str, arguments)]
        environment = quiet if emulator else {}
        return subprocess.run(
            command, check=True, env=environment, stdout=subprocess.PIPE, text=True
        ).stdout

    return run


@pytest.mark.parametrize("target", EMULATED)
@only_for("CrankConveyor")
def test_every_call_is_survived_elsewhere(
    name: str, target: str, elsewhere: Callable[..., str], fmus: Path, tmp_path: Path
) -> None:
    every_call(name, target, elsewhere, fmus, tmp_path)


@each
def test_every_call_is_survived(
    name: str, elsewhere: Callable[..., str], fmus: Path, tmp_path: Path
) -> None:
    """Without any Python, from a path that pythonfmu could not stand."""
    every_call(name, HOST_TARGET, elsewhere, fmus, tmp_path)


def library_in(folder: Path, target: str, name: str) -> Path:
    """The library in an unpacked FMU, or one that is compiled there for another platform."""
    if target == HOST_TARGET:
        return folder / "binaries" / "linux64" / f"{name}.so"
    return library_for(target, name, folder)


def every_call(
    name: str, target: str, elsewhere: Callable[..., str], fmus: Path, folder: Path
) -> None:
    folder, host_arguments = unpacked(fmus / "native" / f"{name}.fmu", folder / "a 100%s #1 + ærø")
    library = library_in(folder, target, name)
    elsewhere("every_call.c", target, library, *host_arguments, 20)


@pytest.mark.parametrize("target", EMULATED)
@only_for("GravityOrientator")
def test_numbers_are_the_same_on_other_platforms(
    name: str, target: str, elsewhere: Callable[..., str], fmus: Path, tmp_path: Path
) -> None:
    """To the bit where the C library is the same one, else to what sine and power differ by."""
    folder, (guid, *_) = unpacked(fmus / "native" / f"{name}.fmu", tmp_path)
    model = MODELS[name]
    stop, h = model.EXPERIMENT
    roles = ("output", "Real")
    outputs = [
        v.reference for v in Interface(model).variables if (v.causality, v.access_type) == roles
    ]

    def rows(target: str) -> np.ndarray:
        library = library_in(folder, target, name)
        message = elsewhere("rows.c", target, library, guid, round(stop / h), h, *outputs)
        return np.array([line.split() for line in message.splitlines()], float)

    host_rows, target_rows = rows(HOST_TARGET), rows(target)
    assert len(host_rows) == round(stop / h) + 1
    if "linux" in target:
        assert np.array_equal(target_rows, host_rows)
    assert np.all(np.abs(target_rows - host_rows) <= 1e-11 * np.ptp(host_rows, axis=0) + 1e-300)


def test_an_importing_tool_can_compile_the_sources(fmus: Path, tmp_path: Path) -> None:
    """FMPy with CMake, as it would on a platform without a binary; the numbers stay."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no compiler")
    script = (
        "import sys; from fmpy import extract; from fmpy.build import build_platform_binary\n"
        "build_platform_binary(sys.argv[1], generator='Unix Makefiles')"
    )
    fmu = fmus / "native" / "CrankConveyor.fmu"
    folder = Path(fmpy.extract(fmu, tmp_path / "fmu"))
    library = folder / "binaries" / "linux64" / "CrankConveyor.so"
    shipped = library.read_bytes()
    library.unlink()
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    subprocess.run(
        [sys.executable, "-c", script, folder], check=True, env={"PATH": path}, capture_output=True
    )
    assert library.read_bytes() != shipped
    again = tmp_path / "CrankConveyor.fmu"
    with zipfile.ZipFile(again, "w") as archive:
        for file in folder.rglob("*.*"):
            archive.write(file, file.relative_to(folder))
    scenario: Any = ({"rod.finite": True}, TORQUE, 1e-3, 1000)
    assert rows(Unit(again), *scenario) == rows(Unit(fmu), *scenario)
