"""Branches: functions full of them give the same bits as their equations."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np

from fmukit.fmu.load import load
from fmukit.fmu.make import make_all
from fmukit.fmu.python.instance import slave_class
from fmukit.trace import tracer
from fmukit.trace.values import Leaf
from fmukit.write.c import definition
from tests.hosts.host import Unit

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
    a: Ratio = real(0.3, "Input")
    b: Ratio = real(-0.4, "Input")
'''
TERMS = (
    "{} + {}", "{} - {}", "{} * {}", "{} / (1.5 + abs({}))", "min({}, {})", "max({}, {})",
    "sin({})", "cos({}) - {}", "sqrt(abs({}))", "tanh({}) * {}", "atan({})", "exp(-abs({}))",
    "({} if {} > 0.1 else {})", "-{}", "abs({}) % (1.0 + abs({}))",
)  # fmt: skip


class Writer:
    """A function at random: assignments, branches in branches, early ends, calls of others."""

    def __init__(self, rng: random.Random, name: str, others: list[str]) -> None:
        self.rng, self.others, self.lines = rng, others, [f"def {name}(p, n0, n1):"]
        self.forks = 4
        known = self.block(["n0", "n1", "p.c"], 1, 3)
        self.lines.append(f"    return {self.term(known)} + {self.term(known)}")

    def term(self, known: list[str]) -> str:
        form = self.rng.choice(TERMS if self.forks > 0 else TERMS[6:12])
        self.forks -= " if " in form or form[:2] in ("mi", "ma")
        args = [self.rng.choice([*known, repr(self.rng.uniform(-2, 2))]) for _ in range(3)]
        if self.others and self.rng.random() < 0.15:
            return f"{self.rng.choice(self.others)}(p, {args[0]}, {args[1]})"
        return f"({form.format(*args)})"

    def block(self, known: list[str], depth: int, length: int) -> list[str]:
        """Statements; the names that are known after them."""
        indent = "    " * depth
        for _ in range(self.rng.randint(1, length)):
            name = f"v{len(self.lines)}"
            if depth < 4 and self.forks > 0 and self.rng.random() < 0.6:
                self.forks -= 1
                either = [n for n in known if n.startswith("v")][-2:]
                self.lines.append(f"{indent}{name} = {self.term(known)}")
                condition = f"{self.term(known)} < {self.term(known)}"
                self.lines.append(f"{indent}if {condition}:")
                for n, branch in enumerate(("if", "else")):
                    if n:
                        self.lines.append(f"{indent}{branch}:")
                    inner = self.block(known, depth + 1, 2)
                    for target in (name, *either):
                        self.lines.append(f"{indent}    {target} = {self.term(inner)}")
                if self.forks > 0 and self.rng.random() < 0.2:
                    self.forks -= 1
                    self.lines.append(f"{indent}if {self.term(known)} > 1.8:")
                    self.lines.append(f"{indent}    return {self.term(known)}")
            else:
                self.lines.append(f"{indent}{name} = {self.term(known)}")
            known = [*known, name]
        return known


def written(seed: int, count: int) -> str:
    """A model whose outputs are so many functions at random."""
    rng, names, text = random.Random(seed), [f"f{n}" for n in range(count)], ""
    for n, name in enumerate(names):
        text += "\n".join(Writer(rng, name, names[max(0, n - 2) : n]).lines) + "\n"
    fields = "".join(
        f'    {n}: Ratio = real(0.0, "Output", feedthrough=("a", "b"))\n' for n in names
    )
    values = ", ".join(f"{n}={n}(p, u.a, u.b)" for n in names)
    end = f"def outputs(p, t, x, u):\n    return Outputs({values})\n"
    return f"{HEAD}@record\nclass Outputs:\n{fields}{text}{end}"


def compared(seed: int, count: int, folder: Path) -> None:
    path = folder / f"random_{seed}.py"
    path.write_text(written(seed, count))
    model = load(path)
    assert make_all([path], "python", folder) == 0
    slave: Any = slave_class(model, "guid")(instance_name="unit")
    known = slave.interface.by_name
    unit = Unit(folder / f"Random{seed}.fmu").start()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    rng, found = random.Random(seed), []
    for n in range(60):
        inputs = {name: rng.choice([rng.uniform(-3, 3), 0.0]) for name in ("a", "b")}
        slave.set_real([known[name].reference for name in inputs], list(inputs.values()))
        slave.do_step(0.1 * n, 0.1)
        expected = slave.get_real([known[f"f{place}"].reference for place in range(count)])
        assert unit.set(**inputs).step(0.1 * n, 0.1).outputs() == expected
        found.append(expected)
    assert np.mean(np.ptp(np.array(found), axis=0) > 0) > 0.8


def test_twenty_functions_at_random_give_the_same_bits_in_python(tmp_path: Path) -> None:
    compared(1, 20, tmp_path)


def test_what_follows_a_branch_is_written_once() -> None:
    def run(x: Any, y: Any) -> Any:
        for _ in range(6):
            x = x + 1.0 if x > y else x * y
        return x

    made = tracer.function("f", run, {"x": "number", "y": "number"})
    assert made is not None
    assert isinstance(made.tree, Leaf)
    assert len(definition(made).splitlines()) < 60


def test_a_branch_that_fails_keeps_its_place_among_what_may_fail() -> None:
    def run(x: Any, y: Any) -> Any:
        a = 1.0 / x
        if y < 0.0:
            raise ValueError(f"y = {y!r}")
        return a + 1.0 / y

    made = tracer.function("f", run, {"x": "number", "y": "number"})
    assert made is not None
    assert [node.op for node in made.tree.nodes] == ["/", "join", "/", "+"]
