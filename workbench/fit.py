"""A system that is fitted to a record: the method, the options of a record, and the rows and pictures of a fit."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid

import cosim
from cosim import Advice, Experiment, Identified, Series, SetupError, System
from cosim.dense import Array as Samples
from cosim.system import Value, connect
from cosim.units import in_unit, multiples, read_quantity

from .answer import Findings, Table
from .charts.model import Chart, Curve, Mark, Panel
from .figure import Figure, listed
from .judgement import Judgement
from .options import Options, option

if TYPE_CHECKING:
    from .context import Context

#: Share by which the errors after two records may differ and both are as good; chosen: errors are not known better.
SAME = 0.05
#: What the errors of a fit are, which stands under its figures.
FIT_ERROR_SCOPE = (
    "The error is the 95 % interval of the fit: the noise of the record and the deviations given with --known are "
    "in it. Values that were taken as exact, and what the model leaves out, are not in it."
)


class Guess(NamedTuple):
    """What a fit begins with: a system that moves nearly as its record does, and the values that are free.

    `settings` are those of `cosim.identify`, `facts` and `defaults` those of `Findings`, `more` is of the question.
    """

    system: System
    record: Mapping[str, Series]
    free: Sequence[str]
    settings: Mapping[str, Any] = MappingProxyType({})
    facts: Mapping[str, Any] = MappingProxyType({})
    defaults: Mapping[str, Any] = MappingProxyType({})
    more: Any = None


class Followed(NamedTuple):
    """What follows from a fit: figures, a function of the values and records that narrow it, facts, `more` of the question."""

    figures: Mapping[str, Figure]
    narrowed: Callable[[Mapping[str, float]], float]
    records: Mapping[str, Experiment]
    facts: Mapping[str, Any] = MappingProxyType({})
    more: Any = None


class Fitted(NamedTuple):
    """A fit, what each further record would leave of an interval, and what the question keeps of guess and fit."""

    fit: Identified
    advice: Sequence[Advice]
    guess: Any
    more: Any


@dataclass(frozen=True, kw_only=True)
class RecordFit:
    """The system of a question fitted to its record; the errors are the 95 % intervals of the fit.

    A question of `RecordOptions` says with `guess(context)` where it begins, and with `follow(context, guess, fit)` what
    follows from a fit.

    Attributes
    ----------
    kind : str
        What is sought, "drive of this kind"; a record that none fits has no figures.
    quantities : mapping of str to pairs of str
        Units and meanings of figures besides those of the values that are free.
    exact : sequence of str
        Values that are taken as exact, unless they are free.
    unit : str
        That of what is narrowed.
    """

    kind: str
    quantities: Mapping[str, tuple[str, str]]
    exact: Sequence[str]
    unit: str = "1"

    def measure(self, context: Context, asked: Sequence[Any]) -> list[Findings | SetupError]:
        """Fit one question's system after the other."""
        return [self.findings(o, context) for o in asked]

    def findings(self, o: Any, context: Context) -> Findings:
        """Fit, and say what follows, or refuse all figures."""
        guess: Guess = o.guess(context)
        fit = o.identify(guess.system, guess.record, guess.free, **guess.settings)
        more: dict[str, Any] = dict(guess.facts)
        advice: Sequence[Advice] = ()
        kept = None
        if fit.misfit:
            why = f"no {self.kind} fits the record"
            free = {
                figure_name(name): (x.unit or "1", f"{name}, fitted")
                for name, x in fit.values.items()
            }
            figures = {
                name: Figure.undetermined(unit, why, text)
                for name, (unit, text) in {**self.quantities, **free}.items()
            }
        else:
            follows: Followed = o.follow(context, guess, fit)
            figures = {
                name: follows.figures[name]._replace(meaning=text)
                for name, (_, text) in self.quantities.items()
            }
            figures |= fitted_figures(fit)
            advice = cosim.advise(fit, follows.records, follows.narrowed)
            more |= follows.facts
            kept = follows.more
        return Findings(
            figures,
            Fitted(fit, advice, guess.more, kept),
            fit.problem.system,
            fit.result.provenance,
            tables=tables(fit, advice, o.name, self.unit),
            facts=more | facts(fit, advice, self.exact),
            defaults=guess.defaults,
        )


