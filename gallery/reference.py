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
from scenarios.fmu_files import CLONE as ROOT
from scenarios.project import PROJECT
from workbench.cli import main

PROGRAM = "scenarios"
API = {
    "cosim": ("The master", ()),
    "workbench": ("Questions", ("live", "charts.motion")),
    "fmukit": ("Machines", ("runtime.hybrid", "runtime.flow", "runtime.jet")),
}
SCRIPTS = {
    "python build_fmus.py": ["build_fmus.py"],
    "fmukit build": ["-m", "fmukit", "build"],
    "python -m gallery": ["-m", "gallery"],
}


def commands_page() -> str:
    """The page of the commands; the options of a question are on its own page."""
    parts = [
        "# Commands\n\nThe help of every command. The options of a question are on its own page."
    ]
    coupling = parser()
    for name in coupling._actions[-1].choices or ():
        help_text = help_of(partial(coupling.parse_args, [name, "--help"]))
        parts.append(section(f"cosim {name}", help_text))
    for name in ("run", "study"):
        help_text = help_of(partial(main, [name, "--help"], PROJECT, PROGRAM))
        parts.append(section(f"scenarios {name}", help_text))
    for name, arguments in SCRIPTS.items():
        command = [sys.executable, *arguments, "--help"]
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | {"COLUMNS": "88"}, check=True, capture_output=True
        )
        parts.append(section(name, done.stdout.decode()))
    return "\n\n".join(parts) + "\n"


def section(title: str, help_text: str) -> str:
    """The help of a command, below its name."""
    return f"## `{title}`\n\n```text\n{help_text.strip()}\n```"


def question_options(name: str) -> str:
    """The options of a question, as its command lists them."""
    help_text = help_of(partial(main, ["run", name, "--help"], PROJECT, PROGRAM))
    return help_text[help_text.index("options:") :].strip()


def help_of(call: Callable[[], object]) -> str:
    """What a parser prints before it exits."""
    help_text = io.StringIO()
    with patch.dict(os.environ, COLUMNS="88"), redirect_stdout(help_text), suppress(SystemExit):
        call()
    return help_text.getvalue()


def package_page(package: str) -> str:
    """The page of a package: its public names, in a table and in detail."""
    title, modules = API[package]
    module = import_module(package)
    public = sorted(set(module.__all__) - {"VERSION"}, key=lambda name: (name.lower(), name))
    rows = [
        f"# {title}: `{package}`\n\n{inspect.getdoc(module)}\n\n| name | what it is |\n| --- | --- |"
    ]
    rows[0] += "".join(
        f"\n| [`{name}`](#{package}.{name}) | {first_sentence(getattr(module, name))} |"
        for name in public
    )
    blocks = "\n".join(line for name in public for line in directive(package, name))
    rows.append(f"## Details\n\n```{{eval-rst}}\n{blocks}\n```")
    for name in modules:
        qualified_name = f"{package}.{name}"
        rows.append(
            f"## `{qualified_name}`\n\n```{{eval-rst}}\n.. automodule:: {qualified_name}\n"
            f"   :exclude-members: {', '.join(public)}\n```"
        )
    return "\n\n".join(rows) + "\n"


def first_sentence(member: object) -> str:
    """What a thing is: the first sentence of its docstring, or its value."""
    if not callable(member):
        return f"`{member!r}`"
    sentence = " ".join((inspect.getdoc(member) or "").split())
    return re.split(r"(?<=\.)\s", sentence)[0].replace("|", "\\|")


def directive(package: str, name: str) -> Iterator[str]:
    """The lines that have Sphinx document a public name, by its docstring or by its value."""
    member = getattr(import_module(package), name)
    if inspect.isclass(member) or callable(member):
        yield f".. auto{'class' if inspect.isclass(member) else 'function'}:: {package}.{name}"
    else:
        yield f".. py:data:: {package}.{name}\n   :value: {member!r}\n"
