"""How often a stated error holds the true one.

Coupled systems whose solution is known, linear ones by the matrix exponential, nonlinear ones by
DOP853 at 1e-12, and the machines of the scenarios by the oracle, are certified with three algorithms
and five steps each. The truth is that of continuous time. Shown are the figures that were stated and refused, the share of those stated that
lie within their error, the worst ratio of true to stated error, and how wide the errors are. The exit status is 1
if too few of them hold, or if a synthetic case does not keep what it promises.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import OdeSolution, simpson, solve_ivp
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import brentq, minimize_scalar

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.certify_cases import Case, relaxing_pair, state_at, synthetic_cases
from cosim import (
    Adaptive,
    Result,
    Series,
    SimulationError,
    System,
    oracle,
    quiet,
)
from cosim.accuracy.certify import estimates_of
from cosim.accuracy.nested import nested_runs
from cosim.metrics import (
    Crossing,
    Largest,
    Last,
    Mean,
    Metric,
    Rms,
    Smallest,
    TimeOfLargest,
)
from cosim.series import TIME, Column
from scenarios.conveyor import machine
from scenarios.conveyor.first_order import SETS
from scenarios.exciter.questions import sommerfeld as exciter
from scenarios.iron import machine as iron
from scenarios.orientator import machine as orientator
from scenarios.packing_line.questions import packing_line as line
from tests import linear_systems as linear
from tests.coupling_theory import Ideal, Scheme

#: The page that this backs, and its heading.
CLAIM = ("docs/certify.md", "What `certify` promises")

FMUS = ROOT / "fmus"
ALGORITHMS = ("jacobi", "gauss-seidel", "strang")
#: Step sizes of a case, each half as long as the one before: a convention, which limits the time of a run.
HALVINGS = 5
#: Machines that are run with adaptive steps, too, beside all conveyors, and the tolerances. Chosen: a run has some hundred
#: steps; those of algorithms of order 1 are in proportion to the tolerance, and below 1 us for a conveyor at 1e-4.
ADAPTIVE = ("conveyor", "iron from rest", "exciter", "masses with play")
TOLERANCES = (1e-2, 1e-3, 1e-4)
#: Times at which a known solution is computed: a convention, odd as Simpson's rule demands.
FINE = 20001
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
#: Accuracy of the time of an extreme, over the duration: a convention, far below TRUTH_ERROR.
EXTREME_ACCURACY = 1e-12
#: Accuracy of the time at which a level is crossed [s]: a convention, near the rounding of the time.
CROSSING_ACCURACY = 1e-14
#: Level whose crossing is timed, over the range from the least to the largest value: a convention, off the middle,
#: at which many motions have a symmetry.
CROSSED_LEVEL = 0.6
#: Least ratio of true to stated error in the table: a convention, which keeps exact figures from a division by zero.
LEAST_RATIO = 1e-9
#: By kind the largest share of errors stated that may not hold, and the largest ratio of true to stated error.
DEMANDS = {"relaxing pairs": (0.02, 3.0), "synthetic": (0.005, 2.0), "hidden impacts": (0.005, 2.0)}
#: The same of the others.
DEMAND = (0.005, math.inf)
#: Draws of a relaxing pair: eight have some four thousand figures.
PAIRS = 8
#: Largest share that may be refused of what can be determined.
MOST_REFUSED = 0.05
#: Figures of a column and a level: as a metric, and of rows as one writes them who does not think of them.
FIGURES: dict[str, tuple[Callable[[str, float], Metric], Callable[[Any, Any, float], Any]]] = {
    "end": (lambda c, _: Last(c), lambda t, x, _: x[-1]),
    "max": (lambda c, _: Largest(c), lambda t, x, _: x.max()),
    "min": (lambda c, _: Smallest(c), lambda t, x, _: x.min()),
    "mean": (lambda c, _: Mean(c), lambda t, x, _: x.mean()),
    "rms": (lambda c, _: Rms(c), lambda t, x, _: math.sqrt((x**2).mean())),
    "time of max": (lambda c, _: TimeOfLargest(c), lambda t, x, _: t[np.argmax(x)]),
    "crossing": (
        lambda c, level: Crossing(c, level=level),
        lambda t, x, level: first_change(t, x > level),
    ),
}


class Half(NamedTuple):
    """Two states: their rates as expressions, start values, what the inputs hear."""

    f1: str
    f2: str
    x: tuple[float, float]
    u: tuple[str, ...]


@dataclass(frozen=True)
class HalvedSystem:
    """Two halves, a stop and a longest step [s]; a period of the fastest motion has 20 of them."""

    parts: Mapping[str, Half]
    stop: float
    step: float
    columns: Sequence[str]


def nonlinear(draw: Callable[[float, float], float]) -> dict[str, HalvedSystem]:
    """Systems with parameters that are drawn between bounds."""
    a, b = draw(0.8, 1.4), draw(0.8, 1.4)
    mu = draw(0.5, 2.0)
    drag, force = draw(0.1, 0.4), draw(0.3, 0.6)
    lag, load = draw(0.05, 0.2), draw(0.5, 1.5)
    flow = draw(0.5, 1.0)
    pull, slip = draw(2.0, 4.0), draw(8.0, 15.0)
    tune = draw(1.8, 2.6)
    return {
        "Lotka-Volterra": HalvedSystem(
            {
                "prey": Half(f"x1 * ({a} - u1)", "0.0", (1.5, 0.0), ("hunter.x1",)),
                "hunter": Half(f"x1 * (u1 - {b})", "0.0", (0.7, 0.0), ("prey.x1",)),
            }, 5.0, 0.25, ("prey.x1", "hunter.x1"),
        ),
        "van der Pol": HalvedSystem(
            {
                "place": Half("u1", "0.0", (0.5, 0.0), ("speed.x1",)),
                "speed": Half(f"{mu} * (1 - u1 * u1) * x1 - u1", "0.0", (1.0, 0.0), ("place.x1",)),
            }, 8.0, 0.1, ("place.x1", "speed.x1"),
        ),
        "Duffing": HalvedSystem(
            {
                "place": Half("u1", "0.0", (0.3, 0.0), ("speed.x1",)),
                "speed": Half(
                    f"-{drag} * x1 + u1 - u1**3 + {force} * cos(1.2 * t)", "0.0", (0.0, 0.0),
                    ("place.x1",),
                ),
            }, 5.0, 0.15, ("place.x1", "speed.x1"),
        ),
        "pendulum on a motor": HalvedSystem(
            {
                "motor": Half(f"(5.0 * (4.0 - u1) - x1) / {lag}", "0.0", (0.0, 0.0), ("arm.x1",)),
                "arm": Half(f"(u1 - 9.81 * sin(x2)) / {load}", "x1", (0.0, 0.2), ("motor.x1",)),
            }, 3.0, 0.02, ("motor.x1", "arm.x1"),
        ),
        "two tanks": HalvedSystem(
            {
                "upper": Half(
                    f"{flow} * (1 + 0.5 * sin(2 * t)) - sqrt(x1) * (1 + 0.2 * u1)", "0.0",
                    (0.3, 0.0), ("lower.x1",),
                ),
                "lower": Half("sqrt(u1) - 0.8 * sqrt(x1)", "0.0", (1.2, 0.0), ("upper.x1",)),
            }, 6.0, 0.2, ("upper.x1", "lower.x1"),
        ),
        "Kloss motor": HalvedSystem(
            {
                "motor": Half(
                    f"(2 * 20 / ((1 - u1 / 100) / 0.2 + 0.2 / (1 - u1 / 100)) - x1) * {slip}",
                    "0.0", (0.0, 0.0), ("fan.x1",),
                ),
                "fan": Half(f"(u1 - 1e-3 * x1 * x1) / {0.1 * pull}", "0.0", (0.0, 0.0),
                            ("motor.x1",)),
            }, 4.0, 0.02, ("motor.x1", "fan.x1"),
        ),
        "Brusselator": HalvedSystem(
            {
                "maker": Half(f"1 + x1 * x1 * u1 - {tune + 1} * x1", "0.0", (1.2, 0.0),
                              ("other.x1",)),
                "other": Half(f"{tune} * u1 - u1 * u1 * x1", "0.0", (1.5, 0.0), ("maker.x1",)),
            }, 6.0, 0.05, ("maker.x1", "other.x1"),
        ),
    }  # fmt: skip


def coupled(halved: HalvedSystem, fmu: Path) -> Case:
    """The halves as FMUs, and their solution as one."""
    wires, start = [], {}
    for name, half in halved.parts.items():
        start |= {f"{name}.f1": half.f1, f"{name}.f2": half.f2}
        start |= {f"{name}.x1": half.x[0], f"{name}.x2": half.x[1]}
        wires += [f"{source} -> {name}.u{k}" for k, source in enumerate(half.u, 1)]
        start |= {f"{name}.u{k}": 0.0 for k in range(len(half.u) + 1, 3)}
    names = [f"{name}.x{k}" for name in halved.parts for k in (1, 2)]
    rates = {
        name: eval(f"lambda t, x1, x2, u1, u2: ({half.f1}, {half.f2})", vars(math).copy())
        for name, half in halved.parts.items()
    }

    def rhs(t: float, y: Any) -> list[float]:
        values = dict(zip(names, y))
        derivatives: list[float] = []
        for name, half in halved.parts.items():
            u = [values[source] for source in half.u] + [0.0] * (2 - len(half.u))
            derivatives += rates[name](t, values[f"{name}.x1"], values[f"{name}.x2"], *u)
        return derivatives

    y0 = [x for half in halved.parts.values() for x in half.x]
    solution = solution_over_time(rhs, y0, halved.stop)
    exact = {c: partial(state_at, solution, names.index(c)) for c in halved.columns}
    system = System(dict.fromkeys(halved.parts, fmu), wires, start)
    return Case(system, halved.stop, halved.step, exact)


def solution_over_time(
    rhs: Callable[[float, Any], Any], y0: Any, stop: float, start: float = 0.0
) -> OdeSolution:
    """The solution as a function of time."""
    accuracy = {"rtol": SOLUTION_TOLERANCE, "atol": SOLUTION_TOLERANCE}
    return solve_ivp(rhs, (start, stop), y0, "DOP853", dense_output=True, **accuracy).sol


def matrices(draw: Callable[[float, float], float]) -> dict[str, tuple[Any, float, float]]:
    """Linear units, a stop and a longest step [s]."""
    return {
        "oscillator": (linear.OSCILLATOR, 0.9, 0.01),
        "dual mass": (linear.DUAL_MASS, 2.0, 0.02),
        "quarter car": (linear.QUARTER_CAR, 0.6, 0.004),
        "DC motor": (linear.DC_MOTOR, 0.02, 1e-4),
        "drive": (linear.drive(draw(50.0, 200.0)), 0.1, 5e-4),
        "lagging motor": (
            linear.lagging_motor(draw(0.03, 0.06), draw(0.5, 1.5), draw(100.0, 400.0)), 0.1, 2e-4,
        ),
        "twisting drive": (linear.twisting_drive(draw(1.0, 20.0)), 0.1, 5e-4),
        "spring and mass": (linear.SPRING_AND_MASS, 1.2, 0.03),
    }  # fmt: skip


def exact_units(units: Any, stop: float, step: float) -> Case:
    """Linear units stepped by the ideal algorithms, which FMUs follow to the last digits (see
    tests/cosim/verification.py), and the matrix exponential of the coupled system.
    """
    ideal = Ideal(units)
    h = stop / (FINE - 1)
    x = ideal.exact([h] * (FINE - 1))
    rates = x @ ideal.coupled_rates[:-1, :-1].T + ideal.coupled_rates[:-1, -1]
    solution = CubicHermiteSpline(np.linspace(0, stop, FINE), x, rates)
    names = linear.states(units)
    columns = [names[0], names[-1]]
    exact = {c: partial(state_at, lambda t: solution(t).T, names.index(c)) for c in columns}

    def runner(_: System, *, step: float, algorithm: str, **__: Any) -> Result:
        count = round(stop / step)
        x = ideal.states(Scheme(algorithm), [stop / count] * count)
        t = np.linspace(0.0, stop, len(x))
        dense = np.column_stack([t, *(x[:, names.index(c)] for c in columns)])
        fed = any(unit.D is not None for unit in units.values())
        order = 2 if algorithm == "strang" and not fed else 1
        return Result(
            [TIME, *map(Column, columns)], {"convergence_order": order}, dense.T.__getitem__
        )

    return Case(linear.couple(units, FMUS / "LinearSystem.fmu"), stop, step, exact, runner)


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


def truth(x: Callable[[Any], Any], stop: float) -> dict[str, float]:
    """The figures of a column in continuous time; the level is at CROSSED_LEVEL of its range."""
    t = np.linspace(0.0, stop, FINE)
    values = np.asarray(x(t))
    figures = {"end": float(values[-1])}
    times = np.union1d(t, np.linspace(0.0, EARLY * stop, CLOSE))
    samples = np.asarray(x(times))
    for name, sign in (("max", 1.0), ("min", -1.0)):
        top = int(np.argmax(sign * samples))
        time = float(times[top])
        if 0 < top < len(times) - 1:
            near = (times[top - 1], times[top + 1])
            time = minimize_scalar(lambda s, sign=sign: -sign * float(x(s)), bounds=near, method="bounded",
                                    options={"xatol": EXTREME_ACCURACY * stop}).x  # fmt: skip
        figures[name] = max(sign * float(x(time)), sign * float(samples[top])) * sign
        figures[f"time of {name}"] = time
    figures["mean"] = float(simpson(values, x=t)) / stop
    figures["rms"] = math.sqrt(float(simpson(values**2, x=t)) / stop)
    level = (1.0 - CROSSED_LEVEL) * figures["min"] + CROSSED_LEVEL * figures["max"]
    passed = np.flatnonzero((values[1:] > level) != (values[:-1] > level))
    k = int(passed[0])
    figures["crossing"] = float(
        brentq(lambda s: float(x(s)) - level, t[k], t[k + 1], xtol=CROSSING_ACCURACY)
    )
    return {"level": level} | figures


def first_change(t: Any, state: Any) -> float:
    """The first time [s] of a row whose state is another one than at the start; nan without one."""
    other = state != state[0]
    return float(t[np.argmax(other)]) if other.any() else math.nan


class Verdict(NamedTuple):
    """A figure that was stated, and the truth."""

    system: str
    algorithm: str
    step: float  # or the tolerance
    method: str
    figure: str
    true: float
    value: float
    error: float | None
    order: float
    size: float
    promise: bool | None = None  # whether it must be stated, or refused

    @property
    def ratio(self) -> float:
        """True over stated error; the truth itself is known to TRUTH_ERROR of the largest value, when a discrete
        column changes to half the distance of the oracle's rows.
        """
        assert self.error is not None
        truth_error = 0.5 / (REFERENCE_ROWS - 1) if self.figure == "event" else TRUTH_ERROR
        return max(0.0, abs(self.value - self.true) - truth_error * self.size) / self.error


def judged(
    name: str,
    case: Case,
    algorithms: Sequence[str] = ALGORITHMS,
    halvings: int = HALVINGS,
    *,
    steps: Sequence[float | Adaptive] = (),
) -> Iterator[Verdict]:
    """Every figure of a case, with halved steps or the given ones."""
    truths = {column: truth(x, case.stop) for column, x in case.exact.items()}
    metrics: dict[str, Metric] = {
        f"between rows|{column}|{figure}": metric(column, true["level"])
        for column, true in truths.items()
        for figure, (metric, _) in FIGURES.items()
    } | {
        f"between rows|{column}|event": Crossing(column, level=level)
        for column, (level, _) in case.changes.items()
    }
    fixed = [case.stop / (round(case.stop / case.step) * 2 ** (k + 2)) for k in range(halvings)]
    for algorithm, h in product(case.algorithms or algorithms, steps or fixed):
        settings = {
            "stop": case.stop, "algorithm": algorithm, "record": [*case.exact, *case.changes]
        }  # fmt: skip
        try:
            with nested_runs(case.system, h, case.runner, settings) as runs:
                estimates = estimates_of(metrics, runs, case.system)
                for column, true in truths.items():
                    of_rows = partial(_by_rows, column, true["level"])
                    estimates |= estimates_of(of_rows, runs, case.system)
        except SimulationError as error:  # a step beyond the limit of stability
            print(name, algorithm, h, error, file=sys.stderr)
            continue
        for key, got in estimates.items():
            method, column, figure = key.split("|")
            true = truths.get(column) or {"event": case.changes[column][1]}
            size = case.stop if figure in ("crossing", "event") or "time" in figure else max(
                abs(true["max"]), abs(true["min"]))  # fmt: skip
            step = h.tolerance if isinstance(h, Adaptive) else h
            yield Verdict(
                f"{name} {column}", algorithm, step, method, figure, true[figure], got.value,
                got.error, got.order, size, case.promises.get(figure),
            )  # fmt: skip


def _by_rows(column: str, level: float, result: Result) -> dict[str, float]:
    """The figures of the rows of a column."""
    t, x = result["time"], result[column]
    return {f"by rows|{column}|{n}": float(of(t, x, level)) for n, (_, of) in FIGURES.items()}


def complaints(kind: str, verdicts: Sequence[Verdict]) -> Iterator[str]:
    """What the errors of a kind of systems must keep and do not."""
    most, worst = DEMANDS.get(kind, DEMAND)
    stated = [v for v in verdicts if v.error is not None]
    outside = float(np.mean([v.ratio > 1.0 for v in stated] or [0.0]))
    if outside > most:
        yield f"{outside:.2%} outside, {kind}"
    yield from (f"off by {v.ratio:.2f} times its error: {v}" for v in stated if v.ratio > worst)
    yield from (f"not refused: {v}" for v in stated if v.promise is False)
    refused = [v.error is None for v in verdicts if v.promise]
    if refused and np.mean(refused) > MOST_REFUSED:
        yield f"{np.mean(refused):.1%} refused of what can be determined, {kind}"


def driven_lags(
    draw: Callable[[float, float], float],
    half: Path,
    levels: Mapping[float, float],
    profile: Any = None,
) -> Case:
    """Two lags that feed each other, and an input over time: levels from times [s] on, or a profile which is as good as these."""
    first, second = draw(0.05, 0.2), draw(0.1, 0.4)
    wires = ["b.x1 -> a.u1", "a.x1 -> b.u1"]
    start = {"a.f1": f"(u2 - u1 - x1) / {first}", "b.f1": f"(u1 - x1) / {second}", "b.u2": 0.0}
    times, y = [*levels, 1.0], np.zeros(2)
    profile = profile or Series.of(
        {"t": np.repeat(times, 2)[1:-1], "u": np.repeat([*levels.values()], 2)}
    )
    system = System({"a": half, "b": half}, wires, start, inputs={"a.u2": profile})
    pieces = []
    for k, u in enumerate(levels.values()):
        rates = lambda _, y, u=u: [(u - y[1] - y[0]) / first, (y[0] - y[1]) / second]
        pieces.append(solution_over_time(rates, y, times[k + 1], times[k]))
        y = pieces[-1](times[k + 1])

    def exact(k: int, t: Any) -> Any:
        at = np.searchsorted(times[1:-1], np.asarray(t, dtype=float), side="right")
        return np.select([at == n for n in range(len(pieces))], [piece(t)[k] for piece in pieces])

    return Case(system, 1.0, 0.02, {"a.x1": partial(exact, 0), "b.x1": partial(exact, 1)})


def inputs_over_time(seed: int, half: Path) -> Iterator[tuple[str, str, Case]]:
    """Inputs that jump at points of all runs, and inside their steps; and some that change within the finest step.

    A pulse of about a step is half resolved: the means of the steps show it, but not when it is.
    """
    draw = uniform_sampler(seed)
    for name, share in (("at all points", 0.0), ("inside steps", draw(0.1, 0.9))):
        at = (round(draw(10.0, 30.0)) + share) * 0.02
        levels = {0.0: draw(-0.5, 0.5), at: draw(1.0, 2.0)}
        yield "known jumps", f"jump {name}", driven_lags(draw, half, levels)
    period = 0.02 / 2 ** (HALVINGS + 1)
    swing = lambda t: 0.3 + math.cos(2.0 * math.pi * t / period)
    yield "inputs within the step", "cosine", driven_lags(draw, half, {0.0: 0.3}, swing)
    for kind, shares in (("inputs within the step", (1e-3, 1e-2)), ("half resolved", (0.5, 3.0))):
        begin = draw(0.3, 0.6)
        levels = {0.0: 0.0, begin: 1e3, begin + draw(*shares) * period: 0.0}
        yield kind, f"pulse, {kind}", driven_lags(draw, half, levels)


def cases(seed: int, half: Path) -> Iterator[tuple[str, Case]]:
    """Systems whose solution is known, with parameters drawn by a seed."""
    draw = uniform_sampler(seed)
    for name, halved in nonlinear(draw).items():
        yield name, coupled(halved, half)
    for name, (units, stop, step) in matrices(draw).items():
        yield name, exact_units(units, stop, step)


def uniform_sampler(seed: int) -> Callable[[float, float], float]:
    """Numbers between bounds; their middle for a seed of 0."""
    random = np.random.default_rng(seed)
    return lambda low, high: float(random.uniform(low, high)) if seed else (low + high) / 2


def table(verdicts: Sequence[Verdict], key: Callable[[Verdict], str]) -> Iterator[str]:
    """A line per group."""
    groups = defaultdict(list)
    for v in verdicts:
        groups[key(v)].append(v)
    yield f"{'':40} stated refused  within  worst  median error/true"
    for name, group in groups.items():
        stated = [v for v in group if v.error is not None]
        ratios = np.array([v.ratio for v in stated]) if stated else np.array([0.0])
        wide = np.median(1.0 / np.maximum(ratios, LEAST_RATIO))
        yield (
            f"{name:40} {len(stated):6} {len(group) - len(stated):7} {np.mean(ratios <= 1):7.1%} "
            f"{ratios.max():6.2f} {wide:8.1f}"
        )


def systems(seed: int, half: Path) -> Iterator[tuple[str, str, Case]]:
    """The kind, the name and the case of each system."""
    draw = uniform_sampler(seed)
    yield from ((kind, name, case) for name, kind, case in synthetic_cases(draw))
    for k in range(PAIRS):
        yield (
            "relaxing pairs",
            "relaxing pair",
            relaxing_pair(uniform_sampler(PAIRS * seed + k + 1)),
        )
    yield from (("known solutions", name, case) for name, case in cases(seed, half))
    yield from inputs_over_time(seed, half)
    for name, arguments in machines(uniform_sampler(seed), FMUS / "native").items():
        yield "machines", name, integrated(*arguments)


def main() -> None:
    """Print the tables and the complaints; exit with status 1 if there are any."""
    from pythonfmu import FmuBuilder

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worst", type=int, default=10)
    parser.add_argument("--only", default="", help="systems whose name has this in it")
    options = parser.parse_args()
    by_kind: dict[str, list[Verdict]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder, quiet():
        FmuBuilder.build_FMU(ROOT / "tests" / "hosts" / "half.py", dest=folder)
        for kind, name, case in systems(options.seed, Path(folder) / "Half.fmu"):
            if options.only not in f"{kind}, {name}":
                continue
            by_kind[kind] += judged(name, case)
            if kind == "machines" and name.startswith(ADAPTIVE):
                steps = [Adaptive(tolerance) for tolerance in TOLERANCES]
                by_kind["adaptive"] += judged(name, case, ["strang"], steps=steps)
            print(name, sum(map(len, by_kind.values())), file=sys.stderr, flush=True)
    for kind, group in by_kind.items():
        print("\n".join(table(group, lambda v, kind=kind: f"{kind}, {v.method}")))  # type: ignore[misc]
    verdicts = [*chain(*by_kind.values())]
    for key in ("system", "figure", "algorithm"):
        print(
            "\n".join(table(verdicts, lambda v, key=key: f"{getattr(v, key)}, {v.method}")),
            end="\n\n",
        )  # type: ignore[misc]
    stated = sorted((v for v in verdicts if v.error is not None), key=lambda v: -v.ratio)
    for v in stated[: options.worst]:
        print(f"{v.ratio:6.2f} {v}")
    violated = [*chain(*(complaints(kind, group) for kind, group in by_kind.items()))]
    print("\n".join(violated))
    sys.exit(bool(violated))


if __name__ == "__main__":
    main()
