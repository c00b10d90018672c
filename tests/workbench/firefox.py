"""Firefox without a window, driven through Marionette, its own protocol."""

from __future__ import annotations

import json
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATIENCE = 60.0


class Firefox:
    """One page at a time."""

    def __init__(self, port: int) -> None:
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE)
                break
            except ConnectionRefusedError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        self._rest, self._count = b"", 0
        self._next()
        self.call("WebDriver:NewSession", capabilities={})

    def _next(self) -> Any:
        """The next message: its length, a colon, JSON."""
        while b":" not in self._rest or len(self._rest) < self._end():
            more = self._socket.recv(1 << 16)
            if not more:
                raise RuntimeError("the browser does not answer")
            self._rest += more
        end = self._end()
        message, self._rest = self._rest[self._rest.index(b":") + 1 : end], self._rest[end:]
        return json.loads(message)

    def _end(self) -> int:
        head = self._rest.partition(b":")[0]
        return len(head) + 1 + int(head)

    def call(self, method: str, **parameters: Any) -> Any:
        """The answer to a method of the protocol."""
        self._count += 1
        text = json.dumps([0, self._count, method, parameters]).encode()
        self._socket.sendall(b"%d:%s" % (len(text), text))
        _, _, error, result = self._next()
        if error:
            raise RuntimeError(f"{method}: {error['message']}")
        return result

    def open(self, path: Path) -> None:
        """Open a page that says when it is ready."""
        self.call("WebDriver:Navigate", url=path.resolve().as_uri())
        self.until("document.documentElement?.dataset.ready === 'yes'")

    def value(self, expression: str) -> Any:
        """The value of an expression in the page."""
        return self.call("WebDriver:ExecuteScript", script=f"return {expression}", args=[])["value"]

    def until(self, holds: str) -> None:
        """Wait until an expression is true in the page."""
        deadline = time.monotonic() + PATIENCE
        while not self.value(holds):
            if time.monotonic() > deadline:
                raise RuntimeError(f"not true within {PATIENCE} s: {holds}")
            time.sleep(0.05)


@contextmanager
def firefox(program: str, home: Path) -> Iterator[Firefox]:
    """A browser whose files stay in a folder."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    home.mkdir()
    (home / "user.js").write_text(f'user_pref("marionette.port", {port});\n')
    process = subprocess.Popen(
        [program, "--headless", "--marionette", "--no-remote", "--profile", str(home)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        page = Firefox(port)
        yield page
        page.call("Marionette:Quit", flags=["eForceQuit"])
        process.wait(timeout=20)
    finally:
        process.kill()
        process.wait()
