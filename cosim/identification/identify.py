"""Fit a system to a record of a machine, and say how far the values and what follows can be trusted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..engine.algorithms import CONVERGENCE_ORDERS
from ..errors import SetupError
from ..result import Result
from ..system import System, connect
from ..system.inputs import Table
from . import evidence
from .evidence import DEVIATIONS, Interval, Local, Residual
from .model import (
    Derived,
    Known,
    Model,
    Prior,
    Vector,
    build,
    checked,
    frees,
    independent,
    sensor,
)  # fmt: skip
from .record import columns
from .search import Loss, Minimum, descend, search

STARTS, COUPLING, HALVINGS = 12, 0.1, 6
AMBIGUOUS, APART = 10.8, 3.0
OUTLIER, SLIGHT = 4.5, 1e-3


@dataclass(frozen=True)
class Identified:
    """What a record shows about a machine, or why it shows nothing.

    `misfit` is a list of sentences. If there are any, no machine of this kind fits, and `values` and
    `derived` are empty. `correlations` are those of the free values, in the order of `names`; `alike`
    are groups of them that the record cannot distinguish; `notes` are further remarks. `minima` are the
    values of chi2 that the starts reached, smallest first. `result` is the run of the fit, with steps
    of `step` [s].
    """

    values: Mapping[str, Interval]
    derived: Mapping[str, Interval]
    misfit: Sequence[str]
    names: Sequence[str]
    correlations: Vector
    alike: Sequence[Sequence[str]]
    notes: Sequence[str]
    residuals: Mapping[str, Residual]
    chi2: float
    dof: int
    band: tuple[float, float]
    minima: Sequence[float]
    result: Result
    step: float
    runs: int
    model: Model = field(repr=False)
    local: Local = field(repr=False)

    def shared(self, name: str) -> bool:
        """Whether a free value is a parameter of the machine, not of this record only."""
        if sensor(name):
            return False
        return bool(connect(self.model.system).port(name).variable.causality == "parameter")

    def known(self, *without: str) -> Prior:
        """The machine's parameters as found from this record, with their covariance, for identifying
        another record of it; `without` names those to omit, such as a supply that has changed.
        """
        places = [
            k for k, name in enumerate(self.names) if self.shared(name) and name not in without
        ]
        covariance = self.local.covariance[np.ix_(places, places)]
        return Prior([self.names[k] for k in places], self.local.p[places], covariance)

    def gradient(self, tell: Callable[[Mapping[str, float]], float]) -> Vector:
        """The gradient of a quantity that depends on the values only, by the free values."""
        model, p = self.model, self.local.p
        slight = SLIGHT * np.minimum(np.sqrt(np.diag(self.local.covariance)), model.sizes)
        below, above = (
            np.array([tell(model.values(p + sign * move)) for move in np.diag(slight)])
            for sign in (-1.0, 1.0)
        )
        return np.asarray((above - below) / (2 * slight), float)

    def interval(self, tell: Callable[[Mapping[str, float]], float], unit: str = "") -> Interval:
        """The interval of a quantity that depends on the values only, such as a limit, by their covariance."""
        g = self.gradient(tell)
        value, reach = float(tell(self.model.values(self.local.p))), self.local.reach(g)
        off = reach + self.local.coupling(g)
        return Interval(value, value - off, value + off, reach / DEVIATIONS, unit)

    def text(self) -> str:
        """The answer in lines."""
        if self.misfit:
            return "\n".join(["No machine of this kind fits:", *(f"  {x}" for x in self.misfit)])
        lines = [f"{name} = {x.text()}" for name, x in {**self.derived, **self.values}.items()]
        return "\n".join([*lines, *self.notes])


def identify(
    system: System,
    data: Mapping[str, Table],
    *,
    free: Sequence[str] | Mapping[str, tuple[float, float]],
    known: Known | Prior | None = None,
    derived: Mapping[str, Derived] | None = None,
    units: Mapping[str, str] | None = None,
    noise: Mapping[str, float] | None = None,
    first: Sequence[str] = (),
    outliers: float = 0.0,
    starts: int = STARTS,
    begin: float | None = None,
    step: float | None = None,
    seed: int = 0,
    **settings: Any,
) -> Identified:
    """Fit start values and parameters of a system's FMUs to a record.

    `data` gives measured columns by the outputs that they measure, each with its own times [s]. `free`
    names the values to be found, with bounds if it is a mapping; the first guess is the system's start
    value. `known` gives values and standard deviations of what is known beforehand, or what another
    record gave (`Identified.known`); these values are free too. Besides start values of FMUs,
    "gain(conveyor.w)", "delay(conveyor.w)" [s] and "zero(conveyor.w)" may be free: those of a sensor
    that shows gain * w(t - delay) + zero.

    `derived` are functions of all values and of the fitted run, such as a resonance, in `units`. `noise`
    gives standard deviations of columns in the units of their variables, by default estimated from the
    rows. The values named in `first`, such as an angle at the start and the supply, are fitted before
    the rest, from each of several starts. `outliers` is the share of rows that may be outliers. Runs
    begin with the first row of all, or at the time `begin` [s] before it. They are those of `run` with
    these settings. Steps are halved until the coupling moves nothing by more than a tenth of its
    interval.

    Raises SetupError for a record or values that cannot be used, and what `run` raises at the guess.
    """
    network, derived = connect(system), dict(derived or {})
    record = columns(network, data, noise or {})
    before = known if isinstance(known, Prior) else independent(known or {})
    unknown = frees(network, record, free, before)
    names = [one.name for one in unknown]
    for name in first:
        if name not in names:
            raise SetupError(f"first: {name} is not free, only {', '.join(names)}")
    model = build(system, record, unknown, before, step, settings, begin)
    checked(model)
    loss: Loss = "huber" if outliers else "linear"
    _, _, enough = evidence.band(model.columns, len(before.names), len(unknown))
    sought = [names.index(name) for name in first]
    minima = search(model, sought, starts, math.inf if outliers else enough, seed, loss)
    notes: list[str] = []
    lost: list[str] = []
    if outliers:
        lost = list(_set_aside(model, minima[0], outliers, notes))
    return _judged(model, minima, derived, units or {}, notes, lost)


def _set_aside(model: Model, best: Minimum, share: float, notes: list[str]) -> Iterator[str]:
    """Remove outliers from a model's columns; yields a sentence where there are too many."""
    shown = model.shown(best.p, model.play(best.p))
    kept = []
    for column, x in zip(model.columns, shown):
        inside = np.abs(x - column.values) <= OUTLIER * column.noise.sigma
        out, rows = int((~inside).sum()), len(inside)
        if out > share * rows:
            yield f"{column.name}: {out} of {rows} rows lie beyond {OUTLIER:g} times the noise"
            inside[:] = True
        elif out:
            notes.append(f"{column.name}: {out} of {rows} rows are outliers and are left out.")
        kept.append(column._replace(times=column.times[inside], values=column.values[inside]))
    model.columns = kept
    model._last = None


