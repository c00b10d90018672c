"""Run FMUs in a separate process, so that a crash of one ends only that process."""

from __future__ import annotations

import json
import logging
import math
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from logging.handlers import QueueHandler
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from .child import GRACE, Child, Death, child, progress_sender
from .engine.settings import RunSettings
from .engine.setup import Setup
from .engine.system_instance import SystemInstance
from .errors import SetupError, pluralize
from .fmu.messages import log, quiet
from .master import run
from .result import Interrupted, Result, SimulationError, file_columns, partial, write_json
from .series import described_columns
from .signals import collect_interrupts
from .system import System, connect

#: Longest wait for a message before signals and time limits are looked at [s]: a convention of this project,
#: which limits how soon Ctrl-C is passed on.
PIPE_PATIENCE = 0.1


def run_isolated(
    system: System,
    *,
    csv: Path | str,
    progress: Callable[[float], None] | None = None,
    timeout: float = math.inf,
    **settings: Any,
) -> Result:
    """Do what `run` does with its `settings`, but in a child process; the rows are streamed to `csv`.

    Ctrl-C ends the child, a second one kills it, and so does SIGTERM or SIGHUP after a while; the rows
    are kept in each case. If this process dies, so does the child. As always with child processes, a
    script needs `if __name__ == "__main__"`.

    Raises what `run` does; SimulationError, with the rows that reached the file, also if an FMU ends the process or takes
    longer than `timeout` [s] for a step or than GRACE to close; and before the first step SetupError if the process
    ends, KeyboardInterrupt after Ctrl-C.
    """
    if not timeout > 0.0:
        raise SetupError(f"timeout = {timeout!r} s must be above 0")
    csv = Path(csv).absolute()
    before = _stamps(csv)
    log_records: list[logging.LogRecord] = []
    ended = ""
    with (
        collect_interrupts() as pressed,
        child(_work, system, csv, settings, grace_seconds=GRACE) as one,
    ):
        for message in _messages(one, pressed, timeout=timeout, csv=csv, before=before):
            if isinstance(message, Death):
                ended = message.how
                continue
            kind, content = message
            if kind == "progress" and progress is not None:
                progress(content)
            elif kind == "log":
                log_records.append(content)
                if (logger := logging.getLogger(content.name)).isEnabledFor(content.levelno):
                    logger.handle(content)
            elif kind == "end":
                error, text, columns, breaks, facts, path = content
                result = Result(columns, facts, file_columns(path), breaks=breaks)
                if error is not None:
                    raise error(text, result)
                return result
            elif kind == "error":
                raise content
    dead = f"the process that ran the parts {', '.join(system.parts)} {ended}"
    after = _stamps(csv)
    if before == after:
        if pressed:
            raise KeyboardInterrupt(dead)
        raise SetupError(f"{dead} before the first step")
    warnings = [record.getMessage() for record in log_records if record.name == log.name]
    path = csv if before[1] != after[1] else partial(csv)
    raise _error_with_rows(path, dead, warnings, pressed=bool(pressed))


def begin_isolated(system: System, settings: RunSettings) -> None:
    """Bring a system to its start in a child process, as a run does before its first step.

    Parameters
    ----------
    system : System
        What is begun.
    settings : RunSettings
        How it would be run.

    Raises
    ------
    SetupError
        For what `run` refuses before the first step, and if an FMU ends the process.
    """
    with child(_begin_in_child, system, settings, grace_seconds=GRACE) as one:
        error = next(one.messages(math.inf))
    if isinstance(error, Death):
        parts = ", ".join(system.parts)
        raise SetupError(
            f"the process that ran the parts {parts} {error.how} before the first step"
        )
    if error is not None:
        raise error


def _begin_in_child(pipe: Connection, system: System, settings: RunSettings) -> None:
    """Begin in the child and tell the parent what is refused, or None."""
    with suppress(BrokenPipeError), quiet():
        try:
            setup = Setup.of(connect(system), settings)
            with closing(SystemInstance(setup)) as instance:
                instance.begin(setup)
        except SetupError as error:
            pipe.send(error)
        else:
            pipe.send(None)


def _work(pipe: Connection, system: System, csv: Path, settings: dict[str, Any]) -> None:
    """Run in the child and tell the parent of the progress, the log and the end."""
    signal.signal(signal.SIGINT, lambda *_: None)
    to_parent: Any = SimpleNamespace(put_nowait=lambda record: pipe.send(("log", record)))
    logging.getLogger().addHandler(QueueHandler(to_parent))
    progress = progress_sender(pipe)
    progress(0.0)
    with suppress(BrokenPipeError):
        ended: SimulationError | Interrupted | None = None
        try:
            result = run(system, csv=csv, progress=progress, **settings)
        except (SimulationError, Interrupted) as error:
            ended, result = error, error.result
        except BrokenPipeError:
            raise
        except Exception as error:  # noqa: BLE001
            pipe.send(("error", error))
            return
        else:
            pipe.send(("progress", 1.0))
        facts = (result.columns, result.breaks, result.provenance)
        path = partial(csv) if ended else csv
        pipe.send(("end", (ended and type(ended), str(ended), *facts, path)))


def _messages(
    one: Child, pressed: Sequence[int], *, timeout: float, csv: Path, before: list[int]
) -> Iterator[Any]:
    """What the child sends until it ends; passes Ctrl-C on until it reacts."""
    while True:
        one.limit = GRACE
        if one.left() != 0.0 or not _is_run_over(csv, before):
            one.limit = timeout
        for message in one.messages(PIPE_PATIENCE):
            yield message
            if isinstance(message, Death):
                return
        one.pass_on(pressed)


def _stamps(csv: Path) -> list[int]:
    """When the facts of a partial and of a complete run were written last [ns]."""
    facts = [path.with_suffix(".json") for path in (partial(csv), csv)]
    return [path.stat().st_mtime_ns if path.exists() else 0 for path in facts]


def _is_run_over(csv: Path, before: list[int]) -> bool:
    """Whether the run has come to an end and only closes its parts."""
    after = _stamps(csv)
    if after[1] != before[1]:
        return True
    with suppress(OSError, ValueError):
        facts = partial(csv).with_suffix(".json")
        return after[0] != before[0] and json.loads(facts.read_text())["status"] != "running"
    return False


def _error_with_rows(
    path: Path, dead: str, warnings: list[str], *, pressed: bool
) -> SimulationError | Interrupted:
    """The error for a child that died, with the rows in its file, which is left readable."""
    content = path.read_bytes()
    complete_lines = content[: content.rfind(b"\n") + 1]
    path.write_bytes(complete_lines)
    header, *rows = complete_lines.decode().splitlines()
    facts = json.loads(path.with_suffix(".json").read_text())
    facts = {"bonds": {}, "warnings": warnings} | facts
    reached = float(rows[-1].split(",")[0]) if rows else facts["start"]
    if facts["status"] == "running":
        facts["status"] = "interrupted" if pressed else "failed"
        facts |= {"reason": dead, "reached": reached}
    elif facts["status"] == "complete":
        dead = f"{dead} when it closed them"
    else:
        dead = f"{facts['reason']}; {dead}"
    write_json(path.with_suffix(".json"), facts)
    columns = described_columns(header.split(","), facts.pop("units"), facts.pop("kinds", {}))
    breaks = np.reshape(facts.pop("breaks", []), (-1, 2))
    result = Result(columns, facts, file_columns(path), breaks=breaks)
    text = f"{dead} after t = {reached!r} s, {pluralize(len(rows), 'row')} in {path.name}"
    return Interrupted(text, result) if pressed else SimulationError(text, result)
