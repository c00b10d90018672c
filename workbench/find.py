"""Where a figure reaches a level: any figure of any question, over an option or a start value.

Crossings are bracketed on a grid of runs. With a *guide*, a figure that formulas give without a run, what is interpolated
between them is the smooth ratio of both, and crossings are looked for on many points; without one, the grid is halved
until two in sequence tell the same crossings apart. Secants then take runs of their own; those of all searches are asked
together, round by round.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cosim import SetupError

from .context import Context
from .figure import Figure
from .question import Question
from .roots import Estimates, ZeroCrossing, secant

Array = NDArray[np.float64]
#: Points of the grid with a guide; and without one, the first, and the most. They are conventions.
WITH_GUIDE, FIRST, MOST = 9, 9, 129
#: Points on which guide times ratio is looked at.
DENSE = 1000
#: Points in sequence at the level, within their errors, that are a stretch and no crossing.
STRETCH = 3


class Find(NamedTuple):
    """Where a figure reaches a level.

    Attributes
    ----------
    over : str
        An option, or a start value, which has a dot; its values are above 0.
    low, high : float
        Between which of its values.
    figure : str
        The figure.
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
    figure: str
    level: float | str
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
        if "." in self.find.over:
            start: Any = {**self.question.start, self.find.over: x}
            return replace(self.question, start=start)
        changed: Any = {self.find.over: x}
        return replace(self.question, **changed)

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

    def crossings(self) -> list[ZeroCrossing]:
        """Return where the level is passed, about, and the slopes there."""
        known = np.isfinite(self.y)
        x, y = self.x[known], self.y[known]
        flat = np.abs(y) <= self.error[known]
        runs = np.convolve(flat, np.ones(STRETCH), "valid") if len(y) >= STRETCH else np.zeros(0)
        if (runs == STRETCH).any():
            a, b = x[flat][[0, -1]]
            self.reason = f"{self.find.figure} is at its level, within its error, from {a:g} to {b:g} {self.find.unit}"
            return []
        if len(x) <= 1:
            self.reason = f"{self.find.figure} has fewer than two values from {self.find.low:g} to {self.find.high:g} {self.find.unit}"
            return []
        if self.find.guide:
            x, y = self._along_guide(x, y)
        k = np.flatnonzero(np.diff(np.sign(y)) != 0)
        slopes = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
        if not len(k):
            side = "above" if y[0] > 0.0 else "below"
            self.reason = f"{self.find.figure} stays {side} its level from {x[0]:g} to {x[-1]:g} {self.find.unit}"
        return [
            ZeroCrossing(*pair) for pair in zip((x[k] - y[k] / slopes).tolist(), slopes.tolist())
        ]

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

    def residual(x: Array) -> tuple[Array, Array]:
        values = np.full((2, len(x)), np.nan)
        some = np.flatnonzero(np.isfinite(x))
        values[:, some] = _ask(context, [(searches[places[k][0]], float(x[k])) for k in some])
        return values[0], values[1]

    roots = secant(residual, *np.array([place for _, place in places], float).reshape(-1, 2).T)
    which = [k for k, _ in places]
    return [
        [search.figure(roots, j) for j, n in enumerate(which) if n == k]
        or [search.figure(roots, -1)]
        for k, search in enumerate(searches)
    ]


def _ask(context: Context, points: Sequence[tuple[_LevelSearch, float]]) -> Array:
    """The figures less their levels at values of searches, and their errors, shape (2, points); nan where there is none."""
    asked = [search.at(x) for search, x in points]
    found = type(asked[0]).solve_all(context, asked) if asked else []
    values = [
        _less_level(search.find, {} if isinstance(one, SetupError) else one.figures)
        for (search, _), one in zip(points, found)
    ]
    return np.array(values, float).reshape(-1, 2).T


def _less_level(sought: Find, figures: Mapping[str, Figure]) -> tuple[float, float]:
    """A figure less its level, and the error of that; nan where it has none."""
    names = [sought.figure, *([sought.level] if isinstance(sought.level, str) else [])]
    for name in names:
        if figures and name not in figures:
            raise SetupError(f"there is no figure {name!r}, only {', '.join(figures)}")
    if not figures or any(figures[name].error is None for name in names):
        return np.nan, np.nan
    x, *other = (figures[name] for name in names)
    level = other[0] if other else Figure(float(sought.level), "1", 0.0)
    return x.value - level.value, (x.error or 0.0) + (level.error or 0.0)
