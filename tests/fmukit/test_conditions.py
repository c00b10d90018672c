"""Conditions: both arms are followed and joined, whatever form they have; what is printed computes what Python does."""

from __future__ import annotations

import cProfile
import importlib.util
import itertools
import random
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from fmukit.codegen import python
from fmukit.codegen.entries import generate
from fmukit.fmu.load import load
from fmukit.trace.graph import Function, UntraceableError
from fmukit.trace.tracer import Tracer, record_note

NUMBERS = itertools.count()
HEAD = "from __future__ import annotations\nfrom math import sqrt, sin\nfrom typing import NamedTuple\n"
#: Bodies of `f(x, y, z)`, one for each rule; all are called with random numbers.
BODIES = {
    "if else": "if x > y:\n    a = x * z\nelse:\n    a = y\nreturn a + z",
    "if alone": "a = z\nif x > y:\n    a = a + x\nreturn a",
    "augmented": "a = z\nif x > y:\n    a += x\nelse:\n    a *= y\na -= 1.0\nreturn a",
    "elif": "if x > 1.0:\n    a = 1.0\nelif x > 0.0:\n    a = y\nelif y > 0.0:\n    a = z\nelse:\n    a = x\nreturn a",
    "within": "a = b = 0.0\nif x > 0.0:\n    if y > 0.0:\n        a = x\n    else:\n        b = y\n    a = a + b\nreturn a - b",
    "swap": "a, b = y, z\nif x > 0.0:\n    a, b = b, a\nreturn a - 2.0 * b",
    "one arm only": "if x > 0.0:\n    a = y\n    b = a * a\nelse:\n    b = z\nreturn b",
    "correlated": "if x > 0.0:\n    a = y\nb = 0.0\nif x > 0.0:\n    b = a * a\nreturn b",
    "return": "if x > y:\n    return x - y\nreturn z",
    "returns": "if x > 1.0:\n    return x\nif y > 1.0:\n    a = y\n    return a * z\nelse:\n    a = z\nb = a + x\nif b > 0.0:\n    return b\nreturn -b",
    "return within": "a = z\nif x > 0.0:\n    if y > 0.0:\n        return y\n    a = x\nreturn a",
    "both return": "if x > y:\n    return x\nelse:\n    return y",
    "expression": "return (x if x > y else y) * (z if z > 0.0 else -z)",
    "nested expression": "return x if x > 0.0 else y if y > 0.0 else z",
    "and": "return 1.0 if x > 0.0 and y > 0.0 and 1.0 / y > z else 2.0",
    "or": "return 1.0 if x <= 0.0 or sqrt(x) > y or z > 0.0 else 2.0",
    "and or not": "a = x > 0.0 and not y > 0.0 or z > 0.0\nreturn x if a else y",
    "value of and": "return (x and y) + (y or z)",
    "truth": "if x:\n    return y\nreturn z",
    "not": "if not x > y:\n    return y\nreturn 1.0 if not z else 0.0",
    "unequal": "if x != y:\n    return 1.0 / (x - y)\nreturn z",
    "chain": "return 1.0 if -0.5 < x <= y < 0.9 else 0.0",
    "chained call": "return 1.0 if 0.0 < g(x, y) < g(z, 0.1) else 0.0",
    "min max": "return min(max(x, y), 0.3, z) + max([x, z]) + min(1, x)",
    "saturations": "for _ in range(30):\n    x = min(max(1.3 * x + 0.1, -z), abs(y))\n    x = x - 0.5 if x > 0.4 else x\nreturn x",
    "tuple": "a = (x, (y, z)) if x > y else (z, (x, 1.0))\nb, (c, d) = a\nreturn b + 2.0 * c + 3.0 * d",
    "record": "a = P(x, y)\nif z > 0.0:\n    a = a._replace(a=z)\nreturn a.a - a.b",
    "records": "return 1.0 if P(x, y) == P(x, z) else 2.0 if (x, y) != (x, y) else 3.0",
    "lists": "a = [x, y]\nif z > 0.0:\n    a = [y, z]\nreturn sum(a) * a[0]",
    "lists of two lengths": "a = [x]\nif z > 0.0:\n    a = [y, z]\nreturn sum(a)",
    "none": "a = None\nif x > 0.0:\n    a = y\nreturn z if a is None else a",
    "text": "a = 'u' if x > 0.0 else 'v'\nreturn y if a == 'u' else z",
    "count": "n = 2 if x > 0.0 else 3\nreturn sum(y * k for k in range(n))",
    "count plus one": "n = 2 if x > 0.0 else 3\nif y > 0.0:\n    n = n + 1\nreturn sum(y * k for k in range(n + 1))",
    "append": "a = [x]\nif y > 0.0:\n    a.append(y)\nif z > 0.0:\n    a.append(z)\nreturn sum(a)",
    "method": "a = [x]\nadd = a.append\nif y > 0.0:\n    add(z)\nreturn sum(a)",
    "object": "a = Sum(x)\nif y > 0.0:\n    a.add(z)\nreturn a.value",
    "set": "a = {1}\nif y > 0.0:\n    a.add(2)\nreturn x * len(a)",
    "item": "a = [x, y]\nif z > 0.0:\n    a[0] = z\nreturn a[0] - a[1]",
    "helper with effect": "a = [x]\ndef more(b):\n    a.append(b)\nif y > 0.0:\n    more(z)\nreturn sum(a)",
    "iterator": "a = iter((x, y, z))\nb = next(a)\nif x > 0.0:\n    b = next(a)\nreturn b + next(a)",
    "closure": "def h(b):\n    return b + a\na = x\nif y > 0.0:\n    a = z\nreturn h(1.0)",
    "own function": "if x > 0.0:\n    def h(b):\n        return b * y\nelse:\n    def h(b):\n        return b + z\nreturn h(2.0)",
    "lambda": "h = lambda b: b if b > x else x\nreturn h(y) + h(z)",
    "comprehension": "return sum([a if a > x else x for a in (y, z, 0.1)]) + sum(b for b in (x, y) if b > 0.0)",
    "continue": "a = 0.0\nfor b in (x, y, z):\n    if b < 0.0:\n        continue\n    if b > 0.8:\n        continue\n    a = a + b * b\nreturn a",
    "break": "a = 0.0\nfor b in (x, y, z):\n    if b < 0.0:\n        break\n    a += b\nreturn a",
    "return in a loop": "for b in (x, y, z):\n    if b > 0.5:\n        return b\nreturn 0.0",
    "across a loop": "a, old = 0.0, 0.0\nfor b in (x, y, z):\n    if b > 0.0:\n        a = a + old\n        old = b\nreturn a + old",
    "raise": "if x > 0.7:\n    raise ValueError(f'x = {x!r}')\nreturn sqrt(1.0 - x) + y",
    "raise between": "a = 1.0 / y if y else z\nif x > 0.5:\n    raise ValueError(f'a = {a!r}')\nreturn a / z",
    "all raise": "if z > 0.0:\n    return y\nif x > 0.0:\n    raise ValueError('above')\nelif y > 0.0:\n    raise ValueError('below')\nelse:\n    raise ValueError(f'at {z!r}')",
    "key": "if x > 0.0:\n    return {}[1]\nreturn y",
    "walrus": "if (a := x + y) > 0.0:\n    return a\nb = (c := z) + c if x > y else 0.0\nreturn a * b",
    "division in an arm": "a = x / y if y != 0.0 else 0.0\nreturn a + (1.0 / z if z > 0.0 else 0.0)",
    "the same in both": "if x > 0.0:\n    a = y * z\nelse:\n    a = y * z\nreturn a + y * z",
    "integers": "k = 1 if x > 0.0 else -1 if y > 0.0 else 0\nreturn z if k == 1 else x if k < 0 else y * k",
    "match": "match x > 0.0 and y > 0.0:\n    case a if a:\n        b = y\n    case _:\n        b = z\nreturn b",
    "while": "n = 0\nwhile n < 3:\n    if x > 0.1:\n        x = x * y\n    n += 1\nreturn x",
    "shadowed": "min = g\nreturn min(x, y) if z > 0.0 else z",
    "defaults": "return g(x) if x > 0.0 else g(y, z)",
}  # fmt: skip
WITH = """
class P(NamedTuple):
    a: float
    b: float
class Sum:
    def __init__(self, value):
        self.value = value
    def add(self, more):
        self.value = self.value + more
def g(a, b=0.25, *, c=2.0):
    return a * c if a > b else b
"""


