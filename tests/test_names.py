"""A class name has one meaning on the master's side of the FMU, and a constant that a reader meets twice one value."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from tests.conftest import ROOT

#: The kit, on the other side of the FMU, has words of its own.
PACKAGES = ("cosim", "workbench", "scenarios", "gallery", "reference_systems")
#: Folders of pages of one form: the name of what each page declares is that of the form.
PAGES = ("questions", "commands", "models")


def modules() -> Iterator[tuple[Path, ast.Module]]:
    """The files of the packages, but for models of equations, and their syntax trees."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.parent != ROOT / "reference_systems" / "models":
                yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def constants(module: ast.Module) -> Iterator[tuple[str, str]]:
    """The constants of a module, in capitals, and the text of the value of each."""
    for node in module.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            for name in node.targets if isinstance(node, ast.Assign) else [node.target]:
                if isinstance(name, ast.Name) and name.id.isupper():
                    yield name.id, ast.unparse(node.value)


def imports(path: Path, module: ast.Module) -> Iterator[tuple[str, str]]:
    """What a module imports by name: from where, and the name."""
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom):
            base = path.parts[: len(path.parts) - node.level] if node.level else ()
            source = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((source, alias.name) for alias in node.names)


def test_a_class_has_a_name_of_its_own() -> None:
    places = defaultdict(list)
    for path, module in modules():
        for node in ast.walk(module):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path}:{node.lineno}")
    assert not {name: found for name, found in places.items() if len(found) > 1}


def test_a_constant_has_one_value() -> None:
    """Among the modules of a folder, and among all constants that other modules import by name."""
    trees = dict(modules())
    taken = {found for path, module in trees.items() for found in imports(path, module)}
    values = defaultdict(dict)
    for path, module in trees.items():
        source = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
        for name, value in constants(module):
            if path.parent.name not in PAGES:
                values[path.parent, name][source] = value
            if (source, name) in taken:
                values["imported", name][source] = value
    assert not {name: found for name, found in values.items() if len({*found.values()}) > 1}
