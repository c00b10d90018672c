"""Make the FMUs of a model: packed, validated, played against their own reference, and then kept."""

import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from ..declare.variables import component, only_steps
from . import validate
from .archive import is_current
from .load import Refused, load, refusing
from .native import build as native
from .python import pack as python

FLAVOURS = ("python", "native", "both")
Build = TypeVar("Build", python.Build, native.NativeBuild)


def make_all(models: Iterable[Path], flavour: str, out: Path, force: bool = False) -> int:
    """Make NAME.fmu of every model, native ones in a folder of their own; how many failed."""
    failed = 0
    for path in models:
        try:
            model = load(path)
            with refusing(path):
                failed += sum(not made for made in make(model, flavour, out, force))
        except Refused as refused:
            print(refused, file=sys.stderr)
            failed += 1
    return failed


def make(model: ModuleType, flavour: str, out: Path, force: bool) -> Iterator[bool]:
    """Make the FMUs of one model; whether each is there."""
    if flavour != "native":
        build = python.collect(model)
        yield kept(build, python.pack, out / f"{build.name}.fmu", force)
    if flavour == "python":
        return
    if hasattr(model, "PYTHON_ONLY"):
        print(f"{component(model)} has no native flavour: {model.PYTHON_ONLY}")
        yield flavour != "native"
        return
    if why := only_steps(model):
        print(f"{component(model)} has no model exchange: {why}")
    compiled = native.collect(model)
    yield kept(compiled, native.pack, out / "native" / f"{compiled.name}.fmu", force)


def kept(build: Build, pack: Callable[[Build, Path], None], fmu: Path, force: bool) -> bool:
    """Make one FMU unless it is up to date; False if it is not valid, and then nothing is kept."""
    label = f"{'native/' if fmu.parent.name == 'native' else ''}{fmu.name}"
    if not force and is_current(build.guid, fmu):
        print(f"{label} is up to date")
        return True
    fmu.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=fmu.parent, prefix=".building-") as temporary:
        candidate = Path(temporary) / fmu.name
        try:
            pack(build, candidate)
        except RuntimeError as error:
            print(f"{label} cannot be built: {error}", file=sys.stderr)
            return False
        problems = validate.problems(candidate) or list(validate.differences(candidate))
        if problems:
            print(f"{label} is not valid and was not kept:", *problems, sep="\n  ", file=sys.stderr)
            return False
        candidate.replace(fmu)
    print(f"{label} built and valid, {fmu.stat().st_size // 1024} KiB, guid {build.guid}")
    return True
