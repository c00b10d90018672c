"""A run of a scenario with the coupling errors of its figures, and figures between the samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
from cosim import Result, System
from cosim.progress import bar

from .answer import Figure
from .orders import Samples

COARSEST = 4
AROUND = 6
Figures = Callable[[Result], Mapping[str, tuple[float, str, str]]]


def run(
    title: str,
    system: System,
    figures: Figures,
    stop: float,
    step: float,
    fed: Sequence[str] = (),
    **settings: Any,
) -> tuple[Result, dict[str, Figure]]:
    """The result with steps of `step` [s], and its figures, with coupling errors from runs with four
    and two times the step. `figures` gives values, units and meanings; those of outputs that a held input
    moves without delay are `fed` and converge with order 1. Raises what `cosim.run` raises.
    """
    told: dict[str, list[str]] = {}
    seen: list[dict[str, float]] = []

    def values(result: Result) -> dict[str, float]:
        found = figures(result)
        told.update({name: words for name, (_, *words) in found.items()})
        seen.append({name: value for name, (value, *_) in found.items()})
        return seen[-1]

    def every_step(system: System, output_step: float, **rest: Any) -> Result:
        return cosim.run(system, **rest)

    with bar(title, 0.0, stop) as progress:
        result, found = cosim.certify(
            system,
            values,
            step=COARSEST * step,
            stop=stop,
            runner=every_step,
            progress=progress,
            **settings,
        )
    found |= {name: cosim.estimate([run[name] for run in seen[::-1]], 1.0) for name in fed}
    return result, {name: Figure.of(value, *told[name]) for name, value in found.items()}


def largest(t: Samples, x: Samples) -> tuple[float, float]:
    """The largest value of x and its time, on the spline through the samples around it."""
    top = int(np.argmax(x))
    if not 0 < top < len(x) - 1:
        return float(x[top]), float(t[top])
    near = slice(max(0, top - AROUND), top + AROUND + 1)
    curve = CubicSpline(t[near], x[near])
    times = curve.derivative().roots(extrapolate=False)
    at = times[np.argmax(curve(times))]
    return float(curve(at)), float(at)


def crossings(t: Samples, x: Samples, level: float) -> Samples:
    """The times at which x passes a level, on the spline through its samples."""
    return np.asarray(CubicSpline(t, x).solve(level, extrapolate=False))
