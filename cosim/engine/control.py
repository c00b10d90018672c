"""How a run steps: the tolerance of adaptive steps, and steps of which all are known before."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SetupError
from ..fmu.times import coincide

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
