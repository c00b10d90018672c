"""What command lines share: bad input is one line, and every way to end has its exit code."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from .errors import SetupError
from .result import SimulationError
from .signals import heard
from .system import Value


class Parser(argparse.ArgumentParser):
    """Reports bad input as one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        raise SetupError(message)

    def path(self, name: str, text: str, **more: Any) -> None:
        """An option that is a file."""
        self.add_argument(name, type=Path, help=text, **more)

    def number(self, name: str, text: str, default: float | None = None, **more: Any) -> None:
        """An option that is a number."""
        self.add_argument(name, type=float, default=default, help=text, **more)

    def several(self, name: str, text: str, **more: Any) -> None:
        """An option that may be given again."""
        self.add_argument(name, action="append", default=[], help=text, **more)


def exit_code(action: Callable[[], int]) -> int:
    """What the action returns; 1 for a run that failed on the way or a file that cannot be written, 2 for
    bad input, 130 for Ctrl-C and the like, 141 where nobody reads the output any more.
    """
    try:
        with heard(signal.default_int_handler):
            code = action()
            sys.stdout.flush()
            return code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except SetupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        print(f"error: {where}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        kept = f", what was computed is kept: {interrupt}" if interrupt.args else ""
        print(f"interrupted{kept}", file=sys.stderr)
        return 130


def require(package: str, what: str) -> None:
    """Raise SetupError if a package is not installed that this needs, "--plot"."""
    if not find_spec(package):
        raise SetupError(f"{what} needs the package {package}, which is not installed")


def assignment(text: str) -> tuple[str, str]:
    """ "motor.T=0.05" as name and value."""
    name, equals, value = text.partition("=")
    if not equals:
        raise SetupError(f"{text!r} must read NAME=VALUE")
    return name.strip(), value.strip()


def literal(text: str) -> Value:
    """A number or truth value where it is one, else the text."""
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
