"""How often a stated error holds the true one: of systems whose solution is exact, and of machines by the oracle.

Drawn systems of each kind of `certify_draws` are certified with one of all algorithms, with fixed or adaptive steps;
one kind are members of a certified sweep, one nonlinear systems without events, whose FMUs keep no state, one the machines
of the scenarios, whose truth is that of the oracle, these with five steps each, and one synthetic runs, which say beforehand
what of them can be determined. The truth is that of continuous time.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import OdeSolution, solve_ivp
from scipy.interpolate import CubicSpline

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.certify_cases import Case, state_at, synthetic_cases
from benchmarks.certify_draws import FIGURES, KINDS, Drawn, Piece, Truth, draw
from benchmarks.coverage import Demand, Stated, Study, Trial, main
from cosim import (
    SimulationError,
    System,
    certify,
    oracle,
    quiet,
    sweep,
)
from cosim.accuracy.certify import estimates_of
from cosim.accuracy.nested import nested_runs
from cosim.metrics import (
    Crossing,
    Metric,
)
from scenarios.conveyor import machine
from scenarios.conveyor.first_order import SETS
from scenarios.exciter.questions import sommerfeld as exciter
from scenarios.iron import machine as iron
from scenarios.orientator import machine as orientator
from scenarios.packing_line.questions import packing_line as line

#: The page that this backs, and its heading.
CLAIM = ("docs/certify.md", "What `certify` promises")

FMUS = ROOT / "fmus"
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
#: Step sizes of a case, each half as long as the one before: a convention, which limits the time of a run.
HALVINGS = 5
#: Rows of a reference solution: a convention, whose spacing limits how exactly the time of an event is known.
REFERENCE_ROWS = 4001
#: Share of the time in which what starts from rest is looked at more closely: a convention.
EARLY = 1e-3
#: Times in that share: a convention, at a 20th of the spacing of FINE.
CLOSE = 401
#: Error of the truth, relative to the largest value: a convention, which limits the stated errors that are tested.
TRUTH_ERROR = 1e-7
#: Tolerance of the solution of a nonlinear system, relative and absolute: a convention, far below TRUTH_ERROR.
SOLUTION_TOLERANCE = 1e-12
#: Level whose crossing is timed, over the range from the least to the largest value: a convention, off the middle,
#: at which many motions have a symmetry.
CROSSED_LEVEL = 0.6


class Half(NamedTuple):
    """One state or two: their rates as expressions of t, x1, x2, u1 and u2, the state that u1 hears, start values."""

    f1: str
    x1: float
    hears: str
    f2: str = "0.0"
    x2: float = 0.0


@dataclass(frozen=True)
class HalvedSystem:
    """Two halves, a stop and a longest step [s]; a period of the fastest motion has 20 of them. Columns are all first states."""

    parts: Mapping[str, Half]
    stop: float
    step: float


def nonlinear(draw: Callable[[float, float], float]) -> dict[str, HalvedSystem]:
    """Systems with parameters that are drawn between bounds."""
    a, b = draw(0.8, 1.4), draw(0.8, 1.4)
    mu = draw(0.5, 2.0)
    drag, force = draw(0.1, 0.4), draw(0.3, 0.6)
    lag, load = draw(0.05, 0.2), draw(0.5, 1.5)
    flow = draw(0.5, 1.0)
    pull, slip = draw(2.0, 4.0), draw(8.0, 15.0)
    tune = draw(1.8, 2.6)
    slope = f"-{drag} * x1 + u1 - u1**3 + {force} * cos(1.2 * t)"
    kloss = "2 * 20 / ((1 - u1 / 100) / 0.2 + 0.2 / (1 - u1 / 100))"
    inflow = f"{flow} * (1 + 0.5 * sin(2 * t)) - sqrt(x1) * (1 + 0.2 * u1)"
    return {
        "Lotka-Volterra": HalvedSystem({
            "prey": Half(f"x1 * ({a} - u1)", 1.5, "hunter.x1"),
            "hunter": Half(f"x1 * (u1 - {b})", 0.7, "prey.x1"),
        }, 5.0, 0.25),
        "van der Pol": HalvedSystem({
            "place": Half("u1", 0.5, "speed.x1"),
            "speed": Half(f"{mu} * (1 - u1 * u1) * x1 - u1", 1.0, "place.x1"),
        }, 8.0, 0.1),
        "Duffing": HalvedSystem({
            "place": Half("u1", 0.3, "speed.x1"),
            "speed": Half(slope, 0.0, "place.x1"),
        }, 5.0, 0.15),
        "pendulum on a motor": HalvedSystem({
            "motor": Half(f"(5.0 * (4.0 - u1) - x1) / {lag}", 0.0, "arm.x1"),
            "arm": Half(f"(u1 - 9.81 * sin(x2)) / {load}", 0.0, "motor.x1", "x1", 0.2),
        }, 3.0, 0.02),
        "two tanks": HalvedSystem({
            "upper": Half(inflow, 0.3, "lower.x1"),
            "lower": Half("sqrt(u1) - 0.8 * sqrt(x1)", 1.2, "upper.x1"),
        }, 6.0, 0.2),
        "Kloss motor": HalvedSystem({
            "motor": Half(f"({kloss} - x1) * {slip}", 0.0, "fan.x1"),
            "fan": Half(f"(u1 - 1e-3 * x1 * x1) / {0.1 * pull}", 0.0, "motor.x1"),
        }, 4.0, 0.02),
        "Brusselator": HalvedSystem({
            "maker": Half(f"1 + x1 * x1 * u1 - {tune + 1} * x1", 1.2, "other.x1"),
            "other": Half(f"{tune} * u1 - u1 * u1 * x1", 1.5, "maker.x1"),
        }, 6.0, 0.05),
    }  # fmt: skip


def coupled(halved: HalvedSystem, fmu: Path) -> Case:
    """The halves as FMUs, and their solution as one."""
    wires, start = [], {}
    for name, half in halved.parts.items():
        values = {"f1": half.f1, "f2": half.f2, "x1": half.x1, "x2": half.x2, "u2": 0.0}
        start |= {f"{name}.{x}": value for x, value in values.items()}
        wires.append(f"{half.hears} -> {name}.u1")
    names = [f"{name}.x{k}" for name in halved.parts for k in (1, 2)]
    rates = {
        name: eval(f"lambda t, x1, x2, u1: ({half.f1}, {half.f2})", vars(math).copy())
        for name, half in halved.parts.items()
    }

    def rhs(t: float, y: Any) -> list[float]:
        x = dict(zip(names, y))
        return [
            rate
            for name, half in halved.parts.items()
            for rate in rates[name](t, x[f"{name}.x1"], x[f"{name}.x2"], x[half.hears])
        ]

    y0 = [x for half in halved.parts.values() for x in (half.x1, half.x2)]
    solution = solution_over_time(rhs, y0, halved.stop)
    exact = {names[k]: partial(state_at, solution, k) for k in range(0, len(names), 2)}
    system = System(dict.fromkeys(halved.parts, fmu), wires, start)
    return Case(system, halved.stop, halved.step, exact)


def solution_over_time(
    rhs: Callable[[float, Any], Any], y0: Any, stop: float, start: float = 0.0
) -> OdeSolution:
    """The solution as a function of time."""
    accuracy = {"rtol": SOLUTION_TOLERANCE, "atol": SOLUTION_TOLERANCE}
    return solve_ivp(rhs, (start, stop), y0, "DOP853", dense_output=True, **accuracy).sol


def machines(
    draw: Callable[[float, float], float], native: Path
) -> dict[str, tuple[System, float, float, list[str], dict[str, float]]]:
    """Systems of the scenarios, a stop and a longest step [s], columns, and levels of discrete ones."""

    def of(parts: Mapping[str, str], wires: Sequence[str], start: Mapping[str, Any]) -> System:
        return System({k: native / f"{v}.fmu" for k, v in parts.items()}, wires, start)

    drives: dict[str, tuple[System, float, float, list[str], dict[str, float]]] = {
        f"conveyor of set {name}, {nu:.0f} rad/s": (
            of(machine.PARTS, machine.WIRES, SETS[name].start(nu) | {"conveyor.w": 0.8 * nu}),
            0.5, 2e-3, ["motor.tau", "conveyor.w"], {},
        )
        for name, speeds in {"A": (20.0, 40.0, 60.0), "B": (25.0, 50.0, 75.0)}.items()
        for nu in (speed * draw(0.9, 1.1) for speed in speeds)
    }  # fmt: skip
    rest = {"motor.characteristic": 1, "motor.tau": 0.0, "conveyor.w": 0.0}
    stuck = {"motor.A": 0.12, "motor.B": 6e-4, "motor.T": 0.01, "motor.tau": 0.0, "iron.phi": 0.3}
    w, mu = draw(3.0, 5.0), draw(0.3, 0.4)
    dropped = {"orientator.w": w, "orientator.release": 1, "orientator.chute.mu": mu}
    packing = line.PackingLine.parse({"gear": draw(1.2, 1.3)}).system(
        {k: native / f"{v}.fmu" for k, v in line.PackingLine.parts.items()}
    )
    play = {"shaft.b": 0.01, "shaft.c": draw(5e3, 2e4), "shaft.d": 5.0, "shaft.twist": 0.02,
            "one.J": 1.1, "two.J": 2.2, "one.w_a": 0.0, "two.w_a": 0.0, "one.tau_a": 0.0,
            "two.tau_b": 0.0, "one.i": 1.0, "two.i": 1.0, "one.eta": 1.0, "two.eta": 1.0}  # fmt: skip
    shaft = ["one.w_b -> shaft.w_a", "two.w_a -> shaft.w_b", "shaft.tau_a -> one.tau_b",
             "shaft.tau_b -> two.tau_a"]  # fmt: skip
    return drives | {
        "conveyor from rest": (
            of(machine.PARTS, machine.WIRES, SETS["B"].start(60.0) | rest), 0.5, 2e-3,
            ["motor.tau", "conveyor.w"], {},
        ),
        "iron from rest": (
            of(iron.PARTS, iron.WIRES, iron.MOTOR | {"motor.A": draw(3.8, 4.2)}), 1.0, 2e-3,
            ["motor.tau", "iron.w_cam"], {"iron.top_dwell": 0.5},
        ),
        "iron that falls back": (
            of(iron.PARTS, iron.WIRES, stuck), 0.8, 2e-3, ["motor.tau", "iron.w"],
            {"iron.direction": 0.0},
        ),
        "exciter": (
            of(exciter.Sommerfeld.parts, exciter.WIRES, {"motor.R": 5.0, "motor.v": draw(20.0, 28.0)}), 0.6,
            4e-3, ["exciter.w", "exciter.x"], {},
        ),
        "orientator": (
            of(orientator.PARTS, [], dropped), 0.4, 4e-3, ["orientator.phi2", "orientator.yc"],
            {"orientator.stage": 0.5},
        ),
        "packing line": (
            packing, 0.9, 2e-3, ["iron.w_cam", "conveyor.w"],
            {"iron.top_dwell": 0.5, "orientator.stage": 5.5},
        ),
        "masses with play": (
            of({"one": "Gearbox", "shaft": "ShaftLink", "two": "Gearbox"}, shaft, play), 0.15, 1e-3,
            ["one.w_a", "shaft.twist"], {},
        ),
    }  # fmt: skip


def integrated(
    system: System, stop: float, step: float, columns: list[str], levels: Mapping[str, float]
) -> Case:
    """Parts for model exchange, and the oracle's solution."""
    record, early = [*columns, *levels], EARLY * stop
    got = oracle(system, stop=stop, output_step=stop / (REFERENCE_ROWS - 1), record=record)
    first = oracle(system, stop=early, output_step=early / (CLOSE - 1), record=record)
    later = got["time"] > early
    times = np.append(first["time"], got["time"][later])
    last = np.append(np.diff(times) > 0.0, True)
    exact = {c: CubicSpline(times[last], np.append(first[c], got[c][later])[last]) for c in columns}
    changes = {}
    for name, level in levels.items():
        above = got[name] > level
        k = int(np.argmax(above != above[0]))
        changes[name] = level, float(got["time"][k - 1 : k + 1].mean())
    return Case(system, stop, step, exact, changes=changes)


