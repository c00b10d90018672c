"""A model from its file: NAME.py, or NAME/model.py with the page.md and the drawing.svg beside it."""

import importlib.util
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import tomllib

from ..declare.model import Model, complete_model
from . import contract


class ModelError(Exception):
    """Why a model cannot become an FMU, in one line with the place in its file."""


def load(path: Path) -> ModuleType:
    """The module of this file, which nothing else can import; a record that it lacks is empty.

    Raises ModelError.
    """
    name = f"{path.resolve().parent.name}.model" if path.stem == "model" else path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.exists():
        raise ModelError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    previous = sys.modules.get(name)
    sys.modules[name] = module
    try:
        with as_model_error(path):
            spec.loader.exec_module(module)
            contract.require_spelling(path, module)
            contract.require_parts(complete_model(module))
            contract.require_imports(path)
    finally:
        del sys.modules[name]
        if previous is not None:
            sys.modules[name] = previous
    return module


@contextmanager
def as_model_error(path: Path) -> Iterator[None]:
    """Turn what a model raises into ModelError, with the line of its file."""
    try:
        yield
    except ModelError:
        raise
    except SyntaxError as error:
        raise ModelError(f"{path}:{error.lineno}: {error.msg}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        model_frames = [f for f in frames if f.filename == str(path.absolute())]
        location = f"{path}:{model_frames[-1].lineno}" if model_frames else str(path)
        function_name = (
            f" in {model_frames[-1].name}:"
            if model_frames and model_frames[-1].name != "<module>"
            else ""
        )
        message = str(error).replace("'Node'", "a number").replace(".__new__()", "(...)")
        raise ModelError(
            f"{location}:{function_name} {' '.join(message.split()) or type(error).__name__}"
        ) from error


def neighbour_file(model: Model, name: str) -> Path | None:
    """The file of this name beside a model.py, if there is one."""
    file = Path(model.__file__ or "")
    path = file.with_name(name)
    return path if file.stem == "model" and path.exists() else None


def project_metadata(model: Model) -> dict[str, str]:
    """Author, licence and version of the project that a model is part of, by its pyproject.toml."""
    for folder in Path(model.__file__ or "").resolve().parents:
        if (folder / "pyproject.toml").exists():
            text = (folder / "pyproject.toml").read_text(encoding="utf-8")
            project = tomllib.loads(text).get("project", {})
            metadata = {
                "author": ", ".join(author["name"] for author in project.get("authors", ())),
                "version": project.get("version", ""),
                "license": project.get("license", ""),
            }
            return {
                name: value for name, value in metadata.items() if value and isinstance(value, str)
            }
    return {}
