"""A model from its file: NAME.py, or NAME/model.py with the page.md and the drawing.svg beside it."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType


def load(path: Path) -> ModuleType:
    """The module of this file, which nobody else can import."""
    name = f"{path.resolve().parent.name}.model" if path.stem == "model" else path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    before = sys.modules.get(name)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[name]
        if before is not None:
            sys.modules[name] = before
    return module


def beside(model: ModuleType, name: str) -> Path | None:
    """The file of this name beside a model.py, if there is one."""
    file = Path(model.__file__ or "")
    found = file.with_name(name)
    return found if file.stem == "model" and found.exists() else None
