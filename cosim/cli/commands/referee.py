"""The command `cosim referee`."""

from __future__ import annotations

import argparse
import sys

from ...accuracy.referee import TIMEOUT, TOLERANCE, RefereeReport, referee
from ...errors import SetupError
from ...scoreboards import UNREADABLE, scoreboard
from ...standings import Scoreboard
from ..options import SEVERAL, Parser, assignment
from ..output import require_writable
from ..system_file import add_system_options, open_system

SUMMARY = "Judge the result of another master."


def execute(options: argparse.Namespace) -> int:
    """Print the report on a result; return 1 if it differs, 2 if that cannot be told."""
    if options.scoreboard is not None:
        return judge_masters(options)
    if not options.files or options.result is None:
        raise SetupError("give a file and --result FILE, or --scoreboard FOLDER alone")
    for path in options.out:
        RefereeReport.format_of(path)
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


def judge_masters(options: argparse.Namespace) -> int:
    """Print the scoreboard; return 1 if something in its folder is no result."""
    if options.files or options.result is not None:
        raise SetupError(
            "--scoreboard takes its systems and results from its folder: give no file and no --result"
        )
    for path in options.out:
        Scoreboard.format_of(path)
        require_writable(path)
    board = scoreboard(
        options.scoreboard, tolerance=options.tolerance,
        progress=lambda line: print(line, file=sys.stderr, flush=True),
    )  # fmt: skip
    for path in options.out:
        board.write(path)
    print(board.text())
    return int(bool(board.notes) or any(s.verdict == UNREADABLE for s in board.standings))


def add_options(parser: Parser) -> None:
    """Add the result, what its columns are, and the files to write."""
    add_system_options(parser, is_timed=True, needs_file=False)
    parser.take("--result", "--scoreboard")
    text = "column of a variable, where their names differ: motor.tau=M*0.73:N.m"
    parser.take("--map", help=text)
    text = "communication step of the other master [s] (default: several are tried)"
    parser.take("--step", help=text)
    parser.take("--stop")
    parser.take("--allowed", default=TOLERANCE)
    text = "longest wall-clock time of an integration [s]"
    parser.take("--timeout", default=TIMEOUT, help=text)
    text = "report: .txt, .json, .xml (JUnit, of one result), .html, or a picture .png, .svg, .pdf"
    parser.take("--out", help=text, **SEVERAL)