def module_of(text: str, folder: Path) -> ModuleType:
    """A module with this text."""
    name = f"conditions_{next(NUMBERS)}"
    path = folder / f"{name}.py"
    path.write_text(HEAD + text)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec and spec.loader
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def function_of(body: str) -> str:
    """The text of a module with a function of this body."""
    return WITH + "def f(x, y, z):\n" + "\n".join("    " + line for line in body.splitlines())


def of(module: ModuleType) -> Callable[..., Any]:
    """The function `f` that the module has when it is called, which tracing replaces."""

    def call(**numbers: Any) -> Any:
        return module.f(**numbers)

    return call


def trace_functions(run: Callable[..., Any], module: ModuleType) -> list[Function]:
    """A function of three numbers, after those of the module that it calls."""
    tracer = Tracer(module, {})
    tracer.trace_entry("entry", run, x=0.0, y=0.0, z=0.0)
    return [function for function in tracer.functions.values() if function]


def print_and_load(run: Callable[..., Any], module: ModuleType) -> Callable[..., Any]:
    """The function as it is printed in Python, which takes `note` first."""
    made: dict[str, Any] = {}
    exec(python.module(trace_functions(run, module), ("entry",)), made)  # noqa: S102
    entry: Callable[..., Any] = made["entry"]
    return entry


