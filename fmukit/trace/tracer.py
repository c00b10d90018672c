"""Trace the functions of a model: what they compute becomes trees, which C and Python repeat bit by bit.

Operations stay as the source has them; what is computed twice on a path is one node. Functions of
the model, and of the kit where `entries` names them, become functions of their own, called where
they return numbers; all others are followed where they are called.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from types import BuiltinFunctionType, FunctionType, ModuleType, SimpleNamespace
from typing import Any

from ..runtime import flow
from .conditions import BUILT_IN, HELPERS, follow_arms
from .execute import (
    arranged,
    explore,
    flatten,
    has_static,
    is_named_tuple,
    leaves,
    number_types,
    symbols,
)
from .graph import (
    REAL,
    AttemptEnd,
    AttemptStart,
    Function,
    Join,
    Leaf,
    Loop,
    Node,
    Note,
    NumberType,
    Result,
    TraceContext,
    Tree,
    UnknownChoiceError,
    UntraceableError,
    active,
    argument,
    call_node,
    call_result,
    current,
    key,
    loop_variable,
    operation,
    size,
    text_of,
    type_of,
    with_float_constants,
)
from .modules import modules
from .ops import OPS
from .rewrite import TELL, rewritten

#: The functions of a model that yield sentences for the log.
TELLERS = ("check", "notes")
#: Largest number of operations of a function that is inlined; a convention of this kit, all compilers inline such.
MOST_INLINED_OPERATIONS = 40


def trace_function(
    name: str, run: Callable[..., Any], shapes: dict[str, Any], types: Sequence[NumberType] = ()
) -> Function | None:
    """Trace `run` with symbols of these shapes; None where its paths return unlike things.

    `types` are those of the parameters that are one number; all are Real without them.
    """
    typed_shapes = list(zip(shapes.items(), types or [REAL] * len(shapes)))

    def call() -> Any:
        return run(
            **{name: symbolic_parameter(name, shape, type) for (name, shape), type in typed_shapes}
        )

    tree = follow_all_paths(call, name)
    shapes_of_results = {leaf.shape for leaf in leaves(tree) if leaf.error is None}
    alike = {with_lists_as_tuples(shape) for shape in shapes_of_results}
    if len(alike) != 1 or (has_static(*alike) and alike != {flatten(None)[0]}):
        return None
    return Function(name, shapes, tree, next(iter(shapes_of_results)))


def follow_all_paths(run: Callable[[], Any], name: str) -> Tree:
    """All paths through a function: joined or, where it needs to know an answer, each to its end."""
    try:
        with current().separate_function(without_joins=False):
            return explore(run, (name,))
    except (UnknownChoiceError, NameError):
        with current().separate_function(without_joins=True):
            return explore(run, (name,))


def symbolic_parameter(name: str, shape: Any, type: NumberType) -> Any:
    """The nodes of a parameter: one of this type for a number, else one for each number of a record."""
    if shape == "number":
        return argument(name, None, type)
    return symbols(shape, partial(argument, name))


def with_lists_as_tuples(shape: Any) -> Any:
    """A shape in which a list is as good as a tuple."""
    if shape == "number" or shape[0] == "static":
        return shape
    cls = shape[0] if is_named_tuple(shape[0]) else tuple
    return cls, tuple(map(with_lists_as_tuples, shape[1]))


class Tracer:
    """Everything traced for one component: `functions` in the order in which C needs them."""

    def __init__(self, model: ModuleType, kit: dict[ModuleType, tuple[str, ...]]) -> None:
        self.modules, self.kit = modules(model), kit
        self.names = {module.__name__ for module in self.modules}
        self.context = TraceContext()
        self.functions: dict[Any, Function | None] = {}
        self.joins: dict[Any, Join] = {}

    def trace(self, name: str, run: Callable[..., Any], **examples: Any) -> Function:
        """Trace a function with symbols in the shape of these examples."""
        shapes = {parameter: flatten(value)[0] for parameter, value in examples.items()}
        with self.tracing():
            traced = trace_function(name, run, shapes)
        if traced is None:
            raise UntraceableError(f"{name} does not return the same record on all paths")
        return traced

    def trace_entry(self, name: str, run: Callable[..., Any], **examples: Any) -> None:
        """Trace a function that the runtime calls."""
        self.functions[name] = self.trace(name, run, **examples)._replace(entry=True)

    @contextmanager
    def tracing(self) -> Iterator[None]:
        """Record what is computed within this context, with the modules patched."""
        with active(self.context), self.patched():
            yield

    @contextmanager
    def patched(self) -> Iterator[None]:
        """Replace mathematics, loops and boundaries of model and kit by what records them.

        This is the one place that patches modules. A model is plain Python over floats that calls `math` and
        its own functions by their names; only its globals lead from these names to what records them.
        """
        saved, added = [], []
        for module in (*self.modules, *self.kit):
            for name, value in list(vars(module).items()):
                new = self.replacement(module, name, value)
                if new is not None:
                    saved.append((module, name, value))
                    setattr(module, name, new)
            added += [(module, name) for name in BUILT_IN if name not in vars(module)]
        for module, name in added:
            setattr(module, name, BUILT_IN[name])
        try:
            yield
        finally:
            for module, name, value in saved:
                setattr(module, name, value)
            for module, name in added:
                delattr(module, name)

    def replacement(
        self, module: ModuleType, name: str, value: object
    ) -> Callable[..., Any] | SimpleNamespace | None:
        """What records the calls of a module's function under this name; None if nothing has to."""
        if isinstance(value, FunctionType | BuiltinFunctionType | ModuleType) and value in REPLACED:
            return REPLACED[value]
        value = inspect.unwrap(value) if callable(value) else value
        if module in self.kit:
            homes, is_called = {module.__name__}, name in self.kit[module]
        else:
            homes, is_called = self.names, not inspect.isgeneratorfunction(value)
        if not isinstance(value, FunctionType) or value.__module__ not in homes:
            return None
        run = rewritten(value, HELPED, tells=module is self.modules[0] and name in TELLERS)
        return self.recording_a_call(value, run) if is_called else run

    def recording_a_call(
        self, original: Callable[..., Any], run: Callable[..., Any]
    ) -> Callable[..., Any]:
        """A function that is traced once and then called, where it returns numbers; else followed as `run`."""
        signature = inspect.signature(original)

        def call(*args: Any, **keywords: Any) -> Any:
            bound = signature.bind(*args, **keywords)
            bound.apply_defaults()
            arguments = bound.args
            flattened = [flatten(arg) for arg in arguments]
            if bound.kwargs or not any(n for _, n in flattened):
                return run(*args, **keywords)
            shapes = {
                name: with_lists_as_tuples(shape)
                for name, (shape, _) in zip(bound.arguments, flattened)
            }
            types = [NumberType(type_of(argument).kind) for argument in arguments]
            identity = (original, tuple(shapes.items()), tuple(types))
            if identity not in self.functions:
                name = f"{original.__name__}_{len(self.functions)}"
                self.functions[identity] = None
                traced = trace_function(name, run, shapes, types)
                del self.functions[identity]
                self.functions[identity] = None if traced and is_short(traced) else traced
            traced = self.functions[identity]
            if traced is None:
                return run(*arguments)
            numbers = [tuple(numbers) for _, numbers in flattened if numbers]
            return arranged(traced.shape, iter(record_call(traced, numbers)))

        return call


