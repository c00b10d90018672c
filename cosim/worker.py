"""Members of an ensemble, one after the other, by one instance of each FMU, as it is shown that this may be done."""

from __future__ import annotations

import ctypes
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from .engine.control import Adaptive
from .engine.energy import NOTICEABLE, energies, is_noticeable
from .engine.process_guard import ProcessGuard
from .engine.settings import RunSettings, StepAndStop
from .engine.snapshot import SystemState
from .engine.system_instance import SystemInstance
from .ensemble import Array, Case, Cases, Ensemble, Facts, Numbers
from .errors import SetupError
from .series import TIME
from .simulation import Simulation, run_setup
from .system import Network, Value, connect, declared_start
from .system.start_values import checked_start

#: Members of a chunk. Chosen: of members without rows, it is the work of a tenth of a second.
MOST_IN_CHUNK = 4096
#: Time [s] after which a worker gives what it has done of a chunk, so that a kill costs no more. Chosen: a person waits so long.
LONGEST_BLOCK = 1.0
#: Time [s] between two calls of who is told of the progress. Chosen: a person notices a tenth of a second.
PATIENCE = 0.05
#: In place of the number of a member: none runs, or instances are freed.
NOBODY, CLOSING = -1, -2
#: Said of an ensemble whose instances cannot be used again.
FRESH = "every run has new instances: not all FMUs are known to be as new after a reset"


class Chunk(NamedTuple):
    """Members that one worker runs one after the other, each for its span; rows of the same distance [s]."""

    numbers: Numbers
    spans: Sequence[StepAndStop]
    output_step: float | None

    def part(self, which: Numbers) -> Chunk:
        """The members at these positions."""
        return self._replace(
            numbers=self.numbers[which], spans=[self.spans[k] for k in which.tolist()]
        )


#: What a worker makes of a chunk: its ensemble, or one with figures in place of rows.
Evaluate = Callable[["Worker", Cases, Chunk, Callable[[int], None]], Ensemble]


@dataclass
class Batch:
    """Members that wait for workers, and what workers look at meanwhile.

    `report` is called with the share that is done; `interrupts` fills with signals that ask to stop; `timeout` is the
    longest time that a worker in another process may be silent [s]; `evaluate` is what a worker does with a chunk.
    """

    network: Network
    settings: RunSettings
    cases: Cases
    waiting: list[Chunk]
    jobs: int
    report: Callable[[float], None]
    interrupts: Sequence[int]
    timeout: float
    evaluate: Evaluate

    def __post_init__(self) -> None:
        self.members = sum(len(chunk.numbers) for chunk in self.waiting)

    def return_undone(self, chunk: Chunk, block: Ensemble) -> None:
        """Let the members wait that a worker has not done of a chunk."""
        rest = np.flatnonzero(~np.isin(chunk.numbers, block.members))
        if len(rest):
            self.waiting.insert(0, chunk.part(rest))


@dataclass(frozen=True)
class Member:
    """What a run by the driver gives: rows, shape (rows, columns), why it failed, warnings, energy over bonds [J]."""

    rows: Array
    reason: str
    warnings: Sequence[str] = ()
    energy: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    facts: Facts | None = None


def with_case(network: Network, case: Case) -> Network:
    """A checked system with other start values, or those of a state; raises SetupError for those that it cannot have."""
    if not isinstance(case, Case):
        raise SetupError(
            f"a run takes a Case, not a {type(case).__name__}: write Case(start) for start values by name, "
            "or Case(begin=state) for the state that run_until hands out"
        )
    if case.begin is not None:
        if not isinstance(case.begin, SystemState):
            raise SetupError(
                "begin must be the state that run_until hands out: write begin=paused.state"
            )
        if case.start:
            names = ", ".join(case.start)
            raise SetupError(
                f"a case has start values or a begin, and this one has both: leave out start ({names}), "
                "since the state brings all values"
            )
        theirs, ours = (", ".join(sorted(x)) for x in (case.begin.parts, network.descriptions))
        if theirs != ours:
            raise SetupError(f"the state has the parts {theirs}; this system has {ours}")
        return _with_start_values_of(network, case.begin)
    if not case.start:
        return network
    return connect(replace(network.system, start={**network.system.start, **case.start}))


