"""How high is a plane over a point?

A scenario for studies that does as it is told: answers, refuses, fails, crashes, hangs.
"""

from __future__ import annotations

import os
import signal
import time
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

from cosim import SetupError
from scenarios.answer import Figure


def refuse() -> NoReturn:
    raise SetupError("this point is refused")


def fail() -> NoReturn:
    raise ZeroDivisionError("no plane\nat all")


def segfault() -> None:
    print("last words", flush=True)
    os.kill(os.getpid(), signal.SIGSEGV)


def be_killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave() -> None:
    os._exit(0)


def hang() -> None:
    time.sleep(1000.0)


MOODS: dict[str, Callable[[], None]] = {
    "good": lambda: None,
    "refuse": refuse,
    "fail": fail,
    "segfault": segfault,
    "victim": be_killed,
    "leave": leave,
    "hang": hang,
}


def arguments(parser: ArgumentParser) -> None:
    """The options of the scenario."""
    parser.add_argument("--x", type=float, default=0.0, help="abscissa [m]")
    parser.add_argument("--times", type=int, default=1, help="slope in y")
    parser.add_argument("--mood", choices=MOODS, default="good", help="what becomes of the run")


def answer(
    x: float = 0.0,
    y: float = 0.0,
    times: int = 1,
    mood: str = "good",
    pause: float = 0.0,
    ledger: str = "",
) -> SimpleNamespace:
    """Height 3 x + times y over the point; each run leaves a line in the ledger, if there is one."""
    if ledger:
        with Path(ledger).open("a") as file:
            file.write(f"{x!r}\n")
    time.sleep(pause)
    MOODS[mood]()
    figures = {"height": Figure(3.0 * x + times * y, "m", 1e-3 * abs(x)), "y": Figure(y, "m")}
    if x >= 0.0:
        figures["root"] = Figure(x**0.5, "m1/2")
    return SimpleNamespace(figures=figures)
