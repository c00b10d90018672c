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
    """Rows that are known to be right, and the largest error of each value, in the same columns at the same times."""

    values: Series
    errors: Series

    def checked(self) -> ReferenceRows:
        """The same; raises SetupError if they do not belong together, do not rise in time, or lack a number."""
        values, errors = self
        if values.names != errors.names or not np.array_equal(values.t, errors.t):
            raise SetupError(
                f"{values.label} and {errors.label} must have the same columns and times"
            )
        if not np.all(np.diff(values.t) > 0.0):
            raise SetupError(f"{values.label}: times must rise")
        for series in self:
            for name in series.names:
                series.numbers(name)
        return self

    @classmethod
    def read(cls, path: Path | str) -> ReferenceRows:
        """Read NAME.csv, and the errors in NAME_error.csv beside it; raises SetupError."""
        errors = Path(path).with_name(f"{Path(path).stem}{ERRORS}")
        return cls(Series.read(path), Series.read(errors)).checked()

    @classmethod
    def of_fmu(cls, fmu: Path | str) -> ReferenceRows | None:
        """The results of its default experiment that an FMU carries; None if there are none with errors that can be read."""
        try:
            with ZipFile(fmu) as archive:
                sizes = {entry.filename: entry.file_size for entry in archive.infolist()}
                manifest = f"{FOLDER}/fmi-ls-manifest.xml"
                if manifest not in sizes:
                    return None
                for related in ElementTree.fromstring(archive.read(manifest)).iter("Related"):
                    source = posixpath.normpath(f"{FOLDER}/{related.get('source')}")
                    files = [source, source.removesuffix(".csv") + ERRORS]
                    is_small = all(sizes.get(file, MOST_BYTES) < MOST_BYTES for file in files)
                    if related.get("role") == "result" and is_small:
                        texts = (archive.read(file).decode() for file in files)
                        return cls(*(Series.of_text(*x) for x in zip(texts, files))).checked()
        except (OSError, BadZipFile, ElementTree.ParseError, ValueError, SetupError):
            return None
        return None
