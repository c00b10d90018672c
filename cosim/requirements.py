"""What a system must be to be run with these settings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from numbers import Integral, Real

from .engine.algorithms import REGISTRY, find_algorithm
from .engine.changes import continuous_profiles, inputs_before
from .engine.control import Adaptive
from .engine.energy import find_bonds
from .engine.initialise import outputs_read_each_step
from .engine.settings import LEFT_OVER, RunSettings
from .engine.snapshot import LiveState, SystemState
from .errors import SetupError
from .fmu.times import coincide
from .names import only
from .system import (
    STATE,
    VARIABLE_STEP,
    Network,
    declared_start,
    is_continuous_input,
    parts_without,
    require_cosimulation,
)
from .system.graph import algebraic_loops, describe_loop
from .system.inputs import parse_change
from .units import QUANTITY, multiples

#: Sub-steps of a part in a communication step. A convention: more than a million are a mistake.
MOST_SUBSTEPS = 1 << 20
#: Degree of the inputs' polynomials. A convention: extrapolation of a higher degree amplifies every rounding error.
HIGHEST_INPUT_DEGREE = 8


def setup_problems(network: Network, settings: RunSettings) -> Iterator[str]:
    """The reasons why this system cannot be run with these settings, a sentence each."""
    try:
        _require_types(settings)
        require_cosimulation(network.descriptions, network.system.parts)
        settings.ports(network)
        settings.check()
        find_algorithm(settings.algorithm)
    except SetupError as error:
        yield str(error)
        return
    yield from _wrong_settings(network, settings)
    yield from _single_instances(network)
    yield from _missing_for_algorithm(network, settings)
    if isinstance(settings.step, Adaptive):
        yield from _missing_for_control(network, settings.step)
    yield from _wrong_times(network, settings)


def _wrong_times(network: Network, settings: RunSettings) -> Iterator[str]:
    """The reasons why steps, changes and inputs over time make no run up to the stop."""
    span = settings.stop - settings.start
    if not isinstance(settings.step, Adaptive):
        if settings.step > span * (1.0 + LEFT_OVER):
            yield (
                f"step = {settings.step!r} s must be at most the time from start to stop: "
                f"write step={span!r}"
            )
        yield from _times_where_no_step_ends(network, settings)
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


def require_runnable(network: Network, settings: RunSettings) -> None:
    """Raise SetupError for a system that cannot be run with these settings."""
    for problem in setup_problems(network, settings):
        raise SetupError(problem)


def require_step_and_stop(network: Network, settings: RunSettings) -> None:
    """Raise SetupError for a step or a stop with which a system that can be run otherwise cannot."""
    settings.check()
    for problem in _wrong_times(network, settings):
        raise SetupError(problem)


def require_pause(network: Network, settings: RunSettings, begin: float, until: float) -> None:
    """Raise SetupError if there is no state at a time [s] with which another run can go on, after a run began [s]."""
    if not isinstance(until, float | Real) or not begin < until <= settings.stop:
        raise SetupError(
            f"run_until({until!r}) must get a time in s, after the start at {begin!r} s and at most "
            f"stop = {settings.stop!r} s"
        )
    for name in parts_without(network.descriptions, STATE):
        raise SetupError(f"{name} cannot save its state: its FMU does not have {STATE}")
    _require_rows_at_steps(network, settings)


def _require_rows_at_steps(network: Network, settings: RunSettings) -> None:
    """Raise SetupError where rows lie between steps, which are made of rows of two runs if one goes on with the other."""
    if settings.steps_per_row(port.column for port in settings.ports(network)) is None:
        raise SetupError(
            f"output_step = {settings.output_step!r} s: rows between steps cannot be continued by another run: "
            "write output_step=None"
        )


def require_begin(network: Network, settings: RunSettings, state: SystemState) -> None:
    """Raise SetupError for a state with which a run of this system cannot begin."""
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
    _require_rows_at_steps(network, settings)
    _require_held_values(network, state)


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
    quantity = QUANTITY.fullmatch(value) if isinstance(value, str) else None
    scale = multiples("s").get(quantity[2] or "s") if quantity and name != "tolerance" else None
    if quantity is None or scale is None:
        return ""
    return f" of seconds: write {name}={float(quantity[1]) * scale!r}"


def _wrong_settings(network: Network, settings: RunSettings) -> Iterator[str]:
    """Settings out of range, or that name no part."""
    parts, order, tolerance = ", ".join(network.descriptions), settings.order, settings.tolerance
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


def _missing_for_algorithm(network: Network, settings: RunSettings) -> Iterator[str]:
    """Parts that cannot be stepped back for an implicit algorithm; loops that an explicit one cannot solve."""
    algorithm = find_algorithm(settings.algorithm)
    if algorithm.is_implicit:
        for name in parts_without(network.descriptions, STATE):
            yield f"{algorithm.name} needs the FMU state, which {name} cannot save"
        return
    implicit = [each.name for each in REGISTRY.values() if each.is_implicit]
    for loop in algebraic_loops(network):
        yield (
            f"algebraic loop: {describe_loop(loop)} act on each other by direct feedthrough; "
            f"{algorithm.name} cannot solve that, but {' and '.join(implicit)} can"
        )


def _missing_for_control(network: Network, step: Adaptive) -> Iterator[str]:
    """What adaptive steps need and the parts, or the bonds, lack."""
    for name in parts_without(network.descriptions, VARIABLE_STEP):
        yield f"adaptive steps: {name} cannot vary its step"
    without_state = parts_without(network.descriptions, STATE)
    if step.control == "doubling":
        for name in without_state:
            yield f"step doubling needs the FMU state, which {name} cannot save"
    elif step.control != "mesh" and (step.control or without_state) and not find_bonds(network):
        yield "step control by energy needs a power bond, and the system has none"
    outputs = outputs_read_each_step(network).values()
    monitored = [port.name for ports in outputs for port in ports if port.type == "Real"]
    for name in step.absolute:
        if name not in monitored:
            yield f"absolute tolerance of {name}: only {', '.join(monitored)} can have one"


def _times_where_no_step_ends(network: Network, settings: RunSettings) -> Iterator[str]:
    """Times at which a step must end, and cannot, since a part takes no other steps."""
    fixed = parts_without(network.descriptions, VARIABLE_STEP)
    if not fixed:
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
                    f"after start, since {fixed[0]} cannot vary its step: write a step that divides it"
                )
