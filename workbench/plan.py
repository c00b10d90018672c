"""A plan: one question, asked at every point of a grid of its options and start values, and the table of what is found."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cosim import SetupError, System

from .answer import Findings, Table, parameters
from .context import Context
from .options import declared
from .question import Question


@dataclass(frozen=True)
class GridPlan:
    """A question at every point of a grid; what is fixed and what varies are options, or start values, which have a dot.

    Attributes
    ----------
    question : type
        What is asked.
    fixed : mapping
        Values by name.
    grid : mapping
        Several values by name; the last one varies fastest.
    """

    question: type[Question]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, Sequence[Any]] = field(default_factory=dict)

    def cases(self) -> list[Question]:
        """Return the question at each point."""
        points = itertools.product(*self.grid.values())
        return [self.at(dict(zip(self.grid, point))) for point in points]

    def at(self, values: Mapping[str, Any]) -> Question:
        """Return the question with these values besides those that are fixed."""
        given = {**self.fixed, **values}
        start = {name: x for name, x in given.items() if "." in name}
        return self.question.parse(
            {name: x for name, x in given.items() if "." not in name} | {"start": start}
        )

    def measure(self, context: Context) -> Iterator[Findings]:
        """Yield what is found at each point, so many at a time as the question is asked together.

        Raises
        ------
        SetupError
            At a point that is refused.
        """
        cases, number = self.cases(), self.question.at_once
        for k in range(0, len(cases), number):
            for found in self.question.solve_all(context, cases[k : k + number]):
                if isinstance(found, SetupError):
                    raise found
                yield found

    def table(
        self, context: Context, csv: str, inputs: Mapping[str, str], figures: Mapping[str, str]
    ) -> tuple[Table, list[Findings]]:
        """Return a table over the grid, and all that is found; rows are kept as they come.

        Parameters
        ----------
        context : Context
            Where the question is asked.
        csv : str
            The file of the table.
        inputs, figures : mapping
            What varied inputs, and figures, are called in it, by their names. Behind a figure comes its error, unless it
            is that of a formula.
        """
        every = self.measure(context)
        first = next(every)
        known = {name: x.unit for name, x in declared(self.question).items()}
        known |= {name: x.unit for name, x in parameters(first.system or System({})).items()}
        units = {column: known[name] for name, column in inputs.items()}
        for name, column in figures.items():
            units[column] = first.figures[name].unit
            if first.figures[name].error != 0.0:
                units[f"{column}_error"] = units[column]
        found: list[Findings] = []

        def rows() -> Iterator[list[float]]:
            points = itertools.product(*self.grid.values())
            for point, one in zip(points, itertools.chain([first], every)):
                found.append(one)
                values = {inputs.get(name): x for name, x in zip(self.grid, point)}
                for name, column in figures.items():
                    value, _, error, *_ = one.figures[name]
                    values |= {
                        column: value,
                        f"{column}_error": math.nan if error is None else error,
                    }
                yield [values[column] for column in units]

        return context.record_rows(csv, units, rows()), found
