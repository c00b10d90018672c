"""A process that answers for scenarios: a case as one JSON line in, its row as one JSON line out.

Before a run begins, with the libraries of its scenario there, a line says so. What FMUs
print goes to stderr, which the parent keeps for the run that is under way. When the parent
ends, this process ends too, in the middle of a run.
"""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import shutil
import sys
import tempfile
import threading
import time
import traceback
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import IO, Any

from cosim import SetupError, SimulationError

from .. import fmus
from ..__main__ import SCENARIOS, load


def scenario(name: str, folder: Path) -> ModuleType:
    """The module of a scenario of the project, or of a Python file in that folder.

    Raises SetupError where there is none, or none that answers.
    """
    if name in SCENARIOS:
        return load(name)
    path = folder / name
    if path.suffix != ".py" or not path.is_file():
        known = ", ".join(SCENARIOS)
        raise SetupError(f"scenario = {name!r} must be one of {known}, or a file NAME.py beside it")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise SetupError(f"{path} cannot be read: {type(error).__name__}: {error}") from error
    if not callable(getattr(module, "answer", None)):
        raise SetupError(f"{path} must define answer(**options)")
    return module


_scenario = cache(scenario)
BEGUN = "begun"


def row(case: dict[str, Any]) -> dict[str, Any]:
    """One run: status, message, figures as (value, unit, error), seconds, traceback."""
    folder = Path(case["folder"])
    fmus.choose(case["flavour"])
    fmus.serve(folder)
    began = time.perf_counter()
    status, message, trace = "ok", "", ""
    figures: dict[str, tuple[float, str, float | None]] = {}
    try:
        options = dict(case["options"])
        if case["start"]:
            options["start"] = case["start"]
        answer = _scenario(case["scenario"], folder).answer(**options)
        figures = {
            name: (float(figure.value), figure.unit, figure.error)
            for name, figure in answer.figures.items()
        }
    except SetupError as error:
        status, message = "refused", str(error)
    except SimulationError as error:
        status, message = "failed", str(error)
    except BaseException as error:  # noqa: BLE001
        status, message = "failed", f"{type(error).__name__}: {error}"
        trace = traceback.format_exc()
    return {
        "status": status,
        "message": message.replace(f"{folder}{os.sep}", ""),
        "figures": figures,
        "seconds": time.perf_counter() - began,
        "trace": trace,
    }


def _listen(source: IO[str], cases: queue.Queue[str], folder: str) -> None:
    """Take cases until the parent closes the pipe or ends, then leave, and our folder with us."""
    for line in source:
        cases.put(line)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def main(folder: str) -> None:
    """Do one case after the other; what is written on the way goes to the folder."""
    tempfile.tempdir = os.environ["TMPDIR"] = folder
    with suppress(BrokenPipeError):
        _work(folder)
    shutil.rmtree(folder, ignore_errors=True)


def _work(folder: str) -> None:
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    cases: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_listen, args=(sys.stdin, cases, folder), daemon=True).start()
    told: dict[str, Any] = {"ready": True}
    while True:
        print(json.dumps(told), file=channel, flush=True)
        case = json.loads(cases.get())
        os.ftruncate(2, 0)
        with suppress(SetupError):
            _scenario(case["scenario"], Path(case["folder"]))
        print(BEGUN, file=channel, flush=True)
        told = row(case)


if __name__ == "__main__":
    main(sys.argv[1])
