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
import tempfile
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from components import MACHINES
from fmukit.declare.interface import Interface, class_name
from fmukit.declare.model import complete_model
from fmukit.fmu import make
from fmukit.fmu.native import package
from fmukit.fmu.reference import by_equations
from fmukit.trace import tracer as trace
from fmukit.trace.context import TraceContext, active
from fmukit.trace.graph import Join, Node, Operation
from tests.conftest import ROOT
from tests.hosts.host import MESSAGES, Unit

HOSTS = ROOT / "tests" / "hosts"
HEADERS = Path(fmpy.__file__).with_name("c-code")
MODELS = {
    class_name(model): complete_model(model)
    for model in (importlib.import_module(f"components.{name}.model") for name in MACHINES)
}
NAMES = [name for name, model in MODELS.items() if not model.PYTHON_ONLY]
each = pytest.mark.parametrize("name", NAMES)


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
SCENARIOS = [
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
]  # fmt: skip


@each
def test_an_fmu_carries_its_module_for_webassembly(name: str, fmus: Path) -> None:
    module = (fmus / "wasm" / f"{name}.wasm").read_bytes()
    with zipfile.ZipFile(fmus / "native" / f"{name}.fmu") as archive:
        assert archive.read(f"{package.WASM_FOLDER}/{name}.wasm") == module
        guid = ElementTree.fromstring(archive.read("modelDescription.xml")).get("guid")
    assert module[:4] == b"\0asm"
    assert guid is not None and guid.encode() in module


def test_a_module_is_built_again_to_the_same_bytes_and_only_when_it_is_out_of_date(
    tmp_path: Path, fmus: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = ROOT / "components" / "drive_motor" / "model.py"
    for built in ("built", "up to date"):
        assert make.make_all([file], "wasm", tmp_path) == 0
        assert built in capsys.readouterr().out
    module = tmp_path / "wasm" / "DriveMotor.wasm"
    assert module.read_bytes() == (fmus / "wasm" / module.name).read_bytes()
    assert [path.name for path in tmp_path.rglob("*.*")] == [module.name]


def test_builds_that_end_immediately_keep_a_complete_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = b"x" * 200_000
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "work"))
    (tmp_path / "work").mkdir()
    unit = package.collect(MODELS["DriveMotor"])
    path = tmp_path / "wasm" / "DriveMotor.wasm"

    def keep(_: int) -> int:
        make.make_file(path, unit, lambda _, file: file.write_bytes(content), force=True)
        return len(path.read_bytes())

    with ThreadPoolExecutor(4) as pool:
        assert {*pool.map(keep, range(400))} == {len(content)}
    assert [*path.parent.iterdir()] == [path]


def rows(fmu: Path, start: dict[str, Any], inputs: Any, h: float, steps: int) -> list[list[Any]]:
    """All outputs after every step."""
    unit = Unit(fmu).start(**start, **inputs(0.0))
    return [unit.set(**inputs(n * h)).step(n * h, h).outputs() for n in range(steps)]


def equations(name: str, start: dict[str, Any], inputs: Any, h: float, steps: int) -> Any:
    """All outputs after every step, from the functions of the component as they are written."""
    slave = by_equations(MODELS[name])(instance_name=name)
    variables_by_name = Interface(MODELS[name]).by_name

    def put(values: dict[str, Any]) -> None:
        for variable, value in values.items():
            kind = variables_by_name[variable].kind.lower()
            getattr(slave, f"set_{kind}")([variables_by_name[variable].reference], [value])

    def outputs() -> list[Any]:
        actual = [v for v in variables_by_name.values() if v.causality == "output"]
        return [getattr(slave, f"get_{v.kind.lower()}")([v.reference])[0] for v in actual]

    slave.setup_experiment(0.0, None, None)
    put(start | inputs(0.0))
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    actual = []
    for n in range(steps):
        put(inputs(n * h))
        slave.do_step(n * h, h)
        actual.append(outputs())
    return actual


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
    name, *scenario = case
    expected = equations(name, *scenario)
    assert rows(fmus / f"{name}.fmu", *scenario) == expected
    assert rows(fmus / "native" / f"{name}.fmu", *scenario) == expected
    assert all(map(math.isfinite, itertools.chain(*expected)))


