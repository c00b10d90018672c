"""What a question found, and the files that show it."""

from __future__ import annotations

import csv
import os
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from html import escape
from importlib.util import find_spec
from math import isnan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from cosim import Result, System
from cosim.result import partial, write_json
from cosim.system import Value, connect, declared_start

from .charts.gif import gif
from .charts.model import Picture
from .charts.motion import Motion
from .charts.mpl import draw
from .figure import ERROR_SCOPE, Figure
from .page.html import report
from .runs.folder import reservation

if TYPE_CHECKING:
    import pandas as pd

    from .live import LivePart

SPOKEN, PAGE = 3, "report.html"
Rows = Callable[[Iterable[Sequence[float]]], None]


class Parameter(NamedTuple):
    """A value that was given or that an FMU has, its unit and meaning."""

    value: Any
    unit: str
    meaning: str


class Table(NamedTuple):
    """Rows of a CSV file and the units of its columns."""

    frame: pd.DataFrame
    units: Mapping[str, str]

    @classmethod
    def of(cls, result: Result) -> Table:
        """All that a run recorded."""
        return cls(result.frame, result.units)

    @classmethod
    def of_rows(cls, rows: Iterable[Sequence[Any]], units: Mapping[str, str]) -> Table:
        """The table of rows, each with as many values as there are units."""
        import pandas as pd

        return cls(pd.DataFrame(list(rows), columns=list(units)), units)


class Show(NamedTuple):
    """What is shown besides numbers: pictures, motions, and `more` pictures only for the page.

    `title` is the answer in one line, shown above the pictures; by default it is the question.
    """

    charts: Sequence[Picture] = ()
    motions: Sequence[Motion] = ()
    more: Sequence[Picture] = ()
    title: str = ""


@dataclass(frozen=True)
class Findings:
    """What `solve` returns: figures with their whole errors, and the data for verdict and show.

    Names of figures are identifiers. `system` gives the FMUs and parameters; `provenance` is that of a
    run, or else `algorithm` and `communication` say how several runs were made. Tables and files are by
    file name without folder. Functions in `files` write what only this question has, such as a system,
    to a path. `facts` are further entries of the JSON. `defaults` are the values of options that were
    left to the question (None, or no list), by name, in the options' units.
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


@dataclass(frozen=True, kw_only=True, repr=False)
class Answer(Findings):
    """What was found, for which question and options, and what is said and shown of it.

    `show` is called for picture and page. Names of parameters are those of the system, "motor.T". `live`
    is what the page needs to ask again. It is `refused` if the figures that it hangs on are not
    determined. As text it is what the command line prints; a notebook shows the picture as well.
    """

    scenario: str
    question: str
    verdict: str
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    options: Mapping[str, Parameter] = field(default_factory=dict)
    warnings: Sequence[str] = ()
    show: Callable[[], Show] = Show
    live: LivePart | None = None
    refused: bool = False

    @property
    def table(self) -> pd.DataFrame:
        """The rows of the first table."""
        return next(iter(self.tables.values())).frame

    def __repr__(self) -> str:
        labels = [figure.meaning or name for name, figure in self.figures.items()]
        wide, warned, more = (
            max(map(len, labels), default=0),
            self.warnings,
            len(self.warnings) - SPOKEN,
        )
        return "\n".join([
            *self.verdict.splitlines(),
            *(f"  {label:<{wide}}  {x.text()}" for label, x in zip(labels, self.figures.values())),
            *[ERROR_SCOPE] * bool(self.figures),
            *(f"Warning: {warning}" for warning in warned[:SPOKEN]),
            *[f"and {more} more warnings, in {self.scenario}.json"] * (more > 0),
            *[f"Computed with {flavour} FMUs." for flavour in [self.provenance.get("flavour")] if flavour],
        ])  # fmt: skip

    def _repr_html_(self) -> str:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "answer.png"
            drawn = draw(self.show(), self.question, path) and b64encode(path.read_bytes()).decode()
        picture = (
            f'<img src="data:image/png;base64,{drawn}" style="max-width: 100%">' if drawn else ""
        )
        return f'<pre style="white-space: pre-wrap">{escape(repr(self))}</pre>{picture}'


def parameters(system: System, own: Iterable[str] = ()) -> dict[str, Parameter]:
    """All parameters of a system's FMUs and all other variables that are given a start value, by dotted
    name, except for its `own`, which the question sets itself.

    Raises SetupError for what `cosim.run` refuses in a system.
    """
    network = connect(system)
    given: dict[str, Value] = {port.name: value for port, value in network.start}
    found = {}
    for part, description in network.descriptions.items():
        for variable in description.modelVariables:
            port = network.port(f"{part}.{variable.name}")
            if variable.causality == "parameter" or port.name in given:
                value = given.get(port.name, declared_start(variable))
                if value is not None and port.name not in own:
                    found[port.name] = Parameter(value, port.unit, variable.description or "")
    return found


def new_file(path: Path) -> TextIO:
    """A text file that nobody else has open, in place of what is there; a link is not followed."""
    path.unlink(missing_ok=True)
    return path.open("x", newline="", encoding="utf-8")


@contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """A new file of this process's own, which takes the place of another when it is complete."""
    fresh = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    fresh.unlink(missing_ok=True)
    try:
        yield fresh
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


