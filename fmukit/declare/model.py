"""What a model is: a module with these names, of which most may be missing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import inf
from types import ModuleType
from typing import Any, NamedTuple, Protocol

from .record import is_record, record


class Experiment(NamedTuple):
    """Default experiment: stop time and preferred communication step, in s."""

    stop: float
    step: float


class Model(Protocol):
    """The names that the kit reads from a model, and what they are where it lacks them.

    p, x and u are its Parameters, State and Inputs, and t is the time. Fields of State that are not Real, or are
    declared `held`, keep their value between events.
    """

    __name__: str
    __file__: str | None
    Parameters: Any
    Inputs: Any
    State: Any
    Outputs: Any
    EXPERIMENT: Experiment
    derivatives: Callable[..., Any]
    outputs: Callable[..., Any]
    #: check(p): a sentence for each unusual parameter; raises ValueError for an impossible one
    check: Callable[[Any], Iterable[str]] = lambda p: ()
    #: step_constants(p, x): a fifth argument for `derivatives` throughout a step that begins with the state x
    step_constants: Callable[[Any, Any], Any] | None = None
    #: exact(p, x, u0, u1, h): the state after h seconds with inputs on a line; None where it has no closed form
    exact: Callable[[Any, Any, Any, Any, float], Any] | None = None
    #: event_indicators(p, t, x, u): positive values; an event occurs where one becomes negative
    event_indicators: Callable[[Any, float, Any, Any], Sequence[float]] | None = None
    #: event_update(p, t, x, u, which): the state just after indicator number `which` became negative
    event_update: Callable[[Any, float, Any, Any, int], Any] | None = None
    #: sample(p, t, x, before, now): the state just after a communication point that brings the inputs `now`;
    #: before = None when initialisation ends
    sample: Callable[[Any, float, Any, Any, Any], Any] | None = None
    #: complete_state(p, x): the state x with all that follows from the rest of it, at the start and at the end of every
    #: communication step; what cannot be chosen at the start is declared with `follows=True`
    complete_state: Callable[[Any, Any], Any] = lambda p, x: x
    #: notes(p, t, old, new, u): sentences for the log on the change from old to new
    notes: Callable[[Any, float, Any, Any, Any], Iterable[str]] = lambda p, t, old, new, u: ()
    #: sub-step [s] within which no indicator changes sign twice
    LONGEST_STEP: float = inf
    #: shaft ends by name: torque, speed and, if there is one, the angle
    FLANGES: Mapping[str, tuple[str, ...]] = {}
    #: why C cannot compute it
    PYTHON_ONLY: str = ""
    #: why others cannot integrate it
    CO_SIMULATION_ONLY: str = ""

    def __hash__(self) -> int: ...


#: What a model may lack, with the value that it has then.
DEFAULTS = {name: vars(Model)[name] for name in Model.__annotations__ if name in vars(Model)}
RECORDS = ("Parameters", "Inputs", "State", "Outputs")


def complete_model(model: ModuleType) -> Model:
    """Return a model after adding what it may lack; raises TypeError for a record that is a plain class."""
    contents = vars(model)
    for name in RECORDS:
        if name not in contents:
            contents[name] = record(type(name, (), {"__module__": model.__name__}))
        if not is_record(contents[name]):
            raise TypeError(f"class {name} needs @record above it")
    if not model.State._declared:
        contents.setdefault("derivatives", lambda p, t, x, u: x)
    if not model.Outputs._declared:
        empty = model.Outputs()
        contents.setdefault("outputs", lambda p, t, x, u: empty)
    for name, default in DEFAULTS.items():
        contents.setdefault(name, default)
    return model