def figures_of(x: Callable[[Any], Any], stop: float) -> tuple[float, dict[str, float]]:
    """A level, and the figures of a column in continuous time."""
    truth = Truth([Piece(0.0, stop, lambda t: np.atleast_2d(x(t)), 0.0)])
    bounds = truth.figures(0)
    level = (1.0 - CROSSED_LEVEL) * bounds["smallest"] + CROSSED_LEVEL * bounds["largest"]
    return level, truth.figures(0, level)


class Judged(NamedTuple):
    """A figure that was stated beside its truth, and whether it must be stated or refused, None where it may be either."""

    name: str
    figure: str
    stated: Stated
    promise: bool | None


def judged(
    name: str, case: Case, algorithms: Sequence[str] = ALGORITHMS, halvings: int = HALVINGS
) -> Iterator[Judged]:
    """Every figure of a case, with halved steps."""
    metrics: dict[str, Metric] = {}
    truths: dict[str, tuple[float, float]] = {}  # and how exactly the truth is known
    for column, x in case.exact.items():
        level, true = figures_of(x, case.stop)
        size = max(abs(true["largest"]), abs(true["smallest"]))
        for figure, value in true.items():
            key = f"{column}|{figure}"
            crossed = {"level": level} if figure == "crossing" else {}
            metrics[key] = FIGURES[figure](column, **crossed)
            timed = figure in ("crossing", "time of largest")
            truths[key] = value, TRUTH_ERROR * (case.stop if timed else size)
    for column, (level, at) in case.changes.items():
        metrics[f"{column}|event"] = Crossing(column, level=level)
        truths[f"{column}|event"] = at, 0.5 * case.stop / (REFERENCE_ROWS - 1)
    record = [*case.exact, *case.changes]
    steps = [case.stop / (round(case.stop / case.step) * 2 ** (k + 2)) for k in range(halvings)]
    for algorithm, h in product(case.algorithms or algorithms, steps):
        settings = {"stop": case.stop, "algorithm": algorithm, "record": record}
        try:
            with nested_runs(case.system, h, case.runner, settings) as runs:
                estimates = estimates_of(metrics, runs)
        except SimulationError as error:  # a step beyond the limit of stability
            print(name, algorithm, h, error, file=sys.stderr)
            continue
        for key, got in estimates.items():
            figure, (true, certain) = key.split("|")[1], truths[key]
            error = None if got.error is None else got.error + certain
            yield Judged(
                f"{name} {algorithm} {h:.3g} {key}", figure, Stated.of(got.value, error, true),
                case.promises.get(figure),
            )  # fmt: skip


