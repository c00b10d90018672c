"""Couple co-simulation FMUs of FMI 2.0 and 3.0: systems of parts and wires, and their coupling errors."""

import re
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

__version__ = "1.0.0"

#: The module of each public name, imported when the name is first asked for: NumPy and SciPy take longer than most runs.
#: The stub beside this file lists them, for type checkers too.
_HOMES = {
    name: module
    for module, name in re.findall(
        r"from \.([\w.]+) import (\w+) as", Path(__file__).with_suffix(".pyi").read_text("utf-8")
    )
}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> object:
    """Load a public name from its module, or a module."""
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _HOMES:
        value = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return value
    try:
        return import_module(f"{__name__}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{__name__}.{name}":
            raise
    near = get_close_matches(name, __all__, 1)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return [*__all__, "__version__"]
