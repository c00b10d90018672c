"""cosim verify: the master against closed-form solutions."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...errors import SetupError
from ..command import Command
from ..options import Parser, require

ROOT = Path(__file__).resolve().parents[3]
CANDIDATES = (
    ROOT / "cosim" / "verification" / "LinearSystem.fmu",
    ROOT / "fmus" / "LinearSystem.fmu",
)
EXACT_FMU = next((path for path in CANDIDATES if path.is_file()), Path("fmus/LinearSystem.fmu"))


def verify_master(options: argparse.Namespace) -> int:
    """Print the checks of the master; return 1 if anything differs from theory."""
    require("scipy", "verify")
    from ...verification import main

    if not options.fmu.is_file():
        raise SetupError(f"there is no file {options.fmu}; build_fmus.py makes it")
    return 0 if main(options.fmu) else 1


def add_options(parser: Parser) -> None:
    """Add the FMU."""
    text = "LinearSystem.fmu (default: the one that comes with cosim)"
    parser.path("fmu", text, metavar="fmu", nargs="?", default=EXACT_FMU)


COMMAND = Command(
    "verify", "test the master against closed-form solutions", verify_master, add_options, rank=9,
    reads_system=False,
)  # fmt: skip
