"""The command `cosim compare`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...analysis.compare import SHARE, compare
from ..options import Parser, assignment
from ..output import require_image

SUMMARY = "Check whether a result stays close to a reference."


def execute(options: argparse.Namespace) -> int:
    """Print how far a result is from a reference; return 1 if a column leaves its band."""
    require_image(options.plot)
    comparison = compare(
        options.result, options.reference, columns=dict(map(assignment, options.map)) or None,
        value=options.value, time=options.time, errors=dict(map(assignment, options.error)),
        gap=options.gap,
    )  # fmt: skip
    print(comparison.text())
    if options.plot is not None:
        comparison.plot(options.plot)
    return 0 if comparison.passed else 1


def add_options(parser: Parser) -> None:
    """Add the two files and the band."""
    text = ".csv or .parquet file with a column of times"
    parser.add_argument("result", type=Path, help=text)
    text = "another result or a measurement, in a file of the same form"
    parser.add_argument("reference", type=Path, help=text)
    text = (
        "columns of result and reference, w=n:rpm or tau=M*0.73:N.m; "
        "by default, all columns with the same name"
    )
    parser.take("--map", help=text)
    parser.take("--value", default=SHARE)
    parser.take("--time", "--error", "--gap")
    parser.take("--plot", help="image file with a plot of the curves and their bands")
