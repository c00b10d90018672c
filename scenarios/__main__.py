"""python -m scenarios list | run NAME [options]."""

import argparse
import importlib
import sys
from types import ModuleType
from typing import NoReturn

from cosim.errors import SetupError, SimulationError

from . import fmus

SCENARIOS = (
    "resonance",
    "run_up",
    "iron_cycle",
    "iron_start",
    "iron_orders",
    "orientation_time",
    "orientator_cycle",
)


class Parser(argparse.ArgumentParser):
    """Reports bad input as one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        raise SetupError(message)


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
                "--flavour", choices=fmus.FOLDERS, default="python", help="flavour of the FMUs"
            )
    return top


def load(name: str) -> ModuleType:
    """The module of a scenario; each brings the libraries it needs."""
    return importlib.import_module(f"scenarios.{name}")


def question(name: str) -> str:
    """The first line of a scenario."""
    return (load(name).__doc__ or "").splitlines()[0]


def main() -> int:
    """Exit code 0, 1 for a run that failed on the way, 2 for bad input, 130 after Ctrl-C."""
    try:
        name = sys.argv[2] if sys.argv[1:2] == ["run"] and len(sys.argv) > 2 else ""
        options = vars(parser(name).parse_args())
        if options.pop("command") == "list":
            for name in SCENARIOS:
                print(f"{name:<17} {question(name)}")
        else:
            fmus.choose(options.pop("flavour"))
            load(options.pop("scenario")).run(**options)
    except SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"interrupted, what was computed is kept: {interrupt}", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
