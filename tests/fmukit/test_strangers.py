"""Models of anybody, from a file anywhere to FMUs of both flavours that compute their equations."""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import pairwise, product
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmukit.codegen.entries import generate
from fmukit.declare.interface import class_name
from fmukit.declare.record import declarations
from fmukit.fmu.load import load
from fmukit.fmu.make import make_all
from tests.conftest import ROOT
from tests.fmukit.test_exchange import Model
from tests.hosts.host import Equations, Unit

MODELS = sorted((ROOT / "tests" / "fmukit" / "models").glob("*.py"))
FLAVOURS = ("", "native")


def fmukit(*arguments: Any) -> str:
    """What the command line says."""
    command = [sys.executable, "-m", "fmukit", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """FMUs of the models, made in a folder of their own."""
    folder = tmp_path_factory.mktemp("strangers")
    message = fmukit("build", *MODELS, "--flavour", "both", "--out", folder)
    assert message.count("built and valid") == len(MODELS)
    return folder


def run(unit: Unit, model: ModuleType, **start: float) -> np.ndarray:
    """Time and outputs of the default experiment."""
    stop, h = model.EXPERIMENT
    actual = [[0.0, *unit.start(**start).outputs()]]
    for n in range(round(stop / h)):
        actual.append([(n + 1) * h, *unit.step(n * h, h).outputs()])
    return np.array(actual)


def compare_with_equations(path: Path, folder: Path) -> np.ndarray:
    """The default experiment of a model from its equations, whose bits both its FMUs in a folder have."""
    model = load(path)
    expected = run(Equations(model), model)
    for flavour in FLAVOURS:
        fmu = folder / flavour / f"{class_name(model)}.fmu"
        assert validate_fmu(str(fmu)) == []
        assert np.array_equal(run(Unit(fmu), model), expected)
    return expected


def build_and_compare(text: str, folder: Path) -> np.ndarray:
    """The same for the text of a model, of which the FMUs are made."""
    path = folder / "thing.py"
    path.write_text(text)
    assert not make_all([path], "both", folder)
    return compare_with_equations(path, folder)


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_equations_and_both_fmus_of_a_stranger_agree_to_the_last_bit(
    path: Path, built: Path
) -> None:
    compare_with_equations(path, built)


HEAD = '''"""Thing"""
from __future__ import annotations
import math
from enum import IntEnum
from fmukit import Experiment, discrete, real, record, replace
from fmukit.si import Length, Time
EXPERIMENT = Experiment(stop=0.1, step=0.01)
'''
BODY = """
@record
class Parameters:
    n0: Length = real(3.0, "Parameter", positive=True)
@record
class State:
    x: Length = real(2.0, "State")
def derivatives(p, t, x, u):
    return State(x=rate(x.x, p.n0))
"""
STILL = BODY.replace("rate(x.x, p.n0)", "p.n0")
INPUT = """
@record
class Inputs:
    r: Length = real(3.0, "Input")
    s: Length = real(3.0, "Input")
"""
OUTPUT = """
@record
class Outputs:
    y: Length = real(0.0, "Output"{})
def outputs(p, t, x, u):
    return Outputs(y={})
"""
JUMP = "def event_update(p, t, x, u, which):\n    return State(x=1.0)\n"


WINDING = f"""{HEAD}
@record
class Inputs:
    a: Length = real(1.0, "Input")
    b: Length = real(2.0, "Input")
    c: Length = real(3.0, "Input")
@record
class State:
    x: Length = real(2.0, "State")
@record
class Outputs:
    y: Length = real(0.0, "Through a function", feedthrough=("a",))
    same: Length = real(0.0, "The same on both sides of a condition")
    other: Length = real(0.0, "Selected by a condition", feedthrough=("b",))
    nested: Length = real(0.0, "Of two conditions", feedthrough=("a", "c"))
    refused: Length = real(0.0, "Of a state that an input refuses")
def derivatives(p, t, x, u):
    return x
def split(a, b, x):
    if a > 100.0 + math.exp(x):
        return a, b + 1.0, x
    return a * math.sin(a) * math.cos(a) * math.exp(-a) * math.sqrt(a * a), math.exp(b), x
def nested(u, x):
    if x > 1.0:
        return 1.0 if u.a > 0.7 else u.c
    return 1.0 if u.c > 3.5 else 1.0
def outputs(p, t, x, u):
    if u.c < -1e9:
        raise ValueError("too low")
    first, _, third = split(u.a, u.b, x.x)
    return Outputs(
        y=first, same=x.x if u.b > 1.0 else x.x, other=x.x if u.b > 1.0 else third * 2.0,
        nested=nested(u, x.x), refused=third,
    )
"""


def test_feedthrough_is_what_the_equations_use(tmp_path: Path) -> None:
    """Through functions, conditions and what may fail: neither more nor less, as numbers show."""
    path = tmp_path / "winding.py"
    path.write_text(WINDING)
    model = load(path)
    declared = {name: d.feedthrough for name, d in declarations(model.Outputs)}
    assert generate(model).warnings == ()
    acts: dict[str, set[str]] = {name: set() for name in declared}
    for values in product((0.0, 0.5, 2.0, 4.0), repeat=3):
        before = model.outputs(None, 0.0, model.State(2.0), model.Inputs(*values))
        for index, name in enumerate(("a", "b", "c")):
            u = model.Inputs(*values)._replace(**{name: values[index] + 1.0})
            after = model.outputs(None, 0.0, model.State(2.0), u)
            for output, old, new in zip(declared, before, after):
                acts[output] |= {name} if old != new else set()
    assert acts == {name: set(inputs) for name, inputs in declared.items()}
    for name, inputs in declared.items():
        for dropped in inputs:
            rest = "".join(f'"{other}", ' for other in inputs if other != dropped)
            changed = re.sub(rf"( {name}: .*feedthrough=)\(.*?\)", rf"\1({rest})", WINDING)
            assert changed != WINDING
            path = tmp_path / f"{name}_{dropped}.py"
            path.write_text(changed)
            refusal = f"^{name} of Outputs depends on {dropped} without delay"
            with pytest.raises(TypeError, match=refusal):
                generate(load(path))


def test_a_declared_input_that_does_not_act_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "thing.py"
    model.write_text(HEAD + INPUT + STILL + OUTPUT.format(', feedthrough=("r", "s")', "u.s * x.x"))
    assert not make_all([model], "python", tmp_path)
    message = capsys.readouterr().err
    assert message == (
        "Thing.fmu: warning: y of Outputs declares feedthrough of r, which its equation does not use: "
        'write y: ... = real(..., "...", feedthrough=("s",))\n'
    )


def test_an_event_indicator_without_a_finite_value_is_an_error(tmp_path: Path) -> None:
    """It was handed to the integrator with status OK."""
    path = tmp_path / "tall.py"
    guard = "def event_indicators(p, t, x, u):\n    return (x.x * p.n0,)\n"
    path.write_text(HEAD + STILL + guard + JUMP)
    assert not make_all([path], "native", tmp_path)
    fmu = tmp_path / "native" / "Tall.fmu"
    model = Model(fmu)
    assert model.all("EventIndicators", 1) == [6.0]
    model = Model(fmu, n0=1e308, x=2.0)
    message = model.refusal(lambda m: m.all("EventIndicators", 1))  # type: ignore[attr-defined]
    assert "event indicator 1 = inf must be a finite number" in message


def test_names_of_a_model_are_not_those_of_the_printers(tmp_path: Path) -> None:
    """Parameters called as the generated code calls its own values and parameters."""
    expected = build_and_compare(
        f"{HEAD}{BODY}"
        "def rate(n1, n0):\n"
        "    a = n1 * n1\n"
        "    b = other(a, n0, n0 + 1.0, n0 + 2.0, n1, a, b=n0)\n"
        "    return n1 + n0 * a if b > 3.0 else b\n"
        "def other(c, d_c, result, note, int, v0_1, b):\n"
        "    return c * 2.0 if d_c > result else note / int + v0_1 - b\n",
        tmp_path,
    )
    assert expected[1, 1] > 2.0


def test_a_state_may_have_vectors(tmp_path: Path) -> None:
    """An oscillator, with its first state beside the vector of the others."""
    expected = build_and_compare(
        HEAD.replace("import Experiment,", "import Experiment, array, fill,") + "@record\n"
        "class State:\n"
        '    y: Length = real(0.5, "Integral")\n'
        '    x: tuple[Length, Length] = array([2.0, 1.0], "State {0}")\n'
        "def derivatives(p, t, x, u):\n"
        "    return fill(State, [x.x[0], x.x[1], -x.x[0]])\n",
        tmp_path,
    )
    t = expected[:, 0]
    assert expected[:, 2] == pytest.approx(2.0 * np.cos(t) + np.sin(t), abs=1e-9)


MATHEMATICS = [
    "sin",
    "cos",
    "tan",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "exp",
    "expm1",
    "log",
    "log10",
    "log2",
    "log1p",
    "erf",
    "erfc",
    "sqrt",
    "floor",
    "ceil",
    "trunc",
    "fabs",
    "degrees",
    "radians",
]
MORE = (
    "math.asin(x / 9.0)", "math.acos(x / 9.0)", "math.acosh(x)", "math.atanh(x / 9.0)",
    "math.atan2(x, c)", "math.pow(x, c)", "math.fmod(x, 0.3)", "math.copysign(x, -c)",
    "math.log(x, c)", "2.0 ** x", "x ** c", "+x", "x // 0.3", "-x // 0.3", "7.5 % x", "7.5 // x",
    "abs(-x)", "max(x, c)", "x * math.isfinite(x) + 1.0",
)  # fmt: skip


def test_all_functions_of_math_that_c_has_give_the_same_bits(tmp_path: Path) -> None:
    terms = [f"math.{name}(x)" for name in MATHEMATICS] + list(MORE)
    fields = "".join(f'    y{n}: Length = real(0.0, "Output")\n' for n in range(len(terms)))
    values = ", ".join(f"y{n}={term}" for n, term in enumerate(terms))
    expected = build_and_compare(
        f"{HEAD}{BODY}def rate(x, c):\n    return 10.0 * c\n"
        f"@record\nclass Outputs:\n{fields}"
        f"def outputs(p, t, x, u):\n    x, c = x.x, p.n0\n    return Outputs({values})\n",
        tmp_path,
    )
    assert all(np.any(a != b) for a, b in pairwise(expected.T))


PLAIN = HEAD + BODY
#: First mistakes in place of something in PLAIN, before the records, after all, and in other models; each with a part
#: of its line.
REPLACED = (
    ('"""Thing"""\nfrom', "from",
     "thing.py: the docstring is missing: write"),
    ('real(2.0, "State")', "2.0",
     "thing.py:12: State.x has no declaration: write x: ... = real(2.0"),
    ("x: Length", "x: Furlong",
     "thing.py:12: Furlong in class State is not a type: from fmukit.si import one of Angle, "),
    ("    x: Length", "    größe: Length",
     "thing.py:12: State.größe is not a name in FMI: write letters from a to z"),
    ("x=rate(x.x, p.n0)", "x=p.m0",
     "thing.py:16: in derivatives: Parameters has no m0: it has n0"),
    (")\n@record\nclass", ")\nclass",
     "thing.py: class State needs @record above it"),
    ("positive=True", "min=5.0, positive=True",
     "thing.py:11: in Parameters: positive=True means min = 0 without the 0 itself: leave out min=5.0"),
    ("EXPERIMENT", "TEST",
     "thing.py: EXPERIMENT is missing: write"),
    ("x=rate", "x=math.hypot",
     "thing.py:16: in derivatives: hypot of math, which C computes differently: write sqrt(x * x"),
    ("x=rate(x.x, p.n0)", "x=[1.0, 2.0][x.x]",
     "thing.py:16: in derivatives: a number known only at run time used as a key"),
    ("x=rate(x.x, p.n0", "x=round(x.x",
     "thing.py:16: in derivatives: round() of a number known only at run time: write floor("),
    ("    return", "    while x.x > 1:\n        x = State(x.x / 2)\n    return",
     "thing.py:16: in derivatives: a loop whose end is known only at run time: write repeat("),
    ("x=rate(x.x, p.n0", "x=float(x.x",
     "thing.py:16: in derivatives: float() of a number known only at run time: leave it out"),
    ("State(x=rate(x.x, p.n0)", "replace(x, y=1.0",
     "thing.py:16: in derivatives: State has no y: it has x"),
    ("State(x=rate(x.x, p.n0))", "x.x / p.n0",
     "thing.py: derivatives returns a number: write return State(...)"),
    ("State(x=rate(x.x, p.n0))", "x.x, 1.0",
     "thing.py: derivatives returns a tuple: write return State(...)"),
    ("t, x", "x, t",
     "thing.py: derivatives takes p, x, t, u: write def derivatives(p, t, x, u)"),
    ("x, u", "x",
     "thing.py: derivatives takes p, t, x: write def derivatives(p, t, x, u)"),
    ("step=0.01", "step=-0.01",
     "thing.py: EXPERIMENT has stop = 0.1 s and step = -0.01 s: 0 < step <= stop"),
    ("x=rate(x.x, p.n0)", "",
     "thing.py:16: in derivatives: State(...) missing 1 required positional argument: 'x'"),
    ("    return", "    assert x.x < 9.0\n    return",
     "thing.py:16: assert cannot go into the FMU: write if not ...: raise ValueError(...)"),
    ("    return", "    match x.x > 1:\n        case True: pass\n    return",
     "thing.py:17: case True, False or None cannot go into the FMU: write if"),
    ("x=rate(x.x, p.n0)", "x=not x.x",
     "State.x is a condition, which is not a number: write 1.0 if ... else 0.0"),
    ("x=rate(x.x, p.n0)", "x=divmod(x.x, 2.0)[0]",
     "thing.py:16: in derivatives: divmod() of a number known only at run time: write x // y"),
    ("x=rate(x.x, p.n0)", "x=1.0 if (x.x > 1) & (p.n0 > 1) else 0.0",
     "thing.py:16: in derivatives: & between conditions: write 'and'"),
    ('"State"', '"State", nominal=0.0',
     "thing.py:12: State.x has nominal=0.0: write its order of magnitude, above 0"),
    ('"State"', '"State", min=3.0, max=1.0',
     "thing.py:12: State.x has min=3.0 above max=1.0"),
    ('"State"', '"State", nominal=1e999',
     "thing.py:12: State.x has nominal=inf: write a finite number, or leave it out"),
    ('"State"', '"State", min="10"',
     "thing.py:12: State.x has min='10': write a finite number, or leave it out"),
    ("stop=0.1", "stop='0.1'",
     "thing.py: EXPERIMENT has stop = '0.1' and step = 0.01: write numbers, in s"),
)  # fmt: skip
INSERTED = (
    ("from fmukit.si import Furlong\n",
     "thing.py:8: fmukit.si has no Furlong: import one of Angle, "),
    ("import numpy\n",
     "thing.py:8: numpy cannot go into the FMU: a model"),
    ("def rate(x, n):\n    x * n\n",
     "thing.py: in derivatives State.x is None, which is not a number"),
    ("k = 0\ndef rate(x, n):\n    global k\n    k += 1\n    return x * k\n",
     "thing.py:10: global cannot go into the FMU: what a function keeps must be in the State"),
    ("def rate(x, n):\n    try:\n        return n / x\n    except ZeroDivisionError:\n        return 0.0\n",
     "thing.py:9: try cannot go into the FMU, where nothing is raised: test with if"),
    ("def rate(x, n):\n    return rate(x, n)\n",
     "thing.py: derivatives calls itself without end"),
    ("def step_constants(p, x):\n    return x.x\n",
     "derivatives takes p, t, x, u: write def derivatives(p, t, x, u, constants=None)"),
)  # fmt: skip
APPENDED = (
    ("def outputs(p, t, x, u) -> None\n",
     "thing.py:17: expected ':'"),
    ("def event_indicators(p, t, x, u):\n    return (x.x,)\n",
     "thing.py: event_update is missing: write"),
    ("def event_update(p, t, x, u, which):\n    return State(x=1.0)\n",
     "thing.py: event_indicators is missing: write def event_indicators(p, t, x, u)"),
    ("@record\nclass Outputs:\n    x: Length = real(0.0, 'x')\ndef outputs(p, t, x, u):\n    return Outputs(x.x)\n",
     "thing.py: x is declared twice: every state is also an output"),
)  # fmt: skip
OTHERS = (
    (HEAD + 'class Kind(IntEnum):\n    a = 0\n' + BODY.replace('@record\nclass State', "    k: Kind = discrete(Kind.a, 'Kind')\n@record\nclass State").replace('rate(x.x, p.n0)', '0.0'),
     "thing.py: Kind has no docstring: write"),
    (HEAD + STILL + 'def event_indicators(p, t, x, u):\n    return x.x\n' + JUMP,
     "thing.py: event_indicators returns a number: write return (..., ...)"),
    (HEAD + STILL + 'def event_indicators(p, t, x, u):\n    return (x.x,)\n' + JUMP.replace('State(x=1.0)', '(1.0,)'),
     "thing.py: event_update returns a tuple: write return State(...)"),
    (HEAD + 'from itertools import count\nCALLS = count()\n' + BODY.replace('rate(x.x, p.n0)', 'x.x * next(CALLS)'),
     "thing.py: derivatives returns another value when it is called again with the same numbers"),
    (HEAD + INPUT + STILL + OUTPUT.format('', 'u.s * x.x'),
     'thing.py: y of Outputs depends on s without delay: write y: ... = real(..., "...", feedthrough=("s",))'),
    (HEAD + INPUT + STILL + OUTPUT.format(', feedthrough=("s",)', 'u.s if u.r > x.x else x.x'),
     'depends on r without delay: write y: ... = real(..., "...", feedthrough=("s", "r",))'),
    (HEAD + 'from typing import Annotated\nfrom fmukit.si import Quantity\nP = Annotated[float, Quantity("Pressure", "Pa", {"kg": 1, "m": -1})]\n' + BODY.replace('n0: Length', 'n0: P'),
     "thing.py:12: Parameters.n0: the unit Pa of Pressure has the exponents {'kg': 1, 'm': -1, 's': -2}, not {'kg': 1, 'm': -1}: write Quantity("),
    (HEAD + INPUT + STILL + OUTPUT.format(', feedthrough="s"', 'u.s * x.x'),
     'Outputs.y: write feedthrough=("s",), a tuple of names'),
    (HEAD + INPUT + STILL + OUTPUT.format(', feedthrough=("s", "q")', 'u.s * x.x'),
     "thing.py: y declares feedthrough of 'q', which is no input: "),
)  # fmt: skip
MISTAKES = [
    *((PLAIN.replace(old, new), message) for old, new, message in REPLACED),
    *((HEAD + text + BODY, message) for text, message in INSERTED),
    *((PLAIN + text, message) for text, message in APPENDED),
    *OTHERS,
]


@pytest.mark.parametrize(("text", "message"), MISTAKES)
def test_first_mistakes_get_a_line_with_their_position_and_what_to_write(
    text: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("thing.py").write_text(text)
    assert len(make_all([Path("thing.py")], "both", tmp_path)) == 1
    actual = capsys.readouterr().err
    assert len(actual.splitlines()) == 1
    assert message in actual
    assert not list(tmp_path.rglob("*.fmu"))