def answer(run: Callable[..., Any], *numbers: float) -> tuple[Any, ...]:
    """What a function returns for these numbers, or that it raises an error."""
    try:
        result = run(*numbers)
    except (ValueError, ArithmeticError, LookupError):
        return ("error",)
    return (*map(float, result if isinstance(result, tuple) else (result,)),)


def numbers_at_random() -> Iterator[list[float]]:
    """Three numbers each, some of them zero or equal."""
    rng = random.Random(7)
    for _ in range(300):
        yield [rng.choice((rng.uniform(-1, 1), 0.0, 0.5)) for _ in range(3)]


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_a_condition_of_any_form_computes_what_python_does(body: str, tmp_path: Path) -> None:
    module = module_of(function_of(body), tmp_path)
    entry = print_and_load(of(module), module)
    answers = set()
    for numbers in numbers_at_random():
        expected = answer(module.f, *numbers)
        assert answer(lambda *n: entry(print, *n), *numbers) == expected
        answers.add(expected)
    assert len(answers) > 1


def test_conditions_around_sentences_tell_those_that_python_yields(tmp_path: Path) -> None:
    text = "def more(x):\n    if x > 0.3:\n        yield f'more {x!r}'\ndef check(x, y, z):\n    yield 'first'\n"
    for n in range(25):
        text += f"    if {'xyz'[n % 3]} > {n / 30 - 0.4}:\n        yield f'{n} {{y!r}}'\n"
    text += "    if x > 0.0 and y > z:\n        yield from more(z)\n        yield 'last'\n"
    module = module_of(text, tmp_path)

    def tell(x: Any, y: Any, z: Any) -> None:
        for sentence in module.check(x, y, z):
            record_note(sentence)

    entry, told = print_and_load(tell, module), []
    for numbers in numbers_at_random():
        sentences: list[str] = []
        entry(sentences.append, *numbers)
        assert sentences == list(module.check(*numbers))
        told.append(len(sentences))
    assert len(set(told)) > 5


def test_more_paths_than_can_be_followed_are_refused_with_the_function(tmp_path: Path) -> None:
    lines = [f"if x > {n}.0:\n    a.append(y)" for n in range(12)]
    module = module_of(function_of("\n".join(["a = [z]", *lines, "return sum(a)"])), tmp_path)
    with pytest.raises(UntraceableError, match="more than 1024 paths through f"):
        trace_functions(of(module), module)


SATURATED = '''"""Saturations in a row"""
from __future__ import annotations
from math import sin
from fmukit import Experiment, real, record
from fmukit.si import Ratio
EXPERIMENT = Experiment(stop=8.0, step=0.25)
@record
class State:
    x: Ratio = real(0.1, "State")
@record
class Outputs:
    y: Ratio = real(0.0, "Slope")
def slope(t, a):
    b = 1.5 * sin(t) - a
{}
    return b
def derivatives(p, t, x, u):
    return State(slope(t, x.x))
def outputs(p, t, x, u):
    return Outputs(slope(t, x.x))
'''


def write_saturations(count: int, folder: Path) -> Path:
    """A model whose slope passes so many saturations, of two forms."""
    lines = []
    for n in range(count):
        top = 1.0 - 0.005 * n
        statement = (
            f"    if b > {top}:\n        b = {top}\n    elif b < -0.9 * a:\n        b = -0.9 * a"
        )
        lines.append(statement if n % 2 else f"    b = 1.01 * min(max(b, -{top}), {top} + 0.1 * a)")
    path = folder / f"saturated_{count}.py"
    path.write_text(SATURATED.format("\n".join(lines)))
    return path


def test_saturations_in_a_row_are_traced_in_proportion_to_their_number(tmp_path: Path) -> None:
    """As many more cost as many more calls, and as much more source; the first model fills the caches."""
    calls, sizes = [], []
    for count in (1, 13, 37, 61):
        profile, model = cProfile.Profile(), load(write_saturations(count, tmp_path))
        sizes.append(len(profile.runcall(generate, model).c))
        calls.append(sum(entry.callcount for entry in profile.getstats()))
    for cost in (calls, sizes):
        assert cost[3] - cost[2] == pytest.approx(cost[2] - cost[1], rel=0.1)
