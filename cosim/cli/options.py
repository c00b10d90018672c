"""Shared by the command lines: one line for bad input, and an exit code for every kind of end."""

from __future__ import annotations

import argparse
import errno
import math
import os
import re
import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from ..engine.algorithms import ALGORITHMS
from ..errors import RunError, SetupError
from ..names import meant
from ..signals import handle_stop_signals
from ..units import in_unit, multiples, read_quantity

#: How argparse refuses a word that is none of several.
CHOICE = re.compile(r".*invalid choice: '(?P<wrong>.*)' \(choose from (?P<names>.*)\)")


class Help(argparse.HelpFormatter):
    """Shows defaults as a person would write them, and omits them where there are none."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        default = (
            f"{action.default:g}" if isinstance(action.default, float) else str(action.default)
        )
        if not action.option_strings or default in ("None", "False", "inf", argparse.SUPPRESS):
            return action.help
        if isinstance(action, argparse._AppendAction):
            return f"{action.help} (repeatable)"
        return f"{action.help} (default: {default})"


class Parser(argparse.ArgumentParser):
    """Reports bad input as one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        """Raise SetupError, where argparse would print its usage and exit."""
        choice = CHOICE.fullmatch(message)
        if choice is not None:
            message += meant(choice["wrong"], re.findall(r"[\w-]+", choice["names"]))
        raise SetupError(message)

    def take(self, *names: str, **changes: Any) -> None:
        """Add options of the table by their names, with what is different in this command."""
        for name in names:
            form, text = OPTIONS[name]
            self.add_argument(name, *FORMER_NAMES.get(name, ()), **form | {"help": text} | changes)


def parse_number(text: str) -> float:
    """A number; raises ArgumentTypeError for another text."""
    quantity = read_quantity(text)
    if quantity is None or quantity.unit or math.isnan(quantity.number):
        other = "; start values are given with --set or --start" if "=" in text else ""
        raise argparse.ArgumentTypeError(f"{text!r} is not a number{other}")
    return quantity.number


def parse_whole(least: int, text: str) -> int:
    """A whole number from `least` on that 64 bits hold; raises ArgumentTypeError for another text."""
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number, at least {least}")
    return int(text)


def parse_time(text: str) -> float:
    """A time [s], which may be written with a unit: "1ms", "2 min". Raises ArgumentTypeError for others."""
    if not math.isnan(time := in_unit(text, "s")):
        return time
    if (quantity := read_quantity(text)) and quantity.unit:
        choices = ", ".join(multiples("s"))
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a time: its unit must be one of {choices}"
        )
    return parse_number(text)


class StartAction(argparse.Action):
    """Keeps a start value, NAME=VALUE as with --set; a time is told that it is now given with --from, where there is one."""

    def __call__(self, parser: Any, options: Any, text: Any, name: str | None = None) -> None:
        """Keep what is given."""
        if "=" in text:
            options.start_values = [*options.start_values, text]
            return
        if not hasattr(options, "start"):
            raise argparse.ArgumentError(self, f"{text!r} must read NAME=VALUE")
        try:
            options.start = parse_time(text)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentError(self, str(error)) from None
        print("warning: the start time is given with --from: write that", file=sys.stderr)


class FormerNameAction(argparse.Action):
    """Keeps a value, and tells what the option is called whose former name was given."""

    def __call__(self, parser: Any, options: Any, value: Any, name: str | None = None) -> None:
        """Keep what is given."""
        if name != self.option_strings[0]:
            print(
                f"warning: {name} is called {self.option_strings[0]}: write that", file=sys.stderr
            )
        setattr(options, self.dest, value)


def name_list(text: str) -> list[str]:
    """Split "a,b" into names; commas in brackets, as in A[2,1], belong to the name."""
    return [name.strip() for name in re.split(r",(?![^\[]*\])", text) if name.strip()]


def _whole_from(least: int, **more: Any) -> dict[str, Any]:
    return {"type": partial(parse_whole, least), "metavar": "N"} | more