def nonlinear_cases(seed: int, half: Path) -> Iterator[tuple[str, Case]]:
    """Nonlinear systems, with parameters drawn by a seed."""
    for name, halved in nonlinear(uniform_sampler(seed)).items():
        yield name, coupled(halved, half)


def uniform_sampler(seed: int) -> Callable[[float, float], float]:
    """Numbers between bounds; their middle for a seed of 0."""
    random = np.random.default_rng(seed)
    return lambda low, high: float(random.uniform(low, high)) if seed else (low + high) / 2


def drawn_trial(name: str, seed: int) -> Trial:
    """What is stated of a drawn system, of all kinds in turn where it is a member of a certified sweep."""
    kind = KINDS[seed % len(KINDS)] if name == "swept" else name
    folder = Path(tempfile.gettempdir()) / "drawn_fmus"
    folder.mkdir(exist_ok=True)
    drawn, words = draw(*divmod(seed, 1000), folder, kind), ""
    began = time.process_time()
    figures = dict.fromkeys(drawn.truth, Stated(None, None, None, 1.0))
    try:
        with quiet():
            figures = _certified(drawn) if name != "swept" else _swept(drawn)
    except SimulationError as error:
        words = str(error)
    return Trial(name, seed, figures, time.process_time() - began, words, drawn.name)


