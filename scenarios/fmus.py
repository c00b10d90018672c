"""The FMUs a scenario needs, built on the way if they are missing or out of date.

One flavour serves a process and its workers: Python unless `choose` says otherwise, because it is
there in a second. Native FMUs run a sweep ten times faster, but on a machine that has not built any
their compiler works for a minute first.
"""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from fmpy.model_description import read_model_description

from cosim import SetupError, System

ROOT = Path(__file__).resolve().parents[1]
DRIVE = {"motor": "drive_motor", "conveyor": "crank_conveyor"}
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
FOLDERS = {"native": ROOT / "fmus" / "native", "python": ROOT / "fmus"}
CHOICE = "DRIVE_FMUS_FLAVOUR"


def choose(flavour: str) -> None:
    """Take FMUs of this flavour from now on, also in processes started later."""
    os.environ[CHOICE] = flavour


def flavour() -> str:
    """The flavour that is taken: "native" or "python"."""
    return os.environ.get(CHOICE, "python")


def build(*components: str) -> None:
    """Run build_fmus.py for these components; raises SetupError with its reason."""
    command = [sys.executable, str(ROOT / "build_fmus.py"), *components, "--flavour", flavour()]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SetupError(f"the FMUs could not be built: {done.stderr.strip()}")
    for line in done.stdout.splitlines():
        if "up to date" not in line:
            print(line)


def fmu(component: str) -> Path:
    """drive_motor -> fmus/DriveMotor.fmu, or its native sister."""
    return FOLDERS[flavour()] / f"{component.title().replace('_', '')}.fmu"


def guid(component: str) -> str:
    """The guid of the FMU of a component."""
    return str(read_model_description(str(fmu(component)), validate=False).guid)


def conveyor_drive(start: Mapping[str, float]) -> System:
    """Motor and conveyor, coupled by torque and speed."""
    parts = {part: fmu(component) for part, component in DRIVE.items()}
    return System(parts, WIRES, start)