NUMBER: dict[str, Any] = {"type": parse_number, "metavar": "NUMBER"}
TIME: dict[str, Any] = {"type": parse_time, "metavar": "TIME"}
PATH: dict[str, Any] = {"type": Path, "metavar": "FILE"}
LIST: dict[str, Any] = {"type": name_list, "metavar": "LIST"}
FLAG: dict[str, Any] = {"action": "store_true"}
SEVERAL: dict[str, Any] = {"action": "append", "default": []}
ASSIGNED = SEVERAL | {"metavar": "NAME=VALUE"}
#: The options of all commands: each means one thing, and what it is of may differ.
OPTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "--wire": (SEVERAL | {"metavar": "WIRE"}, "wire: 'motor.tau -> pump.tau', or 'motor.flange -- pump.flange' between terminals"),
    "--parameters": (PATH, "start values: an .ssv, or a .csv with the columns name, value and unit"),
    "--set": (ASSIGNED | {"dest": "start_values"}, "start value of a parameter or input, with a unit if needed: motor.T=5ms"),
    "--from": (TIME | {"dest": "start"}, "start time [s] (default: that of the file)"),
    "--start": ({"action": StartAction, "dest": "start_values", "metavar": "NAME=VALUE", "default": []}, "start value, as with --set (repeatable)"),
    "--strict": (FLAG, "refuse an FMU whose model description is not valid"),
    "--stop": (TIME, "stop time [s] (default: that of the file)"),
    "--step": (TIME, "communication step [s] (default: that of the file, or the one that the FMUs prefer)"),
    "--adaptive": (NUMBER | {"metavar": "TOLERANCE"}, "choose the steps so that the coupling error stays within this tolerance"),
    "--algorithm": ({"choices": ALGORITHMS, "default": "strang"}, "coupling algorithm"),
    "--order": (LIST, "sequence in which the parts step: a,b,c"),
    "--input-order": (_whole_from(0, default=0), "polynomial order of inputs within a step"),
    "--substeps": (SEVERAL | {"metavar": "PART=N"}, "substeps of a part within a communication step"),
    "--fmu-tolerance": (NUMBER | {"action": FormerNameAction, "dest": "tolerance"}, "relative tolerance passed to the FMUs (default: the one that each FMU states)"),
    "--stop-time-defined": (FLAG, "pass the stop time to all FMUs before the start (default: only to those that need it)"),
    "--input": (PATH, "file of inputs over time, with a column of times [s]"),
    "--map": (SEVERAL | {"metavar": "NAME=COLUMN"}, "input and the column of --input that drives it; NAME=>COLUMN converts no unit (default: columns that are named like inputs)"),
    "--held": (FLAG, "hold the values of --input until the next row instead of interpolating"),
    "--at": (SEVERAL | {"metavar": "'TIME NAME=VALUE'"}, "change of a value during the run"),
    "--record": (LIST, "columns to record: motor.tau,conveyor.w (default: all outputs)"),
    "--output-step": (TIME, "time between rows [s] (default: a row at every step)"),
    "--out": (PATH, ".csv or .parquet file; a JSON file next to it gives units and provenance"),
    "--plot": (PATH, "image file with a plot of all columns"),
    "--timeout": (TIME | {"default": math.inf}, "longest wall-clock time of a step [s] (default: no limit)"),
    "--certify": (FLAG, "also run with other steps, and a tenth of the FMUs' tolerance, and state the error of every figure (exit status 3 if of none)"),
    "--part": ({"metavar": "NAME"}, "write only this part's columns, under their bare names"),
    "--standard": (FLAG, "check the file against the SSP standard instead, clause by clause"),
    "--vary": (SEVERAL | {"metavar": "NAME=VALUES"}, "values from run to run, NAME=from:to:n or NAME=a,b,c, with units if needed; all combinations of several"),
    "--together": (FLAG, "vary several names row by row, not in all combinations"),
    "--table": (PATH, "cases: a .csv whose header names start values, one row per run"),
    "--sample": (_whole_from(1), "draw this many cases from the space within --within"),
    "--within": (SEVERAL | {"metavar": "NAME=a..b"}, "bounds of a start value for --sample"),
    "--seed": (_whole_from(0, default=0), "seed of --sample"),
    "--figure": (SEVERAL | {"metavar": "KIND:COLUMN"}, "figure of each run, as largest:motor.tau or mean:motor.tau@0.5..2"),
    "--jobs": (_whole_from(1), "runs at a time"),
    "--to": ({}, "ssp, osp (a folder for libcosim), or container (one FMU) (default: as --out ends)"),
    "--value": (NUMBER, "half the height of the band, as a share of the reference's range"),
    "--time": (NUMBER, "half the width of the band [s] (default: 0.002 of the time compared)"),
    "--error": (ASSIGNED, "error of a column, in the reference's unit or with its own, as in 7.3rpm"),
    "--gap": (NUMBER | {"default": math.inf}, "skip gaps longer than this between rows of the reference [s] (default: no limit)"),
    "--allowed": (NUMBER | {"action": FormerNameAction, "dest": "tolerance"}, "allowed difference, as a share of the range of a signal"),
    "--result": (PATH, ".csv, .parquet, or .mat file of a Modelica tool"),
    "--scoreboard": (PATH | {"metavar": "FOLDER"}, "judge the results of many masters, FOLDER/results/MASTER/SYSTEM_1ms.csv, on the reference systems in FOLDER"),
    "--method": ({}, "integrator; Radau and LSODA are for stiff systems"),
    "--share": (NUMBER | {"default": 0.05}, "artificial damping allowed, as a share of the real damping"),
    "--settle": (TIME | {"default": 0.0}, "time [s] to settle before the measurement"),
}  # fmt: skip
#: What options were called before; a word tells it. --tolerance is that of a parameter in other commands.
FORMER_NAMES = dict.fromkeys(("--fmu-tolerance", "--allowed"), ("--tolerance",))


