"""The FMUs: valid, the same from the same source, drop-in, and equal to their equations."""

import ast
import importlib
import json
import math
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from fmpy.model_description import ModelDescription, read_model_description
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from components import MACHINES
from fmukit.declare.interface import Interface, Variable, class_name
from fmukit.declare.model import complete_model
from fmukit.declare.record import start
from fmukit.fmu.validate import problems
from tests.conftest import ROOT, described, rewritten
from tests.hosts import fmus as hosts

MODELS = [complete_model(importlib.import_module(f"components.{name}.model")) for name in MACHINES]
MOTOR, CONVEYOR = "DriveMotor.fmu", "CrankConveyor.fmu"
NATIVE = [model for model in MODELS if not model.PYTHON_ONLY]
PATHS = {f"{class_name(model)}.fmu": model for model in MODELS}
PATHS |= {f"native/{class_name(model)}.fmu": model for model in NATIVE}
each_model = pytest.mark.parametrize("model", MODELS, ids=class_name)
each_fmu = pytest.mark.parametrize("path", PATHS)
# What only the wrapper and the runtime decide, which all share, is tried on two machines.
SAMPLE = ("CrankConveyor.fmu", "GravityOrientator.fmu")
sampled = pytest.mark.parametrize(
    "path",
    [p if p.endswith(SAMPLE) else pytest.param(p, marks=pytest.mark.slow) for p in PATHS],
)


@pytest.fixture
def fmu(path: str, fmus: Path) -> Path:
    return fmus / path


@pytest.fixture
def model(path: str) -> Any:
    return PATHS[path]


def path_of(model: Any, fmus: Path) -> Path:
    return fmus / f"{class_name(model)}.fmu"


def content(fmu: Path, name: str) -> str:
    """A file inside an FMU."""
    with zipfile.ZipFile(fmu) as archive:
        return archive.read(name).decode()


def xml(fmu: Path) -> Element:
    return ElementTree.fromstring(content(fmu, "modelDescription.xml"))


def declared_in(model: Any, fmu: Path) -> list[Variable]:
    """The variables, of a native FMU with the derivatives of its continuous states."""
    interface = Interface(model)
    return interface.variables + (interface.rates if fmu.parent.name == "native" else [])


def variables(model: Any, fmu: Path) -> list[tuple[Variable, Element, Element]]:
    """Each variable as declared, its ScalarVariable and the element of its type."""
    elements = xml(fmu).findall("ModelVariables/ScalarVariable")
    return [(v, e, e[0]) for v, e in zip(declared_in(model, fmu), elements, strict=True)]


