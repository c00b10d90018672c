"""Reads the command line of `cosim` and runs the command."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .. import __version__
from ..errors import SetupError
from .commands import (
    check,
    compare,
    crosscheck,
    diagnose,
    export,
    info,
    oracle,
    referee,
    run,
    sweep,
)
from .options import Help, Parser, exit_code
from .output import require_separate_files

#: In the order in which they are listed.
COMMANDS = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        info,
        check,
        run,
        sweep,
        diagnose,
        oracle,
        export,
        referee,
        crosscheck,
        compare,
    )
}
#: What people type for a command that is an option of another one.
SUBSTITUTES = {"certify": "run --certify"}


def parser(program: str = "cosim") -> Parser:
    """Return the parser of the whole command line."""
    top = Parser(
        prog=program,
        description="Couple FMUs of FMI 2.0 and 3.0, and judge what couplings compute.",
    )
    top.add_argument("--version", action="version", version=f"cosim {__version__}")
    subparsers = top.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for name, command in COMMANDS.items():
        text = command.SUMMARY
        subparser = subparsers.add_parser(
            name,
            help=f"{text[0].lower()}{text[1:]}".rstrip("."),
            description=text,
            formatter_class=Help,
        )
        command.add_options(subparser)
    return top


def main(arguments: Sequence[str] | None = None, program: str = "cosim") -> int:
    """Run the command that the arguments, by default those of the process, name; return its exit code."""

    def run_command() -> int:
        argv = sys.argv[1:] if arguments is None else arguments
        if argv and argv[0] in SUBSTITUTES:
            raise SetupError(f"there is no command {argv[0]!r}: use {SUBSTITUTES[argv[0]]}")
        top = parser(program)
        options, rest = top.parse_known_args(arguments)
        if rest and "files" in options and not any(text.startswith("-") for text in rest):
            options.files += rest  # parts after an option
        elif rest:
            top.error(f"unrecognized arguments: {' '.join(rest)}")
        require_separate_files(options)
        return int(COMMANDS[options.command].execute(options))

    return exit_code(run_command)
