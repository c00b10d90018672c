"""Where a figure reaches a level, or is largest: any figure of any question, over an option or a start value.

Places are bracketed on a grid. With a guide, a course that formulas give without a run, what is interpolated between its
points is the smooth part that they leave, and places are looked for on many points; without one, the grid is halved until
two in sequence tell the same crossings apart. Secants, and Chebyshev nodes for a peak, then take values of their own; those
of all searches are asked together, round by round. Where a secant leaves its bracket or ends nowhere, as at a jump, the
bracket is narrowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.optimize.elementwise import find_root

from cosim import CONVERGENCE_ORDERS, SetupError
from cosim.units import read_quantity

from .answer import Findings
from .context import Context
from .figure import Figure
from .options import Option
from .orbits import (
    COARSE_UNSTABLE,
    STEP_MULTIPLES,
    Motions,
    Orbit,
    at_zero_step,
    figure_of,
    measured,
    solve_each,
)
from .question import Question
from .roots import peaks, secant
from .steady import SETTLED

Array = NDArray[np.float64]
#: Points of the grid with a guide; and without one, the first, and the most. They are conventions.
WITH_GUIDE, FIRST, MOST = 9, 9, 129
#: Points of a line, about, at which an interpolant is looked at: a cubic spline through so many leaves 1e-9 of a
#: polynomial of degree five over a decade.
DENSE = 1000
#: Rounds in which places are added where it is in doubt whether a level is passed; each halves the stretch around an
#: extreme, or more, so that the doubt falls to a quarter.
MOST_ROUNDS = 4
#: Points in sequence at the level, within their errors, that are a stretch and no crossing.
STRETCH = 3
#: Chords by which a crossing is polished between two points of a line; each leaves a thousandth of its error.
POLISHES = 3
#: Width to which the bracket of a jump is narrowed, over its place: a convention, a tenth of what four digits tell.
JUMP_WIDTH = 1e-5
#: Gives a number that is sought to be 0, and its error, of what a question finds, or why it is refused.
Residual = Callable[[Question, Findings | SetupError], tuple[float, float]]
#: What such a number is called among figures.
NUMBER = "the number"
AT_EDGE = "the maximum lies at the edge of {}"


class Find(NamedTuple):
    """Where a figure reaches a level, or is largest.

    Attributes
    ----------
    over : str
        An option, or a start value, which has a dot; its values are above 0.
    low, high : float
        Between which of its values.
    figure : str or callable
        The figure; or any number, whose level is 0.
    level : float or str
        Its level, or another figure, or "largest".
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
    which: Literal["first", "all"] = "first"
    unit: str = ""

    @property
    def is_peak(self) -> bool:
        """Whether the largest value is sought."""
        return self.level == "largest"


class Found(NamedTuple):
    """Where a figure reaches a level, as the grid says and as a figure, whether it rises there; or is largest, and its height."""

    x: float
    place: Figure
    rises: bool = False
    height: Figure | None = None


@dataclass(frozen=True)
class _Own:
    """A figure, or what it is above another one, as its own smooth course."""

    figures: Sequence[str]
    period: float = math.inf

    def theory(self, x: Any) -> Any:
        return 0.0 * x

    def smooth(self, _x: Any, values: Any) -> Any:
        return values[0] - sum(values[1:])

    def figure(self, _x: Any, smooth: Any) -> Any:
        return np.real(smooth)


