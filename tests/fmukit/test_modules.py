"""A model of several files: a folder with model.py, or any file and those beside it that it imports."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from fmukit.fmu.load import ModelError, load
from fmukit.fmu.make import make_all
from tests.fmukit.test_strangers import compare_with_equations, run
from tests.hosts.host import Equations, Unit

DECLARATIONS = """
from enum import IntEnum
from fmukit import discrete, real, record
from fmukit.si import Angle, AngularVelocity, Length
class Arm(IntEnum):
    "Arm"
    short = 1
    long = 2
@record
class Parameters:
    l: Length = real(0.5, "Length", positive=True)
    arm: Arm = discrete(Arm.long, "Arm")
@record
class State:
    phi: Angle = real(3.0, "Angle")
    w: AngularVelocity = real(0.0, "Speed")
"""
GEOMETRY = """
import math
from .declarations import Arm
def length(p):
    return p.l if p.arm == Arm.long else p.l / 2
def pull(p, phi):
    if phi > 2.5:
        return -math.sin(phi) / length(p)
    return -math.exp(-phi) * math.sin(phi) * math.cos(phi) / length(p)
"""
MODEL = '''"""Swing"""
from fmukit import Experiment
from . import geometry
from .declarations import Parameters, State
from .geometry import pull
EXPERIMENT = Experiment(stop=2.0, step=0.01)
def derivatives(p, t, x, u):
    return State(phi=x.w, w=9.81 * pull(p, x.phi) + 0.0 * geometry.length(p))
'''
FILES = {"declarations.py": DECLARATIONS, "geometry.py": GEOMETRY}


def write_model(folder: Path, name: str = "model.py", **changes: str) -> Path:
    """The file of the model in this folder, with the files beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: MODEL, **FILES}
    for file, text in files.items():
        content = changes.get(file.removesuffix(".py"), text)
        (folder / file).write_text(content, encoding="utf-8")
    return folder / name


@pytest.mark.parametrize("name", ["model.py", "swing.py"])
def test_a_model_of_several_files_computes_as_its_equations(name: str, tmp_path: Path) -> None:
    path = write_model(tmp_path / "swing", name)
    assert not make_all([path], "both", tmp_path)
    assert np.ptp(compare_with_equations(path, tmp_path)[:, 1]) > 1.0


def test_a_model_that_is_not_traced_carries_its_files(tmp_path: Path) -> None:
    path = write_model(tmp_path / "swing", model=MODEL + 'PYTHON_ONLY = "a test"\n')
    assert not make_all([path], "python", tmp_path)
    fmu = tmp_path / "Swing.fmu"
    names = {Path(name).name for name in zipfile.ZipFile(fmu).namelist()}
    assert names >= {"model.py", *FILES}
    model = load(path)
    assert np.array_equal(run(Unit(fmu), model), run(Equations(model), model))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"geometry": GEOMETRY.replace("import math", "import numpy")},
         "geometry.py:2: numpy cannot go into the FMU: a model uses only the standard library"),
        ({"model": MODEL.replace(".geometry", ".geometries")},
         "model.py:5: .geometries cannot go into the FMU: "),
        ({"model": MODEL.replace("from .geometry", "from ..geometry")},
         "model.py:5: ..geometry cannot go into the FMU: "),
        ({"geometry": GEOMETRY.replace("    if phi", "    assert phi < 9.0\n    if phi")},
         "geometry.py:7: assert cannot go into the FMU: "),
        ({"geometry": GEOMETRY.replace("math.exp(-phi)", "math.hypot(phi)")},
         "geometry.py:9: in pull: hypot of math, which C computes differently"),
        ({"declarations": DECLARATIONS.replace("Length\n", "Furlong\n", 1)},
         "declarations.py:4: fmukit.si has no Furlong"),
        ({"geometry": GEOMETRY.replace("length(p):", "length(p)")},
         "geometry.py:4: expected ':'"),
    ],
)  # fmt: skip
def test_a_refusal_names_the_line_of_its_file(
    changes: dict[str, str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_model(tmp_path / "swing", **changes)
    assert len(make_all([path], "python", tmp_path)) == 1
    assert f"{path.parent}/{message}" in capsys.readouterr().err
    with pytest.raises(ModelError, match="there is no file"):
        load(path.with_name("nothing.py"))
