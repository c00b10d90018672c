"""What is the wall friction of a measured orientator, and how fast may its rotor turn with it?

The machine is fitted to the durations of stages that a camera measured, with a row for each product, at
several speeds of the rotor. Friction is proportional to the squared speed: fast products show it, while
slow ones show the height of the fall. Stage times that no friction explains are refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

import cosim
from cosim import Experiment, Identified, Series, SetupError, System
from cosim.dense import Array as Samples
from cosim.units import multiples
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Judgement,
    Panel,
    Question,
    Show,
)
from workbench.charts.model import SERIES
from workbench.figure import figure_of_figures
from workbench.fit import (
    FIT_ERROR_SCOPE,
    Fitted,
    Followed,
    Guess,
    RecordFit,
    RecordOptions,
    figure_name,
    fitted_system,
    misfit,
    next_record,
    noise,
)

from .. import machine as orientator
from .. import motion
from ..products import run_product, simulated_limit

SPEED, DROP, FRICTION = "orientator.w", "orientator.release", "orientator.chute.mu"
TIMES = ("t_falling", "t_joint", "t_turning", "t_released", "orientation_time")
#: Time between two products [s], longer than the longest product.
PERIOD = 1.6
#: Share of a period before a product is released, in which the rotor has its speed; a convention.
BEFORE = 0.25
#: Smallest friction of which the limit is asked; the formulas divide by it.
LEAST = 1e-3
#: Frictions of which the nearest begins the fit; a convention.
FIRST_FRICTIONS = np.linspace(0.0, 1.0, 21)
#: Speeds of records that are advised, over the limit; a convention.
NEXT = (0.5, 0.8, 0.9, 0.95)


class OrientatorIdentify(Question, RecordOptions):
    """The record to fit; the question asks nothing else."""

    parts = orientator.PARTS
    fixed_starts = (SPEED, DROP, FRICTION)
    error_scope = FIT_ERROR_SCOPE
    is_sequential = True
    method = RecordFit(
        kind="friction",
        quantities={
            "limit": ("rpm", "largest rotor speed that works"),
            "away": ("%", "margin of that speed over the fastest product of the record"),
        },
        exact=("orientator.chute.H", "orientator.chute.R", "orientator.cup.m"),
    )

    def guess(self, context: Context) -> Guess:
        """Return the machine with the friction whose times are nearest, its products a period after each other."""
        record = self.columns(SPEED, timed=False)
        w = record.pop(SPEED)
        scale = multiples("rad/s").get(w.signal.unit or "rad/s")
        if scale is None or not np.isfinite(w.numbers(gaps=True)).all():
            raise SetupError(
                f"{w.label}: each product needs a speed of the rotor, in {' or '.join(multiples('rad/s'))}"
            )
        if not record:
            raise SetupError(
                f"{self.data}: no stage time is mapped: --map orientator.t_turning=COLUMN:ms, or another of "
                f"{', '.join(TIMES)}"
            )
        speeds = (scale * w.numbers()).tolist()
        data = {name: at_period_ends(name, table) for name, table in record.items()}
        system = System(context.fmus, start={**self.start}, inputs=product_inputs(speeds))
        with_noise = [noise(system, text)[0] for text in self.noise]
        for name, table in data.items():
            if name not in with_noise:
                raise SetupError(
                    f"{table.label}: give the noise of its times, as in --noise {name}=1ms"
                )
        rpm = [30 / math.pi * x for x in speeds]
        settings = {"begin": 0.0, "step": PERIOD * BEFORE}
        facts = {"products": len(rpm), "tried": []}
        return Guess(nearest(system, data), data, [FRICTION], settings, facts, more=rpm)

    def follow(self, context: Context, guess: Guess, fit: Identified) -> Followed:
        """Return the fastest rotor, and as many products at speeds near it."""
        limit, fast = fastest_rotor(fit), max(guess.more)
        tried = [round(share * limit.value) for share in NEXT if limit.error is not None]
        away = figure_of_figures(lambda x: 100.0 * (x / fast - 1.0), limit, unit="%")
        records = further_products(fit, tried, len(guess.more))
        return Followed(
            {"limit": limit, "away": away}, itemgetter(FRICTION), records, {"tried": tried}
        )

    def judgements(self, f: Mapping[str, Figure], r: Fitted) -> list[Judgement]:
        """The friction, the largest rotor speed, and what to record next."""
        if r.fit.misfit:
            return misfit("a friction explains these stage times", misfits(r))
        mu, fast = f[figure_name(FRICTION)], max(r.guess)
        return [
            Judgement(
                "the fastest product of the record is below the largest rotor speed",
                Figure(fast, "rpm", 0.0),
                most=f["limit"],
                yes=f"The rotor may turn at up to {f['limit'].brief()}; the fastest product of the record has",
                no=f"The rotor may turn at up to {f['limit'].brief()} only; the fastest product of the record has",
            ),
            Judgement("friction between cup and wall", mu),
            next_record(r.advice, mu, "the friction", ""),
        ]

    def show(self, f: Mapping[str, Figure], r: Fitted) -> Show:
        """Stage times over the speed, measured and fitted; what is between them; the fastest product."""
        panels = []
        for (name, residual), color in zip(r.fit.residuals.items(), SERIES * len(r.fit.residuals)):
            rows = np.round(residual.times / PERIOD).astype(int) - 1
            n = np.array(r.guess)[rows]
            order = np.argsort(n)
            ms: list[Samples] = [1e3 * x[order] for x in (residual.measured, residual.fitted)]
            what = name.removeprefix("orientator.").removeprefix("t_").replace("_", " ")
            wide = [2e3 * residual.sigma] * len(n)
            curves = [
                Curve("measured", n[order], ms[0], "grey", "points", wide),
                Curve("fitted", n[order], ms[1], color, "linked"),
            ]
            panels.append(Panel(what, "ms", curves))
        title = "Stage times, measured with twice their noise, and fitted"
        chart = Chart(title, "rotor speed [rpm]", panels)
        n = max(r.guess)
        with cosim.quiet():
            run = run_product(fitted_machine(r.fit), r.fit.start_values[FRICTION], n, 1e-3)
        return Show([chart], [motion.motion(f"The fitted machine at {n:.4g} rpm", {"": run})])


def product_inputs(speeds: Sequence[float]) -> dict[str, Series]:
    """Inputs that drop a product in each period, at these speeds of the rotor [rad/s]."""
    begins = PERIOD * np.arange(len(speeds))
    edges = np.stack([begins + BEFORE * PERIOD, begins + 2 * BEFORE * PERIOD], axis=1).ravel()
    drops = [False, *[True, False] * len(speeds)]
    return {
        SPEED: Series.of({"t": begins, "w": speeds}).held(),
        DROP: Series.of({"t": [0.0, *edges.tolist()], "drop": drops}),
    }


def at_period_ends(name: str, table: Series) -> Series:
    """The stage times of a column, each at the end of the period in which its product is dropped."""
    if name.removeprefix("orientator.") not in TIMES:
        raise SetupError(f"{table.label}: {name} is not a stage time, only {', '.join(TIMES)}")
    ends = PERIOD * (table.t + 1.0)
    return Series(table.columns, [ends, table.numbers(gaps=True)].__getitem__, label=table.label)


def nearest(system: System, data: Mapping[str, Series]) -> System:
    """The machine with the friction whose times are nearest."""

    def deviation(machine: System) -> float:
        stop = max(float(table.t[-1]) for table in data.values())
        with cosim.quiet():
            run = cosim.run(machine, stop=stop, step=PERIOD * BEFORE)
        ends = [(run[name], table) for name, table in data.items()]
        each = [
            np.interp(table.t, run["time"], x)
            - multiples("s").get(table.signal.unit or "s", math.nan) * table.numbers(gaps=True)
            for x, table in ends
        ]
        return float(np.nansum(np.square(each)))

    machines = [
        replace(system, start={FRICTION: mu, **system.start}) for mu in FIRST_FRICTIONS.tolist()
    ]
    return min(machines, key=deviation)


def fitted_machine(fit: Identified) -> System:
    """Return the machine with the values found, without its products."""
    return replace(fitted_system(fit, fit.start_values), inputs={})


def fastest_rotor(fit: Identified) -> Figure:
    """The fastest rotor that orients [rpm]; its error holds that of friction."""
    mu, machine = fit.values[FRICTION], fitted_machine(fit)
    with cosim.quiet():
        best, *ends = (
            simulated_limit(machine, max(x, LEAST))[1] for x in (mu.value, mu.low, mu.high)
        )
    refused = next((x for x in (best, *ends) if x.error is None), None)
    if refused:
        return refused
    deviation = max(abs(x.value - best.value) + (x.error or 0.0) for x in ends)
    return best._replace(error=deviation)


def further_products(fit: Identified, tried: Sequence[int], count: int) -> dict[str, Experiment]:
    """Return the same products again, and as many at each of these speeds [rpm]."""
    noise = {column.port.name: column.noise.sigma for column in fit.problem.columns}
    stop = PERIOD * count
    experiments = {"the same products again": Experiment({}, noise, stop)}
    for n in tried:
        inputs = product_inputs([n * math.pi / 30] * count)
        experiments[f"{count} products at {n} rpm"] = Experiment({}, noise, stop, (), inputs)
    return experiments


def misfits(r: Fitted) -> list[str]:
    """Why no friction fits, by stages and products."""
    fit = r.fit
    sentences = [why for why in fit.misfit if why.startswith("chi2")]
    for name, residual in fit.residuals.items():
        deviation = (residual.measured - residual.fitted) / residual.sigma
        k = int(np.argmax(abs(deviation)))
        row = round(residual.times[k] / PERIOD) - 1
        sentences.append(
            f"{name}: off by {math.sqrt(float(np.mean(deviation**2))):.1f} times the noise, rms, and at "
            f"most by {deviation[k]:+.1f} times, at {r.guess[row]:.4g} rpm, row {row + 2}"
        )
    return sentences
