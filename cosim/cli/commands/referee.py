"""cosim referee: whether a result that another master wrote is right, how far it is off, and why."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...accuracy.referee import TIMEOUT, TOLERANCE, referee
from ...accuracy.referee.report import writer
from ..command import Command
from ..options import Parser, assignment
from ..output import require_writable
from ..system_file import add_shared_options, open_system


def judge_result(options: argparse.Namespace) -> int:
    """Print the report on a result; return 1 if it differs, 2 if that cannot be told."""
    for path in options.out:
        writer(path)
        require_writable(path)
    with open_system(options) as file:
        report = referee(
            file.system, options.result, columns=dict(map(assignment, options.map)),
            start=file.start if options.start is None else options.start,
            stop=file.package.stop if options.stop is None else options.stop,
            step=options.step, tolerance=options.tolerance, timeout=options.timeout,
        )  # fmt: skip
    for path in options.out:
        report.write(path)
    print(report.text())
    return report.exit_status


def add_options(parser: Parser) -> None:
    """Add the result, what its columns are, and the files to write."""
    parser.path("--result", ".csv, .parquet, or .mat file of a Modelica tool", required=True)
    text = "column of a variable, where their names differ: motor.tau=M*0.73:N.m"
    parser.several("--map", text, metavar="NAME=COLUMN")
    text = "communication step of the other master [s] (default: several are tried)"
    parser.time("--step", text)
    add_shared_options(parser, "--stop")
    text = "allowed difference, as a share of the range of a signal"
    parser.number("--tolerance", text, TOLERANCE)
    parser.time("--timeout", "longest wall-clock time of an integration [s]", TIMEOUT)
    text = "report: .txt, .json, .xml (JUnit), .html, or a picture .png, .svg, .pdf"
    parser.several("--out", text, metavar="FILE", type=Path)


COMMAND = Command(
    "referee", "judge the result of another master", judge_result, add_options, rank=6,
    is_timed=True,
)  # fmt: skip
