"""The modules of a model: its own, and those of files beside it, as in `from .geometry import run`."""

import ast
import sys
from pathlib import Path
from types import ModuleType


def source_files(model: Path) -> list[Path]:
    """The file of a model and the files beside it that it imports, by itself or through each other."""
    files = [model]
    for file in files:
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8"), str(file)))
        imported = {path for node in nodes for path in imported_files(model, node)}
        files += sorted(imported - {*files})
    return files


def imported_files(model: Path, node: ast.AST) -> list[Path]:
    """The files beside a model that a node imports; none if one of them does not exist."""
    if not isinstance(node, ast.ImportFrom) or node.level != 1:
        return []
    names = [node.module] if node.module else [alias.name for alias in node.names]
    files = [model.with_name(f"{name}.py") for name in names]
    return files if all(file.is_file() for file in files) else []


def modules(model: ModuleType) -> list[ModuleType]:
    """A model and what else has been imported of its package, which `load` gives to nothing else."""
    package = f"{model.__package__}."
    names = [name for name in list(sys.modules) if model.__package__ and name.startswith(package)]
    return [model, *(sys.modules[name] for name in names if name != model.__name__)]