@dataclass(frozen=True, kw_only=True)
class RecordOptions(Options):
    """The options of a record, and what is known of its machine beforehand."""

    data: str = option("", "CSV file of the record")
    map: tuple[str, ...] = option(
        (),
        "column of a variable: conveyor.w=n:rpm or motor.tau=M*0.88:N.m; time=t is the time column",
    )
    known: tuple[str, ...] = option(
        (), "known value with its standard deviation: conveyor.trough.m=200+-5 or =200+-2.5%"
    )
    free: tuple[str, ...] = option((), "further value to fit: conveyor.spring.c or gain(motor.tau)")
    noise: tuple[str, ...] = option(
        (), "noise of a column: conveyor.w=2rpm; by default estimated from its rows"
    )
    gaps: bool = option(False, "whether cells of the record may be empty")
    outliers: float = option(
        0.0, "share of the rows that may be outliers", "%", least=0.0, most=20.0
    )
    since: float | None = option(None, "time of the first row to use", "s")
    until: float | None = option(None, "time of the last row to use", "s")
    starts: int = option(12, "largest number of starts of the search", least=2)

    def columns(self, *wanted: str, timed: bool = True) -> dict[str, Series]:
        """Return the measured columns by variable, those that are wanted among them.

        They stand against the number of the row where they are not timed.

        Raises SetupError for a file or a map that cannot be read, and for a column that lacks.
        """
        example = f"--map {wanted[0]}=COLUMN:UNIT"
        if not self.data:
            raise SetupError(f"a record is needed: --data FILE.csv {example}")
        columns: dict[str, str] = {}
        for text in self.map:
            name, equals, column = (part.strip() for part in text.partition("="))
            if not equals or name in columns:
                why = "is mapped twice" if equals else "must read NAME=COLUMN"
                raise SetupError(f"map {text!r}: {name} {why}")
            columns[name] = column
        for name in wanted:
            if name not in columns:
                raise SetupError(f"{self.data}: no column is mapped to {name}: --map {name}=COLUMN")
        time = columns.pop("time", "time") if timed else None
        tables = cosim.measured(self.data, columns, time=time, gaps=self.gaps)
        first = -math.inf if self.since is None else self.since
        last = math.inf if self.until is None else self.until
        return {name: table.between(first, last) for name, table in tables.items()}

    def speeds_and_angles(
        self, speed: Series, what: str, gear: float = 1.0
    ) -> tuple[Samples, Samples]:
        """Return the speeds [rad/s] of a column but for its gaps, and the angle [rad] at each.

        The angle is that of what turns `gear` times slower. Raises SetupError if it has not turned once in
        the end.
        """
        w = speed.numbers(gaps=True) * multiples("rad/s").get(speed.signal.unit, 1.0)
        is_measured = np.isfinite(w)
        w = w[is_measured]
        turned = cumulative_trapezoid(w / gear, speed.t[is_measured], initial=0)
        if turned[-1] < 2 * math.pi:
            raise SetupError(
                f"{self.data}: the record contains {turned[-1] / (2 * math.pi):.2g} turns of the "
                f"{what}; at least one is needed"
            )
        return w, turned

    def identify(
        self, system: System, data: Mapping[str, Series], free: Sequence[str], **settings: Any
    ) -> Identified:
        """The system fitted to columns, with what is asked and known; `cosim.identify`."""
        return cosim.identify(
            system,
            data,
            free=list(dict.fromkeys([*free, *self.free])),
            prior=dict(prior(system, text) for text in self.known),
            noise=dict(noise(system, text) for text in self.noise),
            outliers=self.outliers / 100,
            starts=self.starts,
            **settings,
        )


