"""Draw the pictures of architecture.md from the code: who imports whom, and the road of a run.

usage: python docs/pictures.py [--check]

The floors come from the imports of the source files, the road from a run of two FMUs that is watched call by call.
A test checks that the page has them as they are.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
#: Width of a room's name in the pictures, so that columns line up; a convention of this page.
WIDTH = 16


def room(parts: tuple[str, ...]) -> str:
    """The room of a package that a module lies in: `engine` for cosim.engine.driver."""
    return parts[1] if len(parts) > 1 else ""


def imports(package: str) -> dict[str, set[str]]:
    """The rooms of a package and the others that each imports when it is loaded."""
    graph: dict[str, set[str]] = {}
    for file in sorted((ROOT / package).rglob("*.py")):
        parts = file.relative_to(ROOT).with_suffix("").parts
        importer = room(parts)
        if importer.startswith("__"):
            continue
        used = graph.setdefault(importer, set())
        inside = parts[:-1]
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            base = inside[: len(inside) - node.level + 1]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            used |= {room((*base, *name.split("."))) for name in names} - {importer, ""}
    return {name: {other for other in used if other in graph} for name, used in graph.items()}


def floors(package: str) -> str:
    """The rooms of a package from the top floor down: each imports only from floors below it."""
    graph = imports(package)
    levels: dict[str, int] = {}

    def level(name: str) -> int:
        if name not in levels:
            levels[name] = 1 + max((level(other) for other in graph[name]), default=-1)
        return levels[name]

    top = max(level(name) for name in graph)
    lines = [
        f"{floor:2}  "
        + "".join(name.ljust(WIDTH) for name in sorted(graph) if levels[name] == floor)
        for floor in range(top, -1, -1)
    ]
    return "\n".join(line.rstrip() for line in lines)


def road(fmus: Path) -> str:
    """The modules of `cosim` in the sequence in which a run of two native FMUs first enters them."""
    from cosim import System, run

    wires = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    system = System(
        {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}, wires
    )
    visited: dict[str, str] = {}
    prefix = str(ROOT / "cosim") + "/"

    def watch(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(prefix) and code.co_name[0] not in "<_":
            visited.setdefault(code.co_filename.removeprefix(prefix), code.co_name)

    run(system, stop=0.01, step=1e-3)  # what is cached is there afterwards
    sys.setprofile(watch)
    try:
        run(system, stop=0.01, step=1e-3)
    finally:
        sys.setprofile(None)
    return "\n".join(f"{file:32}{name}" for file, name in visited.items())


def replace_pictures(page: str, pictures: dict[str, str]) -> str:
    """The page with these pictures, each between the comments that name it."""
    for name, picture in pictures.items():
        block = f"<!-- {name} -->\n```text\n{picture}\n```\n<!-- end -->"
        pattern = rf"<!-- {name} -->.*?<!-- end -->"
        page = re.sub(pattern, lambda _, block=block: block, page, flags=re.DOTALL)
    return page


def pictures(fmus: Path) -> dict[str, str]:
    """All pictures by name."""
    return {
        "floors of cosim": floors("cosim"),
        "floors of fmukit": floors("fmukit"),
        "road": road(fmus),
    }


def main() -> int:
    """Write the page, or say whether it is as the code is."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if the page is old")
    options = parser.parse_args()
    page = PAGE.read_text(encoding="utf-8")
    new = replace_pictures(page, pictures(ROOT / "fmus" / "native"))
    if not options.check:
        PAGE.write_text(new, encoding="utf-8")
    return int(options.check and page != new)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
