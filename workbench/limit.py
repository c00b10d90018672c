"""Where a value goes as the communication step vanishes, and what that leaves open."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cosim import Result, estimate
from cosim.accuracy.certify import DIVERGED, disturbed, divergence

from .figure import Figure
from .measure import with_rows

NEGLIGIBLE, SMALL, FLOOR = 1e-9, 1e-3, 0.02


def limit(values: Sequence[float], order: float) -> tuple[float, float | None, str]:
    """Where values at steps h, 2 h, 4 h go as h vanishes, the error of that, or why there is none.

    The coarser pair tells what the finer one tells, with an error at least twice as large. Values
    that move by little and in no order keep the whole of their moves as error.
    """
    if len(values) < 3:
        return values[0], None, "the coupling is not stable with a quarter of the steps"
    fine, middle, coarse = values
    last, before = fine - middle, middle - coarse
    most = max(abs(last), abs(before))
    if abs(before) < 1.5 * abs(last) or most <= NEGLIGIBLE * abs(fine):
        if most > SMALL * abs(fine):
            return fine, None, "it does not converge with smaller steps"
        return fine, 4.0 * most, ""
    gain = 2.0**order - 1.0
    better, rough = fine + last / gain, middle + before / gain
    return better, abs(better - rough) + FLOOR * abs(last), ""


def coupling(values: Sequence[float], order: float) -> float:
    """The coupling error of the first of values at steps h, 2 h, 4 h, as `cosim.estimate` states it;
    twice their spread where it states none, and 0 for a count that all runs agree on.
    """
    spread = max(values) - min(values)
    if spread == 0.0 and values[0] == round(values[0]):
        return 0.0
    error = estimate(values, order).error
    return 2.0 * spread if error is None else error


def certified(
    figures: Callable[[Result], Mapping[str, Figure]],
    result: Result,
    told: Sequence[Mapping[str, Figure]],
) -> dict[str, Figure]:
    """The figures of the last of three runs, each with half the step of the one before, with the
    coupling errors added to their own; `result` is that of the last run.

    They converge with the order of the algorithm, but for those that other rows of outputs of order 1
    would change: outputs that follow an input at once.
    """
    order = result.provenance["convergence_order"]
    other = _otherwise(figures, result) if order > 1 else {}
    return {
        name: _whole([run.get(name) for run in told], order if other.get(name) == fine else 1)
        for name, fine in told[-1].items()
    }


def converged(
    figures: Callable[[Result], Mapping[str, Figure]],
    result: Result,
    stated: Mapping[str, Figure],
    runs: Sequence[np.ndarray],
) -> dict[str, Figure]:
    """The figures, of which those are refused that need rows after the three runs have diverged.

    `runs` are the rows of the runs, shape (rows, columns), the last one that of `result`.
    """
    begin, columns = divergence(runs[::-1])
    if not columns.any():
        return dict(stated)
    reason = f"{DIVERGED} from {begin:.4g} s on"
    before = figures(result)
    try:
        after = figures(with_rows(result, disturbed(result.data, begin, columns)))
    except Exception:  # noqa: BLE001
        after = {}
    return {
        name: figure
        if figure.error is None or after.get(name) == before.get(name)
        else Figure.undetermined(figure.unit, reason, figure.meaning)
        for name, figure in stated.items()
    }


def _otherwise(
    figures: Callable[[Result], Mapping[str, Figure]], result: Result
) -> Mapping[str, Figure]:
    """The figures with other rows of the outputs of order 1; none if there cannot be such figures."""
    rows = result.data.copy()
    for name in result.provenance["first_order"]:
        rows[:, result.columns.index(name)] *= np.linspace(0.5, 1.5, len(rows))
    try:
        return figures(with_rows(result, rows))
    except Exception:  # noqa: BLE001
        return {}


def _whole(runs: Sequence[Figure | None], order: float) -> Figure:
    """The last figure with the coupling error added to its own."""
    fine = runs[-1]
    assert fine is not None
    if fine.error is None:
        return fine
    values = [run.value for run in reversed(runs) if run is not None and run.error is not None]
    if len(values) < len(runs):
        reason = "only some of the three runs with different communication steps have it"
        return Figure.undetermined(fine.unit, reason, fine.meaning)
    return fine._replace(error=fine.error + coupling(values, order))
