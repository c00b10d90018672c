"""Does the master do what theory says? Linear systems with known answers, and a table of verdicts."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from .checks import SchemeCheck, verify

__all__ = ["SchemeCheck", "main", "verify"]


def main(fmu: Path) -> bool:
    """Run all checks with an exact FMU, see `verify`, print them as a table; whether all passed."""
    console = Console()
    table = Table("system", "scheme", "deviation", "quantity", "measured", "theory", "")
    rows: list[SchemeCheck] = []
    with console.status(fmu.name) as status:
        for row in verify(fmu):
            rows.append(row)
            status.update(f"{row.system}, {row.scheme}")
            verdict = "ok" if row.passed else "[bold red]FAILED[/]"
            match, measured, theory = f"{row.match:.1e}", f"{row.measured:.5g}", f"{row.theory:.5g}"
            table.add_row(row.system, row.scheme, match, row.quantity, measured, theory, verdict)
    console.print(table)
    failed = [row for row in rows if not row.passed]
    console.print(f"{len(rows) - len(failed)} of {len(rows)} checks passed")
    return not failed
