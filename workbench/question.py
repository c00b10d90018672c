"""Questions: pages in the folders of a package, found by name, or a user's own files, by path."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import Field
from functools import cache
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import NamedTuple

from cosim import SetupError, SimulationError

from .options import Options, declared

FROM_FILE, FMU, MODULES = "__question__", ".fmu", "wasm"
FLAVOURS = PYTHON, NATIVE = "python", "native"
RESERVED_OPTIONS = ("help", "start", "flavour", "jobs", "scheduler", "out", "animate")


class Project(NamedTuple):
    """A package of questions, by its folder, and the folders of the FMUs they use, by flavour, and of
    their modules for WebAssembly, under "wasm".

    `problem` says for the name of an FMU and a flavour why it cannot be used, "" if it can.
    """

    home: Path | None = None
    folders: Mapping[str, Path] = MappingProxyType({})
    problem: Callable[[str, str], str] = lambda name, flavour: ""

    @property
    def packages(self) -> tuple[str, ...]:
        """The package that the questions lie in."""
        return () if self.home is None else (self.home.name,)

    def flavour(self, page: ModuleType) -> str:
        """The flavour that a page uses if none is given: native where these FMUs are built, else Python."""
        native = self.folders.get(NATIVE, Path())
        named = [fmu for fmu in parts(page).values() if not fmu.endswith(FMU)]
        return NATIVE if all((native / f"{fmu}{FMU}").is_file() for fmu in named) else PYTHON

    def fmus(self, page: ModuleType, flavour: str) -> dict[str, Path]:
        """The FMU of each part of a page: one of the folder by its name, or any by its path from the
        page; raises SetupError for one that is not there or not made from the present sources.
        """
        paths = {}
        for part, fmu in parts(page).items():
            if fmu.endswith(FMU):
                paths[part] = Path(str(page.__file__)).parent / fmu
            elif reason := self.problem(fmu, flavour):
                raise SetupError(f"PARTS: {part} = {fmu!r}: {reason}")
            else:
                paths[part] = self.folders[flavour] / f"{fmu}{FMU}"
            if not paths[part].is_file():
                others = sorted(path.stem for path in paths[part].parent.glob(f"*{FMU}"))
                raise SetupError(
                    f"PARTS: {part} = {fmu!r}: no file {paths[part]}; in its folder: "
                    f"{', '.join(others) or 'none'}"
                )
        return paths

    def modules(self, page: ModuleType) -> dict[str, Path]:
        """The modules for WebAssembly of a page with a live part, by part; none if it has no such part
        or runs FMUs by path."""
        named = dict(parts(page))
        if not hasattr(page, "LIVE") or any(fmu.endswith(FMU) for fmu in named.values()):
            return {}
        return {
            part: self.folders[MODULES] / f"{fmu}.wasm"
            for part, fmu in named.items()
            if MODULES in self.folders and not self.problem(fmu, MODULES)
        }


NO_PROJECT = Project()


class QuestionError(RuntimeError):
    """A question's own code raised; the text says where and what, and needs no name before it."""

    plain = True


