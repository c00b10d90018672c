"""What a command of `cosim` is: a name, a help text, options and a function."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from .options import Parser


@dataclass(frozen=True)
class Command:
    """A command of `cosim`.

    To add one, write a module in `cosim.cli.commands` with a constant `COMMAND`. Nothing else changes.

    Attributes
    ----------
    name : str
        What is typed after `cosim`.
    summary : str
        One line of help without a full stop.
    run : callable
        Takes the parsed options and returns the exit code.
    add_options : callable
        Adds the command's own arguments to its parser.
    rank : int
        Commands are listed by increasing rank.
    reads_system : bool
        Whether the command takes a system file and start values, see `system_file.add_options`.
    is_timed : bool
        Whether the command also takes a start time, so that `--start` may mean either.
    needs_file : bool
        Whether the file must be there.
    """

    name: str
    summary: str
    run: Callable[[argparse.Namespace], int]
    add_options: Callable[[Parser], None]
    rank: int
    reads_system: bool = True
    is_timed: bool = False
    needs_file: bool = True
