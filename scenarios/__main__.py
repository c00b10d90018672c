"""python -m scenarios list | run NAME [options] | study FILE.toml [options]."""

import importlib
import sys
from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from collections.abc import Sequence
from types import ModuleType

from cosim.commandline import Parser, exit_code

from . import fmus
from .answer import question

SCENARIOS = (
    "resonance",
    "resonance_map",
    "run_up",
    "iron_cycle",
    "iron_start",
    "iron_orders",
    "orientation_time",
    "orientator_cycle",
    "packing_line",
)
STUDY = "study"


def parser(name: str) -> Parser:
    """The command line, with the options of the scenario of this name, or of a study."""
    top = Parser(prog="python -m scenarios", description="Run the scenarios of the drives.")
    commands = top.add_subparsers(required=True, metavar="list | run | study", dest="command")
    commands.add_parser("list", help="list the scenarios and the questions they answer")
    names = commands.add_parser("run", help="run a scenario").add_subparsers(
        required=True, metavar="NAME", dest="scenario"
    )
    for known in SCENARIOS:
        module = load(known) if known == name else None
        one = names.add_parser(
            known,
            description=module.__doc__ if module else None,
            formatter_class=ArgumentDefaultsHelpFormatter,
        )
        if module:
            module.arguments(one)
            _add_flavour(one, getattr(module, "FLAVOUR", "python"))
    many = commands.add_parser("study", help="vary inputs of a scenario as a file says")
    if name == STUDY:
        load(f"{STUDY}.command").arguments(many)
        _add_flavour(many, "python")
    return top


def _add_flavour(parser: ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--flavour", choices=fmus.FOLDERS, default=default, help="flavour of the FMUs"
    )


def load(name: str) -> ModuleType:
    """The module of this name; each brings the libraries it needs."""
    return importlib.import_module(f"scenarios.{name}")


def main(words: Sequence[str]) -> int:
    """Run the command of these words; its exit code."""

    def act() -> int:
        first, second, *_ = (*words, "", "")
        options = vars(parser(second if first == "run" else first).parse_args(words))
        command = options.pop("command")
        if command == "list":
            for name in SCENARIOS:
                print(f"{name:<17} {question(load(name).__doc__)}")
            return 0
        fmus.choose(options.pop("flavour"))
        if command == STUDY:
            return int(load(f"{STUDY}.command").command(**options))
        load(options.pop("scenario")).run(**options)
        return 0

    return exit_code(act)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