def noise(system: System, text: str) -> tuple[str, float]:
    """Name of a text such as "conveyor.w=2rpm", and its number in the unit of the variable."""
    name, _, value = (part.strip() for part in text.partition("="))
    unit = connect(system).port(name).unit
    if math.isnan(number := in_unit(value, unit)):
        units = " or ".join(multiples(unit))
        raise SetupError(
            f"noise {text!r} must read NAME=NUMBER, the number in {units}, or without a unit in {unit}"
        )
    return name, number


def prior(system: System, text: str) -> tuple[str, tuple[float, float]]:
    """Name, value and standard deviation of "conveyor.trough.m=200+-5", or "0.2t+-5kg", in the unit of the variable."""
    from cosim.identification.parameters import SENSOR, is_sensor_parameter  # with SciPy

    name, _, known = (part.strip() for part in text.partition("="))
    value, _, off = known.replace("±", "+-").partition("+-")
    kind = name.partition("(")[0] if is_sensor_parameter(name) else ""
    unit = SENSOR[kind][1] if kind else connect(system).port(name).unit
    mean, sigma = in_unit(value, unit), in_unit(off, unit)
    if (share := read_quantity(off)) and share.unit == "%":
        sigma = abs(mean) * share.number / 100
    if math.isnan(mean + sigma):
        units = " or ".join(multiples(unit))
        form = f"NAME=VALUE+-DEVIATION, in {units}, or +- a share in %"
        raise SetupError(f"known {text!r} must read {form}")
    return name, (mean, sigma)


def figure_of(interval: Any, meaning: str = "") -> Figure:
    """An interval as a figure, refused where the record does not determine the value."""
    unit = interval.unit or "1"
    if not math.isfinite(interval.error) or interval.error > abs(interval.value) * 1e3 + 1e9:
        return Figure.undetermined(unit, "the record does not determine it", meaning)
    return Figure(interval.value, unit, interval.error, meaning)


def figure_name(name: str) -> str:
    """The name of a figure of a free value, "conveyor_trough_m"."""
    return re.sub(r"\W+", "_", name).strip("_").lower()


def fitted_figures(fit: Identified) -> dict[str, Figure]:
    """All values that were free, by name; the meaning says which others the record cannot tell one from."""
    meanings = {name: f"{name}, fitted" for name in fit.values}
    for group in fit.correlated_groups:
        for name in meanings.keys() & set(group):
            correlated = listed([member for member in group if member != name])
            meanings[name] += f"; the record cannot tell it apart from {correlated}"
    return {figure_name(name): figure_of(x, meanings[name]) for name, x in fit.values.items()}


def fitted_system(fit: Identified, values: Mapping[str, float]) -> System:
    """The system of a fit with these of its values, but for those of sensors."""
    mine = {name: x for name, x in values.items() if "(" not in name}
    system = fit.problem.system
    return replace(system, start={**system.start, **mine})


def tables(fit: Identified, advice: Sequence[Advice], name: str, unit: str) -> dict[str, Table]:
    """Return the measured and the fitted values, and the errors after further records.

    Values stand by time, with what is between them; errors are those of a quantity in this unit.
    """
    frame, units = None, {"time": "s"}
    for column, residual in fit.residuals.items():
        mine = pd.DataFrame(
            {"time": residual.times, column: residual.measured, f"{column}_fitted": residual.fitted,
             f"{column}_residual": residual.fitted - residual.measured}
        )  # fmt: skip
        units |= dict.fromkeys(mine.columns[1:], residual.unit)
        frame = mine if frame is None else frame.merge(mine, on="time", how="outer")
    assert frame is not None
    after = Table.of_rows([(x.name, x.error) for x in advice], {"record": "", "error": unit})
    return {f"{name}.csv": Table.of_frame(frame, units), f"{name}_next.csv": after}


