"""A question as a function of cases, whose page and FMUs lie in one folder: options in, a row out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cosim import SetupError

from ..ask import answer
from ..options import made
from ..question import QuestionError, loaded, name

Row = dict[str, Any]


def row(
    page: Path | str,
    fmus: Mapping[str, Path],
    case: tuple[Mapping[str, Any], Mapping[str, Any]],
) -> Row:
    """What the page of a file or a module answers to (options, start values): {"figures": {name:
    (value, unit, error, reason)}, "warnings": texts}. Its errors name no folder.
    """
    options, start = case
    try:
        question = loaded(str(page))
        o = made(question.Options, {**options, "start": start}, name(question))
        found = answer(question, o, fmus)
    except (SetupError, QuestionError) as error:
        text = str(error)
        for folder in {path.parent for path in (page, *fmus.values()) if isinstance(path, Path)}:
            text = text.replace(f"{folder}{os.sep}", "")
        raise type(error)(text) from error
    figures = {key: (float(f.value), f.unit, f.error, f.reason) for key, f in found.figures.items()}
    return {"figures": figures, "warnings": list(found.warnings)}
