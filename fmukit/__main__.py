"""The command line: how models become FMUs.

    fmukit build MODEL ... [--flavour python|native|wasm|both|fmi3|all] [--out DIR] [--force]

MODEL is a file, NAME.py or NAME/model.py, or the name of a machine that comes with the package.
"""

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path

#: the machines of the project, which an installed package carries as files and a clone as `components`
MACHINES = Path(__file__).resolve().parent / "machines"
COMPILED = ("native", "wasm", "both", "fmi3", "all")


def main() -> int:
    """Run the command line; 0 if every FMU was built, else 1."""
    try:
        from .fmu.make import FLAVOURS, make_all
    except ModuleNotFoundError as missing:
        sys.exit(f"error: fmukit needs the package {missing.name}, which is not installed")
    parser = argparse.ArgumentParser(
        prog="fmukit", description="Make FMUs from pages of equations."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    build = commands.add_parser("build", help="build FMUs from models, validate and test them")
    build.add_argument(
        "model", nargs="+", help="NAME.py, NAME/model.py, or the name of a machine: drive_motor"
    )
    has_compiler = find_spec("ziglang") is not None
    default = "both" if has_compiler else "python"
    build.add_argument(
        "--flavour",
        choices=FLAVOURS,
        default=default,
        help=f"which FMUs to build (default here: {default})",
    )
    build.add_argument(
        "--out", type=Path, default=Path(), help="folder for the FMUs (default: the current one)"
    )
    build.add_argument("--force", action="store_true", help="rebuild even what is up to date")
    options = parser.parse_args()
    if options.flavour in COMPILED and not has_compiler:
        build.error(
            f"--flavour {options.flavour} needs a C compiler: pip install 'drive-fmus[native]'"
        )
    models = [model_file(model) for model in options.model]
    return min(1, make_all(models, options.flavour, options.out, options.force))


def model_file(model: str) -> Path:
    """The file of a model that is given as a path or as the name of a machine."""
    machine = MACHINES / model / "model.py"
    return machine if not Path(model).exists() and machine.is_file() else Path(model)


if __name__ == "__main__":
    sys.exit(main())
