"""What a model may lack has a default, and what it has under an almost right name is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from fmukit.codegen.entries import generate
from fmukit.declare.interface import Interface, co_simulation_only_reason
from fmukit.declare.model import DEFAULTS
from fmukit.declare.record import start
from fmukit.fmu.contract import FUNCTIONS
from fmukit.fmu.load import ModelError, load
from fmukit.fmu.terminals import flanges
from fmukit.runtime import hybrid

#: A model with everything that one may lack. It bumps once, for 0.2 ms, which only a short sub-step sees.
COMPLETE = '''"""Wheel that has everything"""
from fmukit import Experiment, real, record
from fmukit.si import AngularVelocity, Ratio, Torque
EXPERIMENT = Experiment(stop=0.1, step=0.01)
LONGEST_STEP = 1e-4
FLANGES = {"flange": ("tau", "w")}
PYTHON_ONLY = "of a reason"
CO_SIMULATION_ONLY = "of another reason"
@record
class Parameters:
    c: Ratio = real(2.0, "Parameter")
@record
class Inputs:
    tau: Torque = real(1.0, "Torque")
@record
class State:
    w: AngularVelocity = real(0.5, "Speed")
    twice: Ratio = real(0.0, "Follows", follows=True, held=True)
    bumps: Ratio = real(0.0, "Bumps", held=True)
@record
class Outputs:
    y: Ratio = real(0.0, "Output")
def derivatives(p, t, x, u, factor=1.0):
    return State(factor * u.tau - p.c * x.w, 0.0, 0.0)
def outputs(p, t, x, u):
    return Outputs(x.w * p.c)
def check(p):
    yield "unusual"
def step_constants(p, x):
    return 3.0
def exact(p, x, u0, u1, h):
    return State(7.0, 0.0, x.bumps) if x.w < 0.6 else None
def event_indicators(p, t, x, u):
    return (abs(t - 0.0333) - 1e-4 if x.bumps < 1.0 else 1.0,)
def event_update(p, t, x, u, which):
    return State(x.w, x.twice, x.bumps + 1.0)
def sample(p, t, x, before, now):
    return State(x.w + 0.01, x.twice, x.bumps)
def complete_state(p, x):
    return State(x.w, 2.0 * x.w, x.bumps)
def notes(p, t, old, new, u):
    if new.bumps > old.bumps:
        yield "bump"
'''
PAIR = ("event_indicators", "event_update")


def without(*names: str) -> str:
    """The model without these functions and constants."""
    text = COMPLETE
    for name in names:
        text, times = re.subn(
            rf"^def {name}\(.*\n(?: .*\n)+|^{name} = .*\n", "", text, flags=re.MULTILINE
        )
        assert times == 1
    return text


def load_text(text: str, folder: Path) -> Any:
    path = folder / "wheel.py"
    path.write_text(text)
    return load(path)


def behaviour(model: Any) -> tuple[Any, ...]:
    """All that an optional name may change: warnings, ends of ten steps, notes, terminals and flavours."""
    interface, sentences = Interface(model), list[str]()
    p, x, u = (start(cls) for cls in (model.Parameters, model.State, model.Inputs))
    rows = []
    for n in range(10):
        inputs = hybrid.input_trajectory(0, u, u, 0.01, 0.01)
        x = hybrid.step(model, p, n * 0.01, x, u, u, inputs, sentences.append)
        rows.append(x)
    ends = (flanges(interface), model.PYTHON_ONLY, co_simulation_only_reason(model))
    return list(model.check(p)), rows, sentences, *ends


@pytest.mark.parametrize("name", DEFAULTS)
def test_each_optional_name_may_be_missing_and_matters_where_it_is_not(
    name: str, tmp_path: Path
) -> None:
    names = PAIR if name in PAIR else (name,)
    model = load_text(without(*names), tmp_path)
    assert [getattr(model, n) for n in names] == [DEFAULTS[n] for n in names]
    assert behaviour(model) != behaviour(load_text(COMPLETE, tmp_path))
    assert generate(model).indicators == (name not in PAIR)


@pytest.mark.parametrize("name", [*DEFAULTS, "derivatives", "outputs"])
def test_a_misspelt_name_is_refused_with_what_to_write(name: str, tmp_path: Path) -> None:
    form = f"def {name}({FUNCTIONS[name]})" if name in FUNCTIONS else f"{name} = ..."
    for misspelt in (name[:-1], name + "s", name[:-2] + name[-1] + name[-2], name.swapcase()):
        text = re.sub(rf"^(def )?{name}\b", rf"\1{misspelt}", COMPLETE, flags=re.MULTILINE)
        line = next(
            n for n, row in enumerate(text.splitlines(), 1) if misspelt in row.split("(")[0]
        )
        refusal = f"wheel.py:{line}: nothing uses {misspelt}: write {form}"
        with pytest.raises(ModelError, match=re.escape(refusal)):
            load_text(text, tmp_path)


def test_a_misspelt_constant_with_a_type_and_a_misspelt_record_are_refused(tmp_path: Path) -> None:
    for right, wrong, form in (
        ("LONGEST_STEP =", "LONGEST_STEPS: float =", "LONGEST_STEP = ..."),
        ("class Inputs", "class Input", "class Inputs"),
    ):
        with pytest.raises(ModelError, match=f"nothing uses .*: write {form}$"):
            load_text(COMPLETE.replace(right, wrong), tmp_path)


@pytest.mark.parametrize("name", [name for name in DEFAULTS if f"def {name}(" in COMPLETE])
def test_a_function_with_other_arguments_is_refused(name: str, tmp_path: Path) -> None:
    text = re.sub(rf"def {name}\(.*\)", f"def {name}(p, z, y, x, w, v, u)", COMPLETE)
    with pytest.raises(ModelError, match=re.escape(f"write def {name}({FUNCTIONS[name]})")):
        load_text(text, tmp_path)
