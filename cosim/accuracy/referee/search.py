"""Why a result differs, by running the system again: held inputs, a long step, what was lost or crossed.

Each variant of the system, or of the way it is stepped, makes all columns anew. A cause is named only if they
are at least ten times closer to the table than the reference solution is.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from ...errors import SetupError
from ...fmu.messages import quiet
from ...master import run
from ...result import SimulationError
from ...system import Network, System, Wire, connect
from .causes import (
    DECISIVE_REDUCTION,
    LEAST_REDUCTION,
    LONGEST_DELAY,
    Cause,
    ratio,
    root_mean_square,
)
from .signals import SignalJudgement, Verdict
from .solution import INTEGRATION_TOLERANCE, SPACING_TOLERANCE, Array, Request, integrate
from .variants import MOST_VARIANTS, FreeNumber, Variant, numbers, variants
from .whole import EULERS, by_method, late, wires_with_total_factors

#: Numbers of communication steps per row that masters are run with: a convention of decimal steps.
STEPS_PER_ROW = (1, 2, 4, 5, 10, 20, 50, 100)
#: Steps that are longer than the time between rows, in rows.
ROWS_PER_STEP = (2, 4, 5, 10)
#: Most steps of a run that only serves to reproduce a cause: limits the time.
MOST_RUN_STEPS = 1_000_000
#: Most parts whose stepping orders are all tried: 3! = 6 orders.
MOST_ORDERED_PARTS = 3
#: Shortest steps, in rows, whose rows may be a step early: a convention; of shorter ones a row shows no start.
EARLY_STEP = 0.5
#: Longest time of the processor for a variant [s]: limits systems that a lost wire makes unstable.
VARIANT_SECONDS = 0.5
#: Share of the difference that a run may be off and serve in place of an integration: a third of what a
#: reduction of LEAST_REDUCTION leaves.
ACCURATE_ENOUGH = 0.03
#: Most halvings of the step until a run is so accurate: 64 times more steps.
MOST_HALVINGS = 6
#: Numbers that are fitted of all that are moved a little.
MOST_FITTED = 2
#: Share of a number by which it is moved: large against the rounding of runs, small against what a run shows.
MOVED = 1e-4
#: Share of a number below which its fit has ended: the digits that are printed.
FITTED = 1e-6
#: Most moves of such a number: those that end at all double their right digits.
MOST_MOVES = 12
#: Most variants of the system that are tried together with a coupling that holds inputs.
MOST_COMBINED = 3
#: Shortest delay that is sought, in rows.
SHORTEST_DELAY = 0.01
#: Difference from the reference, in ranges, from which on a table tells nothing more: it has become unstable.
UNSTABLE = 10.0
#: Share of the largest difference that shows how a table begins to differ.
SHOWN = 0.1
#: Share of the difference that the first rows of a guess may leave to be looked at any further.
ALIKE = 0.5
#: Fewest rows that are looked at of a table that becomes unstable, or of the beginning of any: a convention.
FEWEST_STABLE_ROWS = 20
HELD = {
    "jacobi": "all parts step at once with inputs that are one step old (Jacobi)",
    "gauss-seidel": "the parts step one after the other with held inputs (Gauss-Seidel)",
    "strang": "the parts step forth and back with held inputs (Strang)",
}


@dataclass(frozen=True)
class Coupling:
    """How a master steps: algorithm, communication step [s], stepping order.

    Rows of `early_parts` show the end of a step at the time of its start, as some masters write them.
    """

    algorithm: str
    step: float
    order: tuple[str, ...] = ()
    early_parts: tuple[str, ...] = ()

    def text(self) -> str:
        """The cause as a clause."""
        order = f", in the order {', '.join(self.order)}" if self.order else ""
        early = f"; rows of {', '.join(self.early_parts)} are a step too early"
        how = f"communication steps of {self.step:.4g} s: {HELD[self.algorithm]}{order}"
        return f"{how}{early if self.early_parts else ''}"

    @property
    def kind(self) -> str:
        """The cause in a word: inputs that are a step old, or a step that is too long for its algorithm."""
        return "held inputs" if self.algorithm == "jacobi" else "step too long"


class OutOfTimeError(Exception):
    """A run takes longer than it may."""


class CauseSearch:
    """Makes the columns of a table by variants of a system, and measures how close they come.

    Columns are arrays of shape (signals, rows), each over its range. All are measured, so that those that agree tell two
    causes apart; `explained` are those that differ. Rows after the table has become unstable tell nothing more.
    """

    def __init__(
        self,
        network: Network,
        signals: Sequence[SignalJudgement],
        request: Request,
        seconds: float,
    ) -> None:
        self.network, self.names = network, [signal.name for signal in signals]
        self.explained = tuple(s.name for s in signals if s.verdict is Verdict.DIFFERS)
        self.scale = np.array([[signal.scale] for signal in signals])
        table = np.array([signal.values for signal in signals]) / self.scale
        reference = np.array([signal.reference for signal in signals]) / self.scale
        beyond = np.flatnonzero((np.abs(table - reference) > UNSTABLE).any(axis=0))
        rows = max(FEWEST_STABLE_ROWS, beyond[0]) if beyond.size else len(request.times)
        self.table, self.reference = table[:, :rows], reference[:, :rows]
        timeout = min(request.timeout, seconds)
        times = request.times[:rows]
        self.request = replace(request, names=self.names, times=times, timeout=timeout)
        self.deadline = clock.process_time() + seconds
        self.before = self.distance(self.reference)
        apart = np.abs(self.table - self.reference).max(axis=0)
        shown = int(np.argmax(apart >= SHOWN * apart.max(initial=0.0)))
        self.beginning = min(rows, max(FEWEST_STABLE_ROWS, shown + 1))
        self.fine = self._fine_coupling()

    def distance(self, columns: Array | None) -> float:
        """The distance of columns from those of the table; infinite where there are none."""
        if columns is None:
            return math.inf
        return root_mean_square(columns - self.table[:, : columns.shape[1]])

    def has_first_rows_closer_to_table(self, system: System) -> bool:
        """Whether the first rows of a system are clearly closer to those of the table than the reference is."""
        columns = self.columns(system, rows=self.beginning)
        before = self.distance(self.reference[:, : self.beginning])
        return self.distance(columns) <= ALIKE * before

    def cause(self, kind: str, text: str, columns: Array | None) -> Cause | None:
        """The cause that makes these columns, None if they are not close enough to those of the table."""
        better = ratio(self.before, self.distance(columns))
        return Cause(kind, text, better, self.explained) if better >= LEAST_REDUCTION else None

    @property
    def is_over(self) -> bool:
        """Whether its time is used up."""
        return clock.process_time() > self.deadline

    def steps(self) -> list[float]:
        """Communication steps [s]: the known one, those that fit the time between rows, and longer ones."""
        spacing, known = self.request.output_step(), self.request.step
        steps = [] if known is None else [known]
        steps += [spacing / n for n in STEPS_PER_ROW] + [spacing * n for n in ROWS_PER_STEP]
        span = self.request.stop - self.request.start
        return [step for step in dict.fromkeys(steps) if span / MOST_RUN_STEPS <= step <= span]

    def columns(
        self,
        system: System,
        coupling: Coupling | None = None,
        later: float = 0.0,
        rows: int | None = None,
    ) -> Array | None:
        """What a system does at times that are later by so much [s]; by default without a coupling error that matters."""
        how = coupling or self.fine
        if how is None:
            return self.integrated(system, rows)
        if self.is_over:
            return None
        spacing = self.request.output_step()
        is_fine = how.step <= spacing * (1.0 + SPACING_TOLERANCE)
        deadline = clock.process_time() + VARIANT_SECONDS

        def require_time(_: float) -> None:
            if clock.process_time() > deadline:
                raise OutOfTimeError

        request = replace(self.request, times=self.request.times[:rows] + later)
        try:
            with quiet():
                result = run(
                    system, start=request.start, stop=request.stop, record=self.names, step=how.step,
                    output_step=spacing if is_fine else None, algorithm=how.algorithm,
                    order=how.order or None, progress=require_time,
                )  # fmt: skip
        except (SetupError, SimulationError, OutOfTimeError):
            return None
        columns = request.interpolated(result.t, result.data[:, 1:], held=not is_fine)
        return np.asarray(columns / self.scale)

    def integrated(self, system: System, rows: int | None = None) -> Array | None:
        """What a system does by model exchange; None if it cannot be integrated."""
        if self.is_over:
            return None
        request = replace(self.request, times=self.request.times[:rows])
        try:
            values = integrate(connect(system), request, 100.0 * INTEGRATION_TOLERANCE).values
        except (SetupError, SimulationError):
            return None
        return np.array([values[name] for name in self.names] / self.scale)

    def _fine_coupling(self) -> Coupling | None:
        """Steps with which runs are accurate enough in place of integrations, None if there are none."""
        for n in range(MOST_HALVINGS):
            coupling = Coupling("strang", self.request.output_step() / 2**n)
            columns = self.columns(self.network.system, coupling)
            if columns is None:
                return None
            sizes = map(root_mean_square, columns - self.reference)
            if max(sizes) <= ACCURATE_ENOUGH * self.before:
                return coupling
        return None

    def fitted(
        self, columns: Callable[[float], Array | None], first: float, change: float
    ) -> tuple[float, Array | None]:
        """The number whose columns come closest to the table, by Gauss and Newton with secants, and these if it is not lost."""
        b = first + change
        x, y = columns(first), columns(b)
        for _ in range(MOST_MOVES):
            move, _ = self.secant_move(x, y, change)
            b, x, change = b + move, y, move
            y = columns(b)
            if y is None or abs(move) <= FITTED * abs(b):
                break
        return b, y

    def secant_move(self, x: Array | None, y: Array | None, change: float) -> tuple[float, float]:
        """By how much a number that made y is to be moved, if its change made y of x, and what is left then; 0 if it cannot."""
        if x is None or y is None or not change:
            return 0.0, math.inf
        slope = (y - x) / change
        square = float(np.sum(slope * slope))
        if not (math.isfinite(square) and square > 0.0):
            return 0.0, math.inf
        move = float(np.sum(slope * (self.table - y))) / square
        return move, root_mean_square(self.table - y - move * slope)


def find_causes(search: CauseSearch) -> list[Cause]:
    """The causes that explain the columns of a table, the best first."""
    causes: list[Cause] = []
    scores: list[tuple[float, Variant]] = []
    finders: tuple[Callable[[], Iterator[Cause]], ...] = (
        lambda: coupling_causes(search),
        lambda: _step_late_causes(search),
        lambda: _whole_system_euler_causes(search),
        lambda: _variant_causes(search, scores),
        lambda: _number_causes(search),
        lambda: _late_input_causes(search),
        lambda: _combined_causes(search, scores),
    )
    for find in finders:
        for cause in find():
            causes.append(cause)
            if cause.reduction >= DECISIVE_REDUCTION:
                return sorted(causes, key=lambda cause: -cause.reduction)
    if not causes:
        causes.extend(_fmu_integration_causes(search))
    return sorted(causes, key=lambda cause: -cause.reduction)


def coupling_causes(search: CauseSearch) -> Iterator[Cause]:
    """The coupling that comes closest to the table, if it is close enough."""
    coupling, columns = _best_coupling(search, search.network.system)
    if coupling is not None:
        cause = search.cause(coupling.kind, coupling.text(), columns)
        yield from [] if cause is None else [cause]


def _best_coupling(search: CauseSearch, system: System) -> tuple[Coupling | None, Array | None]:
    """The coupling of a system that comes closest to the table, and what it makes."""
    best: tuple[Coupling | None, Array | None] = None, None
    nearest = math.inf
    for coupling, columns in _run_couplings(search, system):
        if (distance := search.distance(columns)) < nearest:
            best, nearest = (coupling, columns), distance
            if search.before >= DECISIVE_REDUCTION * distance:
                break
    return best


def _run_couplings(search: CauseSearch, system: System) -> Iterator[tuple[Coupling, Array]]:
    """What each coupling makes of a system; at last those whose rows are a step early for some of the parts."""
    if not (search.network.wires or search.network.inputs):
        return
    parts = tuple(system.parts)
    orders = list(permutations(parts)) if len(parts) <= MOST_ORDERED_PARTS else [parts, parts[::-1]]
    ways = [("jacobi", ()), *(("gauss-seidel", order) for order in orders), ("strang", ())]
    coarse: list[tuple[Coupling, Array]] = []
    for step in search.steps():
        for algorithm, order in ways:
            coupling = Coupling(algorithm, step, order)
            columns = search.columns(system, coupling)
            if columns is not None:
                yield coupling, columns
                if step >= EARLY_STEP * search.request.output_step():
                    coarse.append((coupling, columns))
    part_of = np.array([search.network.port(name).part for name in search.names])
    for coupling, columns in coarse:
        later = search.columns(system, coupling, coupling.step)
        if later is None:
            continue
        early = [
            part
            for part in dict.fromkeys(part_of.tolist())
            if np.square(later - search.table)[part_of == part].sum()
            < np.square(columns - search.table)[part_of == part].sum()
        ]
        if early:
            mixed = np.where(np.isin(part_of, early)[:, None], later, columns)
            yield replace(coupling, early_parts=tuple(early)), mixed


def _whole_system_euler_causes(search: CauseSearch) -> Iterator[Cause]:
    """Euler's methods over the whole system, with the steps of a row and shorter ones."""
    longest = max(search.request.output_step(), search.request.step or 0.0)
    for name, method in EULERS.items():
        best: tuple[float, Array | None] = math.inf, None
        for step in (step for step in search.steps() if step <= longest):
            if search.is_over:
                continue
            columns = by_method(search.network, search.request, method, step)
            if columns is None:
                continue
            columns = columns / search.scale
            if search.distance(columns) < search.distance(best[1]):
                best = step, columns
            # A shorter step makes less of a difference than this one.
            size = root_mean_square(columns - search.reference)
            is_found = search.before >= DECISIVE_REDUCTION * search.distance(columns)
            if is_found or size < 0.5 * search.before:
                break
        how = f"with steps of {best[0]:.4g} s"
        text = f"{name} {how} integrates the whole system"
        variant = Variant(
            "step too long", text, f"{name} over the whole system {how} imitates it", search.network.system
        )  # fmt: skip
        if cause := search.cause(variant.kind, text, best[1]):
            yield variant.clause(cause)


