"""No order of calls and no value brings a native FMU down, nor its host."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.fmukit.test_native import built, compile_c, only_for, unpacked

SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.mark.parametrize("seeds", [3, pytest.param(300, marks=pytest.mark.slow)])
@pytest.mark.parametrize("version", [2, 3])
@only_for("CrankConveyor")
def test_random_calls_are_survived(
    name: str, version: int, seeds: int, fmus: Path, tmp_path: Path
) -> None:
    """Under sanitizers: no read or write beyond, no leak, no undefined operation, no hang."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no gcc")
    fmu = fmus / "native" / f"{name}.fmu" if version == 2 else built(name)
    folder, host_arguments = unpacked(fmu, tmp_path / "fmu")
    flags = ["-DFMI3"] if version == 3 else []
    host, library = tmp_path / "host", tmp_path / f"{name}.so"
    compile_c(ROOT / "tests" / "hosts" / "fuzz.c", host, *SANITIZE, *flags, "-ldl")
    compile_c(folder / "sources" / f"{name}.c", library, *SANITIZE, "-fPIC", "-shared", "-lm")
    for seed in range(1, seeds + 1):
        done = subprocess.run(
            [host, library, *host_arguments, str(seed), "5000"],
            capture_output=True, text=True, check=False, timeout=600,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, ""), f"seed {seed}"
