"""JavaScript outside of a page: in node, or where that is not installed, in Chromium."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.workbench.browser import browser

Evaluate = Callable[[str], Any]
EMPTY = "<!doctype html><html data-ready='yes'>"
#: as JSON, which has no NaN, but null
PRINT = "process.stdout.write(JSON.stringify({{ value: (() => {{ {} }})() }}))"


@contextmanager
def evaluator(folder: Path) -> Iterator[Evaluate | None]:
    """A function that returns what the body of a function of JavaScript returns; None where nothing runs it."""
    node, chromium = shutil.which("node"), shutil.which("chromium")
    if node is not None:
        yield lambda body: _in_node(node, folder, body)
    elif chromium is not None:
        (folder / "empty.html").write_text(EMPTY)
        with browser(chromium, folder / "home") as page:
            page.open(folder / "empty.html", 1000)
            yield lambda body: page.value(f"(() => {{ {body} }})()")
    else:
        yield None


def _in_node(node: str, folder: Path, body: str) -> Any:
    script = folder / "script.js"
    script.write_text(PRINT.format(body), encoding="utf-8")
    done = subprocess.run([node, str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout).get("value")
