"""Why a result differs, by running the system again: held inputs, a long step, what was lost or crossed.

Each variant of the system, or of the way it is stepped, makes all columns anew. A cause is named only if they
are at least ten times closer to the table than the reference solution is.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from ...system import Network, System, Wire
from ...system.ports import is_continuous_input
from ...system.wires import dotted
from .causes import LEAST_REDUCTION, LONGEST_DELAY, Cause, ratio, root_mean_square
from .connections import DECISIVE_REDUCTION, MOST_VARIANTS, Variant, plain_wires, wrongly_connected
from .continuous import EULER, Method, initial_outputs, integrated, late
from .signals import SignalJudgement, Verdict
from .solution import SolutionRequest, integrate_variant, reproduce
from .table import Array

Columns = Mapping[str, Array]
#: Numbers of communication steps per row that masters are run with: a convention of decimal steps.
STEPS_PER_ROW = (1, 2, 4, 5, 10, 20, 50, 100)
#: Steps that are longer than the time between rows, in rows.
ROWS_PER_STEP = (2, 4, 5, 10)
#: Most steps of a run that only serves to reproduce a cause: limits the time.
MOST_STEPS = 1_000_000
#: Most parts whose stepping orders are all tried: 3! = 6 orders.
MOST_ORDERED_PARTS = 3
#: Shortest steps, in rows, whose rows may be a step early: a convention; of shorter ones a row shows no begin.
EARLY_STEP = 0.5
#: Longest time of the processor for a variant [s]: limits systems that a lost wire makes unstable.
VARIANT_SECONDS = 0.5
#: Longest real time of an integration of a variant [s], likewise.
VARIANT_TIMEOUT = 20.0
#: Share of the difference that a run may be off and serve in place of an integration: a third of what a
#: reduction of LEAST_REDUCTION leaves.
ACCURATE_ENOUGH = 0.03
#: Most halvings of the step until a run is so accurate: 64 times more steps.
MOST_HALVINGS = 6
#: Start values that are fitted of all that are moved a little.
MOST_FITTED = 2
#: Share of a start value by which it is moved: large against the rounding of runs, small against what a run shows.
MOVED = 1e-4
#: Share of a start value below which its fit has ended: the digits that are printed.
FITTED = 1e-6
#: Most variants of the system that are tried together with a coupling that holds inputs.
MOST_COMBINED = 3
#: Delays that are tried until one makes a difference of the right size: four scale it, then it is bisected.
MOST_GUESSES = 12
#: Share by which two differences may differ and be of one size: the search for the closest delay covers twice that.
SAME_SIZE = 0.2
#: Share of the difference that a delay of the right size leaves where it is the cause: one that does not resemble
#: the table at all leaves the root of 2.
RESEMBLES = 0.7
#: Shortest delay that is sought, in rows.
SHORTEST_DELAY = 0.01
HELD = {
    "jacobi": "all parts step at once with inputs that are one step old (Jacobi)",
    "gauss-seidel": "the parts step one after the other with held inputs (Gauss-Seidel)",
    "strang": "the parts step forth and back with held inputs (Strang)",
}


@dataclass(frozen=True)
class Coupling:
    """How a master steps: algorithm, communication step [s], stepping order.

    Rows of `early_parts` show the end of a step at the time of its begin, as some masters write them.
    """

    algorithm: str
    step: float
    order: tuple[str, ...] | None = None
    early_parts: tuple[str, ...] = ()

    def text(self) -> str:
        """The cause as a clause."""
        order = f", in the order {', '.join(self.order)}" if self.order else ""
        early = (
            f"; rows of {', '.join(self.early_parts)} are a step too early"
            if self.early_parts
            else ""
        )
        return f"communication steps of {self.step:.4g} s: {HELD[self.algorithm]}{order}{early}"

    @property
    def kind(self) -> str:
        """The cause in a word: inputs that are a step old, or a step that is too long for its algorithm."""
        return "held inputs" if self.algorithm == "jacobi" else "step too long"


class Reproduction:
    """Reproduces variants of a system and measures how close they come to the columns of a table.

    All columns are measured, so that those that agree tell two causes apart; `explained` are those that differ.
    """

    def __init__(
        self,
        network: Network,
        signals: Sequence[SignalJudgement],
        request: SolutionRequest,
        seconds: float,
    ) -> None:
        self.system, self.network, self.signals = network.system, network, signals
        self.explained = tuple(s.name for s in signals if s.verdict is Verdict.DIFFERS)
        self.request = replace(
            request,
            names=[signal.name for signal in signals],
            timeout=min(request.timeout, VARIANT_TIMEOUT),
        )
        self.deadline = clock.process_time() + seconds
        self.can_run = all(d.coSimulation is not None for d in network.descriptions.values())
        self.fine_step = self._find_fine_step() if self.can_run else None

    def distance(self, columns: Columns | None) -> float:
        """The distance of these columns from those of the table, each as a share of its range."""
        return self.distance_of([signal.name for signal in self.signals], columns)

    def distance_of(self, names: Sequence[str], columns: Columns | None) -> float:
        """The same for some of the columns."""
        if columns is None:
            return math.inf
        squares = [
            (root_mean_square(signal.values - columns[signal.name]) / signal.scale) ** 2
            for signal in self.signals
            if signal.name in names
        ]
        return math.sqrt(sum(squares) / len(squares))

    def deviation(self, columns: Columns | None) -> float:
        """The distance of these columns from those of the reference solution, likewise."""
        if columns is None:
            return math.inf
        squares = [
            (root_mean_square(signal.reference - columns[signal.name]) / signal.scale) ** 2
            for signal in self.signals
        ]
        return math.sqrt(sum(squares) / len(squares))

    @property
    def reference(self) -> dict[str, Array]:
        """The columns of the reference solution."""
        return {signal.name: signal.reference for signal in self.signals}

    def cause(self, kind: str, text: str, columns: Columns | None) -> Cause | None:
        """The cause that makes these columns, None if they are not close enough to those of the table."""
        better = ratio(self.distance(self.reference), self.distance(columns))
        return Cause(kind, text, better, self.explained) if better >= LEAST_REDUCTION else None

    def columns(self, system: System) -> Columns | None:
        """What a changed system does without a coupling error that matters."""
        if clock.process_time() > self.deadline:
            return None
        if self.fine_step is not None:
            return reproduce(system, self.request, step=self.fine_step, seconds=VARIANT_SECONDS)
        return integrate_variant(system, self.request)

    def confirmed(self, cause: Cause, variant: Variant) -> Cause:
        """The cause with what an integration says of its reduction, where that is more."""
        columns = integrate_variant(variant.system, self.request)
        exact = self.cause(variant.kind, variant.text, columns)
        return cause if exact is None or exact.reduction < cause.reduction else exact

    def coupled(self, system: System, coupling: Coupling, delay: float = 0.0) -> Columns | None:
        """What a system does if a master steps it like this, at times that are later by a delay [s]."""
        span = self.request.stop - self.request.start
        if (
            not self.can_run
            or span / coupling.step > MOST_STEPS
            or clock.process_time() > self.deadline
        ):
            return None
        return reproduce(
            system,
            replace(self.request, times=self.request.times + delay),
            step=coupling.step,
            algorithm=coupling.algorithm,
            order=coupling.order,
            seconds=VARIANT_SECONDS,
        )

    def integrated(self, method: Method, step: float) -> Columns | None:
        """What a method makes of the whole system with a step [s]."""
        if clock.process_time() > self.deadline:
            return None
        return integrated(self.system, self.request, method, step)

    def late(
        self,
        wires: Sequence[Wire],
        delay: float,
        initial: Mapping[str, float],
        *,
        held: bool = False,
    ) -> Columns | None:
        """What the system does if these wires bring their values a time [s] later."""
        if clock.process_time() > self.deadline:
            return None
        return late(self.network, self.request, wires, delay, initial, held=held)

    def _find_fine_step(self) -> float | None:
        """A step with which runs are accurate enough in place of integrations, None if there is none."""
        wanted = ACCURATE_ENOUGH * self.distance(self.reference)
        step = self.request.output_step()
        for _ in range(MOST_HALVINGS):
            columns = reproduce(self.system, self.request, step=step, seconds=VARIANT_SECONDS)
            if columns is None:
                return None
            distances = [
                root_mean_square(columns[signal.name] - signal.reference) / signal.scale
                for signal in self.signals
            ]
            if max(distances) <= wanted:
                return step
            step *= 0.5
        return None


def variant_causes(reproduction: Reproduction) -> list[Cause]:
    """The causes that explain the columns of a table, the best first."""
    causes: list[Cause] = []
    scores: list[tuple[float, Variant]] = []
    finders: tuple[Callable[[], Iterator[Cause]], ...] = (
        lambda: _coupling_causes(reproduction),
        lambda: step_late_causes(reproduction),
        lambda: euler_causes(reproduction),
        lambda: _connection_causes(reproduction, scores),
        lambda: start_causes(reproduction),
        lambda: late_causes(reproduction),
    )
    for find in finders:
        for cause in find():
            causes.append(cause)
            if cause.reduction >= DECISIVE_REDUCTION:
                return sorted(causes, key=lambda cause: -cause.reduction)
    if not causes:
        causes.extend(_combined_causes(reproduction, scores))
    if not causes and (inexact := less_exact_integration(reproduction)) is not None:
        causes.append(inexact)
    return sorted(causes, key=lambda cause: -cause.reduction)


def _coupling_causes(reproduction: Reproduction) -> Iterator[Cause]:
    _, cause = best_coupling(reproduction, reproduction.system)
    if cause is not None:
        yield cause


def _connection_causes(
    reproduction: Reproduction, scores: list[tuple[float, Variant]]
) -> Iterator[Cause]:
    """What is lost or crossed; the distance of each variant is added to the scores."""
    for variant in wrongly_connected(reproduction.network):
        columns = reproduction.columns(variant.system)
        scores.append((reproduction.distance(columns), variant))
        cause = reproduction.cause(variant.kind, variant.text, columns)
        if cause is not None:
            yield variant.clause(reproduction.confirmed(cause, variant))


def _combined_causes(
    reproduction: Reproduction, scores: list[tuple[float, Variant]]
) -> Iterator[Cause]:
    """What is lost, together with a coupling: two free choices, so that each must pay its LEAST_REDUCTION."""
    for _, variant in sorted(scores, key=lambda score: score[0])[:MOST_COMBINED]:
        coupling, cause = best_coupling(reproduction, variant.system)
        if coupling is not None and cause is not None and cause.reduction >= LEAST_REDUCTION**2:
            told = variant.clause(cause)
            yield replace(told, text=f"{told.text}; and {coupling.text()}")


def euler_causes(reproduction: Reproduction) -> Iterator[Cause]:
    """Euler's methods over the whole system, with the steps of a row and shorter ones."""
    before = reproduction.distance(reproduction.reference)
    request = reproduction.request
    for name, method in EULER.items():
        best: tuple[float, float, Columns] | None = None
        steps = [request.output_step() / n for n in STEPS_PER_ROW]
        for step in [request.step, *steps] if request.step else steps:
            columns = reproduction.integrated(method, step)
            if columns is None:
                continue
            distance = reproduction.distance(columns)
            if best is None or distance < best[0]:
                best = distance, step, columns
            # A shorter step makes less of a difference than this one.
            if (
                before >= DECISIVE_REDUCTION * distance
                or reproduction.deviation(columns) < 0.5 * before
            ):
                break
        if best is not None:
            text = f"{name} with steps of {best[1]:.4g} s integrates the whole system"
            cause = reproduction.cause("step too long", text, best[2])
            if cause is not None and cause.reduction < DECISIVE_REDUCTION:
                text = f"{name} over the whole system with steps of {best[1]:.4g} s imitates it"
                cause = replace(cause, text=text, is_certain=False)
            if cause is not None:
                yield cause


