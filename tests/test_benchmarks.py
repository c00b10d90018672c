"""Every benchmark can be started: what it takes of the project has the name by which it asks for it."""

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.py")))
def test_a_benchmark_can_be_imported(name: str, fmus: Path) -> None:
    importlib.import_module(f"benchmarks.{name}")