def exit_code(action: Callable[[], int]) -> int:
    """Run an action and return the exit status: what the action returns, or that of its error.

    It is 1 for a run that failed or a file that cannot be written, 2 for bad input, 130 for Ctrl-C and
    the like, and 141 if nobody reads the output any more.
    """
    open_standard_files()
    try:
        with handle_stop_signals(signal.default_int_handler):
            code = action()
            sys.stdout.flush()
            return code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (SetupError, RunError, OSError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else error
        print(f"error: {reason}", file=sys.stderr)
        return 2 if isinstance(error, SetupError) else 1
    except KeyboardInterrupt as interrupt:
        rows = f"; what was computed is kept: {interrupt}" if interrupt.args else ""
        print(f"interrupted{rows}", file=sys.stderr)
        return 130


def open_standard_files() -> None:
    """Give a process that was started without standard input, output or error the null device there.

    Otherwise the next file that is opened takes their place, and what an FMU prints goes into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123


def reason_of(error: OSError) -> str:
    """What is wrong with which file, or with the current folder."""
    if error.filename is not None:
        return f"{error.filename}: {error.strerror or error}"
    if error.errno == errno.ENOENT:
        try:
            Path.cwd()
        except FileNotFoundError:
            return "the current folder has been removed: change to another one"
    return str(error.strerror or error)


def require(package: str, what: str) -> None:
    """Raise SetupError if a package is not installed that this needs, "--plot"."""
    if not find_spec(package):
        raise SetupError(f"{what} needs the package {package}, which is not installed")


def assignment(text: str, form: str = "NAME=VALUE") -> tuple[str, str]:
    """Name and value of an assignment such as "motor.T=0.05"; raises SetupError with the form for another text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise SetupError(f"{text!r} must read {form}")
    return name.strip(), value.strip()