def _delayable(reproduction: Reproduction) -> tuple[list[Wire], dict[str, float]]:
    """The wires that can be late, and what their sources are at the start; none without model exchange."""
    network = reproduction.network
    initial = initial_outputs(network, reproduction.request) or {}
    wires = [
        wire
        for wire in plain_wires(network)
        if not wire.adds
        and dotted(wire.source) in initial
        and is_continuous_input(network.port(dotted(wire.target)))
    ]
    return wires, initial


def step_late_causes(reproduction: Reproduction) -> Iterator[Cause]:
    """All inputs of a step are what their sources were a step before its begin."""
    step = reproduction.request.step or reproduction.request.output_step()
    wires, initial = _delayable(reproduction)
    if not wires:
        return
    columns = reproduction.late(wires, step, initial, held=True)
    text = (
        f"inputs come a step late: over each step of {step:.4g} s they hold what their sources were at the begin "
        "of the step before"
    )
    cause = reproduction.cause("late input", text, columns)
    if cause is not None:
        yield cause


def start_causes(reproduction: Reproduction) -> Iterator[Cause]:
    """A start value that is another number, which is fitted, without a coupling and with those of the known step.

    A value moves the columns in proportion to its change, to begin with: that tells which values to fit (Gauss-Newton).
    """
    system, step = reproduction.system, reproduction.request.step
    held = [
        Coupling(algorithm, step, order)
        for algorithm, order in (("jacobi", None), ("gauss-seidel", tuple(system.parts)), ("strang", None))
        if step is not None
    ]  # fmt: skip
    for coupling in (None, *held):

        def columns(
            name: str, value: float, coupling: Coupling | None = coupling
        ) -> Columns | None:
            changed = replace(system, start={**system.start, name: value})
            if coupling is None:
                return reproduction.columns(changed)
            return reproduction.coupled(changed, coupling)

        values = {n: float(v) for n, v in system.start.items() if isinstance(v, float)}
        fits = [fit for n, v in values.items() if (fit := _moved(reproduction, columns, n, v))]
        for _, name, value in sorted(fits)[:MOST_FITTED]:
            for _ in range(MOST_GUESSES):
                closer = _moved(reproduction, columns, name, value)
                if closer is None or abs(closer[2] - value) <= FITTED * abs(value):
                    break
                value = closer[2]
            if abs(value) < FITTED * abs(values[name]):
                value = 0.0
            text = f"the start value {name} seems to be {value:.6g}, not {values[name]:.6g}"
            text += f"; and {coupling.text()}" if coupling else ""
            cause = reproduction.cause("wrong start value", text, columns(name, value))
            if cause is not None and (coupling is None or cause.reduction >= LEAST_REDUCTION**2):
                yield replace(cause, is_certain=cause.reduction >= DECISIVE_REDUCTION)


