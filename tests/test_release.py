"""What is released, installed where there is nothing else: the wheels, their commands, their sizes."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODEL = ROOT / "tests" / "fmukit" / "models" / "van_der_pol.py"
MASTER, ALL = 250, 450  # megabytes
OURS = ("drive-fmus", "drive-fmus-cosim", "drive-fmus-kit")
UV = [sys.executable, "-m", "uv"]

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("release")]


class Empty:
    """An environment without our code, and a folder of its own to work in."""

    def __init__(self, python: str, folder: Path) -> None:
        self.home, self.folder = folder / "env", folder / "work"
        self.folder.mkdir()
        others = Path.home().glob(".pyenv/versions/*/bin")
        places = os.pathsep.join([*map(str, others), os.environ["PATH"]])
        make = [*UV, "venv", "-q", "-p", python, str(self.home)]
        if subprocess.run(make, env=os.environ | {"PATH": places}, check=False).returncode:
            pytest.skip(f"uv cannot get Python {python}")

    def install(self, *what: str) -> None:
        python, wheels = str(self.home / "bin" / "python"), str(ROOT / "dist")
        ours = [f"--refresh-package={name}" for name in OURS]  # another wheel of the same version
        install = [*UV, "pip", "install", "-q", "-p", python, "-f", wheels, *ours, *what]
        subprocess.run(install, check=True)

    def megabytes(self) -> float:
        files = [path for path in self.home.rglob("*") if path.is_file() and not path.is_symlink()]
        return sum(path.stat().st_size for path in files) / 1e6

    def does(self, *words: str, code: int = 0) -> str:
        """What a command of the environment prints; it must end with this exit code."""
        clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
        done = subprocess.run(
            [str(self.home / "bin" / words[0]), *words[1:]],
            cwd=self.folder, env=clean, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, f"{done.stdout}\n{done.stderr}"
        return f"{done.stdout}{done.stderr}"


@pytest.fixture(scope="module")
def dist() -> Path:
    subprocess.run([sys.executable, str(ROOT / "release.py")], check=True)
    return ROOT / "dist"


@pytest.fixture(params=["3.11", "3.12", "3.13", "3.14"])
def empty(request: pytest.FixtureRequest, dist: Path, tmp_path: Path) -> Empty:
    return Empty(request.param, tmp_path)


def test_checksums_name_every_file(dist: Path) -> None:
    lines = (dist / "SHA256SUMS").read_text().splitlines()
    for line in lines:
        told, name = line.split("  ")
        assert hashlib.sha256((dist / name).read_bytes()).hexdigest() == told
    wheels, fmus, modules = (list(dist.rglob(f"*.{kind}")) for kind in ("whl", "fmu", "wasm"))
    assert len(wheels) == 3
    assert len(lines) == len(wheels) + len(fmus) + len(modules)
    assert len(fmus) > len(modules) > 5


def test_master_runs_an_fmu_and_says_what_it_lacks(dist: Path, empty: Empty) -> None:
    empty.install("drive-fmus-cosim")
    assert empty.megabytes() < MASTER
    fmu = str(dist / "fmus" / "native" / "DriveMotor.fmu")
    run = ("cosim", "run", fmu, "--stop", "0.1", "--step", "1e-3")
    assert "tau" in empty.does(*run)
    empty.does(*run, "--out", "run.csv")
    assert (empty.folder / "run.csv").read_text().startswith("time,")
    refused = empty.does(*run, "--certify", code=2)
    assert refused == "error: --certify needs the package scipy, which is not installed\n"
    empty.does("python", "-c", "from cosim import System, run, certify, read_ssp")


def test_drives_answer_without_a_compiler(empty: Empty) -> None:
    empty.install("drive-fmus")
    assert empty.megabytes() < ALL
    assert "packing_line" in empty.does("scenarios", "list")
    ask = ("scenarios", "run", "resonance", "--flavour", "native", "--out", "answer")
    assert "no page was written: it needs the package plotly" in empty.does(*ask)
    answer = json.loads((empty.folder / "answer" / "resonance.json").read_text())
    lag = answer["figures"]["nu_90"]
    assert abs(lag["value"] - 40.00222) < 3e-4 > lag["error"]
    files = {path.name for path in (empty.folder / "answer").iterdir()}
    assert files == {"resonance.csv", "resonance.json", "resonance.png"}
    program = "import cosim.engine.program as p; p.library(); print(p.SOURCE.parent)"
    made = Path(empty.does("python", "-c", program).strip()) / "__pycache__"
    assert not list(made.glob("*loop*.so")), "the loop came compiled"
    empty.install("drive-fmus[page]")
    assert "report.html" in empty.does(*ask)


def test_kit_builds_a_stranger_s_model(empty: Empty) -> None:
    empty.install("drive-fmus-kit")
    refused = empty.does("fmukit", "build", str(MODEL), code=1)
    assert refused.endswith("pip install 'drive-fmus-kit[build]'\n")
    empty.install("drive-fmus-kit[build]", "drive-fmus-cosim")
    empty.does("fmukit", "build", str(MODEL))
    ends = []
    for fmu in ("VanDerPol.fmu", "native/VanDerPol.fmu"):
        empty.does("cosim", "run", fmu, "--stop", "1", "--step", "0.1", "--out", "run.csv")
        ends.append((empty.folder / "run.csv").read_bytes())
    assert ends[0] == ends[1]
