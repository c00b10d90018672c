"""Reads the command line of `cosim` and runs the command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pkgutil import iter_modules

from .. import __version__
from ..errors import SetupError
from . import commands, system_file
from .command import Command
from .options import Help, Parser, exit_code

#: What people type for a command that is an option of another one.
SUBSTITUTES = {"certify": "run --certify"}


def registered_commands() -> list[Command]:
    """Return the commands of all modules in `cosim.cli.commands`, by rank."""
    modules = (
        import_module(f"{commands.__name__}.{module.name}")
        for module in iter_modules(commands.__path__)
    )
    return sorted((module.COMMAND for module in modules), key=lambda command: command.rank)


def parser(program: str = "cosim") -> Parser:
    """Return the parser of the whole command line."""
    top = Parser(
        prog=program,
        description="Couple FMUs of FMI 2.0 and 3.0, and judge what couplings compute.",
    )
    top.add_argument("--version", action="version", version=f"cosim {__version__}")
    subparsers = top.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for command in registered_commands():
        text = command.summary
        sentence = f"{text[0].upper()}{text[1:]}."
        subparser = subparsers.add_parser(
            command.name, help=text, description=sentence, formatter_class=Help
        )
        subparser.set_defaults(run=command.run)
        if command.reads_system:
            system_file.add_options(
                subparser, is_timed=command.is_timed, needs_file=command.needs_file
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
        return int(options.run(options))

    return exit_code(run_command)
