"""The command `cosim crosscheck`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...analysis.crosscheck import crosscheck
from ...analysis.crosscheck.report import Crosscheck
from ..options import SEVERAL, Parser
from ..output import require_writable

SUMMARY = "Check whether an FMU keeps its promises."


def execute(options: argparse.Namespace) -> int:
    """Print and write the report of an FMU; return 1 if a check failed."""
    for path in options.out:
        Crosscheck.format_of(path)
        require_writable(path)
    report = crosscheck(options.fmu, step=options.step, timeout=options.timeout)
    for path in options.out:
        report.write(path)
    print(report.text())
    return 0 if report.passed else 1


def add_options(parser: Parser) -> None:
    """Add the FMU, the step and the reports."""
    parser.add_argument("fmu", type=Path, help="a co-simulation FMU of FMI 2.0 or 3.0")
    text = "communication step [s] (default: the one that the FMU prefers)"
    parser.take("--step", help=text)
    parser.take("--timeout", default=60.0, help="longest wall-clock time of a check [s]")
    text = "report file: .txt, .xml (JUnit), .html, or a badge .svg"
    parser.take("--out", help=text, **SEVERAL)
