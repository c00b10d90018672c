"""What is public changes only on purpose: names with signatures, commands, exit statuses, JSON keys, columns.

`tests/public.txt` lists them. Who changes one writes the list again, python tests/test_public.py, and a file
into `docs/changes`.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

LIST = Path(__file__).with_name("public.txt")
PACKAGES = ("cosim", "fmukit", "scenarios", "workbench")


def interface() -> Iterator[str]:
    """A line for each public thing."""
    from cosim.cli.main import COMMANDS
    from scenarios.project import PROJECT
    from workbench import cli
    from workbench.catalog import names

    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in sorted(module.__all__):
            yield f"{package}.{name}{signature(getattr(module, name))}"
    yield from (f"command: cosim {name}" for name in sorted(COMMANDS))
    yield from (f"command: scenarios {name}" for name in sorted(cli.COMMANDS))
    yield "command: fmukit build"
    yield "command: drive-fmus"
    yield from (f"question: {name}" for name in names(PROJECT.home))
    yield f"exit status of a refused answer: {cli.REFUSED}"


def signature(value: object) -> str:
    """The parameters of a function or class in every version of Python alike: their names, which are given
    by name only, and which may be left out.
    """
    if not callable(value):
        return ""
    try:
        parameters = inspect.signature(value).parameters.values()
    except ValueError:
        return ""
    texts, named = [], False
    for parameter in parameters:
        if parameter.kind is parameter.KEYWORD_ONLY and not named:
            named = True
            texts.append("*")
        stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        optional = "=" * (parameter.default is not parameter.empty)
        texts.append(f"{stars}{parameter.name}{optional}")
    return f"({', '.join(texts)})"


def test_the_public_interface_is_that_which_is_listed() -> None:
    listed, actual = LIST.read_text(encoding="utf-8").splitlines(), list(interface())
    gone = [line for line in listed if line not in actual]
    new = [line for line in actual if line not in listed]
    assert not gone and not new, (
        f"gone or changed: {gone}\nnew: {new}\n"
        "write tests/public.txt again with `python tests/test_public.py` and a file in docs/changes"
    )


def test_an_answer_has_the_keys_that_are_documented() -> None:
    from tests.conftest import plain
    from workbench.export import content

    keys = set(content(plain("orientator_cycle")))
    assert {
        "scenario", "question", "verdict", "refused", "warnings", "figures", "options", "parameters",
        "units", "wires", "parts", "algorithm", "versions", "flavour",
    } <= keys  # fmt: skip


if __name__ == "__main__":
    LIST.write_text("".join(f"{line}\n" for line in interface()), encoding="utf-8")
