"""Steady turns as a method: the figures of machines that turn, from runs that repeat, with steps of h, 2 h and 4 h.

Arrays have the step size as their first axis: row 0 is that of the communication step h, rows 1 and 2 those of 2 h and
4 h, which give the errors.
"""

from __future__ import annotations

import ast
import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial, reduce
from itertools import chain, count
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import CONVERGENCE_ORDERS, SetupError, SimulationError, System
from cosim.accuracy.limit import Limit, Reason, limit
from cosim.system import connect

from .answer import Findings, Table, parameters
from .branches import BEYOND, Branch, first_of_same, follow_branches
from .context import Context
from .figure import UNSURE, Figure, value_of_values
from .formula import Formula
from .live import Number, Reader
from .method import as_declared
from .options import declared
from .steady import ORBIT_ANGLES, TURN, LastTwoTurns, steady_turns

Array = NDArray[np.float64]
#: Communication steps of a run over the shortest one. Three runs give value, error and observed order.
STEP_MULTIPLES = (1, 2, 4)
#: Sectors of a revolution, of each of which the largest values are kept; a convention, finer than the peaks
#: of the orders 1 to 7 are apart.
SECTORS = 16
#: Even angles between which the largest value of a sector is interpolated by a parabola; sixteen for each of ORBIT_ANGLES.
FINE_ANGLES = 16 * ORBIT_ANGLES
#: Orbits that are run side by side before they are kept. Chosen: half a second of work.
AT_ONCE = 256
#: Convergence order of a peak: an output that an input moves at once, as a rod force by a torque, has that of half a step before.
PEAK_ORDER = 1.0
COARSE_UNSTABLE = "the run with four times the step is unstable, so that no error can be estimated; take more steps per revolution"
NO_COUPLING_ERROR = "the coupling error is not known; take more steps per revolution"
#: Relative error of the mean over a turn, which settling leaves of its period.
MEAN_ERROR = 2e-9


def at_zero_step(values: Array, order: float, noise: Array | float = 0.0) -> Limit:
    """Return where values of shape (k, ...) go, whose rows are those of the first k of STEP_MULTIPLES."""
    missing = ((0, len(STEP_MULTIPLES) - len(values)), *((0, 0),) * (values.ndim - 1))
    runs = np.pad(values, missing, constant_values=np.nan)
    noises = np.pad(np.broadcast_to(noise, values.shape), missing, constant_values=np.nan)
    return limit(runs, order, noise=noises)


def extrapolate_to_zero_step(
    values: Any, order: float, noise: Array | float = 0.0
) -> tuple[Any, Array]:
    """Return where values go, real or complex, and the errors of that, nan where they are not known."""
    found = at_zero_step(values, order, noise)
    return found.extrapolated, np.where(found.is_stated, found.extrapolated_error, np.nan)


def mean_over_angles(x: Array) -> tuple[Any, Array]:
    """Return the mean of a turn over even angles, shape (..., angles), and what the orders that they cannot tell add to it.

    Orders fall geometrically, if not faster: how fast, what a half and a quarter of the angles make of the mean tells.
    """
    whole, half, quarter = (x[..., ::k].mean(-1) for k in (1, 2, 4))
    missed, before = np.abs(whole - half), np.abs(half - quarter)
    return whole, missed * np.minimum(missed / np.maximum(before, 1e-300), 1.0)


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
    """Largest values of all sectors at a step of zero, up to where each may reach, whether that is known, and with each step."""

    value: Array
    reach: Array
    is_known: NDArray[np.bool_]
    steps: Array

    def each(self, function: Callable[[Any], Any]) -> Peaks:
        """Return a function of each array."""
        return Peaks(*map(function, vars(self).values()))

    def largest(self) -> tuple[Array, Array]:
        """Return the largest value, over the last axis, and its error.

        The error reaches as far as that of any other peak does; it is nan where one is not known that may
        be the largest.
        """
        best = self.value.max(-1)
        error = self.reach.max(-1) - best
        doubtful = (~self.is_known & ~(self.reach < best[..., None])).any(-1)
        return best, np.where(doubtful, np.nan, error)


