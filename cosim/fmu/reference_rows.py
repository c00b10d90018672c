"""The results of its default experiment that an FMU carries, with their errors.

The layered standard FMI-LS-REF 1.0 lets an FMU name files of results in a manifest. The FMUs of `fmukit` also
carry, for a file `NAME.csv` of results, a file `NAME_error.csv` with the same heading and the same times, whose
values are the largest errors of these results.
"""

from __future__ import annotations

import posixpath
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from zipfile import BadZipFile, ZipFile

import numpy as np

from ..errors import SetupError
from ..series import Series

#: A convention of FMI-LS-REF: where its files are in an FMU.
FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
#: What the file of errors is called after the file of results: a convention of `fmukit`.
ERRORS = "_error.csv"
#: Largest size of a file that is read [bytes]: chosen, 100 times the largest of this project's FMUs.
MOST_BYTES = 100_000_000


class ReferenceRows(NamedTuple):
    """The results of a default experiment over time, in the units of the FMU, and the largest errors of each."""

    values: Series
    errors: Series


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
    except (OSError, BadZipFile, ElementTree.ParseError, ValueError, SetupError):
        return None
    return None


def _reference_rows(results: str, errors: str) -> ReferenceRows:
    """The rows of both texts; raises ValueError or SetupError if they do not belong together."""
    rows = ReferenceRows(Series.of_text(results, "results"), Series.of_text(errors, "errors"))
    if rows.values.names != rows.errors.names or not np.array_equal(rows.values.t, rows.errors.t):
        raise ValueError("results and errors have different columns or times")
    if not np.all(np.diff(rows.values.t) > 0.0):
        raise ValueError("times must rise")
    for series in rows:
        for name in series.names:
            series.numbers(name)
    return rows
