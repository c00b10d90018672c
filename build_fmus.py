"""Build the FMUs: components/NAME.py -> fmus/Name.fmu, each validated before it is kept.

usage: python build_fmus.py [COMPONENT ...] [--into DIR] [--force] [--docs]
"""

import argparse
import sys
import tempfile
from pathlib import Path

from components import CATALOGUE
from components.kit.interface import Interface, title
from components.packing import page, validate
from components.packing.pack import Build, collect, is_current, pack

ROOT = Path(__file__).resolve().parent


def main() -> int:
    parser = argparse.ArgumentParser(description="Build and validate the FMUs.")
    parser.add_argument("component", nargs="*", help=f"one of {', '.join(CATALOGUE)} (default all)")
    parser.add_argument("--into", type=Path, default=ROOT / "fmus", help="folder of the FMUs")
    parser.add_argument("--force", action="store_true", help="build also what is up to date")
    parser.add_argument("--docs", action="store_true", help="also write docs/variables.md")
    options = parser.parse_args()
    unknown = [name for name in options.component if name not in CATALOGUE]
    if unknown:
        parser.error(f"unknown component {unknown[0]!r}; there are {', '.join(CATALOGUE)}")
    builds = [collect(name) for name in options.component or CATALOGUE]
    if options.docs:
        write_tables([collect(name) for name in CATALOGUE])
    return max(make(build, options.into, options.force) for build in builds)


def make(build: Build, folder: Path, force: bool) -> int:
    """Build one FMU unless it is up to date; 1 if it is not valid, and then nothing is kept."""
    fmu = folder / f"{build.name}.fmu"
    if not force and is_current(build, fmu):
        print(f"{fmu.name} is up to date")
        return 0
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".building-") as temporary:
        candidate = Path(temporary) / fmu.name
        pack(build, candidate)
        problems = validate.problems(candidate)
        if problems:
            print(
                f"{fmu.name} is not valid and was not kept:", *problems, sep="\n  ", file=sys.stderr
            )
            return 1
        candidate.replace(fmu)
    print(f"{fmu.name} built and valid, {fmu.stat().st_size // 1024} KiB, guid {build.guid}")
    return 0


def write_tables(builds: list[Build]) -> None:
    """Write the variable tables of the documentation."""
    sections = [
        f"## {build.name}\n\n{title(build.model)}.\n\n{page.markdown_table(Interface(build.model))}\n"
        for build in builds
    ]
    text = "# Variables of the FMUs\n\nWritten by `build_fmus.py --docs`.\n\n" + "\n".join(sections)
    (ROOT / "docs" / "variables.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
