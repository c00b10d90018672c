"""The ranges of the dependencies are true at both ends: .venv/bin/uv run pytest -m slow tests/test_dependencies.py

The quick tests pass in an environment with the lowest versions that the ranges allow, and with the newest.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("dependencies")]
UV = [sys.executable, "-m", "uv"]
#: extras with code that runs in the quick tests; `site` makes the website of a clone only
EXTRAS = ("cluster", "container", "native", "notebook", "page", "parquet", "studies")
#: what the tests themselves need, in the versions of today
TOOLS = ("hypothesis", "pint", "pytest", "pytest-randomly", "pytest-xdist", "sympy")
#: a cell that a kernel of the extra `notebook` must be able to run
CELL = """\
from jupyter_client.manager import run_kernel
with run_kernel(kernel_name="python3") as client:
    reply = client.execute("import cosim, scenarios; cosim.__version__", reply=True, timeout=120)
    assert reply["content"]["status"] == "ok", reply["content"]
"""


def environment(end: str, folder: Path) -> Path:
    """The Python of an environment with the versions at one end of the ranges."""
    chosen = folder / "requirements.txt"
    extras = [f"--extra={name}" for name in EXTRAS]
    compiled = [*UV, "pip", "compile", "-q", "--no-config", "--no-header", "--no-annotate"]
    source = str(ROOT / "pyproject.toml")
    subprocess.run([*compiled, "--resolution", end, *extras, "-o", str(chosen), source], check=True)
    home = folder / "env"
    subprocess.run([*UV, "venv", "-q", "-p", sys.executable, str(home)], check=True)
    python = home / "bin" / "python"
    install = [*UV, "pip", "install", "-q", "--no-config", "-p", str(python)]
    subprocess.run([*install, "-r", str(chosen), *TOOLS], check=True)
    return python


@pytest.mark.parametrize("end", ["lowest-direct", "highest"])
def test_the_quick_tests_pass_at_an_end_of_the_ranges(end: str, tmp_path: Path) -> None:
    """In a copy, since FMUs are made again where their pages come from other versions."""
    python = environment(end, tmp_path)
    tree = tmp_path / "tree"
    # .git stays, because tests ask for the history
    left = shutil.ignore_patterns(".[!g]*", "results", "dist", "__pycache__")
    shutil.copytree(ROOT, tree, ignore=left)
    clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTEST")}
    for arguments in (["-m", "pytest", "-q", "-n0", "-m", "quick"], ["-c", CELL]):
        done = subprocess.run(
            [str(python), *arguments],
            cwd=tree, env=clean | {"PYTHONPATH": str(tree)}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-5000:]