def test_the_scenarios_contain_stick_reversal_impacts_flight_and_jams(fmus: Path) -> None:
    observed: dict[str, set[Any]] = {}
    for name, *scenario in SCENARIOS:
        fmu = fmus / "native" / f"{name}.fmu"
        names = [v.name for v in Unit(fmu).variables.values() if v.causality == "output"]
        for row in rows(fmu, *scenario):  # type: ignore[arg-type]
            for variable, value in zip(names, row):
                if isinstance(value, int):
                    observed.setdefault(f"{name}.{variable}", set()).add(value)
    assert observed["IronDrive.direction"] == {-1, 0, 1}
    assert observed["IronDrive.motion"] == {0, 1, 2, 3}
    assert observed["IronDrive.valid"] == {0, 1}
    assert observed["GravityOrientator.stage"] >= {0, 1, 2, 3, 4, 5}
    assert observed["GravityOrientator.contact"] == {0, 1}
    assert len(observed["GravityOrientator.reason"]) >= 4
    assert max(observed["GravityOrientator.missed"]) > 0


@each
def test_descriptions_differ_only_in_what_native_ones_can_do(name: str, fmus: Path) -> None:
    python, native = (
        ElementTree.fromstring(zipfile.ZipFile(fmu).read("modelDescription.xml"))
        for fmu in (fmus / f"{name}.fmu", fmus / "native" / f"{name}.fmu")
    )
    elements = [native.find("CoSimulation"), python.find("CoSimulation")]
    changed = {k: v for k, v in elements[0].items() if elements[1].get(k) != v}  # type: ignore[union-attr]
    assert changed == {
        "needsExecutionTool": "false",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "1",
        "canNotUseMemoryManagementFunctions": "false",
        "providesDirectionalDerivative": "true",
    }
    more = {"numberOfEventIndicators"}
    assert python.attrib.keys() == native.attrib.keys() - more
    assert {k for k in python.attrib if python.get(k) != native.get(k)} == {
        "guid",
        "generationTool",
    }
    assert python.find("ModelExchange") is None
    elements = [native.find("ModelExchange"), native.find("CoSimulation")]
    assert set(elements[0].items()) - set(elements[1].items()) == {  # type: ignore[union-attr]
        (
            "completedIntegratorStepNotNeeded",
            str(not MODELS[name].event_indicators).lower(),
        )
    }
    for part in ("UnitDefinitions", "TypeDefinitions", "ModelVariables", "InitialUnknowns"):
        ours, theirs = (
            [[(e.tag, e.attrib) for e in actual.iter()][1:] for actual in root.iter(part)]
            for root in (python, native)
        )
        for mine, more_of_them in zip(ours, theirs, strict=True):
            assert mine == more_of_them[: len(mine)]
            assert part != "TypeDefinitions" or mine == more_of_them


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


def derivative(unit: Unit, unknown: list[str], variable_name: str) -> list[float]:
    """fmi2GetDirectionalDerivative of some outputs by one variable."""
    refs = [unit.variables[n].valueReference for n in unknown]
    return list(
        unit.fmi.getDirectionalDerivative(
            refs, [unit.variables[variable_name].valueReference], [1.0]
        )
    )


def reals(unit: Unit, *causalities: str) -> list[str]:
    return [n for n, v in unit.variables.items() if v.type == "Real" and v.causality in causalities]


