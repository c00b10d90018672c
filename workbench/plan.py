"""Plans: a question that is asked many times, and what is found among its answers.

A study file is read as a `Plan`, and questions that follow from others are answered by some of them.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc
from scipy.stats.distributions import rv_frozen

from cosim import SetupError, System
from cosim.system import connect

from .answer import Findings, Table
from .context import Context
from .find import Find, Found, LineSearch, search
from .formula import Formula
from .options import Option, declared, quoted, unknown_option
from .orbits import Motions, table_of
from .question import Question

Value = float | int | str | bool
Samples = NDArray[np.float64]
#: Distance of samples from the faces of the unit cube; derived from the 30 bits of scipy's Sobol numbers, half of one.
LEAST = 2.0**-31
#: A safety margin by convention.
MARGIN = 3.0


class Sampling(NamedTuple):
    """How tolerances are sampled: method, base number of samples, seed."""

    method: str
    number: int
    seed: int

    def group(self, dimensions: int) -> int:
        """Rows of a sample; those of Saltelli's extension give indices of first and total order."""
        return dimensions + 2 if self.method == "saltelli" else 1

    def cube(self, dimensions: int) -> Samples:
        """Samples of the unit cube but for its faces, shape (number * group, dimensions)."""
        if self.method == "saltelli":
            from SALib.sample import sobol

            inputs = salib_problem([str(number) for number in range(dimensions)])
            cube = sobol.sample(inputs, self.number, calc_second_order=False, seed=self.seed)
        else:
            kind = {"lhs": qmc.LatinHypercube, "sobol": qmc.Sobol}[self.method]
            cube = kind(dimensions, rng=self.seed).random(self.number)
        return np.asarray(np.clip(cube, LEAST, 1.0 - LEAST))


def salib_problem(inputs: Sequence[str]) -> dict[str, Any]:
    """Inputs between 0 and 1, as SALib wants them."""
    return {"num_vars": len(inputs), "names": list(inputs), "bounds": [[0.0, 1.0]] * len(inputs)}


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A question that is asked at every point of a grid, there with every sample.

    Inputs are options of the question, and start values, whose names have a dot.

    Attributes
    ----------
    question : type of Question
        What is asked.
    fixed : mapping
        Inputs that do not vary.
    grid : mapping
        Several values of inputs. The next row has the next value of the last one.
    linked : mapping of str to Formula
        Inputs that follow from the others.
    tolerances : mapping
        Distributions of scipy.stats of inputs that are sampled as `sampling` says.
    find : mapping of str to Find
        What is sought: along each line of the grid where it is over one of its inputs, else in each row.
    limits : mapping
        Values of figures that all rows are to keep, in the units of these or as texts with one.
    names, columns : mapping of str to str
        What inputs, and figures, are called in the table; figures are all by default.
    units : mapping of str to str
        Those of start values that are not in the unit of the FMU.
    """

    question: type[Question]
    fixed: Mapping[str, Value] = field(default_factory=dict)
    grid: Mapping[str, Sequence[Value]] = field(default_factory=dict)
    linked: Mapping[str, Formula] = field(default_factory=dict)
    tolerances: Mapping[str, rv_frozen] = field(default_factory=dict)
    sampling: Sampling | None = None
    find: Mapping[str, Find] = field(default_factory=dict)
    limits: Mapping[str, float | str] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        tables = self.fixed, self.grid, self.linked, self.tolerances
        for name, times in Counter(itertools.chain(*tables)).items():
            if times > 1:
                raise SetupError(
                    f"{name!r} is given in two of [fixed], [grid], [linked] and [tolerances]"
                )

    @property
    def varied(self) -> list[str]:
        """The inputs that vary: those of the grid, then the sampled ones."""
        return [*self.grid, *self.tolerances]

    def samples(self) -> list[tuple[float, ...]]:
        """The sampled values, the same at each point of the grid; one empty row without any."""
        if self.sampling is None:
            return [()]
        cube = self.sampling.cube(len(self.tolerances))
        columns = [d.ppf(shares) for d, shares in zip(self.tolerances.values(), cube.T)]
        return [tuple(row) for row in np.column_stack(columns).tolist()]

    def runs(self) -> list[tuple[Value, ...]]:
        """The values of the varied inputs, run by run: the samples at one grid point, at the next."""
        samples = self.samples()
        points = itertools.product(*self.grid.values())
        return [(*point, *sample) for point in points for sample in samples]

    def cases(self) -> list[dict[str, Value]]:
        """What each run is given: options of the question and start values, which have a dot."""
        cases = []
        for run in self.runs():
            values = dict(zip(self.varied, run))
            numbers: Any = {**self.fixed, **values}
            linked = {name: formula(numbers) for name, formula in self.linked.items()}
            cases.append({**self.fixed, **self.given(values), **linked})
        return cases

    def given(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Values of inputs, those that are in a unit of their own as texts with it."""
        units = self.units
        return {name: f"{x!r}{units[name]}" if name in units else x for name, x in values.items()}

    def units_of(self, fmus: Mapping[str, Path]) -> dict[str, str]:
        """The units of the varied inputs."""
        return {x: self.units.get(x) or self._unit(fmus, x, "grid") for x in self.varied}

    def finds(self, fmus: Mapping[str, Path]) -> dict[str, Find]:
        """What is sought, with the units of the inputs."""
        return {
            name: x._replace(unit=self._unit(fmus, x.over, f"find.{name}"))
            for name, x in self.find.items()
        }

    def _unit(self, fmus: Mapping[str, Path], name: str, key: str) -> str:
        """The unit of an input."""
        option = input_of(self.question, name, key)
        return connect(System(fmus)).port(name).unit if "." in name else option.unit