def _variant_causes(search: CauseSearch, scores: list[tuple[float, Variant]]) -> Iterator[Cause]:
    """What is lost, crossed or wrongly converted; the distance of each variant is added to the scores."""
    for variant in variants(search.network):
        if variant.is_guess and not search.has_first_rows_closer_to_table(variant.system):
            continue
        columns = search.columns(variant.system)
        scores.append((search.distance(columns), variant))
        if cause := search.cause(variant.kind, variant.text, columns):
            yield variant.clause(_confirmed(search, cause, variant.system))


def _confirmed(search: CauseSearch, cause: Cause, system: System) -> Cause:
    """The cause with what an integration says of its reduction, where that is more."""
    exact = search.cause(cause.kind, cause.text, search.integrated(system))
    return cause if exact is None or exact.reduction < cause.reduction else exact


def _combined_causes(search: CauseSearch, scores: list[tuple[float, Variant]]) -> Iterator[Cause]:
    """What is lost, by integration where steps are too long for it, and together with a coupling.

    Two free choices must each pay their LEAST_REDUCTION.
    """
    for _, variant in sorted(scores, key=lambda score: score[0])[:MOST_COMBINED]:
        exact = search.cause(variant.kind, variant.text, search.integrated(variant.system))
        if exact:
            yield variant.clause(exact)
        coupling, columns = _best_coupling(search, variant.system)
        cause = search.cause(variant.kind, variant.text, columns)
        if coupling is not None and cause and cause.reduction >= LEAST_REDUCTION**2:
            told = variant.clause(cause)
            yield replace(told, text=f"{told.text}; and {coupling.text()}")


