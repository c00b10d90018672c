"""The FMUs a scenario needs, built on the way if they are missing or out of date.

One flavour serves a process and its workers: Python unless `choose` says otherwise, because it is
there in a second. Native FMUs run a sweep ten times faster, but on a machine that has not built any
their compiler works for a minute first.
"""

import os
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from rich.console import Console

import cosim
from cosim import SetupError, System
from cosim.system import Value, connect

from .theory import Machine

ROOT = Path(__file__).resolve().parents[1]
DRIVE = {"motor": "drive_motor", "conveyor": "crank_conveyor"}
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
FOLDERS = {"native": ROOT / "fmus" / "native", "python": ROOT / "fmus"}
CHOICE = "DRIVE_FMUS_FLAVOUR"
SERVED = "DRIVE_FMUS_FOLDER"


def choose(flavour: str) -> None:
    """Take FMUs of this flavour from now on, also in processes started later."""
    os.environ[CHOICE] = flavour


def flavour() -> str:
    """The flavour that is taken: "native" or "python"."""
    return os.environ.get(CHOICE, "python")


def serve(folder: Path) -> None:
    """Take the FMUs from this folder from now on, as they are there; nothing is built."""
    os.environ[SERVED] = str(folder)


def build(*components: str) -> None:
    """Run build_fmus.py for these components, once in a process; raises SetupError with its reason."""
    if SERVED not in os.environ:
        _build(tuple(dict.fromkeys(components)), flavour())


@cache
def _build(components: tuple[str, ...], flavour: str) -> None:
    command = [sys.executable, str(ROOT / "build_fmus.py"), *components, "--flavour", flavour]
    with Console(stderr=True).status("FMUs"):
        done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SetupError(f"the FMUs could not be built: {done.stderr.strip()}")


def fmu(component: str) -> Path:
    """drive_motor -> fmus/DriveMotor.fmu, or its native sister."""
    folder = Path(os.environ[SERVED]) if SERVED in os.environ else FOLDERS[flavour()]
    return folder / f"{component.title().replace('_', '')}.fmu"


def provenance(system: System, algorithm: str | None, communication: str) -> dict[str, Any]:
    """How the runs of a sweep were made, in the words in which one run tells it."""
    descriptions = connect(system).descriptions
    return {
        "algorithm": algorithm,
        "communication": communication,
        "wires": list(system.wires),
        "parts": {
            name: {"fmu": path.name, "model": d.modelName, "guid": d.guid}
            for (name, path), d in zip(system.parts.items(), descriptions.values())
        },
        "versions": cosim.versions(),
        "flavour": flavour(),
    }


def conveyor_drive(start: Mapping[str, Value]) -> System:
    """Motor and conveyor, coupled by torque and speed."""
    parts = {part: fmu(component) for part, component in DRIVE.items()}
    return System(parts, WIRES, start)


def followed(machine: Machine, start: Mapping[str, Value]) -> Machine:
    """The machine with these start values; raises SetupError for what its FMUs or theory refuse."""
    build(*DRIVE.values())
    cosim.run(conveyor_drive(machine.start(1.0) | dict(start)), stop=1e-6, step=1e-6)
    changed = machine.follow(start)
    if changed.B == 0.0:
        raise SetupError("motor.B = 0.0 N.m.s/rad must be above 0: no slope, no resonance")
    return changed
