"""cosim diagnose: what the coupling does to the damping."""

from __future__ import annotations

import argparse

from ..command import Command
from ..options import Parser
from ..system_file import add_shared_options, open_system


def print_diagnosis(options: argparse.Namespace) -> int:
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
    add_shared_options(parser, "--step", "--algorithm")
    text = "artificial damping allowed, as a share of the real damping"
    parser.number("--share", text, 0.05)
    parser.time("--settle", "time [s] to settle before the measurement", 0.0)


COMMAND = Command(
    "diagnose", "measure how the coupling changes the damping", print_diagnosis, add_options,
    rank=4,
)  # fmt: skip
