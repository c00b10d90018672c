"""The command `cosim compare`."""

from __future__ import annotations

import argparse
import math

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
    text = ".csv or .parquet file whose first column is the time"
    parser.path("result", text, metavar="result")
    text = "another result or a measurement, in a file of the same form"
    parser.path("reference", text, metavar="reference")
    text = (
        "columns of result and reference, w=n:rpm or tau=M*0.73:N.m; "
        "by default, all columns with the same name"
    )
    parser.several("--map", text, metavar="NAME=COLUMN")
    text = "half the height of the band, as a share of the reference's range"
    parser.number("--value", text, SHARE)
    text = f"half the width of the band [s] (default: {SHARE} of the time compared)"
    parser.number("--time", text)
    text = "error of a column, in the reference's unit or with its own, as in 7.3rpm"
    parser.several("--error", text, metavar="NAME=VALUE")
    text = "skip gaps longer than this between rows of the reference [s] (default: no limit)"
    parser.number("--gap", text, math.inf)
    parser.path("--plot", "image file with a plot of the curves and their bands")
