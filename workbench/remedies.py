"""What would make a judgement good: for each input the nearest values at which it is decided so, errors included.

Each input is varied alone, over a range around its present value. `find` searches on single runs without errors, on all
inputs at once, where judgements turn. Only the ends of the stretches in which they are good are certified: of two
neighbouring values of four digits the judgement is decided on the one, and not on the other. A stall, a jam or a fold, at
which a number jumps or ends, is such an end as well.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from cosim import SetupError
from cosim.progress import bar_of_runs
from cosim.rounding import unit_suffix

from .answer import Answer, Findings, GivenValue, Table, option_values, parameters
from .context import Context
from .find import Find, find, solve_each
from .judgement import Holds, Judgement, capital
from .live import Slider
from .options import Option, declared
from .question import Question

#: How much wider than its slider a range may be: from a third of the present value to three times it.
WIDENED = 3.0
#: Significant digits of a remedy, as of a figure in a sentence.
DIGITS = 4
#: Rounds in which the ends of a stretch move apart until both are decided, and by which factor; conventions.
ROUNDS, WIDER = 5, 4.0
#: Runs of a search for an input and a judgement, about: a grid of 17, the rounds of its crossings, what is between them.
RUNS = 28
#: Least share of a range that counts as above 0. A convention.
LEAST_SHARE = 1e-3
#: Relative change of a figure that is an effect: far above the rounding of its sums.
EFFECT = 1e-9
#: Lines of remedies that are printed; the files have all.
MOST_LINES = 5
TABLE = "remedies.csv"
#: What a figure shall be.
UNTIL = re.compile(r"\s*(\w+)\s*(<=|>=|=)\s*(.+)")
Judge = Callable[[Question, Findings], Judgement]


class Range(NamedTuple):
    """An input, an option or a start value, its present value, and the range in which it is varied."""

    name: str
    unit: str
    now: float
    low: float
    high: float

    def text(self) -> str:
        """The range in words."""
        return f"{self.name} from {self.low:.4g} to {self.high:.4g}{unit_suffix(self.unit)}"


class Remedy(NamedTuple):
    """A value of an input at which a judgement is decided as one wants, as it is on the way to `until`.

    Attributes
    ----------
    varied : Range
        The input.
    is_upper : bool
        Whether larger values do as well, else smaller ones.
    value : float
        The value, of four digits where errors allow.
    error : float
        At a value so much before it the judgement is not decided that way.
    until : float
        The other end of the stretch, of the search alone; an end of the range where there is none.
    turns : sequence of str
        What is worse then than now: other judgements and their answers.
    """

    varied: Range
    is_upper: bool
    value: float
    error: float
    until: float
    turns: Sequence[str] = ()

    def text(self) -> str:
        """The remedy without the input, "up to 0.0312"."""
        end = self.varied.high if self.is_upper else self.varied.low
        more = "" if self.until == end else f" (as far as about {self.until:.3g})"
        return f"{'from' if self.is_upper else 'up to'} {self.value:.6g}{more}"

    @property
    def change(self) -> float:
        """The relative change from the present value."""
        return self.value / self.varied.now - 1.0 if self.varied.now else math.inf


class Remedies(NamedTuple):
    """What would make a judgement good, the least change first, and the inputs that do not."""

    judgement: Judgement
    found: Sequence[Remedy]
    without: Sequence[Range]

    def lines(self) -> list[str]:
        """The remedies in words, and what else turns with them."""
        inputs = dict.fromkeys(x.varied for x in self.found)
        texts = []
        for x in inputs:
            both = sorted((y for y in self.found if y.varied == x), key=lambda y: y.is_upper)
            of_input = " or ".join(y.text() for y in both)
            texts.append(f"{x.name} {of_input}{unit_suffix(x.unit)} (now {x.now:.6g})")
        which = f"with {'one of: ' if len(texts) > 1 else ''}{'; '.join(texts)}"
        nothing = "; ".join(x.text() for x in self.without)
        what = f"{self.judgement.what}: {Holds.YES if self.judgement.is_wanted else Holds.NO}"
        said = [*([which] if texts else []), *([f"not by {nothing}"] if nothing else [])]
        return [
            capital(f"{what} {'; '.join(said)}"),
            *(
                f"But with {x.varied.name} {x.text()}{unit_suffix(x.varied.unit)}: {'; '.join(x.turns)}"
                for x in self.found
                if x.turns
            ),
        ]

    def rows(self) -> list[dict[str, Any]]:
        """The remedies for files; one without a value is none in the whole range."""
        none = [
            Remedy(x, is_upper=False, value=math.nan, error=math.nan, until=math.nan)
            for x in self.without
        ]
        return [
            {
                "claim": self.judgement.what, "input": x.varied.name, "unit": x.varied.unit, "now": x.varied.now,
                "side": ("from" if x.is_upper else "up to") if math.isfinite(x.value) else "none",
                "value": x.value, "error": x.error, "until": x.until, "change": x.change,
                "low": x.varied.low, "high": x.varied.high, "turns": "; ".join(x.turns),
            }
            for x in (*self.found, *none)
        ]  # fmt: skip


def ranges(o: Question, sliders: Sequence[Slider], values: Mapping[str, GivenValue]) -> list[Range]:
    """Return the ranges of inputs that have sliders, around their present values, within the bounds of options."""
    options = declared(type(o))
    found = []
    for x in sliders:
        now = values[x.name].value if x.name in values else None
        is_float = x.name not in options or options[x.name].kind is float
        if not is_float or not isinstance(now, int | float) or isinstance(now, bool):
            continue
        ends = (x.low, x.high, now / WIDENED, now * WIDENED)
        bounds = options[x.name].bounds if x.name in options else {}
        high = min(max(ends), bounds.get("at most", math.inf))
        low = max(min(ends), bounds.get("at least", -math.inf), LEAST_SHARE * high)
        found.append(Range(x.name, values[x.name].unit, now, low, high))
    return found


class Stretch(NamedTuple):
    """Values between two ends, with the widths within which these are known, where a judgement is good or not."""

    low: float
    high: float
    low_error: float
    high_error: float
    is_good: bool


@dataclass
class Edge:
    """An end of a stretch in which a judgement is good, which is being certified: good at `inner`, not at `outer`."""

    judge: int
    varied: Range
    place: float
    error: float
    until: float
    is_upper: bool
    inner: float = math.nan
    outer: float = math.nan
    others: Sequence[Judgement] = ()
    reach: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def value(self, side: int) -> float:
        """A value of few digits inside (1) or outside (-1) of the stretch, farther away round by round."""
        upward = side if self.is_upper else -side
        far = self.error + self.reach[side > 0] * abs(self.place)
        return rounded_towards(self.place + upward * far, upward)


def rounded_towards(x: float, upward: int) -> float:
    """Return a number rounded to DIGITS, up (1) or down (-1)."""
    unit = 10.0 ** (math.floor(math.log10(abs(x))) - DIGITS + 1) if x else 1.0
    whole = (math.ceil if upward > 0 else math.floor)(x / unit * (1.0 - upward * 1e-12))
    return float(f"{whole * unit:.{DIGITS}g}")


@dataclass(frozen=True)
class Search:
    """A search for what would make judgements good.

    Attributes
    ----------
    question : Question
        What is asked.
    context : Context
        Where.
    ranges : sequence of Range
        What is varied, each alone.
    judges : sequence of callable
        Give the judgements of what the question finds.
    all_judgements : callable
        Gives those that must not become worse.
    """

    question: Question
    context: Context
    ranges: Sequence[Range]
    judges: Sequence[Judge]
    all_judgements: Callable[[Question, Findings], Sequence[Judgement]] = lambda _o, _f: ()

    @classmethod
    def of(
        cls,
        o: Question,
        context: Context,
        judgements: Sequence[Judgement],
        sliders: Sequence[Slider],
        values: Mapping[str, GivenValue],
    ) -> Search:
        """Return the search for what would make good the judgements of an answer that are not."""

        def judge(k: int) -> Judge:
            return lambda o, found: o.judgements(found.figures, found.data)[k]

        bad = [k for k, x in enumerate(judgements) if x.answer is not None and x.good is not True]
        return cls(
            o.probe(), context, ranges(o, sliders, values) if bad else [], [judge(k) for k in bad],
            lambda o, found: o.judgements(found.figures, found.data),
        )  # fmt: skip

    @cached_property
    def is_empty(self) -> bool:
        """Whether there is nothing to search."""
        return not (self.ranges and self.judges)

    @cached_property
    def first(self) -> tuple[Findings | SetupError, Sequence[Range], float]:
        """What is found now, the ranges that have an effect, and about how long the search takes [s]."""
        began = perf_counter()
        (now,) = solve_each(self.context, [self.question])
        middle = perf_counter()
        points = [(x, end) for x in self.ranges for end in (x.low, x.high)]
        found = self.ask(self.rough, [(x, x.now) for x in self.ranges] + points)
        at_now, ends = found[: len(self.ranges)], found[len(self.ranges) :]
        each = (perf_counter() - middle) / len(found)
        able = [
            x
            for x, here, low, high in zip(self.ranges, at_now, ends[::2], ends[1::2])
            if not (same_figures(here, low) and same_figures(here, high))
        ]
        number = len(able) * len(self.judges)
        return now, able, number * (RUNS * each + 4.0 * (middle - began))

    @property
    def rough(self) -> Context:
        """The context of runs without errors."""
        return replace(self.context, certifies=False)

    @property
    def seconds(self) -> float:
        """About how long the search takes [s]."""
        return 0.0 if self.is_empty else self.first[2]

    def at(self, varied: Range, x: float) -> Question:
        """Return the question with a value of an input."""
        return self.question.with_value(varied.name, x)

    def ask(
        self, context: Context, points: Sequence[tuple[Range, float]]
    ) -> list[Findings | SetupError]:
        """Return what is found at values of inputs."""
        return solve_each(context, [self.at(varied, x) for varied, x in points])

    def judged(self, k: int, o: Question, found: Findings | SetupError) -> Judgement | None:
        """Return a judgement of what was found; None where it is refused, or has none."""
        if isinstance(found, SetupError):
            return None
        try:
            return self.judges[k](o, found)
        except (LookupError, SetupError):
            return None

    def margin(self, k: int, o: Question, found: Findings | SetupError) -> tuple[float, float]:
        """By how much a judgement is good, and the error of that; -1 where there is none."""
        judgement = self.judged(k, o, found)
        return judgement.margin if judgement else (-1.0, 0.0)

    def stretches(self, context: Context) -> list[tuple[int, Range, list[Stretch]]]:
        """Return where judgements are good and where not, over each input."""
        pairs = [(k, x) for k in range(len(self.judges)) for x in self.first[1]]
        with bar_of_runs("remedies", RUNS * len(pairs)) as show:
            asked = 0

            def residual(
                k: int,
            ) -> Callable[[Question, Findings | SetupError], tuple[float, float]]:
                def measure(o: Question, found: Findings | SetupError) -> tuple[float, float]:
                    nonlocal asked
                    asked += 1
                    show(min(1.0, asked / (RUNS * len(pairs))))
                    return self.margin(k, o, found)

                return measure

            crossings = find(
                context,
                [
                    (self.question, Find(x.name, x.low, x.high, residual(k), which="all", unit=x.unit))
                    for k, x in pairs
                ],
            )  # fmt: skip
        ends = []
        for (_, x), of_pair in zip(pairs, crossings):
            inside = sorted((y.value, y.error) for y in of_pair if y.error is not None)
            ends.append([(x.low, 0.0), *inside, (x.high, 0.0)])
        middles = [
            (x, (a + b) / 2.0) for (_, x), e in zip(pairs, ends) for (a, _), (b, _) in pairwise(e)
        ]
        between = iter(zip(middles, self.ask(context, middles)))
        found = []
        for (k, x), e in zip(pairs, ends):
            parts = []
            for (a, a_error), (b, b_error) in pairwise(e):
                (_, at), here = next(between)
                is_good = self.margin(k, self.at(x, at), here)[0] > 0.0
                parts.append(Stretch(a, b, a_error, b_error, is_good))
            found.append((k, x, parts))
        return found

    def nearest_edges(self) -> list[Edge]:
        """Return the certified ends of stretches in which judgements are good, the nearest on each side."""
        edges = []
        for k, x, parts in self.stretches(self.rough):
            up = [y for y in parts if y.is_good and y.low > x.low and y.high > x.now]
            down = [y for y in parts if y.is_good and y.high < x.high and y.low < x.now]
            edges += [Edge(k, x, y.low, y.low_error, y.high, is_upper=True) for y in up[:1]]
            edges += [Edge(k, x, y.high, y.high_error, y.low, is_upper=False) for y in down[-1:]]
        self.certify(edges)
        return [x for x in edges if math.isfinite(x.inner)]

    def good_intervals(self) -> dict[Range, list[tuple[float, float]]]:
        """Return by input the intervals in which the first judgement is good, with certified ends; nan where there is none."""
        edges: dict[tuple[Range, bool, float], Edge] = {}
        found = self.stretches(self.rough)
        for k, x, parts in found:
            for y in parts:
                for is_upper, place, error in (
                    (True, y.low, y.low_error),
                    (False, y.high, y.high_error),
                ):
                    if y.is_good and x.low < place < x.high:
                        edges[x, is_upper, place] = Edge(k, x, place, error, math.nan, is_upper)
        self.certify([*edges.values()])
        ends = {key: edge.inner for key, edge in edges.items()}
        return {
            x: [(ends.get((x, True, y.low), x.low), ends.get((x, False, y.high), x.high)) for y in parts if y.is_good]
            for _, x, parts in found
        }  # fmt: skip

    def certify(self, edges: Sequence[Edge]) -> None:
        """Move both sides of edges apart until judgements are decided there, all together round by round."""
        for r in range(ROUNDS):
            open_sides = [
                (x, side)
                for x in edges
                for side, y in ((1, x.inner), (-1, x.outer))
                if math.isnan(y)
            ]
            points = [(x.varied, x.value(side)) for x, side in open_sides]
            found = self.ask(self.context, points)
            for (edge, side), (varied, at), here in zip(open_sides, points, found):
                o = self.at(varied, at)
                judgement = self.judged(edge.judge, o, here)
                is_good = judgement is not None and judgement.good is True
                if side > 0 and is_good and isinstance(here, Findings):
                    edge.inner, edge.others = at, self.all_judgements(o, here)
                elif side < 0 and not is_good:
                    edge.outer = at
                edge.reach[side > 0] = 10.0**-DIGITS * WIDER**r

    def remedies(self) -> list[Remedies]:
        """Return what would make each judgement good."""
        if self.is_empty:
            return []
        now = self.first[0]
        before = self.all_judgements(self.question, now) if isinstance(now, Findings) else ()
        edges = self.nearest_edges()
        found = []
        for k in range(len(self.judges)):
            judgement = self.judged(k, self.question, now)
            if judgement is None:
                continue
            mine = [
                Remedy(
                    x.varied, x.is_upper, x.inner, abs(x.inner - x.outer), x.until,
                    [f"{y.what}: {y.answer}" for was, y in zip(before, x.others) if was.good and not y.good],
                )
                for x in edges
                if x.judge == k
            ]  # fmt: skip
            mine.sort(key=lambda x: abs(x.change))
            named = {x.varied for x in mine}
            found.append(Remedies(judgement, mine, [x for x in self.first[1] if x not in named]))
        return found


def same_figures(one: Findings | SetupError, other: Findings | SetupError) -> bool:
    """Whether nothing that was found differs."""
    if isinstance(one, SetupError) or isinstance(other, SetupError):
        return False
    names = [*one.figures]
    a, b = (
        [x.figures[name].value if name in x.figures else math.nan for name in names]
        for x in (one, other)
    )
    return names == [*other.figures] and np.allclose(a, b, rtol=EFFECT, atol=0.0, equal_nan=True)


def values_until(o: Question, context: Context, wanted: str, varied: Sequence[Find]) -> list[str]:
    """Return where a figure has a level, "lag = 90 deg", or is within it, "tau2 <= 50 N.m", over each of several inputs.

    Raises
    ------
    SetupError
        For another form, for a figure that there is not, and for a question that is refused as it is.
    """
    written = UNTIL.fullmatch(wanted)
    if not written:
        raise SetupError(f'--until {wanted!r} must read "FIGURE = VALUE UNIT", or with <= or >=')
    name, sign, raw = written.groups()
    now, brief = solve_each(context, [o, o.probe()])
    if isinstance(now, SetupError):
        raise now
    if isinstance(brief, Findings) and brief.figures.get(name) == now.figures.get(name):
        o = o.probe()
    if name not in now.figures:
        raise SetupError(
            f"--until {wanted!r}: {o.name} has no figure {name!r}, only {', '.join(now.figures)}"
        )
    level = Option(name, float, unit=now.figures[name].unit.removeprefix("1")).read(
        raw.strip(), f"--until: {name}"
    )
    if sign == "=":
        found = find(context, [(o, x._replace(figure=name, level=level)) for x in varied])
        return [
            f"{wanted}: " + (" or ".join(f"{x.over} = {y.text()}" for y in each) if each[0].error is not None
            else f"not by {x.over}: {each[0].reason}")
            for x, each in zip(varied, found)
        ]  # fmt: skip
    bound = {"<=": "most", ">=": "least"}[sign]

    def judge(_o: Question, found: Findings) -> Judgement:
        return Judgement(wanted, found.figures[name], **{bound: level})

    of_fmus = parameters(now.system) if now.system and now.system.parts else {}
    given = {**of_fmus, **option_values(o, now.defaults)}
    ranges = [Range(x.over, x.unit, given[x.over].value, x.low, x.high) for x in varied]
    search = Search(o, context, ranges, [judge])
    intervals = search.good_intervals()
    lines = []
    for x in ranges:
        unit = unit_suffix(x.unit)
        if x not in intervals:
            lines.append(f"{wanted}: {x.name} has no effect")
        else:
            each = [f"{a:.6g} to {b:.6g}{unit}" for a, b in intervals[x]]
            lines.append(
                f"{wanted}: "
                + (f"{x.name} = {' or '.join(each)}" if each else f"not by {x.text()}")
            )
    return lines


def with_remedies(answer: Answer, seconds: float) -> tuple[Answer, list[str]]:
    """Return an answer with its remedies, if these take at most so long [s], and the lines to print.

    The page has all lines, below the verdict, and JSON and the table `remedies.csv` all values.
    """
    search = answer.search
    if search is None or search.is_empty or seconds <= 0.0:
        return answer, []
    if search.seconds > seconds:
        return answer, [
            f"What would change that takes about {search.seconds:.2g} s to find: ask again with --remedies"
        ]
    found = search.remedies()
    lines = [x.lines() for x in found]
    every = [*(x[0] for x in lines), *(y for x in lines for y in x[1:])]
    more = len(every) - MOST_LINES
    rows = [row for x in found for row in x.rows()]
    table = (
        Table.of_rows([[*row.values()] for row in rows], dict.fromkeys(rows[0], ""))
        if rows
        else None
    )
    more_tables = {TABLE: table} if table else {}
    return replace(
        answer,
        verdict="\n".join([answer.verdict, *every]),
        tables={**answer.tables, **more_tables},
        facts={**answer.facts, "remedies": rows},
    ), [*every[:MOST_LINES], *([f"{more} more in {TABLE}"] if more > 0 else [])]