def is_short(traced: Function) -> bool:
    """Whether a function is better followed than called: one path, and a short one."""
    nodes = traced.tree.nodes
    is_straight = isinstance(traced.tree, Leaf) and not any(
        isinstance(node, Join | Loop) for node in nodes
    )
    return is_straight and len(nodes) <= MOST_INLINED_OPERATIONS and size(traced.shape) > 0


def record_call(traced: Function, groups: Sequence[Sequence[Any]]) -> list[Result]:
    """A call of this function on the path, and the numbers that it returns; one without any is called each time.

    There is a group of numbers for each parameter that has any.
    """
    path = current().path
    call = call_node(traced, groups, () if size(traced.shape) else path.next_place())
    path.record(call)
    return [call_result(call, *numbered) for numbered in enumerate(number_types(traced.shape))]


def traceable_mathematics(original: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `math` that also takes symbols."""
    name = original.__name__

    def call(*args: Any) -> Any:
        if not any(isinstance(number, Node) for number in flatten(args)[1]):
            return original(*args)
        if name in OTHERWISE:
            return OTHERWISE[name](*args)
        if name not in OPERATIONS:
            instead = INSTEAD.get(name, f"one of {', '.join(sorted(OPERATIONS | {*OTHERWISE}))}")
            raise UntraceableError(f"{name} of math, which C computes differently: write {instead}")
        return operation(name, *args)

    return call


def logarithm(x: Any, *base: Any) -> Any:
    """`math.log` of one number or two."""
    return operation("/", logarithm(x), logarithm(*base)) if base else operation("log", x)


def record_note(sentence: str) -> None:
    """Have the FMU say this to the host's log, where the path is now."""
    path, text = current().path, text_of(sentence)
    path.record(current().unique(("note", path.next_place()), Note, REAL, text))


def traceable_attempted(run: Callable[[], Any], otherwise: Any) -> Any:
    """`flow.attempted` for symbols: `otherwise` where the FMU finds no value for them.

    Parameters
    ----------
    run : callable
        Takes no argument, and is followed once.
    otherwise : value or tuple of values
        The result of the branch in which `run` has no value.
    """
    path, unique = current().path, current().unique
    path.record(unique(("attempt", path.next_place()), AttemptStart, REAL))
    path.attempts += 1
    try:
        shape, numbers = flatten(run())
    except (ArithmeticError, ValueError):
        return otherwise
    finally:
        path.attempts -= 1
    failed = path.record(unique(("end", path.next_place()), AttemptEnd, REAL))
    _, alternatives = flatten(otherwise)
    chosen = [
        operation("select", failed, number, alternative)
        if key(number) != key(alternative)
        else number
        for number, alternative in zip(numbers, alternatives, strict=True)
    ]
    return arranged(shape, iter(chosen))


def traceable_repeat(body: Callable[[Any], tuple[bool, Any]], carry: Any) -> Any:
    """`flow.repeat` for symbols: the body is followed once, its state is in variables.

    Parameters
    ----------
    body : callable
        Takes the state of the loop, and returns whether the loop is done and the next state.
    carry : value or tuple of values
        The state before the first iteration.
    """
    context, path = current(), current().path
    place = path.next_place()
    shape, start = flatten(carry)
    loop = context.loop_numbers.setdefault(place, len(context.loop_numbers))
    state = symbols(shape, partial(loop_variable, loop))

    def run_body() -> Any:
        done, following = body(state)
        return follow_arms(done, lambda: True, lambda: False), following

    if place not in context.loop_bodies:
        context.loop_bodies[place] = explore(run_body, (*place, "body"))
    identity, numbers = ("loop", loop, *map(key, start)), with_float_constants(start)
    path.record(context.unique(identity, Loop, REAL, loop, numbers, context.loop_bodies[place]))
    return state


#: What rewritten functions call for their conditions, and for their sentences.
HELPED = frozenset({**HELPERS, TELL: record_note}.items())
#: The functions of `math` that are operations of the table.
OPERATIONS = {op.name for op in OPS.values() if op.from_math and op.name != "log"}
OTHERWISE: dict[str, Callable[..., Any]] = {
    "log": logarithm,
    "degrees": lambda x: x * (180.0 / math.pi),
    "radians": lambda x: x * (math.pi / 180.0),
    "isnan": lambda x: operation("-", x, 0.0) != x,
    "isinf": lambda x: abs(x) == math.inf,
    "isfinite": lambda x: abs(x) < math.inf,
}
INSTEAD = {
    "hypot": "sqrt(x * x + y * y)",
    "fsum": "x + y + z",
    "prod": "x * y * z",
    "cbrt": "copysign(abs(x) ** (1 / 3), x)",
    "exp2": "2.0 ** x",
}
MATHEMATICS = {
    name: traceable_mathematics(function)
    for name, function in vars(math).items()
    if callable(function) and not name.startswith("_")
}
REPLACED: dict[Any, Callable[..., Any] | SimpleNamespace] = {
    **{getattr(math, name): new for name, new in MATHEMATICS.items()},
    math: SimpleNamespace(**vars(math) | MATHEMATICS),
    flow.repeat: traceable_repeat,
    flow.attempted: traceable_attempted,
}
