"""The C source of a component: its traced functions, and its variables as a table for the runtime."""

from __future__ import annotations

import json
import sys
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple, cast

from ..declare import bounds
from ..declare.interface import Interface, Variable, class_name, co_simulation_only_reason
from ..declare.record import Value, start
from ..runtime import direction, hybrid, jet, ode
from ..trace import feedthrough, purity, tangents
from ..trace.graph import Function, NumberType, argument, size
from ..trace.ops import libm_functions
from ..trace.tracer import Tracer, record_note
from . import c, python

BOUNDARIES = {
    hybrid: (
        "input_trajectory",
        "inputs_at",
        "first_negative_indicator",
        "slope",
        "smaller",
        "note_change",
        "integrate_through_events",
    ),
    ode: ("clip_to_stop", "next_size"),
    bounds: ("require_bounds",),
    direction: ("at_angle",),
    jet: (),
}


SLAVE = (
    "model_check", "model_check_start", "model_initial", "model_begin", "model_input_trajectory", "model_step", "model_outputs"
)  # fmt: skip


class GeneratedSources(NamedTuple):
    """The sources of a model: C without guid, and the functions of a slave in Python.

    `indicators` are the event indicators; `run_to_event` is the C that FMI 3.0 needs to end at an event;
    `warnings` are sentences about the model.
    """

    c: str
    python: str
    indicators: int
    run_to_event: str
    warnings: tuple[str, ...]


@cache
def generate(model: ModuleType) -> GeneratedSources:
    """Trace and print a model, once in a process; raises TypeError for undeclared feedthrough."""
    interface = Interface(model)
    functions = trace_all(interface)
    outputs = next(f for f in functions if f.name == "model_outputs")
    feedthrough.require(interface, outputs)
    warnings = tuple(feedthrough.superfluous_declarations(interface, outputs))
    indicators = next(size(f.shape) for f in functions if f.name == "model_event_indicators")
    last = next(n for n, f in enumerate(functions, 1) if f.name == "model_tangents")
    code = c_source(interface, functions[:last], indicators)
    more = "\n".join(map(c.definition, functions[last:]))
    return GeneratedSources(code, python.module(functions, SLAVE), indicators, more, warnings)


def c_source(interface: Interface, functions: list[Function], indicators: int) -> str:
    """The C file to compile; it includes `fmi2.c`."""
    names = ("inputs", "states", "outputs", "derivatives")
    width = {name: getattr(interface, name) for name in names}
    nominals = [  # C wants at least one
        f"{{{v.reference - interface.states.start}, {c.real(v.declaration.nominal or 1.0)}}}"
        for v in interface.continuous
    ]
    defined = {
        "IDENTIFIER": json.dumps(class_name(interface.model)),
        "GUID": '""',
        "VARIABLES": interface.derivatives.stop,
        "INPUT_HOLD": interface.input_hold,
        "HIGHEST_DEGREE": hybrid.HIGHEST_DEGREE,
        "MODEL_EXCHANGE": int(not co_simulation_only_reason(interface.model)),
        "INDICATORS": indicators,
        "MOST_EVENTS": hybrid.MOST_EVENTS,
        **{f"FIRST_{name[:-1].upper()}": part.start for name, part in width.items()},
        **{name.upper(): part.stop - part.start for name, part in width.items()},
    }
    return "\n".join(
        [
            f"/* {class_name(interface.model)}: written by fmukit. */",
            *(f"#define {name} {value}" for name, value in defined.items()),
            f"#define LIBM_FUNCTIONS(F) {' '.join(f'F({name})' for name, n in libm_functions().items() if n == 1)}",
            f"#define LIBM_FUNCTIONS_2(F) {' '.join(f'F({name})' for name, n in libm_functions().items() if n == 2)}",
            '#include "fmi2.c"\n',
            *map(c.definition, functions),
            "static const Variable variables[VARIABLES] = {",
            ",\n".join(map(c_variable, interface.variables + interface.rates)),
            "};\n",
            f"static const Continuous continuous[] = {{{', '.join(nominals) or '{0, 1.0}'}}};\n",
        ]
    )


def c_variable(v: Variable) -> str:
    """The initialiser of one variable in the C table of variables."""
    texts = (v.name, v.unit, v.declaration.fmi_type, v.causality, v.variability)
    settable = str(int(v.settable_before_start))
    items = v.declaration.items
    limits = (min(items), max(items)) if items else LIMITS[v.declaration.fmi_type]
    numbers = (c.real(float(x)) for x in (v.declaration.start, *limits))
    return f"    {{{', '.join([*map(json.dumps, texts), settable, *numbers])}}}"


LIMITS: dict[str, tuple[float, float]] = {
    "Real": (-sys.float_info.max, sys.float_info.max),
    "Integer": (-(2.0**31), 2.0**31 - 1),
    "Boolean": (0.0, 1.0),
}


