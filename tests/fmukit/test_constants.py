"""What enters a model's constants is in its files: all else is refused at import, with what to write."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmukit.fmu import contract

REFUSED = [
    "DATA = [float(v) for v in open('t.csv').read().split(',')]",
    "from pathlib import Path\nDATA = Path('t.csv').read_text()",
    "import os\nDATA = float(os.environ['MASS'])",
    "from os import environ, getenv",
    "import io\nDATA = io.open('t.csv')",
    "import random\nDATA = random.random()",
    "import time\nDATA = time.time()",
    "from datetime import datetime",
    "import subprocess",
    "import platform, math",
    "from importlib.resources import files",
    "import csv, tomllib",
    "DATA = __import__('os').environ",
    "DATA = eval(input())",
]
TAKEN = [
    "from __future__ import annotations\nfrom math import pi\nfrom bisect import bisect\nimport json",
    "from dataclasses import dataclass\nfrom enum import IntEnum\nfrom collections.abc import Callable",
    "def open(valve):\n    return valve\n\nDATA = open(0.5)",
    "def flow(open):\n    return 2.0 * open",
]


@pytest.mark.parametrize("source", REFUSED)
def test_what_may_change_without_the_model_is_refused(source: str, tmp_path: Path) -> None:
    path = tmp_path / "model.py"
    path.write_text(f"{source}\n", encoding="utf-8")
    with pytest.raises(SyntaxError, match="may give other values at another time"):
        contract.require_imports(path)


@pytest.mark.parametrize("source", TAKEN)
def test_what_gives_the_same_is_taken(source: str, tmp_path: Path) -> None:
    path = tmp_path / "model.py"
    path.write_text(f"{source}\n", encoding="utf-8")
    contract.require_imports(path)
