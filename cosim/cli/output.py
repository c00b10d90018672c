"""What a command writes and prints: files that are checked before a run, tables, warnings."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile, mkdtemp

from .. import describe
from ..engine.recorder import Stream
from ..errors import SetupError
from ..result import Result, require_writable_names
from ..result import partial as partial_file
from ..table_file import facts_path, is_of_result
from .options import require

#: What files of rows may end in.
TABLES = (".csv", ".parquet")


def write_result(result: Result, path: Path, part: str | None) -> None:
    """Write a result at the end of its run, into a folder for temporary files if its own is full."""
    try:
        result.write(path, part=part)
    except OSError as error:
        rescue = Path(mkdtemp(prefix="rows_")) / f"{path.stem}.csv"
        result.write(rescue, part=part)
        raise OSError(
            f"{path} cannot be written: {error.strerror or error}; the rows are in {rescue}"
        ) from error


@contextmanager
def locked_for_writing(path: Path | None) -> Iterator[None]:
    """Keep other runs from a file that is written at the end; SetupError if one writes it now."""
    if path is None:
        yield
        return
    claim = Stream(partial_file(path.with_suffix(".csv")))
    try:
        yield
    finally:
        if claim.path.exists() and not claim.path.stat().st_size:
            claim.path.unlink()
        claim.close()


def require_separate_files(options: argparse.Namespace, parts: Iterable[Path] = ()) -> None:
    """Raise SetupError for an output that is a file which the command reads, or the JSON file beside a table.

    A JSON file that no result of this master has is nobody's to overwrite either.
    """
    given = {
        name: value if isinstance(value, list) else [value] for name, value in vars(options).items()
    }
    outputs = [p for name in ("out", "plot") for p in given.pop(name, []) if isinstance(p, Path)]
    read = [Path(text.partition("=")[2] or text) for text in given.pop("files", [])]
    read += [path for values in given.values() for path in values if isinstance(path, Path)]
    read += map(Path, parts)
    tables = [path for path in outputs if path.suffix.lower() in TABLES]
    beside, unfinished = [*map(facts_path, tables)], [*map(partial_file, tables)]
    journals = [path.with_suffix(".journal") for path in unfinished]
    for output in (*outputs, *beside, *unfinished, *map(facts_path, unfinished), *journals):
        if not _is_file(output):
            continue
        for path in (*read, *(facts_path(x) for x in read if x.name)):
            if path.is_file() and path.samefile(output):
                raise SetupError(
                    f"{output} is read by this command and would be overwritten: write another --out"
                )
    for path in filter(_is_file, beside):
        if not is_of_result(path):
            raise SetupError(
                f"{path} is no file of a result and would be overwritten: move it, or write another --out"
            )


def _is_file(path: Path) -> bool:
    """Whether there is such a file; a name that is too long for one is refused where it is to be written."""
    try:
        return path.is_file()
    except OSError:
        return False


def require_outputs(options: argparse.Namespace) -> None:
    """Raise SetupError, before a run, for a table or a picture that could not be written at its end."""
    require_image(options.plot)
    if options.out is not None:
        require_writable(options.out)
        require_writable_names(options.out)
        if options.out.suffix.lower() not in TABLES:
            raise SetupError(f"{options.out} must end in .csv or .parquet")
        if options.out.suffix.lower() == ".parquet":
            require("pyarrow", f"{options.out}: Parquet")


def require_writable(path: Path) -> None:
    """Raise SetupError for a path that no file can have; make its folder."""
    if path.is_dir():
        raise SetupError(f"{path} is a folder")
    folder = path.absolute().parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror}") from error


def require_image(path: Path | None) -> None:
    """Raise SetupError for an image that could not be written."""
    if path is None:
        return
    require_writable(path)
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix[1:] not in (kinds := FigureCanvasBase.get_supported_filetypes()):
        raise SetupError(f"{path} must end in one of {', '.join(kinds)}")


def new_folders(options: argparse.Namespace) -> list[Path]:
    """Return the folders that must be made for the files to write, the outermost of each."""
    folders = []
    for path in filter(None, (options.out, options.plot)):
        missing = [folder for folder in path.parents if not folder.exists()]
        folders += missing[-1:]
    return list(dict.fromkeys(folders))


def print_written_files(options: argparse.Namespace, folders: Sequence[Path]) -> None:
    """Print which files and folders a command has made."""
    if options.out is not None:
        facts = facts_path(options.out)
        print(f"rows written to {options.out}, units and provenance to {facts}")
    if options.plot is not None:
        print(f"plot written to {options.plot}")
    for folder in folders:
        print(f"new folder: {folder}")


def print_warnings(result: Result) -> None:
    """Print the warnings of a result to the standard error."""
    for warning in (*result.warnings, *result.doubts()):
        print(f"warning: {warning}", file=sys.stderr)


def print_table(rows: Iterable[Sequence[str]]) -> None:
    """Print rows in aligned columns."""
    print("\n".join(f"  {line}" for line in describe.table(list(rows))))