def _moved(
    reproduction: Reproduction,
    columns: Callable[[str, float], Columns | None],
    name: str,
    value: float,
) -> tuple[float, str, float] | None:
    """What a start value leaves of the difference once it is moved as fits best, its name, and where to."""
    change = MOVED * (abs(value) or 1.0)
    before, after = columns(name, value), columns(name, value + change)
    if before is None or after is None:
        return None
    rest = np.concatenate([(s.values - before[s.name]) / s.scale for s in reproduction.signals])
    slope = np.concatenate(
        [(after[s.name] - before[s.name]) / (change * s.scale) for s in reproduction.signals]
    )
    square = float(slope @ slope)
    if not (np.isfinite(rest).all() and math.isfinite(square) and square > 0.0):
        return None
    move = float(slope @ rest) / square
    return root_mean_square(rest - move * slope), name, value + move


def late_causes(reproduction: Reproduction) -> Iterator[Cause]:
    """Wires whose values arrive a transport time later, one by one and all together.

    The time is the one that makes as large a difference as the table has, then the one that comes closest to it.
    """
    network = reproduction.network
    wires, initial = _delayable(reproduction)
    groups = [[wire] for wire in wires[:MOST_VARIANTS]] + ([wires] if len(wires) > 1 else [])
    for group in groups:

        def delayed(delay: float) -> Columns | None:
            return reproduction.late(group, delay, initial)  # noqa: B023

        delay = _delay_of_size(reproduction, delayed)
        if delay is None:
            continue
        delay = _closest_delay(reproduction, delayed, delay)
        if len(group) == 1:
            text = f"{group[0].target} gets what {group[0].source} was {delay:.4g} s earlier"
        else:
            text = f"all inputs get what their sources were {delay:.4g} s earlier"
        cause = reproduction.cause("late input", text, delayed(delay))
        if cause is not None:
            yield Variant("late input", text, network.system, text).clause(cause)


