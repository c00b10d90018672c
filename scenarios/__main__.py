"""python -m scenarios list | run NAME [options]."""

import argparse
import importlib
import sys
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


def parser(name: str) -> Parser:
    """The command line, with the options of the scenario of this name."""
    top = Parser(prog="python -m scenarios", description="Run the scenarios of the drives.")
    commands = top.add_subparsers(required=True, metavar="list | run", dest="command")
    commands.add_parser("list", help="list the scenarios and the questions they answer")
    names = commands.add_parser("run", help="run a scenario").add_subparsers(
        required=True, metavar="NAME", dest="scenario"
    )
    for known in SCENARIOS:
        module = load(known) if known == name else None
        one = names.add_parser(
            known,
            description=module.__doc__ if module else None,
            formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        )
        if module:
            module.arguments(one)
            one.add_argument(
                "--flavour",
                choices=fmus.FOLDERS,
                default=getattr(module, "FLAVOUR", "python"),
                help="flavour of the FMUs",
            )
    return top


def load(name: str) -> ModuleType:
    """The module of a scenario; each brings the libraries it needs."""
    return importlib.import_module(f"scenarios.{name}")


def main() -> int:
    """Run the command that was typed; its exit code."""

    def act() -> int:
        name = sys.argv[2] if sys.argv[1:2] == ["run"] and len(sys.argv) > 2 else ""
        options = vars(parser(name).parse_args())
        if options.pop("command") == "list":
            for name in SCENARIOS:
                print(f"{name:<17} {question(load(name).__doc__)}")
        else:
            fmus.choose(options.pop("flavour"))
            load(options.pop("scenario")).run(**options)
        return 0

    return exit_code(act)


if __name__ == "__main__":
    sys.exit(main())
