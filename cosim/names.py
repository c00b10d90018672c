"""Public names, loaded when they are asked for; and what a wrong name is answered with: all there are, and the nearest."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from difflib import get_close_matches
from heapq import nlargest
from importlib import import_module
from os.path import commonprefix
from pathlib import Path
from typing import Any

#: Names up to which a message lists all. A convention: they fill a few lines of a screen.
MOST_LISTED = 40
#: The nearest names that it lists of more. A convention: names of so many variables are long.
NEAREST = 12
#: Names of many that are compared in full. A convention: they take a tenth of a second.
MOST_COMPARED = 1024


def only(wrong: object, names: Iterable[str]) -> str:
    """The words "only a, b" of what there is, of many the nearest, and "; did you mean b?" where a name is near."""
    known = [*dict.fromkeys(names)]
    listed, more = known, ""
    if len(known) > MOST_LISTED:
        listed = get_close_matches(str(wrong), _alike(str(wrong), known), NEAREST, 0.0)
        more = f" and {len(known) - NEAREST} more"
    return f"only {', '.join(listed) or 'none'}{more}{meant(wrong, known)}"


def meant(wrong: object, names: Iterable[str]) -> str:
    """The words "; did you mean b?" where a name is near, in whatever letters, else nothing."""
    by_lower = {name.lower(): name for name in names}
    lower = str(wrong).lower()
    near = get_close_matches(lower, _alike(lower, by_lower), 1)
    return f"; did you mean {by_lower[near[0]]}?" if near else ""


def _alike(wrong: str, names: Collection[str]) -> Collection[str]:
    """The names themselves, or of very many those that begin and end most like the wrong one."""

    def common(name: str) -> int:
        return sum(len(commonprefix([wrong[::way], name[::way]])) for way in (1, -1))  # noqa: RUF071 - no paths

    return names if len(names) <= MOST_COMPARED else nlargest(MOST_COMPARED, names, common)


def load_on_request(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose public names the stub beside its file lists.

    A name is imported when it is first asked for: NumPy and SciPy take longer than most runs.
    """
    stub = Path(file).with_suffix(".pyi").read_text("utf-8")
    homes = {name: home for home, name in re.findall(r"from \.([\w.]+) import (\w+) as", stub)}
    public = sorted(homes)

    def load(name: str) -> Any:
        """Return a public name from its module, or a module; raises AttributeError."""
        if name.startswith("_"):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            if name in homes:
                value = getattr(import_module(f"{package}.{homes[name]}"), name)
                setattr(import_module(package), name, value)
                return value
            return import_module(f"{package}.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"{package}.{name}":
                raise
        raise AttributeError(f"module {package!r} has no attribute {name!r}{meant(name, public)}")

    return load, lambda: [*public, "__version__"], public
