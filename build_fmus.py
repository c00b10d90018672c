"""Build the FMUs: components/NAME/model.py -> fmus/Name.fmu, each validated before it is kept.

usage: python build_fmus.py [COMPONENT ...] [--flavour python|native|wasm|both] [--into DIR]
                            [--force] [--docs]

Native FMUs go to a folder `native` of their own, and modules for WebAssembly to `wasm`, which native
FMUs bring along.
"""

import argparse
import sys
from pathlib import Path
from types import ModuleType

from fmukit.declare.variables import Interface, component
from fmukit.fmu import page, plot, reference
from fmukit.fmu.load import load
from fmukit.fmu.make import FLAVOURS, make_all
from fmukit.fmu.python.instance import slave_class

ROOT = Path(__file__).resolve().parent
MACHINES = {file.parent.name: file for file in sorted(ROOT.glob("components/*/model.py"))}


def main() -> int:
    parser = argparse.ArgumentParser(description="Build and validate the FMUs.")
    parser.add_argument("component", nargs="*", help=f"one of {', '.join(MACHINES)} (default all)")
    parser.add_argument("--flavour", choices=FLAVOURS, default="python")
    parser.add_argument("--into", type=Path, default=ROOT / "fmus", help="folder of the FMUs")
    parser.add_argument("--force", action="store_true", help="build also what is up to date")
    parser.add_argument("--docs", action="store_true", help="also write docs/machines")
    options = parser.parse_args()
    known = {plain(name): file for name, file in MACHINES.items()}
    unknown = [name for name in options.component if plain(name) not in known]
    if unknown:
        parser.error(f"unknown component {unknown[0]!r}; there are {', '.join(MACHINES)}")
    if options.docs:
        write_pages([load(file) for file in MACHINES.values()])
    models = [known[plain(name)] for name in options.component or MACHINES]
    return min(1, make_all(models, options.flavour, options.into, options.force))


def plain(name: str) -> str:
    """A component's name whether it is spelt as its folder or as its FMU: drivemotor."""
    return name.replace("_", "").lower()


def write_pages(models: list[ModuleType]) -> None:
    """Write the page of every component, with the plot of its default experiment."""
    folder = ROOT / "docs" / "machines"
    folder.mkdir(parents=True, exist_ok=True)
    for model in models:
        interface = Interface(model)
        rows = reference.experiment(slave_class(model, "page"))
        picture = folder / f"{component(model)}.svg"
        picture.write_text(plot.svg(interface, rows), encoding="utf-8")
        text = page.github(interface, picture.name, folder)
        picture.with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
