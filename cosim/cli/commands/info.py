"""The command `cosim info`."""

from __future__ import annotations

import argparse

from ... import describe
from ..options import Parser
from ..system_file import add_system_options, open_system

SUMMARY = "Show the parts, wires and start values of a system."


def execute(options: argparse.Namespace) -> int:
    """Print parts, wires, start values and times of a system."""
    with open_system(options, runnable=False) as file:
        print("\n".join(describe.info(file.network)))
        for connector, wires in file.system.connectors.items():
            same = file.package.connectors.get(connector)
            print(
                f"connector {connector} is {same}"
                if same
                else f"connector {connector}: {', '.join(map(str, wires))}"
            )
        if file.package.stop is not None:
            print(f"default experiment: {file.start:g} to {file.package.stop:g} s")
        if file.package.step is not None:
            print(f"communication step: {file.package.step:g} s")
    return 0


def add_options(parser: Parser) -> None:
    """Add the file."""
    add_system_options(parser)
