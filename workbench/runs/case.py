"""A question as a function of cases, which travels with its files: options in, a row out."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cosim import SetupError

from ..ask import answer
from ..options import made
from ..question import Carried, QuestionError, loaded, name
from .identity import digest

Row = dict[str, Any]


@dataclass(frozen=True)
class Cases:
    """A question, a module or a file of one's own, and its FMUs: file names by part, and contents.

    `digest` names them all by their contents.
    """

    question: str
    fmus: Mapping[str, str]
    files: Mapping[str, bytes]
    digest: str

    def unpacked(self, folder: Path) -> Callable[[Any], Row]:
        """What answers a case: a function that finds the files in a folder of their own, in this
        folder; they may be there already. Where it is unpickled the question is loaded, for which no
        run is charged.
        """
        target = folder.resolve() / self.digest
        if not target.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            fresh = Path(tempfile.mkdtemp(dir=folder, prefix=f"{self.digest}."))
            for file, content in self.files.items():
                (fresh / file).write_bytes(content)
            try:
                fresh.rename(target)
            except OSError:  # another one was faster
                shutil.rmtree(fresh)
        page = str(target / self.question) if self.question in self.files else self.question
        return Carried(page, partial(row, page, self.fmus, target))


def cases(where: str, fmus: Mapping[str, Path]) -> Cases:
    """The question that `where` loads, with these FMUs; raises SetupError for two files of one name."""
    own = [Path(where)] if where.endswith(".py") else []
    files: dict[str, bytes] = {}
    for path in [*dict.fromkeys(fmus.values()), *own]:
        if path.name in files:
            raise SetupError(f"PARTS: two files are called {path.name}")
        files[path.name] = path.read_bytes()
    told = b"".join(file.encode() + digest(files[file]).encode() for file in sorted(files))
    parts = {part: path.name for part, path in fmus.items()}
    return Cases(Path(where).name if own else where, parts, files, digest(told))


def row(
    where: str,
    fmus: Mapping[str, str],
    folder: Path,
    case: tuple[Mapping[str, Any], Mapping[str, Any]],
) -> Row:
    """What a question answers to (options, start values): {"figures": {name: (value, unit, error,
    reason)}, "warnings": texts}. Its errors name no folder.
    """
    options, start = case
    try:
        page = loaded(where)
        o = made(page.Options, {**options, "start": start}, name(page))
        found = answer(page, o, {part: folder / file for part, file in fmus.items()})
    except (SetupError, QuestionError) as error:
        raise type(error)(str(error).replace(f"{folder}{os.sep}", "")) from error
    figures = {key: (float(f.value), f.unit, f.error, f.reason) for key, f in found.figures.items()}
    return {"figures": figures, "warnings": list(found.warnings)}
