"""scenarios list | run NAME or FILE.py [options] | find NAME or FILE.py [options] | study FILE.toml [options]."""

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None, program: str = "scenarios") -> int:
    """Run a command line, by default that of the process; return its exit code.

    Ctrl-C while modules are imported ends it as it does later.
    """
    try:
        from workbench import cli

        from .project import PROJECT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return cli.main(sys.argv[1:] if arguments is None else arguments, PROJECT, program)


if __name__ == "__main__":
    sys.exit(main())
