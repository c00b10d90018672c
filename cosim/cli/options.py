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

from ..errors import RunError, SetupError
from ..names import meant
from ..signals import handle_stop_signals
from ..units import QUANTITY, in_unit, multiples

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

    def path(self, name: str, text: str, **more: Any) -> None:
        """An option that is a file."""
        self.add_argument(name, type=Path, help=text, **{"metavar": "FILE"} | more)

    def number(self, name: str, text: str, default: float | None = None, **more: Any) -> None:
        """An option that is a number."""
        arguments: dict[str, Any] = {
            "type": parse_number,
            "metavar": "NUMBER",
            "default": default,
        } | more
        self.add_argument(name, help=text, **arguments)

    def whole(self, name: str, text: str, least: int, **more: Any) -> None:
        """An option that is a whole number."""
        arguments: dict[str, Any] = {"type": partial(parse_whole, least), "metavar": "N"} | more
        self.add_argument(name, help=text, **arguments)

    def time(self, name: str, text: str, default: float | None = None, **more: Any) -> None:
        """An option that is a time [s]."""
        self.number(name, text, default, **{"type": parse_time, "metavar": "TIME"} | more)

    def several(self, name: str, text: str, **more: Any) -> None:
        """An option that may be given again."""
        self.add_argument(name, action="append", default=[], help=text, **more)


def parse_number(text: str) -> float:
    """A number; raises ArgumentTypeError for another text."""
    quantity = QUANTITY.fullmatch(text)
    if quantity is None or quantity[2]:
        other = "; start values are given with --set or --start" if "=" in text else ""
        raise argparse.ArgumentTypeError(f"{text!r} is not a number{other}")
    if math.isnan(number := float(quantity[1])):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return number


def parse_whole(least: int, text: str) -> int:
    """A whole number from `least` on that 64 bits hold; raises ArgumentTypeError for another text."""
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number, at least {least}")
    return int(text)


def parse_time(text: str) -> float:
    """A time [s], which may be written with a unit: "1ms", "2 min". Raises ArgumentTypeError for others."""
    if QUANTITY.fullmatch(text) is None:
        return parse_number(text)
    if math.isnan(time := in_unit(text, "s")):
        choices = ", ".join(multiples("s"))
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a time: its unit must be one of {choices}"
            if text.strip().lower() != "nan"
            else f"{text!r} is not a number"
        )
    return time


class StartAction(argparse.Action):
    """NAME=VALUE is a start value, as with --set; anything else the start time [s], where there is one."""

    def __call__(self, parser: Any, options: Any, text: Any, name: str | None = None) -> None:
        """Keep what is given."""
        if "=" in text:
            options.start_values = [*options.start_values, text]
            return
        if not hasattr(options, self.dest):
            raise argparse.ArgumentError(self, f"{text!r} must read NAME=VALUE")
        try:
            setattr(options, self.dest, parse_time(text))
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentError(self, str(error)) from None


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
    except SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except RunError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {reason_of(error)}", file=sys.stderr)
        return 1
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
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115, PTH123


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


def assignment(text: str) -> tuple[str, str]:
    """Name and value of an assignment such as "motor.T=0.05"."""
    name, equals, value = text.partition("=")
    if not equals:
        raise SetupError(f"{text!r} must read NAME=VALUE")
    return name.strip(), value.strip()
