"""A project: a package of questions, and the folders of their FMUs. It needs neither NumPy nor FMPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from cosim import SetupError

from . import catalog

if TYPE_CHECKING:
    from .question import Question

FMU, MODULES = ".fmu", "wasm"
FLAVOURS = PYTHON, NATIVE = "python", "native"


class Project(NamedTuple):
    """A package of questions, by its folder, with the folders of the FMUs they use.

    The folders are by flavour; that of their modules for WebAssembly is under "wasm".

    `problem` says for the name of an FMU and a flavour why it cannot be used, "" if it can.
    """

    home: Path | None = None
    folders: Mapping[str, Path] = MappingProxyType({})
    problem: Callable[[str, str], str] = lambda *_: ""

    @property
    def packages(self) -> tuple[str, ...]:
        """The package that the questions lie in."""
        return () if self.home is None else (self.home.name,)

    def load(self, text: str, folder: Path = Path()) -> type[Question]:
        """Return the question of that name, or of a file in that folder."""
        from .question import load  # needs NumPy, which a list of questions does not

        return load(self.locate(text, folder))

    def locate(self, text: str, folder: Path = Path()) -> str:
        """Return the module or the file of that question; raises SetupError if there is none."""
        return catalog.find(self.home, text, folder)

    def flavour(self, question: type[Question]) -> str:
        """Return the flavour used by default: native where these FMUs are built, else Python."""
        native = self.folders.get(NATIVE, Path())
        built = [fmu for fmu in question.parts.values() if not fmu.endswith(FMU)]
        return NATIVE if all((native / f"{fmu}{FMU}").is_file() for fmu in built) else PYTHON

    def fmus(self, question: type[Question], flavour: str) -> dict[str, Path]:
        """Return the FMU of each part: one of the folder by its name, or any by its path from the question.

        Raises
        ------
        SetupError
            For one that does not exist, or is not made from the present sources.
        """
        paths = {}
        for part, fmu in question.parts.items():
            if fmu.endswith(FMU):
                paths[part] = question.path.parent / fmu
            elif reason := self.problem(fmu, flavour):
                raise SetupError(f"parts: {part} = {fmu!r}: {reason}")
            else:
                paths[part] = self.folders[flavour] / f"{fmu}{FMU}"
            if not paths[part].is_file():
                neighbours = sorted(path.stem for path in paths[part].parent.glob(f"*{FMU}"))
                raise SetupError(
                    f"parts: {part} = {fmu!r}: no file {paths[part]}; in its folder: "
                    f"{', '.join(neighbours) or 'none'}"
                )
        return paths

    def wasm_modules(self, question: type[Question]) -> dict[str, Path]:
        """Return the modules for WebAssembly by part, for a question with a live part and built FMUs."""
        parts = question.parts
        if not question.has_live_page() or any(fmu.endswith(FMU) for fmu in parts.values()):
            return {}
        return {
            part: self.folders[MODULES] / f"{fmu}.wasm"
            for part, fmu in parts.items()
            if MODULES in self.folders and not self.problem(fmu, MODULES)
        }


NO_PROJECT = Project()