def _judged(
    model: Model,
    minima: Sequence[Minimum],
    derived: Mapping[str, Derived],
    units: Mapping[str, str],
    notes: list[str],
    lost: list[str],
) -> Identified:
    """The fit at the best minimum, with all the evidence for and against it."""
    every = range(len(model.free))
    best = descend(model, minima[0].p, every, 2 * len(every))
    look = evidence.looking(model, derived)
    order = float(CONVERGENCE_ORDERS[model.settings.get("algorithm", "strang")])
    for _ in range(HALVINGS):
        local = evidence.close_by(model, best.p, look, order)
        if evidence.overrated(model, local):
            best = descend(model, best.p, every, 2 * len(every))
            continue
        wanted = [*np.eye(len(model.free)), *local.gradients]
        if all(local.coupling(g) <= COUPLING * local.reach(g) for g in wanted):
            break
        model.step /= 2.0
        best = descend(model, best.p, every, 2 * len(every))
    else:
        lost.append(
            f"the coupling still moves the values by more than {COUPLING:.0%} of their intervals "
            f"with steps of {model.step:.3g} s"
        )
    result = model.play(local.p, all=True)
    seen = evidence.residuals(model, model.shown(local.p, result))
    misfit = [*lost, *evidence.misfits(model, local, seen)]
    correlations = evidence.correlation(local.covariance)
    groups = evidence.alike(model.names, correlations)
    tied = {name for group in groups for name in group}
    values: dict[str, Interval] = {}
    told: dict[str, Interval] = {}

    def interval(value: float, g: Vector, unit: str, far: bool, which: int, k: int) -> Interval:
        """That of a free value (0) or derived quantity (1) k with gradient g, `far` by its profile."""
        reach, off = local.reach(g), local.coupling(g)
        low, high = value - reach, value + reach
        if far:
            tell = lambda *both: float(both[which][k])
            low, high = evidence.profile(model, local, look, g, tell)
        return Interval(value, low - off, high + off, reach / DEVIATIONS, unit)

    if not misfit:
        for k, name in enumerate(derived):
            value, g = float(local.derived[k]), local.gradients[k]
            told[name] = interval(value, g, units.get(name, ""), bool(groups), 1, k)
        for k, free in enumerate(model.free):
            value, g = float(local.p[k]), np.eye(len(every))[k]
            values[free.name] = interval(value, g, free.unit, free.name in tied, 0, k)
        misfit += _ambiguous(minima, told, local, look)
        if misfit:
            values, told = {}, {}
        for group in groups:
            notes.append(f"The record cannot distinguish {', '.join(group)} from each other.")
    dof, low, high = evidence.band(model.columns, len(model.prior.names), len(model.free))
    for column in model.columns:
        notes.append(
            f"Noise of {column.name}: {column.noise.sigma:.3g} {column.port.unit}, {column.noise.told}."
        )
    return Identified(
        values, told, misfit, model.names, correlations, groups, notes, seen, local.chi2, dof,
        (low, high), [m.chi2 for m in minima], result, model.step, model.runs, model, local,
    )  # fmt: skip


def _ambiguous(
    minima: Sequence[Minimum], told: Mapping[str, Interval], local: Local, look: evidence.Look
) -> list[str]:
    """Other minima that fit equally well but give a different machine."""
    for other in minima[1:]:
        if other.chi2 > local.chi2 + AMBIGUOUS:
            break
        for (name, mine), value in zip(told.items(), look(other.p)[1].tolist()):
            if abs(value - mine.value) > APART * mine.error:
                return [
                    f"two machines fit equally well: {name} = {mine.value:.5g} and {value:.5g} "
                    f"{mine.unit} with chi2 = {local.chi2:.5g} and {other.chi2:.5g}"
                ]
    return []
