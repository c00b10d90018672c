"""How the figures of a question are measured: the only places where their errors come from.

`Run` does a certified run, `Orbit` in `orbits` seeks the steady turn of an angle, `RecordFit` in `fit` fits to a record. What a
question declares as `numbers` is read from the first two.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

from cosim import Result, SetupError, System
from cosim.metrics import Metric
from cosim.system import connect

from .answer import Findings, Table, parameters
from .context import captured_log_warnings
from .dimensions import check_unit, conversion, known_units
from .figure import ROUNDING, Figure, NamedFigures, checked_figures, figure_of_figures, scaled
from .formula import DOTTED, Formula, with_formulas
from .live import Number, Reader
from .live.declare import UNIT_OF_COLUMN

if TYPE_CHECKING:
    from .context import Context


class Method(Protocol):
    """How the figures of questions are measured; it works on instances of `Question`."""

    def measure(self, context: Context, asked: Sequence[Any]) -> list[Findings | SetupError]:
        """Return what each of several questions of one class finds, or why it is refused."""


@dataclass(frozen=True)
class Run:
    """A run of each system of a question, whose errors are those of three step sizes, or of other refinements.

    Attributes
    ----------
    finer : sequence of mappings
        Options and start values of runs that show the error, as formulas of those of the question, such as twice the rows
        and half a tolerance; each adds twice what it changes. All numbers are then read from plain runs.
    """

    finer: Sequence[Mapping[str, str | float]] = ()

    def measure(self, context: Context, asked: Sequence[Any]) -> list[Findings | SetupError]:
        """Run and certify the systems of one question after the other."""
        return [answer(o, context) for o in asked]


def run_with_refinements(
    o: Any,
    context: Context,
    values: Mapping[str, float],
    metrics: Mapping[str, Metric],
    derive: Any,
) -> tuple[Result, dict[str, Figure]]:
    """Return a plain run, and metrics of it; the errors are those that finer runs show, if they are wanted."""
    runs, plain = [], replace(context, certifies=False)
    for changes in ({}, *(o.method.finer if context.certifies else ())):
        new = {name: Formula.read(text)(values) for name, text in changes.items()}
        start = {name: new.pop(name) for name in changes if "." in name}
        options = {name: type(getattr(o, name))(x) for name, x in new.items()}
        other = replace(o, start={**o.start, **start}, **options)
        with captured_log_warnings() if changes else nullcontext():
            system = other.system(context.fmus)
            runs.append(plain.certify(system, metrics, other.run_options(), None, derive=derive))
    (result, first), *others = runs
    figures = {}
    for name, x in first.items():
        change = sum(abs(x.value - of_run[name].value) for _, of_run in others)
        error = ROUNDING * abs(x.value) + 2 * change
        figures[name] = x if x.error is None else x._replace(error=error)
    return result, figures


def answer(o: Any, context: Context) -> Findings:
    """Run and certify every system, and collect figures, tables and files."""
    systems = o.system(context.fmus)
    by_name = {"": systems} if isinstance(systems, System) else systems
    require_starts(o, by_name.values())
    figures = NamedFigures()
    certified: dict[str, Result] = {}
    for name, system in by_name.items():
        certified[name], of_run = certify(o, system, context, f"{name or o.name}.csv")
        label = o.labels.get(name, name)
        figures |= {
            f"{name}_{key}" if name else key: x._replace(meaning=f"{x.meaning}, {label}")
            if name
            else x
            for key, x in of_run.items()
        }
    tables = {f"{x or o.name}.csv": Table.of(r) for x, r in certified.items()}
    results: Any = certified.get("", certified)
    if (more := o.more_runs(context, systems)) is not None:
        results = (results, more)
    figures |= o.more_figures(figures, results)
    return Findings(
        figures,
        results,
        next(iter(by_name.values())),
        next(iter(certified.values())).provenance,
        tables=tables | dict(o.tables(figures, results)),
        files=o.files(results),
        warnings=list(
            dict.fromkeys(
                f"nothing drives or sets the input {name}, which stays at {value:g}; add a wire, or give it in start_values"
                for result in certified.values()
                for name, value in result.provenance.get("open_inputs", {}).items()
            )
        ),
    )


def require_starts(o: Any, systems: Collection[System]) -> None:
    """Refuse a system that lacks start values of the user, or of the question."""
    for name in (*o.start, *o.start_values):
        is_given, part = name in o.start, name.partition(".")[0]
        for system in [x for x in systems if part in x.parts] or systems:
            is_there = name in system.start or (not is_given and name in system.inputs)
            if not is_there or (is_given and system.start[name] != o.start[name]):
                raise SetupError(
                    f"{'--start' if is_given else f'{o.path}: start_values:'} {name}: the System that system(self, fmus) returns "
                    "lacks this start value; take super().system(fmus), which has it, and change that with dataclasses.replace"
                )


def certify(o: Any, system: System, context: Context, csv: str) -> tuple[Result, dict[str, Figure]]:
    """Return the result of a system, processed, and its figures with their errors."""
    results: list[Result] = []
    given = parameters(system) if o.numbers else {}
    numbers = {n: float(x.value) for n, x in given.items() if isinstance(x.value, int | float)}
    values = {**numbers, **o.values}
    texts: dict[str, str] = {}
    metrics: dict[str, Metric] = {}
    for x in o.numbers:
        read = x.value
        if isinstance(read, Reader):
            texts.setdefault(read.column, x.unit if read.kind in UNIT_OF_COLUMN else "1")
            metrics[x.name] = read.metric(values)
        elif isinstance(read, Metric):
            metrics[x.name] = read

    def derive(result: Result) -> Result:
        results.append(o.process(result))
        return with_formulas(results[-1], texts, values)

    def figures(result: Result) -> Mapping[str, Figure]:
        return checked_figures(o.figures(result), o.path, may_await_error=True)

    has_formulas = any(DOTTED.fullmatch(text) is None for text in texts)
    own = {"figures": figures} if o.overrides("figures") else {}
    if o.method.finer:
        result, certified = run_with_refinements(o, context, values, metrics, derive)
    else:
        result, certified = context.certify(
            system, {**metrics, **own}, o.run_options(), columns_to_record(o, system), csv,
            derive=derive if o.overrides("process") or has_formulas else None,
        )  # fmt: skip
    units = (results[0] if results else result).units
    for x in o.numbers:
        figure = certified[x.name] if x.name in metrics else figure_of_formula(x, certified, values)
        known = known_units(o, certified, given, units)
        certified[x.name] = as_declared(o, x, figure, known)
    return results[0] if results else result, certified


def columns_to_record(o: Any, system: System) -> Sequence[str] | None:
    """Return the columns of `record`, and the outputs that numbers and charts use besides."""
    if o.record is None:
        return None
    used = [chart.x for chart in o.charts]
    used += [text for chart in o.charts for panel in chart.panels for text in panel.curves]
    for x in o.numbers:
        if isinstance(x.value, Reader):
            used += [name for name in (x.value.column, x.value.angle) if name]
    names = {name: None for text in used for name in sorted(Formula.read(text).names)}
    outputs = {
        f"{part}.{x.name}"
        for part, description in connect(system).descriptions.items()
        for x in description.modelVariables
        if x.causality == "output"
    }
    return [*dict.fromkeys((*o.record, *(x for x in names if x in outputs)))]


def as_declared(o: Any, x: Number, figure: Figure, units: Mapping[str, str]) -> Figure:
    """Return the figure of a number with its meaning, in its unit, from one in that of a column."""
    where = f"{o.path}: number {x.name!r}"
    try:
        meaning = x.meaning.format(**vars(o))
    except LookupError as error:
        raise SetupError(f"{o.path}: the meaning of {x.name!r} names {error}, no option") from error
    except ValueError as error:
        raise SetupError(
            f"{o.path}: the meaning of {x.name!r} = {x.meaning!r} must have options in braces, as in "
            f"{{stop:g}}, and braces themselves twice"
        ) from error
    factor: float = 1.0
    formula: str | float | None = None
    if isinstance(x.value, Reader):
        is_alone = DOTTED.fullmatch(x.value.column) is not None
        own = units.get(x.value.column, "") * is_alone
        factor = x.value.factor(own, x.unit, where)
        check_unit(x.value.level, own, units, f"{where}: level")
        if not is_alone and x.value.kind in UNIT_OF_COLUMN:
            formula = x.value.column
    elif not isinstance(x.value, Metric):
        formula = x.value
    else:
        factor = conversion(figure.unit, x.unit or figure.unit, where)
    stated = x.unit or figure.unit
    if formula is not None and (unknown := check_unit(formula, stated, units, where)):
        logging.getLogger("cosim").warning(
            f"number {x.name!r} is in {stated} as stated: the unit of {', '.join(unknown)} is not known"
        )
    return scaled(figure, factor, stated, meaning)


def figure_of_formula(
    number: Number, figures: Mapping[str, Figure], values: Mapping[str, float]
) -> Figure:
    """Return the figure of a formula, `figures.speed / 2`, see `figure_of_figures`."""
    known = {f"figures.{name}": x for name, x in figures.items()}
    formula = Formula.read(number.value)
    used = sorted(formula.names & known.keys())
    at = {**values, **{name: x.value for name, x in known.items()}}
    return figure_of_figures(
        lambda *x: formula.over({**at, **dict(zip(used, x))}),
        *(known[name] for name in used),
        unit=number.unit or "1",
    )
