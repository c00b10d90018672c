"""Runs in child processes of their own: one that crashes or hangs costs its row and no more."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from cosim import SetupError

from ..fmus import ROOT

CHILD = f"{__package__}.child"
LOST = 3
OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
TRACE = 2000


class Closed(Exception):
    """The slots were closed while a run was under way."""


class Slots:
    """As many child processes as runs are asked for at a time; each does one run after the other."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._all: list[Slot] = []
        self._idle: list[Slot] = []
        self._closed = False

    def run(self, case: dict[str, Any], timeout: float | None) -> dict[str, Any]:
        """The row of a case; blocks. Raises Closed, and SetupError if no child can be started."""
        with self._lock:
            if self._closed:
                raise Closed
            slot = self._idle.pop() if self._idle else Slot(self._folder)
            if slot not in self._all:
                self._all.append(slot)
        row = slot.run(case, timeout)
        with self._lock:
            self._idle.append(slot)
        return row

    def rest(self) -> None:
        """End the child processes that do nothing."""
        with self._lock:
            idle, self._idle = self._idle, []
            self._all = [slot for slot in self._all if slot not in idle]
        for slot in idle:
            slot.close()

    def close(self) -> None:
        """End the child processes, whatever they do."""
        with self._lock:
            self._closed = True
            slots = list(self._all)
        for slot in slots:
            slot.close()


class Slot:
    """One child process, and the next one when it dies."""

    def __init__(self, folder: Path | None) -> None:
        self._base = folder
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._folder = Path()
        self._number = 0
        self._late = self._closed = False

    def run(self, case: dict[str, Any], timeout: float | None) -> dict[str, Any]:
        """The row of a case.

        A child that was killed from outside has its run done again, three times at most.
        """
        for _ in range(LOST):
            process = self._ready()
            began = time.perf_counter()
            line = self._exchange(process, json.dumps(case), timeout)
            if line:
                row: dict[str, Any] = json.loads(line)
                return row
            told = {"figures": {}, "seconds": time.perf_counter() - began, "trace": self._last()}
            death = self._buried(process)
            if self._late:
                return {"status": "timeout", "message": f"no answer after {timeout:g} s"} | told
            if death not in OUTSIDE:
                break
        text = f"the run ended its process: {death}"
        if death in OUTSIDE:
            text = f"its process was killed {LOST} times: {death}"
        return {"status": "crashed", "message": text} | told

    def close(self) -> None:
        """End the child."""
        with self._lock:
            self._closed = True
            process = self._process
        if process is not None:
            _kill(process)
            process.wait()
            shutil.rmtree(self._folder, ignore_errors=True)

    def _ready(self) -> subprocess.Popen[str]:
        """A child that waits for a case."""
        for _ in range(LOST):
            if self._process is None:
                self._start()
                assert self._process is not None
                assert self._process.stdout is not None
                if self._process.stdout.readline():
                    return self._process
            elif self._process.poll() is None:
                return self._process
            last = self._last()
            self._buried(self._process)
        why = last.strip().splitlines()[-1:]
        raise SetupError(f"no process for runs can be started: {''.join(why)}")

    def _start(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="study_", dir=self._base))
        paths = os.pathsep.join([str(ROOT), *filter(None, sys.path)])
        with self._lock, (self._folder / "stderr").open("a") as errors:
            if self._closed:
                raise Closed
            self._process = subprocess.Popen(
                [sys.executable, "-m", CHILD, str(self._folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                encoding="utf-8",
                env=os.environ | {"PYTHONPATH": paths} | dict.fromkeys(THREADS, "1"),
                start_new_session=True,
            )

    def _exchange(
        self, process: subprocess.Popen[str], case: str, timeout: float | None
    ) -> str | None:
        """What the child answers; nothing if it dies first, or is killed after the timeout."""
        assert process.stdin is not None
        assert process.stdout is not None
        self._late = False
        timer = threading.Timer(timeout or 0.0, self._expire, (process, self._number))
        try:
            process.stdin.write(case + "\n")
            process.stdin.flush()
            begun = process.stdout.readline()
            if begun and timeout is not None:
                timer.start()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        with self._lock:
            self._number += 1
            late = self._late
        timer.cancel()
        return line if line.endswith("\n") and not late else None

    def _expire(self, process: subprocess.Popen[str], number: int) -> None:
        with self._lock:
            if number == self._number:
                self._late = True
                _kill(process)

    def _last(self) -> str:
        """The last words on stderr."""
        try:
            return (self._folder / "stderr").read_text(errors="replace")[-TRACE:]
        except OSError:
            return ""

    def _buried(self, process: subprocess.Popen[str]) -> str:
        """How a child ended; what it leaves is removed."""
        code = process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        shutil.rmtree(self._folder, ignore_errors=True)
        with self._lock:
            self._process = None
            if self._closed:
                raise Closed
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def _kill(process: subprocess.Popen[str]) -> None:
    """Kill a child and what it has started."""
    try:
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