def _delay_of_size(
    reproduction: Reproduction, delayed: Callable[[float], Columns | None]
) -> float | None:
    """The delay [s] that makes a difference as large as that of the table; None if it does not resemble it."""
    request = reproduction.request
    before = reproduction.distance(reproduction.reference)
    longest = LONGEST_DELAY * (request.stop - request.start)
    delay, least, most = min(request.output_step(), longest), 0.0, math.inf
    for _ in range(MOST_GUESSES):
        columns = delayed(delay)
        size = reproduction.deviation(columns)
        if abs(size - before) <= SAME_SIZE * before:
            return delay if reproduction.distance(columns) <= RESEMBLES * before else None
        if size < before:
            least = delay
        else:
            most = delay
        # In proportion to it until it is bracketed; beyond, a difference may grow exponentially with the delay.
        if least > 0.0 and most < math.inf:
            delay = math.sqrt(least * most)
        elif size > 0.0:
            delay *= min(10.0, max(0.1, before / size))
        if size == 0.0 or not SHORTEST_DELAY * request.output_step() <= delay <= longest:
            return None
    return None


def _closest_delay(
    reproduction: Reproduction, delayed: Callable[[float], Columns | None], delay: float
) -> float:
    """The delay [s] near this one that comes closest to the table."""
    from scipy.optimize import minimize_scalar

    bounds = ((1.0 - 2.0 * SAME_SIZE) * delay, (1.0 + 2.0 * SAME_SIZE) * delay)
    found = minimize_scalar(
        lambda d: min(reproduction.distance(delayed(d)), 1e9), bounds=bounds, method="bounded",
        options={"xatol": 1e-5 * delay},
    )  # fmt: skip
    return float(found.x)


