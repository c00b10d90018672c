"""What an answer claims: figures and their bounds, which are judged and put into words here alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from numbers import Real
from typing import Any

from cosim import SetupError
from cosim.json_values import without_infinities
from cosim.rounding import rounded, unit_suffix

from .figure import MOST_DIGITS, Figure, listed

#: A whole, in percent.
WHOLE = 100.0


class Holds(StrEnum):
    """Whether a claim holds."""

    YES = "yes"
    NO = "no"
    OPEN = "not determined"


@dataclass(frozen=True)
class Judgement:
    """A claim about a figure, or the figure alone where nothing bounds it.

    Attributes
    ----------
    what : str
        The claim, such as "torque ripple below its limit", or what the figure is.
    figure : Figure, optional
        What decides it.
    least, most : float or Figure
        What the figure must not be below or above, in its unit.
    also : sequence of Judgement
        What else must hold.
    is_so : bool, optional
        The answer where no number decides; `note` then says why.
    yes, no : str
        What to do if it holds, and if it does not; said in the answer in place of claim and yes or no. With `no` alone the
        claim is said where it holds.
    note : str
        What else there is to say.
    is_wanted : bool
        Whether one wants the claim to hold; of "on resonance" one does not.
    """

    what: str
    figure: Figure | None = None
    least: Figure | float = -math.inf
    most: Figure | float = math.inf
    also: Sequence[Judgement] = ()
    is_so: bool | None = None
    yes: str = ""
    no: str = ""
    note: str = ""
    is_wanted: bool = True

    def __post_init__(self) -> None:
        where = f"judgement {self.what!r}"
        if not isinstance(self.figure, Figure | None):
            raise SetupError(f'{where}: {self.figure!r} must be a figure, f["name"], not its value')
        for name in ("least", "most"):
            bound = getattr(self, name)
            if not isinstance(bound, Figure | Real):
                raise SetupError(f"{where}: {name} = {bound!r} must be a number or a figure")
            if isinstance(bound, Figure) and self.figure and bound.unit != self.figure.unit:
                raise SetupError(
                    f"{where}: the figure is in {self.figure.unit}, and {name} in {bound.unit}"
                )

    @property
    def good(self) -> bool | None:
        """Whether the answer is what one wants; None where nothing is decided."""
        return {Holds.YES: self.is_wanted, Holds.NO: not self.is_wanted}.get(
            self.answer or Holds.OPEN
        )

    @property
    def claim(self) -> str:
        """All that is claimed: of the figure, and what else must hold."""
        more = [x.claim for x in self.also] if _bounds(self) else []
        return listed([self.what, *more])

    @property
    def answer(self) -> Holds | None:
        """Whether the claim holds; None for a figure without bounds."""
        if self.is_so is not None:
            return Holds.YES if self.is_so else Holds.NO
        answers = [x for x in (self._of_figure(), *(x.answer for x in self.also)) if x]
        return next((x for x in (Holds.NO, Holds.OPEN, Holds.YES) if x in answers), None)

    @property
    def margin(self) -> tuple[float, float]:
        """How far it is from turning, over its bound, and the error of that: above 0 where one has what one wants.

        It is 1 or -1 where no number decides, and -1 where one is not determined.
        """
        every = list(_with_also(self))
        figures = [y for x in every for y in (x.figure, x.least, x.most) if isinstance(y, Figure)]
        is_unknown = self.answer is Holds.OPEN and any(y.error is None for y in figures)
        if self.is_so is not None or is_unknown:
            return (1.0 if self.good else -1.0), 0.0
        room, error = min(y for x in every for y in _rooms(x))
        return (room if self.is_wanted else -room), error

    def _of_figure(self) -> Holds | None:
        rooms, bounds = _rooms(self), _bounds(self)
        if self.figure is None or not bounds:
            return None
        if any(room + error < 0.0 for room, error in rooms):
            return Holds.NO
        is_sure = len(rooms) == len(bounds) and all(room - error >= 0.0 for room, error in rooms)
        return Holds.YES if is_sure else Holds.OPEN

    @property
    def why_open(self) -> str:
        """Why the answer is not determined."""
        for x in (self.figure, self.least, self.most):
            if isinstance(x, Figure) and x.error is None:
                return x.reason
        if self._of_figure() is Holds.OPEN:
            return "the bound lies within the error"
        return next((x.why_open for x in self.also if x.answer is Holds.OPEN), "")

    def evidence(self) -> str:
        """Return the figure, its bounds and how much of them it takes, "16.2 of 62.5 N.m (26 %)"."""
        answer = self.answer
        decisive = [x for x in self.also if x.answer is answer]
        if answer is Holds.OPEN:
            return f"because {self.why_open}"
        parts = [f"{x.what} {x.measured()}" for x in decisive]
        if self.is_so is None and self._of_figure() is answer:
            parts.insert(0, self.measured())
        return ", ".join(part for part in parts if part)

    def measured(self) -> str:
        """Return the figure and its bounds."""
        if self.figure is None:
            return ""
        least, most = bounded(self.least, self.figure), bounded(self.most, self.figure)
        if (math.isinf(least.value) and math.isinf(most.value)) or self.figure.error is None:
            return self.figure.brief()
        text = signed(self.figure)
        if math.isinf(most.value):
            return f"{text} (at least {bare(least)})"
        if not math.isinf(least.value):
            return f"{text} ({bare(least)} to {bare(most)})"
        if abs(self.figure.value) + self.figure.error <= most.value:
            text = self.figure.brief()
        if most.value <= 0.0 or self.figure.value < 0.0:
            return f"{text} (at most {bare(most)})"
        if self.figure.unit == "%" or not self.figure.has_digit:
            return f"{text} (limit {most.brief()})"
        share = share_text(self.figure.value / most.value)
        if self.figure.value > most.value:
            return f"{text}, limit {most.brief()} ({share})"
        return f"{bare(self.figure)} of {most.brief()} ({share})"

    def text(self) -> str:
        """Return the judgement in a line, "Torque ripple below its limit: yes, 16.2 of 62.5 N.m (26 %)"."""
        said = ", ".join(x for x in (self.answer and str(self.answer), self.evidence()) if x)
        return capital(
            ": ".join(x for x in (self.claim, "; ".join(x for x in (said, self.note) if x)) if x)
        )

    def headline(self) -> str:
        """Return the judgement as a line of an answer: what to do, if that is said, and the figure that says so."""
        do = {Holds.YES: self.yes or (self.no and self.what), Holds.NO: self.no}.get(
            self.answer or Holds.OPEN, ""
        )
        said = "; ".join(x for x in (self.evidence(), self.note) if x)
        return capital(": ".join(x for x in (do, said) if x)) if do else self.text()

    def json(self) -> dict[str, Any]:
        """The judgement for JSON."""
        ends = {"least": self.least, "most": self.most}
        values = {name: bounded(x, self.figure).value for name, x in ends.items()}
        figure = self.figure.json() if self.figure else {}
        record: dict[str, Any] = {"claim": self.what, "answer": self.answer and str(self.answer)}
        record |= {name: figure.get(name) for name in ("value", "unit", "error")} | values
        record |= {
            "reason": self.why_open if self.answer is Holds.OPEN else "",
            "also": [x.json() for x in self.also],
            "text": self.text(),
        }
        return without_infinities(record)  # type: ignore[return-value]


def _with_also(judgement: Judgement) -> Iterator[Judgement]:
    """Give a judgement and all that must hold as well."""
    yield judgement
    for x in judgement.also:
        yield from _with_also(x)


def _bounds(judgement: Judgement) -> list[tuple[Figure, float]]:
    """The bounds that a judgement has, with 1 for the least and -1 for the most."""
    both = ((judgement.least, 1.0), (judgement.most, -1.0))
    bounds = [(bounded(x, judgement.figure), sign) for x, sign in both]
    return [(bound, sign) for bound, sign in bounds if not math.isinf(bound.value)]


def _rooms(judgement: Judgement) -> list[tuple[float, float]]:
    """How far a figure is within each bound, over the bound, and the errors of that."""
    figure = judgement.figure
    return [
        (sign * (figure.value - bound.value) / scale, (figure.error + bound.error) / scale)
        for bound, sign in _bounds(judgement)
        if figure and figure.error is not None and bound.error is not None
        for scale in [abs(bound.value) or 1.0]
    ]


def share_text(share: float) -> str:
    """Write a share of a bound in percent, to two digits or whole percents; it is 100 % of the bound alone."""
    percent = WHOLE * share
    if len(f"{percent:.0f}") == 1:
        return f"{percent:.2g} %"
    texts = (f"{percent:.{digits}f}" for digits in range(MOST_DIGITS))
    return next((f"{text} %" for text in texts if float(text) != WHOLE), "100 %")


def signed(figure: Figure) -> str:
    """Return a figure for a sentence with its sign: with value and error where only a bound of its size is known."""
    if figure.error is None or figure.has_digit:
        return figure.brief()
    value, error = rounded(figure.value, figure.error, MOST_DIGITS)
    return f"{value} ± {error}{unit_suffix(figure.unit)}"


def bare(figure: Figure) -> str:
    """Return a figure for a sentence without its unit."""
    return signed(figure._replace(unit="1"))


def bounded(bound: Figure | float, figure: Figure | None) -> Figure:
    """Return a bound as a figure."""
    return (
        bound if isinstance(bound, Figure) else Figure(bound, figure.unit if figure else "1", 0.0)
    )


def capital(text: str) -> str:
    """Return a text that begins with a capital."""
    return text[:1].upper() + text[1:]


def in_time(
    claim: str, negation: str, time: Figure, within: float, *, why: str, yes: str = ""
) -> Judgement:
    """Return the judgement of what happens at a time, and within another [s]; `why` says why it never does."""
    is_known = time.error is not None
    return Judgement(
        claim, time, most=within, is_so=False if why else is_known or None, yes=yes, no=negation,
        note=why or (f"after {time.brief()}" if is_known else ""),
    )  # fmt: skip


def lines(judgements: Sequence[Judgement]) -> list[str]:
    """Return an answer in words: a line for each judgement, what to do by the first one above all."""
    return [x.headline() for x in judgements]
