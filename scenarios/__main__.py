"""scenarios list | run NAME or FILE.py [options] | study FILE.toml [options]."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

from rich.console import Console

from workbench.command import main
from workbench.question import Project

HOME = Path(__file__).resolve().parent
ROOT = HOME.parent
CLONE = (ROOT / "build_fmus.py").is_file()


@cache
def build(names: tuple[str, ...], flavour: str) -> None:
    """Build the FMUs of these names, "DriveMotor", that are missing or out of date, once in a process."""
    components = [re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower() for name in names]
    command = [sys.executable, str(ROOT / "build_fmus.py"), *components, "--flavour", flavour]
    with Console(stderr=True).status("FMUs"):
        done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        from cosim import SetupError

        why = done.stderr.strip().splitlines()[-1:]
        raise SetupError(f"the FMUs could not be built: {''.join(why)}")


FMUS = (ROOT if CLONE else HOME) / "fmus"
FOLDERS = {"python": FMUS, "native": FMUS / "native", "wasm": FMUS / "wasm"}
FILL = (lambda names, flavour: build(tuple(names), flavour)) if CLONE else None
PROJECT = Project(HOME, FOLDERS, FILL)


PROGRAM = "python -m scenarios" if CLONE else "scenarios"


def run() -> int:
    """The words of the command line; its exit code."""
    return main(sys.argv[1:], PROJECT, PROGRAM)


if __name__ == "__main__":
    sys.exit(run())
