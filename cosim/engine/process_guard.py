"""What an FMU shares with its whole process: rounding, folder, locale, signal handlers."""

from __future__ import annotations

import ctypes
import locale
import os
import sys
import time as clock
from contextlib import suppress

from ..errors import FmuError
from ..signals import reinstall_handlers

#: Seconds between two looks at all that FMUs may have changed. A convention: a look takes some 10 us.
BETWEEN = 0.1
#: A convention of IEEE 754: the smallest number above 0, which is subnormal.
SUBNORMAL = 5e-324
#: Derived from the largest fenv_t known, 256 bytes of 32-bit x86 with all extensions.
ENVIRONMENT_BYTES = 256
C = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


class ProcessGuard:
    """Keeps these as they were when it was made, by `restore`; `warnings` reports what had to be restored."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self._rounding, self._locale = C.fegetround(), locale.setlocale(locale.LC_ALL)
        self._environment, self._flushes = (
            ctypes.create_string_buffer(ENVIRONMENT_BYTES),
            _flushes(),
        )
        C.fegetenv(self._environment)
        self._folder = _folder()
        self._looked = clock.perf_counter()

    def restore(self) -> None:
        """Bring back what an FMU has changed."""
        self._looked = clock.perf_counter()
        reinstall_handlers()
        if self._folder is not None and _folder() != self._folder:
            with suppress(OSError):
                os.chdir(self._folder)
            self._warn("the working directory")
        if locale.setlocale(locale.LC_ALL) != self._locale:
            locale.setlocale(locale.LC_ALL, self._locale)
            self._warn("the locale")
        if C.fegetround() != self._rounding:
            C.fesetround(self._rounding)
            self._warn("the rounding of floating-point numbers")
        if _flushes() != self._flushes:
            C.fesetenv(self._environment)
            self._warn("the treatment of subnormal floating-point numbers (FTZ, DAZ)")

    def require_unchanged_arithmetic_at_times(self) -> None:
        """Look at the arithmetic, and now and then at all; raises FmuError if numbers were computed otherwise."""
        is_changed = (C.fegetround(), _flushes()) != (self._rounding, self._flushes)
        if is_changed or clock.perf_counter() > self._looked + BETWEEN:
            self.require_unchanged_arithmetic()

    def require_unchanged_arithmetic(self) -> None:
        """Restore all that FMUs have changed; raises FmuError if numbers were computed otherwise."""
        arithmetic = C.fegetround(), _flushes()
        self.restore()
        if arithmetic != (self._rounding, self._flushes):
            raise FmuError(self.warnings[-1])

    def _warn(self, what: str) -> None:
        sentence = f"an FMU has changed {what} of the whole process; it was restored"
        if sentence not in self.warnings:
            self.warnings.append(sentence)


def _flushes() -> tuple[bool, bool]:
    """Whether the processor takes subnormal results, and subnormal operands, as zero."""
    smallest, half = sys.float_info.min, 0.5
    return smallest * half == 0.0, SUBNORMAL == 0.0


def _folder() -> str | None:
    """The working directory; None if it has been removed."""
    with suppress(FileNotFoundError):
        return os.getcwd()  # noqa: PTH109 (a Path takes twenty calls)
    return None
