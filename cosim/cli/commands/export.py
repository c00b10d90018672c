"""The command `cosim export`."""

from __future__ import annotations

import argparse

from ...formats.container import write_container
from ...formats.osp import write_osp
from ...formats.ssp.write import write_ssp
from ..options import Parser
from ..output import require_writable
from ..system_file import add_system_options, open_system

SUMMARY = "Write a system in another format."

FORMATS = ("ssp", "osp", "container")
#: The length [s] of a container's experiment where the system states no stop time: a convention of FMI,
#: whose default experiment lasts 1 s.
DEFAULT_DURATION = 1.0


def execute(options: argparse.Namespace) -> int:
    """Write a system as a package, a folder or a single FMU."""
    with open_system(options) as file:
        if options.to != "osp":
            require_writable(options.out)
        start, stop = file.start, file.package.stop
        if options.to == "ssp":
            step = file.package.step if options.step is None else options.step
            write_ssp(file.system, options.out, stop, start, step)
        elif options.to == "osp":
            step = file.step(options.step)
            write_osp(file.system, options.out, step=step, start=start, stop=stop)
        else:
            stop = start + DEFAULT_DURATION if stop is None else stop
            step = file.step(options.step)
            write_container(file.system, options.out, step=step, start=start, stop=stop)
    print(f"{options.out} written")
    return 0


def add_options(parser: Parser) -> None:
    """Add the format, the file and the step."""
    add_system_options(parser)
    parser.add_argument(
        "--to",
        choices=FORMATS,
        required=True,
        help="ssp, osp (a folder for libcosim), or container (one FMU)",
    )
    parser.path("--out", "file to write; a folder for osp", required=True)
    parser.time("--step", "communication step [s]")
