"""Chromium without a window, driven through its debugging pipe."""

from __future__ import annotations

import base64
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATIENCE = 60.0
LAUNCH = """import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]
for end, number in zip(ends, (3, 4)):
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])"""


class Browser:
    """One page at a time; `events` holds what the browser reported since the page was opened."""

    def __init__(self, write: int, read: int) -> None:
        self._write, self._read = write, read
        self._count, self._rest = 0, b""
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []

    def _next(self) -> dict[str, Any]:
        """The next message of the browser, each of which ends with a zero byte."""
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._read], [], [], PATIENCE)
            more = os.read(self._read, 1 << 20) if ready else b""
            if not more:
                raise RuntimeError("the browser does not answer")
            self._rest += more
        message, self._rest = self._rest.split(b"\0", 1)
        told: dict[str, Any] = json.loads(message)
        return told

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer of the browser to a method of its protocol."""
        self._count += 1
        call = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            call["sessionId"] = self._session
        os.write(self._write, json.dumps(call).encode() + b"\0")
        while (told := self._next()).get("id") != self._count:
            self.events.append(told)
        if "error" in told:
            raise RuntimeError(f"{method}: {told['error']['message']}")
        answer: dict[str, Any] = told["result"]
        return answer

    def open(self, path: Path, width: int, height: int) -> None:
        """Open a page that says when it is ready."""
        self._session, self.events = None, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(width, height)
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.until("document.documentElement?.dataset.ready === 'yes'")

    def resize(self, width: int, height: int) -> None:
        """Give the screen another size."""
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **screen)
        self.call("Emulation.setTouchEmulationEnabled", enabled=width < 600)

    def value(self, expression: str) -> Any:
        """The value of an expression in the page; promises are waited for."""
        told = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in told:
            raise RuntimeError(f"{expression}: {told['exceptionDetails']}")
        return told["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression is true."""
        self.until_here(lambda: self.value(expression), expression)

    def until_here(self, holds: Callable[[], object], what: str = "") -> None:
        """Wait until something holds outside the page."""
        deadline = time.monotonic() + PATIENCE
        while not holds():
            if time.monotonic() > deadline:
                raise RuntimeError(f"not true within {PATIENCE} s: {what}")
            time.sleep(0.02)

    def told(self, method: str) -> list[dict[str, Any]]:
        """The parameters of the events of a method so far."""
        self.value("1")
        return [event["params"] for event in self.events if event.get("method") == method]

    def pdf(self) -> bytes:
        """The page as it is printed."""
        return base64.b64decode(self.call("Page.printToPDF", printBackground=True)["data"])


@contextmanager
def browser(program: str, home: Path) -> Iterator[Browser]:
    """A browser whose files stay in a folder."""
    reads, writes = os.pipe(), os.pipe()
    flags = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync "
        "--disable-background-networking --disable-component-update --remote-debugging-pipe"
    )
    pipes = [str(reads[0]), str(writes[1])]
    process = subprocess.Popen(
        [sys.executable, "-c", LAUNCH, *pipes, program, *flags.split(), f"--user-data-dir={home}"],
        pass_fds=(reads[0], writes[1]),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(reads[0])
    os.close(writes[1])
    try:
        page = Browser(reads[1], writes[0])
        yield page
        page._session = None
        page.call("Browser.close")
    finally:
        os.close(reads[1])
        os.close(writes[0])
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