def facts(fit: Identified, advice: Sequence[Advice], exact: Sequence[str]) -> dict[str, Any]:
    """Further entries of the JSON; `exact` are values that were taken as exact, unless free."""
    taken = fit.start_values
    return {
        "chi2": {"sum": fit.chi2, "degrees": fit.dof, "band": list(fit.band)},
        "minima": list(fit.minima),
        "misfit": list(fit.misfit),
        "notes": list(fit.notes),
        "exact": {name: taken[name] for name in exact if name in taken and name not in fit.names},
        "alike": [list(group) for group in fit.correlated_groups],
        "correlations": {
            name: dict(zip(fit.names, map(float, row)))
            for name, row in zip(fit.names, fit.correlations)
        },
        "next": {x.name: x.error for x in advice},
    }


def further_records(
    fit: Identified,
    states: Sequence[str],
    *,
    rest: Mapping[str, Value],
    supply: str,
    steps: Mapping[str, float],
    torque: Mapping[str, float],
) -> dict[str, Experiment]:
    """Return further records as long and as noisy as that of a fit: the same again, from `rest`, and after `steps` of its supply.

    The others begin at the `states` at the end of the record. A step is told by words and gives the factor of the start value
    `supply`. Each is there with the noise of `torque`, too, where the record is without it.
    """
    times = fit.problem.columns[0].times
    stop, noise = (
        float(times[-1] - times[0]),
        {x.port.name: x.noise.sigma for x in fit.problem.columns},
    )
    last: dict[str, Value] = {name: float(fit.result[name][-1]) for name in states}
    stepped = {x: {**last, supply: share * fit.start_values[supply]} for x, share in steps.items()}
    starts = {"the same again": last, "a run-up from rest": rest, **stepped}
    columns = {"": noise, ", with the torque": {**noise, **torque}}
    return {
        f"{word}{more}": Experiment(start, of_columns, stop, (supply,) * (word in stepped))
        for word, start in starts.items()
        for more, of_columns in columns.items()
        if not more or not torque.keys() <= noise.keys()
    }


def misfit(what: str, reasons: Sequence[str]) -> list[Judgement]:
    """Return that no machine of a kind fits a record, and a line for each reason."""
    return [Judgement(what, is_so=False), *(Judgement("", note=reason) for reason in reasons)]


def next_record(advice: Sequence[Advice], now: Figure, what: str, unit: str) -> Judgement:
    """Return which record to make next; those within SAME of the best are as good."""
    best = [x for x in advice if x.error <= (1 + SAME) * advice[0].error]
    error = max(x.error for x in best)
    narrows = f"narrows the interval of {what}"
    if now.error and error >= now.error / (1 + SAME):
        return Judgement(f"a further record of these kinds {narrows} by much", is_so=False)
    names = " or ".join(x.name for x in best)
    return Judgement(
        f"next, record {names}, which {narrows} to", note=f"{error:.2g} {unit}".rstrip()
    )


def fitted_charts(fit: Identified, labels: Mapping[str, tuple[str, str]]) -> list[Chart]:
    """Each column measured, fitted and what is between them; `labels` are their words and colors."""
    pictures = []
    for name, residual in fit.residuals.items():
        what, color = labels[name]
        difference = residual.fitted - residual.measured
        panels = [
            Panel(what, residual.unit, [Curve("measured", residual.times, residual.measured, "grey", "points"),
                                    Curve("fitted", residual.times, residual.fitted, color)]),
            Panel("fitted minus measured", residual.unit, [Curve("residual", residual.times, difference, color, "points")],
                  [Mark(s * 2 * residual.sigma, f"{2 * s:+d} sigma of the noise") for s in (-1, 1)]),
        ]  # fmt: skip
        pictures.append(Chart(f"The {what}, measured and fitted", "time [s]", panels))
    return pictures
