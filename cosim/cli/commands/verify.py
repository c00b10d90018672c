"""The command `cosim verify`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...errors import SetupError
from ..options import Parser

SUMMARY = "Test the master against closed-form solutions."

ROOT = Path(__file__).resolve().parents[3]
CANDIDATES = (
    ROOT / "cosim" / "verification" / "LinearSystem.fmu",
    ROOT / "fmus" / "LinearSystem.fmu",
)
EXACT_FMU = next((path for path in CANDIDATES if path.is_file()), Path("fmus/LinearSystem.fmu"))


def execute(options: argparse.Namespace) -> int:
    """Print the checks of the master; return 1 if anything differs from theory."""
    from rich.console import Console
    from rich.table import Table

    from ...verification.checks import (
        verify,
    )  # its parts of SciPy take longer to import than `--help`

    if not options.fmu.is_file():
        raise SetupError(f"there is no file {options.fmu}; build_fmus.py makes it")
    console = Console()
    table = Table("system", "scheme", "deviation", "quantity", "measured", "theory", "")
    passed = []
    with console.status(options.fmu.name) as status:
        for row in verify(options.fmu):
            passed.append(row.passed)
            status.update(f"{row.system}, {row.scheme}")
            verdict = "ok" if row.passed else "[bold red]FAILED[/]"
            match, measured, theory = f"{row.match:.1e}", f"{row.measured:.5g}", f"{row.theory:.5g}"
            table.add_row(row.system, row.scheme, match, row.quantity, measured, theory, verdict)
    console.print(table)
    console.print(f"{sum(passed)} of {len(passed)} checks passed")
    return 0 if all(passed) else 1


def add_options(parser: Parser) -> None:
    """Add the FMU."""
    text = "LinearSystem.fmu (default: the one that comes with cosim)"
    parser.path("fmu", text, metavar="fmu", nargs="?", default=EXACT_FMU)