def _number_causes(search: CauseSearch) -> Iterator[Cause]:
    """A number that is another one, which is fitted, without a coupling and with those of the known step.

    It moves the columns in proportion to its change, to begin with: that tells which numbers to fit.
    """
    step, system = search.request.step, search.network.system
    orders = {"jacobi": (), "gauss-seidel": tuple(system.parts), "strang": ()}
    held = [] if step is None else [Coupling(how, step, orders[how]) for how in HELD]
    for coupling in (None, *held):
        base = search.columns(system, coupling)
        fits = []
        for number in numbers(search.network):
            change = MOVED * (abs(number.value) or 1.0)
            moved = search.columns(number.system(number.value + change), coupling)
            fits.append((search.secant_move(base, moved, change)[1], number, change))
        for _, number, change in sorted(fits, key=lambda fit: fit[0])[:MOST_FITTED]:
            value, columns = _fitted_number(search, number, change, coupling)
            value = 0.0 if abs(value) < FITTED * abs(number.value) else value
            text = number.seems(value)
            text += f"; and {coupling.text()}" if coupling else ""
            cause = search.cause(number.kind, text, columns)
            if cause and (coupling is None or cause.reduction >= LEAST_REDUCTION**2):
                yield replace(cause, is_certain=cause.reduction >= DECISIVE_REDUCTION)


