"""cosim oracle: the true errors of a run, against the coupled system integrated by model exchange."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from ...accuracy.certify import summary_of_rows
from ...accuracy.reference import METHODS, oracle, true_errors
from ...fmu.messages import quiet
from ...system import System
from ..command import Command
from ..options import Parser
from ..output import (
    new_folders,
    print_new_files,
    print_table,
    print_warnings,
    require_files,
)
from ..system_file import SystemFile, add_shared_options, open_system


def print_true_errors(options: argparse.Namespace) -> int:
    """Print the metrics of a run beside those of the reference solution."""
    folders = new_folders(options)
    require_files(options, System({}))
    with open_system(options) as file:
        descriptions = file.network.descriptions.items()
        if model_exchange_only := [name for name, d in descriptions if d.coSimulation is None]:
            return print_reference(file, options, model_exchange_only, folders)
        settings = file.settings(options)
        with quiet():
            judged = true_errors(
                file.system, start=settings.start, stop=settings.stop,
                step=file.step(options.step), record=options.record, method=options.method,
                algorithm=options.algorithm, timeout=options.timeout,
            )  # fmt: skip
    if options.out is not None:
        judged.result.write(options.out)
    print("the oracle's figure, the certified one, its true error")
    rows = []
    for name, figure in judged.figures.items():
        certified, unit = figure.certified, figure.certified.unit
        rows.append(
            (name, f"{figure.true:.9g} {unit}", str(certified), f"{figure.error:.2g} {unit}")
        )
    print_table(rows)
    print_new_files(options, folders)
    print_warnings(judged.result)
    return 0


def print_reference(
    file: SystemFile,
    options: argparse.Namespace,
    model_exchange_only: Sequence[str],
    folders: Sequence[Path],
) -> int:
    """Print the metrics of the reference solution alone, for parts that no run can step."""
    start, stop = file.times(options)
    with quiet():
        result = oracle(
            file.system, start=start, stop=stop, output_step=options.step, record=options.record,
            method=options.method, timeout=options.timeout,
        )  # fmt: skip
    if options.out is not None:
        result.write(options.out)
    parts = ", ".join(model_exchange_only)
    print(f"the oracle's figures, with no run to compare: {parts} offers no co-simulation")
    figures = summary_of_rows(result, result.provenance["errors"])
    rows = [(name, str(figure)) for name, figure in figures.items()]
    print_table(rows)
    print_new_files(options, folders)
    print_warnings(result)
    return 0


def add_options(parser: Parser) -> None:
    """Add the times, the integrator and what is written."""
    add_shared_options(parser, "--stop", "--step", "--algorithm")
    text = "longest wall-clock time of an integration [s] (default: no limit)"
    parser.time("--timeout", text, math.inf)
    text = "integrator; Radau and LSODA are for stiff systems"
    parser.add_argument("--method", choices=METHODS, default=METHODS[0], help=text)
    add_shared_options(parser, "--record")
    parser.path("--out", ".csv or .parquet file for the rows of the reference solution")
    parser.set_defaults(adaptive=None, output_step=None, plot=None, part=None, certify=True)


COMMAND = Command(
    "oracle", "compute the true errors of a run by model exchange", print_true_errors, add_options,
    rank=5, is_timed=True,
)  # fmt: skip
