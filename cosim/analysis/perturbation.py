"""Small deviations of a coupled run: the same steps with and without a perturbation of one wire.

The wires are perturbed one after the other, by an offset that is small compared with the signal's
nominal value. A perturbation in either direction gives the linear
part of the deviation as a central difference; the rest is a measure of its error. Where all parts
can save their state, the system settles once and comes back to there; others are started again.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from ..engine.control import Adaptive
from ..engine.march import March
from ..engine.recorder import Recorder
from ..engine.settings import RunSettings
from ..engine.setup import Setup
from ..engine.snapshot import Snapshot
from ..engine.sources import InputSource
from ..engine.system_instance import SystemInstance
from ..errors import FmuError, SetupError

Array = NDArray[np.float64]

#: Relative size of a perturbation: derived from the rounding error eps / d and the truncation error d^2
#: of a central difference, which are equal at d = eps^(1/3).
RELATIVE_SIZE = sys.float_info.epsilon ** (1 / 3)
#: Most directions in which wires are perturbed at one time, so that the effort does not grow with the
#: number of wires: a convention.
MAX_DIRECTIONS = 8
#: Fewest perturbations, so that as many states can be told apart at one time: derived from the three
#: states of a drive, angle, speed and a lagging torque, and one more.
MIN_PERTURBATIONS = 4
#: Fewest rows that show anything: derived from two rows of each of 16 windows.
MIN_ROWS = 32


@dataclass(frozen=True)
class Deviations:
    """What the wired Real outputs do without and after perturbations, at steps of `step` [s].

    Attributes
    ----------
    motion : array (times, outputs)
        The unperturbed outputs.
    values : array (perturbations, times, outputs)
        Their deviations for perturbations of unit size, relative to each signal's own size.
    sizes : array (outputs,)
        What the deviations have been divided by, in the outputs' units.
    noise : float
        The relative error of the deviations, from rounding and from the part that is not linear.
    event_change : str
        The first change of a discrete output, or of the division of steps at events, that a
        perturbation has made, as a clause; empty if there is none.
    """

    step: float
    motion: Array
    values: Array
    sizes: Array
    noise: float
    event_change: str


@dataclass(frozen=True)
class _Rows:
    """The rows of one run, its discrete columns apart, and the last row of each step that was divided."""

    real: Array
    discrete: Array
    divided: list[int]


@dataclass(frozen=True)
class PerturbedRuns:
    """A system that is perturbed again and again after `settle` [s].

    Attributes
    ----------
    setup
        What is run, and how; stop and step of its settings do not matter.
    settle : float
        Time [s] from the start until the first perturbation.
    """

    setup: Setup
    settle: float

    @property
    def settings(self) -> RunSettings:
        """How it is run."""
        return self.setup.settings

    @property
    def step(self) -> float:
        """The communication step in question [s]."""
        assert not isinstance(self.settings.step, Adaptive)
        return self.settings.step

    def record(self, h: float, count: int, gap: int) -> Deviations:
        """Return the deviations over `count` steps of h [s].

        Parameters
        ----------
        h : float
            Communication step [s].
        count : int
            Number of steps after the last perturbation.
        gap : int
            Number of steps that a perturbation lasts; the next one follows at once.

        Raises
        ------
        SetupError
            If a part fails soon after a perturbation.
        FmuError
            If a part fails before.
        """
        with ExitStack() as stack:
            runner = _Runner(self, h, count, gap, stack)
            unperturbed = runner.run(0, 0, {})
            directions = list(_directions(runner.sizes(unperturbed)))
            perturbations = [
                (k * gap, {i: sign * RELATIVE_SIZE * x for i, x in offsets.items()})
                for k in range(runner.times)
                for offsets in directions
                for sign in (1.0, -1.0)
            ]
            runs = [runner.run(first, gap, offsets) for first, offsets in perturbations]
            changes = (
                runner.event_change(unperturbed, rows, offsets)
                for rows, (_, offsets) in zip(runs, perturbations)
            )
            event_change = next(filter(None, changes), "")
        lead = runner.times * gap + runner.memory
        return _deviations(h, lead, unperturbed, runs, event_change)


class _Runner:
    """Brings the parts to the time of the first perturbation and runs them from there."""

    def __init__(
        self, experiment: PerturbedRuns, h: float, count: int, gap: int, stack: ExitStack
    ) -> None:
        self.experiment, self.h = experiment, h
        network = experiment.setup.network
        ports = list({wire.source.name: wire.source for wire in network.wires}.values())
        self.real = [port for port in ports if port.type == "Real"]
        self.discrete = [p for p in ports if p.type not in ("Real", "String", "Binary")]
        wires = sum(wire.source.type == "Real" for wire in network.wires)
        self.times = math.ceil(MIN_PERTURBATIONS / wires)
        # Values that are handed on from part to part, and nodes of moving inputs, die out in so many steps.
        self.memory = len(experiment.setup.sequence) * (1 + experiment.settings.input_order) + 1
        self.count = self.times * gap + self.memory + count
        self.settled_steps = round(experiment.settle / h)
        self._saves = not experiment.setup.stateless
        settings = replace(
            experiment.settings,
            stop=experiment.settings.start + (self.settled_steps + self.count) * h,
            record=[port.name for port in (*self.real, *self.discrete)],
        )
        self._instance = SystemInstance(Setup(network, settings))
        stack.callback(self._instance.close)
        if self._saves:
            self._settle()
            self._snapshot = Snapshot(self._instance.stepped)
            self._snapshot.take()

    def run(self, first: int, count: int, offsets: Mapping[int, float]) -> _Rows:
        """Run with offsets on the links of these indices, from step `first` for `count` steps."""
        if self._saves:
            self._snapshot.restore()
        else:
            self._settle()
        return self._run(first, count, offsets)

    def sizes(self, unperturbed: _Rows) -> dict[int, float]:
        """The size of the signal of each Real link by its index: its nominal value, or its largest one."""
        peaks = np.abs(unperturbed.real).max(axis=0, initial=0.0)
        sizes = {}
        for port, peak in zip(self.real, peaks.tolist()):
            nominal = abs(float(port.variable.nominal or 0.0))
            sizes[port.name] = nominal or peak or 1.0
        return {
            i: abs(link.factor) * sizes[link.source.name]
            for i, link in enumerate(self._instance.links())
            if link.real and not isinstance(link.signal, InputSource) and link.source.name in sizes
        }

    def event_change(self, unperturbed: _Rows, rows: _Rows, offsets: Mapping[int, float]) -> str:
        """The first change of the sequence of events that a perturbation by offsets has made, as a clause."""
        count = min(len(unperturbed.discrete), len(rows.discrete))
        differences = np.argwhere(rows.discrete[:count] != unperturbed.discrete[:count])
        if len(differences):
            row, column = differences[0].tolist()
            before, after = unperturbed.discrete[row, column], rows.discrete[row, column]
            effect = f"{self.discrete[column].name} becomes {after:g} instead of {before:g}"
        elif len(rows.divided) != len(unperturbed.divided):
            pairs = zip_longest(rows.divided, unperturbed.divided, fillvalue=self.count)
            row = min(next(pair for pair in pairs if pair[0] != pair[1]))
            effect = "the step that ends there is divided another number of times"
        else:
            return ""
        t = self.experiment.settings.start + (self.settled_steps + row) * self.h
        links = self._instance.links()
        targets = sorted({links[i].target.name for i in offsets})
        perturbed = targets[0] if len(targets) == 1 else f"all of {', '.join(targets)}"
        return f"a perturbation of {perturbed} changes the sequence of events at t = {t:.6g} s: {effect}"

    def _settle(self) -> None:
        """Bring the parts to the time of the first perturbation."""
        self._instance.begin(self._instance.setup)
        if self.settled_steps:
            self._go(-self.settled_steps, 0)

    def _run(self, first: int, count: int, offsets: Mapping[int, float]) -> _Rows:
        pieces = [self._go(0, first)] if first else []
        complete = True
        if count:
            with _offset(self._instance, offsets):
                pieces.append(self._go(first, first + count))
            complete = len(pieces[-1].real) == count + 1
        if complete:
            pieces.append(self._go(first + count, self.count))
        real, discrete = (
            np.concatenate([rows if k == 0 else rows[1:] for k, rows in enumerate(parts)])
            for parts in zip(*((piece.real, piece.discrete) for piece in pieces))
        )
        return _Rows(real, discrete, [row for piece in pieces for row in piece.divided])

    def _go(self, first: int, last: int) -> _Rows:
        """Step from one communication point to another, or to where a part fails."""
        origin = self.experiment.settings.start + self.settled_steps * self.h
        settings = replace(
            self.experiment.settings,
            start=origin + first * self.h, stop=origin + last * self.h, step=self.h,
        )  # fmt: skip
        recorder = Recorder(self._instance.row.recorded)
        march = March(self._instance, settings, recorder)
        divided: list[int] = []
        with suppress(FmuError) if first >= 0 else ExitStack():
            for _ in march.steps():
                divided += [first + march.controller.accepted] * (
                    march.controller.discarded - len(divided)
                )
        rows = np.array(recorder.rows).reshape(recorder.count, -1)
        points = settings.start + self.h * np.round((rows[:, 0] - settings.start) / self.h)
        at_step = np.isclose(rows[:, 0], points, rtol=0.0, atol=1e-6 * self.h)
        rows = rows[at_step & (np.diff(rows[:, 0], prepend=-np.inf) > 0.0), 1:]  # none behind jumps
        split = len(self.real)
        return _Rows(rows[:, :split], rows[:, split:], divided)


@contextmanager
def _offset(instance: SystemInstance, offsets: Mapping[int, float]) -> Iterator[None]:
    """Add offsets to the links of these indices."""
    links = instance.links()
    saved = [link.offset for link in links]
    for i, offset in offsets.items():
        links[i].offset += offset
    instance.forget_loop()
    try:
        yield
    finally:
        for link, value in zip(links, saved):
            link.offset = value
        instance.forget_loop()


def _directions(sizes: Mapping[int, float]) -> Iterator[dict[int, float]]:
    """Offsets of unit size: one link after the other, or random mixtures of many."""
    if len(sizes) <= MAX_DIRECTIONS:
        yield from ({i: size} for i, size in sizes.items())
        return
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (MAX_DIRECTIONS, len(sizes)))
    yield from (dict(zip(sizes, row * np.array([*sizes.values()]))) for row in signs)


def _deviations(
    h: float, lead: int, unperturbed: _Rows, runs: Sequence[_Rows], event_change: str
) -> Deviations:
    """Make central differences of pairs of runs."""
    count = min(len(rows.real) for rows in (unperturbed, *runs))
    if count - lead < MIN_ROWS:
        raise SetupError(f"with steps of {h!r} s a part fails soon after the perturbation")
    motion = unperturbed.real[:count]
    up, down = (np.array([rows.real[lead:count] for rows in runs[k::2]]) for k in (0, 1))
    odd, even = (up - down) / 2, (up + down) / 2 - motion[lead:]
    size = np.abs(odd).max(axis=(0, 1))
    size[size == 0.0] = 1.0
    peak = np.abs(motion).max(axis=0, initial=0.0)
    rounding = float((sys.float_info.epsilon * peak / size).max(initial=0.0))
    curvature = float((np.abs(even) / size).max(initial=0.0))
    values = odd / size
    return Deviations(h, motion[lead:], values, size, rounding + curvature**2, event_change)