def _fitted_number(
    search: CauseSearch, number: FreeNumber, change: float, coupling: Coupling | None
) -> tuple[float, Array | None]:
    """The value of a number that comes closest to the table, and what it makes; by integrations once it is close."""
    value, columns = search.fitted(
        lambda x: search.columns(number.system(x), coupling), number.value, change
    )
    if coupling is None and search.cause(number.kind, "", columns):
        exact = search.fitted(
            lambda x: search.integrated(number.system(x)), value, MOVED * (abs(value) or 1.0)
        )
        if exact[1] is not None:
            return exact
    return value, columns


def _delayed(
    search: CauseSearch, wires: Sequence[Wire], delay: float, *, held: bool = False
) -> Array | None:
    """What a system does whose wires bring what their sources were a time [s] earlier."""
    request = search.request
    longest = LONGEST_DELAY * (request.stop - request.start)
    is_sought = SHORTEST_DELAY * request.output_step() <= delay <= longest
    if search.is_over or not is_sought or not wires:
        return None
    columns = late(search.network, request, wires, delay, held=held)
    return None if columns is None else columns / search.scale


def _delayable(search: CauseSearch) -> list[Wire]:
    """The wires whose values can be late."""
    return [
        wire
        for wire, checked in zip(wires_with_total_factors(search.network), search.network.wires)
        if not wire.adds and checked.source.type == checked.target.type == "Real"
    ]


