"""Where a figure reaches a level: any figure of any question, over an option or a start value.

Crossings are bracketed on a grid of runs. With a *guide*, a figure that formulas give without a run, what is interpolated
between them is the smooth ratio of both, and crossings are looked for on many points; without one, the grid is halved
until two in sequence tell the same crossings apart. Secants then take runs of their own; those of all searches are asked
together, round by round. Where a secant leaves its bracket or ends nowhere, as at a jump, the bracket is narrowed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize.elementwise import find_root

from cosim import SetupError, SimulationError

from .answer import Findings
from .context import Context
from .figure import Figure
from .question import Question
from .roots import Estimates, secant

Array = NDArray[np.float64]
#: Points of the grid with a guide; and without one, the first, and the most. They are conventions.
WITH_GUIDE, FIRST, MOST = 9, 9, 129
#: Points on which guide times ratio is looked at.
DENSE = 1000
#: Points in sequence at the level, within their errors, that are a stretch and no crossing.
STRETCH = 3
#: Width to which the bracket of a jump is narrowed, over its place: a convention, a tenth of what four digits tell.
JUMP_WIDTH = 1e-5
#: Gives a number that is sought to be 0, and its error, of what a question finds, or why it is refused.
Residual = Callable[[Question, Findings | SetupError], tuple[float, float]]


class Find(NamedTuple):
    """Where a figure reaches a level.

    Attributes
    ----------
    over : str
        An option, or a start value, which has a dot; its values are above 0.
    low, high : float
        Between which of its values.
    figure : str or callable
        The figure; or any number, whose level is 0.
    level : float or str
        Its level, or another figure.
    guide : str
        A figure of `Question.formulas` of about its course.
    which : str
        Whether the first crossing is wanted, or all.
    unit : str
        The unit of `over`.
    """

    over: str
    low: float
    high: float
    figure: str | Residual
    level: float | str = 0.0
    guide: str = ""
    which: Literal["first", "all"] = "first"
    unit: str = ""


@dataclass
class _LevelSearch:
    """The search of one question: what is known of the figure less its level."""

    question: Question
    find: Find
    x: Array
    y: Array
    error: Array
    reason: str = ""

    def at(self, x: float) -> Question:
        """Return the question at a value."""
        return self.question.with_value(self.find.over, x)

    def wanted(self) -> Array:
        """Return where the grid is to be asked: at first, or halved while it tells other crossings apart than before."""
        first, last, number = self.find.low, self.find.high, len(self.x)
        if not number:
            return np.linspace(first, last, WITH_GUIDE if self.find.guide else FIRST)
        if self.find.guide or number >= MOST:
            return np.empty(0)
        halved = _signs(self.y[::2])
        is_settled = number > FIRST and np.array_equal(
            halved[halved != 0], _signs(self.y)[_signs(self.y) != 0]
        )
        return np.empty(0) if is_settled else (self.x[1:] + self.x[:-1]) / 2.0

    def take(self, x: Array, y: Array, error: Array) -> None:
        """Take what was found at values."""
        order = np.argsort([*self.x, *x])
        self.x, self.y, self.error = (
            np.append(a, b)[order] for a, b in ((self.x, x), (self.y, y), (self.error, error))
        )

    def crossings(self) -> Array:
        """Return where the level is passed, about, the slopes there, and between what, shape (crossings, 4)."""
        known = np.isfinite(self.y)
        x, y = self.x[known], self.y[known]
        flat = np.abs(y) <= self.error[known]
        runs = np.convolve(flat, np.ones(STRETCH), "valid") if len(y) >= STRETCH else np.zeros(0)
        if (runs == STRETCH).any():
            a, b = x[flat][[0, -1]]
            self.reason = f"{self.find.figure} is at its level, within its error, from {a:g} to {b:g} {self.find.unit}"
            return np.empty((0, 4))
        if len(x) <= 1:
            self.reason = f"{self.find.figure} has fewer than two values from {self.find.low:g} to {self.find.high:g} {self.find.unit}"
            return np.empty((0, 4))
        asked = x
        if self.find.guide:
            x, y = self._along_guide(x, y)
        k = np.flatnonzero(np.diff(np.sign(y)) != 0)
        slopes = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
        if not len(k):
            side = "above" if y[0] > 0.0 else "below"
            self.reason = f"{self.find.figure} stays {side} its level from {x[0]:g} to {x[-1]:g} {self.find.unit}"
        above = np.searchsorted(asked, x[k], side="right")
        return np.column_stack([x[k] - y[k] / slopes, slopes, asked[above - 1], asked[above]])

    def figure(self, roots: Estimates, k: int) -> Figure:
        """Return root k as a figure, or with -1 why there is none."""
        unit = self.find.unit or "1"
        meaning = f"{self.find.over} at which {self.find.figure} is {self.find.level}"
        if k < 0 or roots.reasons[k]:
            return Figure.undetermined(unit, self.reason if k < 0 else roots.reasons[k], meaning)
        return Figure(float(roots.x[k]), unit, float(roots.error[k]), meaning)

    def _along_guide(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Many values, and the figure less its level there, by a spline through its ratio to the guide."""
        level = float(self.find.level)
        fine = np.union1d(np.linspace(x[0], x[-1], DENSE), x)
        guide = np.array([self.at(z).formulas()[self.find.guide] for z in fine.tolist()])
        ratio = CubicSpline(x, (y + level) / guide[np.searchsorted(fine, x)])
        return fine, guide * ratio(fine) - level


