"""Coupling error against cost, compared with published results.

Two systems: the quarter car of Schierz, Arnold and Clauß (2012) on a step of the road, which is one of the reference systems,
4 s, rms error of all states; and the predators and prey of MasterSim's tests (Nicolai, 2018), whose equations are made into
FMUs here, from benchmarks/models, 100 s, largest error. Prints a table.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import Adaptive, System, run
from fmukit.fmu.make import make_all
from reference_systems.equations import Equations, quarter_car, solve
from reference_systems.systems import SYSTEMS, build_fmus

#: The page that this backs, and its heading.
CLAIM = ("docs/speed.md", "Comparison with published results")

MODELS = Path(__file__).with_name("models")
#: Tolerances of the runs: a convention, two for each decade.
TOLERANCES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
ALGORITHMS: dict[str, dict[str, Any]] = {
    "Gauss-Seidel, inputs of order 6": {"algorithm": "gauss-seidel", "input_order": 6},
    "Gauss-Seidel, inputs of order 2": {"algorithm": "gauss-seidel", "input_order": 2},
    "Strang, inputs of order 3": {"algorithm": "strang", "input_order": 3},
    "Strang, inputs held": {"algorithm": "strang"},
}
#: Calls of a part in an adaptive macro step, whose error is that of two half steps: derived.
CALLS = {"gauss-seidel": 3, "strang": 6}


class Case(NamedTuple):
    """A coupled system and its equations, its stop [s], how its error is measured, and what others have published."""

    title: str
    system: System
    equations: Equations
    stop: float
    norm: Callable[[NDArray[np.float64]], float]
    published: Mapping[str, tuple[int, float]]


def animals(_: float, x: NDArray[np.float64]) -> Sequence[float]:
    """Numbers of prey and predators."""
    return x[0] * (0.1 - 0.02 * x[1]), x[1] * (0.02 * x[0] - 0.4)


def cases() -> list[Case]:
    """Both systems, whose FMUs are made."""
    folder = ROOT / "results" / "published"
    if failed := [*build_fmus(), *make_all([*MODELS.glob("pre*.py")], "native", folder)]:
        raise RuntimeError(f"FMUs cannot be made: {failed}")
    car = SYSTEMS["quarter_car"]
    parts = {name: folder / "native" / f"{name}.fmu" for name in ("Prey", "Predator")}
    return [
        Case(
            "Quarter car, 4 s, rms error of all states", car.system(), quarter_car(car.start), 4.0,
            lambda error: float(np.sqrt((error**2).mean())),
            {"fixed 1 ms, inputs held": (4000, 8.92e-4), "fixed 1 ms, order 2": (4000, 4.14e-4),
             "Richardson, inputs held": (1628, 1.05e-3), "Richardson, order 1": (422, 3.20e-4),
             "Richardson, order 2": (230, 3.18e-4)},
        ),
        Case(
            "Predators and prey, 100 s, largest error",
            System(parts, ["Prey.x -> Predator.x", "Predator.y -> Prey.y"]),
            Equations([10.0, 10.0], animals, lambda _, x: {"Prey.x": x[0], "Predator.y": x[1]}), 100.0,
            lambda error: float(np.abs(error).max()), {"MasterSim, tolerance 1e-6": (8660, 1e-3)},
        ),
    ]  # fmt: skip


def main() -> None:
    """Run both systems by all algorithms and tolerances."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for case in cases():
        print(f"\n{case.title}; macro steps with the rejected ones, steps of the busiest FMU")
        for name, (steps, error) in case.published.items():
            print(f"  {f'published: {name}':<40} {error:8.2e} {steps:6d}")
        start = case.equations.signals(0.0, np.array(case.equations.start))
        for name, settings in ALGORITHMS.items():
            for tolerance in TOLERANCES:
                got = run(
                    case.system, stop=case.stop, step=Adaptive(tolerance), record=list(start), **settings
                )  # fmt: skip
                exact = solve(case.equations, got["time"]).values
                error = case.norm(np.array([got[x] - exact[x] for x in start]))
                steps = max(got.provenance["do_steps"].values())
                macro = steps // CALLS[settings["algorithm"]]
                print(f"  {f'{name}, {tolerance:g}':<40} {error:8.2e} {macro:6d} {steps:6d}")


if __name__ == "__main__":
    main()
