"""Why a result differs, by running the system again: held inputs, a long step, what was lost or crossed.

Each variant of the system, or of the way it is stepped, makes all columns anew. A cause is named only if they
are at least ten times closer to the table than the reference solution is.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

from ...errors import SetupError
from ...system import Network, System, Wire, connect
from .causes import LEAST_REDUCTION, Cause, ratio, root_mean_square
from .signals import SignalJudgement, Verdict
from .solution import SolutionRequest, integrate_variant, reproduce
from .table import Array

Columns = Mapping[str, Array]
#: Most variants of one kind that are tried: a convention, to limit the time.
MOST_VARIANTS = 30
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
#: A reduction of the difference from which on no other cause is sought: what is left is a thousandth of it.
DECISIVE_REDUCTION = 1e3
#: Share of the difference that a run may be off and serve in place of an integration: a third of what a
#: reduction of LEAST_REDUCTION leaves.
ACCURATE_ENOUGH = 0.03
#: Most halvings of the step until a run is so accurate: 64 times more steps.
MOST_HALVINGS = 6
#: Most variants of the system that are tried together with a coupling that holds inputs.
MOST_COMBINED = 3
HELD = {
    "jacobi": "all parts step at once with inputs that are one step old (Jacobi)",
    "gauss-seidel": "the parts step one after the other with held inputs (Gauss-Seidel)",
    "strang": "the parts step forth and back with held inputs (Strang)",
}


@dataclass(frozen=True)
class Variant:
    """A changed system and the cause that it stands for."""

    kind: str
    text: str
    system: System


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
    _, cause = best_coupling(reproduction, reproduction.system)
    if cause is not None and cause.reduction >= DECISIVE_REDUCTION:
        return [cause]
    causes = [] if cause is None else [cause]
    scores: list[tuple[float, Variant]] = []
    for variant in wrongly_connected(reproduction.network):
        columns = reproduction.columns(variant.system)
        scores.append((reproduction.distance(columns), variant))
        if (cause := reproduction.cause(variant.kind, variant.text, columns)) is not None:
            causes.append(reproduction.confirmed(cause, variant))
            if causes[-1].reduction >= DECISIVE_REDUCTION:
                break
    if not causes:
        for _, variant in sorted(scores, key=lambda score: score[0])[:MOST_COMBINED]:
            coupling, cause = best_coupling(reproduction, variant.system)
            if coupling is not None and cause is not None:
                text = f"{variant.text}; and {coupling.text()}"
                causes.append(replace(cause, kind=variant.kind, text=text))
    if not causes and (cause := less_exact_integration(reproduction)) is not None:
        causes.append(cause)
    return sorted(causes, key=lambda cause: -cause.reduction)


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


def wrongly_connected(network: Network) -> Iterator[Variant]:
    """Systems in which something has been lost, crossed or not converted."""
    for make in (
        _missing_values,
        _missing_inputs,
        _missing_factors,
        _missing_wires,
        _crossed_wires,
    ):
        count = 0
        for variant in make(network):
            try:
                connect(variant.system)
            except SetupError:
                continue
            yield variant
            count += 1
            if count == MOST_VARIANTS:
                break


def _missing_values(network: Network) -> Iterator[Variant]:
    system = network.system
    for name, value in system.start.items():
        start = {other: v for other, v in system.start.items() if other != name}
        text = f"the start value {name} = {value} is lost: the FMU has its own"
        yield Variant("lost start value", text, replace(system, start=start))
    if len(system.start) > 1:
        text = "all start values are lost: the FMUs have their own"
        yield Variant("lost start value", text, replace(system, start={}))
    for part in system.parts:
        start = {n: v for n, v in system.start.items() if network.port(n).part != part}
        if 0 < len(start) < len(system.start) - 1:
            text = f"all start values of {part} are lost: its FMU has its own"
            yield Variant("lost start value", text, replace(system, start=start))


def _missing_inputs(network: Network) -> Iterator[Variant]:
    system = network.system
    driven = {port.name: value for port, value in network.open if port.type == "Real" and value}
    for names in ([name] for name in driven) if len(driven) > 1 else ():
        yield _zeroed(system, names)
    if driven:
        yield _zeroed(system, list(driven))
    for change in system.changes:
        changes = [other for other in system.changes if other != change]
        yield Variant(
            "lost input", f"the change {change!r} is missed", replace(system, changes=changes)
        )
    for name in system.inputs:
        inputs = {other: v for other, v in system.inputs.items() if other != name}
        yield Variant(
            "lost input", f"nothing drives the input {name}", replace(system, inputs=inputs)
        )


def _zeroed(system: System, names: Sequence[str]) -> Variant:
    """Inputs that nothing drives, at 0 in place of the start values of their FMUs."""
    text = f"the open inputs {', '.join(names)} are 0, not the start values of their FMUs"
    return Variant(
        "lost input", text, replace(system, start={**system.start, **dict.fromkeys(names, 0.0)})
    )


def _plain_wires(network: Network) -> list[Wire]:
    """The checked wires with their total factors and offsets."""
    sums = network.sums()
    return [
        Wire(
            c.source.name,
            c.target.name,
            c.factor,
            c.offset,
            converts=False,
            adds=c.target.name in sums,
        )
        for c in network.wires
    ]


def _rewired(network: Network, changed: Mapping[int, Wire | None]) -> System:
    """The system with some of its wires replaced, or left out."""
    wires = [changed.get(k, wire) for k, wire in enumerate(_plain_wires(network))]
    return replace(network.system, wires=[w for w in wires if w is not None], bonds=())


def _missing_factors(network: Network) -> Iterator[Variant]:
    for k, wire in enumerate(_plain_wires(network)):
        ends = f"{wire.source} to {wire.target}"
        if (wire.factor, wire.offset) != (1.0, 0.0):
            text = f"the wire from {ends} lacks its factor {wire.factor:.6g}"
            text += f" and offset {wire.offset:.6g}" if wire.offset else ""
            yield Variant(
                "lost factor", text, _rewired(network, {k: wire._replace(factor=1.0, offset=0.0)})
            )
        if network.wires[k].source.type == "Real":
            opposite = wire._replace(factor=-wire.factor, offset=-wire.offset)
            text = f"the wire from {ends} has the opposite sign"
            yield Variant("lost factor", text, _rewired(network, {k: opposite}))


def _missing_wires(network: Network) -> Iterator[Variant]:
    for k, wire in enumerate(_plain_wires(network)):
        text = f"the wire from {wire.source} to {wire.target} is lost"
        yield Variant("lost wire", text, _rewired(network, {k: None}))


def _crossed_wires(network: Network) -> Iterator[Variant]:
    wires = _plain_wires(network)
    for (i, first), (j, second) in combinations(enumerate(wires), 2):
        if (
            first.source == second.source
            or network.wires[i].source.type != network.wires[j].source.type
        ):
            continue
        changed = {i: first._replace(source=second.source), j: second._replace(source=first.source)}
        text = f"{first.target} and {second.target} are crossed: each is driven by the source of the other"
        yield Variant("wires crossed", text, _rewired(network, changed))


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