def _signs(y: Array) -> NDArray[np.int64]:
    """The signs of values in sequence, each once."""
    signs = np.sign(y[np.isfinite(y)]).astype(np.int64)
    return signs[np.append(True, np.diff(signs) != 0)] if len(signs) else signs


def find(context: Context, sought: Sequence[tuple[Question, Find]]) -> list[list[Figure]]:
    """Return where figures of questions of one class reach their levels, for each in order; one with a reason if nowhere.

    Raises
    ------
    SetupError
        For a level that is a figure together with a guide, and for a figure that there is not.
    """
    for _, one in sought:
        if one.guide and isinstance(one.level, str):
            raise SetupError(f"{one.figure} at {one.level}: with a guide it must be a number")
    searches = [_LevelSearch(question, one, *np.empty((3, 0))) for question, one in sought]
    while grids := [(search, x) for search in searches if len(x := search.wanted())]:
        y, error = _ask(context, [(search, float(z)) for search, x in grids for z in x])
        ends = np.cumsum([len(x) for _, x in grids])[:-1]
        for (search, x), own, unsure in zip(grids, np.split(y, ends), np.split(error, ends)):
            search.take(x, own, unsure)
    places = [
        (k, place)
        for k, search in enumerate(searches)
        for place in search.crossings()[: 1 if search.find.which == "first" else None]
    ]
    which = [k for k, _ in places]
    x, slope, low, high = np.array([place for _, place in places], float).reshape(-1, 4).T

    def residual(x: Array, of: Any) -> tuple[Array, Array]:
        values = np.full((2, len(x)), np.nan)
        some = np.flatnonzero(np.isfinite(x))
        values[:, some] = _ask(context, [(searches[of[k]], float(x[k])) for k in some])
        return values[0], values[1]

    roots = secant(lambda x: residual(x, which), x, slope)
    lost = np.flatnonzero(~((low <= roots.x) & (roots.x <= high)))
    if len(lost):
        value: Any = lambda x, of: residual(x, of)[0]
        narrow = find_root(
            value, (low[lost], high[lost]), args=(np.array(which)[lost],),
            tolerances={"xatol": 0.0, "xrtol": JUMP_WIDTH, "fatol": 0.0, "frtol": 0.0},
        )  # fmt: skip
        some, (a, b) = lost[narrow.success], (end[narrow.success] for end in narrow.bracket)
        roots.x[some], roots.error[some] = (a + b) / 2.0, np.abs(b - a) / 2.0
        roots.reasons[some] = ""
    return [
        [search.figure(roots, j) for j, n in enumerate(which) if n == k]
        or [search.figure(roots, -1)]
        for k, search in enumerate(searches)
    ]


def solve_each(context: Context, asked: Sequence[Question]) -> list[Findings | SetupError]:
    """Return what each of several questions of one class finds, or why it is refused or its run ends early.

    So many are solved at a time as the class says, in halves where one of them fails.
    """
    found: list[Findings | SetupError] = []
    number = type(asked[0]).at_once if asked else 1
    for k in range(0, len(asked), number):
        some = asked[k : k + number]
        try:
            found += type(some[0]).solve_all(context, some)
        except (ValueError, ArithmeticError, LookupError, SimulationError) as error:
            half = len(some) // 2
            halves = (some[:half], some[half:]) if half else ()
            found += [x for part in halves for x in solve_each(context, part)] or [
                SetupError(str(error))
            ]
    return found


def _ask(context: Context, points: Sequence[tuple[_LevelSearch, float]]) -> Array:
    """The figures less their levels at values of searches, and their errors, shape (2, points); nan where there is none."""
    keys = [(id(search.question), search.find.over, x) for search, x in points]
    asked = {key: search.at(x) for key, (search, x) in zip(keys, points)}
    found = dict(zip(asked, solve_each(context, list(asked.values()))))
    values = [
        _less_level(search.find, asked[key], found[key]) for key, (search, _) in zip(keys, points)
    ]
    return np.array(values, float).reshape(-1, 2).T


def _less_level(sought: Find, o: Question, found: Findings | SetupError) -> tuple[float, float]:
    """A figure less its level, and the error of that; nan where it has none."""
    if not isinstance(sought.figure, str):
        return sought.figure(o, found)
    figures = {} if isinstance(found, SetupError) else found.figures
    names = [sought.figure, *([sought.level] if isinstance(sought.level, str) else [])]
    for name in names:
        if figures and name not in figures:
            raise SetupError(f"there is no figure {name!r}, only {', '.join(figures)}")
    if not figures or any(figures[name].error is None for name in names):
        return np.nan, np.nan
    x, *other = (figures[name] for name in names)
    level = other[0] if other else Figure(float(sought.level), "1", 0.0)
    return x.value - level.value, (x.error or 0.0) + (level.error or 0.0)