def build(tree: Path, *options: Any, code: int = 0) -> str:
    """What build_fmus.py says in this tree."""
    command = [sys.executable, "build_fmus.py", *map(str, options)]
    done = subprocess.run(command, cwd=tree, check=False, capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of all that builds FMUs, to be changed."""
    for name in ("components", "fmukit"):
        shutil.copytree(ROOT / name, tmp_path / "tree" / name)
    for name in ("build_fmus.py", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path / "tree")
    (tmp_path / "tree" / "docs").mkdir()
    return tmp_path / "tree"


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


LIBRARIES = ("so", "dll", "dylib")
DOCUMENTS = ("index.html", "externalDependencies.txt", "licenses/license.txt")
DISPLAY_FACTORS = {
    ("rad", "deg"): 180 / math.pi,
    ("rad/s", "rpm"): 30 / math.pi,
    ("Pa", "bar"): 1e-5,
}


def flaws(fmu: Path) -> Iterator[str]:
    """What breaks rules of FMI 2.0 that no public checker covers, and that the kit keeps whatever the model."""
    description: ModelDescription = read_model_description(str(fmu))
    with zipfile.ZipFile(fmu) as archive:
        names = set(archive.namelist())
    identifier = description.coSimulation.modelIdentifier
    binaries = {name.rpartition("/")[0] for name in names if name.startswith("binaries/")}
    for folder in sorted(binaries) or ["binaries"]:
        if not names & {f"{folder}/{identifier}.{end}" for end in LIBRARIES}:
            yield f"{folder} has no library {identifier}"
    wanted = [f"documentation/{name}" for name in DOCUMENTS]
    yield from (f"{name} is missing" for name in wanted if name not in names)
    slave = description.coSimulation
    if slave.canSerializeFMUstate and not slave.canGetAndSetFMUstate:
        yield "canSerializeFMUstate needs canGetAndSetFMUstate"
    experiment = description.defaultExperiment
    if experiment is None or None in (
        experiment.startTime,
        experiment.stopTime,
        experiment.stepSize,
    ):
        yield "DefaultExperiment lacks startTime, stopTime or stepSize"
    for unit in description.unitDefinitions:
        for display in unit.displayUnits:
            factor = DISPLAY_FACTORS.get((unit.name, display.name))
            if factor != display.factor:
                yield f"display unit {display.name} of {unit.name} has factor {display.factor}"
    for unknown in [*description.outputs, *description.initialUnknowns]:
        order = [description.modelVariables.index(v) for v in unknown.dependencies or ()]
        if order != sorted(set(order)):
            yield f"dependencies of {unknown.variable.name} are not in order"
        if unknown.variable in (unknown.dependencies or ()):
            yield f"{unknown.variable.name} depends on itself"


@each_fmu
def test_fmu_is_valid(model: Any, fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    assert problems(fmu) == []
    assert [*flaws(fmu)] == []


@pytest.mark.parametrize(
    ("fmu", "old", "new", "problem"),
    [
        (MOTOR, 'start="199.8"', 'start="-1.0"', "start -1.0 of B is outside 0.0 .. inf"),
        (MOTOR, 'start="40.0"', 'start="40.0" max="9.0"', "start 40.0 of w is outside -inf .. 9.0"),
        (MOTOR, 'min="0.0" start="190.0"', 'min="9.0" max="1.0" start="5.0"', "min 9.0 of kloss"),
        (MOTOR, 'unit="W"', 'unit="W" min="9.0" max="1.0"', "min 9.0 of P is above max 1.0"),
        (MOTOR, 'start="8000.0"', 'start="INF"', "start of A is not finite"),
        (MOTOR, 'nominal="100.0"', 'nominal="0.0"', "nominal of tau is 0"),
        (
            MOTOR,
            'modelIdentifier="DriveMotor"',
            'modelIdentifier="2Drive"',
            "modelIdentifier 2Drive is not a C identifier",
        ),
    ],
)
def test_our_checks_find_what_no_public_checker_reports(
    fmu: str, old: str, new: str, problem: str, fmus: Path, tmp_path: Path
) -> None:
    spoilt = rewritten(fmus / fmu, tmp_path / fmu, described((old, new)))
    assert validate_fmu(str(spoilt)) == []
    assert any(problem in actual for actual in problems(spoilt))


@each_fmu
def test_every_variable_is_in_the_fmu_as_declared(model: Any, fmu: Path) -> None:
    """With its bounds and its unit, angles shown in deg and rpm."""
    units = {u.get("name"): u[0].attrib for u in xml(fmu).findall("UnitDefinitions/Unit")}
    for variable, scalar, typed in variables(model, fmu):
        declared = variable.declaration
        text = (scalar.get("name"), scalar.get("description"), typed.tag)
        assert text == (variable.name, declared.meaning, declared.fmi_type)
        settable = variable.settable_before_start
        assert ("start" in typed.attrib) == settable
        if typed.tag == "Real":
            for number in (
                ("min", "max", "nominal", "start") if settable else ("min", "max", "nominal")
            ):
                text = typed.get(number)
                assert (text and float(text)) == getattr(declared, number)
            unit = typed.attrib["unit"]
            exponents = {name: int(power) for name, power in units[unit].items()}
            assert exponents == declared.quantity.exponents
            assert typed.get("displayUnit") == {"rad": "deg", "rad/s": "rpm"}.get(unit)
        elif settable:
            assert typed.attrib["start"] == json.dumps(declared.start)


def test_an_unknown_component_is_named_and_ends_with_code_2() -> None:
    message = build(ROOT, "drive_mottor", code=2)
    assert "unknown component 'drive_mottor'; there are DC_motor, crank_conveyor" in message


def test_an_invalid_fmu_is_removed_and_ends_with_code_1(tree: Path) -> None:
    change(
        tree / "fmukit" / "fmu" / "description" / "fmi2.py",
        "attributes[name] = repr(float(bound))",
        'attributes[name] = repr(float(bound)) if variable.name != "phi" else "0"',
    )
    message = build(tree, "crank_conveyor", "drive_motor", "--flavour", "python", code=1)
    assert "CrankConveyor.fmu is not valid and was not kept:\n  " in message
    assert [file.name for file in (tree / "fmus").glob("*.fmu")] == [MOTOR]
    assert [file.name for file in (tree / "fmus" / ".sources").iterdir()] == [f"{MOTOR}.txt"]


def test_what_the_compiler_refuses_is_reported_and_removed(tree: Path) -> None:
    runtime = tree / "fmukit" / "fmu" / "native" / "fmi2_context.c"
    change(runtime, "static void fail(", "static wrong fail(")
    message = build(tree, "drive_motor", "--flavour", "native", code=1)
    assert "native/DriveMotor.fmu cannot be built: DriveMotor does not compile for" in message
    assert not list(tree.rglob("*.fmu"))


def test_a_component_without_native_flavour_is_named_with_the_reason() -> None:
    message = build(ROOT, "linear_system", "--flavour", "native", code=1)
    assert "linear_system has no native flavour: its matrix exp" in message
    assert "linear_system" in MACHINES


def test_two_versions_in_the_same_process_compute_different_numbers(fmus: Path, tree: Path) -> None:
    change(tree / "components" / "drive_motor" / "model.py", "real(8000.0,", "real(8199.8,")
    build(tree, "drive_motor")
    old, new = fmus / MOTOR, tree / "fmus" / MOTOR
    assert xml(old).get("guid") != xml(new).get("guid")
    lag = math.exp(-1.0 / 0.0625)
    expected = [8.0, 207.8 + (8.0 - 207.8) * lag]
    assert hosts.versions([old, new]) == pytest.approx(expected, rel=1e-12)


def test_the_pages_of_the_machines_are_up_to_date(tree: Path, fmus: Path) -> None:
    shutil.copytree(fmus, tree / "fmus")
    shutil.copy(ROOT / "pyproject.toml", tree)
    assert " built " not in build(tree, "--docs")
    written_page, stored_page = (
        {file.name: file.read_text() for file in (folder / "docs" / "machines").iterdir()}
        for folder in (tree, ROOT)
    )
    assert set(written_page) == {f"{name}.{end}" for name in MACHINES for end in ("md", "svg")}
    assert written_page == stored_page
    written_papers, stored_papers = ((x / "docs" / "papers.md").read_text() for x in (tree, ROOT))
    assert written_papers == stored_papers


@each_model
def test_the_fmu_needs_only_the_standard_library(model: Any, fmus: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(path_of(model, fmus)) as archive:
        archive.extractall(tmp_path)
    for source in (tmp_path / "resources").rglob("*.py"):
        ast.parse(source.read_text(), feature_version=(3, 10))
    bare = ROOT / "tests" / "hosts" / "bare.py"
    done = subprocess.run(
        [sys.executable, "-I", "-S", bare, tmp_path / "resources"],
        check=True,
        capture_output=True,
        text=True,
    )
    numbers = [float(number) for number in done.stdout.split()]
    assert len(numbers) == 10 * sum(
        v.declaration.fmi_type == "Real" for v in Interface(model).variables
    )
    assert all(map(math.isfinite, numbers))


def reference_file(fmu: Path, end: str) -> tuple[list[str], Any]:
    """Heading and columns of a file of reference results."""
    with zipfile.ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(end)]
        header, *lines = archive.read(name).decode().splitlines()
    return header.split(","), np.array([line.split(",") for line in lines], float).T


CONTINUOUS = [model for model in MODELS if not model.event_indicators]


@pytest.mark.parametrize("model", CONTINUOUS, ids=class_name)
def test_the_shipped_errors_are_no_smaller_than_the_true_ones(model: Any, fmus: Path) -> None:
    """The truth is SciPy's, at two tolerances whose difference is its own error."""
    names, (time, *results) = reference_file(path_of(model, fmus), "_ref.csv")
    _, (_, *errors) = reference_file(path_of(model, fmus), "_ref_error.csv")
    p, x, u = (start(cls) for cls in (model.Parameters, model.State, model.Inputs))

    def slopes(t: float, y: Any) -> Any:
        return model.derivatives(p, t, model.State(*y), u)

    def solution(tolerance: float) -> Any:
        options = {"rtol": tolerance, "atol": 1e-3 * tolerance, "max_step": model.EXPERIMENT.step}
        y = solve_ivp(slopes, (0.0, time[-1]), list(x), "DOP853", time, **options).y
        states = [model.State(*row) for row in y.T]
        outputs = [model.outputs(p, t, state, u) for t, state in zip(time, states)]
        return np.column_stack([np.array(states), np.array(outputs, float)]).T

    loose, tight = solution(1e-11), solution(1e-13)
    doubts = np.abs(tight - loose)
    for name, result, error, truth, doubt in zip(
        names[1:], results, errors, tight, doubts, strict=True
    ):
        difference = np.abs(result - truth)
        allowed = error + doubt.max() + 1e-12 * np.abs(truth).max()
        assert (difference <= allowed).all(), (name, difference.max(), error.max(), doubt.max())


@sampled
def test_many_lives_leave_less_than_4_kB_each_and_no_path(model: Any, fmu: Path) -> None:
    leak, paths = hosts.lives(fmu)
    assert leak < 4096
    assert paths == 0
