"""What would make a judgement good: for each input the nearest values at which it is decided so, errors included.

Each input is varied alone, over a range around its present value. `find` searches on single runs without errors, on all
inputs at once, where judgements turn. Only the ends of the stretches in which they are good are certified: of two
neighbouring values of four digits the judgement is decided on the one, and not on the other. A stall, a jam or a fold, at
which a number jumps or ends, is such an end as well.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import count, pairwise
from typing import Any, NamedTuple

import numpy as np

from cosim import SetupError
from cosim.progress import bar_of_runs
from cosim.rounding import unit_suffix

from .answer import Answer, Findings, GivenValue, Table, option_values, parameters
from .context import Context, captured_log_warnings
from .figure import Figure
from .find import Find, find
from .judgement import Holds, Judgement, capital
from .live import Slider
from .options import Option, declared
from .orbits import solve_each
from .project import PYTHON
from .question import Probe, Question

#: How much wider than its slider a range may be: from a third of the present value to three times it.
WIDENED = 3.0
#: Significant digits of a remedy, as of a figure in a sentence.
DIGITS = 4
#: Rounds in which the ends of a stretch move apart until both are decided, and by which factor; conventions.
ROUNDS, WIDER = 5, 4.0
#: Runs of a search for an input and a judgement, about: a grid of 17, the rounds of its crossings, what is between them.
RUNS = 28
#: Runs of its certified values, about: two on each side, each with three step sizes.
CERTIFIED = 7
#: Turns of runs until an orbit is steady, from both sides and with three step sizes, about; and steps of what has neither turns
#: nor a stop, so many that nobody waits for them unasked.
TURNS, UNKNOWN_STEPS = 50, 100_000
#: Steps that one of a Python FMU counts as; measured ones take 6 to 23 times as long as native ones.
PYTHON_STEPS = 10
#: Least share of a range that counts as above 0. A convention.
LEAST_SHARE = 1e-3
#: Relative change of a figure that is an effect: far above the rounding of its sums.
EFFECT = 1e-9
#: Figures beside a remedy that are told, and their least relative change; conventions.
MOST_FIGURES, LEAST_CHANGE = 3, 0.02
#: Lines of remedies that are printed; the files have all.
MOST_LINES = 16
TABLE = "remedies.csv"
#: What a figure shall be.
UNTIL = re.compile(r"\s*(\w+)\s*(<=|>=|=)\s*(.+)")
Judge = Callable[[Question, Findings], Sequence[Judgement]]


class Range(NamedTuple):
    """An input, an option or a start value, its present value, the range in which it is varied, and what it is."""

    name: str
    unit: str
    now: float
    low: float
    high: float
    meaning: str = ""

    def text(self) -> str:
        """The range in words."""
        return f"{self.name} from {self.low:.4g} to {self.high:.4g}{unit_suffix(self.unit)}"


@dataclass
class Remedy:
    """An end of a stretch of values of an input over which a judgement is decided as one wants.

    Attributes
    ----------
    varied : Range
        The input.
    is_upper : bool
        Whether the stretch is above the value, else below it.
    place, until : float
        Where the stretch begins and ends by the search.
    value, outside : float
        Two values of four digits, where errors allow: at the first the judgement is decided so, at the other it is not.
    turns : sequence of str
        What is worse at the value than now: other judgements and their answers.
    changes : sequence of str
        The figures that change most, at the value and now.
    """

    varied: Range
    is_upper: bool
    place: float
    until: float
    value: float = math.nan
    outside: float = math.nan
    turns: Sequence[str] = ()
    changes: Sequence[str] = ()

    @property
    def error(self) -> float:
        """How far before the value the judgement is not decided so."""
        return abs(self.value - self.outside)

    @property
    def change(self) -> float:
        """The relative change from the present value."""
        return self.value / self.varied.now - 1.0 if self.varied.now else math.inf

    def text(self) -> str:
        """The stretch without the input, "below 0.0312"."""
        end = self.varied.high if self.is_upper else self.varied.low
        if self.until == end:
            return f"{'above' if self.is_upper else 'below'} {self.value:.6g}"
        ends = [f"{self.value:.6g}", f"about {self.until:.3g}"]
        return f"between {' and '.join(ends if self.is_upper else ends[::-1])}"


class Remedies(NamedTuple):
    """What makes a judgement good, the least change first, and the inputs that do not change it."""

    judgement: Judgement
    found: Sequence[Remedy]
    without: Sequence[Range]

    def lines(self) -> list[str]:
        """The remedies in words, an input in a line."""
        texts = []
        for x in dict.fromkeys(x.varied for x in self.found):
            down, up = (
                [y for y in self.found if y.varied == x and y.is_upper == u] for u in (False, True)
            )
            said = " or ".join(y.text() for y in (*down, *up))
            if down and up and up[0].value < down[0].value:  # the present value lies between
                said = f"between {up[0].value:.6g} and {down[0].value:.6g}"
            name = f"{x.name} ({x.meaning})" if x.meaning else x.name
            texts.append(f"{name} {said}{unit_suffix(x.unit)}, now {x.now:.6g}")
        claim = f"{capital(self.judgement.claim)}: {Holds.YES if self.judgement.is_wanted else Holds.NO} with"
        lines = [f"{claim} {x}" for x in texts]
        if len(texts) > 1:
            lines = [f"{claim} any one of these changes:", *(f"  {x}" for x in texts)]
        if self.without:
            nothing = "; ".join(x.text() for x in self.without)
            lines.append(
                f"{claim} any {nothing}" if self.judgement.good else f"  not with any {nothing}"
            )
        return lines

    def effects(self, *, in_full: bool) -> Iterator[str]:
        """What else turns to no at the ends of the stretches, and in full what changes there."""
        for x in self.found:
            if told := [*x.turns, *(x.changes if in_full else ())]:
                value = f"{x.varied.name} = {x.value:.6g}{unit_suffix(x.varied.unit)}"
                yield f"{'But with' if x.turns else 'With'} {value}: {'; '.join(told)}"

    def rows(self) -> list[dict[str, Any]]:
        """The remedies for files; a value that is not there is none in the whole range."""
        none = [Remedy(x, is_upper=False, place=math.nan, until=math.nan) for x in self.without]
        return [
            {
                "claim": self.judgement.claim, **x.varied._asdict(), "side": "from" if x.is_upper else "up to",
                "value": x.value, "error": x.error, "until": x.until, "change": x.change, "turns": "; ".join(x.turns),
                "changes": "; ".join(x.changes),
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
        given = values[x.name]
        found.append(Range(x.name, given.unit, now, low, high, given.meaning.partition(",")[0]))
    return found


def rounded_towards(x: float, upward: int) -> float:
    """Return a number rounded to DIGITS, up (1) or down (-1)."""
    unit = 10.0 ** (math.floor(math.log10(abs(x))) - DIGITS + 1) if x else 1.0
    whole = (math.ceil if upward > 0 else math.floor)(x / unit * (1.0 - upward * 1e-12))
    return float(f"{whole * unit:.{DIGITS}g}")


@dataclass(frozen=True)
class Search:
    """A search for what makes judgements good.

    Attributes
    ----------
    question : Question
        What is asked.
    context : Context
        Where.
    ranges : sequence of Range
        What is varied, each alone.
    judge : callable
        Gives the judgements of what the question finds.
    wanted : sequence of int
        The numbers of those that shall be good. The others shall not become worse.
    """

    question: Question
    context: Context
    ranges: Sequence[Range]
    judge: Judge
    wanted: Sequence[int]

    @property
    def steps(self) -> float:
        """About how many communication steps the search takes, known beforehand; cases that are run together count as one."""
        o: Any = self.question
        of_one = UNKNOWN_STEPS
        if "steps_per_rev" in declared(type(o)):
            of_one = TURNS * o.steps_per_rev
        elif hasattr(how := o.run_options(), "stop"):
            of_one = how.stop / how.step
        pairs = len(self.ranges) * len(self.wanted)
        return float(pairs * (RUNS + CERTIFIED) * of_one / o.at_once)

    @cached_property
    def first(self) -> tuple[Findings | SetupError, Sequence[Range]]:
        """What is found now, and the ranges that have an effect."""
        (now,) = solve_each(self.context, [self.question])
        points = [(x, end) for x in self.ranges for end in (x.now, x.low, x.high)]
        found = self.ask(self.rough, points)
        able = [
            x
            for x, *three in zip(self.ranges, found[::3], found[1::3], found[2::3])
            if not all(same_figures(three[0], y) for y in three[1:])
        ]
        return now, able

    @property
    def rough(self) -> Context:
        """The context of runs without errors."""
        return replace(self.context, certifies=False)

    def ask(
        self, context: Context, points: Sequence[tuple[Range, float]]
    ) -> list[Findings | SetupError]:
        """Return what is found at values of inputs."""
        return solve_each(context, [self.question.with_value(x.name, value) for x, value in points])

    def judgements(self, o: Question, found: Findings | SetupError) -> Sequence[Judgement]:
        """Return the judgements of what was found, none where that is refused."""
        return () if isinstance(found, SetupError) else self.judge(o, found)

    def margin(self, k: int, o: Question, found: Findings | SetupError) -> tuple[float, float]:
        """By how much a judgement is good, and the error of that; -1 where there is none."""
        judgements = self.judgements(o, found)
        return judgements[k].margin if k < len(judgements) else (-1.0, 0.0)

    def good_stretches(self) -> list[tuple[int, Range, list[tuple[float, float]]]]:
        """Return by single runs where judgements are good over each input: the ends of each stretch."""
        pairs = [(k, x) for k in self.wanted for x in self.first[1]]
        asked, total = count(1), RUNS * len(pairs)
        with bar_of_runs("remedies", total) as show:

            def residual(k: int, o: Question, found: Findings | SetupError) -> tuple[float, float]:
                show(min(1.0, next(asked) / total))
                return self.margin(k, o, found)

            finds = [Find(x.name, x.low, x.high, partial(residual, k), which="all", unit=x.unit) for k, x in pairs]  # fmt: skip
            crossings = find(self.rough, [(self.question, x) for x in finds])
        ends = [
            pairwise([x.low, *sorted(y.value for y in each if y.error is not None), x.high])
            for (_, x), each in zip(pairs, crossings)
        ]
        parts = [(pair, a, b) for pair, each in zip(pairs, ends) for a, b in each]
        middles = [(x, (a + b) / 2.0) for (_, x), a, b in parts]
        good: dict[tuple[int, Range], list[tuple[float, float]]] = {pair: [] for pair in pairs}
        for ((k, x), a, b), (_, at), here in zip(parts, middles, self.ask(self.rough, middles)):
            if self.margin(k, self.question.with_value(x.name, at), here)[0] > 0.0:
                good[k, x].append((a, b))
        return [(k, x, each) for (k, x), each in good.items()]

    def certify(self, ends: Sequence[tuple[int, Remedy]], before: Sequence[Judgement]) -> None:
        """Set the values of remedies: on both sides of an end, so far apart that judgements are decided there."""
        for r in range(ROUNDS):
            sides = [
                (k, x, side)
                for k, x in ends
                for side, value in ((1, x.value), (-1, x.outside))
                if math.isnan(value)
            ]
            points = []
            for _, x, side in sides:
                upward = side if x.is_upper else -side
                far = upward * abs(x.place) * 10.0**-DIGITS * (WIDER**r - 1.0)
                points.append((x.varied, rounded_towards(x.place + far, upward)))
            for (k, x, side), (_, at), here in zip(sides, points, self.ask(self.context, points)):
                judgements = self.judgements(self.question.with_value(x.varied.name, at), here)
                is_good = k < len(judgements) and judgements[k].good is True
                if side > 0 and is_good:
                    x.value = at
                    x.turns = [
                        f"{y.what}: {y.answer}"
                        for was, y in zip(before, judgements)
                        if was.good and not y.good
                    ]
                    x.changes = changes(self.first[0], here, before[k].figure)
                elif side < 0 and not is_good:
                    x.outside = at

    def remedies(self) -> list[Remedies]:
        """Return what makes each judgement good: the nearest stretches on both sides, or that of the present value."""
        if not (self.steps and self.first[1]):
            return []
        before = self.judgements(self.question, self.first[0])
        ends = []
        for k, x, stretches in self.good_stretches():
            up = [
                Remedy(x, is_upper=True, place=a, until=b)
                for a, b in stretches
                if a > x.low and b > x.now
            ]
            down = [
                Remedy(x, is_upper=False, place=b, until=a)
                for a, b in stretches
                if b < x.high and a < x.now
            ]
            ends += [(k, y) for y in (*up[:1], *down[-1:])]
        self.certify(ends, before)
        found = []
        for k in self.wanted:
            mine = [y for number, y in ends if number == k and math.isfinite(y.value)]
            named = {y.varied for y in mine}
            mine.sort(key=lambda y: abs(y.change))
            found.append(Remedies(before[k], mine, [x for x in self.first[1] if x not in named]))
        return found


def search_for(
    o: Question,
    context: Context,
    found: Findings,
    sliders: Sequence[Slider],
    values: Mapping[str, GivenValue],
) -> Search:
    """Return the search for what makes good the judgements of an answer that are not.

    Inputs have the sliders of the page, and their values unless what is asked in place of the question has others.
    """
    judgements = o.judgements(found.figures, found.data)
    bad = [k for k, x in enumerate(judgements) if x.answer is not None and x.good is not True]
    question, judge, own = o.probe(context, found) if bad else Probe(o)
    start = {x: values[x]._replace(value=y) for x, y in question.start.items() if x in values}
    inputs = ranges(question, sliders if own is None else own, {**values, **start}) if bad else []
    return Search(question, context, inputs, judge or own_judgements, bad)


def own_judgements(o: Question, found: Findings) -> Sequence[Judgement]:
    """Return the judgements of a question."""
    return o.judgements(found.figures, found.data)


def same_figures(one: Findings | SetupError, other: Findings | SetupError) -> bool:
    """Whether nothing that was found differs."""
    if isinstance(one, SetupError) or isinstance(other, SetupError):
        return False
    a, b = ({name: figure.value for name, figure in x.figures.items()} for x in (one, other))
    return [*a] == [*b] and np.allclose([*a.values()], [*b.values()], EFFECT, 0.0, equal_nan=True)


def changes(
    now: Findings | SetupError, then: Findings | SetupError, judged: Figure | None
) -> list[str]:
    """Return the figures of runs that change most, but for the one that is judged: what they become, and what they are."""
    if isinstance(now, SetupError) or isinstance(then, SetupError):
        return []
    pairs = [(x, then.figures[name]) for name, x in now.figures.items() if name in then.figures]
    found = [
        (abs(y.value / x.value - 1.0), f"{y.meaning} {y.brief()}, now {x.brief()}")
        for x, y in pairs
        if x.error and y.error and x.value and x != judged
    ]
    found.sort(reverse=True)
    return [text for change, text in found[:MOST_FIGURES] if change > LEAST_CHANGE]


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
    (now,) = solve_each(context, [o])
    if isinstance(now, SetupError):
        raise now
    probe = o.probe(context, now).question
    if name not in now.figures:
        raise SetupError(
            f"--until {wanted!r}: {o.name} has no figure {name!r}, only {', '.join(now.figures)}"
        )
    of_fmus = parameters(now.system) if now.system and now.system.parts else {}
    given = {**of_fmus, **option_values(o, now.defaults)}
    (brief,) = solve_each(context, [probe])
    if isinstance(brief, Findings) and brief.figures.get(name) == now.figures[name]:
        o = probe
    level = Option(name, float, unit=now.figures[name].unit.removeprefix("1")).read(
        raw.strip(), f"--until: {name}"
    )
    if sign == "=":
        found = find(context, [(o, x._replace(figure=name, level=level)) for x in varied])
        return [
            f"{wanted}: not by {x.over}: {each[0].reason}" if each[0].reason
            else f"{wanted}: {x.over} = {' or '.join(y.text() for y in each)}"
            for x, each in zip(varied, found)
        ]  # fmt: skip

    def judge(_o: Question, found: Findings) -> list[Judgement]:
        return [
            Judgement(wanted, found.figures[name], **{"most" if sign == "<=" else "least": level})
        ]

    inputs = [Range(x.over, x.unit, given[x.over].value, x.low, x.high) for x in varied]
    search = Search(o, context, inputs, judge, [0])
    idle = [f"{wanted}: no effect of {x.name}" for x in inputs if x not in search.first[1]]
    return [*(line for x in search.remedies() for line in x.lines()), *idle]


def with_remedies(answer: Answer, most_steps: float) -> tuple[Answer, list[str]]:
    """Return an answer with its remedies, if these take at most so many communication steps, and the lines to print.

    The page has the ranges and what turns to no at their ends, below the verdict; JSON and the table `remedies.csv` have all
    values. What other figures become is printed where remedies are asked for.
    """
    search: Search | None = answer.search
    if search is None or not (search.steps and most_steps):
        return answer, []
    is_python = answer.provenance.get("flavour") == PYTHON
    steps = search.steps * (PYTHON_STEPS if is_python else 1)
    if steps > most_steps:
        return answer, ["What would change that takes many runs to find: ask again with --remedies"]
    with captured_log_warnings():  # of values that nobody has chosen
        found = search.remedies()
    if not found:
        return answer, []
    told, printed = (
        [line for x in found for line in (*x.lines(), *x.effects(in_full=in_full))]
        for in_full in (False, most_steps == math.inf)
    )
    more = len(printed) - MOST_LINES
    rows = [row for x in found for row in x.rows()]
    table = Table.of_rows([[*row.values()] for row in rows], dict.fromkeys(rows[0], ""))
    return replace(
        answer,
        verdict="\n".join([answer.verdict, *told]),
        tables={**answer.tables, TABLE: table},
        facts={**answer.facts, "remedies": rows},
    ), [*printed[:MOST_LINES], *([f"{more} more in {TABLE}"] if more > 0 else [])]