def trace_all(interface: Interface) -> list[Function]:
    """The functions of a model that the runtime calls, and those that they call, in the order in which C needs them."""
    model = interface.model
    module = cast(ModuleType, model)
    purity.require(model, Tracer(module, BOUNDARIES))
    tracer = Tracer(module, BOUNDARIES)
    p, x, u = (start(cls) for cls in (model.Parameters, model.State, model.Inputs))
    inputs = hybrid.InputTrajectory(u, u, 0.0, 1, (u,) * (hybrid.HIGHEST_DEGREE - 1))

    def symbols_of_values() -> list[Value]:
        return [argument("p", v.reference, NumberType(v.access_type)) for v in interface.variables]  # type: ignore[misc]

    def check(p: Any) -> None:
        for sentence in bounds.check_parameters(interface, p, symbols_of_values()):
            record_note(sentence)

    def check_start(p: Any) -> None:
        bounds.check_start(interface, symbols_of_values())

    def begin(p: Any, t: Any, x: Any, now: Any) -> Any:
        return hybrid.sample(model, p, t, x, None, now, record_note)

    def input_trajectory(hold: Any, before: Any, now: Any, past: Any, h: Any) -> Any:
        return hybrid.input_trajectory(hold, before, now, past, h)

    def step(p: Any, t: Any, x: Any, before: Any, now: Any, inputs: Any) -> Any:
        return hybrid.step(model, p, t, x, before, now, inputs, record_note)

    def outputs(p: Any, t: Any, x: Any, u: Any) -> Any:
        return model.outputs(p, t, x, u)

    def initial(p: Any, t: Any, x: Any, u: Any) -> Any:
        completed = model.complete_state(p, x)
        return completed, model.outputs(p, t, completed, u)

    def derivatives(p: Any, t: Any, x: Any, u: Any) -> Any:
        return hybrid.continuous_values(
            model.derivatives(p, t, x, u), hybrid.continuous_indices(model.State)
        )

    def indicators(p: Any, t: Any, x: Any, u: Any) -> list[Any]:
        return list(model.event_indicators(p, t, x, u)) if model.event_indicators else []

    def count(p: Any, t: Any, x: Any, u: Any) -> None:
        counts.append(len(indicators(p, t, x, u)))

    def event_indicators(p: Any, t: Any, x: Any, u: Any) -> Any:
        values = indicators(p, t, x, u)
        return values + [1.0] * (max(counts) - len(values))

    def run_to_event(p: Any, t: Any, x: Any, inputs: Any) -> Any:
        return hybrid.run_to_event(model, p, t, x, inputs)

    def event(p: Any, t: Any, x: Any, before: Any, now: Any, which: Any) -> Any:
        if not model.event_update or which < 0.0:
            return hybrid.sample(model, p, t, x, before, now, record_note)
        new = model.event_update(p, t, x, now, which)
        hybrid.note_change(model, p, t, x, new, now, record_note)
        return new

    def initial_values(p: Any, t: Any, x: Any, u: Any) -> Any:
        completed = model.complete_state(p, x)
        return completed, model.outputs(p, t, completed, u), derivatives(p, t, completed, u)

    def present_values(p: Any, t: Any, x: Any, u: Any) -> Any:
        return x, model.outputs(p, t, x, u), derivatives(p, t, x, u)

    counts: list[int] = []

    tracer.trace_entry("model_check", check, p=p)
    tracer.trace_entry("model_check_start", check_start, p=p)
    tracer.trace_entry("model_begin", begin, p=p, t=0.0, x=x, now=u)
    tracer.trace_entry(
        "model_input_trajectory", input_trajectory, hold=0, before=u, now=u, past=0.0, h=0.0
    )
    tracer.trace_entry("model_step", step, p=p, t=0.0, x=x, before=u, now=u, inputs=inputs)
    tracer.trace_entry("model_outputs", outputs, p=p, t=0.0, x=x, u=u)
    tracer.trace_entry("model_initial", initial, p=p, t=0.0, x=x, u=u)
    tracer.trace_entry("model_derivatives", derivatives, p=p, t=0.0, x=x, u=u)
    tracer.trace("count", count, p=p, t=0.0, x=x, u=u)
    tracer.trace_entry("model_event_indicators", event_indicators, p=p, t=0.0, x=x, u=u)
    tracer.trace_entry("model_event", event, p=p, t=0.0, x=x, before=u, now=u, which=0.0)
    for name, run in (("model_directional", initial_values), ("model_tangents", present_values)):
        with tracer.tracing():
            primal = tracer.trace(name, run, p=p, t=0.0, x=x, u=u)
            derivative = tangents.derived(tracer, primal, ("p", "t", "x", "u"))
        tracer.functions = {k: v for k, v in tracer.functions.items() if v is not derivative}
        tracer.functions[name] = derivative._replace(name=name, entry=True)
    if model.event_indicators:
        tracer.trace_entry("model_run_to_event", run_to_event, p=p, t=0.0, x=x, inputs=inputs)
    return [function for function in tracer.functions.values() if function]
