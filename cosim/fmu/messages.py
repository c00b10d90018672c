"""What an instance of an FMU logs: its last lines, its warnings, and what it complained of."""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..system.description import ModelDescription

#: Sentences that a part may add to a result. A convention: more are the same fault again.
MOST_WARNINGS = 100
#: Lines of its log that a part keeps for the reason of a failure. A convention: only the last is quoted.
MOST_LINES = 20
#: A reference to a variable in a message, and an escaped sharp. A convention of FMI 2.0.
REFERENCE = re.compile(r"#(?:([ribs])(\d{1,10})#|#)")
#: The call did what it should: fmi2OK and fmi3OK, a convention of FMI.
OK = 0
#: It did, and a message says what may be wrong: fmi2Warning and fmi3Warning, a convention of FMI.
WARNING = 1
#: It could not be done for these values: fmi2Discard and fmi3Discard, a convention of FMI.
DISCARD = 2
#: The instance cannot go on: fmi2Error and fmi3Error, a convention of FMI.
ERROR = 3
#: No instance of the FMU can go on: fmi2Fatal and fmi3Fatal, a convention of FMI.
FATAL = 4
#: The names of the statuses in messages, by number.
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

log = logging.getLogger("cosim")


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the warnings of FMUs out of the log; they are still in the results."""
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


class MessageLog:
    """The messages of the part with this name; `warnings` are those for the result.

    `on_warning`, if any, takes each warning too, with the name.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._names: dict[tuple[str, int], str] = {}
        self.on_warning: Callable[[str, str], None] | None = None
        self.clear()

    def describe(self, description: ModelDescription) -> None:
        """Learn the names of the variables of an FMU of FMI 2.0, whose messages may refer to them, #r12# to a Real."""
        if description.fmiVersion == "2.0":
            for v in reversed(description.modelVariables):
                letter = "i" if v.type == "Enumeration" else v.type[0].lower()
                self._names[letter, v.valueReference] = v.name

    def _named(self, line: str) -> str:
        """A line with names in place of references, and # in place of ##, by FMI 2.0.4, 2.1.5."""
        return (
            REFERENCE.sub(lambda m: self._names.get((m[1], int(m[2])), m[0]) if m[1] else "#", line)
            if self._names
            else line
        )

    def clear(self) -> None:
        """Forget what the instance has logged, which begins anew."""
        self.warnings: list[str] = []
        self._left_out = 0
        self._lines: deque[str] = deque(maxlen=MOST_LINES)
        self._complaint = ""

    def on_log(self, status: int, message: bytes | None) -> None:
        """Keep the last line of a log message, without the name that FMUs may put before it."""
        for line in (message or b"").decode("utf-8", "replace").strip().splitlines()[-1:]:
            text = re.sub(rf"(^|; )({re.escape(self.name)}: )+", r"\1", self._named(line))
            self._lines.append(text)
            if status == WARNING:
                self.keep_warning(text)
            if status in (ERROR, FATAL):
                self._complaint = text

    def keep_warning(self, text: str) -> None:
        """Log a warning and keep it for the result, each sentence once."""
        if self.on_warning is not None:
            self.on_warning(self.name, text)
        if text in self.warnings:
            return
        if len(self.warnings) < MOST_WARNINGS:
            self.warnings.append(text)
            log.warning("%s: %s", self.name, text)
            return
        self._left_out += 1
        self.warnings[MOST_WARNINGS:] = [f"and {self._left_out} more, not listed"]

    def last(self) -> str:
        """What the FMU last complained of, or else logged; empty if it has logged nothing."""
        return self._complaint or (self._lines[-1] if self._lines else "")

    def reason(self) -> str:
        """The same as a sentence for an error."""
        return self.last() or "the FMU gives no reason"
