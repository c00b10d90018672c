"""scenarios list | run NAME or FILE.py [options] | study FILE.toml [options]."""

import sys

from workbench.cli import main
from workbench.question import Project

from . import fmu_files
from .old_names import OLD_NAMES

PROJECT = Project(fmu_files.PACKAGE, fmu_files.FOLDERS, fmu_files.problem, OLD_NAMES)
PROGRAM = "scenarios"


def run() -> int:
    """The words of the command line; its exit code."""
    return main(sys.argv[1:], PROJECT, PROGRAM)


if __name__ == "__main__":
    sys.exit(run())