@dataclass
class LineSearch:
    """A search along a line: what is sought of which question, and what is known there.

    Attributes
    ----------
    question, find
        Of which question, and what.
    x : ndarray, shape (n,)
        Where it has been asked, rising; without any, it is asked on a grid.
    known : Values
        What it said there.
    states : ndarray, shape (n, states), optional
        The states of an orbit there, for the one branch that is followed.
    """

    question: Question
    find: Find
    x: Array = field(default_factory=lambda: np.empty(0))
    known: Motions | None = None
    states: Array | None = None
    reason: str = ""
    #: where the figure was known, and its largest value on the line, by guide and spline
    seen: Array = field(default_factory=lambda: np.empty(0))
    highest: float = -math.inf
    correction: Any = None
    rounds: int = 0

    def __post_init__(self) -> None:
        self.name = self.find.figure if isinstance(self.find.figure, str) else NUMBER
        given = self.question.guide(self.name, self.find.over)
        level = self.find.level
        is_own = isinstance(level, str) and not self.find.is_peak
        self.is_guided = given is not None and not is_own
        own = [self.name, *([level] if is_own and isinstance(level, str) else [])]
        self.guide: Any = given if self.is_guided else _Own(own)
        self.level = 0.0 if isinstance(level, str) else float(level)

    @classmethod
    def along(
        cls, motions: Motions, sought: Find, x: Array, states: Array | None = None
    ) -> LineSearch:
        """Return the search among motions that are known at values."""
        return cls(motions.asked[0], sought, x, motions, states)

    def at(self, x: float) -> Question:
        """Return the question at a value."""
        return self.question.with_value(self.find.over, x)

    def states_at(self, x: Array) -> Array:
        """Return the states at values, shape (n, states)."""
        assert self.states is not None
        if len(self.x) == 1:
            return np.broadcast_to(self.states[0], (len(x), self.states.shape[1]))
        good = np.isfinite(self.states).all(1)
        return np.asarray(CubicSpline(self.x[good], self.states[good])(x))

    def wanted(self) -> Array:
        """Return where the grid is to be asked: at first, or halved while it tells other crossings apart than before."""
        first, last, number = self.find.low, self.find.high, len(self.x)
        if not number:
            return np.linspace(first, last, WITH_GUIDE if self.is_guided else FIRST)
        if number >= MOST or self.find.is_peak:
            return np.empty(0)
        if self.is_guided:
            return self.doubtful()
        y = self.above(self.x, self.smooth(self.x, self.known))
        halved = _signs(y[::2])
        is_settled = number > FIRST and np.array_equal(
            halved[halved != 0], _signs(y)[_signs(y) != 0]
        )
        return np.empty(0) if is_settled else (self.x[1:] + self.x[:-1]) / 2.0

    def doubtful(self) -> Array:
        """Return where the level may be passed twice between two places, by what a straight line leaves of a spline."""
        x, y = self.course()
        if self.reason:
            return np.empty(0)
        straight = self.above(
            x, self.guide.theory(x) + np.interp(x, self.seen, self.correction(self.seen))
        )
        doubt = np.abs(y - straight)
        doubt = np.where(doubt < self.guide.period / 2.0, doubt, 0.0)
        places = np.searchsorted(x, self.seen)
        found = []
        for first, last in pairwise(places.tolist()):
            side = np.sign(y[first])
            beyond = (doubt - side * y)[first + 1 : last]
            if side == np.sign(y[last]) and beyond.max() > 0.0:
                found.append(x[first + 1 + int(beyond.argmax())])
        self.rounds += 1
        return np.array(found if self.rounds <= MOST_ROUNDS else [])

    def take(self, x: Array, more: Motions) -> None:
        """Take what was found at values."""
        every, order = np.append(self.x, x), np.argsort([*self.x, *x])
        both = more if self.known is None else self.known.beside(more)
        self.x, self.known = every[order], both[order]
        if self.states is not None:
            self.states = self.known.states

    def smooth(self, x: Array, motions: Any, row: int | None = None) -> Array:
        """Return what is smooth at values, of the best values, or with a step size."""
        columns = [motions.columns[name] for name in self.guide.figures]
        values = [y.value if row is None else y.steps[row] for y in columns]
        return np.asarray(self.guide.smooth(x, values))

    def above(self, x: Array, smooth: Array) -> Array:
        """Return the figure less its level, an angle by the shorter way round."""
        y = np.asarray(self.guide.figure(x, smooth)) - self.level
        half = self.guide.period / 2.0
        return y if math.isinf(half) else (y + half) % (2.0 * half) - half

    def error(self, motions: Motions) -> Array:
        """Return the error of the figure less its level."""
        names = [self.name] if self.is_guided else self.guide.figures
        return np.asarray(sum(motions.columns[name].error for name in names))

    def course(self) -> tuple[Array, Array]:
        """Return many values on the line, and the figure less its level there, by guide and spline; or why not."""
        y = self.above(self.x, smooth := self.smooth(self.x, self.known))
        known = np.isfinite(smooth)
        self.seen = x = self.x[known]
        smooth = smooth[known]
        unit = self.find.unit
        assert self.known is not None
        flat = np.abs(y[known]) <= self.error(self.known)[known]
        runs = np.convolve(flat, np.ones(STRETCH), "valid") if len(x) >= STRETCH else np.zeros(0)
        if len(x) <= 1:
            where = f"from {self.find.low:g} to {self.find.high:g} {unit}"
            self.reason = f"{self.name} has fewer than two values {where}"
        elif (runs == STRETCH).any() and not self.find.is_peak:
            a, b = x[flat][[0, -1]]
            self.reason = (
                f"{self.name} is at its level, within its error, from {a:g} to {b:g} {unit}"
            )
        if self.reason or not self.is_guided:
            return x, y[known]
        self.correction = CubicSpline(x, smooth - self.guide.theory(x))
        return self.fine(x), self.guided(self.fine(x))

    def fine(self, x: Array) -> Array:
        """Return many values between some."""
        per = max(8, DENSE // (len(x) - 1))
        parts = x[:-1] + np.diff(x) * np.linspace(0.0, 1.0, per, endpoint=False)[:, None]
        return np.append(parts.T.ravel(), x[-1])

    def guided(self, x: Any) -> Any:
        """Return the figure less its level by guide and spline."""
        return self.above(x, self.guide.theory(x) + self.correction(x))

    def crossings(self) -> list[tuple[float, ...]]:
        """Return where the level is passed, about, the slopes there, and between which places that were asked."""
        x, y = self.course()
        if self.reason:
            return []
        found = self.polished(x, y)
        if not found:
            side = "above" if y[0] > 0.0 else "below"
            self.reason = (
                f"{self.name} stays {side} its level from {x[0]:g} to {x[-1]:g} {self.find.unit}"
            )
        if not found:
            return []
        some = np.array(found[: 1 if self.find.which == "first" else None])
        above = np.clip(np.searchsorted(self.seen, some[:, 0], side="right"), 1, len(self.seen) - 1)
        ends = self.seen[above - 1], self.seen[above]
        return list(zip(*some.T.tolist(), *(x.tolist() for x in ends)))

    def polished(self, x: Array, y: Array) -> list[tuple[float, float]]:
        """Return where a course passes 0, and its slopes there."""
        jumps = np.abs(np.diff(y)) > self.guide.period / 2.0
        k = np.flatnonzero((np.diff(np.sign(y)) != 0) & ~jumps)
        slopes = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
        at = x[k] - y[k] / slopes
        for _ in range(POLISHES if self.is_guided and len(k) else 0):
            at = np.clip(at - self.guided(at) / slopes, x[k], x[k + 1])
        return list(zip(at.tolist(), slopes.tolist()))

    def by_guide(self) -> float:
        """Return the first place that the guide alone gives; nan for none."""
        x, own = self.fine(self.x), replace(self, correction=lambda x: 0.0 * x)
        y = own.guided(x)
        if self.find.is_peak:
            return own.refined(x, y)
        return next((at for at, _ in own.polished(x, y)), math.nan)

    def top(self) -> float:
        """Return where the figure is largest on the line, about."""
        x, y = self.course()
        if self.reason:
            return math.nan
        k = int(np.nanargmax(y))
        self.highest = float(y[k])
        if k in (0, len(x) - 1):
            self.reason = AT_EDGE.format("the range where it is sought")
        return self.refined(x, y)

    def refined(self, x: Array, y: Array) -> float:
        """Return where a course is largest; by its guide not only on its points."""
        k = int(np.nanargmax(y))
        if not self.is_guided or k in (0, len(x) - 1):
            return float(x[k])
        bounds: Any = (x[k - 1], x[k + 1])
        found = minimize_scalar(
            lambda z: -float(self.guided(z)),
            bounds=bounds,
            method="bounded",
            options={"xatol": 1e-8 * x[k]},
        )
        return float(found.x)

    def half_width(self, x: float) -> float:
        """Return half the range of nodes around a peak."""
        if self.is_guided:
            return min(float(self.guide.half_width(x)), 0.9 * x)
        k = int(np.searchsorted(self.x, x))
        return float(np.diff(self.x[max(k - 1, 0) : k + 2]).min())

    def refused(self, reason: str = "") -> Figure:
        """Return the place as what is not determined, and why."""
        return Figure.undetermined(self.find.unit or "1", reason or self.reason, self.meaning)

    @property
    def meaning(self) -> str:
        """What is found."""
        if self.find.is_peak:
            return f"{self.find.over} of the largest {self.name}"
        return f"{self.find.over} at which {self.name} is {self.find.level}"


def with_level(sought: Find, figures: Mapping[str, Figure]) -> Find:
    """Return what is sought with its level, "400 ms", as a number in the unit of its figure."""
    name, level = sought.figure, sought.level
    if not isinstance(level, str) or not isinstance(name, str) or not read_quantity(level):
        return sought
    unit = figures[name].unit.removeprefix("1") if name in figures else ""
    return sought._replace(level=Option(name, float, unit=unit).read(level, f"level of {name}"))


def _signs(y: Array) -> NDArray[np.int64]:
    """The signs of values in sequence, each once."""
    signs = np.sign(y[np.isfinite(y)]).astype(np.int64)
    return signs[np.append(True, np.diff(signs) != 0)] if len(signs) else signs


def find(context: Context, sought: Sequence[tuple[Question, Find]]) -> list[list[Figure]]:
    """Return where figures of questions of one class reach their levels, for each in order; one with a reason if nowhere.

    Of a largest value it returns place and height.

    Raises
    ------
    SetupError
        For a figure that there is not.
    """
    found = search(context, [LineSearch(question, one) for question, one in sought])
    return [
        [x for one in of_each for x in (one.place, one.height) if x is not None]
        for of_each in found
    ]


def search(context: Context, searches: Sequence[LineSearch]) -> list[list[Found]]:
    """Return what each search finds, in order; one with a reason if nothing."""
    lines: dict[Any, list[LineSearch]] = {}
    for s in searches:  # what one adds on a line, the others have, too
        key = (id(s.question), *s.find[:3]) if s.is_guided else id(s)
        lines.setdefault(key, []).append(s)
    while grids := [
        (line, x)
        for line in lines.values()
        if len(x := np.unique([y for s in line for y in s.wanted()]))
    ]:
        values = _ask(context, [(line[0], float(z)) for line, x in grids for z in x])
        ends = np.cumsum([0, *(len(x) for _, x in grids)])
        for (line, x), first, last in zip(grids, ends, ends[1:]):
            for s in line:
                s.take(x, values[first:last])
    found: dict[int, list[Found]] = {}
    levels = [(k, c) for k, s in enumerate(searches) if not s.find.is_peak for c in s.crossings()]
    places = _roots(context, [searches[k] for k, _ in levels], [c for _, c in levels])
    for (k, (at, slope, *_)), place in zip(levels, places):
        found.setdefault(k, []).append(Found(at, place, slope > 0.0))
    tops = [(k, s.top()) for k, s in enumerate(searches) if s.find.is_peak]
    inner = [(k, x) for k, x in tops if not searches[k].reason]
    pairs = dict(zip([k for k, _ in inner], _peaks(context, [(searches[k], x) for k, x in inner])))
    for k, at in tops:
        place, height = pairs.get(k, (searches[k].refused(),) * 2)
        found[k] = [Found(at, place, height=height)]
    return [found.get(k) or [Found(math.nan, s.refused())] for k, s in enumerate(searches)]


def _roots(
    context: Context, searches: Sequence[LineSearch], crossings: Sequence[tuple[float, ...]]
) -> list[Figure]:
    """Where levels are passed, by secants from about there; or within brackets."""
    problems = np.full(len(crossings), "", object)

    def residual(x: Array, of: Sequence[int]) -> tuple[Array, Array]:
        y, error = np.full((2, len(x)), np.nan)
        some = np.flatnonzero(np.isfinite(x)).tolist()
        motions = _ask(context, [(searches[of[j]], float(x[j])) for j in some])
        for j, row in enumerate(some):
            k, one = of[row], motions[[j]]
            s = searches[k]
            y[row] = s.above(x[[row]], s.smooth(x[[row]], one))[0]
            error[row], problems[k] = s.error(one)[0], one.problems[0]
            if math.isnan(error[row]) and not problems[k]:
                problems[k] = COARSE_UNSTABLE
        return y, np.nan_to_num(error)

    x, slope, low, high = np.array(crossings, float).reshape(-1, 4).T
    roots = secant(lambda x: residual(x, range(len(x))), x, slope)
    lost = np.flatnonzero(~((low <= roots.x) & (roots.x <= high)) & (problems == ""))
    if len(lost):
        value: Any = lambda x, of: residual(x, of.astype(int).tolist())[0]
        narrow = find_root(
            value, (low[lost], high[lost]), args=(lost.astype(float),),
            tolerances={"xatol": 0.0, "xrtol": JUMP_WIDTH, "fatol": 0.0, "frtol": 0.0},
        )  # fmt: skip
        some, good = lost[narrow.success], narrow.success
        a, b, left, right = (end[good] for end in (*narrow.bracket, *narrow.f_bracket))
        roots.x[some] = (a + b) / 2.0
        unsure = residual(roots.x[some], some.tolist())[1] / np.abs((right - left) / (b - a))
        roots.error[some] = np.abs(b - a) / 2.0 + unsure
        roots.reasons[some] = ""
    figures = []
    for k, s in enumerate(searches):
        if why := problems[k] or roots.reasons[k]:
            figures.append(s.refused(why))
        else:
            at, error = float(roots.x[k]), float(roots.error[k])
            figures.append(Figure(at, s.find.unit or "1", error, s.meaning))
    return figures


def _peaks(
    context: Context, tops: Sequence[tuple[LineSearch, float]]
) -> list[tuple[Figure, Figure]]:
    """Places and heights of largest values, from about where they are."""
    if not tops:
        return []
    searches, x = [s for s, _ in tops], np.array([x for _, x in tops])
    problems, own = np.full(len(tops), "", object), [s.name for s in searches]
    heights = ["1"] * len(tops)
    has_steps = isinstance(searches[0].question.method, Orbit)

    def smooth(nodes: Array) -> tuple[NDArray[Any], Array]:
        where = [(int(i), int(k)) for i, k in np.argwhere(np.isfinite(nodes))]
        motions = _ask(context, [(searches[k], float(nodes[i, k])) for i, k in where])
        found = np.full((len(STEP_MULTIPLES) if has_steps else 1, *nodes.shape), np.nan, complex)
        noise = np.full(nodes.shape, SETTLED)
        for j, (i, k) in enumerate(where):
            s, at, one = searches[k], nodes[i, [k]], motions[[j]]
            theory = s.guide.theory(at)
            found[:, i, k] = [(s.smooth(at, one, row) - theory)[0] for row in range(len(found))]
            problems[k] = problems[k] or one.problems[0]
            x = one.columns[own[k]]
            heights[k] = x.unit
            if not has_steps:
                noise[i, k] = x.error[0] / abs(x.value[0])
        return found, noise.max(0)

    def height(x: Array, smooth: NDArray[Any], numbers: NDArray[np.intp]) -> Array:
        size = np.empty(x.shape)
        for k in np.unique(numbers):
            guide, own = searches[k].guide, numbers == k
            size[..., own] = guide.figure(x[..., own], guide.theory(x[..., own]) + smooth[..., own])
        return np.maximum(size, np.finfo(float).tiny)

    half = np.array([s.half_width(at) for s, at in tops])
    of_all = peaks(smooth, height, x, half)
    figures = []
    for k, s in enumerate(searches):
        order = CONVERGENCE_ORDERS[getattr(s.question, "algorithm", "strang")]
        why = of_all.places.reasons[k] and (problems[k] or of_all.places.reasons[k])
        pair = []
        units = ((s.find.unit or "1", s.meaning), (heights[k], f"largest {s.find.figure}"))
        for one, text in zip(of_all, units):
            value, error = one.x[:, k], one.error[:, k]
            if not (has_steps or why):
                pair.append(Figure(float(value[0]), text[0], float(error[0]), text[1]))
            else:
                pair.append(figure_of(at_zero_step(value, order, error), (), *text, why))
        figures.append((pair[0], pair[1]))
    return figures


def _ask(context: Context, points: Sequence[tuple[LineSearch, float]]) -> Motions:
    """What questions say at values of searches."""
    groups: dict[Any, list[int]] = {}
    for j, (s, _) in enumerate(points):
        is_orbit = isinstance(s.question.method, Orbit) and s.name != NUMBER
        groups.setdefault((type(s.question), is_orbit, s.states is None), []).append(j)
    parts, order = [], []
    for (_, is_orbit, _), some in groups.items():
        own = [points[j] for j in some]
        if is_orbit:
            states = [s.states_at(np.array([x])) for s, x in own if s.states is not None]
            asked = [s.at(x) for s, x in own]
            parts.append(measured(context, asked, np.concatenate(states) if states else None))
        else:
            parts.append(_solved(context, own))
        order += some
    return reduce(Motions.beside, parts)[np.argsort(order)] if parts else Motions.of([], [])


def _solved(context: Context, points: Sequence[tuple[LineSearch, float]]) -> Motions:
    """What questions find at values of searches, and the numbers that these seek; what several ask is solved once."""
    keys = [(id(s.question), s.find.over, x) for s, x in points]
    asked = {key: s.at(x) for key, (s, x) in zip(keys, points)}
    found = dict(zip(asked, solve_each(context, list(asked.values()))))
    each: list[Findings | SetupError] = []
    for key, (s, _) in zip(keys, points):
        one = found[key]
        if not isinstance(s.find.figure, str):
            value, error = s.find.figure(asked[key], one)
            known = math.isfinite(value)
            one = Findings({NUMBER: Figure(value, "1", error if known else None)})
        each.append(one)
    return Motions.of([asked[key] for key in keys], each)
