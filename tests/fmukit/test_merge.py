"""Branches: functions full of them give the same bits as their equations."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmukit.fmu.load import load
from fmukit.fmu.make import make_all
from fmukit.fmu.native import package
from fmukit.trace import tangents, tracer
from fmukit.trace.graph import size
from tests.hosts.host import Equations, Unit

HEAD = '''"""Functions with branches"""
from __future__ import annotations
from math import atan, cos, exp, sin, sqrt, tanh
from fmukit import Experiment, real, record
from fmukit.si import Ratio
EXPERIMENT = Experiment(stop=0.1, step=0.1)
@record
class Parameters:
    c: Ratio = real(0.7, "Parameter")
@record
class Inputs:
    note: Ratio = real(0.3, "Input")
    result: Ratio = real(-0.4, "Input")
@record
class State:
    v0_0: Ratio = real(0.1, "State")
'''
TERMS = (
    "{} + {}", "{} - {}", "{} * {}", "{} / (1.5 + abs({}))", "min({}, {})", "max({}, {})",
    "sin({})", "cos({}) - {}", "sqrt(abs({}))", "tanh({}) * {}", "atan({})", "exp(-abs({}))",
    "({} if {} > 0.1 else {})", "-{}", "abs({}) % (1.0 + abs({}))",
)  # fmt: skip
NAMES = [
    "c", "n0", "n1", "j0", "v0_0", "v0_1", "d_c", "p_c", "note", "result", "done", "int", "double",
    "self", "Slave", "functions", "inputs", "values", "model_step", "within", "travel", "slope", "main",
    "exit", "errno", "libm_sin", "math_pow", "fail", "defined", "größe", "restrict", "fmi2DoStep",
]  # fmt: skip


class Writer:
    """A function at random: assignments, branches in branches, early ends, calls of others; its names
    are those that the printers and the runtimes use.
    """

    def __init__(self, rng: random.Random, name: str, callees: list[str], forks: int) -> None:
        self.rng, self.callees, self.forks = rng, callees, forks
        self.names = rng.sample(NAMES, len(NAMES))
        self.locals: set[str] = set()
        parameters = [self.names.pop() for _ in range(2)]
        self.lines = [f"def {name}(p, {', '.join(parameters)}):"]
        names_in_scope = self.block([*parameters, "p.c"], 1, 3)
        self.lines.append(f"    return {self.term(names_in_scope)} + {self.term(names_in_scope)}")

    def term(self, names_in_scope: list[str]) -> str:
        form = self.rng.choice(TERMS if self.forks > 0 else TERMS[6:12])
        self.forks -= " if " in form or form[:2] in ("mi", "ma")
        args = [self.rng.choice([*names_in_scope, repr(self.rng.uniform(-2, 2))]) for _ in range(3)]
        if self.callees and self.rng.random() < 0.15:
            return f"{self.rng.choice(self.callees)}(p, {args[0]}, {args[1]})"
        return f"({form.format(*args)})"

    def block(self, names_in_scope: list[str], depth: int, length: int) -> list[str]:
        """Statements; the names that are known after them."""
        indent = "    " * depth
        for _ in range(self.rng.randint(1, length)):
            name = self.names.pop() if self.names else f"v{len(self.lines)}"
            if depth < 4 and self.forks > 0 and self.rng.random() < 0.6:
                self.forks -= 1
                either = [n for n in names_in_scope if n in self.locals][-2:]
                self.lines.append(f"{indent}{name} = {self.term(names_in_scope)}")
                condition = f"{self.term(names_in_scope)} < {self.term(names_in_scope)}"
                self.lines.append(f"{indent}if {condition}:")
                for n, branch in enumerate(("if", "else")):
                    if n:
                        self.lines.append(f"{indent}{branch}:")
                    inner = self.block(names_in_scope, depth + 1, 2)
                    for target in (name, *either):
                        self.lines.append(f"{indent}    {target} = {self.term(inner)}")
                if self.forks > 0 and self.rng.random() < 0.2:
                    self.forks -= 1
                    self.lines.append(f"{indent}if {self.term(names_in_scope)} > 1.8:")
                    self.lines.append(f"{indent}    return {self.term(names_in_scope)}")
            else:
                self.lines.append(f"{indent}{name} = {self.term(names_in_scope)}")
            self.locals.add(name)
            names_in_scope = [*names_in_scope, name]
        return names_in_scope


def written(seed: int, count: int, forks: int) -> str:
    """A page with so many functions at random: one is the slope of its state, all are outputs."""
    rng, text = random.Random(seed), ""
    names = [f"{rng.choice(NAMES)}_{n}" for n in range(count)]
    for n, name in enumerate(names):
        text += "\n".join(Writer(rng, name, names[n - n % 3 : n], forks).lines) + "\n"
    fields = "".join(
        f'    y{n}: Ratio = real(0.0, "Output", feedthrough=("note", "result"))\n'
        for n in range(count)
    )
    values = ", ".join(f"{name}(p, u.note + x.v0_0, u.result)" for name in names)
    end = (
        f"def derivatives(p, t, x, u):\n    return State(tanh({names[0]}(p, x.v0_0, u.note)))\n"
        f"def outputs(p, t, x, u):\n    return Outputs({values})\n"
    )
    return f"{HEAD}@record\nclass Outputs:\n{fields}{text}{end}"


def without_derivatives(_: Any, traced: Any, moving: Any) -> Any:
    """What `tangents.derived` returns, with zeros: here nobody asks, and compilers take long over it."""
    more = {f"{name}'": tangents.untyped_shape(traced.parameters[name]) for name in moving}
    zeros = (0.0,) * size(traced.shape)
    return tracer.trace_function(traced.name, lambda **_: zeros, traced.parameters | more)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Native FMUs without module and derivatives."""
    monkeypatch.setattr(package, "wasm_module", lambda build: build.guid.encode())
    monkeypatch.setattr(tangents, "derived", without_derivatives)


def compared(seed: int, count: int, forks: int, folder: Path) -> None:
    """Equations and both FMUs give the same bits, through steps of swinging inputs."""
    path = folder / f"random_{seed}.py"
    path.write_text(written(seed, count, forks))
    assert not make_all([path], "python", folder)
    model = load(path)
    (folder / "native").mkdir()
    package.write_fmu(package.hashed_build(model), folder / "native" / f"Random{seed}.fmu")
    paths = [folder / flavour / f"Random{seed}.fmu" for flavour in ("", "native")]
    rows = []
    for unit in (Equations(model), *map(Unit, paths)):
        rng, outputs = random.Random(seed), []
        unit.start()
        for n in range(60):
            note, result = (rng.choice([rng.uniform(-3, 3), 0.0]) for _ in range(2))
            outputs.append(unit.set(note=note, result=result).step(0.1 * n, 0.1).outputs())
        rows.append(outputs)
    assert rows[0] == rows[1] == rows[2]
    assert np.mean(np.ptp(np.array(rows[0]), axis=0) > 0) > 0.5


@pytest.mark.usefixtures("quick")
def test_twenty_functions_at_random_give_the_same_bits_in_both_fmus(tmp_path: Path) -> None:
    compared(1, 20, 2, tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("seed", range(20))
def test_two_hundred_functions_at_random_give_the_same_bits_in_both_fmus(
    seed: int, tmp_path: Path
) -> None:
    compared(100 + seed, 10, 4, tmp_path)
