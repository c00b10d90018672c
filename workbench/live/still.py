"""Charts and motions of runs as they are declared, drawn from recorded rows: the picture of what the live page draws."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from cosim import Result

from ..charts.model import Chart, Curve, Mark, Panel, Rows, Samples
from ..charts.motion import FRAMES, Motion, Shape, rows_nearest_to_times, shifted
from ..dimensions import known_units
from ..figure import Figure
from ..formula import Formula
from ..options import Options
from ..steady import TURN
from .declare import REVOLUTION, Caption, LiveMotion, LiveRun, RunChart

#: Share of a turn within which a whole one is there, whatever its ends are rounded to.
WHOLE = 1 - 1e-9


def drawn(
    chart: RunChart,
    results: Result | Sequence[Result],
    o: Options | None = None,
    figures: Mapping[str, Figure] = MappingProxyType({}),
    *,
    runs: Sequence[LiveRun] = (LiveRun(),),
    angle: str = "",
) -> Chart:
    """Return a chart of runs with the rows of these.

    Parameters
    ----------
    chart
        What is declared, for the picture and the live page alike.
    results
        A result, or one for each of the `runs`.
    o, figures
        Options and figures that formulas of levels name.
    runs
        Names and colours where there are several.
    angle
        The column of the crank angle [rad].

    Raises
    ------
    KeyError
        For a column that does not exist.
    SetupError
        For a unit that it does not convert to, and a panel without one.
    ValueError
        For a look that does not exist.
    """
    results = [results] if isinstance(results, Result) else results
    values: dict[str, float] = {f"figures.{name}": x.value for name, x in figures.items()}
    values |= {name: x for name, x in vars(o).items() if isinstance(x, int | float)} if o else {}
    known = known_units(o, figures, results[0].units)
    scopes = [_formula_scope(result, chart, values, angle) for result in results]
    panels = []
    for panel in chart.panels:
        unit, factors = panel.units(results[0].units, known, f"panel {panel.quantity!r}")
        looks, curves = iter(panel.looks(runs)), []
        for scope in scopes:
            x = Formula.read(chart.x).over(scope)
            for text, factor in factors.items():
                y, look = factor * Formula.read(text).over(scope), next(looks)
                curves.append(Curve(look.name, x, y, look.color, look.look))
        levels = [Mark(Formula.read(at)(values), text) for text, at in panel.levels.items()]
        panels.append(Panel(panel.quantity, unit, curves, levels, panel.includes))
    return Chart(chart.title, chart.label, panels)


def moved(
    motion: LiveMotion,
    *results: Result,
    names: Sequence[str] = ("",),
    first: float = -math.inf,
    last: float = math.inf,
    frames: int = FRAMES,
) -> Motion:
    """Return a motion with the rows of results of the same step, each beside the other.

    Parameters
    ----------
    motion
        What is declared, for the picture and the live page alike.
    results, names
        The rows, whose columns formulas of captions name, and what each is called.
    first, last
        The times [s] between which it is shown.
    frames
        How many times, at most.
    """
    t = results[0]["time"]
    picked = rows_nearest_to_times(t, max(first, float(t[0])), min(last, float(t[-1])), frames)
    read = [Formula.read(x.value) for x in motion.captions]
    used = {x.column for x in motion.coordinates}.union(*(formula.names for formula in read))
    shapes, texts = list[Shape](), []
    for k, (name, result) in enumerate(zip(names, results)):
        at = {column: np.asarray(result[column], float)[picked] for column in used}
        shapes += shifted(motion.draw(at), *(k * np.array(motion.offset)))
        values = zip(*(np.broadcast_to(x.over(at), len(picked)).tolist() for x in read))
        told = [", ".join(map(Caption.told, motion.captions, row)) for row in values]
        texts.append([f"{name} {text}".strip() for text in told])
    captions = [
        f"{now - t[picked[0]]:.3f} s: {'; '.join(each)}" for now, *each in zip(t[picked], *texts)
    ]
    return Motion(motion.title, t[picked], motion.slow, captions, shapes, motion.note)


def _formula_scope(
    result: Result, chart: RunChart, values: Mapping[str, float], angle: str
) -> dict[str, Samples | float]:
    """The columns that a chart needs, in its window, and the values that formulas may use."""
    texts = [chart.x, *(text for panel in chart.panels for text in panel.curves)]
    names = {"time"}.union(*(Formula.read(text).names for text in texts))
    columns = {name: result[name] for name in names & set(result.names)}
    inside: Rows = slice(None)
    if angle:
        phi = result[angle]
        has_turn = phi[-1] - phi[0] >= WHOLE * TURN
        columns["crank_angle"] = phi - (phi[-1] - TURN if has_turn else 0.0)
        if has_turn and chart.window == REVOLUTION:
            inside = columns["crank_angle"] >= -(1 - WHOLE) * TURN
    if chart.window not in {"", REVOLUTION}:
        inside = columns["time"] >= Formula.read(chart.window)(values)
    return {**values, **{name: np.asarray(x, float)[inside] for name, x in columns.items()}}
