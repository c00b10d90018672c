"""What a slave asks of a model, over plain numbers, by the functions of the model as they stand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

from ..declare import bounds
from ..declare.interface import Interface
from ..declare.record import fill
from . import hybrid

Numbers = Sequence[Any]
Note = Callable[[str], None]


def functions(interface: Interface) -> SimpleNamespace:
    """The functions that `codegen.entries` traces, with the arguments and results of those printed.

    `v` are the values of all variables, and records lie flat in tuples.
    """
    model = interface.model
    state, inputs, width = model.State._make, model.Inputs._make, len(model.Inputs._fields)

    def parameters(v: Numbers) -> Any:
        return fill(model.Parameters, v[interface.parameters])

    def model_check(note: Note, v: Numbers) -> None:
        for sentence in bounds.check_parameters(interface, parameters(v), v):
            note(sentence)

    def model_check_start(note: Note, v: Numbers) -> None:
        bounds.check_start(interface, v)

    def model_initial(note: Note, v: Numbers, t: float, x: Numbers, u: Numbers) -> Numbers:
        completed = model.complete_state(parameters(v), state(x))
        return *completed, *model.outputs(parameters(v), t, completed, inputs(u))

    def model_begin(note: Note, v: Numbers, t: float, x: Numbers, now: Numbers) -> Any:
        return hybrid.sample(model, parameters(v), t, state(x), None, inputs(now), note)

    def model_input_trajectory(
        note: Note, hold: int, before: Numbers, now: Numbers, past: float, h: float
    ) -> Numbers:
        start, end, h, degree, _ = hybrid.input_trajectory(
            hold, inputs(before), inputs(now), past, h
        )
        return *start, *end, h, degree

    def model_step(
        note: Note,
        v: Numbers,
        t: float,
        x: Numbers,
        before: Numbers,
        now: Numbers,
        trajectory: Numbers,
    ) -> Any:
        start, end = inputs(trajectory[:width]), inputs(trajectory[width : 2 * width])
        followed = hybrid.InputTrajectory(start, end, trajectory[-2])
        return hybrid.step(
            model, parameters(v), t, state(x), inputs(before), inputs(now), followed, note
        )

    def model_outputs(note: Note, v: Numbers, t: float, x: Numbers, u: Numbers) -> Any:
        return model.outputs(parameters(v), t, state(x), inputs(u))

    return SimpleNamespace(**{name: f for name, f in locals().items() if name.startswith("model_")})
