"""Why a column differs, from the table alone: a unit, crossed columns, a delay, an offset, a missed event.

A cause is a way to make the wrong column from the right one. It is named only if what it makes is at least
ten times closer to the column than the reference solution is. These causes need no run of the system.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...errors import pluralize
from ...rounding import unit_suffix
from ...system import Network
from .conversions import units_of, wrong_factors
from .signals import SignalJudgement
from .solution import Array

#: By how much reproducing a cause must reduce a difference: a convention of the referee. Where two things have to be
#: right, such as a number of a list and a cause at all, its square.
LEAST_REDUCTION = 10.0
#: A reduction from which on no other cause is sought, and that of a cause with a number that is fitted: what is left
#: is a thousandth of the difference.
DECISIVE_REDUCTION = 1e3
#: Largest reduction that is stated: a difference between results in double precision shows no more.
MOST_REDUCTION = 1e9
#: Longest delay that is sought, as a share of a run: a convention; a longer one is another experiment.
LONGEST_DELAY = 0.1
#: Delays tried before the best is refined: twice the rows within LONGEST_DELAY, at most this many.
MOST_DELAYS = 400
#: Events of a discrete column that are left out one by one: a convention, to limit the time.
MOST_CHANGES = 100
#: Most events over rows of a column whose events are looked at one by one.
MOST_EVENTS = 0.1


@dataclass(frozen=True)
class Cause:
    """What makes a difference, and how well it does.

    Attributes
    ----------
    kind : str
        One of "no number", "unit", "sign", "scale", "columns crossed", "delay", "offset", "missed event", "time unit",
        "held inputs", "step too long", "lost start value", "lost wire", "wires crossed", "lost factor",
        "lost input", "wrong start value", "late input", "integration in the FMUs".
    text : str
        The cause as a clause.
    reduction : float
        How many times smaller the difference is once the cause is reproduced (root mean square).
    signals : tuple of str
        The variables that it explains; none for a cause that concerns the times of all rows.
    is_certain : bool
        Whether it is told from what imitates it.
    """

    kind: str
    text: str
    reduction: float
    signals: tuple[str, ...]
    is_certain: bool = True


def root_mean_square(values: Array) -> float:
    """The root mean square, infinite where a value is none or its square overflows."""
    if not np.isfinite(values).all():
        return math.inf
    with np.errstate(over="ignore"):
        return math.sqrt(float(np.mean(np.square(values))))


def ratio(before: float, after: float) -> float:
    """How many times smaller a distance has become, at most MOST_REDUCTION; 0 where one is infinite."""
    if not math.isfinite(before) or not math.isfinite(after):
        return 0.0
    return min(MOST_REDUCTION, before / after) if after > 0.0 else MOST_REDUCTION


def table_causes(
    signal: SignalJudgement, network: Network, references: Mapping[str, Array]
) -> Iterator[Cause]:
    """The causes that explain a column that differs from the table alone; `references` are all variables at the same rows."""
    missing = np.flatnonzero(~np.isfinite(signal.values))
    if missing.size:
        text = (
            f"{signal.column} has no finite number in {pluralize(missing.size, 'row')}, "
            f"the first at {signal.t[missing[0]]:.6g} s"
        )
        yield Cause("no number", text, MOST_REDUCTION, (signal.name,))
        return
    before = root_mean_square(signal.values - signal.reference)
    is_found = False
    for kind, text, reproduced, least, is_fitted in _candidates(signal, network, references):
        distance = root_mean_square(signal.values - reproduced)
        # A column of zeros is close to everything that is small: it must be close as measured by itself.
        is_close = LEAST_REDUCTION * distance < root_mean_square(reproduced)
        better = ratio(before, distance)
        # a number that is fitted, the last, fits at least as well as a listed one
        if better >= least and is_close and not (is_found and is_fitted):
            is_found = True
            yield Cause(kind, f"{signal.column} {text}", better, (signal.name,))


class Candidate(NamedTuple):
    """A way to make a column: its kind, the rest of a clause, the column, and the least reduction for which it counts."""

    kind: str
    text: str
    column: Array
    least_reduction: float
    is_fitted: bool = False


def _candidates(
    signal: SignalJudgement, network: Network, references: Mapping[str, Array]
) -> Iterator[Candidate]:
    """Ways to make a column."""
    port, x, rest = network.port(signal.name), signal.reference, signal.values - signal.reference
    if port.type == "Real":
        yield Candidate("sign", "has the opposite sign", -x, LEAST_REDUCTION)
        for unit, factor, offset in units_of(port, network):
            text = f"is in {unit}, not in {port.unit or '1'}"
            yield Candidate("unit", text, factor * x + offset, LEAST_REDUCTION)
        if signal.varies:
            for what, factor in wrong_factors(port.unit):
                text = f"is {factor:.6g} times the reference: {what}?"
                yield Candidate("scale", text, factor * x, LEAST_REDUCTION**2)
    for name, other in references.items():
        # as far as the column is that variable and not merely small like it
        distance = root_mean_square(signal.values - other)
        if name != signal.name and distance * LEAST_REDUCTION <= float(np.std(other)):
            yield Candidate("columns crossed", f"holds {name}", other, LEAST_REDUCTION)
    yield _delay(signal)
    offset = float(np.mean(rest))
    if abs(offset) > LEAST_REDUCTION * np.finfo(float).eps * signal.scale:
        number = f"{offset:+.6g}{unit_suffix(signal.unit)}"
        text = f"is {number} off from the first row on: its start value or zero"
        yield Candidate("offset", text, x + offset, LEAST_REDUCTION)
    if port.kind.is_held:
        yield from _with_one_event_missed(signal)
    if port.type == "Real" and signal.varies:
        fit = float(signal.values @ x) / float(x @ x)
        text = f"is {fit:.6g} times the reference"
        yield Candidate("scale", text, fit * x, DECISIVE_REDUCTION, is_fitted=True)


def _delay(signal: SignalJudgement) -> Candidate:
    """The reference some time later or earlier."""
    from scipy.optimize import minimize_scalar

    t, x = signal.t, signal.reference
    spacing = float(np.median(np.diff(t)))
    longest = LONGEST_DELAY * (t[-1] - t[0])

    def distance(delay: float) -> float:
        return root_mean_square(signal.values - np.interp(t - delay, t, x))

    count = min(MOST_DELAYS, 4 * math.ceil(longest / spacing) + 1)
    delays = np.linspace(-longest, longest, count)
    best = float(delays[int(np.argmin([distance(delay) for delay in delays]))])
    pitch = float(delays[1] - delays[0])
    refined = minimize_scalar(distance, bounds=(best - pitch, best + pitch), method="bounded")
    rows = round(refined.x / spacing)
    delay = rows * spacing
    if not rows or distance(delay) > LEAST_REDUCTION * distance(float(refined.x)):
        delay = float(refined.x)
    direction = "late" if delay > 0.0 else "early"
    text = f"is {abs(delay):.4g} s ({abs(delay) / spacing:.3g} rows) too {direction}"
    return Candidate("delay", text, np.interp(t - delay, t, x), LEAST_REDUCTION)


def _with_one_event_missed(signal: SignalJudgement) -> Iterator[Candidate]:
    """A column that holds its values, with one of its changes left out."""
    x = signal.reference
    changes = np.flatnonzero(np.diff(x))[:MOST_CHANGES]
    if len(changes) > MOST_EVENTS * len(x):
        return
    for k, end in zip(changes, [*(changes[1:] + 1), len(x)]):
        reproduced = x.copy()
        reproduced[k + 1 : end] = x[k]
        text = f"misses the event at {signal.t[k + 1]:.6g} s"
        yield Candidate("missed event", text, reproduced, LEAST_REDUCTION)
