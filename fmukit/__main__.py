"""The command line: how models become FMUs.

    fmukit build MODEL ... [--flavour python|native|wasm|both|fmi3|all] [--platforms host|all] [--out DIR]
                           [--force] [--verbose]

MODEL is a file, NAME.py or NAME/model.py, or the name of a machine that comes with the package.
"""

import argparse
import difflib
import sys
from collections.abc import Sequence
from pathlib import Path

KIT = Path(__file__).resolve().parent
#: the machines of the project, which an installed package carries as files and a clone as `components`
MACHINES = next(
    folder
    for folder in (KIT.parent / "components", KIT / "machines")
    if folder.is_dir() or folder.parent == KIT
)


def main(arguments: Sequence[str] | None = None, program: str = "fmukit") -> int:
    """Run a command line, by default that of the process; 0 if every FMU was built, else 1; 2 for what cannot be meant."""
    try:
        from .fmu import make
    except ModuleNotFoundError as missing:
        sys.exit(f"error: fmukit needs the package {missing.name}, which is not installed")
    except KeyboardInterrupt:
        return 130
    parser = argparse.ArgumentParser(prog=program, description="Make FMUs from pages of equations.")
    commands = parser.add_subparsers(dest="command", required=True)
    build = commands.add_parser("build", help="build FMUs from models, validate and test them")
    build.add_argument(
        "model", nargs="+", help="NAME.py, NAME/model.py, or the name of a machine: drive_motor"
    )
    build.add_argument(
        "--out",
        type=Path,
        default=Path(),
        help="folder for the FMUs, with the folders native, wasm and fmi3 for compiled ones (default: the current one)",
    )
    make.add_options(build)
    options = parser.parse_args(arguments)
    models = [model_file(model) for model in options.model]
    if problems := [text for text in map(problem, options.model, models) if text]:
        print(*(f"error: {text}" for text in problems), sep="\n", file=sys.stderr)
        return 2
    return make.run(models, options.out, options)


def model_file(model: str) -> Path:
    """The file of a model that is given as a path or as the name of a machine."""
    machine = MACHINES / model / "model.py"
    return machine if not Path(model).exists() and machine.is_file() else Path(model)


def problem(given: str, file: Path) -> str:
    """Why what was given is no model, with what to write; "" if it may be one."""
    if file.is_dir():
        inside = file / "model.py"
        hint = f"write {inside}" if inside.is_file() else "write the .py file of a model"
        return f"{given} is a folder: {hint}"
    if not file.exists():
        if file.suffix or file.parent != Path():
            return f"there is no file {given}"
        names = sorted(path.parent.name for path in MACHINES.glob("*/model.py"))
        close = difflib.get_close_matches(given, names, 1)
        hint = f"did you mean {close[0]}?" if close else f"the machines are {', '.join(names)}"
        return f"there is no file and no machine {given}; {hint}"
    return (
        ""
        if file.suffix == ".py"
        else f"{given} is not a Python file: write the .py file of a model"
    )


if __name__ == "__main__":
    sys.exit(main())
