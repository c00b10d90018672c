"""Coupling error against cost, compared with published results.

Two systems whose equations are made into FMUs here, from benchmarks/models: the quarter car of Schierz,
Arnold and Clauß (2012) on a step of the road, 4 s, rms error of all states; and the predators and prey
of MasterSim's tests (Nicolai, 2018), 100 s, largest error. Writes results/published.png and a table.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import Adaptive, System, run
from fmukit.fmu.make import make_all

#: The page that this backs, and its heading.
CLAIM = ("docs/speed.md", "Comparison with published results")

MODELS = Path(__file__).with_name("models")
#: Relative and absolute tolerance of the exact motion. Chosen: far below the least of TOLERANCES.
EXACT_TOLERANCE = 1e-12
#: Tolerances of the runs: a convention, two for each decade.
TOLERANCES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
ALGORITHMS = {
    "Gauss-Seidel, inputs of order 6": {"algorithm": "gauss-seidel", "input_order": 6},
    "Gauss-Seidel, inputs of order 2": {"algorithm": "gauss-seidel", "input_order": 2},
    "Strang, inputs of order 3": {"algorithm": "strang", "input_order": 3},
    "Strang, inputs held": {"algorithm": "strang"},
}
Samples = NDArray[np.float64]


class Case(NamedTuple):
    """A coupled system, its states in the order of `slopes`, and points (cost, error) of others."""

    title: str
    parts: tuple[str, ...]
    wires: list[str]
    states: list[str]
    slopes: Callable[[float, Samples], Samples]
    start: list[float]
    stop: float
    norm: Callable[[Samples], float]
    error: str
    published: Mapping[str, tuple[int, float]]


def car(t: float, x: Samples) -> Samples:
    """Heights and speeds of chassis and wheel, m = 400 and 40 kg, on a step of 0.1 m."""
    z_c, v_c, z_w, v_w = x
    force = 15e3 * (z_w - z_c) + 1e3 * (v_w - v_c)
    return np.array([v_c, force / 400.0, v_w, (150e3 * (0.1 - z_w) - force) / 40.0])


def animals(t: float, x: Samples) -> Samples:
    """Numbers of prey and predators."""
    return np.array([x[0] * (0.1 - 0.02 * x[1]), x[1] * (0.02 * x[0] - 0.4)])


CASES = {
    "quarter car": Case(
        "Quarter car, 4 s", ("Chassis", "Wheel"),
        ["Wheel.z -> Chassis.z_w", "Wheel.v -> Chassis.v_w", "Chassis.z -> Wheel.z_c",
         "Chassis.v -> Wheel.v_c"],
        ["Chassis.z", "Chassis.v", "Wheel.z", "Wheel.v"], car, [0.0] * 4, 4.0,
        lambda error: float(np.sqrt((error**2).mean())), "rms error of all states",
        {
            "fixed 1 ms, inputs held": (4000, 8.92e-4),
            "fixed 1 ms, order 2": (4000, 4.14e-4),
            "Richardson, inputs held": (1628, 1.05e-3),
            "Richardson, order 1": (422, 3.20e-4),
            "Richardson, order 2": (230, 3.18e-4),
        },
    ),
    "predators and prey": Case(
        "Predators and prey, 100 s", ("Prey", "Predator"),
        ["Prey.x -> Predator.x", "Predator.y -> Prey.y"],
        ["Prey.x", "Predator.y"], animals, [10.0, 10.0], 100.0,
        lambda error: float(np.abs(error).max()), "largest error",
        {"MasterSim, tolerance 1e-6": (8660, 1e-3)},
    ),
}  # fmt: skip


class Cost(NamedTuple):
    """Error in the norm of the case, macro steps with the rejected ones, steps of the busiest FMU."""

    error: float
    macro_steps: int
    do_steps: int


def system(case: Case, folder: Path) -> System:
    """The FMUs of a case, made in that folder; raises RuntimeError where one cannot be made."""
    models = [MODELS / f"{name.lower()}.py" for name in case.parts]
    if make_all(models, "native", folder):
        raise RuntimeError("the FMUs cannot be made")
    return System({name: folder / "native" / f"{name}.fmu" for name in case.parts}, case.wires)


def cost(case: Case, coupled: System, tolerance: float, **settings: object) -> Cost:
    """What a run by this tolerance costs, and its error against one solver for the whole."""
    result = run(coupled, stop=case.stop, step=Adaptive(tolerance), record=case.states, **settings)
    exact = solve_ivp(
        case.slopes, (0.0, case.stop), case.start, "DOP853", t_eval=result["time"], rtol=EXACT_TOLERANCE,
        atol=EXACT_TOLERANCE,
    ).y  # fmt: skip
    error = case.norm(np.array([result[name] for name in case.states]) - exact)
    steps = max(result.provenance["do_steps"].values())
    per_macro_step = 6 if settings["algorithm"] == "strang" else 3
    return Cost(error, steps // per_macro_step, steps)


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    for axis, case in zip(figure.subplots(1, 2), CASES.values()):
        coupled = system(case, ROOT / "results" / "published")
        print(f"\n{case.title}: {case.error}, macro steps with the rejected ones, steps of an FMU")
        for name, (steps, error) in case.published.items():
            print(f"  {f'published: {name}':<40} {error:8.2e} {steps:6d}")
        axis.loglog(*zip(*case.published.values()), "kx", label="published")
        for name, settings in ALGORITHMS.items():
            costs = [cost(case, coupled, tolerance, **settings) for tolerance in TOLERANCES]
            axis.loglog([c.macro_steps for c in costs], [c.error for c in costs], "o-", label=name)
            for tolerance, c in zip(TOLERANCES, costs):
                print(
                    f"  {f'{name}, {tolerance:g}':<40} {c.error:8.2e} {c.macro_steps:6d} {c.do_steps:6d}"
                )
        axis.set(title=case.title, xlabel="macro steps with the rejected ones", ylabel=case.error)
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize="small")
    target = ROOT / "results" / "published.png"
    figure.savefig(target, dpi=150)
    print(f"\n{target.relative_to(ROOT)} written")


if __name__ == "__main__":
    main()