def _step_late_causes(search: CauseSearch) -> Iterator[Cause]:
    """All inputs of a step are what their sources were a step before it began."""
    step = search.request.step or search.request.output_step()
    text = (
        f"inputs come a step late: over each step of {step:.4g} s they hold what their sources were at the start "
        "of the step before"
    )
    if cause := search.cause(
        "late input", text, _delayed(search, _delayable(search), step, held=True)
    ):
        yield cause


def _late_input_causes(search: CauseSearch) -> Iterator[Cause]:
    """Wires whose values arrive a time later, which is fitted, one by one and all together."""
    wires = _delayable(search)
    for some in [[wire] for wire in wires[:MOST_VARIANTS]] + ([wires] if len(wires) > 1 else []):

        def columns(delay: float) -> Array | None:
            return _delayed(search, some, delay) if delay else search.reference  # noqa: B023

        found = search.fitted(columns, 0.0, search.request.output_step())
        one = f"{some[0].target} gets what {some[0].source} was"
        every = "all inputs get what their sources were"
        text = f"{one if len(some) == 1 else every} {found[0]:.4g} s earlier"
        if cause := search.cause("late input", text, found[1]):
            imitation = f"a late input imitates it: {text}"
            yield Variant("late input", text, imitation, search.network.system).clause(cause)


def _fmu_integration_causes(search: CauseSearch) -> Iterator[Cause]:
    """The integrators within the FMUs, where co-simulation tends to something else than model exchange."""
    finest: Array | None = None
    for n in range(MOST_HALVINGS):
        coupling = Coupling("strang", search.request.output_step() / 2**n)
        columns = search.columns(search.network.system, coupling)
        if columns is None:
            break
        finest = columns
    text = "the FMUs integrate themselves in co-simulation less exactly than their model-exchange sides"
    if cause := search.cause("integration in the FMUs", text, finest):
        yield cause
