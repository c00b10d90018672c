"""The C source of a component: its traced functions, and its variables as a table for the runtime."""

from __future__ import annotations

import json
import sys
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

from ..declare import bounds
from ..declare.record import Value, start
from ..declare.variables import Interface, Variable, class_name
from ..step import hybrid, jet, near, ode
from ..trace import tangents
from ..trace.paths import flatten
from ..trace.tracer import Tracer, note
from ..trace.values import Function, symbol
from . import c, python

BOUNDARIES = {
    hybrid: ("course", "along", "fallen", "slope", "smaller", "announce", "travel"),
    ode: ("reach", "resized"),
    bounds: ("within",),
    near: ("turned",),
    jet: (),
}


class Written(NamedTuple):
    """The sources of a model: C without guid, and a Python module with the entries of a step."""

    c: str
    python: str


@cache
def written(model: ModuleType) -> Written:
    """Trace and print a model, once in a process."""
    interface = Interface(model)
    functions = traced(interface)
    entries = ("model_step", "model_outputs")
    return Written(source(interface, functions), python.module(functions, entries))


def source(interface: Interface, functions: list[Function]) -> str:
    """The C file to compile; it includes `fmi2.c`."""
    width = {name: getattr(interface, name) for name in ("inputs", "states", "outputs")}
    defined = {
        "IDENTIFIER": json.dumps(class_name(interface.model)),
        "GUID": '""',
        "VARIABLES": len(interface.variables),
        "INPUT_HOLD": interface.input_hold,
        "HIGHEST_DEGREE": hybrid.HIGHEST_DEGREE,
        **{f"FIRST_{name[:-1].upper()}": place.start for name, place in width.items()},
        **{name.upper(): place.stop - place.start for name, place in width.items()},
    }
    return "\n".join(
        [
            f"/* {class_name(interface.model)}: written by build_fmus.py. */",
            *(f"#define {name} {value}" for name, value in defined.items()),
            '#include "fmi2.c"\n',
            *map(c.definition, functions),
            f"static const Variable variables[VARIABLES] = {{\n{table(interface)}\n}};\n",
        ]
    )


def table(interface: Interface) -> str:
    """The variables as the runtime reads them."""
    return ",\n".join(f"    {{{', '.join(row(variable))}}}" for variable in interface.variables)


def row(v: Variable) -> list[str]:
    texts = (v.name, v.unit, v.declaration.kind, v.causality, v.variability)
    settable = str(int(v.settable_before_start))
    items = v.declaration.items
    most = float(max(items)) if items else MOST[v.declaration.kind]
    return [*map(json.dumps, texts), settable, c.real(float(v.declaration.start)), c.real(most)]


MOST = {"Real": sys.float_info.max, "Integer": 2.0**31 - 1, "Boolean": 1.0}


def traced(interface: Interface) -> list[Function]:
    """The functions in the order in which C needs them."""
    model = interface.model
    tracer = Tracer(model, BOUNDARIES)
    p, x, u = (start(cls) for cls in (model.Parameters, model.State, model.Inputs))
    inputs = hybrid.Course(u, u, 0.0, 1, (u,) * (hybrid.HIGHEST_DEGREE - 1))

    def check(p: Any) -> None:
        values: list[Value] = [
            symbol("element", "p", v.reference, kind=v.kind)  # type: ignore[misc]
            for v in interface.variables
        ]
        for sentence in bounds.start_values(interface, p, values):
            note(sentence)

    def begin(p: Any, t: Any, x: Any, now: Any) -> Any:
        return hybrid.sample(model, p, t, x, None, now, note)

    def course(hold: Any, before: Any, now: Any, past: Any, h: Any) -> Any:
        return hybrid.course(hold, before, now, past, h)

    def step(p: Any, t: Any, x: Any, before: Any, now: Any, inputs: Any) -> Any:
        return hybrid.step(model, p, t, x, before, now, inputs, note)

    def outputs(p: Any, t: Any, x: Any, u: Any) -> Any:
        return model.outputs(p, t, x, u)

    def initial(p: Any, t: Any, x: Any, u: Any) -> Any:
        settled = hybrid.settle(model, p, x)
        return settled, model.outputs(p, t, settled, u)

    def rates(p: Any, t: Any, x: Any, u: Any, du: Any) -> Any:
        change = model.derivatives(p, t, x, u)
        places = hybrid.continuous(model.State)
        dx = [d if i in places else 0.0 for i, d in enumerate(change)]
        groups = [numbers for _, numbers in map(flatten, (p, t, x, u))]
        slopes = [[0.0] * len(groups[0]), [1.0], dx, list(du)]
        dy = tangents.forward(tracer, at_end, *zip(*(g for g in zip(groups, slopes) if g[0])))
        return [*dx, *dy]

    tracer.entry("model_check", check, p=p)
    tracer.entry("model_begin", begin, p=p, t=0.0, x=x, now=u)
    tracer.entry("model_course", course, hold=0, before=u, now=u, past=0.0, h=0.0)
    tracer.entry("model_step", step, p=p, t=0.0, x=x, before=u, now=u, inputs=inputs)
    at_end = tracer.entry("model_outputs", outputs, p=p, t=0.0, x=x, u=u)
    at_start = tracer.entry("model_initial", initial, p=p, t=0.0, x=x, u=u)
    with tracer.patched():
        directional = tangents.derived(tracer, at_start, ("p", "x", "u"))
    tracer.functions["directional"] = directional._replace(name="model_directional", entry=True)
    tracer.functions = {k: v for k, v in tracer.functions.items() if v is not directional}
    tracer.entry("model_rates", rates, p=p, t=0.0, x=x, u=u, du=tuple(u))
    return [function for function in tracer.functions.values() if function]
