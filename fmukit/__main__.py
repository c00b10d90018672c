"""python -m fmukit build MODEL.py ... [--flavour python|native|wasm|both|fmi3|all] [--out DIR]
[--force].
"""

import argparse
import sys
from pathlib import Path


def main() -> int:
    """Run the command line; 0 if every FMU was made, else 1."""
    try:
        from .fmu.make import FLAVOURS, make_all
    except ModuleNotFoundError as missing:
        sys.exit(f"fmukit needs {missing.name}: pip install 'drive-fmus-kit[build]'")
    parser = argparse.ArgumentParser(
        prog="fmukit", description="Make FMUs from pages of equations."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    build = commands.add_parser("build", help="build, validate and play the FMUs of models")
    build.add_argument("model", nargs="+", type=Path, help="NAME.py, or NAME/model.py")
    build.add_argument(
        "--flavour", choices=FLAVOURS, default="both", help="which FMUs to build; default both"
    )
    build.add_argument(
        "--out", type=Path, default=Path(), help="folder for the FMUs; default the current one"
    )
    build.add_argument("--force", action="store_true", help="rebuild even what is up to date")
    options = parser.parse_args()
    return min(1, make_all(options.model, options.flavour, options.out, options.force))


if __name__ == "__main__":
    sys.exit(main())
