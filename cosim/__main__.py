"""The command `cosim`, and python -m cosim: the command line of `cosim.cli.main`."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None, program: str = "cosim") -> int:
    """Run a command line, by default that of the process; Ctrl-C while its modules are imported ends it as it does later."""
    try:
        from .cli.main import main as command_line  # what takes seconds to import
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return command_line(arguments, program)


if __name__ == "__main__":
    sys.exit(main())
