"""The command `cosim diagnose`."""

from __future__ import annotations

import argparse

from ..options import Parser
from ..system_file import add_system_options, open_system

SUMMARY = "Measure how the coupling changes the damping."


def execute(options: argparse.Namespace) -> int:
    """Print the diagnosis of a system in plain words."""
    from ...analysis.damping import (
        diagnose,
    )  # its parts of SciPy take longer to import than `--help`

    with open_system(options) as file:
        diagnosis = diagnose(
            file.system, step=file.step(options.step), algorithm=options.algorithm,
            share=options.share, start=file.start, settle=options.settle,
        )  # fmt: skip
    print(diagnosis.text())
    return 0


def add_options(parser: Parser) -> None:
    """Add the step, the algorithm and what is allowed of it."""
    add_system_options(parser)
    parser.take("--step", "--algorithm", "--share", "--settle")