def peaks_at_zero_step(waveform: Array) -> Peaks:
    """Return the peaks of waveforms, shape (k, ..., ORBIT_ANGLES), of the first k of STEP_MULTIPLES."""
    peaks = sector_peaks(waveform)
    rows = np.abs(sector_peaks(waveform[..., ::2]) - peaks) / 4.0
    of_all = at_zero_step(peaks, PEAK_ORDER)
    reach = of_all.extrapolated + of_all.extrapolated_error + 2.0 * rows[0]
    reach = np.where(np.isfinite(reach), reach, np.inf)
    return Peaks(of_all.extrapolated, reach, of_all.is_stated, peaks)


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
        reason = (why or UNSURE) if math.isnan(value) else NO_COUPLING_ERROR
        return Figure.undetermined(unit, reason, meaning)
    return Figure(float(value), unit, float(error), meaning)


ARRAYS = ("value", "error", "steps")


class FigureColumn(NamedTuple):
    """A figure of many motions: values, errors, nan where they are not known, and values with each step, shape (k, n)."""

    value: Array
    error: Array
    unit: str
    meaning: str
    steps: Array

    def each(
        self, function: Callable[[Any], Any], unit: str, meaning: str, slope: Any = 1.0
    ) -> FigureColumn:
        """Return a function of each value, whose slope is known."""
        error = self.error * np.abs(slope)
        return FigureColumn(function(self.value), error, unit, meaning, function(self.steps))

    def take(self, index: Any) -> FigureColumn:
        """Return that of some of the motions."""
        arrays: Any = {name: getattr(self, name)[..., index] for name in ARRAYS}
        return self._replace(**arrays)

    def beside(self, other: FigureColumn) -> FigureColumn:
        """Return these values and others."""
        arrays: Any = {
            name: np.concatenate((getattr(self, name), getattr(other, name)), -1) for name in ARRAYS
        }
        return self._replace(**arrays)


class Columns(Mapping[str, FigureColumn]):
    """Figures that are computed when they are asked for."""

    def __init__(self, functions: Mapping[str, Callable[[], FigureColumn]]) -> None:
        self._functions = functions
        self._known: dict[str, FigureColumn] = {}

    def __getitem__(self, name: str) -> FigureColumn:
        if name not in self._functions:
            raise SetupError(f"there is no figure {name!r}, only {', '.join(self)}")
        if name not in self._known:
            self._known[name] = self._functions[name]()
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._functions)

    def __len__(self) -> int:
        return len(self._functions)

    def each(self, function: Callable[[str, FigureColumn], FigureColumn]) -> Columns:
        """Return a function of name and figure, of each."""
        return Columns({name: lambda name=name: function(name, self[name]) for name in self})  # type: ignore[misc]


