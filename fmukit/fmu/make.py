"""Make the FMUs of models: pack, validate, play against their own reference, and then keep them."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from ..codegen.entries import generate
from ..declare.interface import class_name, co_simulation_only_reason, component_name
from . import validate
from .archive import is_current, is_current_wasm
from .load import ModelError, as_model_error, load
from .native import package as native
from .python import package as python
from .workplace import interruptible, put_in_place, results, workplace

FLAVOURS = ("python", "native", "wasm", "both", "fmi3", "all")
COMPILED = ("native", "wasm", "both", "fmi3", "all")
PLATFORMS = ("host", "all")


class Made(NamedTuple):
    """A file that is there: where, its GUID, and whether it was built now or was up to date."""

    path: Path
    guid: str
    is_new: bool

    @property
    def label(self) -> str:
        """Its name, with the folder of its flavour."""
        folder = self.path.parent.name
        return (
            f"{folder}/{self.path.name}" if folder in ("native", "wasm", "fmi3") else self.path.name
        )


class Outcome(NamedTuple):
    """What became of the files of one model: those that are there, remarks, warnings, and an error for each other."""

    made: list[Made]
    remarks: list[str]
    warnings: list[str]
    errors: list[str]


def print_outcome(outcome: Outcome, verbose: bool = False) -> None:
    """Print a line for what was built and one for what was up to date; in full, a line for each file."""
    for sentence in outcome.remarks:
        print(sentence)
    for is_new, words in ((True, "built and valid"), (False, "up to date")):
        files = [made for made in outcome.made if made.is_new == is_new]
        if verbose:
            for made in files:
                size = made.path.stat().st_size // 1024
                print(f"{made.label} {words}, {size} KiB, guid {made.guid}")
        elif files:
            print(f"{', '.join(made.label for made in files)} {words}")
    sys.stdout.flush()
    for sentence in (*outcome.warnings, *outcome.errors):
        print(sentence, file=sys.stderr, flush=True)


def make_all(
    models: Iterable[Path],
    flavour: str,
    out: Path,
    force: bool = False,
    platforms: str = "host",
    report: Callable[[Outcome], Any] = print_outcome,
) -> list[str]:
    """Make NAME.fmu of every model, compiled ones in separate folders, and NAME.wasm; each core takes a model.

    Parameters
    ----------
    models : iterable of Path
        The files of the models.
    flavour : str
        One of FLAVOURS.
    out : Path
        The folder of the FMUs, which is made.
    force : bool
        Whether also what is up to date is made again.
    platforms : str
        "host": native FMUs run on this machine, "all": on every platform of FMI. What was made for all is up to
        date for this machine, and not the other way round.
    report : callable
        What to do with the outcome of each model as soon as it and those before it are there.

    Returns
    -------
    list of str
        An error for each file that could not be made.

    Raises
    ------
    KeyboardInterrupt
        For Ctrl-C and other signals that ask to stop; files that are made stay.
    OSError
        If the folder cannot be written.
    """
    errors: list[str] = []
    names = native.ALL if platforms == "all" else native.HOST
    make_one = partial(make, flavour=flavour, out=out, force=force, platforms=names)
    with interruptible(), workplace(out) as folder:
        try:
            for outcome in results(make_one, list(models), folder):
                errors += outcome.errors
                report(outcome)
        except BrokenProcessPool:
            message = "a process of the build was killed, perhaps for want of memory; what was built stays"
            errors.append(f"error: {message}: enter the command again")
            report(Outcome([], [], [], errors[-1:]))
    return errors


def make(path: Path, flavour: str, out: Path, force: bool, platforms: tuple[str, ...]) -> Outcome:
    """Make the FMUs and the module of one model."""
    outcome = Outcome([], [], [], [])
    try:
        model = load(path)
        with as_model_error(path):
            outcome.remarks.extend(_remarks(model, flavour))
            for product in _products(model, flavour, platforms):
                try:
                    made = make_file(out, product, force)
                except _NotMadeError as reason:
                    outcome.errors.append(str(reason))
                    continue
                outcome.made.append(made)
                if made.is_new and made.path.suffix == ".fmu" and not model.PYTHON_ONLY:
                    warnings = generate(model).warnings
                    outcome.warnings.extend(f"{made.label}: warning: {text}" for text in warnings)
    except ModelError as refusal:
        outcome.errors.append(str(refusal))
    return outcome


def _remarks(model: ModuleType, flavour: str) -> Iterator[str]:
    """What the native FMUs of a model cannot be."""
    if flavour == "python":
        return
    if model.PYTHON_ONLY:
        sentence = f"{component_name(model)} has no native flavour: {model.PYTHON_ONLY}"
        if flavour not in ("both", "all"):
            raise ModelError(sentence)
        yield sentence
    elif why := co_simulation_only_reason(model):
        yield f"{component_name(model)} has no model exchange: {why}"


class Product(NamedTuple):
    """A file to make: its place, its GUID, what an FMU must contain to be up to date, the function that writes it."""

    place: str
    guid: str
    libraries: Collection[str]
    write: Callable[[Path], None]


def _products(model: ModuleType, flavour: str, platforms: tuple[str, ...]) -> Iterator[Product]:
    """The files of a flavour."""
    name = class_name(model)
    if flavour in ("python", "both", "all"):
        build = python.hashed_build(model)
        yield Product(f"{name}.fmu", build.guid, (), partial(python.write_fmu, build))
    if flavour == "python" or model.PYTHON_ONLY:
        return
    versions = {"fmi3": (3,), "all": (2, 3)}.get(flavour, (2,))
    for compiled in (native.hashed_build(model, fmi, platforms) for fmi in versions):
        guid, libraries = compiled.guid, compiled.targets_by_library
        write = partial(native.write_fmu, compiled)
        if compiled.fmi == 3:
            yield Product(f"fmi3/{name}.fmu", guid, libraries, write)
            continue
        if flavour != "wasm":
            yield Product(f"native/{name}.fmu", guid, libraries, write)
        yield Product(f"wasm/{name}.wasm", guid, (), partial(native.write_wasm, compiled))


class _NotMadeError(Exception):
    """Why a file is not there, in words that name it."""


def make_file(out: Path, product: Product, force: bool) -> Made:
    """Make one FMU or module in this folder unless it is up to date.

    Raises _NotMadeError, and then nothing is kept but what was there before.
    """
    path = out / product.place
    made, is_wasm = Made(path, product.guid, is_new=True), path.suffix == ".wasm"
    is_there = (
        is_current_wasm(product.guid, path)
        if is_wasm
        else is_current(product.guid, product.libraries, path)
    )
    if is_there and not force:
        return made._replace(is_new=False)
    try:
        with tempfile.TemporaryDirectory() as folder:
            candidate = Path(folder) / path.name
            product.write(candidate)
            if not is_wasm:
                _require_valid(candidate, made.label)
            put_in_place(candidate, path)
    except RuntimeError as error:
        raise _NotMadeError(f"{made.label} cannot be built: {error}") from None
    except OSError as error:
        raise _NotMadeError(f"{path} cannot be written: {reason_of(error)}") from None
    return made


def reason_of(error: OSError) -> str:
    """What an error of the operating system says, with the file that it is about."""
    return f"{error.strerror or error}" + (f": {error.filename}" if error.filename else "")


def _require_valid(fmu: Path, label: str) -> None:
    if problems := validate.problems(fmu) or list(validate.differences_from_reference(fmu)):
        lines = "\n  ".join([f"{label} is not valid and was not kept:", *problems])
        raise _NotMadeError(lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that builds FMUs, but for the folder."""
    default = "both" if find_spec("ziglang") and native.HOST else "python"
    parser.add_argument(
        "--flavour",
        choices=FLAVOURS,
        default=default,
        help="python; native, from C; wasm, for browsers; both, which is these three; fmi3, native in FMI 3.0; or "
        f"all (default here: {default})",
    )
    parser.add_argument(
        "--platforms",
        choices=PLATFORMS,
        default="host",
        help=f"where native FMUs run: on this machine ({', '.join(native.HOST) or 'none'}, the default), or on "
        f"all of {', '.join(native.ALL)}",
    )
    parser.add_argument("--force", action="store_true", help="rebuild even what is up to date")
    parser.add_argument(
        "--verbose", action="store_true", help="print the size and the GUID of each file"
    )


def run(
    models: Iterable[Path],
    out: Path,
    options: argparse.Namespace,
    report: Callable[[Outcome], Any] = lambda _: None,
) -> int:
    """Make what these options ask for and print what becomes of it; returns the exit status."""
    if options.flavour in COMPILED:
        if not find_spec("ziglang"):
            return _refuse(
                f"--flavour {options.flavour} needs a C compiler: "
                'write pip install "drive-fmus[native]", in a clone uv sync --extra native'
            )
        if options.platforms == "host" and not native.HOST:
            return _refuse(
                "no native FMU can be built for this machine: write --flavour python, or --platforms all for others"
            )

    def show(outcome: Outcome) -> None:
        print_outcome(outcome, options.verbose)
        report(outcome)

    try:
        errors = make_all(models, options.flavour, out, options.force, options.platforms, show)
    except KeyboardInterrupt:
        print("interrupted; what was built stays, and the same command continues", file=sys.stderr)
        return 130
    except OSError as error:
        return _refuse(f"{out} cannot be written: {reason_of(error)}", 1)
    return int(bool(errors))


def _refuse(sentence: str, status: int = 2) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return status
