"""The examples in docstrings give what they say."""

import doctest
import importlib
from collections.abc import Iterator
from types import ModuleType

import pytest

from tests.conftest import ROOT

PACKAGES = ("cosim", "fmukit", "scenarios", "workbench")
PROMPT = ">>> "


def modules_with_examples() -> Iterator[str]:
    """The modules whose source has an example; no other is imported."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if PROMPT in path.read_text(encoding="utf-8"):
                name = path.relative_to(ROOT).with_suffix("")
                yield ".".join(name.parts).removesuffix(".__init__")


MODULES = list(modules_with_examples())


def examples(module: ModuleType) -> list[doctest.DocTest]:
    """The examples of a module, of its functions, its classes and their methods."""
    return [test for test in doctest.DocTestFinder().find(module) if test.examples]


@pytest.mark.quick
@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)  # the examples name FMUs by their path in the project
    module = importlib.import_module(name)
    tests = examples(module)
    assert tests, f"no example of {name} is in a docstring"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    texts: list[str] = []
    for test in tests:
        runner.run(test, out=texts.append)
    assert runner.failures == 0, "".join(texts)
