"""Build the FMUs: components/NAME/model.py -> fmus/Name.fmu, each validated before it is kept.

usage: python build_fmus.py [COMPONENT ...] [--flavour python|native|wasm|both|fmi3|all] [--platforms host|all]
                            [--into DIR] [--force] [--verbose] [--docs]

By default both flavours are built, or the Python FMUs alone where there is no compiler. Native FMUs are
written to the folder `native`, those of FMI 3.0 to `fmi3`, and WebAssembly modules to `wasm`. Building a
native FMU also builds its module. Native FMUs run on this machine; with `--platforms all`, on every platform.
"""

import argparse
import re
import sys
from pathlib import Path
from types import ModuleType

from fmukit.declare.interface import Interface, class_name, component_name
from fmukit.fmu import make, page, plot, reference
from fmukit.fmu.load import ModelError, load
from scenarios import fmu_files
from scenarios.fmu_files import plain

ROOT = Path(__file__).resolve().parent
FORMULAS = "Formulas of the paper"
ERRATUM = r"^((?:\|[^|]*){3}\| )([\d(][^|]*?)( \|[^|]*\|)$"
HOME = r"`(\w+/[\w/.]+)(:\w+)?`"
PAPERS = """\
# The papers, formula by formula

This page lists every formula and figure of the three papers, where it is found in this project, and how well it
is met. A home is a file with the function or property in it, a variable of an FMU (`IronDrive.alpha`), or a
[question](scenarios.md). An erratum is named as in the table of errata on its machine's page. The last column ends
with the test that checks the formula. Errors are relative unless they have a unit.

The rows are kept in `page.md` next to each machine's `model.py`, under *Formulas of the paper*."""
MACHINES = {file.parent.name: file for file in sorted(ROOT.glob("components/*/model.py"))}


def main() -> int:
    """Build the FMUs that the command line asks for; returns the exit status."""
    parser = argparse.ArgumentParser(description="Build and validate the FMUs.")
    parser.add_argument("component", nargs="*", help=f"one of {', '.join(MACHINES)} (default: all)")
    parser.add_argument(
        "--into", type=Path, default=ROOT / "fmus", help="folder for the FMUs (default: fmus)"
    )
    make.add_options(parser)
    parser.add_argument(
        "--docs",
        action="store_true",
        help="also write their pages in docs/machines, and docs/papers.md",
    )
    options = parser.parse_args()
    files_by_name = {plain(name): file for name, file in MACHINES.items()}
    unknown = [name for name in options.component if plain(name) not in files_by_name]
    if unknown:
        parser.error(f"unknown component {unknown[0]!r}; there are {', '.join(MACHINES)}")
    if options.docs and options.flavour == "wasm":
        parser.error(
            "--docs plots the results contained in an FMU: choose a flavour other than wasm"
        )
    names = options.component or buildable(options.flavour)
    models = [files_by_name[plain(name)] for name in names]
    number = "all" if len(models) == len(MACHINES) else str(len(models))
    print(
        f"building {number} of {len(MACHINES)} machines: {', '.join(f.parent.name for f in models)}"
    )

    def record(outcome: make.Outcome) -> None:
        for file in outcome.made:
            fmu_files.record(file.path, options.into)

    if failed := make.run(models, options.into, options, record):
        return failed
    if options.docs:
        write_machine_pages([load(file) for file in models], options.into)
        write_formulas_page()
    return 0


def buildable(flavour: str) -> list[str]:
    """The components that can be built in the flavour, and those that cannot be read, which the build reports."""
    compiled = flavour in ("native", "wasm", "fmi3")
    return [name for name, file in MACHINES.items() if not (compiled and _why_python_only(file))]


def _why_python_only(file: Path) -> str:
    """Why a model has no native flavour; "" if it has one, or cannot be read."""
    try:
        return str(load(file).PYTHON_ONLY)
    except ModelError:
        return ""


def write_machine_pages(models: list[ModuleType], fmus: Path) -> None:
    """Write the pages of components, with the default experiment contained in their FMUs."""
    folder = ROOT / "docs" / "machines"
    folder.mkdir(parents=True, exist_ok=True)
    for model in models:
        interface = Interface(model)
        rows = reference.carried_rows(next(fmus.rglob(f"{class_name(model)}.fmu")))
        picture = folder / f"{component_name(model)}.svg"
        picture.write_text(plot.svg(interface, rows), encoding="utf-8")
        text = page.github_markdown(interface, picture.name, folder)
        picture.with_suffix(".md").write_text(text, encoding="utf-8")


def write_formulas_page() -> None:
    """Write one page of all that the machine pages say about the formulas of their papers."""
    parts = [PAPERS]
    for name, file in MACHINES.items():
        notes = file.with_name("page.md")
        notes_text = notes.read_text(encoding="utf-8") if notes.is_file() else ""
        section = notes_text.partition(f"\n## {FORMULAS}\n")[2].partition("\n## ")[0].strip()
        if section:
            machine = f"machines/{name}.md"
            linked = rf"\1[\2]({machine}#errata-of-the-paper)\3"
            section = re.sub(ERRATUM, linked, section, flags=re.MULTILINE)
            section = re.sub(HOME, r"[`\1\2`](../\1)", section)
            parts.append(f"## [{class_name(load(file))}]({machine})\n\n{section}")
    text = page.with_github_formulas("\n\n".join(parts) + "\n")
    (ROOT / "docs" / "papers.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
