"""Does the master do what theory says? Linear systems with known answers, and a table of verdicts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ..errors import SetupError
from .checks import Row, verify

__all__ = ["Row", "linear_system", "main", "verify"]

ROOT = Path(__file__).resolve().parents[2]


def linear_system() -> Path:
    """LinearSystem.fmu, built if it is missing or out of date.

    Raises SetupError with the reason if it cannot be.
    """
    command = [sys.executable, str(ROOT / "build_fmus.py"), "linear_system"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SetupError(f"LinearSystem.fmu could not be built: {done.stderr.strip()}")
    return ROOT / "fmus" / "LinearSystem.fmu"


def main(fmu: Path | None = None) -> bool:
    """Run all checks, print them as a table; whether all have passed."""
    console = Console()
    table = Table(
        "system", "scheme", "off the ideal", "of which theory says", "found", "theory", ""
    )
    rows: list[Row] = []
    with console.status("LinearSystem.fmu") as status:
        for row in verify(fmu or linear_system()):
            rows.append(row)
            status.update(f"{row.system}, {row.scheme}")
            verdict = "ok" if row.passed else "[bold red]FAILED[/]"
            match, found, theory = f"{row.match:.1e}", f"{row.found:.5g}", f"{row.theory:.5g}"
            table.add_row(row.system, row.scheme, match, row.quantity, found, theory, verdict)
    console.print(table)
    failed = [row for row in rows if not row.passed]
    console.print(f"{len(rows) - len(failed)} of {len(rows)} checks passed")
    return not failed
