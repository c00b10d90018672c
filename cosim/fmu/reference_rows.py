"""The results of its default experiment that an FMU carries, with their errors.

The layered standard FMI-LS-REF 1.0 lets an FMU name files of results in a manifest. The FMUs of `fmukit` also
carry, for a file `NAME.csv` of results, a file `NAME_error.csv` with the same heading and the same times, whose
values are the largest errors of these results.
"""

from __future__ import annotations

import csv
import posixpath
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: A convention of FMI-LS-REF: where its files are in an FMU.
FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
#: What the file of errors is called after the file of results: a convention of `fmukit`.
ERRORS = "_error.csv"
#: Largest size of a file that is read [bytes]: chosen, 100 times the largest of this project's FMUs.
MOST_BYTES = 100_000_000


@dataclass(frozen=True)
class ReferenceRows:
    """The results of a default experiment.

    Attributes
    ----------
    time : array of shape (rows,)
        Times [s], which rise.
    values, errors : mapping of str to array of shape (rows,)
        By the name of the variable, in its unit.
    """

    time: Array
    values: Mapping[str, Array]
    errors: Mapping[str, Array]


def read_reference_rows(fmu: Path) -> ReferenceRows | None:
    """Read the results that an FMU carries.

    Returns
    -------
    ReferenceRows or None
        None if it carries none with errors, or none that can be read.
    """
    try:
        with ZipFile(fmu) as archive:
            members = {entry.filename: entry.file_size for entry in archive.infolist()}
            manifest = f"{FOLDER}/fmi-ls-manifest.xml"
            if manifest not in members:
                return None
            for related in ElementTree.fromstring(archive.read(manifest)).iter("Related"):
                source = posixpath.normpath(f"{FOLDER}/{related.get('source')}")
                errors = source.removesuffix(".csv") + ERRORS
                files = [source, errors]
                if related.get("role") == "result" and all(
                    members.get(file, MOST_BYTES) < MOST_BYTES for file in files
                ):
                    return _reference_rows(*(archive.read(file).decode() for file in files))
    except (OSError, BadZipFile, ElementTree.ParseError, ValueError):
        return None
    return None


def _reference_rows(results: str, errors: str) -> ReferenceRows:
    """The rows of both texts; raises ValueError if they do not belong together."""
    time, values = _columns(results)
    times_of_errors, stated = _columns(errors)
    if values.keys() != stated.keys() or not np.array_equal(time, times_of_errors):
        raise ValueError("results and errors have different columns or times")
    if not np.all(np.diff(time) > 0.0):
        raise ValueError("times must rise")
    return ReferenceRows(time, values, stated)


def _columns(text: str) -> tuple[Array, dict[str, Array]]:
    """The times and the other columns by name."""
    heading, *rows = csv.reader(text.splitlines())
    time, *columns = np.array(rows, float).T
    return time, dict(zip(heading[1:], columns, strict=True))