def _with_start_values_of(network: Network, state: SystemState) -> Network:
    """The system with the start values of a state; raises SetupError for one of its own that the state does not have."""
    begun = connect(replace(network.system, start=state.start_values))
    begun_with = {port.name: value for port, value in begun.start}
    for name, value in network.system.start.items():
        port, ours = checked_start(network, network.port(name), value)
        theirs = begun_with.get(port.name, declared_start(port.variable))
        if ours == theirs or state.system_start.get(name) == value:
            continue
        change = f"changes=['at {state.time!r} s {name} = {value!r}']"
        can_change = port.variable.causality == "input" or port.variable.variability == "tunable"
        raise SetupError(
            f"{name} = {ours!r} in the system, and {theirs!r} at the start of the run that handed the state out: "
            f"leave it out{f', or change it with {change}' if can_change else ''}"
        )
    return begun


@dataclass
class Alike:
    """What members with the same fixed steps have in common, and what the last of them has said of its run."""

    settings: RunSettings
    setup: dict[str, Any] | None = None
    facts: Facts | None = None
    breaks: Sequence[tuple[float, float]] = ()


class Worker:
    """Runs members one after the other, by instances that begin again where this is known to give the same bits.

    `member` is where others can see the number of the member that runs, NOBODY or CLOSING. `abandoned` says that an FMU may not
    be called any more.
    """

    def __init__(self, network: Network, settings: RunSettings, member: Any = None) -> None:
        self.network, self.settings = network, settings
        self._member = ctypes.c_longlong(NOBODY) if member is None else member
        self.interrupts: Sequence[int] = ()
        self.columns = (TIME, *(port.column for port in settings.ports(network)))
        self._instance = SystemInstance(network, settings)
        self._deadline = 0.0
        self._names: list[str] = []
        self._begins: Network | None = None
        self._varies_inputs = False
        self._known: dict[tuple[StepAndStop, float | None], Alike] = {}
        self.abandoned = False

    def close(self) -> None:
        """Free the instances."""
        self._member.value = CLOSING
        self._instance.close()
        self._member.value = NOBODY

    def run(
        self, cases: Cases, chunk: Chunk, progress: Callable[[int], None] = lambda _: None
    ) -> Ensemble:
        """The members of a chunk, or as many as it does in LONGEST_BLOCK, until it is abandoned or the user interrupts.

        `progress` is called with how many are done.
        """
        self._deadline = clock.monotonic() + LONGEST_BLOCK
        if self._names != cases.names:
            self._names, self._begins, self._known = cases.names, None, {}
            self._varies_inputs = any(p.name in self._names for p, _ in self.network.inputs)
        self._instance.process = process = ProcessGuard()
        values, wrong = cases.checked(self.network, chunk.numbers.tolist())
        done: list[Member] = []
        told = clock.monotonic()
        for k, row in enumerate(values):
            if self.abandoned or self.interrupts or (done and self.is_late()):
                break
            done.append(
                Member(self._no_rows, wrong[k]) if k in wrong else self._run(cases, chunk, k, row)
            )
            if clock.monotonic() > told + PATIENCE:
                told = clock.monotonic()
                progress(len(done))
        progress(len(done))
        process.restore()
        return self._ensemble(cases, chunk.numbers[: len(done)], done)

    def is_late(self) -> bool:
        """Whether it has worked so long that it gives what is done."""
        return clock.monotonic() > self._deadline

    @property
    def _no_rows(self) -> Array:
        return np.empty((0, len(self.columns)))

    def _run(self, cases: Cases, chunk: Chunk, k: int, values: tuple[Value, ...]) -> Member:
        """Run the member at position k of a chunk, with these values of the cases."""
        began, instance, number = clock.perf_counter(), self._instance, int(chunk.numbers[k])
        self._member.value = CLOSING
        instance.rest()
        self._member.value = number
        try:
            if self._begins is None or self._varies_inputs:
                self._begins = with_case(self.network, cases.case(number))
            alike = self._alike(chunk.spans[k], chunk.output_step)
            instance.begin(self._begins, alike.settings, case=dict(zip(self._names, values)))
        except SetupError as error:
            self.abandoned = instance.is_abandoned
            return Member(self._no_rows, str(error))
        if alike.setup is None:
            alike.setup = run_setup(instance)
        simulation = Simulation(instance, began, setup=alike.setup)
        simulation.drive(self.interrupts)
        self.abandoned = instance.is_abandoned
        return Member(
            np.frombuffer(simulation.recorder.rows).reshape(-1, len(self.columns)),
            "" if simulation.status == "complete" else simulation.reason,
            simulation.warnings(),
            {bond: energies(sides) for bond, sides in instance.bonds.items()},
            self._facts(alike, simulation),
        )

    def _alike(self, span: StepAndStop, output_step: float | None) -> Alike:
        """What is known of members with such fixed steps; of one with others, nothing."""
        if isinstance(span.step, Adaptive):
            return Alike(self._settings_of(span, output_step))
        key = span, output_step
        if key not in self._known:
            self._known[key] = Alike(self._settings_of(span, output_step))
        return self._known[key]

    def _facts(self, alike: Alike, simulation: Simulation) -> Facts:
        """What a run says of itself, shared with the one before it that is alike if it says the same."""
        breaks, known = simulation.driver.breaks, alike.facts
        ran = {"reason": simulation.reason, **simulation.driver.statistics()}
        if (
            known is None
            or breaks != alike.breaks
            or any(known.provenance[name] != value for name, value in ran.items())
        ):
            shown = {name: self._showing(name) for name in self._names}
            intervals = np.array(breaks, float).reshape(-1, 2)
            alike.facts = known = Facts(simulation.provenance(), intervals, shown)
            alike.breaks = breaks
        return known

    def _settings_of(self, span: StepAndStop, output_step: float | None) -> RunSettings:
        """Those of a member; the FMUs' tolerance is that of its adaptive steps, unless the user has given one."""
        step, given = span.step, self.settings.tolerance
        if isinstance(self.settings.step, Adaptive) and given == self.settings.step.tolerance:
            given = None
        if given is None and isinstance(step, Adaptive):
            given = step.tolerance
        return replace(
            self.settings, step=step, stop=span.stop, output_step=output_step, tolerance=given
        )

    def _showing(self, name: str) -> list[tuple[str, str]]:
        """The parameters that show a start value, aliases too, with their part."""
        port = self.network.port(name)
        variables = self.network.descriptions[port.part].modelVariables
        return [
            (port.part, v.name)
            for v in variables
            if v.causality == "parameter"
            and v.valueReference == port.variable.valueReference
            and v.type == port.variable.type
        ]

    def _ensemble(self, cases: Cases, numbers: Numbers, done: Sequence[Member]) -> Ensemble:
        """What is known of these members."""
        n, most = len(done), max((len(member.rows) for member in done), default=0)
        rows, warnings = np.empty((n, most, len(self.columns))), dict[str, list[int]]()
        energy: dict[str, Array] = {}
        for k, member in enumerate(done):
            rows[k, : len(member.rows)], rows[k, len(member.rows) :] = member.rows, np.nan
            for text in member.warnings:
                warnings.setdefault(text, []).append(int(numbers[k]))
            for bond, carried in member.energy.items():
                energy.setdefault(bond, np.full((n, 3), np.nan))[k] = carried
        for bond, values in energy.items():
            text = (
                f"bond {bond}: the coupling created or removed more than {NOTICEABLE:.0%} of the energy "
                "carried: use smaller steps or another algorithm; see diagnose"
            )
            if len(where := numbers[is_noticeable(*values.T)]):
                warnings[text] = where.tolist()
        return Ensemble(
            cases, numbers, self.columns, rows, np.array([len(m.rows) for m in done], np.int64),
            [m.reason for m in done], warnings, energy, [m.facts for m in done],
            () if self._instance.is_reset_trusted else (FRESH,),
        )  # fmt: skip
