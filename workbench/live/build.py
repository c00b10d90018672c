"""What the browser gets of a question's live part: its modules, its scripts, and data.

Everything declared is checked here, with the values of the answer, so that a mistake is one line when the page
is made and never a page that does not work.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim import SetupError
from cosim.system import connect

from ..answer import LivePart
from ..formula import Formula
from ..options import Options, declared
from ..page.script import compact
from .declare import Formulas, Live
from .encoder import LiveEncoder, numeric

if TYPE_CHECKING:
    from ..answer import Findings

FOLDER = Path(__file__).with_name("js")
#: scripts of the worker, which computes, and of the page, which draws, in the sequence that they need
WORKER = ("formula.js", "readers.js", "master.js", "model.js", "worker.js")
PAGE = ("curves.js", "motion.js", "page.js")


@cache
def script(names: tuple[str, ...]) -> str:
    """Return script files one after the other, without comments and indents."""
    text = "\n".join((FOLDER / name).read_text(encoding="utf-8") for name in names)
    return compact(text)


def of(
    live: Any,
    o: Options,
    findings: Findings,
    modules: Mapping[str, Path],
    command: str,
) -> LivePart | str | None:
    """Return the live part of an answer.

    Parameters
    ----------
    live : Live, str or None
        What `live` of a question returns.
    o : Options
        The options of the answer.
    findings : Findings
        What the question found.
    modules : mapping of str to Path
        The WebAssembly modules by part.
    command : str
        The start of the command line that asks the question.

    Returns
    -------
    LivePart, str or None
        Why the page has no sliders where the question says so; None where it declares no live part, or a module of its
        parts does not exist.

    Raises
    ------
    SetupError
        If the declaration does not fit the question and its FMUs.
    """
    if live is None or findings.system is None or not set(findings.system.parts) <= set(modules):
        return None
    if isinstance(live, str):
        return live
    if not isinstance(live, Live):
        raise SetupError("live(self, f, r) must return a workbench.live.Live")
    network = connect(findings.system)
    encoder = LiveEncoder(network, o, findings, live)
    options = declared(type(o))
    values = {name: getattr(o, name) for name in options}
    changed = {
        name: x for name, x in values.items() if x != options[name].read(options[name].default)
    }
    data = encoder.page_data() | {
        "command": [command, *(_command_line_option(name, x) for name, x in changed.items())],
        "given": {name: for_shell(f"{name}={value}") for name, value in o.given_start.items()},
        "user": numeric((port, x) for port, x in network.start if port.name in o.start),
        "adapted": [
            name for name, text in live.start.items() if name in names_behind(text, live.values)
        ],
    }
    worker = f'"use strict";\n{script(WORKER)}\n{encoder.formula_functions()}'
    contents = {part: modules[part].read_bytes() for part in network.descriptions}
    return LivePart(contents, worker, script(PAGE), data)


def names_behind(text: str | float, values: Formulas) -> frozenset[str]:
    """Return the names that a formula uses, and those behind the values among them."""
    names = Formula.read(text).names
    return names.union(*(names_behind(values[name], values) for name in names & values.keys()))


def for_shell(word: str) -> str:
    """Return a word as command lines take it, in double quotes where they do in any shell."""
    is_plain = re.fullmatch(r"[\w.,:=+/%@-]+", word)
    return word if is_plain else shlex.quote(word) if re.search(r'["$`\\!]', word) else f'"{word}"'


def _command_line_option(name: str, value: Any) -> str:
    """An option as a command line has it."""
    flag = f"--{name.replace('_', '-')}"
    if isinstance(value, bool):
        return flag if value else f"--no-{flag[2:]}"
    if isinstance(value, tuple):
        value = ",".join(map(str, value))
    return f"{flag} {for_shell(str(value))}"
