"""Steady turns as a method: the figures of machines that turn, from runs that repeat, with steps of h, 2 h and 4 h.

Arrays have the step size as their first axis: row 0 is that of the communication step h, rows 1 and 2 those of 2 h and
4 h, which give the errors.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import CONVERGENCE_ORDERS, SetupError, System
from cosim.accuracy.limit import Limit, Reason, limit
from cosim.system import connect

from .answer import Findings, parameters
from .branches import Branch, first_of_same, follow_branches
from .context import Context
from .figure import Figure, scaled
from .formula import Formula
from .live import Reader
from .method import as_declared, follows
from .options import declared
from .steady import ORBIT_ANGLES, TURN, LastTwoTurns, steady_turns

Array = NDArray[np.float64]
#: Communication steps of a run over the shortest one. Three runs give value, error and observed order.
STEP_MULTIPLES = (1, 2, 4)
#: Sectors of a revolution, of each of which the largest rod forces are kept; a convention, finer than the peaks
#: of the orders 1 to 7 are apart.
SECTORS = 16
#: Even angles between which the largest force of a sector is interpolated by a parabola; sixteen for each of ORBIT_ANGLES.
FINE_ANGLES = 16 * ORBIT_ANGLES
#: Orbits that are run side by side before they are kept. Chosen: half a second of work.
AT_ONCE = 256
#: Convergence order of the rod force, which follows the torque of half a step before at once.
FORCE_ORDER = 1.0
COARSE_UNSTABLE = "the run with four times the step is unstable, so that no error can be estimated"
NO_COUPLING_ERROR = "the coupling error is not known; take more steps per revolution"
#: Relative error of the mean over a turn, which settling leaves of its period.
MEAN_ERROR = 2e-9


def at_zero_step(values: Array, order: float, noise: Array | float = 0.0) -> Limit:
    """Return where values of shape (k, ...) go, whose rows are those of the first k of STEP_MULTIPLES."""
    missing = ((0, len(STEP_MULTIPLES) - len(values)), *((0, 0),) * (values.ndim - 1))
    runs = np.pad(values, missing, constant_values=np.nan)
    noises = np.pad(np.broadcast_to(noise, values.shape), missing, constant_values=np.nan)
    return limit(runs, order, noise=noises)


def extrapolated(values: Any, order: float, noise: Array | float = 0.0) -> tuple[Any, Array]:
    """Return where values go, real or complex, and the errors of that, nan where they are not known."""
    found = at_zero_step(values, order, noise)
    return found.extrapolated, np.where(found.is_stated, found.extrapolated_error, np.nan)


def sector_peaks(waveform: Array) -> Array:
    """Return the largest value of every sector of a turn, then the largest of the other sense.

    Which of two nearly equal peaks is the larger may change with the step; each by itself converges. Between FINE_ANGLES
    points of the Fourier series a parabola is laid; its error is that of the fourth derivative, over FINE_ANGLES^4.

    Parameters
    ----------
    waveform : ndarray, shape (..., angles)
        Values at even angles.

    Returns
    -------
    ndarray, shape (..., 2 * SECTORS)
    """
    fine = np.fft.irfft(np.fft.rfft(waveform), FINE_ANGLES) * (FINE_ANGLES / waveform.shape[-1])
    before, after = np.roll(fine, 1, -1), np.roll(fine, -1, -1)
    bend, rise = before - 2.0 * fine + after, after - before
    is_turn = np.abs(rise) < np.abs(2.0 * bend)
    lift = np.where(is_turn, -(rise**2) / (8.0 * np.where(is_turn, bend, 1.0)), 0.0)
    both = []
    for sense in (1.0, -1.0):
        top = np.where(sense * bend < 0.0, sense * (fine + lift), sense * fine)
        sectors = top.reshape(*waveform.shape[:-1], SECTORS, -1)
        both.append(np.maximum(sectors.max(-1), np.roll(sectors[..., 0], -1, -1)))
    return np.concatenate(both, -1)


@dataclass(frozen=True)
class Peaks:
    """Rod forces of all sectors at a step of zero, up to where each may reach [N], and whether that is known."""

    value: Array
    reach: Array
    is_known: NDArray[np.bool_]

    def each(self, function: Callable[[Any], Any]) -> Peaks:
        """Return a function of each array."""
        return Peaks(*map(function, vars(self).values()))

    def largest(self) -> tuple[Array, Array]:
        """Return the largest force, over the last axis, and its error.

        The error reaches as far as that of any other peak does; it is nan where one is not known that may
        be the largest.
        """
        best = self.value.max(-1)
        error = self.reach.max(-1) - best
        doubtful = (~self.is_known & ~(self.reach < best[..., None])).any(-1)
        return best, np.where(doubtful, np.nan, error)


def force_peaks(waveform: Array) -> Peaks:
    """Return the peaks of waveforms, shape (k, ..., ORBIT_ANGLES), of the first k of STEP_MULTIPLES."""
    peaks = sector_peaks(waveform)
    rows = np.abs(sector_peaks(waveform[..., ::2]) - peaks) / 4.0
    of_all = at_zero_step(peaks, FORCE_ORDER)
    reach = of_all.extrapolated + of_all.extrapolated_error + 2.0 * rows[0]
    reach = np.where(np.isfinite(reach), reach, np.inf)
    return Peaks(of_all.extrapolated, reach, of_all.is_stated)


def figure_of(found: Limit, k: Any, unit: str, meaning: str, why: str = "") -> Figure:
    """Return the limit of element k as a figure; `why` says why there is no value."""
    one = Limit(*(np.asarray(x)[k] for x in vars(found).values()))
    if why or not one.is_stated:
        lost = COARSE_UNSTABLE if one.reason == Reason.MISSING else one.sentence()
        return Figure.undetermined(unit, why or lost, meaning)
    return Figure(float(one.extrapolated), unit, float(one.extrapolated_error), meaning)


def orbit_figure(value: float, error: float, unit: str, meaning: str, why: str) -> Figure:
    """Return a figure of an orbit, refused where the error is not known; `why` says why there is no orbit."""
    if math.isnan(error):
        reason = why if math.isnan(value) else NO_COUPLING_ERROR
        return Figure.undetermined(unit, reason, meaning)
    return Figure(float(value), unit, float(error), meaning)


class SteadyMotion(NamedTuple):
    """A steady motion that a question has found: its figures; with the shortest step, its last turn at even angles by
    column, the states where a turn begins, and the share of a deviation that a turn leaves.
    """

    figures: Mapping[str, Figure]
    turn: Mapping[str, Array]
    states: Array
    multiplier: float


@dataclass(frozen=True)
class Orbit:
    """The steady turns of an angle, whose errors are those of three step sizes.

    A question of this method has options `steps_per_rev` and `algorithm`; its `system` has start values near the orbit. Its
    `numbers` are read from the last turn, see `Reader`. Where it has a method `starts` that returns several states, all
    motions to which they lead are found, and all that lie beside those of other questions that differ in the speed alone. The figures are those of the
    motion whose number `worst` is largest; `data` of the findings has all, that first.

    Attributes
    ----------
    angle, rate : str
        Outputs: the angle, 0 at the start, and its rate [rad/s].
    states : sequence of str
        The states of a return map.
    speed : str
        The option that is about the mean rate [rad/s].
    worst : str
        A number.
    """

    angle: str
    rate: str
    states: Sequence[str]
    speed: str = "speed"
    worst: str = ""

    @property
    def options(self) -> tuple[str, ...]:
        """The options that a question must have."""
        return self.speed, "steps_per_rev", "algorithm"

    def turns(
        self,
        context: Context,
        system: System,
        cases: Mapping[str, Array],
        speed: Array,
        **settings: Any,
    ) -> LastTwoTurns:
        """Return the last turns of many members, AT_ONCE at a time, which are kept; all else as of `steady_turns`."""

        def block(some: NDArray[Any]) -> tuple[Any, ...]:
            own = {"steps_per_rev": settings["steps_per_rev"][some]}
            turns = steady_turns(
                system, {name: x[some] for name, x in cases.items()}, self.states, self.angle, speed[some],
                **{**settings, **own}, jobs=context.jobs,
            )  # fmt: skip
            return tuple(vars(turns).values())

        n = len(speed)
        blocks = np.array_split(np.arange(n), max(1, math.ceil(n / AT_ONCE)))
        columns, *of_blocks, problems = zip(*context.each(block, blocks, "orbits", here=True))
        values, periods, left, ends = map(np.concatenate, of_blocks)
        return LastTwoTurns(columns[0], values, periods, left, ends, [*chain(*problems)])

    def branches(
        self, context: Context, asked: Sequence[Any]
    ) -> list[tuple[NDArray[np.intp], Branch]]:
        """Return the branches of motions of questions that have the same whole numbers and texts, with their numbers."""
        batch = _Batch(self, context, asked, [o.system(context.fmus) for o in asked])
        return batch.branches(batch.starts())

    def measure(self, context: Context, asked: Sequence[Any]) -> list[Findings | SetupError]:
        """Run all questions together that have the same whole numbers and texts for start values."""
        systems = [o.system(context.fmus) for o in asked]
        alike: dict[Hashable, list[int]] = defaultdict(list)
        for k, (o, system) in enumerate(zip(asked, systems)):
            texts = {name: x for name, x in system.start.items() if not isinstance(x, float)}
            alike[o.algorithm, tuple(system.start), *texts.items()].append(k)
        found: dict[int, Findings] = {}
        for some in alike.values():
            batch = _Batch(self, context, [asked[k] for k in some], [systems[k] for k in some])
            found |= zip(some, batch.findings())
        return [found[k] for k in range(len(asked))]


class _Batch:
    """Questions whose systems differ in numbers alone, and what is read of their turns."""

    def __init__(
        self, method: Orbit, context: Context, asked: Sequence[Any], systems: Sequence[System]
    ) -> None:
        self.method, self.context, self.asked, self.systems = method, context, asked, systems
        given = {name: x.value for name, x in parameters(systems[0]).items()}
        self.values = [
            {name: float(x) for name, x in {**given, **system.start, **o.values}.items() if isinstance(x, int | float)}
            for o, system in zip(asked, systems)
        ]  # fmt: skip
        readers = [x.value for x in asked[0].numbers if isinstance(x.value, Reader)]
        self.formulas = {x.column: Formula.read(x.column) for x in readers}
        used = {name for formula in self.formulas.values() for name in formula.names}
        network = connect(systems[0])
        is_output = {
            f"{part}.{x.name}": x.causality == "output"
            for part, description in network.descriptions.items()
            for x in description.modelVariables
        }
        self.columns = sorted(x for x in {method.rate, *used} if is_output.get(x))
        self.units = {
            name: network.port(name).unit for name in is_output if name in used | {method.rate}
        }

    def findings(self) -> list[Findings]:
        """Return what is found of each question."""
        case, states = self.motions()
        k = len(STEP_MULTIPLES)
        turns = self.turns(
            [self.asked[i] for i in case] * k, [self.systems[i] for i in case] * k,
            np.tile(states, (k, 1)), np.repeat(STEP_MULTIPLES, len(case)),
        )  # fmt: skip
        problems = np.array(turns.problems, object).reshape(k, -1)
        numbers = [
            (x, *self.read(x.value, turns, case))
            for x in self.asked[0].numbers
            if isinstance(x.value, Reader)
        ]
        motions: dict[int, list[SteadyMotion]] = defaultdict(list)
        for j in np.flatnonzero(first_of_same(case.tolist(), turns.states[: len(case)])).tolist():
            i = int(case[j])
            why = next(filter(None, problems[:, j]), "")
            figures: dict[str, Figure] = {}
            for x, value, error in numbers:
                one = as_declared(
                    self.asked[i],
                    x,
                    Figure(1.0, self.units.get(x.value.column, "1"), 0.0),
                    self.units,
                )
                found = orbit_figure(value[j], error[j], one.unit, one.meaning, why)
                figures[x.name] = scaled(found, one.value, one.unit, one.meaning)
            for x in self.asked[i].numbers:
                if not isinstance(x.value, Reader):
                    figures[x.name] = follows(x, figures, self.values[i])._replace(
                        meaning=x.meaning
                    )
            turn = {name: turns.of(name)[j, 1] for name in turns.columns}
            figures |= self.asked[i].more_figures(figures, self.values[i])
            motions[i].append(
                SteadyMotion(figures, turn, turns.states[j], float(turns.contraction[j]))
            )
        return [self.finding(i, motions[i]) for i in range(len(self.asked))]

    def finding(self, i: int, motions: list[SteadyMotion]) -> Findings:
        """Return the findings of a question of these motions."""
        o, worst = self.asked[i], self.method.worst
        if worst:
            motions.sort(key=lambda x: -np.nan_to_num(x.figures[worst].value, nan=-math.inf))
        return Findings(
            motions[0].figures, motions, self.systems[i], algorithm=o.algorithm,
            communication=f"{o.steps_per_rev} steps per revolution",
        )  # fmt: skip

    def turns(
        self, asked: Sequence[Any], systems: Sequence[System], states: Array, multiple: NDArray[Any]
    ) -> LastTwoTurns:
        """Return the last turns of members, from states, with multiples of their steps."""
        first, method = systems[0].start, self.method
        differ = {name for name, x in first.items() if isinstance(x, float)} - {*method.states}
        cases = {name: np.array([x.start[name] for x in systems], float) for name in sorted(differ)}
        shared = {name: x for name, x in first.items() if name not in differ}
        speed = np.array([getattr(o, method.speed) for o in asked], float)
        steps = np.array([o.steps_per_rev for o in asked]) // multiple
        return method.turns(
            self.context, replace(systems[0], start=shared), {**cases, **dict(zip(method.states, states.T))},
            speed, steps_per_rev=steps, record=self.columns, algorithm=asked[0].algorithm,
        )  # fmt: skip

    def motions(self) -> tuple[NDArray[np.intp], Array]:
        """Return the number of the question of each motion, and its states at the start of a turn."""
        starts, every = self.starts(), np.arange(len(self.asked))
        if len(starts) == 1:
            return every, starts[0]
        found = self.branches(starts)
        case = np.concatenate([every[:0], *(numbers for numbers, _ in found)])
        lost = np.setdiff1d(every, case)
        states = [branch.states for _, branch in found]
        return np.append(case, lost), np.concatenate([*states, starts[0][lost]])

    def starts(self) -> Array:
        """Return the states from which motions are sought, shape (starts, questions, states)."""
        own = [
            o.starts(system)
            if hasattr(o, "starts")
            else [[system.start[x] for x in self.method.states]]
            for o, system in zip(self.asked, self.systems)
        ]
        return np.stack([np.array(x, float) for x in own], axis=1)

    def branches(self, starts: Array) -> list[tuple[NDArray[np.intp], Branch]]:
        """Return the branches of motions of questions that differ in the speed alone, with the numbers of these."""
        lines: dict[Hashable, list[int]] = defaultdict(list)
        speed = np.array([getattr(o, self.method.speed) for o in self.asked], float)
        for k in np.argsort(speed, kind="stable").tolist():
            o = self.asked[k]
            others = [getattr(o, x) for x in declared(type(o)) if x != self.method.speed]
            lines[*others, *o.start.items()].append(k)
        members = [np.array(some) for some in lines.values()]

        def settle(line: NDArray[np.intp], x: Array, states: Array) -> Array:
            ends = np.full_like(states, np.nan)
            wanted = np.flatnonzero(np.isfinite(states).all(-1))
            if len(wanted):
                asked = [
                    replace(self.asked[members[line[j]][0]], **{self.method.speed: float(x[j])})
                    for j in wanted
                ]
                systems = [o.system(self.context.fmus) for o in asked]
                multiple = np.full(len(wanted), STEP_MULTIPLES[-1])
                ends[wanted] = self.turns(asked, systems, states[wanted], multiple).states
            return ends

        found = follow_branches(
            settle, [speed[some] for some in members], starts[:, np.concatenate(members)]
        )
        return [(members[b.line][np.searchsorted(speed[members[b.line]], b.x)], b) for b in found]

    def read(
        self, reader: Reader, turns: LastTwoTurns, case: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Return a number of all motions, and its error, nan where it is not known, in the unit of its column."""
        k, formula = len(STEP_MULTIPLES), self.formulas[reader.column]
        known = {
            name: np.tile([self.values[i][name] for i in case], k)[:, None, None]
            for name in formula.names - {*self.columns}
        }
        x = formula.over({**known, **{name: turns.of(name) for name in self.columns}})
        x = np.broadcast_to(x, turns.values.shape[:3])
        order = CONVERGENCE_ORDERS[self.asked[0].algorithm]
        if reader.kind in ("max", "min"):
            sense = 1.0 if reader.kind == "max" else -1.0
            peaks = force_peaks(sense * x[:, 1].reshape(k, -1, x.shape[-1]))
            value, error = peaks.each(lambda y: y[..., :SECTORS]).largest()
            return sense * value, error
        if reader.kind == "mean":
            of_both: Any = (x / turns.of(self.method.rate)).mean(-1) * TURN / turns.periods
            left = turns.settling_error(of_both) + MEAN_ERROR * np.abs(of_both[:, 1])
        elif reader.kind in ("amplitude", "phase"):
            number = x.shape[-1]
            wave = np.exp(-2j * math.pi * reader.order / number * np.arange(number))
            of_both = (2j if reader.order else 1j) / number * (x @ wave)
            left = turns.settling_error(of_both)
        else:
            kinds = "max, min, mean, amplitude or phase"
            raise SetupError(
                f"reader {reader.kind!r} of {reader.column}: of a turn it must be {kinds}"
            )
        value, error = extrapolated(of_both[:, 1].reshape(k, -1), order, left.reshape(k, -1))
        if reader.kind == "phase":
            with np.errstate(all="ignore"):
                return np.angle(value, deg=True), np.degrees(error / np.abs(value))
        return np.abs(value) if reader.kind == "amplitude" else value, error
