"""cosim info: what a system is made of."""

from __future__ import annotations

import argparse

from ... import describe
from ..command import Command
from ..options import Parser
from ..system_file import open_system


def print_info(options: argparse.Namespace) -> int:
    """Print parts, wires, start values and times of a system."""
    with open_system(options, runnable=False) as file:
        print("\n".join(describe.info(file.network)))
        for connector, port in file.package.connectors.items():
            print(f"connector {connector} is {port}")
        if file.package.stop is not None:
            print(f"default experiment: {file.start:g} to {file.package.stop:g} s")
        if file.package.step is not None:
            print(f"communication step: {file.package.step:g} s")
    return 0


def add_options(parser: Parser) -> None:
    """Add nothing: the file is enough."""


COMMAND = Command(
    "info", "show the parts, wires and start values of a system", print_info, add_options, rank=1
)
