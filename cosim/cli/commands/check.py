"""cosim check: whether a system can run, without running it."""

from __future__ import annotations

import argparse

from ... import describe
from ...requirements import setup_problems
from ..command import Command
from ..system_file import add_stepping_options, open_system


def check_system(options: argparse.Namespace) -> int:
    """Print notes and problems of a system; return 1 if it cannot run."""
    with open_system(options) as file:
        settings = file.settings(options)
        problems = list(setup_problems(file.network, settings))
        notes = list(describe.notes(file.network, settings))
        if file.package.step is not None:
            notes.append(f"communication step: {file.package.step!r} s, given by the file")
    for note in notes:
        print(note)
    for problem in problems:
        print(f"error: {problem}")
    print(f"problems: {len(problems)}" if problems else "ready to run")
    return 1 if problems else 0


COMMAND = Command(
    "check", "check whether a system can run, without running it", check_system,
    add_stepping_options, rank=2, is_timed=True,
)  # fmt: skip
