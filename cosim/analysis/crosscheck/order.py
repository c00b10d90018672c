"""The check of calls out of order: what an FMU does that is called where the standard forbids it.

The standard leaves open what follows such a call. An FMU that refuses it shows an importer his mistake; one that takes
it computes something else without a word; one that crashes takes the importer with it, which is all that fails here.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from functools import partial

from ...errors import FmuError
from ...fmu.calls import CALLS, STATES
from ...fmu.instance import CoSimulation
from ...system.description import Variable
from .process import forked
from .subject import CheckFailed, NotOffered, Row, Subject, nudged

#: What the process of a call ends with.
REFUSED, HARMLESS = "refused", "harmless"


def order(s: Subject) -> str:
    """Every call in every state that forbids it, each in a process of its own."""
    if not hasattr(os, "fork"):
        raise NotOffered("this system cannot copy processes")
    answers: dict[str, str] = {}
    for name, state in wrong_calls(s):
        wrong = f"{name} {STATES[state]}"
        try:
            if answer := forked(partial(_effect_of_call, s, name, state)):
                answers[wrong] = answer
        except FmuError as error:
            raise CheckFailed(f"{wrong}: {error}") from error
    refused = sum(answer == REFUSED for answer in answers.values())
    count = f"{refused} of {len(answers)} calls where they are forbidden are refused"
    if taken := [
        f"{wrong} {answer}"
        for wrong, answer in answers.items()
        if answer not in (REFUSED, HARMLESS)
    ]:
        raise NotOffered(f"{count}, which the standard leaves open; taken: {'; '.join(taken)}")
    return count if refused == len(answers) else f"{count}, the others change nothing"


def wrong_calls(s: Subject) -> Iterator[tuple[str, str]]:
    """Calls that this FMU can be given, each with the letter of a state that forbids it."""
    states = "IMSET" if s.is_fmi3 and s.can.hasEventMode else "IMST"
    for call in CALLS.values():
        allowed = call.allowing_states(s.description.fmiVersion)
        if allowed is not None and _has_call(s, call.name):
            yield from ((call.name, state) for state in states if state not in allowed)


def _variable_of_call(s: Subject, name: str) -> Variable | None:
    """What a call sets or gets; an output is one that has no start value."""
    causality, variability = {
        "set a fixed parameter": ("parameter", "fixed"), "set an input": ("input", "continuous")
    }.get(name, ("output", "continuous"))  # fmt: skip
    variables = (
        v
        for v in s.description.modelVariables
        if (v.type, v.causality, v.variability) == ("Real", causality, variability)
    )
    if causality == "output":
        return next(
            (
                v
                for v in variables
                if v.initial in (None, "calculated") and v.name not in s.unsteady
            ),
            None,
        )
    return next((v for v in variables if nudged(v) is not None), None)


def _has_call(s: Subject, name: str) -> bool:
    """Whether this FMU has what the call is about."""
    if name.startswith(("set a", "get a")):
        return _variable_of_call(s, name) is not None
    if name == "getDirectionalDerivative":
        return bool(s.can.providesDirectionalDerivative and s.inputs and _variable_of_call(s, name))
    return not name.startswith(("enterEvent", "enterStep", "updateDisc", "evaluateDisc")) or bool(
        s.can.hasEventMode
    )


def _effect_of_call(s: Subject, name: str, state: str) -> str:
    """What follows a call in a state: refused, harmless, or what it changes; "" if the state is not reached."""
    before = s.steps // 2
    with s.instance() as part:
        try:
            shown = _reach(s, part, state, before)
        except FmuError:
            return ""
        try:
            _make_call(s, part, name)
        except FmuError:
            return REFUSED
        try:
            if state == "T":
                return HARMLESS if s.row(part) == shown else "changes what it shows"
            return _effect_on_rest_of_run(s, part, state, before)
        except FmuError as error:
            return f"and then the run fails ({error})"


def _reach(s: Subject, part: CoSimulation, state: str, steps: int) -> Row:
    """Bring a new instance into a state; what it shows if it is terminated there."""
    if state != "I":
        s.enter(part)
    if state in "SET":
        s.set_inputs(part, s.inputs_at(0))
        part.leave_initialisation()
        s.go(part, 0, steps)
    if state == "T":
        part.session.terminate()
        return s.row(part)
    if state == "E":
        part.session.call("enterEventMode")
    return ()


def _effect_on_rest_of_run(s: Subject, part: CoSimulation, state: str, before: int) -> str:
    """Whether the rows of a run from this state on are what they are without the call."""
    if state == "I":
        s.initialise(part)
    elif state == "M":
        s.set_inputs(part, s.inputs_at(0))
        part.leave_initialisation()
    elif state == "E":
        part.session.call("enterStepMode")
    first = before if state in "SE" else 0
    with suppress(CheckFailed):
        s.same(s.go(part, first, s.steps), s.reference[first:], "", first)
        return HARMLESS
    return "changes the rows after it"


def _make_call(s: Subject, part: CoSimulation, name: str) -> None:
    """The call, with arguments that it takes where it is allowed."""
    session, third = part.session, s.is_fmi3
    v = _variable_of_call(s, name)
    match name:
        case "setupExperiment":
            session.call(name, s.tolerance, s.start, None)
        case "enterInitializationMode":
            session.call(name, *((s.tolerance, s.start, None) if third else ()))
        case "doStep":
            session.call(name, s.start + (s.steps // 2) * s.h, s.h)
        case "get an output":
            assert v is not None
            part.session.values([v])
        case "set an input" | "set a fixed parameter" | "set an output":
            assert v is not None
            part.session.set(v, nudged(v) or 0.0)
        case "getDirectionalDerivative":
            assert v is not None
            part.session.slopes([v], s.inputs[0])
        case "evaluateDiscreteStates":
            if session.function("EvaluateDiscreteStates")(session.component):
                raise FmuError(f"{name} is refused")
        case _:
            session.call(name)
