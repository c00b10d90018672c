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
    """The functions that `codegen.entries` traces, with the arguments and results of those printed:
    `v` are the values of all variables, records lie flat in tuples.
    """
    model = interface.model
    state, inputs, width = model.State._make, model.Inputs._make, len(model.Inputs._fields)

    def given(v: Numbers) -> Any:
        return fill(model.Parameters, v[interface.parameters])

    def model_check(note: Note, v: Numbers) -> None:
        for sentence in bounds.start_values(interface, given(v), v):
            note(sentence)

    def model_initial(note: Note, v: Numbers, t: float, x: Numbers, u: Numbers) -> Numbers:
        settled = hybrid.settle(model, given(v), state(x))
        return *settled, *model.outputs(given(v), t, settled, inputs(u))

    def model_begin(note: Note, v: Numbers, t: float, x: Numbers, now: Numbers) -> Any:
        return hybrid.sample(model, given(v), t, state(x), None, inputs(now), note)

    def model_course(
        note: Note, hold: int, before: Numbers, now: Numbers, past: float, h: float
    ) -> Numbers:
        start, end, h, degree, _ = hybrid.course(hold, inputs(before), inputs(now), past, h)
        return *start, *end, h, degree

    def model_step(
        note: Note, v: Numbers, t: float, x: Numbers, before: Numbers, now: Numbers, course: Numbers
    ) -> Any:
        start, end = inputs(course[:width]), inputs(course[width : 2 * width])
        line = hybrid.Course(start, end, course[-2])
        return hybrid.step(model, given(v), t, state(x), inputs(before), inputs(now), line, note)

    def model_outputs(note: Note, v: Numbers, t: float, x: Numbers, u: Numbers) -> Any:
        return model.outputs(given(v), t, state(x), inputs(u))

    return SimpleNamespace(**{name: f for name, f in locals().items() if name.startswith("model_")})
