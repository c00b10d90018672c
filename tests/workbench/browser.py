"""Chromium without a window, driven through its debugging pipe."""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATIENCE = 60.0
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync "
    "--disable-background-networking --disable-component-update --remote-debugging-pipe"
)


class Browser:
    """One page at a time; `events` holds what the browser reported since the page was opened."""

    def __init__(self, write: int, read: int) -> None:
        self._write, self._read = write, read
        self._count, self._rest = 0, b""
        self._session: dict[str, str] = {}
        self._open = ""
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
        return dict(json.loads(message))

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer of the browser to a method of its protocol."""
        self._count += 1
        call = {"id": self._count, "method": method, "params": parameters} | self._session
        os.write(self._write, json.dumps(call).encode() + b"\0")
        while (reply := self._next()).get("id") != self._count:
            self.events.append(reply)
        if "error" in reply:
            raise RuntimeError(f"{method}: {reply['error']['message']}")
        return dict(reply["result"])

    def open(self, path: Path, width: int) -> None:
        """Open a page that says when it is ready, in place of the one before."""
        before, self._session, self.events = self._open, {}, []
        self._open = self.call("Target.createTarget", url="about:blank")["targetId"]
        if before:
            self.call("Target.closeTarget", targetId=before)
        attached = self.call("Target.attachToTarget", targetId=self._open, flatten=True)
        self._session = {"sessionId": attached["sessionId"]}
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(width)
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.until("document.documentElement?.dataset.ready === 'yes'")

    def resize(self, width: int) -> None:
        """Give the screen another width."""
        screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **screen)
        self.call("Emulation.setTouchEmulationEnabled", enabled=width < 600)

    def value(self, expression: str) -> Any:
        """The value of an expression in the page; promises are waited for."""
        wanted = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        reply = self.call("Runtime.evaluate", **wanted)
        if "exceptionDetails" in reply:
            raise RuntimeError(f"{expression}: {reply['exceptionDetails']}")
        return reply["result"].get("value")

    def until(self, holds: str | Callable[[], object]) -> None:
        """Wait until an expression is true in the page, or something holds outside it."""
        deadline = time.monotonic() + PATIENCE
        while not (self.value(holds) if isinstance(holds, str) else holds()):
            if time.monotonic() > deadline:
                raise RuntimeError(f"not true within {PATIENCE} s: {holds}")
            time.sleep(0.02)

    def reported(self, method: str) -> list[dict[str, Any]]:
        """The parameters of the events of a method so far."""
        self.value("1")
        return [event["params"] for event in self.events if event.get("method") == method]


@contextmanager
def browser(program: str, home: Path) -> Iterator[Browser]:
    """A browser whose files stay in a folder."""
    (orders, write), (read, replies) = os.pipe(), os.pipe()
    process = subprocess.Popen(
        ["bash", "-c", f'exec "$@" 3<&{orders} 4>&{replies}', "bash", program, *FLAGS.split(),
         f"--user-data-dir={home}"],
        pass_fds=(orders, replies), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(orders)
    os.close(replies)
    try:
        page = Browser(write, read)
        yield page
        page._session = {}
        page.call("Browser.close")
        process.wait(timeout=PATIENCE)
    finally:
        os.close(read)
        os.close(write)
        process.kill()
        process.wait()
