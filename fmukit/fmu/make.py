"""Make the FMUs of models: pack, validate, play against their own reference, and then keep them."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from ..declare.interface import co_simulation_only_reason, component_name
from . import validate
from .archive import is_current, is_current_module
from .load import ModelError, as_model_error, load
from .native import package as native
from .python import package as python
from .workplace import interruptible, keep, results, workplace

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
) -> int:
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
        What to do with the outcome of each model, in their order.

    Returns
    -------
    int
        How many files could not be made.

    Raises
    ------
    KeyboardInterrupt
        For Ctrl-C and other signals that ask to stop; files that are made stay.
    OSError
        If the folder cannot be written.
    """
    paths, failed = list(models), 0
    names = native.ALL if platforms == "all" else native.HOST
    make_one = partial(make, flavour=flavour, out=out, force=force, platforms=names)
    with interruptible(), workplace(out) as folder:
        try:
            for outcome in results(make_one, paths, folder):
                report(outcome)
                failed += len(outcome.errors)
        except BrokenProcessPool:
            message = "a process of the build was killed, perhaps for want of memory; what was built stays"
            report(Outcome([], [], [], [f"error: {message}: enter the command again"]))
            failed += 1
    return failed


def make(path: Path, flavour: str, out: Path, force: bool, platforms: tuple[str, ...]) -> Outcome:
    """Make the FMUs and the module of one model."""
    outcome = Outcome([], [], [], [])
    try:
        model = load(path)
        with as_model_error(path):
            outcome.remarks.extend(_remarks(model, flavour))
            for file, build, pack in _files(model, flavour, platforms):
                try:
                    made, warnings = make_file(out / file, build, pack, force)
                except _NotMadeError as reason:
                    outcome.errors.append(str(reason))
                else:
                    outcome.made.append(made)
                    outcome.warnings.extend(warnings)
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


Build = python.Build | native.NativeBuild
Pack = Callable[[Any, Path], None]


def _files(
    model: ModuleType, flavour: str, platforms: tuple[str, ...]
) -> Iterator[tuple[str, Build, Pack]]:
    """The files of a flavour, with what each is made from and the function that writes it."""
    if flavour in ("python", "both", "all"):
        build = python.collect(model)
        yield f"{build.name}.fmu", build, python.pack
    if flavour == "python" or model.PYTHON_ONLY:
        return
    if flavour != "fmi3":
        second = native.collect(model, 2, platforms)
        if flavour != "wasm":
            yield f"native/{second.name}.fmu", second, native.pack
        yield f"wasm/{second.name}.wasm", second, native.write_module
    if flavour in ("fmi3", "all"):
        third = native.collect(model, 3, platforms)
        yield f"fmi3/{third.name}.fmu", third, native.pack


class _NotMadeError(Exception):
    """Why a file is not there, in words that name it."""


def make_file(path: Path, build: Build, pack: Pack, force: bool) -> tuple[Made, Sequence[str]]:
    """Make one FMU or module unless it is up to date; what there is to warn of, if it was made now.

    Raises _NotMadeError, and then nothing is kept but what was there before.
    """
    made = Made(path, build.guid, is_new=True)
    module = path.suffix == ".wasm"
    current = (
        is_current_module(build.guid, path)
        if module
        else is_current(build.guid, build.members, path)
    )
    if current and not force:
        return made._replace(is_new=False), ()
    try:
        with tempfile.TemporaryDirectory() as folder:
            candidate = Path(folder) / path.name
            pack(build, candidate)
            if not module:
                _require_valid(candidate, made.label)
            keep(candidate, path)
    except RuntimeError as error:
        raise _NotMadeError(f"{made.label} cannot be built: {error}") from None
    except OSError as error:
        raise _NotMadeError(f"{path} cannot be written: {reason_of(error)}") from None
    return made, [] if module else [f"{made.label}: warning: {text}" for text in build.warnings]


def reason_of(error: OSError) -> str:
    """What an error of the operating system says, with the file that it is about."""
    return f"{error.strerror or error}" + (f": {error.filename}" if error.filename else "")


def _require_valid(fmu: Path, label: str) -> None:
    if problems := validate.problems(fmu) or list(validate.differences(fmu)):
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
        failed = make_all(models, options.flavour, out, options.force, options.platforms, show)
    except KeyboardInterrupt:
        print("interrupted; what was built stays, and the same command continues", file=sys.stderr)
        return 130
    except OSError as error:
        return _refuse(f"{out} cannot be written: {reason_of(error)}", 1)
    return min(1, failed)


def _refuse(sentence: str, status: int = 2) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return status
