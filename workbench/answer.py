"""The answer to a question as data: figures, verdict, tables, charts. It does not know who writes it."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import Result, System
from cosim.system import Value, connect, declared_start

from .charts.model import Picture
from .charts.motion import Motion
from .figure import ERROR_SCOPE, Figure
from .judgement import Judgement
from .options import Options, declared

if TYPE_CHECKING:
    import pandas as pd

#: Warnings that are printed; the JSON file has all. It is a convention of this project.
PRINTED_WARNINGS = 3
#: Rows of a file that are texts in memory at a time. Chosen: some megabytes.
ROWS_OF_A_PIECE = 10_000


class GivenValue(NamedTuple):
    """A value that was given or that an FMU has, its unit and meaning."""

    value: Any
    unit: str
    meaning: str


@dataclass(frozen=True)
class Table:
    """Rows of a CSV file: columns by name, each of shape (rows,), and their units."""

    columns: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]

    @classmethod
    def of(cls, result: Result) -> Table:
        """All that a run recorded."""
        return cls(dict(zip(result.names, result.data.T)), result.units)

    @classmethod
    def of_rows(cls, rows: Iterable[Sequence[Any]], units: Mapping[str, str]) -> Table:
        """The table of rows, each with as many values as there are units; None is an empty cell."""
        columns = list(zip(*rows, strict=True)) or [()] * len(units)
        return cls({name: _column(values) for name, values in zip(units, columns)}, units)

    @classmethod
    def of_frame(cls, frame: pd.DataFrame, units: Mapping[str, str]) -> Table:
        """The table of a frame of pandas, whose columns have some of the units."""
        columns = {str(name): frame[name].to_numpy() for name in frame}
        return cls(columns, {name: units[name] for name in columns if name in units})

    @cached_property
    def frame(self) -> pd.DataFrame:
        """The rows as a frame of pandas."""
        import pandas as pd

        return pd.DataFrame(dict(self.columns))

    def __len__(self) -> int:
        return max(map(len, self.columns.values()), default=0)

    def csv(self, every: int = 1) -> Iterator[str]:
        """The file in pieces, of every k-th row on request: numbers to the last digit, nan and None as nothing."""
        columns = [values[::every] for values in self.columns.values()]
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        for begin in range(0, len(self), ROWS_OF_A_PIECE):
            piece = slice(begin, begin + ROWS_OF_A_PIECE)
            writer.writerows(zip(*(map(_csv_cell, values[piece].tolist()) for values in columns)))
            yield text.getvalue()
            text.seek(text.truncate(0))
        yield text.getvalue()


def _column(values: Sequence[Any]) -> NDArray[Any]:
    """Values as numbers where all are such or None, which is nan; else as they are."""
    numbers = np.array([math.nan if value is None else value for value in values])
    return numbers if numbers.dtype.kind in "biuf" else np.array(values, dtype=object)


def _csv_cell(value: Any) -> Any:
    """A value in a file; the writer writes the shortest digits of a number that give it back."""
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


class Show(NamedTuple):
    """What is shown besides numbers: pictures, motions, and `more` pictures only for the page."""

    charts: Sequence[Picture] = ()
    motions: Sequence[Motion] = ()
    more: Sequence[Picture] = ()


class LivePart(NamedTuple):
    """What a live page needs besides what every page has.

    Attributes
    ----------
    modules : mapping of str to bytes
        The FMUs' code for WebAssembly by part.
    worker, page : str
        The scripts that compute and that draw.
    data : dict
        What both need to know.
    """

    modules: Mapping[str, bytes]
    worker: str
    page: str
    data: dict[str, Any]


@dataclass(frozen=True)
class Findings:
    """What `solve` returns: figures with their whole errors, and the data for verdict and show.

    Names of figures are identifiers. `system` gives the FMUs and parameters; `provenance` is that of a
    run, or else `algorithm` and `communication` say how several runs were made, by default those of the options
    `algorithm` and `steps_per_rev`. Tables and files are by
    file name without folder. Functions in `files` write what only this question has, such as a system,
    to a path. `facts` are further entries of the JSON. `defaults` are the values of options that were
    left to the question (None, or no list), by name, in the options' units. `warnings` are shown with those of FMUs.
    """

    figures: Mapping[str, Figure]
    data: Any = None
    system: System | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    communication: str = ""
    algorithm: str | None = None
    tables: Mapping[str, Table] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True, repr=False)
class Answer(Findings):
    """The complete answer to a question: findings, options, judgements, tables and charts.

    `verdict` is what the judgements say, a line each; the first says what to do, and stands above the picture.
    `show` is called for picture and page. Names of parameters are those of the system, "motor.T". `live`
    is what the page needs to ask again, or why it has no sliders. It is `refused` if the figures that it hangs on are not
    determined. `sources` are papers whose formulas the question names, and where they are described.
    `error_scope` says what the errors of the figures cover. `search` finds what would make judgements good that are not.
    As text it is what the command line prints; `picture` gives the picture that a notebook shows as well.
    """

    scenario: str
    question: str
    verdict: str
    judgements: Sequence[Judgement] = ()
    parameters: Mapping[str, GivenValue] = field(default_factory=dict)
    options: Mapping[str, GivenValue] = field(default_factory=dict)
    show: Callable[[], Show] = Show
    live: LivePart | str | None = None
    refused: bool = False
    sources: Sequence[tuple[str, str]] = ()
    error_scope: str = ERROR_SCOPE
    search: Any = None
    picture: Callable[[Answer], str] = lambda _: ""

    @property
    def first_table(self) -> pd.DataFrame:
        """The rows of the first table."""
        return next(iter(self.tables.values())).frame

    def __repr__(self) -> str:
        labels = [figure.meaning or name for name, figure in self.figures.items()]
        wide, warned, more = (
            max(map(len, labels), default=0),
            self.warnings,
            len(self.warnings) - PRINTED_WARNINGS,
        )
        return "\n".join([
            *self.verdict.splitlines(),
            *(f"  {label:<{wide}}  {x.text()}" for label, x in zip(labels, self.figures.values())),
            *(f"{source}, {where}" for source, where in self.sources),
            *([self.error_scope] if self.figures else []),
            *(f"Warning: {warning}" for warning in warned[:PRINTED_WARNINGS]),
            *([f"and {more} more warnings, in {self.scenario}.json"] if more > 0 else []),
            *[f"Computed with {flavour} FMUs." for flavour in [self.provenance.get("flavour")] if flavour],
        ])  # fmt: skip

    def _repr_html_(self) -> str:
        return f'<pre style="white-space: pre-wrap">{escape(repr(self))}</pre>{self.picture(self)}'


def parameters(system: System, leaving_out: Iterable[str] = ()) -> dict[str, GivenValue]:
    """All parameters of a system's FMUs and other variables with a start value, by dotted name.

    Those to be left out are not among them.

    Raises SetupError for what `cosim.run` refuses in a system.
    """
    network = connect(system)
    starts: dict[str, Value] = {port.name: value for port, value in network.start}
    values = {}
    for part, description in network.descriptions.items():
        for variable in description.modelVariables:
            port = network.port(f"{part}.{variable.name}")
            if variable.causality == "parameter" or port.name in starts:
                value = starts.get(port.name, declared_start(variable))
                if value is not None and port.name not in leaving_out:
                    values[port.name] = GivenValue(value, port.unit, variable.description or "")
    return values


def option_values(
    o: Options, defaults: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, GivenValue]:
    """Return the options of an answer, with the question's `defaults` for those left to it."""
    values = vars(o) | {name: x for name, x in defaults.items() if vars(o)[name] in (None, ())}
    return {
        key: GivenValue(values[key], option.unit, option.meaning)
        for key, option in declared(type(o)).items()
    }