@contextmanager
def stream(path: Path | None, columns: Sequence[str]) -> Iterator[Rows]:
    """A function that appends rows to NAME.partial.csv, nan as nothing; without a path it keeps none.

    Raises SetupError if another run uses the folder.
    """
    if path is None:
        yield lambda rows: None
        return
    with reservation(path.parent), new_file(partial(path)) as file:
        writer = csv.writer(file)
        writer.writerow(columns)

        def keep(rows: Iterable[Sequence[float]]) -> None:
            writer.writerows(["" if isnan(x) else x for x in row] for row in rows)
            file.flush()

        yield keep


def write(answer: Answer, folder: Path, animate: bool = False) -> list[str]:
    """Write tables, JSON, other files, page and, if asked, motions to a folder; their names.

    Raises SetupError if another run uses the folder.
    """
    with reservation(folder):
        return _write(answer, folder, animate)


def _write(answer: Answer, folder: Path, animate: bool) -> list[str]:
    """Write the files to a folder that is this run's; it may have been removed meanwhile."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in answer.tables.items():
        with replacement(folder / name) as fresh:
            table.frame.to_csv(fresh, index=False)
        partial(folder / name).unlink(missing_ok=True)
    with replacement(folder / f"{answer.scenario}.json") as fresh:
        write_json(fresh, content(answer))
    for name, save in answer.files.items():
        save(folder / name)
    if find_spec("plotly"):
        with replacement(folder / PAGE) as fresh:
            report(answer, fresh)
    drawn = draw(answer.show(), answer.question, folder / f"{answer.scenario}.png")
    for number, motion in enumerate(answer.show().motions if animate else (), 1):
        drawn.append(f"{answer.scenario}{f'_{number}' if number > 1 else ''}.gif")
        gif(folder / drawn[-1], motion)
    data = [*answer.tables, f"{answer.scenario}.json", *answer.files]
    return [*data, *drawn, *[PAGE] * bool(find_spec("plotly"))]


def content(answer: Answer) -> dict[str, Any]:
    """What stands in the JSON file, each number once."""
    parts = {
        name: {key: part[key] for key in part if key not in ("parameters", "warnings")}
        for name, part in answer.provenance["parts"].items()
    }
    return {
        "scenario": answer.scenario,
        "question": answer.question,
        "verdict": answer.verdict.splitlines(),
        "warnings": list(answer.warnings),
        "figures": {name: figure.json() for name, figure in answer.figures.items()},
        "refused": answer.refused,
        "options": {name: value._asdict() for name, value in answer.options.items()},
        "parameters": {name: value._asdict() for name, value in answer.parameters.items()},
        "units": {
            key: unit for table in answer.tables.values() for key, unit in table.units.items()
        },
        **answer.provenance,
        "parts": parts,
        **answer.facts,
    }


def finish(answer: Answer, folder: Path, animate: bool = False) -> None:
    """Write the files; print the verdict, the figures, the FMUs' warnings, and where the files are."""
    names = write(answer, folder, animate)
    if text := repr(answer):
        print(text)
    print(f"{', '.join(names)} written to {folder}")
    if PAGE not in names:
        print("no page was written: it needs the package plotly")
