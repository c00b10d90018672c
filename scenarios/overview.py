"""The command `drive-fmus`: what is installed, and the other commands under a name that no other tool has.

drive-fmus                        the version, the commands, and the folder of the FMUs
drive-fmus cosim|scenarios|fmukit ...   the same as cosim, scenarios, fmukit
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from cosim import __version__
from cosim.names import only

#: The module of each command, which is imported when the command is given, and what the command does.
COMMANDS = {
    "cosim": ("cosim.__main__", "couple FMUs of any tool, and judge what the coupling computes"),
    "fmukit": ("fmukit.__main__", "build an FMU from a page of equations"),
    "scenarios": ("scenarios.__main__", "ask a question about a drive; the answer has its error"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name, by default those of the process; return its exit code."""
    name, *rest = [*(sys.argv[1:] if arguments is None else arguments), ""]
    if name in ("", "-h", "--help"):
        print(drive_fmus_help())
    elif name == "--version":
        print(f"drive-fmus {__version__}")
    elif name in COMMANDS:
        try:
            module = import_module(COMMANDS[name][0])
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return 130
        return int(module.main(rest[:-1], f"drive-fmus {name}"))
    else:
        print(f"error: drive-fmus has no command {name!r}: {only(name, COMMANDS)}", file=sys.stderr)
        return 2
    return 0


def drive_fmus_help() -> str:
    """The version, the commands, and the folder of the FMUs with their number by flavour."""
    from .fmu_files import FMUS

    lines = [f"drive-fmus {__version__}", ""]
    lines += [f"drive-fmus {name:<10}{text}" for name, (_, text) in COMMANDS.items()]
    lines += ["", "Each has --help, and is also installed without drive-fmus in front.", ""]
    flavours = {"native": FMUS / "native", "Python": FMUS}
    counts = {name: len(list(folder.glob("*.fmu"))) for name, folder in flavours.items()}
    built = " and ".join(f"{count} {name}" for name, count in counts.items() if count)
    where = f"{built} FMUs in {FMUS}" if built else f"There are no FMUs in {FMUS} yet."
    return "\n".join([*lines, where])
