"""The command `cosim export`."""

from __future__ import annotations

import argparse

from ...errors import SetupError
from ...formats.container import write_container
from ...formats.osp import write_osp
from ...formats.ssp.write import write_ssp
from ..options import Parser
from ..output import require_writable
from ..system_file import CHECKED_TIME, add_system_options, open_system

SUMMARY = "Write a system in another format."

FORMATS = ("ssp", "osp", "container")
#: The format of a file by how its name ends; a folder is that of osp.
BY_SUFFIX = {".ssp": "ssp", ".fmu": "container", "": "osp"}


def execute(options: argparse.Namespace) -> int:
    """Write a system as a package, a folder or a single FMU."""
    to = options.to or BY_SUFFIX.get(options.out.suffix.lower(), "")
    if not to:
        raise SetupError(
            f"{options.out} must end in .ssp, or in .fmu for one FMU, or be a folder for libcosim: "
            "else say which with --to"
        )
    with open_system(options) as file:
        if to != "osp":
            require_writable(options.out)
        start, stop = file.start, file.package.stop
        if options.stop is not None:
            stop = options.stop
        if to == "ssp":
            step = file.package.step if options.step is None else options.step
            write_ssp(file.system, options.out, stop, start, step)
        elif to == "osp":
            step = file.step(options.step)
            write_osp(file.system, options.out, step=step, start=start, stop=stop)
        else:
            stop = start + CHECKED_TIME if stop is None else stop
            step = file.step(options.step)
            write_container(file.system, options.out, step=step, start=start, stop=stop)
    print(f"{options.out} written")
    return 0


def add_options(parser: Parser) -> None:
    """Add the format, the file and the step."""
    add_system_options(parser)
    parser.take("--to", choices=FORMATS)
    parser.take("--out", required=True, help="file to write; a folder for osp")
    parser.take("--step", "--stop")
