"""Where questions are: modules in the folders of a package, by name, or a user's own files, by path."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from types import ModuleType

from cosim.errors import RunError, SetupError

#: What the name of a module begins with that is a user's own file: no `import` of other code can mean it.
FROM_FILE = "workbench.from_file."


class QuestionError(RuntimeError):
    """A question's own code raised; the text says where and what, and needs no name before it."""

    plain = True


@cache
def names(home: Path | None) -> Mapping[str, str]:
    """Return the questions below a package's folder, by name, and their modules; none is imported.

    A question is a file whose documentation begins with one.
    """
    modules: dict[str, str] = {}
    if home is None:
        return modules
    for path in sorted(home.rglob("*.py")):
        module = ".".join(path.relative_to(home.parent).with_suffix("").parts)
        if summary(home, module).endswith("?"):
            modules[path.stem] = module
    return modules


def summary(home: Path, module: str) -> str:
    """Return the question of a module of the package, in one line; it is not imported."""
    return (ast.get_docstring(ast.parse(source(home, module))) or "").partition("\n")[0]


def is_plan(home: Path, module: str) -> bool:
    """Whether the question of a module of the package is answered by plans; it is not imported."""
    return "(PlanQuestion" in source(home, module)


def source(home: Path, module: str) -> str:
    """Return the text of a module of the package."""
    return home.parent.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")


def is_from_file(module: ModuleType) -> bool:
    """Whether a module is a user's own file and no module of a package."""
    return module.__name__.startswith(FROM_FILE)


def locator(module: ModuleType) -> str:
    """Return what `load_module` takes to load a module again, or in another process."""
    return str(module.__file__) if is_from_file(module) else module.__name__


def load_module(locator: str) -> ModuleType:
    """Return the module of a question.

    Parameters
    ----------
    locator : str
        A module of a package, "scenarios.conveyor.run_up", or a file, "mine.py".

    Raises
    ------
    SetupError
        If there is no such file.
    QuestionError
        If the question's own code raises.
    """
    if not locator.endswith(".py"):
        return importlib.import_module(locator)
    path = Path(locator).resolve()
    if not path.is_file():
        raise SetupError(f"there is no file {locator}")
    name = FROM_FILE + path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with as_question_errors(module):
            spec.loader.exec_module(module)
    except BaseException:
        unload(module)
        raise
    return module


def unload(module: ModuleType) -> None:
    """Unload a module that was loaded from a file, so that its name is free."""
    if is_from_file(module):
        sys.modules.pop(module.__name__, None)


@cache
def load_cached(locator: str) -> ModuleType:
    """What `load_module` returns, loaded once."""
    return load_module(locator)


def find(home: Path | None, text: str, folder: Path = Path()) -> str:
    """Return what `load_module` takes, from the name of a question of the package or a file in that folder.

    Raises
    ------
    SetupError
        If there is none.
    """
    if text in names(home):
        return names(home)[text]
    if text.endswith(".py") and (folder / text).is_file():
        return str((folder / text).resolve())
    choices = f"one of {', '.join(names(home))}, or " if home else ""
    near = get_close_matches(text, names(home), 1)
    hint = f": did you mean {near[0]!r}?" if near else ""
    raise SetupError(f"{text!r} must be {choices}an existing file NAME.py{hint}")


@contextmanager
def as_question_errors(page: ModuleType) -> Iterator[None]:
    """Turn what a page's own code raises into a QuestionError with its file and line.

    What a user's own file makes other code raise is turned into one, too.
    """
    try:
        yield
    except (SetupError, RunError, QuestionError, OSError):
        raise
    except SyntaxError as error:
        raise QuestionError(f"{error.filename}:{error.lineno}: {error.msg}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        frames_of_page = [frame for frame in frames if frame.filename == page.__file__]
        if not frames_of_page and not is_from_file(page):
            raise
        line = f":{frames_of_page[-1].lineno}" if frames_of_page else ""
        location = "" if frames_of_page else f", in {frames[-1].filename}:{frames[-1].lineno}"
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise QuestionError(f"{page.__file__}{line}: {what}{location}") from error
