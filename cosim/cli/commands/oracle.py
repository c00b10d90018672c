"""The command `cosim oracle`."""

from __future__ import annotations

import argparse

from ...accuracy.certify import summary_of_rows
from ...accuracy.reference import METHODS, oracle, true_errors
from ...fmu.messages import quiet
from ..options import Parser
from ..output import (
    new_folders,
    print_table,
    print_warnings,
    print_written_files,
    require_outputs,
)
from ..system_file import add_system_options, open_system, recorded_names

SUMMARY = "Compute the true errors of a run by model exchange."


def execute(options: argparse.Namespace) -> int:
    """Print the metrics of a run beside those of the reference solution, or these alone for parts that no run can step."""
    folders = new_folders(options)
    require_outputs(options)
    rows: list[tuple[str, ...]]
    with open_system(options) as file, quiet():
        record = options.record and recorded_names(file.network, options.record)
        how = {"record": record, "method": options.method, "timeout": options.timeout}
        descriptions = file.network.descriptions.items()
        if not_stepped := [name for name, d in descriptions if d.coSimulation is None]:
            start, stop = file.times(options)
            result = oracle(file.system, start=start, stop=stop, output_step=options.step, **how)
            figures = summary_of_rows(result, result.provenance["errors"])
            rows = [(name, str(figure)) for name, figure in figures.items()]
            parts = ", ".join(not_stepped)
            title = f"the oracle's figures, with no run to compare: no co-simulation in {parts}"
        else:
            settings, step = file.settings(options), file.step(options.step)
            judged = true_errors(
                file.system, start=settings.start, stop=settings.stop, step=step,
                algorithm=options.algorithm, **how,
            )  # fmt: skip
            result = judged.result
            rows = [
                (name, f"{f.true:.9g} {unit}", str(f.certified), f"{f.error:.2g} {unit}")
                for name, f in judged.figures.items()
                for unit in (f.certified.unit,)
            ]
            title = "the oracle's figure, the certified one, its true error"
    if options.out is not None:
        result.write(options.out)
    print(title)
    print_table(rows)
    print_written_files(options, folders)
    print_warnings(result)
    return 0


def add_options(parser: Parser) -> None:
    """Add the times, the integrator and what is written."""
    add_system_options(parser, is_timed=True)
    parser.take("--stop", "--step", "--algorithm")
    parser.take(
        "--timeout", help="longest wall-clock time of an integration [s] (default: no limit)"
    )
    parser.take("--method", choices=METHODS, default=METHODS[0])
    parser.take("--record")
    parser.take("--out", help=".csv or .parquet file for the rows of the reference solution")
    parser.set_defaults(adaptive=None, output_step=None, plot=None)
