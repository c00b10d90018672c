"""Error of adaptive steps over their tolerance and their cost: python benchmarks/tolerance.py.

The drive of set A from rest, one second; the largest error of the motor's torque over its largest
value against one solver for the whole, steps of FMUs with the rejected ones. Writes
results/tolerance.png and prints the table and the slopes.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from math import log10
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from cosim import Adaptive, run
from scenarios.conveyor.first_order import SETS
from scenarios.conveyor.machine import conveyor_drive
from scenarios.project import PROJECT
from tests.oracle import monolithic

START = SETS["A"].start(40.0) | {"motor.tau": 0.0, "conveyor.w": 0.0}
SYSTEM = conveyor_drive(PROJECT.fmus(PROJECT.load("resonance"), "native"), START)
TOLERANCES = [10.0**-k for k in range(6)]
VARIANTS = {
    "Strang, held inputs": {"algorithm": "strang"},
    "Gauss-Seidel, inputs of order 6": {"algorithm": "gauss-seidel", "input_order": 6},
}


def point(step: float | Adaptive, **settings: object) -> tuple[float, int]:
    """Relative error of the torque, and steps of FMUs."""
    result = run(SYSTEM, stop=1.0, step=step, record=["motor.tau"], **settings)
    exact = monolithic(START, 1.0, t_eval=result["time"]).y[2]
    error = np.abs(result["motor.tau"] - exact).max() / np.abs(exact).max()
    return float(error), sum(result.provenance["do_steps"].values())


def main() -> None:
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, settings in VARIANTS.items():
        errors, steps = zip(*(point(Adaptive(tol), **settings) for tol in TOLERANCES))
        slopes = [log10(a / b) for a, b in pairwise(errors)]
        left.loglog(TOLERANCES, errors, "o-", label=name)
        right.loglog(errors, steps, "o-", label=f"{name}, adaptive")
        print(name)
        for tol, error, count in zip(TOLERANCES, errors, steps):
            print(f"  tolerance {tol:<8g} error {error:.2e}  {count} steps of FMUs")
        print(f"  slopes {', '.join(f'{slope:.2f}' for slope in slopes)}")
    fixed = [point(1 / n, algorithm="gauss-seidel") for n in (250, 500, 1000, 2000, 4000, 8000)]
    right.loglog(*zip(*fixed), "s--", color="gray", label="Gauss-Seidel, fixed steps")
    left.loglog(TOLERANCES, [1e-2 * tol for tol in TOLERANCES], ":", color="gray", label="slope 1")
    left.set(xlabel="tolerance", ylabel="error of the torque, of its largest")
    right.set(xlabel="error of the torque, of its largest", ylabel="steps of FMUs")
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    target = ROOT / "results" / "tolerance.png"
    target.parent.mkdir(exist_ok=True)
    figure.savefig(target, dpi=150)
    print(f"{target.relative_to(ROOT)} written")


if __name__ == "__main__":
    main()