class SteadyMotion(NamedTuple):
    """A steady motion: its figures, what is read over the last turn at even angles, the states at its start, and the
    largest size of its Floquet multipliers.
    """

    figures: Mapping[str, Figure]
    turn: Mapping[str, Array]
    states: Array
    multiplier: float


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of questions: figures by name, why there is none, multipliers, states, and values over the last turn with
    each step, shape (k, n, angles).
    """

    asked: Sequence[Any]
    columns: Columns
    problems: NDArray[np.object_]
    multipliers: Array
    states: Array
    turn: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.asked)

    def __getitem__(self, index: Any) -> Motions:
        """Return some of them."""
        k = np.arange(len(self))[index]
        return Motions(
            [self.asked[i] for i in k], self.columns.each(lambda _, x: x.take(k)), self.problems[k],
            self.multipliers[k], self.states[k], {name: x[:, k] for name, x in self.turn.items()},
        )  # fmt: skip

    def beside(self, other: Motions) -> Motions:
        """Return these and others of the same kind."""
        columns = self.columns.each(lambda name, x: x.beside(other.columns[name]))
        turn = {name: np.concatenate([x, other.turn[name]], 1) for name, x in self.turn.items()}
        problems, multipliers, states = (
            np.concatenate([getattr(x, name) for x in (self, other)])
            for name in ("problems", "multipliers", "states")
        )
        return Motions([*self.asked, *other.asked], columns, problems, multipliers, states, turn)

    def figure(self, name: str, j: int) -> Figure:
        """Return a figure of a motion."""
        x = self.columns[name]
        meaning = x.meaning.format(**vars(self.asked[j]))
        return orbit_figure(x.value[j], x.error[j], x.unit, meaning, self.problems[j])

    def motion(self, j: int) -> SteadyMotion:
        """Return one of them, with its figures."""
        figures = {name: self.figure(name, j) for name in self.columns}
        turn = {name: x[0, j] for name, x in self.turn.items()}
        return SteadyMotion(figures, turn, self.states[j], float(self.multipliers[j]))

    def table(
        self, inputs: Mapping[str, tuple[str, Sequence[Any]]], figures: Mapping[str, str]
    ) -> Table:
        """Return the table of inputs, by their units and values, and of figures by the names that they have there.

        Behind a figure comes its error, unless it is that of a formula.
        """
        columns = {name: np.asarray(x) for name, (_, x) in inputs.items()}
        units = {name: unit for name, (unit, _) in inputs.items()}
        for figure, name in figures.items():
            x = self.columns[figure]
            columns[name], units[name] = x.value, x.unit
            if (x.error != 0.0).any():
                columns[f"{name}_error"], units[f"{name}_error"] = x.error, x.unit
        return Table(columns, units)

    @classmethod
    def of(cls, asked: Sequence[Any], found: Sequence[Findings | SetupError]) -> Motions:
        """Return what is found of other questions in the same form, with figures but no motions."""
        some = [{} if isinstance(x, SetupError) else x.figures for x in found]

        def column(name: str) -> FigureColumn:
            unknown = Figure.undetermined("1", "")
            figures = [of_one.get(name, unknown) for of_one in some]
            value, error = np.array(
                [(x.value, math.nan if x.error is None else x.error) for x in figures]
            ).T
            return FigureColumn(value, error, figures[0].unit, "", value[None])

        names = dict.fromkeys(name for of_one in some for name in of_one)
        problems = np.array([str(x) if isinstance(x, SetupError) else "" for x in found], object)
        unknown = np.full((len(asked), 1), np.nan)
        columns = Columns({name: partial(column, name) for name in names})
        return cls(asked, columns, problems, unknown[:, 0], unknown, {})


@dataclass(frozen=True)
class Orbit:
    """The steady turns of an angle, whose errors are those of three step sizes.

    A question of this method has options `steps_per_rev` and `algorithm`; its `system` has start values near the orbit. Its
    `numbers` are read from the last turn, see `Reader`. Where it has a method `starts` that returns several states, all
    motions to which they lead are found, and all that lie beside those of other questions that differ in the speed alone. The figures are those of the
    motion whose number `worst` is largest; `data` of the findings has all, that first. A class method `more_columns` of the
    question returns more figures of many motions, and its `coarsest` says how many times its step a run is stable with.

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
    angles : int
        Even angles of a turn at which columns are read.
    """

    angle: str
    rate: str
    states: Sequence[str]
    speed: str = "speed"
    worst: str = ""
    angles: int = ORBIT_ANGLES

    @property
    def options(self) -> tuple[str, ...]:
        """The options that a question must have."""
        return self.speed, "steps_per_rev", "algorithm"

    def measure(self, context: Context, asked: Sequence[Any]) -> list[Findings | SetupError]:
        """Return what each question finds of its motions."""
        found: dict[int, Findings] = {}
        for batch, some in self._batches(context, asked):
            numbers, motions = batch.all_motions()
            for i, k in enumerate(some):
                own = [motions.motion(int(j)) for j in np.flatnonzero(numbers == i)]
                found[k] = self._findings(batch.systems[i], own)
        return [found[k] for k in range(len(asked))]

    def worst_motions(
        self, context: Context, asked: Sequence[Any], states: Array | None = None
    ) -> Motions:
        """Return the worst motion of each question, or that to which states lead."""
        parts, order = [], []
        for batch, some in self._batches(context, asked):
            if states is None:
                numbers, motions = batch.all_motions()
                parts.append(motions[self.worst_of(numbers, motions)])
            else:
                parts.append(batch.motions(np.arange(len(some)), states[some]))
            order += some
        return reduce(Motions.beside, parts)[np.argsort(order)]

    def branches(self, context: Context, asked: Sequence[Any]) -> tuple[Motions, list[Branch]]:
        """Return the motions of questions, and the branches that they form, in that order.

        Lines are those of questions that differ in the speed alone, numbered as they are first met by speed; a branch
        with one motion may be that of a question that has none. `asked` of the motions says which question is theirs.
        """
        parts: list[Motions] = []
        branches: list[Branch] = []
        for batch, _ in self._batches(context, asked):
            numbers, own = zip(*batch.branches())
            parts.append(
                batch.motions(np.concatenate(numbers), np.concatenate([b.states for b in own]))
            )
            branches += own
        return reduce(Motions.beside, parts), branches

    def motions(
        self, context: Context, asked: Sequence[Any], states: Array, multiples: int
    ) -> Motions:
        """Return the motions of questions that are run alike, to which states lead, with so many of STEP_MULTIPLES."""
        ((batch, _),) = self._batches(context, asked)
        return batch.motions(np.arange(len(asked)), states, multiples)

    def worst_of(self, numbers: NDArray[np.intp], motions: Motions) -> list[int]:
        """Return which motion is the worst of each question."""
        height = motions.columns[self.worst].value if self.worst else np.zeros(len(motions))
        order = np.lexsort((-np.nan_to_num(height, nan=-math.inf), numbers))
        return [int(j) for k, j in enumerate(order) if not k or numbers[j] != numbers[order[k - 1]]]

    def _batches(
        self, context: Context, asked: Sequence[Any]
    ) -> Iterator[tuple[_Batch, list[int]]]:
        """The questions that have the same whole numbers and texts for start values, together, and their numbers."""
        alike: dict[Hashable, list[int]] = defaultdict(list)
        systems = [o.system(context.fmus) for o in asked]
        for k, (o, system) in enumerate(zip(asked, systems)):
            texts = {name: x for name, x in system.start.items() if not isinstance(x, float)}
            alike[o.algorithm, tuple(system.start), *texts.items()].append(k)
        for some in alike.values():
            yield _Batch(self, context, [asked[k] for k in some], [systems[k] for k in some]), some

    def _findings(self, system: System, motions: list[SteadyMotion]) -> Findings:
        if self.worst:
            motions.sort(key=lambda x: -np.nan_to_num(x.figures[self.worst].value, nan=-math.inf))
        return Findings(motions[0].figures, motions, system)


def solve_each(context: Context, asked: Sequence[Any]) -> list[Findings | SetupError]:
    """Return what each of several questions of one class finds, or why it is refused or its run ends early.

    So many are solved at a time as the class says, in halves where one of them fails.
    """
    found: list[Findings | SetupError] = []
    number = type(asked[0]).at_once if asked else 1
    for k in range(0, len(asked), number):
        some = asked[k : k + number]
        try:
            found += type(some[0]).solve_all(context, some)
        except (ValueError, ArithmeticError, LookupError, SimulationError) as error:
            half = len(some) // 2
            halves = (some[:half], some[half:]) if half else ()
            found += [x for part in halves for x in solve_each(context, part)] or [
                SetupError(str(error))
            ]
    return found


def measured(context: Context, asked: Sequence[Any], states: Array | None = None) -> Motions:
    """Return what is found of questions of one class as arrays; of orbits, that to which states lead."""
    method = asked[0].method
    if isinstance(method, Orbit):
        return method.worst_motions(context, asked, states)
    return Motions.of(asked, solve_each(context, asked))


def table_of(
    context: Context,
    csv: str,
    asked: Sequence[Any],
    inputs: Mapping[str, tuple[str, Sequence[float]]],
    figures: Mapping[str, str],
) -> tuple[Table, Motions]:
    """Return a table of the worst motions of questions, and these; rows are kept as they come.

    Parameters
    ----------
    context : Context
        Where they are asked.
    csv : str
        The file of the table.
    asked : sequence
        Questions of one class, which are asked AT_ONCE at a time.
    inputs : mapping
        Columns of what varies: the unit, and a value for each question.
    figures : mapping
        What figures are called in it, by default all by their names, see `Motions.table`.
    """  # fmt: skip
    silent = replace(context, out=None)  # the table has what is kept of each answer
    found = [measured(silent, asked[:AT_ONCE])]
    if not found[0].columns:
        raise SetupError(f"no row of {csv} has an answer; the first: {found[0].problems[0]}")
    figures = figures or {name: name for name in found[0].columns}
    units = {name: unit for name, (unit, _) in inputs.items()}
    units |= found[0].table({}, figures).units

    def rows() -> Iterator[tuple[Any, ...]]:
        for k in range(0, len(asked), AT_ONCE):
            some = slice(k, k + AT_ONCE)
            if k:
                found.append(measured(silent, asked[some]))
            own = {name: (unit, x[some]) for name, (unit, x) in inputs.items()}
            columns, exact = found[-1].table(own, figures).columns, np.zeros(len(found[-1]))
            yield from zip(*(columns.get(name, exact).tolist() for name in units))

    return context.record_rows(csv, units, rows()), reduce(Motions.beside, found)


class _Batch:
    """Questions whose systems differ in numbers alone, and what is read of their turns."""

    def __init__(
        self, method: Orbit, context: Context, asked: Sequence[Any], systems: Sequence[System]
    ) -> None:
        self.method, self.context, self.asked, self.systems = method, context, asked, systems
        readers = [x.value for x in asked[0].numbers if isinstance(x.value, Reader)]
        used = {name for x in readers for name in Formula.read(x.column).names}
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
        given = {name: x.value for name, x in parameters(systems[0]).items()}
        self.constants = {name: x for name, x in given.items() if isinstance(x, int | float)}

    def values(self, numbers: NDArray[np.intp]) -> dict[str, Any]:
        """Return the parameters and options of questions with these numbers, an array where they differ."""
        own = [{**self.systems[i].start, **self.asked[i].values} for i in numbers]
        numeric = [name for name, x in own[0].items() if isinstance(x, int | float)]
        return self.constants | {name: np.array([x[name] for x in own]) for name in numeric}

    def all_motions(self) -> tuple[NDArray[np.intp], Motions]:
        """Return all motions, each once, and the numbers of their questions."""
        pairs = self.branches()
        numbers = np.concatenate([some for some, _ in pairs])
        motions = self.motions(numbers, np.concatenate([b.states for _, b in pairs]))
        if len(numbers) > len(self.asked):
            own = first_of_same(numbers.tolist(), motions.states)
            numbers, motions = numbers[own], motions[own]
        return numbers, motions

    def motions(
        self, numbers: NDArray[np.intp], states: Array, multiples: int = len(STEP_MULTIPLES)
    ) -> Motions:
        """Return the motions of questions with these numbers, to which states lead, with so many of STEP_MULTIPLES."""
        k, n = multiples, len(numbers)
        asked = [self.asked[i] for i in numbers]
        systems = [self.systems[i] for i in numbers]
        multiple = np.repeat(STEP_MULTIPLES[:k], n)
        most = [coarsest(o) for o in asked] if k > 1 else [1] * n
        is_stable = multiple <= np.tile(most, k)
        begin = np.where(is_stable[:, None], np.tile(states, (k, 1)), np.nan)
        turns = self.turns(asked * k, systems * k, begin, multiple)
        problems = np.array(turns.problems, object).reshape(k, -1)
        why = [next(filter(None, reasons), "") for reasons in problems.T]
        turn = {name: turns.of(name)[:, 1].reshape(k, n, -1) for name in turns.columns}
        reading = _Reading(self, turns, cache(lambda: self.values(numbers)), k)
        functions: dict[str, Callable[[], FigureColumn]] = {}
        columns = Columns(functions)
        functions |= {x.name: partial(reading.column, x, columns) for x in asked[0].numbers}
        if hasattr(asked[0], "more_columns"):
            functions |= asked[0].more_columns(asked, columns)
        return Motions(
            asked, columns, np.array(why, object), turns.contraction[:n], turns.states[:n], turn
        )

    def turns(
        self, asked: Sequence[Any], systems: Sequence[System], states: Array, multiple: NDArray[Any]
    ) -> LastTwoTurns:
        """Return the last turns of questions from states, AT_ONCE at a time, with multiples of their steps; nan has none."""
        first, method = systems[0].start, self.method
        differ = {name for name, x in first.items() if isinstance(x, float)} - {*method.states}
        cases = {name: np.array([x.start[name] for x in systems], float) for name in sorted(differ)}
        cases |= dict(zip(method.states, states.T))
        system = replace(systems[0], start={x: y for x, y in first.items() if x not in cases})
        speed = np.array([getattr(o, method.speed) for o in asked], float)
        steps = np.array([o.steps_per_rev for o in asked]) // multiple

        def block(some: NDArray[Any]) -> tuple[Any, ...]:
            turns = steady_turns(
                system, {name: x[some] for name, x in cases.items()}, method.states, method.angle,
                speed[some], steps_per_rev=steps[some], record=self.columns, algorithm=asked[0].algorithm,
                angles=method.angles, jobs=self.context.jobs,
            )  # fmt: skip
            return tuple(vars(turns).values())

        run = np.flatnonzero(np.isfinite([*cases.values()]).all(0))
        blocks = np.array_split(run, max(1, math.ceil(len(run) / AT_ONCE)))
        columns, *of_blocks, problems = zip(*self.context.each(block, blocks, "orbits", here=True))
        arrays: list[Any] = []
        for part in map(np.concatenate, of_blocks):
            arrays.append(np.full((len(asked), *part.shape[1:]), np.nan))
            arrays[-1][run] = part
        values, periods, contraction, ends = arrays
        why = np.full(len(asked), "", object)
        why[run] = [*chain(*problems)]
        return LastTwoTurns(columns[0], values, periods, contraction, ends, why.tolist())

    def branches(self) -> list[tuple[NDArray[np.intp], Branch]]:
        """Return the branches of motions, with the numbers of their questions; a question without any is one of its own."""
        own = [
            o.starts(system)
            if hasattr(o, "starts")
            else [[system.start[x] for x in self.method.states]]
            for o, system in zip(self.asked, self.systems)
        ]
        starts = np.stack([np.array(x, float) for x in own], axis=1)
        speed = np.array([getattr(o, self.method.speed) for o in self.asked], float)
        lines: dict[Hashable, list[int]] = defaultdict(list)
        for k in np.argsort(speed, kind="stable").tolist():
            o = self.asked[k]
            others = [
                getattr(o, x) for x in declared(type(o)) if x not in (self.method.speed, "start")
            ]
            key = (*others, *o.start.items())
            taken = next(n for n in count() if speed[k] not in speed[lines[n, *key]])
            lines[taken, *key].append(k)
        members = [np.array(some) for some in lines.values()]
        if len(starts) == 1:
            return [
                (m, Branch(k, speed[m], starts[0][m], (BEYOND, BEYOND)))
                for k, m in enumerate(members)
            ]

        def settle(line: NDArray[np.intp], x: Array, states: Array) -> Array:
            ends = np.full_like(states, np.nan)
            wanted = np.flatnonzero(np.isfinite(states).all(-1))
            if len(wanted):
                asked = [
                    replace(self.asked[members[line[j]][0]], **{self.method.speed: float(x[j])})
                    for j in wanted
                ]
                systems = [o.system(self.context.fmus) for o in asked]
                multiple = np.array([coarsest(o) for o in asked])
                ends[wanted] = self.turns(asked, systems, states[wanted], multiple).states
            return ends

        followed = follow_branches(
            settle, [speed[some] for some in members], starts[:, np.concatenate(members)]
        )
        found = [
            (members[b.line][np.searchsorted(speed[members[b.line]], b.x)], b) for b in followed
        ]
        for k, m in enumerate(members):
            lost = np.setdiff1d(m, np.concatenate([m[:0], *(some for some, _ in found)]))
            if len(lost):  # is run again, to say why
                found.append((lost, Branch(k, speed[lost], starts[0][lost], (BEYOND, BEYOND))))
        return found


@dataclass(frozen=True, eq=False)
class _Reading:
    """What is read of the turns of a batch with so many step sizes, and the values of its parameters and options."""

    batch: _Batch
    turns: LastTwoTurns
    values: Callable[[], dict[str, Any]]
    k: int
    known_peaks: dict[str, Peaks] = field(default_factory=dict)

    def column(self, x: Number, columns: Columns) -> FigureColumn:
        """Return a number, which may follow from others."""
        if not isinstance(x.value, Reader):
            return self.following(x, columns)
        batch = self.batch
        one = Figure(1.0, batch.units.get(x.value.column, "1"), 0.0)
        factor, unit, *_ = as_declared(batch.asked[0], x, one, batch.units)
        value, error, steps = (factor * y for y in self.read(x.value))
        return FigureColumn(value, np.abs(error), unit, x.meaning, steps)

    def over_turns(self, formula: Formula) -> Array:
        """Return a formula over both turns, shape (members, 2, angles)."""
        names, columns = formula.names, self.batch.columns
        known = self.values() if names - {*columns} else {}
        scope = {
            name: x if np.ndim(x) == 0 else np.tile(x, self.k)[:, None, None]
            for name, x in known.items()
            if name in names
        }
        x = formula.over(scope | {name: self.turns.of(name) for name in columns if name in names})
        return np.broadcast_to(x, self.turns.values.shape[:3])

    def peaks(self, text: str) -> Peaks:
        """The peaks of a formula over the last turn, of both senses."""
        if text not in self.known_peaks:
            x = self.over_turns(Formula.read(text))
            self.known_peaks[text] = peaks_at_zero_step(x[:, 1].reshape(self.k, -1, x.shape[-1]))
        return self.known_peaks[text]

    def read(self, reader: Reader) -> tuple[Array, Array, Array]:
        """Return a number of all motions, its error, nan where it is not known, and what each step gives, in the unit of
        its column.
        """
        if reader.kind in ("max", "min"):
            sense, which = (
                (1.0, slice(SECTORS)) if reader.kind == "max" else (-1.0, slice(SECTORS, None))
            )
            inner = inside_of_size(reader)
            some = slice(None) if inner else which
            of_sense = self.peaks(inner or reader.column).each(lambda y: y[..., some])
            value, error = of_sense.largest()
            return sense * value, error, sense * of_sense.steps.max(-1)
        x, turns, k = self.over_turns(Formula.read(reader.column)), self.turns, self.k
        if reader.kind == "mean":
            x = x * TURN / (turns.of(self.batch.method.rate) * turns.periods[..., None])
        elif reader.kind in ("amplitude", "phase"):
            points = x.shape[-1]
            wave = np.exp(-2j * math.pi * reader.order / points * np.arange(points))
            x = (2j if reader.order else 1j) * x * wave
        else:
            kinds = "max, min, mean, amplitude or phase"
            raise SetupError(
                f"reader {reader.kind!r} of {reader.column}: of a turn it must be {kinds}"
            )
        of_both, missed = mean_over_angles(x)
        left = turns.settling_error(of_both) + missed[:, 1]
        if reader.kind == "mean":
            left += MEAN_ERROR * np.abs(of_both[:, 1])
        steps, left = of_both[:, 1].reshape(k, -1), left.reshape(k, -1)
        value, error = extrapolate_to_zero_step(
            steps, CONVERGENCE_ORDERS[self.batch.asked[0].algorithm], left
        )
        if reader.kind == "phase":
            with np.errstate(all="ignore"):
                share = np.degrees(1.0 / np.abs(value))
            degrees = (np.angle(y, deg=True) for y in (value, steps))
            return next(degrees), error * share, next(degrees)
        if reader.kind == "amplitude":
            value, steps = np.abs(value), np.abs(steps)
        return value, error, steps

    def following(self, x: Number, columns: Columns) -> FigureColumn:
        """Return the number of a formula of others."""
        formula = Formula.read(x.value)
        others = {
            f"figures.{name}": columns[name]
            for name in columns
            if f"figures.{name}" in formula.names
        }
        at = self.values()

        def of_others(*values: Any) -> Array:
            return formula.over({**at, **dict(zip(others, values))})

        columns_of = others.values()
        value, error = value_of_values(
            of_others, [y.value for y in columns_of], [y.error for y in columns_of]
        )
        steps = of_others(*(y.steps for y in columns_of))
        return FigureColumn(value, error, x.unit or "1", x.meaning, steps)


def coarsest(o: Any) -> int:
    """Return how many times the step of a question may be without a run that grows, which would be no orbit."""
    return int(getattr(o, "coarsest", STEP_MULTIPLES[-1]))


def inside_of_size(reader: Reader) -> str:
    """Return what a reader takes the largest size of, "x" in "abs(x)", or "": a size has kinks, where no series converges."""
    call = ast.parse(reader.column.strip(), mode="eval").body
    if reader.kind == "max" and isinstance(call, ast.Call) and ast.unparse(call.func) == "abs":
        return ast.unparse(call.args[0])
    return ""
