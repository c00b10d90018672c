"""How high is a plane over a point?

A question for studies that does as it is told: answers, warns, refuses, fails, crashes, hangs.
"""

from __future__ import annotations

import ctypes
import logging
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from workbench import Context, Figure, Findings, Question, option

DEATH_SIGNAL_OF_PARENT = 1


def refuse() -> NoReturn:
    from cosim import SetupError

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


def hang_in_python() -> None:
    """Hang where only threads of Python notice that the parent is gone."""
    ctypes.CDLL(None).prctl(DEATH_SIGNAL_OF_PARENT, 0)
    hang()


def hang_in_c() -> None:
    """Hang where no thread of Python has a turn."""
    ctypes.PyDLL(None).sleep(1000)


MOODS: dict[str, Callable[[], Any]] = {
    "good": lambda: None,
    "warn": lambda: None,
    "refuse": refuse,
    "fail": fail,
    "exit": sys.exit,
    "segfault": segfault,
    "victim": be_killed,
    "leave": leave,
    "hang": hang,
    "hang in python": hang_in_python,
    "hang in c": hang_in_c,
    "lock": lambda: lambda: None,
}


class Plane(Question):
    x: float = option(0.0, "abscissa", "m")
    y: float = option(0.0, "ordinate")
    z: float = option(0.0, "of no effect")
    times: int = option(1, "slope in y")
    mood: str = option("good", "what becomes of the run", choices=MOODS)
    points: tuple[str, ...] = option((), "of no effect")
    gate: str = option("", "from x = 6 on a run waits for this file to open")
    ledger: str = option("", "where each run leaves a line")

    def solve(self, context: Context) -> Findings:
        """Height 3 x + times y over the point."""
        if self.ledger:
            with Path(self.ledger).open("a") as file:
                file.write(f"{self.x!r}\n")
        if self.gate and self.x >= 6.0:
            Path(self.gate).read_bytes()
        MOODS[self.mood]()
        if self.mood == "warn":
            logging.getLogger("cosim").warning(f"the plane is steep, {(self.x + 3) / 3!r} rad")
        root = (
            Figure(self.x**0.5, "m1/2", 0.0)
            if self.x >= 0.0
            else Figure.undetermined("m1/2", "x < 0")
        )
        height = Figure(3.0 * self.x + self.times * self.y, "m", 1e-3 * abs(self.x))
        high = Figure(float(self.x > 0.0), "1", 0.0)
        return Findings(
            {"height": height, "y": Figure(self.y, "m", 0.0), "root": root, "high": high}
        )


def be(task: tuple[str, str]) -> Any:
    """What a mood does, after a line with the process in a ledger."""
    mood, ledger = task
    with Path(ledger).open("a") as file:
        file.write(f"{os.getpid()}\n")
    return MOODS[mood]()


def height(task: tuple[float, str]) -> float:
    """Three times a number, with a line in a ledger; above 6 it is refused, above 7 it crashes."""
    x, ledger = task
    with Path(ledger).open("a") as file:
        file.write(f"{x!r}\n")
    if x > 6.0:
        segfault() if x > 7.0 else refuse()
    return 3.0 * x
