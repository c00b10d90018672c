"""Communication steps chosen during the run, so that the coupling error stays within a tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FmuError, NonFiniteValueError, SetupError, StepDiscarded
from ..fmu.times import coincide, is_reached
from .part import Part
from .schedule import Advance
from .snapshot import Snapshot, StepMemory

#: Share of the size that the error allows. A convention: Hairer, Norsett and Wanner, Solving Ordinary
#: Differential Equations I, section II.4, use 0.8 to 0.9.
SAFETY = 0.9
#: The first step over the run. A convention: short enough that a wrong guess costs a few rejected steps.
FIRST = 1e-4
#: The least factor from one step to the next. A convention: the same section uses 0.2 to 0.5.
SHRINK = 0.2
#: The largest factor from one step to the next. A convention: the same section uses 1.5 to 5.
GROW = 3.0
#: Share of the permitted error up to which a step counts. Derived: errors of a run add up, and steps that
#: use a little more are made up for by SAFETY, which lets the others use less.
ACCEPT = 1.2
#: The shortest step over the run, below which the tolerance cannot be met. A convention: a run of 1e9 steps
#: does not end.
LEAST = 1e-9
#: Exponent of the error of this step, over the order. A convention: PI control after Gustafsson, ACM Trans.
#: Math. Softw. 17 (1991), whose pair is 0.7 and 0.4.
THIS_ERROR = 0.7
#: Exponent of the error of the step before, over the order: a convention of this project, less than the 0.4
#: of Gustafsson.
PREVIOUS_ERROR = 0.3
#: Least share of the permitted error that counts as used, for a power of it. Derived: an error is the difference of
#: two doubles near a signal's largest value, whose last place is 2^-53 of it. Over a tolerance of 1e-4 that is
#: 1.1e-12; what is less is an error of 0. GROW limits the next step already from a share of
#: (SAFETY / GROW)^(order / THIS_ERROR), which is 0.18 for order 1 and 0.03 for order 2. Measured by Strang on
#: motor and conveyor at rest, whose supply is switched on and off: 1e-4 and 3e-2 in its place change 340 and 1033
#: steps by 2 each.
LEAST_USED = 1e-12
#: Share of what is left to the next time that a step may fall short of and still end there. Derived: the time after
#: n steps of h is a sum whose n roundings are 2^-53 n h each at most, n^2 2^-53 h together. This share covers them
#: for 3000 equal steps from one time to the next; after more of them the last step may be taken in two halves.
END_ROUNDING = 1e-9
#: Steps of a mesh that its coarsest run takes as one: derived, three runs whose steps differ by two.
COARSEST = 4


@dataclass(frozen=True)
class Adaptive:
    """Step size control: the coupling error that a whole run may add to each coupled signal.

    `tolerance` is relative to the larger of a signal's largest value so far and its nominal value.
    `absolute` gives individual signals, by name, an error in their own unit instead. `first` and
    `longest` are the first and the longest step [s]. Control "doubling" takes each step once whole
    and once in two halves, and repeats it if the results differ too much. Control "energy" never
    repeats a step; it follows the energy that the last step created in a power bond. The default,
    None, means doubling where all FMUs can restore their state, else energy.
    """

    tolerance: float
    absolute: Mapping[str, float] = field(default_factory=dict)
    first: float | None = None
    longest: float = math.inf
    control: str | None = None

    def check(self) -> None:
        """Refuse a setting out of range.

        Raises
        ------
        SetupError
            For a tolerance or a step that is not above 0, and for an unknown control.
        """
        limits = {"tolerance": self.tolerance, "longest": self.longest}
        limits |= {f"absolute tolerance of {name}": a for name, a in self.absolute.items()}
        limits |= {} if self.first is None else {"first": self.first}
        for name, value in limits.items():
            if not value > 0.0:
                raise SetupError(f"{name} = {value!r} must be above 0")
        if self.control not in (None, "doubling", "energy"):
            raise SetupError(f"control {self.control!r} must be doubling or energy")

    def __str__(self) -> str:
        return f"adaptive steps, tolerance {self.tolerance:g}"


class EqualSteps(NamedTuple):
    """So many steps of one size [s] from a time on [s], of which the last ends at the stop [s], if they have one."""

    begin: float
    size: float
    number: int
    stop: float | None = None

    def at(self, n: int) -> tuple[float, float]:
        """When step number n begins, and its size [s]."""
        t = self.begin + n * self.size
        if n + 1 < self.number or self.stop is None or t + self.size == self.stop:
            return t, self.size
        return t, self.stop - t


@dataclass(frozen=True)
class Mesh(Adaptive):
    """Steps that are known before a run; it meets the start, the stop and each known jump and change between them.

    Behind each of these the steps grow from `first` to `longest` [s] by `growth`, or go along given times.

    Attributes
    ----------
    tolerance
        That of the FMUs; nothing is controlled.
    every
        The runs of one mesh with 1, 2 and 4 take all its ends, every second and every fourth one; that with 1/2 halves its steps.
    growth
        The ratio of two steps up to the longest; where this is more than one step in three of the run, its square.
    along
        Times [s] along which it goes, if there are any, `ratio` of their distances a step.
    """

    tolerance: float | None = None  # type: ignore[assignment]
    control: str | None = "mesh"
    every: float = 1.0
    growth: float = 1.0
    along: tuple[float, ...] = field(default=(), repr=False)
    ratio: float = 1.0

    def check(self) -> None:
        """Nothing that a user has written."""

    def __str__(self) -> str:
        if self.along:
            return f"steps along {len(self.along)} times, a ratio of {self.ratio:g}"
        return f"steps from {self.every * (self.first or self.longest):.3g} to {self.every * self.longest:.6g} s"

    def stretches(self, times: Sequence[float]) -> list[EqualSteps]:
        """The steps through times that must be met [s], the start first, the stop last; equal ones as one."""
        found = []
        for begin, end in pairwise(times):
            if coincide(begin, end):
                continue
            t = begin
            sizes = self._along(begin, end) if self.along else self._growing(end - begin, times)
            for size, same in groupby(sizes.tolist()):
                found.append(EqualSteps(t, size, len(list(same))))
                t += size * found[-1].number
        return found

    def _growing(self, length: float, times: Sequence[float]) -> NDArray[np.float64]:
        """The sizes of steps that grow, and fill a length [s]: a multiple of COARSEST of them, before `every` is taken."""
        growth, h = self.growth, self.longest
        first = h if self.first is None else self.first
        grades = math.log(h / first) / math.log(growth) if growth > 1.0 else 0.0
        if 3.0 * grades * (len(times) - 1) * h > times[-1] - times[0]:
            growth, grades = growth**2, grades / 2.0
        sizes = first * growth ** np.arange(math.ceil(grades))
        number = int(np.searchsorted(np.cumsum(sizes), length * (1.0 - END_ROUNDING)))
        if number == len(sizes):
            number += max(0, math.ceil((length - sizes.sum()) / h - END_ROUNDING))
        else:
            number += 1
        number = -(-number // COARSEST) * COARSEST
        sizes = np.append(sizes[:number], np.full(max(0, number - len(sizes)), h))
        sizes *= length / sizes.sum()
        if self.every < 1.0:
            return np.repeat(sizes * self.every, round(1.0 / self.every))
        return np.asarray(sizes.reshape(-1, round(self.every)).sum(axis=1))

    def _along(self, begin: float, end: float) -> NDArray[np.float64]:
        """The sizes of steps along given times from one time to another [s]."""
        inner = [
            t
            for t in self.along
            if begin < t < end and not coincide(t, begin) and not coincide(t, end)
        ]
        times = [begin, *inner, end]
        number = max(1, math.ceil((len(times) - 1) / self.ratio - END_ROUNDING))
        ends = np.interp(self.ratio * np.arange(number + 1), np.arange(len(times)), times)
        ends[-1] = end
        return np.diff(ends)


class ErrorScale:
    """The largest size of each wired Real output so far, at least its nominal value."""

    def __init__(self, parts: Sequence[Part], control: Controller) -> None:
        settings = control.settings
        self.blocks = [block for part in parts for block in part.outputs if block.real]
        self.names = [name for block in self.blocks for name in block.names]
        self.tolerance = settings.tolerance
        self.absolute = [settings.absolute.get(name) for name in self.names]
        self._control = control
        if not control.largest:
            control.largest = [size for block in self.blocks for size in block.nominals()]
        self.instant = [name in control.instant for name in self.names]

    def values(self) -> list[float]:
        """The present outputs."""
        return [cell for block in self.blocks for cell in block.cells]

    def accept(self) -> None:
        """Include the present outputs in the largest values."""
        pairs = zip(self._control.largest, self.values())
        self._control.largest = [max(a, abs(b)) for a, b in pairs]

    def share(self, errors: Sequence[float], steps: float) -> float:
        """The worst error over what is allowed, if as many steps like this one make the run.

        The errors of a run add up, except those of an output with direct feedthrough: it shows
        the error of its own instant, which the next step does not inherit.
        """
        allowed = (
            self.tolerance * size if absolute is None else absolute
            for size, absolute in zip(self._control.largest, self.absolute)
        )
        times = (1.0 if instant else steps for instant in self.instant)
        return max((abs(e) / a * n for e, a, n in zip(errors, allowed, times)), default=0.0)


class Controller:
    """The steps between times [s], each of which is met; a PI controller chooses their sizes [s].

    The next size follows from how much of the tolerance this step and the last one used. `next_event` gives the time
    of the next event that parts tell [s], which is met too. `instant` are
    the wired outputs with direct feedthrough; `largest` the largest values so far, of what the `control`,
    "doubling" or "energy", compares.
    """

    def __init__(
        self,
        control: str,
        order: int,
        settings: Adaptive,
        times: Sequence[float],
        instant: Collection[str],
        *,
        next_event: Callable[[], float],
    ) -> None:
        self.next_event = next_event
        self.order, self.settings, self.times, self.rejected = order, settings, times, 0
        self.control, self.instant = control, instant
        self.t, self.span = times[0], times[-1] - times[0]
        first = FIRST * self.span if settings.first is None else settings.first
        self.h = min(first, settings.longest)
        self.before = 1.0
        self.largest: list[float] = []

    def resume(self, t: float, memory: StepMemory | None) -> None:
        """Go on from a time [s], with what steps have taught so far if the same control has made them."""
        self.t = t
        if memory is not None and memory.control == self.control:
            _, self.h, self.before, self.largest = memory
            self.h = min(self.h, self.settings.longest)

    def memory(self) -> StepMemory:
        """What another run goes on with."""
        return StepMemory(self.control, self.h, self.before, self.largest)

    def steps(self) -> Iterator[tuple[float, float]]:
        """The time and the size of each step, the same time again until it is accepted.

        A step ends at the next of the times or events, or half-way there where it would leave a crumb.
        """
        stop, ends = self.times[-1], iter(self.times)
        end = self.t
        while self.t < stop:
            if end <= self.t or coincide(end, self.t):
                later = (time for time in ends if time > self.t and not coincide(time, self.t))
                end = next(later, stop)
            event = self.next_event()
            goal = end if is_reached(event, self.t) or is_reached(end, event) else event
            rest = goal - self.t
            is_last = self.h >= rest * (1 - END_ROUNDING)
            self.h = rest if is_last else min(self.h, rest / 2)
            self.end = goal if coincide(self.t + self.h, goal) else self.t + self.h
            yield self.t, self.h

    def accept(self, share: float) -> None:
        """Go on from the end of a step that used this share of what it may."""
        used = max(share, LEAST_USED)
        factor = SAFETY * used ** (-THIS_ERROR / self.order)
        factor *= self.before ** (PREVIOUS_ERROR / self.order)
        self.before = used
        self.t = self.end
        self.h = min(self.settings.longest, self.h * float(min(GROW, max(SHRINK, factor))))

    def shrink(self, share: float) -> None:
        """Take a smaller step in place of one that used this share of what it may."""
        self.h *= float(max(SHRINK, SAFETY * share ** (-1.0 / self.order)))


def step_ends_by_doubling(
    parts: Sequence[Part], advance: Advance, control: Controller
) -> Iterator[float]:
    """The times [s] at which accepted steps end, among them all of the controller's `times`.

    The whole step's end serves the halves as a prediction where inputs move within a step.
    """
    scale, snapshot = ErrorScale(parts, control), Snapshot(parts)
    for t, h in control.steps():
        snapshot.take()
        reason = ""
        try:
            advance(t, h)
            full = scale.values()
            snapshot.restore(keeps_nodes=True)
            advance(t, h / 2)
            advance(t + h / 2, h / 2)
        except (StepDiscarded, NonFiniteValueError) as failure:
            reached = failure.reached if isinstance(failure, StepDiscarded) else t
            control.h = min(h / 2, max(0.0, reached - t)) or h / 2
            reason = f"{failure}; "
        else:
            errors = [a - b for a, b in zip(scale.values(), full)]
            used = scale.share(errors, control.span / h)
            if used <= ACCEPT:
                scale.accept()
                control.accept(used)
                yield control.t
                continue
            control.shrink(used)
        control.rejected += 1
        if control.h < LEAST * control.span:
            raise FmuError(f"{reason}the tolerance requires steps below {control.h:.2g} s")
        snapshot.restore()


def step_ends_by_energy(
    parts: Sequence[Part], advance: Advance, control: Controller
) -> Iterator[float]:
    """The times at which steps end, all of the controller's among them.

    The size of the next step follows from the energy that each bond made in the last.
    After the energy-conservation-based co-simulation of Sadjina et al. (2017), with the power that
    a bond may create held to the tolerance times the largest power so far.
    """
    booked = [end for part in parts for end in part.bond_sides]
    bonds = dict.fromkeys(end.bond for end in booked)
    sides = [[end for end in booked if end.bond == bond] for bond in bonds]
    for t, h in control.steps():
        before = [[end.energy for end in pair] for pair in sides]
        advance(t, h)
        energies = [[end.energy - e for end, e in zip(p, b)] for p, b in zip(sides, before)]
        largest = max([*control.largest, *(abs(e) / h for pair in energies for e in pair)])
        control.largest = [largest]
        created = max(abs(first - second) for first, second in energies) / h
        allowed = control.settings.tolerance * largest
        control.accept(created / allowed if largest else 0.0)
        yield control.t
