"""What the coupling did to a figure: Richardson extrapolation over three step sizes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from .adaptive import Adaptive
from .master import run
from .result import Result, Rows
from .system import System

NEGLIGIBLE = 1e-10
SLOWER, FASTER = 0.5, 1.5
HALVED, TENTH = 2.0, 10.0


SUMMARY: dict[str, Callable[[Rows, Rows], float]] = {
    " at the end": lambda t, x: x[-1],
    ", smallest": lambda t, x: x.min(),
    ", largest": lambda t, x: x.max(),
    ", mean": lambda t, x: np.trapezoid(x, t) / (t[-1] - t[0]),
}


class Estimate(NamedTuple):
    """A figure with its coupling error and the order at which it converges.

    `error` is None where the runs do not converge at the order of the algorithm: the figure is then
    no answer, and its text says so.
    """

    value: float
    error: float | None
    order: float

    def text(self, unit: str) -> str:
        """The figure as it may be printed."""
        if self.error is None:
            seen = f"with order {self.order:.1f}" if math.isfinite(self.order) else "in no order"
            return f"{self.value:.5g} {unit} (not converged: the error falls {seen})"
        digits = min(7, max(0, 1 - math.floor(math.log10(max(self.error, 1e-7)))))
        shown = max(self.error, 10.0**-digits)
        return f"{self.value:.{digits}f} +- {shown:.{digits}f} {unit}"


def estimate(values: Sequence[float], order: float, ratio: float = HALVED) -> Estimate:
    """The estimate from runs with steps h, r h and r^2 h, in this order, of an algorithm's order p.

    The error is |v(h) - v(r h)| / (r^q - 1), with q the observed order where that is below p.
    """
    fine, middle, coarse = values
    last, before = fine - middle, middle - coarse
    if abs(last) <= NEGLIGIBLE * abs(fine):
        return Estimate(fine, abs(last), float(order))
    observed = math.log(abs(before / last), ratio) if last * before > 0.0 else math.nan
    if not order - SLOWER <= observed <= order + FASTER:
        return Estimate(fine, None, observed)
    return Estimate(fine, abs(last) / (ratio ** min(observed, order) - 1), observed)


class Certified(NamedTuple):
    """The finest of three runs, and every figure with its coupling error."""

    result: Result
    figures: dict[str, Estimate]


def certify(
    system: System,
    figures: Callable[[Result], Mapping[str, float]],
    *,
    step: float | Adaptive,
    runner: Callable[..., Result] = run,
    **settings: Any,
) -> Certified:
    """Run with the step, a half and a quarter of it, or the tolerance, a tenth and a hundredth.

    `figures` takes the scalars from a result. Rows are `step` apart in all runs unless the settings,
    which are those of `run`, say otherwise. `runner` is what runs a system, `run` or the like; it
    gets `csv` in the last run only. Raises what it raises.
    """
    progress = settings.pop("progress", None)
    csv = settings.pop("csv", None)
    if isinstance(step, Adaptive):
        ratio = TENTH
        steps: list[Any] = [replace(step, tolerance=step.tolerance / ratio**k) for k in range(3)]
    else:
        ratio = HALVED
        steps = [step / ratio**k for k in range(3)]
        settings = {"output_step": step} | settings
    values = []
    for k, h in enumerate(steps):
        done = (ratio**k - 1) / (ratio**3 - 1)
        share = ratio**k * (ratio - 1) / (ratio**3 - 1)
        told = None if progress is None else _within(progress, done, share)
        last = {} if csv is None or k < 2 else {"csv": csv}
        result = runner(system, step=h, **settings, progress=told, **last)
        values.append(figures(result))
    order = 1.0 if isinstance(step, Adaptive) else result.provenance["convergence_order"]
    finest_first = values[::-1]
    names = finest_first[0]
    found = {name: estimate([v[name] for v in finest_first], order, ratio) for name in names}
    return Certified(result, found)


def _within(
    progress: Callable[[float], None], done: float, share: float
) -> Callable[[float], None]:
    """Tells a progress that has done a share already what a run adds to it."""
    return lambda part: progress(done + part * share)


def summary(result: Result) -> dict[str, float]:
    """The last, smallest, largest and mean value of every column over time."""
    t = result["time"]
    return {
        f"{name}{what}": float(figure(t, result[name]))
        for name in result.columns[1:]
        for what, figure in SUMMARY.items()
    }
