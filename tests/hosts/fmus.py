"""What an FMU must do in a process of its own."""

import resource
import sys
from pathlib import Path
from types import ModuleType

from tests.hosts.host import Unit, in_subprocess


def resident() -> int:
    """Memory of this process in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@in_subprocess
def lives(fmu: str) -> list[float]:
    """Bytes that each of 500 instances leaves behind, and entries that all leave on sys.path."""
    paths = len(sys.path)
    for life in range(700):
        if life == 200:
            before = resident()
        unit = Unit(fmu).start().step(0.0, 1e-3)
        unit.outputs()
        unit.fmi.freeInstance()
    return [(resident() - before) / 500, len(sys.path) - paths]


@in_subprocess
def versions(fmus: list[str]) -> list[float]:
    """Torque of several builds side by side, in a host that has modules of the same names."""
    for name in ("components", "drive_motor", "fmu", "fmukit", "fmukit.fmu"):
        sys.modules[name] = ModuleType(name)
    units = [Unit(fmu).start() for fmu in fmus]
    for n in range(10):
        for unit in units:
            unit.step(n * 0.1, 0.1)
    return [unit.get("tau") for unit in units]
