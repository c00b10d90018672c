"""Figures of a run with the errors that three step sizes show, beside those that the figures have themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from cosim import Result
from cosim.accuracy.extrapolation import NOT_CONVERGED
from cosim.accuracy.function_error import ObservedResult, after_divergence
from cosim.accuracy.limit import STEP_RATIO, likeliest

from .figure import Figure

FiguresOf = Callable[[Result], Mapping[str, Figure]]
#: The reason why a figure is refused that one of the runs does not have.
SOME_RUNS = "not all three step sizes give this figure"


def with_coupling_errors(
    figures_of: FiguresOf, results: Sequence[Result], figures: Sequence[Mapping[str, Figure]]
) -> dict[str, Figure]:
    """Add the coupling errors to the figures of the finest of three runs.

    Parameters
    ----------
    figures_of : callable
        Makes the figures of a result.
    results : sequence of three results
        With the steps h, 2 h and 4 h, in this order.
    figures : sequence of three mappings
        The values of `figures_of` for each of them.

    Returns
    -------
    dict
        The figures of the finest run. Their order is that of the algorithm, or 1 for outputs with direct
        feedthrough; `likeliest` decides which one counts where the figures read both. Figures that need
        rows after trajectories have diverged are refused.
    """
    finest = results[0]
    observed = ObservedResult(finest)
    figures_of(observed)
    order = float(finest.provenance["convergence_order"])
    first_order = finest.provenance.get("first_order", ())
    orders = {min(order, 1.0) if c in first_order else order for c in observed.columns_read()}
    diverged = after_divergence(figures_of, results, STEP_RATIO)
    return {
        name: Figure.undetermined(figure.unit, diverged[name], figure.meaning)
        if name in diverged and figure.error is not None
        else _add([run.get(name) for run in figures], sorted(orders or {order}))
        for name, figure in figures[0].items()
    }


def _add(runs: Sequence[Figure | None], orders: Sequence[float]) -> Figure:
    """The first figure with the coupling error added to its own."""
    finest = runs[0]
    assert finest is not None
    if finest.error is None:
        return finest
    values = [run.value for run in runs if run is not None and run.error is not None]
    if len(values) < len(runs):
        return Figure.undetermined(finest.unit, SOME_RUNS, finest.meaning)
    if len(set(values)) == 1 and values[0] == round(values[0]):
        return finest  # a count that all runs agree on
    errors = [run.error for run in runs if run is not None and run.error is not None]
    of_runs = likeliest(values, orders, noise=errors)
    if not of_runs.is_stated:
        return Figure.undetermined(finest.unit, NOT_CONVERGED, finest.meaning)
    return finest._replace(error=float(of_runs.error))