def _stated(drawn: Drawn, name: str, value: float, error: float | None) -> Stated:
    """A figure beside its truth, of which it may miss what is not certain of it."""
    true, certain = drawn.truth[name], drawn.certain[name]
    if error is not None:
        true = (
            value if abs(value - true) <= certain else true - math.copysign(certain, true - value)
        )
    return Stated.of(value, error, None if math.isnan(true) else true)


def _certified(drawn: Drawn) -> dict[str, Stated]:
    answer = certify(drawn.system, drawn.metrics, step=drawn.step, **drawn.settings).figures
    return {name: _stated(drawn, name, x.value, x.error) for name, x in answer.items()}


def _swept(drawn: Drawn) -> dict[str, Stated]:
    """The second of three members, which differ in a start value."""
    x = drawn.system.start["a.x1"]
    assert isinstance(x, float)
    cases = {"a.x1": [0.5 * x, x, 1.5 * x]}
    settings = drawn.settings | {"step": drawn.step}
    table = sweep(drawn.system, cases, drawn.metrics, certified=True, **settings)
    errors = {name: float(table[f"{name} error"].iloc[1]) for name in drawn.metrics}
    return {
        name: _stated(drawn, name, float(table[name].iloc[1]), None if math.isnan(e) else e)
        for name, e in errors.items()
    }


def known_trials(kind: str, seed: int) -> list[Trial]:
    """Nonlinear and linear systems with known solutions, synthetic runs, or machines, with several steps each."""
    trials = []
    for name, case in _cases_of(kind, seed):
        began = time.process_time()
        figures = {x.name: x.stated for x in judged(name, case)}
        trials.append(Trial(kind, seed, figures, time.process_time() - began, "", name))
    return trials


def _cases_of(kind: str, seed: int) -> Iterator[tuple[str, Case]]:
    sampler = uniform_sampler(seed)
    if kind == "synthetic":
        yield from synthetic_cases(sampler).items()
    elif kind == "machines":
        for name, arguments in machines(sampler, FMUS / "native").items():
            yield name, integrated(*arguments)
    else:
        from pythonfmu import FmuBuilder

        with tempfile.TemporaryDirectory() as folder:
            FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "half.py", dest=folder)
            yield from nonlinear_cases(seed, Path(folder) / "Half.fmu")


KNOWN = ("known solutions", "synthetic", "machines")
STUDY = Study(
    __doc__ or "",
    {kind: partial(drawn_trial, kind) for kind in (*KINDS, "swept")}
    | {kind: partial(known_trials, kind) for kind in KNOWN},
    number=1,
    demands=dict.fromkeys((*KINDS, "swept", *KNOWN), Demand(within=0.995)),
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
