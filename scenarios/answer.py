"""What a scenario found, and the files that tell it."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim import Estimate, Result, System
from cosim.result import partial, write_json
from cosim.system import Value, connect, own_start

from .page.charts import Chart
from .page.fields import Field
from .page.motion import Motion
from .page.report import report

if TYPE_CHECKING:
    import pandas as pd

Rows = Callable[[Iterable[Sequence[float]]], None]


class Figure(NamedTuple):
    """A number with its unit and its error in the same unit.

    The error is that of the coupling, or of the search that located the number: None where it is
    not known, 0 where there is none of both, in a formula or an FMU alone.
    `order` is the one at which the figure converges, None where nobody looked.
    """

    value: float
    unit: str
    error: float | None = None
    order: float | None = None
    meaning: str = ""

    @classmethod
    def of(cls, estimate: Estimate, unit: str, meaning: str = "") -> Figure:
        """The figure that three runs tell."""
        return cls(estimate.value, unit, estimate.error, estimate.order, meaning)

    def text(self) -> str:
        """The figure as it may be printed."""
        unit = "" if self.unit == "1" else self.unit
        if self.order is not None or self.error:
            order = float("nan") if self.order is None else self.order
            return Estimate(self.value, self.error, order).text(unit).replace("  (", " (").rstrip()
        known = "" if self.error == 0.0 else " (coupling error not known)"
        return f"{self.value:.6g} {unit}".rstrip() + known


class Parameter(NamedTuple):
    """The start value that an FMU was given or has, its unit and meaning."""

    value: Value
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
        """Rows of as many values as there are units."""
        import pandas as pd

        return cls(pd.DataFrame(list(rows), columns=list(units)), units)


class Show(NamedTuple):
    """What the page shows besides numbers."""

    charts: Sequence[Chart | Field] = ()
    motions: Sequence[Motion] = ()


@dataclass(frozen=True)
class Answer:
    """What a scenario found; `tables` and `files` by file name without folder.

    `stem` names the JSON file, `facts` is what else stands in it; `files` write what only this
    scenario has, a picture or a system, to the path that they get; `show` is called for the page.
    Names of figures are identifiers, names of parameters those of the system, "motor.T".
    """

    scenario: str
    question: str
    verdict: str
    figures: Mapping[str, Figure]
    parameters: Mapping[str, Parameter]
    tables: Mapping[str, Table]
    provenance: Mapping[str, Any]
    stem: str
    facts: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)
    show: Callable[[], Show] = Show


def question(documentation: str | None) -> str:
    """The first line of a scenario."""
    return (documentation or "").splitlines()[0]


def parameters(system: System) -> dict[str, Parameter]:
    """All parameters of a system's FMUs and what else has a start value, by dotted name.

    Raises SetupError for what `cosim.run` refuses in a system.
    """
    network = connect(system)
    given = {port.name: value for port, value in network.start}
    found = {}
    for part, description in network.descriptions.items():
        for variable in description.modelVariables:
            port = network.port(f"{part}.{variable.name}")
            if variable.causality == "parameter" or port.name in given:
                value = given.get(port.name, own_start(variable))
                if value is not None:
                    found[port.name] = Parameter(value, port.unit, variable.description or "")
    return found


@contextmanager
def stream(path: Path | None, columns: Sequence[str]) -> Iterator[Rows]:
    """Takes rows, which reach NAME.partial.csv at once; without a path it does nothing."""
    if path is None:
        yield lambda rows: None
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with partial(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)

        def keep(rows: Iterable[Sequence[float]]) -> None:
            writer.writerows(rows)
            file.flush()

        yield keep


def write(answer: Answer, folder: Path) -> list[str]:
    """Write the tables as CSV, the JSON, the other files and the page to a folder; their names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in answer.tables.items():
        path = folder / name
        table.frame.to_csv(partial(path), index=False)
        partial(path).replace(path)
    write_json(folder / f"{answer.stem}.json", content(answer))
    for name, save in answer.files.items():
        save(folder / name)
    report(answer, folder / "report.html")
    return [*answer.tables, f"{answer.stem}.json", *answer.files, "report.html"]


def content(answer: Answer) -> dict[str, Any]:
    """What stands in the JSON file."""
    units = {name: unit for table in answer.tables.values() for name, unit in table.units.items()}
    return {
        "scenario": answer.scenario,
        "question": answer.question,
        "verdict": answer.verdict.splitlines(),
        "figures": {name: _finite(figure) for name, figure in answer.figures.items()},
        "parameters": {name: value._asdict() for name, value in answer.parameters.items()},
        "units": units,
        **answer.provenance,
        **answer.facts,
    }


def _finite(figure: Figure) -> dict[str, Any]:
    """A figure for JSON, which has no infinity and no NaN."""
    told = figure._asdict().items()
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in told
    }


def finish(answer: Answer, folder: Path) -> None:
    """Write the files and print the verdict."""
    names = write(answer, folder)
    print(answer.verdict)
    print(f"{', '.join(names)} written to {folder}")