@each
@pytest.mark.parametrize("seed", range(3))
def test_directional_derivatives_at_the_start_match_finite_differences(
    name: str, seed: int, fmus: Path
) -> None:
    """By every Real parameter, state and input; Richardson's extrapolation of central differences."""
    rng = random.Random(seed)
    fmu = fmus / "native" / f"{name}.fmu"
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
    unit = Unit(fmu)
    unit.fmi.setupExperiment()
    unit.set(**start)
    unit.fmi.enterInitializationMode()
    outputs = reals(unit, "output")
    state = unit.fmi.getFMUstate()
    actual = 0
    for variable_name in [
        n for n in reals(unit, "parameter", "input", "output") if settable(unit, n)
    ]:
        unit.fmi.setFMUstate(state)
        exact = derivative(unit, outputs, variable_name)
        value = unit.get(variable_name)
        steps = [1e-3 * (abs(value) or 1.0), 5e-4 * (abs(value) or 1.0)]
        differences = []
        for step in steps:
            sides = []
            for sign in (1, -1):
                unit.fmi.setFMUstate(state)
                unit.set(**{variable_name: value + sign * step})
                unit.get(first_calculated(unit))
                sides.append([unit.get(n) for n in outputs])
            differences.append((np.array(sides[0]) - np.array(sides[1])) / (2 * step))
        estimate = (4 * differences[1] - differences[0]) / 3
        scale = np.maximum(np.abs(estimate), 1e-6 * np.max(np.abs(estimate)))
        error = np.abs(exact - estimate)
        assert np.all(error <= 1e-6 * np.maximum(scale, noise(unit, outputs, steps[1]))), (
            variable_name
        )
        actual += np.count_nonzero(exact)
    assert actual > len(outputs)


def settable(unit: Unit, name: str) -> bool:
    return unit.variables[name].start is not None


def first_calculated(unit: Unit) -> str:
    return next(n for n, v in unit.variables.items() if v.initial == "calculated")


def noise(unit: Unit, outputs: list[str], step: float) -> np.ndarray:
    """What rounding makes of a difference quotient, over 1e-6."""
    return np.array([1e-13 * (1.0 + abs(unit.get(n))) / step / 1e-6 for n in outputs])


@each
def test_directional_derivatives_after_a_step_are_by_inputs(name: str, fmus: Path) -> None:
    """The outputs are affine in the inputs of all but the motor and the orientator's square of w."""
    unit = Unit(fmus / "native" / f"{name}.fmu").start(
        **({"stage": 0} if name == "GravityOrientator" else {})
    )
    outputs = reals(unit, "output")
    saved = unit.fmi.getFMUstate()
    for variable_name in reals(unit, "input"):
        value, h = unit.get(variable_name), 1e-12
        sides = []
        for sign in (1, -1):
            unit.fmi.setFMUstate(saved)
            unit.set(**{variable_name: value + sign * 1e-3}).step(0.0, h)
            sides.append(np.array([unit.get(n) for n in outputs]))
        unit.fmi.setFMUstate(saved)
        exact = derivative(unit.step(0.0, h), outputs, variable_name)
        assert np.any(exact)
        assert exact == pytest.approx((sides[0] - sides[1]) / 2e-3, rel=1e-6, abs=1e-5)
    with pytest.raises(FMICallException):
        derivative(unit, outputs, reals(unit, "parameter")[0])
    assert re.search(r"there is no derivative by \S+ after initialisation", MESSAGES[-1])


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
    build = package.collect(MODELS[name])
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
    build = package.collect(MODELS["DriveMotor"])
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


WINE = next(filter(None, map(shutil.which, ("wine64", "wine", "/usr/lib/wine/wine64"))), None)
ARM = Path("/usr/aarch64-linux-gnu")
HOST_TARGET = "x86_64-linux-gnu"
EMULATORS: dict[str, list[Any]] = {
    HOST_TARGET: [],
    "x86_64-windows-gnu": [WINE],
    "aarch64-linux-gnu.2.17": [
        shutil.which("qemu-aarch64"),
        "-L",
        str(ARM) if ARM.exists() else None,
    ],
}
EMULATED = [target for target, emulator in EMULATORS.items() if emulator]


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
@only_for("CrankConveyor", "DCMotor")
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
@only_for("CrankConveyor", "GravityOrientator", "IronDrive")
def test_numbers_are_the_same_on_other_platforms(
    name: str, target: str, elsewhere: Callable[..., str], fmus: Path, tmp_path: Path
) -> None:
    """To the bit where the C library is the same one, else to what sine and power differ by."""
    folder, (guid, *_) = unpacked(fmus / "native" / f"{name}.fmu", tmp_path)
    model = MODELS[name]
    stop, h = model.EXPERIMENT
    roles = ("output", "Real")
    outputs = [v.reference for v in Interface(model).variables if (v.causality, v.kind) == roles]

    def rows(target: str) -> np.ndarray:
        library = library_in(folder, target, name)
        message = elsewhere("rows.c", target, library, guid, round(stop / h), h, *outputs)
        return np.array([line.split() for line in message.splitlines()], float)

    host_rows, target_rows = rows(HOST_TARGET), rows(target)
    assert len(host_rows) == round(stop / h) + 1
    if "linux" in target:
        assert np.array_equal(target_rows, host_rows)
    assert np.all(np.abs(target_rows - host_rows) <= 1e-11 * np.ptp(host_rows, axis=0) + 1e-300)


