"""The FMUs: valid, the same from the same source, drop-in, and equal to their equations."""

import ast
import importlib
import itertools
import json
import math
import random
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import html
from scipy.integrate import solve_ivp

from build_fmus import buildable
from components import MACHINES
from fmukit import VERSION
from fmukit.declare.interface import Interface, Variable, class_name
from fmukit.declare.model import complete_model
from fmukit.declare.record import Declaration, declarations, fill, start
from fmukit.fmu import plot
from fmukit.fmu.native import package as compiled
from fmukit.fmu.python import package as python
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


@each_fmu
def test_fmu_is_valid(model: Any, fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    assert problems(fmu) == []


@pytest.mark.parametrize(
    ("fmu", "old", "new", "problem"),
    [
        (MOTOR, 'start="199.8"', 'start="-1.0"', "start -1.0 of B is outside 0.0 .. inf"),
        (MOTOR, 'start="40.0"', 'start="40.0" max="9.0"', "start 40.0 of w is outside -inf .. 9.0"),
        (MOTOR, 'min="0.0" start="190.0"', 'min="9.0" max="1.0" start="5.0"', "min 9.0 of kloss"),
        (MOTOR, 'unit="W"', 'unit="W" min="9.0" max="1.0"', "min 9.0 of P is above max 1.0"),
        (MOTOR, 'start="8000.0"', 'start="INF"', "start of A is not finite"),
        (MOTOR, 'nominal="100.0"', 'nominal="0.0"', "nominal of tau is 0"),
        (MOTOR, 'factor="9.54929', 'factor="9.55', "display unit rpm of rad/s has factor 9.55"),
        (CONVEYOR, 'x="13" dependencies="', 'x="13" dependencies="9 8 ', "x are not in order"),
        (CONVEYOR, 'x="13" dependencies="', 'x="13" dependencies="13 ', "x depends on itself"),
        (MOTOR, 'canGetAndSetFMUstate="true" ', "", "canSerializeFMUstate needs canGetAndSet"),
        (MOTOR, ' stepSize="0.001"', "", "DefaultExperiment lacks"),
        (MOTOR, r"<DefaultExperiment[^>]*>", "", "DefaultExperiment lacks"),
        (
            MOTOR,
            'modelIdentifier="DriveMotor"',
            'modelIdentifier="Drive"',
            "linux64 has no library Drive",
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
    """With its bounds and its unit, angles shown in deg and rpm; the GUID is the hash of the source."""
    root, maker = xml(fmu), compiled if fmu.parent.name == "native" else python
    assert (root.get("guid"), root.get("version")) == (maker.hashed_build(model).guid, VERSION)
    units = {u.get("name"): u[0].attrib for u in root.findall("UnitDefinitions/Unit")}
    for variable, scalar, typed in variables(model, fmu):
        declared = variable.declaration
        assert scalar.get("name") == variable.name
        assert scalar.get("description") == declared.meaning
        assert typed.tag == declared.fmi_type
        assert ("start" in typed.attrib) == variable.settable_before_start
        if typed.tag == "Real":
            for number in ("min", "max", "nominal", *["start"] * ("start" in typed.attrib)):
                text = typed.get(number)
                assert (text and float(text)) == getattr(declared, number)
            unit = typed.attrib["unit"]
            exponents = {name: int(power) for name, power in units[unit].items()}
            assert exponents == declared.quantity.exponents
            assert typed.get("displayUnit") == {"rad": "deg", "rad/s": "rpm"}.get(unit)
        elif variable.settable_before_start:
            assert typed.attrib["start"] == json.dumps(declared.start)


@each_fmu
def test_model_structure_is_complete_and_in_order(model: Any, fmu: Path) -> None:
    rows = [(v, scalar) for v, scalar, _ in variables(model, fmu) if v.causality == "output"]
    names = [v.name for v in declared_in(model, fmu)]
    outputs, initial, derivatives = (
        {
            names[int(u.attrib["index"]) - 1]: [
                names[int(i) - 1] for i in u.attrib["dependencies"].split()
            ]
            for u in xml(fmu).findall(f"ModelStructure/{part}/Unknown")
        }
        for part in ("Outputs", "InitialUnknowns", "Derivatives")
    )
    states = [name for name, d in declarations(model.State) if not d.follows]
    integrated = [n for n, d in declarations(model.State) if d.fmi_type == "Real" and not d.held]
    inputs = [name for name, _ in declarations(model.Inputs)]
    native = fmu.parent.name == "native"
    assert list(outputs) == [v.name for v, _ in rows]
    assert list(derivatives) == [f"der({n})" for n in integrated if native]
    assert all(causes == inputs + integrated for causes in derivatives.values())
    assert list(initial) == [name for name in (*outputs, *derivatives) if name not in states]
    links = xml(fmu).findall("ModelVariables/ScalarVariable/Real[@derivative]")
    assert [names[int(e.attrib["derivative"]) - 1] for e in links] == integrated * native
    for variable, scalar in rows:
        exact = variable.name in states
        assert scalar.get("initial") == ("exact" if exact else "calculated")
        feedthrough = variable.declaration.feedthrough
        is_state = variable.name in dict(declarations(model.State))
        acting = [] if is_state or not native else integrated
        assert outputs[variable.name] == [*feedthrough, *acting]
        if not exact:
            assert {*states, *feedthrough} <= {*initial[variable.name]}


def draw(rng: random.Random, declared: Declaration) -> Any:
    """A value near the start of a Real, or any of the others."""
    if declared.fmi_type == "Real":
        return declared.start + rng.uniform(0.1, 1.5)
    return rng.choice(list(declared.items or (False, True)))


@each_model
def test_outputs_feel_at_once_the_inputs_that_they_declare_and_no_other(model: Any) -> None:
    kinds = {name: d for name, d in declarations(model.Parameters) if d.fmi_type != "Real"}
    choices = [list(d.items or (False, True)) for d in kinds.values()]
    matrices = {name: d for name, d in declarations(model.Parameters) if name.endswith("]")}
    names = [name for name, _ in declarations(model.Outputs)]
    felt, rng = set(), random.Random(1)
    for choice in 20 * list(itertools.product(*choices)):
        entries = {name: draw(rng, d) for name, d in matrices.items()}
        p = start(model.Parameters, **dict(zip(kinds, choice)), **entries)
        x = fill(model.State, [draw(rng, d) for _, d in declarations(model.State)])
        u = fill(model.Inputs, [draw(rng, d) for _, d in declarations(model.Inputs)])
        try:
            before = model.outputs(p, 0.0, x, u)
        except ValueError:  # a mechanism has no such position
            continue
        for i, (name, declared) in enumerate(declarations(model.Inputs)):
            changed = fill(model.Inputs, [*u[:i], draw(rng, declared), *u[i + 1 :]])
            after = model.outputs(p, 0.0, x, changed)
            felt |= {(out, name) for out, a, b in zip(names, before, after) if a != b}
    promised = {(out, name) for out, d in declarations(model.Outputs) for name in d.feedthrough}
    assert felt == promised


@pytest.mark.slow
def test_another_build_is_the_same_to_the_byte(fmus: Path, tmp_path: Path) -> None:
    """Native ones of this machine, twice: in `fmus` there may be one for all platforms."""
    machines = ("crank_conveyor", "gravity_orientator", "linear_system")
    for folder in ("one", "other"):
        build(ROOT, "drive_motor", "--flavour", "native", "--into", tmp_path / folder)
    build(ROOT, *machines, "--flavour", "python", "--into", tmp_path / "one")
    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*.fmu")]
    assert len(files) == 4
    for file in files:
        same = tmp_path / "other" / file if "native" in file.parts else fmus / file
        assert (tmp_path / "one" / file).read_bytes() == same.read_bytes()


@pytest.mark.slow
def test_a_build_skips_what_is_up_to_date_and_makes_what_is_not(tree: Path) -> None:
    drive_motor = "DriveMotor.fmu, native/DriveMotor.fmu, wasm/DriveMotor.wasm"
    assert f"{drive_motor} built and valid\n" in build(tree, "drive_motor")
    assert f"{drive_motor} up to date\n" in build(tree, "DriveMotor")
    assert "wasm/DCMotor.wasm built and valid" in build(tree, "DCMotor")
    assert f"{drive_motor} built and valid\n" in build(tree, "drive_motor", "--force")
    (tree / "fmus" / MOTOR).write_bytes((tree / "fmus" / MOTOR).read_bytes()[:-100])
    assert "\nDriveMotor.fmu built and valid\n" in build(tree, "drive_motor")


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


@pytest.mark.parametrize("flavour", ["native", "wasm", "fmi3"])
def test_all_components_are_those_that_have_the_flavour(flavour: str) -> None:
    """So that the build of all ends well, and a name that was given does not."""
    assert set(MACHINES) - set(buildable(flavour)) == {"linear_system"}
    assert set(buildable("all")) == set(buildable("python")) == set(MACHINES)


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


def test_the_picture_of_the_default_experiment_has_its_labels_and_larger_values_further_up() -> (
    None
):
    interface = Interface(importlib.import_module("components.drive_motor.model"))
    rows = [[0.0, 1.0, -2.0, 5.0], [0.5, 4.0, -2.0, 7.0], [1.0, 2.0, -2.0, 6.0]]
    picture = ElementTree.fromstring(plot.svg(interface, rows))
    svg = "{http://www.w3.org/2000/svg}"
    dots = [line.get("points", "").split() for line in picture.iter(f"{svg}polyline")]
    assert [[line[0], line[-1]] for line in dots] == [
        ["60,96", "250,76"], ["310,66", "500,66"], ["560,96", "750,66"],
    ]  # fmt: skip
    heights = {text.text: float(text.get("y", "")) for text in picture.iter(f"{svg}text")}
    assert [name for name in heights if "[" in str(name)] == [
        "tau [N.m]",
        "tau_static [N.m]",
        "P [W]",
    ]
    assert heights["4"] < heights["1"] and heights["7"] < heights["5"]
    assert "time from 0 to 1 s" in heights


@each_fmu
def test_the_page_in_the_fmu_needs_no_network_and_is_complete(model: Any, fmu: Path) -> None:
    page = content(fmu, "documentation/index.html")
    formulas = re.findall(r"<math.*?</math>", page, re.DOTALL)
    assert formulas
    for formula in formulas:
        ElementTree.fromstring(formula)
    assert not re.search(r"\b(src|href|data)=|url\(|@import|\$|FORMULA", page)
    rows = [[*row.itertext()] for row in html.fromstring(page).findall(".//table")[-1].iter("tr")]
    declared = Interface(model).variables
    assert [row[1] for row in rows[1:]] == [v.name for v in declared]
    for variable, row in zip(declared, rows[1:]):
        for item in variable.declaration.items or ():
            assert f"{item.value} = {item.name}" in row[-2]


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


def shipped(fmu: Path, end: str) -> tuple[list[str], Any]:
    """Heading and columns of a file of reference results."""
    with zipfile.ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(end)]
        header, *lines = archive.read(name).decode().splitlines()
    return header.split(","), np.array([line.split(",") for line in lines], float).T


@each_fmu
def test_the_shipped_reference_is_that_of_the_default_experiment(model: Any, fmu: Path) -> None:
    """Its end is that of another run; each Real has an error, below the 1e-6 that the tolerance of the kit is
    made for; and the manifest names both files.
    """
    (names, results), (heading, errors) = shipped(fmu, "_ref.csv"), shipped(fmu, "_ref_error.csv")
    assert (heading, errors[0].tolist()) == (names, results[0].tolist())
    assert len(results[0]) - 1 == round(model.EXPERIMENT.stop / model.EXPERIMENT.step)
    end = dict(zip(names, results[:, -1]))
    assert hosts.default_experiment(fmu) == pytest.approx(end, rel=1e-8, abs=1e-9)
    by_name = Interface(model).by_name
    assert {*names[1:]} == {n for n, v in by_name.items() if v.causality == "output"}
    for name, result, error in zip(names[1:], results[1:], errors[1:]):
        assert (error >= 0.0).all(), name
        if by_name[name].access_type == "Real" and result.any():
            assert error.min() > 0.0, name
        assert error.max() <= 1e-6 * (np.ptp(result) or np.abs(result).max() or 1.0), name
    folder = "extra/org.fmi-standard.fmi-ls-ref"
    with zipfile.ZipFile(fmu) as archive:
        root = ElementTree.fromstring(archive.read(f"{folder}/fmi-ls-manifest.xml"))
        assert root.get("{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-name") == folder[6:]
        roles = [(related.get("role"), related.get("source")) for related in root]
        assert [role for role, _ in roles] == ["result", "report"]
        assert {f"{folder}/{source}" for _, source in roles} <= {*archive.namelist()}


CONTINUOUS = [model for model in MODELS if not model.event_indicators]


@pytest.mark.parametrize("model", CONTINUOUS, ids=class_name)
def test_the_shipped_errors_are_no_smaller_than_the_true_ones(model: Any, fmus: Path) -> None:
    """The truth is SciPy's, at two tolerances whose difference is its own error."""
    names, (time, *results) = shipped(path_of(model, fmus), "_ref.csv")
    _, (_, *errors) = shipped(path_of(model, fmus), "_ref_error.csv")
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


def test_sixty_instances_live_side_by_side(both: Path) -> None:
    speeds = [30.0 + 0.25 * n for n in range(60)]
    lag = math.exp(-0.010 / 0.0625)
    for w, (tau, static, power) in zip(speeds, hosts.crowd(both / MOTOR, "w", speeds)):
        final = 8000.0 - 199.8 * w
        expected = final + (8.0 - final) * lag
        assert [tau, static, power] == pytest.approx([expected, final, expected * w], rel=1e-11)
