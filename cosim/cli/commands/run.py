"""The command `cosim run`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ...accuracy.certify import COVERS_SOLVERS, Certified, certify
from ...errors import SetupError, pluralize
from ...fmu.messages import quiet
from ...isolated import run_isolated
from ...names import only
from ...result import Interrupted, Result, SimulationError
from ...result import partial as partial_file
from ...scratch import scratch
from ...system import System
from ..options import Parser
from ..output import (
    locked_for_writing,
    new_folders,
    print_table,
    print_warnings,
    print_written_files,
    require_outputs,
    write_result,
)
from ..system_file import SystemFile, add_stepping_options, add_system_options, open_system

SUMMARY = "Run a system and write its results."
#: The exit status where no figure has an error: that of a refused answer of the workbench.
REFUSED = 3


def execute(options: argparse.Namespace) -> int:
    """Run a system, write its rows and print what the run did; REFUSED if no figure has the error that was asked for."""
    with open_system(options) as file, TemporaryDirectory(dir=scratch()) as folder:
        settings = file.settings(options)
        arguments = {k: value for k, value in vars(settings).items() if value is not None}
        folders = new_folders(options)
        require_outputs(options)
        if options.part is not None and options.part not in (parts := file.system.parts):
            raise SetupError(f"there is no part {options.part!r}, {only(options.part, parts)}")
        files = (Path(folder) / f"rows{k}.csv" for k in count())

        def runner(system: System, **settings: Any) -> Result:
            """Run in a child; rows that are not wanted in a file have one of their own for as long as they are needed."""
            settings = {"csv": next(files)} | settings
            return run_isolated(system, timeout=options.timeout, **settings)

        result, certified = _run_and_write(file, options, arguments, runner)
        if options.plot is not None:
            result.plot(path=options.plot)
        print("\n".join(run_summary(result)))
        print_written_files(options, folders)
        if options.out is None and options.plot is None:
            last = zip(result.names, result.data[-1])
            print_table((name, f"{value:.6g} {result.units[name]}") for name, value in last)
    if certified is not None:
        print_certified(certified)
    print_warnings(result)
    is_refused = certified is not None and all(x.error is None for x in certified.figures.values())
    return REFUSED if is_refused else 0


def _run_and_write(
    file: SystemFile, options: argparse.Namespace, arguments: dict[str, Any], runner: Any
) -> tuple[Result, Certified | None]:
    """Run with a progress bar; a run that breaks off leaves the rows that it has."""
    from ...progress import bar  # rich takes longer to import than `--help`

    is_streamed = (
        options.out is not None and options.part is None and options.out.suffix.lower() == ".csv"
    )
    path_at_end = None if is_streamed else options.out
    if is_streamed:
        arguments["csv"] = options.out
    certified = None
    with locked_for_writing(path_at_end):
        try:
            start, stop = arguments["start"], arguments["stop"]
            with quiet(), bar(file.title, start, stop) as progress:
                arguments["progress"] = progress
                if options.certify:
                    certified = certify(file.system, runner=runner, **arguments)
                    result = certified.result
                else:
                    result = runner(file.system, **arguments)
        except (SimulationError, Interrupted) as incomplete:
            print_warnings(incomplete.result)
            if path_at_end is not None:
                write_result(incomplete.result, partial_file(path_at_end), options.part)
            raise
        if path_at_end is not None:
            write_result(result, path_at_end, options.part)
    return result, certified


def run_summary(result: Result) -> Iterator[str]:
    """Yield what a run did, in a few lines."""
    facts = result.provenance
    steps = pluralize(facts["steps"], "step")
    for kind in ("rejected", "discarded"):
        steps += f", {facts[kind]} {kind}" if facts[kind] else ""
    pace = (facts["reached"] - facts["start"]) / facts["wall_time"]
    if facts["reason"]:
        yield str(facts["reason"])
    yield (
        f"{facts['algorithm']}, {facts['communication']}: {steps} in {facts['wall_time']:.3g} s "
        f"({pace:.3g} x real time), {pluralize(facts['rows'], 'row')}"
    )
    for bond, energy in result.energy.items():
        yield (
            f"{bond}: {energy['given']:.6g} J delivered, {energy['taken']:.6g} J received, "
            f"{-energy['residual']:+.2g} J created by the coupling"
        )
    if facts["unrecorded"]:
        yield f"texts are not recorded: {', '.join(facts['unrecorded'])}"


def print_certified(certified: Certified) -> None:
    """Print the metrics of the summary with their errors and observed orders, and what the errors cover."""
    tenth = " and a tenth of the tolerance" if certified.covers is COVERS_SOLVERS else ""
    print(f"{certified.covers}; from runs with other steps{tenth} as well")
    rows = []
    for name, estimate in certified.figures.items():
        is_known = estimate.error is not None and math.isfinite(estimate.order)
        order = f"order {estimate.order:.1f}" if is_known else ""
        rows.append((name, str(estimate), order))
    print_table(rows)


def add_options(parser: Parser) -> None:
    """Add how the system is stepped and what is written."""
    add_system_options(parser, is_timed=True)
    add_stepping_options(parser)
    parser.take("--out", "--timeout", "--part", "--plot", "--certify")