@cache
def names(home: Path | None) -> Mapping[str, str]:
    """The questions below a package's folder, by name, and their modules; none is imported.

    A question is a file that defines a class `Options`.
    """
    found: dict[str, str] = {}
    if home is None:
        return found
    for path in sorted(home.rglob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        if any(isinstance(node, ast.ClassDef) and node.name == "Options" for node in body):
            inside = path.relative_to(home.parent).with_suffix("")
            found[path.stem] = ".".join(inside.parts)
    return found


def summary(home: Path, module: str) -> str:
    """The question of a module of the package, in one line; it is not imported."""
    path = home.parent.joinpath(*module.split(".")).with_suffix(".py")
    documentation = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    return (documentation or "").partition("\n")[0]


def title(page: ModuleType) -> str:
    """The question of a page: the first line of its text."""
    return (page.__doc__ or "").strip().partition("\n")[0]


def name(page: ModuleType) -> str:
    """The name of a question: that of its file."""
    return page.__name__.rpartition(".")[2]


def locator(page: ModuleType) -> str:
    """What `load` takes to load a page again, or in another process."""
    return str(page.__file__) if hasattr(page, FROM_FILE) else page.__name__


def files(page: ModuleType) -> list[Path]:
    """The file of a page that is no module of a package."""
    return [Path(str(page.__file__))] if hasattr(page, FROM_FILE) else []


def parts(page: ModuleType) -> Mapping[str, str]:
    """The FMUs of a page by part."""
    found: Mapping[str, str] = getattr(page, "PARTS", {})
    return found


def load(locator: str) -> ModuleType:
    """The page of a module, "scenarios.conveyor.questions.run_up", or of a file, "mine.py".

    Raises SetupError for a file that is not there, and for what is no page; QuestionError for one
    whose own code raises.
    """
    if not locator.endswith(".py"):
        return _checked(importlib.import_module(locator), locator)
    path = Path(locator).resolve()
    if not path.is_file():
        raise SetupError(f"there is no file {locator}")
    known = sys.modules.get(path.stem)
    if known is not None and not hasattr(known, FROM_FILE):
        raise SetupError(f"{locator}: {path.stem!r} is the name of a module; rename the file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    page = importlib.util.module_from_spec(spec)
    setattr(page, FROM_FILE, True)
    sys.modules[path.stem] = page
    try:
        with attribute_errors(page):
            spec.loader.exec_module(page)
        return _checked(page, locator)
    except BaseException:
        del sys.modules[path.stem]
        raise


load_cached = cache(load)


def find(home: Path | None, text: str, folder: Path = Path()) -> str:
    """What `load` takes, from the name of a question of the package or a file in that folder.

    Raises SetupError where there is none.
    """
    if text in names(home):
        return names(home)[text]
    if text.endswith(".py") and (folder / text).is_file():
        return str((folder / text).resolve())
    known = f"one of {', '.join(names(home))}, or " if home else ""
    raise SetupError(f"{text!r} must be {known}an existing file NAME.py")


def _checked(page: ModuleType, locator: str) -> ModuleType:
    """The page, if it has what a page must have."""
    kind = getattr(page, "Options", None)
    if not (isinstance(kind, type) and issubclass(kind, Options)):
        raise SetupError(f"{locator} must define a class Options(workbench.Options)")
    if not isinstance(parts(page), Mapping):
        raise SetupError(f"{locator}: PARTS must be a dict of FMUs by part")
    if not hasattr(page, "solve"):
        for wanted, form in (("system", "(o, fmus)"), ("figures", "(o, r)")):
            if not hasattr(page, wanted):
                raise SetupError(f"{locator} must define {wanted}{form}, or solve(o, context)")
        if not hasattr(kind, "step"):
            raise SetupError(
                f"{locator}: with system and figures, Options must derive from workbench.Run"
            )
    if any(isinstance(value, Field) for value in vars(kind).values()):
        raise SetupError(
            f"{locator}: class Options must be decorated with @dataclass(frozen=True, kw_only=True)"
        )
    for name in declared(kind):
        if name in RESERVED_OPTIONS:
            raise SetupError(
                f"{locator}: no option can be called {name!r}, since every question has one of that name"
            )
    if not title(page):
        raise SetupError(f"{locator} must begin with its question as a docstring")
    return page


@contextmanager
def attribute_errors(page: ModuleType) -> Iterator[None]:
    """Turn what a page's own code raises into a QuestionError with its file and line, and also what a
    user's own file makes other code raise.
    """
    try:
        yield
    except (SetupError, SimulationError, QuestionError, OSError):
        raise
    except SyntaxError as error:
        raise QuestionError(f"{error.filename}:{error.lineno}: {error.msg}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if frame.filename == page.__file__]
        if not own and not files(page):
            raise
        line = f":{own[-1].lineno}" if own else ""
        seen = "" if own else f", in {frames[-1].filename}:{frames[-1].lineno}"
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise QuestionError(f"{page.__file__}{line}: {what}{seen}") from error
