"""Build the FMUs: components/NAME/model.py -> fmus/Name.fmu, each validated before it is kept.

usage: python build_fmus.py [COMPONENT ...] [--flavour python|native|both] [--into DIR] [--force]
                            [--docs]

Native FMUs go to a folder `native` of their own.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from fmukit.declare.variables import Interface, component
from fmukit.fmu import page, plot, reference, validate
from fmukit.fmu.archive import is_current
from fmukit.fmu.load import load
from fmukit.fmu.native import build as native
from fmukit.fmu.python import pack as python
from fmukit.fmu.python.instance import slave_class

ROOT = Path(__file__).resolve().parent
MACHINES = {file.parent.name: file for file in sorted(ROOT.glob("components/*/model.py"))}
Build = TypeVar("Build", python.Build, native.NativeBuild)


def main() -> int:
    parser = argparse.ArgumentParser(description="Build and validate the FMUs.")
    parser.add_argument("component", nargs="*", help=f"one of {', '.join(MACHINES)} (default all)")
    parser.add_argument("--flavour", choices=("python", "native", "both"), default="python")
    parser.add_argument("--into", type=Path, default=ROOT / "fmus", help="folder of the FMUs")
    parser.add_argument("--force", action="store_true", help="build also what is up to date")
    parser.add_argument("--docs", action="store_true", help="also write docs/machines")
    options = parser.parse_args()
    unknown = [name for name in options.component if name not in MACHINES]
    if unknown:
        parser.error(f"unknown component {unknown[0]!r}; there are {', '.join(MACHINES)}")
    if options.docs:
        write_pages([load(file) for file in MACHINES.values()])
    return max(make_all(options.component or [*MACHINES], options))


def make_all(components: Sequence[str], options: argparse.Namespace) -> Iterator[int]:
    """Make every FMU that is asked for; 1 for each that is not valid."""
    for name in components:
        model = load(MACHINES[name])
        if options.flavour != "native":
            build = python.collect(model)
            yield make(build, python.pack, options.into, "", options.force)
        if options.flavour != "python" and hasattr(model, "PYTHON_ONLY"):
            print(f"{name} has no native flavour: {model.PYTHON_ONLY}")
            yield int(name in options.component)
        elif options.flavour != "python":
            compiled = native.collect(model)
            yield make(compiled, native.pack, options.into, "native/", options.force)


def make(
    build: Build, pack: Callable[[Build, Path], None], into: Path, folder: str, force: bool
) -> int:
    """Build one FMU unless it is up to date; 1 if it is not valid, and then nothing is kept."""
    label = f"{folder}{build.name}.fmu"
    fmu = into / label
    if not force and is_current(build.guid, fmu):
        print(f"{label} is up to date")
        return 0
    fmu.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=fmu.parent, prefix=".building-") as temporary:
        candidate = Path(temporary) / fmu.name
        try:
            pack(build, candidate)
        except RuntimeError as error:
            print(f"{label} cannot be built: {error}", file=sys.stderr)
            return 1
        problems = validate.problems(candidate)
        if problems:
            print(f"{label} is not valid and was not kept:", *problems, sep="\n  ", file=sys.stderr)
            return 1
        candidate.replace(fmu)
    print(f"{label} built and valid, {fmu.stat().st_size // 1024} KiB, guid {build.guid}")
    return 0


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