@only_for("CrankConveyor", "DriveMotor")
def test_valgrind_finds_nothing(name: str, fmus: Path, tmp_path: Path) -> None:
    if shutil.which("valgrind") is None or shutil.which("gcc") is None:
        pytest.skip("there is no valgrind or no gcc")
    folder, host_arguments = unpacked(fmus / "native" / f"{name}.fmu", tmp_path)
    program, library = tmp_path / "host", folder / "binaries" / "linux64" / f"{name}.so"
    compile_c(HOSTS / "every_call.c", program, "-ldl")
    valgrind = ["valgrind", "-q", "--leak-check=full", "--error-exitcode=9"]
    done = subprocess.run(
        [*valgrind, program, library, *host_arguments, "2"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


@only_for("CrankConveyor")
def test_sanitizers_find_nothing(name: str, fmus: Path, tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("there is no gcc")
    folder, host_arguments = unpacked(fmus / "native" / f"{name}.fmu", tmp_path)
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program, library = tmp_path / "host", tmp_path / f"{name}.so"
    compile_c(HOSTS / "every_call.c", program, *sanitize, "-ldl")
    compile_c(folder / "sources" / f"{name}.c", library, *sanitize, "-fPIC", "-shared", "-lm")
    done = subprocess.run(
        [program, library, *host_arguments, "5"], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


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
    assert rows(again, *scenario) == rows(fmu, *scenario)


@pytest.mark.parametrize(
    ("run", "what"),
    [
        (lambda x: [1, 2][x], "used as a key, an index or a choice"),
        (lambda x: f"{x:.3f}", "the format '.3f'"),
    ],
)
def test_what_cannot_be_expressed_in_c_is_refused(run: Any, what: str) -> None:
    with pytest.raises(TypeError, match=what), active(TraceContext()):
        trace.function("f", run, {"x": "number"})


def sort_of(node: Node) -> str:
    """The operation of a node, or its class."""
    return node.op if isinstance(node, Operation) else type(node).__name__


def test_traced_conditions_are_followed_once_for_each_answer() -> None:
    def run(x: Any) -> Any:
        if x > 1.0 and x < 2.0:
            return x + 1.0
        return -x if x > 1.0 else abs(x)

    with active(TraceContext()):
        traced = trace.function("f", run, {"x": "number"})
    assert traced is not None
    (outer,) = [node for node in traced.tree.nodes if isinstance(node, Join)]
    assert [list(map(sort_of, arm.nodes)) for arm in outer.arms] == [["Join"], ["fabs"]]


@pytest.mark.parametrize(
    "name", [pytest.param("IronDrive", marks=pytest.mark.slow), "GravityOrientator"]
)
def test_both_flavours_say_the_same_of_what_happens(name: str, fmus: Path) -> None:
    """Warnings with the values of the event, and the reason of a failure, digit by digit."""
    message = []
    for folder in (fmus, fmus / "native"):
        cases = [case for case in SCENARIOS if case[0] == name and case[3] == 1e-3][::2]
        MESSAGES.clear()
        for _, *scenario in cases:
            rows(folder / f"{name}.fmu", *scenario)  # type: ignore[arg-type]
        warnings = list(MESSAGES)
        unit = Unit(folder / f"{name}.fmu").start()
        key = "tau" if name == "IronDrive" else "w"
        unit.refusal(lambda u, key=key: u.set(**{key: 1e200}).step(0.0, 1e-3))  # type: ignore[misc]
        message.append(
            [re.sub(r"(?s).*?(unit: )", r"\1", text, count=1) for text in warnings + MESSAGES]
        )
    assert len(message[0]) > 3
    assert message[0] == message[1]
