"""Signals that ask a program to stop: Ctrl-C, and what batch systems and closed terminals send."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def handle_stop_signals(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Call this function for signals that ask to stop, as far as they are not ignored.

    A handler that is not Python's own, as a program in C installs one, could not be put back: it stays.
    Only the main thread can; where Ctrl-C is ignored, as in the children of a pool, nothing changes.
    """
    elsewhere = threading.current_thread() is not threading.main_thread()
    if elsewhere or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield
        return
    free = [n for n in STOPS if signal.getsignal(n) not in (signal.SIG_IGN, None)]
    before = {number: signal.signal(number, handler) for number in free}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def reinstall_handlers() -> None:
    """Install what hears these signals anew, in place of what an FMU may have put there."""
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            if (handler := signal.getsignal(number)) is not None:
                signal.signal(number, handler)


@contextmanager
def collect_interrupts() -> Iterator[list[int]]:
    """A list that fills with the signals that ask to stop, so that no FMU is left half-way."""
    received: list[int] = []
    with handle_stop_signals(lambda number, _: received.append(number)):
        yield received