class StartValue(Option):
    """A start value of an FMU, whose type and unit are those of its variable."""

    def read(self, raw: Any, key: str = "") -> Any:
        """The value itself."""
        if not isinstance(raw, float | int | str | bool):
            raise SetupError(f"{key} = {quoted(raw)} must be a start value")
        if isinstance(raw, float) and not math.isfinite(raw):
            raise SetupError(f"{key} = {raw} must be finite")
        return raw


def input_of(question: type[Question], name: str, key: str) -> Option:
    """Return what checks the values of an input: an option of the question, or a start value with a dot.

    Raises SetupError, with the key of a file or the like, for what is neither.
    """
    options, part = declared(question), name.partition(".")[0]
    if name in options:
        return options[name]
    if "." not in name:
        raise unknown_option(name, options, f"{key}: {question.name}")
    if part not in question.parts:
        choices = (
            f"part {part!r}, only {', '.join(question.parts)}" if question.parts else "start values"
        )
        raise SetupError(f"{key}: {question.name} has no {choices}")
    if name in question.fixed_starts:
        raise SetupError(f"{key}: {question.name} sets it itself")
    return StartValue(name, float)


def case_of(question: type[Question], case: Mapping[str, Value]) -> Question:
    """Return a question with values of its options, and start values, which have a dot."""
    start = {name: x for name, x in case.items() if "." in name}
    return question.parse({**{n: x for n, x in case.items() if n not in start}, "start": start})


@dataclass(frozen=True)
class Measured:
    """The answers to a plan: its table, and the same as arrays; and what each search found, line by line or row by row."""

    plan: Plan
    table: Table
    motions: Motions
    searches: Mapping[str, Sequence[LineSearch]]
    found: Mapping[str, Sequence[Sequence[Found]]]


def extreme(values: Samples, errors: Samples, sense: float = 1.0) -> tuple[float, float]:
    """Return the largest of values, or with a sense of -1 the least, and its error, which reaches as far as any does.

    An error that is not known counts as MARGIN times the largest that is.
    """
    if np.isnan(errors).all():
        return math.nan, math.nan
    reach = sense * values + np.where(np.isnan(errors), MARGIN * np.nanmax(errors), errors)
    best = float(np.nanmax(sense * values))
    return sense * best, float(np.nanmax(reach)) - best


def measure(context: Context, plans: Mapping[str, Plan]) -> dict[str, Measured]:
    """Return the answers to plans, by the files of their tables, whose rows are kept as they come.

    All searches advance together.
    """
    searches: dict[str, dict[str, list[LineSearch]]] = {}
    tables: dict[str, tuple[Table, Motions]] = {}
    for csv, plan in plans.items():
        asked = [case_of(plan.question, case) for case in plan.cases()]
        units = plan.units_of(context.fmus)
        values = dict(zip(plan.varied, zip(*plan.runs())))
        names = {**plan.names, **{x: x for x in plan.varied if x not in plan.names}}
        inputs = {name: (units[x], values[x]) for x, name in names.items()}
        tables[csv] = table_of(context, csv, asked, inputs, plan.columns)
        searches[csv] = {
            name: [*_searches(plan, sought, tables[csv][1])]
            for name, sought in plan.finds(context.fmus).items()
        }
    every = [x for of_plan in searches.values() for own in of_plan.values() for x in own]
    found = iter(search(context, every))
    return {
        csv: Measured(
            plan, *tables[csv], searches[csv], {name: [next(found) for _ in own] for name, own in searches[csv].items()}
        )
        for csv, plan in plans.items()
    }  # fmt: skip


def _searches(plan: Plan, sought: Find, motions: Motions) -> Iterator[LineSearch]:
    """The searches for what is sought, along the lines of the grid over its input, or in each row."""
    if sought.over not in plan.grid:
        yield from (LineSearch(o, sought) for o in motions.asked)
        return
    shape = [*map(len, plan.grid.values()), -1]
    axis = list(plan.grid).index(sought.over)
    rows = np.moveaxis(np.arange(len(motions)).reshape(shape), axis, -1)
    x = np.array(plan.grid[sought.over], float)
    rising = np.argsort(x)
    for line in rows.reshape(-1, len(x)):
        yield LineSearch.along(motions[line[rising]], sought, x[rising])


class PlanQuestion(Question):
    """A question that follows from the answers to others, which it asks by plans: it defines `plans` and `conclude`."""

    def plans(self, context: Context) -> Mapping[str, Plan]:
        """Return its plans, by the files of their tables; raises SetupError for options that cannot give an answer."""
        raise NotImplementedError

    def conclude(self, context: Context, measured: Mapping[str, Measured]) -> Findings:
        """Return what follows from the answers to its plans."""
        raise NotImplementedError

    def solve(self, context: Context) -> Findings:
        """Ask what its plans say, and conclude."""
        return self.conclude(context, measure(context, self.plans(context)))
