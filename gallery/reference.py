"""The reference: the commands from their --help, the Python API from its docstrings."""

from __future__ import annotations

import inspect
import io
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout, suppress
from functools import partial
from importlib import import_module
from unittest.mock import patch

from cosim.cli.main import parser
from scenarios.__main__ import PROJECT
from scenarios.fmu_files import CLONE as ROOT
from workbench.cli import main

PROGRAM = "scenarios"
API = {
    "cosim": ("The master", ()),
    "workbench": ("Questions", ("measure", "live", "charts.motion")),
    "fmukit": ("Machines", ("runtime.hybrid", "runtime.flow", "runtime.jet")),
}
SCRIPTS = {
    "python build_fmus.py": ["build_fmus.py"],
    "fmukit build": ["-m", "fmukit", "build"],
    "python -m gallery": ["-m", "gallery"],
}


def commands() -> str:
    """The page of the commands; the options of a question are on its own page."""
    parts = [
        "# Commands\n\nThe help of every command. The options of a question are on its own page."
    ]
    coupling = parser()
    for name in coupling._actions[-1].choices or ():
        said = help_of(partial(coupling.parse_args, [name, "--help"]))
        parts.append(section(f"cosim {name}", said))
    for name in ("run", "study"):
        said = help_of(partial(main, [name, "--help"], PROJECT, PROGRAM))
        parts.append(section(f"scenarios {name}", said))
    for name, words in SCRIPTS.items():
        command = [sys.executable, *words, "--help"]
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | {"COLUMNS": "88"}, check=True, capture_output=True
        )
        parts.append(section(name, done.stdout.decode()))
    return "\n\n".join(parts) + "\n"


def section(title: str, said: str) -> str:
    return f"## `{title}`\n\n```text\n{said.strip()}\n```"


def question(name: str) -> str:
    """The options of a question, as its command lists them."""
    said = help_of(partial(main, ["run", name, "--help"], PROJECT, PROGRAM))
    return said[said.index("options:") :].strip()


def help_of(call: Callable[[], object]) -> str:
    """What a parser prints before it exits."""
    said = io.StringIO()
    with patch.dict(os.environ, COLUMNS="88"), redirect_stdout(said), suppress(SystemExit):
        call()
    return said.getvalue()


def api(package: str) -> str:
    """The page of a package: its public names, in a table and in detail."""
    title, modules = API[package]
    module = import_module(package)
    public = sorted(set(module.__all__) - {"VERSION"}, key=str.lower)
    rows = [
        f"# {title}: `{package}`\n\n{inspect.getdoc(module)}\n\n| name | what it is |\n| --- | --- |"
    ]
    rows[0] += "".join(
        f"\n| [`{name}`](#{package}.{name}) | {first(getattr(module, name))} |" for name in public
    )
    blocks = "\n".join(line for name in public for line in directive(package, name))
    rows.append(f"## Details\n\n```{{eval-rst}}\n{blocks}\n```")
    for name in modules:
        whole = f"{package}.{name}"
        rows.append(f"## `{whole}`\n\n```{{eval-rst}}\n.. automodule:: {whole}\n```")
    return "\n\n".join(rows) + "\n"


def first(thing: object) -> str:
    """What a thing is: the first sentence of its docstring, or its value."""
    if not callable(thing):
        return f"`{thing!r}`"
    words = " ".join((inspect.getdoc(thing) or "").split())
    return re.split(r"(?<=\.)\s", words)[0].replace("|", "\\|")


def directive(package: str, name: str) -> Iterator[str]:
    thing = getattr(import_module(package), name)
    if inspect.isclass(thing) or callable(thing):
        yield f".. auto{'class' if inspect.isclass(thing) else 'function'}:: {package}.{name}"
    else:
        yield f".. py:data:: {package}.{name}\n   :value: {thing!r}\n"
