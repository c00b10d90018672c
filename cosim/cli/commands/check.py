"""The command `cosim check`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ... import describe
from ...engine.setup import setup_problems
from ...errors import SetupError
from ...formats.ssp.standard import check_standard
from ...isolated import begin_isolated
from ..options import Parser
from ..system_file import add_stepping_options, add_system_options, open_system

SUMMARY = "Check whether a system can run, without running it."


def execute(options: argparse.Namespace) -> int:
    """Print notes and problems of a system; return 1 if it cannot run, or breaks the standard that is asked for."""
    if options.standard:
        if len(options.files) > 1:
            raise SetupError("--standard checks one file, an .ssp or an .ssd")
        report = check_standard(Path(options.files[0]))
        print(report.text())
        return 0 if report.passed else 1
    with open_system(options) as file:
        settings = file.settings(options, is_checked_only=True)
        problems = list(setup_problems(file.network, settings))
        notes = list(describe.notes(file.network, settings))
        if file.package.step is not None:
            notes.append(f"communication step: {file.package.step!r} s, given by the file")
        if not problems:
            try:
                begin_isolated(file.system, settings)
            except SetupError as error:
                problems.append(str(error))
    for note in notes:
        print(note)
    for problem in problems:
        print(f"error: {problem}")
    print(f"problems: {len(problems)}" if problems else "ready to run")
    return 1 if problems else 0


def add_options(parser: Parser) -> None:
    """Add how the system is stepped, and the check of the standard in its place."""
    add_system_options(parser, is_timed=True)
    add_stepping_options(parser)
    parser.take("--standard")
