"""python -m scenarios list | run NAME [options]."""

import argparse
import sys
from typing import NoReturn

import cosim

from . import resonance, run_up

SCENARIOS = {"resonance": resonance, "run_up": run_up}


class Parser(argparse.ArgumentParser):
    """Reports bad input as one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        raise cosim.SetupError(message)


def parser() -> Parser:
    """The command line of all scenarios."""
    top = Parser(prog="python -m scenarios", description="Run the scenarios of the drives.")
    commands = top.add_subparsers(required=True, metavar="list | run", dest="command")
    commands.add_parser("list", help="list the scenarios and the questions they answer")
    names = commands.add_parser("run", help="run a scenario").add_subparsers(
        required=True, metavar="NAME", dest="scenario"
    )
    for name, module in SCENARIOS.items():
        one = names.add_parser(
            name,
            description=module.__doc__,
            help=question(name),
            formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        )
        module.arguments(one)
    return top


def question(name: str) -> str:
    """The first line of a scenario."""
    return (SCENARIOS[name].__doc__ or "").splitlines()[0]


def main() -> int:
    """Exit code 0, 1 for a run that failed on the way, 2 for bad input, 130 after Ctrl-C."""
    try:
        options = vars(parser().parse_args())
        if options.pop("command") == "list":
            for name in SCENARIOS:
                print(f"{name:<12} {question(name)}")
        else:
            SCENARIOS[options.pop("scenario")].run(**options)
    except cosim.SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except cosim.SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"interrupted, what was computed is kept: {interrupt}", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