def best_coupling(
    reproduction: Reproduction, system: System
) -> tuple[Coupling | None, Cause | None]:
    """The coupling of a system that comes closest to the table, and the cause it is if it is close enough."""
    best: tuple[float, Coupling, Columns] | None = None
    before = reproduction.distance(reproduction.reference)
    for coupling, columns in _coupled_columns(reproduction, system):
        distance = reproduction.distance(columns)
        if best is None or distance < best[0]:
            best = distance, coupling, columns
            if before >= DECISIVE_REDUCTION * distance:
                break
    if best is None:
        return None, None
    _, coupling, columns = best
    return coupling, reproduction.cause(coupling.kind, coupling.text(), columns)


def _coupled_columns(
    reproduction: Reproduction, system: System
) -> Iterator[tuple[Coupling, Columns]]:
    """What each coupling makes of a system; at last those whose rows are a step early for some of the parts."""
    shortest = reproduction.request.output_step() * EARLY_STEP
    coarse: list[tuple[Coupling, Columns]] = []
    for coupling in couplings(reproduction):
        columns = reproduction.coupled(system, coupling)
        if columns is not None:
            yield coupling, columns
            coarse += [(coupling, columns)] if coupling.step >= shortest else []
    for coupling, columns in coarse:
        later = reproduction.coupled(system, coupling, delay=coupling.step)
        if later is None:
            continue
        early, mixed = [], dict(columns)
        for part in system.parts:
            names = [s.name for s in reproduction.signals if s.name.startswith(f"{part}.")]
            if names and reproduction.distance_of(names, later) < reproduction.distance_of(
                names, columns
            ):
                early.append(part)
                mixed |= {name: later[name] for name in names}
        if early:
            yield replace(coupling, early_parts=tuple(early)), mixed


def couplings(reproduction: Reproduction) -> Iterator[Coupling]:
    """The ways in which masters step, with steps that fit the time between rows."""
    if not reproduction.network.wires and not reproduction.network.inputs:
        return
    spacing = reproduction.request.output_step()
    steps = [spacing / n for n in STEPS_PER_ROW] + [spacing * n for n in ROWS_PER_STEP]
    if reproduction.request.step is not None:
        steps.insert(0, reproduction.request.step)
    parts = tuple(reproduction.system.parts)
    orders = list(permutations(parts)) if len(parts) <= MOST_ORDERED_PARTS else [parts, parts[::-1]]
    for step in dict.fromkeys(steps):
        if reproduction.request.start + step > reproduction.request.stop:
            continue
        yield Coupling("jacobi", step)
        for order in orders:
            yield Coupling("gauss-seidel", step, order)
        yield Coupling("strang", step)


def less_exact_integration(reproduction: Reproduction) -> Cause | None:
    """The integrators within the FMUs, where co-simulation tends to something else than model exchange."""
    step = reproduction.request.output_step()
    finest: Columns | None = None
    for _ in range(MOST_HALVINGS if reproduction.can_run else 0):
        columns = reproduce(
            reproduction.system, reproduction.request, step=step, seconds=VARIANT_SECONDS
        )
        if columns is None or clock.process_time() > reproduction.deadline:
            break
        finest, step = columns, 0.5 * step
    text = "the FMUs integrate themselves in co-simulation less exactly than their model-exchange sides"
    return reproduction.cause("integration in the FMUs", text, finest)
