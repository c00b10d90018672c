"""Checks of dependencies: that outputs and initial unknowns follow no other values than those that are declared."""

from __future__ import annotations

from contextlib import suppress

from ...errors import FmuError
from ...system import Value
from ...system.description import Unknown, Variable
from .subject import EXCITATION, CheckFailed, NotOffered, Subject, nudged
from .tolerances import AGREEMENT, NO_CHANGE

#: Variables that are changed while initialising, at most. Chosen: each takes an instance.
MOST_SETTABLE = 60
#: Inputs that are changed, at most. Chosen: each takes four instances at each of two times.
MOST_INPUTS = 20
#: A step in which no state moves is the step of a run over this. Chosen: states move 1024 times less than in a step, so
#: that what moves follows an input directly.
SHORT_STEP_DIVISOR = 1024
#: A step that is compared with it is the step of a run over this. Chosen: 16 times longer than the short one.
LONG_STEP_DIVISOR = 64
#: What a direct dependence moves in the short step is above this share of what it moves in the long one. Derived: a
#: dependence through a state makes it 1 / 16, a direct one 1.
DIRECT_SHARE = 0.5


def outputs(s: Subject) -> str:
    """Which outputs an input moves in a step too short for any state to move."""
    s.needs("canHandleVariableCommunicationStepSize")
    declared = {u.variable.name: u for u in s.description.outputs}
    reals = [v for v in s.outputs if v.name in s.ranges and v.variability in (None, "continuous")]
    short, long = s.h / SHORT_STEP_DIVISOR, s.h / LONG_STEP_DIVISOR
    unresolved: set[str] = set()
    for n in (0, s.steps // 2):
        u = s.inputs_at(n)
        unresolved |= _unresolved(s, n)
        reals = [v for v in reals if v.name not in unresolved]
        for j, driver in enumerate(s.inputs[:MOST_INPUTS]):
            short_slopes, long_slopes = (s.slopes(n, u, j, h, EXCITATION) for h in (short, long))
            for v in reals:
                resolution = NO_CHANGE * s.ranges[v.name] / s.size(driver)
                least = max(DIRECT_SHARE * abs(long_slopes[v.name][0]), resolution)
                if v.name in declared:
                    _require_declared(declared[v.name], driver, short_slopes[v.name][0], least)
                    _require_kind(declared[v.name], driver, short_slopes[v.name], resolution)
    if unresolved and not reals:
        raise NotOffered(f"it takes no steps as short as {short:.3g} s")
    tried = min(len(s.inputs), MOST_INPUTS)
    return f"{len(reals)} Real outputs by {tried} of {len(s.inputs)} Real inputs"


def _require_declared(output: Unknown, driver: Variable, slope: float, least: float) -> None:
    """Raise CheckFailed for a slope above the least that shows a dependence, where none is declared."""
    names = output.dependencies
    if abs(slope) > least and names is not None and driver not in names:
        raise CheckFailed(
            f"{output.variable.name} has an undeclared direct feedthrough from {driver.name}, of slope {slope:.4g}"
        )


def _require_kind(
    output: Unknown, driver: Variable, slopes: tuple[float, float], resolution: float
) -> None:
    """Raise CheckFailed if the slopes above and below differ, where they are declared to be the same."""
    names, kinds = output.dependencies, output.dependenciesKind
    kind = kinds[names.index(driver)] if kinds and names and driver in names else ""
    up, down = slopes
    if kind in ("constant", "fixed") and abs(up - down) > AGREEMENT * abs(up) + resolution:
        raise CheckFailed(
            f"{output.variable.name} by {driver.name} is declared {kind}, but its slope is {down:.6g} on "
            f"one side and {up:.6g} on the other"
        )


def _unresolved(s: Subject, n: int) -> set[str]:
    """The Real outputs that a step of h / 1024 moves about as far as one of h / 64, with the same inputs.

    An FMU that takes whole internal steps only, or rounds the size of a step, moves its states in such a
    step; the slopes by its inputs then show no direct dependence.
    """
    u = s.inputs_at(max(n - 1, 0))
    begin, short, long = (
        s.after(n, u, sizes)
        for sizes in ([], [s.h / SHORT_STEP_DIVISOR], [s.h / LONG_STEP_DIVISOR])
    )
    return {
        name
        for name, span in s.ranges.items()
        if abs(short[name] - begin[name])
        > max(DIRECT_SHARE * abs(long[name] - begin[name]), NO_CHANGE * span)
    }


def unknowns(s: Subject) -> str:
    """Which unknowns a value moves while initialising."""
    entries = s.description.initialUnknowns
    if not entries:
        raise NotOffered("there are no InitialUnknowns")
    settable = [v for v in s.description.modelVariables if s.is_settable(v)]
    unknown_variables = [u.variable for u in entries]

    def values_with(v: Variable | None = None, value: Value = 0) -> dict[str, Value]:
        def work() -> dict[str, Value]:
            with s.instance() as part:
                s.enter(part)
                if v is not None:
                    part.set(v, value)
                return part.session.values(unknown_variables)

        return s.in_process(work)

    base, tried = values_with(), 0
    steady = [u for u in entries if u.variable.name not in s.unsteady]
    for v in settable[:MOST_SETTABLE]:
        if (value := nudged(v)) is None:
            continue
        with suppress(FmuError):
            changed = values_with(v, value)
            tried += 1
            for u in steady:
                name = u.variable.name
                responds = (
                    changed[name] != base[name] and base[name] == base[name]
                )  # not so for nan
                if responds and u.dependencies is not None and v not in u.dependencies:
                    raise CheckFailed(
                        f"{name} is {changed[name]!r}, not {base[name]!r}, with {v.name} = {value!r}, undeclared"
                    )
    return f"{len(entries)} unknowns by {tried} of {len(settable)} values"
