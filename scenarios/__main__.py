"""scenarios list | run NAME or FILE.py [options] | study FILE.toml [options]."""

import sys
from collections.abc import Sequence

from workbench import cli
from workbench.question import Project

from . import fmu_files
from .old_names import OLD_NAMES

PROJECT = Project(fmu_files.PACKAGE, fmu_files.FOLDERS, fmu_files.problem, OLD_NAMES)
PROGRAM = "scenarios"


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run a command line, by default that of the process; return its exit code."""
    return cli.main(sys.argv[1:] if arguments is None else arguments, PROJECT, program)


if __name__ == "__main__":
    sys.exit(main())
