"""What is released, installed where there is nothing else: the wheel, its commands, its size."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import cosim
import fmukit

ROOT = Path(__file__).resolve().parents[1]
MODEL = ROOT / "tests" / "fmukit" / "models" / "van_der_pol.py"
#: megabytes without bytecode and installer; docs/install.md has the table
SIZE = 550
#: megabytes of clone and home after the README's first command; the same table
FIRST_ANSWER = 600
UV = [sys.executable, "-m", "uv"]

slow = pytest.mark.slow
pytestmark = [pytest.mark.xdist_group("release")]


class Environment:
    """An environment that has only what is installed into it, and a folder to work in."""

    def __init__(self, python: str, folder: Path) -> None:
        self.home, self.folder = folder / "env", folder / "work with blanks"
        self.folder.mkdir()
        paths = Path.home().glob(".pyenv/versions/*/bin")
        search = os.pathsep.join([*map(str, paths), os.environ["PATH"]])
        make = [*UV, "venv", "-q", "-p", python, str(self.home)]
        if subprocess.run(make, env=os.environ | {"PATH": search}, check=False).returncode:
            pytest.skip(f"uv cannot get Python {python}")

    def install(self, *requirements: str) -> None:
        python = str(self.home / "bin" / "python")
        install = [*UV, "pip", "install", "-q", "-p", python, "--refresh-package=drive-fmus"]
        subprocess.run([*install, *requirements], check=True)

    def megabytes(self) -> float:
        files = [path for path in self.home.rglob("*") if path.is_file() and not path.is_symlink()]
        return sum(path.stat().st_size for path in files if path.suffix != ".pyc") / 1e6

    def run(self, *command: str, status: int = 0) -> str:
        """What a command of the environment prints; it must end with this exit status."""
        clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
        done = subprocess.run(
            [str(self.home / "bin" / command[0]), *command[1:]],
            cwd=self.folder, env=clean, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == status, f"{done.stdout}\n{done.stderr}"
        return f"{done.stdout}{done.stderr}"


def test_what_builds_the_fmus_is_named_where_the_package_is_built() -> None:
    """By the distributions that have the modules, since the package is built where nothing else is installed."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]
    required = {re.split(r"[<>=]", line)[0] for line in build["requires"]}
    sources = [*(ROOT / "fmukit").rglob("*.py"), *(ROOT / "components").rglob("*.py")]
    own = {"fmukit", "components", "scenarios", *sys.stdlib_module_names}
    distributions = packages_distributions()
    for path in [*sources, ROOT / "build_fmus.py", ROOT / "tools" / "hatch_build.py"]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [x.name for x in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                modules = [node.module or ""]
            for module in {x.partition(".")[0] for x in modules} - own:
                names = {x.lower().replace("_", "-") for x in distributions.get(module, ())}
                assert required & names, f"{path}: {module}"


@pytest.fixture(scope="module")
def dist() -> Path:
    subprocess.run([sys.executable, "-m", "tools.release"], cwd=ROOT, check=True)
    return ROOT / "dist"


@pytest.fixture(params=["3.11", "3.12", "3.13", "3.14"])
def environment(request: pytest.FixtureRequest, dist: Path, tmp_path: Path) -> Environment:
    return Environment(request.param, tmp_path)


def test_the_same_version_stands_everywhere() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f'\nversion = "{cosim.__version__}"\n' in text
    assert cosim.__version__ == fmukit.VERSION
    assert f"version: {cosim.__version__}\n" in citation


@slow
def test_the_wheel_answers_without_a_compiler(dist: Path, environment: Environment) -> None:
    (wheel,) = dist.glob("*.whl")
    environment.install(str(wheel))
    assert environment.megabytes() < SIZE
    assert "packing_line" in environment.run("scenarios", "list")
    ask = ("scenarios", "run", "resonance", "--out", "answer")
    assert "no page was written: install it with" in environment.run(*ask)
    answer = json.loads((environment.folder / "answer" / "resonance.json").read_text())
    lag = answer["figures"]["nu_90"]
    assert answer["flavour"] == "native"
    assert abs(lag["value"] - 40.00222) < 3e-4 > lag["error"]
    files = {path.name for path in (environment.folder / "answer").iterdir()}
    assert {"resonance.csv", "resonance.json", "resonance.png"} <= files
    loops = "import cosim.engine.compiler as c; print(c.SOURCE.parent)"
    folder = Path(environment.run("python", "-c", loops).strip()) / "__pycache__"
    assert not list(folder.glob("*loop*.so")), "the loop came compiled"
    assert "10 native and 10 Python FMUs" in environment.run("drive-fmus")
    refused = environment.run("python", "-c", "import components", status=1)
    assert refused.rstrip().endswith("No module named 'components'")


@slow
def test_the_wheel_builds_a_stranger_s_model(dist: Path, environment: Environment) -> None:
    (wheel,) = dist.glob("*.whl")
    environment.install(f"drive-fmus[native] @ {wheel.as_uri()}")
    environment.run("fmukit", "build", str(MODEL))
    rows = []
    for fmu in ("VanDerPol.fmu", "native/VanDerPol.fmu"):
        run = ("cosim", "run", fmu, "--stop", "1", "--step", "0.1", "--out", "run.csv")
        environment.run(*run)
        rows.append((environment.folder / "run.csv").read_bytes())
    assert rows[0] == rows[1]


@slow
def test_the_first_command_of_the_readme_answers_and_removes_the_compiler(tmp_path: Path) -> None:
    """In a copy of the sources with an empty home; a file with several names in it counts once."""
    clone, home = tmp_path / "clone", tmp_path / "home"
    shutil.copytree(ROOT, clone, ignore=shutil.ignore_patterns(".*", "fmus", "results", "dist"))
    (clone / "fmus").mkdir()
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    command = text.partition("<!-- run -->\n```sh\n")[2].partition("\n")[0]
    environment = os.environ | {"HOME": str(home)}
    done = subprocess.run(
        command, shell=True, cwd=clone, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith("Avoid 40 rad/s"), done.stderr
    files = [path.lstat() for path in tmp_path.rglob("*")]
    sizes = {(file.st_dev, file.st_ino): 512 * file.st_blocks for file in files}
    assert sum(sizes.values()) < FIRST_ANSWER * 1e6
