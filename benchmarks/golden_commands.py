"""Commands of the project as the golden dump runs them, and what of their output it keeps."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
#: a convention of this dump: pages of text as wide as a terminal, no colour, one thread, no window
ENVIRONMENT = {
    "COLUMNS": "100",
    "LC_ALL": "C.UTF-8",
    "MPLBACKEND": "Agg",
    "NO_COLOR": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONUNBUFFERED": "1",
}
#: what no two runs print alike: run times, and memory that other programs move
MASKS = [
    (r"in [\d.e+-]+ s \([\d.e+-]+ x real time\)", "in TIME s"),
    (r"-?\d+ KiB more after", "N KiB more after"),
    (r"0x[0-9a-f]{6,}", "0xADDRESS"),
]

Entry = dict[str, Any]


def execute(arguments: Sequence[str], folder: Path) -> Entry:
    """
    Run a program of the project and record what it says.

    Parameters
    ----------
    arguments : sequence of str
        Arguments of the Python interpreter, in the root of the project.
    folder : Path
        The folder of the item, which its output calls FOLDER.

    Returns
    -------
    dict
        The exit status and the lines of both streams, without times and paths.
    """
    process = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, check=False, capture_output=True, text=True,
        stdin=subprocess.DEVNULL, env=os.environ | ENVIRONMENT | {"TMPDIR": str(folder)},
    )  # fmt: skip
    output, errors = (mask(text, folder).splitlines() for text in (process.stdout, process.stderr))
    return {"exit": process.returncode, "output": output, "errors": errors}


def mask(text: str, folder: Path) -> str:
    """The text without times, memory sizes and the paths of `folder` and of the project."""
    for path, name in ((folder, "FOLDER"), (ROOT, "PROJECT")):
        text = text.replace(str(path), name)
    for pattern, replacement in MASKS:
        text = re.sub(pattern, replacement, text)
    return text
