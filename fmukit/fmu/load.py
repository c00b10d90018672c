"""A model from its file: NAME.py, or NAME/model.py with the page.md and the drawing.svg beside it.

Either may import other files of its folder.
"""

import importlib.util
import itertools
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import tomllib

from ..declare.model import Model, complete_model
from ..trace.modules import source_files
from . import contract

#: The number of the next model that this process loads, which gives each model a package of its own.
NUMBERS = itertools.count()


class ModelError(Exception):
    """Why a model cannot become an FMU, in one line with the place in its file."""


def load(path: Path) -> ModuleType:
    """The module of this file, in a package that nothing else imports; a record that it lacks is empty.

    Raises ModelError.
    """
    if not path.is_file():
        raise ModelError(f"there is no file {path}")
    name = f"_model_{next(NUMBERS)}"
    sys.modules[name] = package = ModuleType(name)
    if path.stem == "model":
        name += f".{path.resolve().parent.name}"
        sys.modules[name] = package = ModuleType(name)
    package.__path__ = [str(path.absolute().parent)]
    name += f".{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ModelError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    with as_model_error(path):
        for file in source_files(path):
            contract.require_imports(file)
        spec.loader.exec_module(module)
        contract.require_spelling(path, module)
        contract.require_parts(complete_model(module))
    return module


@contextmanager
def as_model_error(path: Path) -> Iterator[None]:
    """Turn what a model raises into ModelError, with the line of its file."""
    try:
        yield
    except ModelError:
        raise
    except SyntaxError as error:
        file = path.with_name(Path(error.filename or path).name)
        raise ModelError(f"{file}:{error.lineno}: {error.msg}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        folder = path.absolute().parent
        model_frames = [f for f in frames if Path(f.filename).parent == folder]
        location = str(path)
        if model_frames:
            file = path.with_name(Path(model_frames[-1].filename).name)
            location = f"{file}:{model_frames[-1].lineno}"
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
