"""Make the FMUs of a model: pack, validate, play against their own reference, and then keep them."""

import io
import multiprocessing
import signal
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from ..declare.interface import co_simulation_only_reason, component_name
from . import validate
from .archive import is_current
from .load import ModelError, as_model_error, load
from .native import package as native
from .python import package as python

FLAVOURS = ("python", "native", "wasm", "both", "fmi3", "all")
Build = TypeVar("Build", python.Build, native.NativeBuild)


def make_all(models: Iterable[Path], flavour: str, out: Path, force: bool = False) -> int:
    """Make NAME.fmu of every model, compiled ones in separate folders, and NAME.wasm.

    Returns how many failed. Each core takes a model.
    """
    paths, build_from_file = (
        list(models),
        partial(make_from_file, flavour=flavour, out=out, force=force),
    )
    if len(paths) == 1:
        return _print_results([build_from_file(paths[0])])
    with multiprocessing.Pool(initializer=_set_child_signals) as pool:
        failed = _print_results(pool.imap(build_from_file, paths, 1))
        pool.close()
        pool.join()  # a child that is terminated as it begins to wait may miss it
    return failed


def make_from_file(path: Path, flavour: str, out: Path, force: bool) -> tuple[int, str, str]:
    """Make the FMUs of one model; returns how many failed, and the output for stdout and stderr."""
    failed = 0
    with redirect_stdout(io.StringIO()) as stdout, redirect_stderr(io.StringIO()) as stderr:
        try:
            model = load(path)
            with as_model_error(path):
                failed += sum(not succeeded for succeeded in make(model, flavour, out, force))
        except ModelError as refusal:
            print(refusal, file=sys.stderr)
            failed += 1
    return failed, stdout.getvalue(), stderr.getvalue()


def _set_child_signals() -> None:
    """Leave Ctrl-C to the parent, which then ends its children; they clean up."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _print_results(results: Iterable[tuple[int, str, str]]) -> int:
    total = 0
    for failed, stdout, stderr in results:
        print(stdout, end="", flush=True)
        print(stderr, end="", file=sys.stderr, flush=True)
        total += failed
    return total


def make(model: ModuleType, flavour: str, out: Path, force: bool) -> Iterator[bool]:
    """Make the FMUs and the module of one model; whether each is there."""
    if flavour in ("python", "both", "all"):
        build = python.collect(model)
        yield build_if_outdated(build, python.pack, out / f"{build.name}.fmu", force)
    if flavour == "python":
        return
    if model.PYTHON_ONLY:
        print(f"{component_name(model)} has no native flavour: {model.PYTHON_ONLY}")
        yield flavour in ("both", "all")
        return
    if why := co_simulation_only_reason(model):
        print(f"{component_name(model)} has no model exchange: {why}")
    if flavour != "fmi3":
        compiled = native.collect(model)
        if flavour != "wasm":
            yield build_if_outdated(
                compiled, native.pack, out / "native" / f"{compiled.name}.fmu", force
            )
        yield build_module_if_outdated(compiled, out / "wasm" / f"{compiled.name}.wasm", force)
    if flavour in ("fmi3", "all"):
        third = native.collect(model, 3)
        yield build_if_outdated(third, native.pack, out / "fmi3" / f"{third.name}.fmu", force)


def build_module_if_outdated(build: native.NativeBuild, path: Path, force: bool) -> bool:
    """Make the module for WebAssembly unless it is up to date, which its guid shows.

    Returns whether the module is there.
    """
    if not force and path.is_file() and build.guid.encode() in path.read_bytes():
        print(f"wasm/{path.name} is up to date")
        return True
    try:
        content = native.wasm_module(build)
    except RuntimeError as error:
        print(f"wasm/{path.name} cannot be built: {error}", file=sys.stderr)
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".building-") as temporary:
        candidate = Path(temporary) / path.name
        candidate.write_bytes(content)
        candidate.replace(path)
    print(f"wasm/{path.name} built, {len(content) // 1024} KiB, guid {build.guid}")
    return True


def build_if_outdated(
    build: Build, pack: Callable[[Build, Path], None], fmu: Path, force: bool
) -> bool:
    """Make one FMU unless it is up to date; False if it is not valid, and then nothing is kept."""
    folder = fmu.parent.name
    label = f"{folder}/{fmu.name}" if folder in ("native", "fmi3") else fmu.name
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
    for sentence in build.warnings:
        print(f"{label}: warning: {sentence}", file=sys.stderr)
    return True
