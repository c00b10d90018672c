"""A system and how it is run: what follows from both, and what makes no run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real

from ..errors import SetupError
from ..fmu.times import coincide
from ..names import only
from ..series import TIME, Column
from ..system import (
    STATE,
    VARIABLE_STEP,
    Network,
    Port,
    connect,
    declared_start,
    is_continuous_input,
    parts_without,
    require_cosimulation,
)
from ..system.graph import algebraic_loops, describe_loop, stepping_order
from ..system.inputs import parse_change
from ..system.start_values import checked_start
from ..units import in_unit
from .algorithms import REGISTRY, find_algorithm
from .changes import continuous_profiles, inputs_before
from .control import Adaptive
from .energy import Bond, find_bonds
from .initialise import outputs_read_each_step
from .settings import LEFT_OVER, RunSettings
from .snapshot import Case, LiveState, SystemState

#: Sub-steps of a part in a communication step. A convention: more than a million are a mistake.
MOST_SUBSTEPS = 1 << 20
#: Degree of the inputs' polynomials. A convention: extrapolation of a higher degree amplifies every rounding error.
HIGHEST_INPUT_DEGREE = 8


@dataclass(frozen=True)
class Setup:
    """A checked system and how it is run, with what follows from both; its methods raise SetupError before a run.

    `of` refuses what cannot be run; `Setup` itself only settings that are of no kind to be checked.
    """

    network: Network
    settings: RunSettings
    #: What is recorded, whatever the case and the span.
    ports: list[Port] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        _require_types(self.settings)
        require_cosimulation(self.network.descriptions, self.network.system.parts)
        if not self.ports:
            self.ports.extend(self.settings.ports(self.network))
        self.settings.check()
        find_algorithm(self.settings.algorithm)

    @classmethod
    def of(cls, network: Network, settings: RunSettings) -> Setup:
        """The same, where it can be run."""
        setup = cls(network, settings)
        for problem in setup.problems():
            raise SetupError(problem)
        return setup

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """What a run records, the time first."""
        return (TIME, *(port.column for port in self.ports))

    @cached_property
    def sequence(self) -> list[str]:
        """The parts in their stepping order."""
        return stepping_order(self.network, self.settings.order)

    @cached_property
    def stateless(self) -> list[str]:
        """The parts that cannot save their state."""
        return parts_without(self.network.descriptions, STATE)

    @cached_property
    def fixed(self) -> list[str]:
        """The parts that cannot vary their step."""
        return parts_without(self.network.descriptions, VARIABLE_STEP)

    @cached_property
    def bonds(self) -> list[Bond]:
        """The power bonds."""
        return find_bonds(self.network)

    def with_span(self, step: float | Adaptive, stop: float, output_step: float | None) -> Setup:
        """The same with another step, stop and distance of rows [s]."""
        changed = replace(self.settings, step=step, stop=stop, output_step=output_step)
        if changed == self.settings:
            return self
        setup = replace(self, settings=changed)
        for problem in setup.wrong_times():
            raise SetupError(problem)
        return setup

    def with_case(self, case: Case) -> Setup:
        """The same with other start values, or those of a state with which it can begin."""
        if not isinstance(case, Case):
            raise SetupError(
                f"a run takes a Case, not a {type(case).__name__}: write Case(start) for start values by name, "
                "or Case(begin=state) for the state that run_until hands out"
            )
        if case.begin is not None:
            if not isinstance(case.begin, SystemState) or not case.begin.is_sound:
                raise SetupError(
                    "begin must be the state that run_until hands out: write begin=paused.state"
                )
            if case.start:
                names = ", ".join(case.start)
                raise SetupError(
                    f"a case has start values or a begin, and this one has both: leave out start ({names}), "
                    "since the state brings all values"
                )
            parts = case.begin.parts, self.network.descriptions
            theirs, ours = (", ".join(sorted(names)) for names in parts)
            if theirs != ours:
                raise SetupError(f"the state has the parts {theirs}; this system has {ours}")
            setup = replace(self, network=_with_start_values_of(self.network, case.begin))
            setup.require_begin(case.begin)
            return setup
        if not case.start:
            return self
        system = self.network.system
        return replace(self, network=connect(replace(system, start={**system.start, **case.start})))

    def require_begin_of_many(self, case: Case) -> None:
        """Raise SetupError for a state with which several runs cannot begin."""
        self.with_case(case)
        if case.begin is not None and case.begin.live:
            raise SetupError(
                f"the state of {', '.join(case.begin.live)} cannot be serialised, so that it can begin one run: "
                "write run(Case(begin=state))"
            )

    def problems(self) -> Iterator[str]:
        """The reasons why the system cannot be run with these settings, a sentence each."""
        yield from self._wrong_settings()
        yield from _single_instances(self.network)
        yield from self._missing_for_algorithm()
        if isinstance(self.settings.step, Adaptive):
            yield from self._missing_for_control(self.settings.step)
        yield from self.wrong_times()

    def wrong_times(self) -> Iterator[str]:
        """The reasons why steps, changes and inputs over time make no run up to the stop."""
        network, settings = self.network, self.settings
        span = settings.stop - settings.start
        if not isinstance(settings.step, Adaptive):
            if settings.step > span * (1.0 + LEFT_OVER):
                yield f"step = {settings.step!r} s must be at most the time from start to stop, {span!r} s"
            yield from self._times_where_no_step_ends()
        for text in network.system.changes:
            time, _, _ = parse_change(text)
            if not settings.start <= time <= settings.stop:
                ends = f"from {settings.start!r} to {settings.stop!r} s"
                yield f"change {text!r}: {time!r} s is not in the run, {ends}"
        for port, profile in network.inputs:
            try:
                profile.at(settings.start)
            except SetupError as error:
                yield str(error)
            if lack := profile.lacks(settings.start, settings.stop):
                yield f"{port.name}: its table {lack}"

    def require_pause(self, begin: float, until: float) -> None:
        """Raise SetupError if there is no state at a time [s] with which another run can go on, after a run began [s]."""
        settings = self.settings
        if not isinstance(until, float | Real) or not begin < until <= settings.stop:
            raise SetupError(
                f"run_until({until!r}) must get a time in s, after the start at {begin!r} s and at most "
                f"stop = {settings.stop!r} s"
            )
        for name in self.stateless:
            raise SetupError(f"{name} cannot save its state: its FMU does not have {STATE}")
        self._require_rows_at_steps()

    def _require_rows_at_steps(self) -> None:
        """Raise SetupError where rows lie between steps, which are made of rows of two runs if one goes on with the other."""
        settings = self.settings
        if settings.steps_per_row(self.columns[1:]) is None:
            raise SetupError(
                f"output_step = {settings.output_step!r} s: rows between steps cannot be continued by another run: "
                "write output_step=None"
            )

    def require_begin(self, state: SystemState) -> None:
        """Raise SetupError for a state with which a run of this system cannot begin."""
        network, settings = self.network, self.settings
        start, stop, time = settings.start, settings.stop, state.time
        for name, part in state.parts.items():
            if network.descriptions[name].guid != part.guid:
                raise SetupError(f"{name}: the state is of another FMU, with the GUID {part.guid}")
        if not start <= time < stop:
            raise SetupError(
                f"the run from start = {start!r} s to stop = {stop!r} s must contain the state at t = {time!r} s: "
                f"give {'a stop after it' if start <= time else f'start={state.start!r}'}"
            )
        if not isinstance(settings.step, Adaptive):
            if settings.steps_until(time) is None:
                raise SetupError(
                    f"the state is at t = {time!r} s, where no step of {settings.step!r} s from start = {start!r} s "
                    f"ends: write start={time!r}"
                )
            if settings.step != state.step and settings.step > (stop - time) * (1.0 + LEFT_OVER):
                raise SetupError(
                    f"step = {settings.step!r} s must be at most the time from the state at t = {time!r} s to "
                    f"stop = {stop!r} s"
                )
        if stop > state.stop_told:
            raise SetupError(
                f"stop = {stop!r} s must be at most {state.stop_told!r} s, which FMUs were told before the state"
            )
        for name, part in state.parts.items():
            if isinstance(part.fmu, LiveState) and part.fmu.is_gone:
                raise SetupError(
                    f"{name}: its FMU does not have canSerializeFMUstate, so that its state can begin one run, while the "
                    "`Prepared` that handed it out is open: hand it out again by run_until"
                )
        self._require_rows_at_steps()
        _require_held_values(network, state)

    def _wrong_settings(self) -> Iterator[str]:
        """Settings out of range, or that name no part."""
        network, settings = self.network, self.settings
        parts, order, tolerance = (
            ", ".join(network.descriptions),
            settings.order,
            settings.tolerance,
        )
        if order is not None and sorted(order) != sorted(network.descriptions):
            yield f"order {list(order)} must name each of {parts} once"
        if tolerance is not None and not tolerance > 0.0:
            yield f"tolerance = {tolerance!r} must be above 0"
        if not 0 <= settings.input_order <= HIGHEST_INPUT_DEGREE:
            yield (
                f"input_order = {settings.input_order!r} must be at least 0 and at most "
                f"{HIGHEST_INPUT_DEGREE}"
            )
        for name, count in settings.substeps.items():
            if name not in network.descriptions:
                yield f"substeps: there is no part {name!r}, {only(name, network.descriptions)}"
            if not 1 <= count < MOST_SUBSTEPS:
                yield f"substeps of {name} = {count!r} must be at least 1 and below {MOST_SUBSTEPS}"

    def _missing_for_algorithm(self) -> Iterator[str]:
        """Parts that cannot be stepped back for an implicit algorithm; loops that an explicit one cannot solve."""
        network, settings = self.network, self.settings
        algorithm = find_algorithm(settings.algorithm)
        if algorithm.is_implicit:
            for name in self.stateless:
                yield f"{algorithm.name} needs the FMU state, which {name} cannot save"
            return
        implicit = [each.name for each in REGISTRY.values() if each.is_implicit]
        for loop in algebraic_loops(network):
            yield (
                f"algebraic loop: {describe_loop(loop)} act on each other by direct feedthrough; "
                f"{algorithm.name} cannot solve that, but {' and '.join(implicit)} can"
            )

    def _missing_for_control(self, step: Adaptive) -> Iterator[str]:
        """What adaptive steps need and the parts, or the bonds, lack."""
        network = self.network
        for name in self.fixed:
            yield f"adaptive steps: {name} cannot vary its step"
        if step.control == "doubling":
            for name in self.stateless:
                yield f"step doubling needs the FMU state, which {name} cannot save"
        elif step.control != "mesh" and (step.control or self.stateless) and not self.bonds:
            yield "step control by energy needs a power bond, and the system has none"
        outputs = outputs_read_each_step(network).values()
        monitored = [port.name for ports in outputs for port in ports if port.type == "Real"]
        for name in step.absolute:
            if name not in monitored:
                yield f"absolute tolerance of {name}: only {', '.join(monitored)} can have one"

    def _times_where_no_step_ends(self) -> Iterator[str]:
        """Times at which a step must end, and cannot, since a part takes no other steps."""
        network, settings = self.network, self.settings
        if not self.fixed:
            return
        start, stop = settings.start, settings.stop
        continuous, times = [port for port, _ in continuous_profiles(network)], {"stop": [stop]}
        for port, profile in network.inputs:
            if port not in continuous:
                times[port.name] = profile.jumps(start, stop)
        for name, ends in times.items():
            for time in ends:
                if settings.steps_until(time) is None:
                    yield (
                        f"{name} = {time!r} s must be a whole number of steps of {settings.step!r} s "
                        f"after start, since {self.fixed[0]} cannot vary its step: write a step that divides it"
                    )


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


def _require_held_values(network: Network, state: SystemState) -> None:
    """Raise SetupError for an input or parameter that changes between steps, and that the state has with another value.

    It may have any where the system changes it at the time of the state.
    """
    time, ours = state.time, inputs_before(network, state.time)
    starts = {port.name: value for port, value in network.start}
    jumping = {
        port.name
        for port, profile in network.inputs
        if any(coincide(jump, time) for jump in profile.jumps(-math.inf, math.inf))
    }
    for name in sorted(state.inputs_before.keys() | ours.keys()):
        port = network.port(name)
        begun = starts.get(name, declared_start(port.variable))
        before, now = (values.get(name, begun) for values in (state.inputs_before, ours))
        if before != now and name not in jumping and not is_continuous_input(port):
            raise SetupError(
                f"{name} is {before!r} in the state at t = {time!r} s, and {now!r} in this system: write "
                f"changes=['at {time!r} s {name} = {before!r}'] to keep it"
            )


def _require_types(settings: RunSettings) -> None:
    """Refuse what is not of the kind that a setting is; raises SetupError with what to write."""
    times = {name: getattr(settings, name) for name in ("start", "stop", "step", "output_step")}
    times |= {"tolerance": settings.tolerance}
    for name, value in times.items():
        if isinstance(value, Adaptive) or (value is None and name in ("output_step", "tolerance")):
            continue
        if isinstance(value, bool) or not isinstance(value, float | Real):
            raise SetupError(f"{name} = {value!r} must be a number{_how_to_write(name, value)}")
    for name in ("record", "order"):
        value = getattr(settings, name)
        if isinstance(value, str):
            raise SetupError(f"{name} must be a sequence of names: write {value.split(',')}")
    if not isinstance(settings.algorithm, str):
        raise SetupError(f"algorithm = {settings.algorithm!r} must be a name")
    counts = {f"substeps of {name}": n for name, n in dict(settings.substeps).items()}
    for name, value in (counts | {"input_order": settings.input_order}).items():
        if isinstance(value, bool) or not isinstance(value, Integral):
            raise SetupError(f"{name} = {value!r} must be a whole number")


def _how_to_write(name: str, value: object) -> str:
    """How to write a text as a number of seconds, where it is one."""
    seconds = in_unit(value, "s")
    if name == "tolerance" or math.isnan(seconds):
        return ""
    return f" of seconds: write {name}={seconds!r}"


def _single_instances(network: Network) -> Iterator[str]:
    """FMUs of several parts that allow one instance only."""
    by_guid: dict[str, str] = {}
    for name, description in network.descriptions.items():
        twin = by_guid.setdefault(description.guid, name)
        if (
            twin != name
            and description.offered_interface("coSimulation").canBeInstantiatedOnlyOncePerProcess
        ):
            yield f"{name}: its FMU allows only one instance per process, and {twin} is another"


def setup_problems(network: Network, settings: RunSettings) -> Iterator[str]:
    """The reasons why a system cannot be run with these settings, or the first where these are of no kind to be checked."""
    try:
        setup = Setup(network, settings)
    except SetupError as error:
        yield str(error)
        return
    yield from setup.problems()
