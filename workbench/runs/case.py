"""A question as a function of cases, for child processes: options in, a row out."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from cosim import SetupError

from ..ask import answer
from ..options import made
from ..question import QuestionError, load, name

_load = cache(load)


@dataclass(frozen=True)
class Asked:
    """Answers cases of a question with FMUs, and perhaps the question, from a folder.

    `question` is a module or a file in the folder, `fmus` are file names by part. A case is (options,
    start values), a row {"figures": {name: (value, unit, error, reason)}, "warnings": texts}. Where
    it is unpickled, the question is loaded: no run is charged for that.
    """

    question: str
    fmus: Mapping[str, str]
    flavour: str
    folder: Path

    def __call__(self, case: tuple[Mapping[str, Any], Mapping[str, Any]]) -> dict[str, Any]:
        """The row of a case."""
        options, start = case
        page = self._page()
        fmus = {part: self.folder / file for part, file in self.fmus.items()}
        try:
            o = made(page.Options, {**options, "start": start}, name(page))
            found = answer(page, o, fmus, flavour=self.flavour)
        except (SetupError, QuestionError) as error:
            raise type(error)(str(error).replace(f"{self.folder}{os.sep}", "")) from error
        warnings = Counter(map(str, found.warnings))
        return {
            "figures": {
                name: (float(f.value), f.unit, f.error, f.reason)
                for name, f in found.figures.items()
            },
            "warnings": [f"{text} ({n} times)" if n > 1 else text for text, n in warnings.items()],
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        with suppress(SetupError, QuestionError):
            self._page()

    def _page(self) -> ModuleType:
        own = self.question.endswith(".py")
        return _load(str(self.folder / self.question) if own else self.question)
