"""Why a column differs, from the table alone: a unit, crossed columns, a delay, an offset, a missed event.

A cause is a way to make the wrong column from the right one. It is named only if what it makes is at least
ten times closer to the column than the reference solution is. These causes need no run of the system.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import pluralize
from ...system import Network, Port
from ...units import multiples
from .signals import SignalJudgement, column_scale
from .table import Array

#: By how much reproducing a cause must reduce a difference: a convention of the referee.
LEAST_REDUCTION = 10.0
#: Largest reduction that is stated: a difference between results in double precision shows no more.
MOST_REDUCTION = 1e9
#: Longest delay that is sought, as a share of a run: a convention; a longer one is another experiment.
LONGEST_DELAY = 0.1
#: Delays tried before the best is refined: twice the rows within LONGEST_DELAY, at most this many.
MOST_DELAYS = 400
#: Kelvin at 0 degrees Celsius: the definition of the degree Celsius.
CELSIUS_ZERO = 273.15
#: Events of a discrete column that are left out one by one: a convention, to limit the time.
MOST_CHANGES = 100


@dataclass(frozen=True)
class Cause:
    """What makes a difference, and how well it does.

    Attributes
    ----------
    kind : str
        One of "no number", "unit", "sign", "columns crossed", "delay", "offset", "missed event", "time unit", "held inputs",
        "step too long", "lost start value", "lost wire", "wires crossed", "lost factor", "lost input",
        "wrong start value", "late input", "integration in the FMUs".
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


def reduction(signal: SignalJudgement, reproduced: Array) -> float:
    """How many times closer a reproduced column is to the one of the table than the reference is."""
    before = root_mean_square(signal.values - signal.reference)
    after = root_mean_square(signal.values - reproduced)
    return ratio(before, after)


def ratio(before: float, after: float) -> float:
    """How many times smaller a distance has become, at most MOST_REDUCTION; 0 where one is infinite."""
    if not math.isfinite(before) or not math.isfinite(after):
        return 0.0
    return min(MOST_REDUCTION, before / after) if after > 0.0 else MOST_REDUCTION


def table_causes(
    signal: SignalJudgement,
    network: Network,
    references: Sequence[tuple[Port, Array]],
) -> Iterator[Cause]:
    """The causes that explain a column from the table alone.

    Parameters
    ----------
    signal : SignalJudgement
        A column that differs.
    network : Network
        The system; its FMUs define units.
    references : sequence of (Port, array)
        Every variable of the reference solution at the same rows.
    """
    finders: tuple[Callable[[], Iterator[tuple[str, str, Array]]], ...] = (
        lambda: _units(signal, network),
        lambda: _crossed(signal, references),
        lambda: _delays(signal),
        lambda: _offsets(signal),
        lambda: _missed_events(signal, network),
    )
    for find in finders:
        for kind, text, reproduced in find():
            better = reduction(signal, reproduced)
            # A column of zeros is close to everything that is small: it must be close as measured by itself.
            distance = root_mean_square(signal.values - reproduced)
            is_close = LEAST_REDUCTION * distance <= root_mean_square(reproduced)
            if better >= LEAST_REDUCTION and is_close:
                yield Cause(kind, text, better, (signal.name,))


def not_finite(signal: SignalJudgement) -> Cause | None:
    """The cause of a column that has rows without a finite number; None if it has none."""
    rows = np.flatnonzero(~np.isfinite(signal.values))
    if not rows.size:
        return None
    text = (
        f"{signal.column} has no finite number in {pluralize(rows.size, 'row')}, "
        f"the first at {signal.t[rows[0]]:.6g} s"
    )
    return Cause("no number", text, MOST_REDUCTION, (signal.name,))


def _units(signal: SignalJudgement, network: Network) -> Iterator[tuple[str, str, Array]]:
    """The reference in other units, and with the other sign."""
    port = network.port(signal.name)
    if port.type != "Real":
        return
    x = signal.reference
    yield "sign", f"{signal.column} has the opposite sign", -x
    for unit, factor in sorted(_ratios(port, network).items()):
        if factor != 1.0:
            yield "unit", f"{signal.column} is in {unit}, not in {port.unit or '1'}", factor * x
    if port.unit == "K":
        yield "unit", f"{signal.column} is in degC, not in K", x - CELSIUS_ZERO


def _ratios(port: Port, network: Network) -> dict[str, float]:
    """By unit, the number that stands for 1 of the variable's own unit."""
    ratios = {unit: 1.0 / scale for unit, scale in multiples(port.unit).items()}
    definitions = network.fmus[port.part].description.unitDefinitions
    for display in (d for unit in definitions if unit.name == port.unit for d in unit.displayUnits):
        if not display.offset and not display.inverse:
            ratios[display.name] = float(display.factor)
    return ratios


def _crossed(
    signal: SignalJudgement, references: Sequence[tuple[Port, Array]]
) -> Iterator[tuple[str, str, Array]]:
    """Other variables in place of this one, as far as the column is them and not merely small like them."""
    for port, x in references:
        if port.name == signal.name:
            continue
        distance = root_mean_square(signal.values - x)
        if distance * LEAST_REDUCTION <= root_mean_square(x - x.mean()):
            yield "columns crossed", f"{signal.column} holds {port.name}", x


def _delays(signal: SignalJudgement) -> Iterator[tuple[str, str, Array]]:
    """The reference some time later or earlier."""
    from scipy.optimize import minimize_scalar

    t, x = signal.t, signal.reference
    spacing = float(np.median(np.diff(t)))
    longest = LONGEST_DELAY * (t[-1] - t[0])

    def shift(delay: float) -> Array:
        return np.interp(t - delay, t, x)

    def distance(delay: float) -> float:
        return root_mean_square(signal.values - shift(delay))

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
    text = (
        f"{signal.column} is {abs(delay):.4g} s ({abs(delay) / spacing:.3g} rows) too {direction}"
    )
    yield "delay", text, shift(delay)


def _offsets(signal: SignalJudgement) -> Iterator[tuple[str, str, Array]]:
    """The reference plus a constant that is there from the first row on."""
    if not np.isfinite(signal.values).all():
        return
    offset = float(np.mean(signal.values - signal.reference))
    if abs(offset) > LEAST_REDUCTION * np.finfo(float).eps * column_scale(signal.reference):
        text = f"{signal.column} is {offset:+.6g} {signal.unit} off from the first row on: its start value or zero"
        yield "offset", text.replace("  ", " "), signal.reference + offset


def _missed_events(signal: SignalJudgement, network: Network) -> Iterator[tuple[str, str, Array]]:
    """A column that holds its values, with one of its changes left out."""
    if not network.port(signal.name).column.kind.is_held:
        return
    changes = np.flatnonzero(np.diff(signal.reference))[:MOST_CHANGES]
    if len(changes) * 10 > len(signal.reference):
        return
    for n, k in enumerate(changes):
        reproduced = signal.reference.copy()
        end = changes[n + 1] + 1 if n + 1 < len(changes) else len(reproduced)
        reproduced[k + 1 : end] = signal.reference[k]
        text = f"{signal.column} misses the event at {signal.t[k + 1]:.6g} s"
        yield "missed event", text, reproduced
