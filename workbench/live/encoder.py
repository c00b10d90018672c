"""What a declaration is as data: its fields by their names, checked with the values of an answer, its formulas numbered.

How a field is encoded follows from its type in `declare`: a formula becomes its number, one of columns with the columns
that it uses, and a declaration within another the same again. The page's script reads the fields by the same names.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, get_type_hints

from cosim import SetupError
from cosim.engine.algorithms import find_algorithm
from cosim.metrics import Metric
from cosim.system import Network, Port, Value
from cosim.system.graph import stepping_order

from ..answer import parameters
from ..charts.model import Chart, Curve, Mark, Panel
from ..charts.plotly import figure
from ..charts.svg import font_size_css
from ..dimensions import check_unit, known_units
from ..formula import DOTTED, Formula
from ..options import Options, declared
from . import drawing
from .declare import (
    READERS,
    REVOLUTION,
    UNIT_OF_COLUMN,
    Live,
    LiveMotion,
    LiveRun,
    LiveSweep,
    Number,
    Reader,
    RunChart,
    Slider,
)

if TYPE_CHECKING:
    from ..answer import Findings

#: what a formula of columns may use besides outputs
CLOCK = ("time", "crank_angle")
#: Fields that no script reads.
NOT_SENT = ("factors", "panels", "label", "draw")


def numeric(start: Iterable[tuple[Port, Value]]) -> dict[str, float]:
    """Return start values that are numbers, by name; the modules take no texts."""
    return {port.name: float(x) for port, x in start if not isinstance(x, str)}


def require_angle_for_window(x: Reader | RunChart | LiveMotion, where: str, angle: str) -> None:
    """Refuse a revolution of no angle."""
    if x.window == REVOLUTION and not angle:
        raise SetupError(f"{where}: a revolution needs `angle`, the output of the crank angle")


@dataclass
class LiveEncoder:
    """Turns a declaration into data, and collects the formulas and the columns that it uses."""

    network: Network
    options: Options
    findings: Findings
    live: Live
    values: dict[str, float] = field(default_factory=dict)
    numbers_read: set[str] = field(default_factory=set)
    sources: list[str] = field(default_factory=list)
    columns: list[str] = field(default_factory=list)

    def page_data(self) -> dict[str, Any]:
        """Return the data of the declaration."""
        live = self.live
        sliders = [self.slider(x) for x in live.sliders]
        self.values |= self.option_values | {x["name"]: x["value"] for x in sliders}
        scope = dict(self.values)
        if self.network.inputs:
            names = ", ".join(port.name for port, _ in self.network.inputs)
            raise SetupError(f"{names} follows a table or a function, which a live page cannot do")
        values = []
        for name, text in live.values.items():
            values.append([name, self.formula_of_values(text, f"values: {name}")])
            self.values[name] = Formula.read(text)(self.values)
        for text, where in ((live.stop, "stop"), (live.step, "step")):
            self.values.setdefault(where, self.positive(text, where))
        starts = [("start", live.start), *(("start of a run", run.start) for run in live.runs)]
        for where, start in starts:
            for name in start:
                self.port(name, where)
        if live.angle:
            self.record(live.angle, "angle")
        self.check_sweep()
        sequence = stepping_order(self.network, None)
        chosen = find_algorithm(getattr(self.options, "algorithm", "strang"))
        if live.until == REVOLUTION:
            raise SetupError(f"until must be a time, not {REVOLUTION!r}")
        numbers = self.numbers(live.numbers)  # before the charts, which may use all of them
        return self.encoded(live, "live", sliders=sliders, values=values, numbers=numbers) | {
            "scope": scope, "base": numeric(self.network.start), "wires": self.wires(), "sequence": sequence,
            "schedule": {"stages": chosen.stages(sequence), "end_weight": chosen.end_weight}, "columns": self.columns,
        }  # fmt: skip

    def encoded(self, x: Any, where: str, /, **known: Any) -> dict[str, Any]:
        """Return a declaration by the names of its fields, some of which are known."""
        hints = get_type_hints(type(x), include_extras=True)
        return {
            f.name: known[f.name]
            if f.name in known
            else self.field(getattr(x, f.name), hints[f.name], where)
            for f in fields(x)
            if f.name not in NOT_SENT
        }

    def field(self, x: Any, hint: Any, where: str) -> Any:
        """Return the value of a field as its type says."""
        match x:
            case RunChart():
                return self.chart(x)
            case LiveMotion():
                return self.motion(x)
            case LiveSweep():
                return self.encoded(x, "sweep", numbers=self.numbers(x.numbers))
            case _ if is_dataclass(x):
                return self.encoded(x, where)
            case Mapping():
                return [
                    [name, self.formula_of_values(text, f"{where}: {name}")]
                    for name, text in x.items()
                ]
        if role := getattr(hint, "__metadata__", None):
            return getattr(self, role[0])(x, where)
        if isinstance(x, Sequence) and not isinstance(x, str):
            return [self.field(each, hint, where) for each in x]
        return x

    @cached_property
    def fmu_outputs(self) -> frozenset[str]:
        """The outputs of the FMUs, which formulas of columns may use."""
        return frozenset(
            f"{part}.{variable.name}"
            for part, description in self.network.descriptions.items()
            for variable in description.modelVariables
            if variable.causality == "output"
        )

    @cached_property
    def parameters(self) -> Mapping[str, Any]:
        """The start values and parameters of the system; formulas may name those that are numbers."""
        return parameters(self.findings.system)  # type: ignore[arg-type]

    @cached_property
    def option_values(self) -> dict[str, float]:
        """The values of start values and options that formulas may name."""
        options = {name: getattr(self.options, name) for name in declared(type(self.options))}
        options = dict(self.findings.defaults) | {k: x for k, x in options.items() if x is not None}
        all_values = {name: x.value for name, x in self.parameters.items()} | options
        return {
            name: float(x)
            for name, x in all_values.items()
            if DOTTED.fullmatch(name) and isinstance(x, (int, float))
        }

    @cached_property
    def units_of_terms(self) -> dict[str, str]:
        """The units of what formulas may name, where they are known."""
        columns = {x: self.network.port(x).unit for x in self.fmu_outputs}
        clock = dict(zip(CLOCK, ("s", "rad")))
        return known_units(self.options, self.findings.figures, self.parameters, columns, clock)

    def slider(self, slider: Slider) -> dict[str, Any]:
        """Return a slider with value, unit and meaning of the option or start value that it moves."""
        name, options = slider.name, declared(type(self.options))
        if name not in options and name not in self.parameters:
            raise SetupError(f"slider {name!r} is neither an option nor a start value")
        what: Any = options.get(name) or self.parameters[name]
        value = self.option_values.get(name)
        if value is None:
            raise SetupError(
                f"slider {name!r} has no value of its own, and none among the defaults"
            )
        first = type(self.options)()
        own = getattr(first, name) if name in options else value if first == self.options else None
        if own is not None and not slider.low <= float(own) <= slider.high:
            raise SetupError(
                f"slider {name!r} from {slider.low:g} to {slider.high:g} must contain its original value {own:g}"
            )
        meaning = what.meaning.partition(", ")[0]
        return {
            "name": name, "meaning": meaning[:1].upper() + meaning[1:], "unit": what.unit, "option": name in options,
            "value": value, "low": min(slider.low, value), "high": max(slider.high, value),
        }  # fmt: skip

    def wires(self) -> list[dict[str, Any]]:
        """Return the wires with their factors, which may be formulas."""
        targets, factors = [wire.target.name for wire in self.network.wires], self.live.factors
        for name in factors:
            if name not in targets:
                raise SetupError(
                    f"factors: no wire leads to {name!r}, only to {', '.join(targets)}"
                )
        for name in sorted({x for x in targets if targets.count(x) > 1}):
            raise SetupError(f"several wires add up in {name!r}, which a live page cannot do")
        return [
            {
                "from": wire.source.name, "to": wire.target.name, "factor": wire.factor, "offset": wire.offset,
                "nominal": abs(float(wire.source.variable.nominal or 0.0)) or 1.0,
                "discrete": wire.source.type != "Real",
                "formula": self.formula_of_values(factors.get(wire.target.name, wire.factor), "factors"),
            }
            for wire in self.network.wires
        ]  # fmt: skip

    def formula_of_values(self, text: Any, where: str, more: Iterable[str] = ()) -> int:
        """Return the number of a formula of values, and of what is named besides."""
        formula = Formula.read(text)
        for name in sorted(formula.names - self.values.keys() - {*more}):
            what = (
                "number of this page that is read before"
                if name.startswith("figures.")
                else "option, start value or value of this page"
            )
            raise SetupError(f"{where}: the formula {text!r} uses {name!r}, which is no {what}")
        if formula.source not in self.sources:
            self.sources.append(formula.source)
        return self.sources.index(formula.source)

    def formula_of_numbers(self, text: Any, where: str) -> int:
        """Return the number of a formula of values and of numbers that were read before."""
        return self.formula_of_values(text, where, more=self.numbers_read)

    def formula_of_columns(self, text: Any, where: str, factor: float = 1.0) -> dict[str, Any]:
        """Return a formula of columns: its number, and the columns that it uses."""
        formula = Formula.read(text if factor == 1.0 else f"{factor!r} * ({text})")
        if "crank_angle" in formula.names and not self.live.angle:
            raise SetupError(f"{where}: crank_angle needs `angle`, the output of the crank angle")
        columns = sorted(formula.names & {*CLOCK, *self.fmu_outputs})
        for name in columns:
            if name not in CLOCK:
                self.record(name, where)
        number = self.formula_of_values(formula.text, where, more=(*self.numbers_read, *columns))
        return {"formula": number, "columns": columns}

    def window_formula(self, window: Any, where: str) -> Any:
        """Return the number of the formula of a time, a word, or None for all rows."""
        if window in ("", REVOLUTION):
            return window or None
        return self.formula_of_numbers(window, where)

    def formula_functions(self) -> str:
        """Return the formulas as functions of JavaScript."""
        return "const formulas = [\n{}];\n".format("".join(f"v=>{x},\n" for x in self.sources))

    def positive(self, text: Any, where: str) -> float:
        """Return the value of a formula that is a time above 0 [s] with the values of the options."""
        self.formula_of_values(text, where)
        value = Formula.read(text)(self.values)
        if not value > 0.0 or not math.isfinite(value):
            raise SetupError(f"{where} = {text!r} is {value:g} s, but must be above 0")
        return value

    def port(self, name: str, where: str) -> Port:
        """Return the variable of a name."""
        try:
            return self.network.port(name)
        except SetupError as error:
            raise SetupError(f"{where}: {error}") from error

    def record(self, name: str, where: str) -> None:
        """Record an output."""
        self.port(name, where)
        if name not in self.columns:
            self.columns.append(name)

    def numbers(self, numbers: Sequence[Number]) -> list[dict[str, Any]]:
        """Return the numbers of a run, each of which may use those before, and all of them in `when`."""
        encoded, self.numbers_read = [], set()
        names = [f"figures.{x.name}" for x in numbers]
        for x, name in zip(numbers, names):
            when = self.formula_of_values(x.when, f"number {x.name!r}: when", more=names)
            encoded.append(self.number(x, when))
            self.numbers_read.add(name)
        return encoded

    def number(self, number: Number, when: int) -> dict[str, Any]:
        """Return a live number with the number of its formula `when`, and with unit, meaning and value of the figure beside it."""
        figure, where = self.findings.figures.get(number.name), f"number {number.name!r}"
        if figure is None and not (number.unit and number.meaning):
            raise SetupError(
                f"{where} is no figure of the answer, so it must have unit and meaning"
            )
        if figure and number.unit and number.unit != figure.unit:
            raise SetupError(f"{where} has the unit {number.unit!r}, its figure {figure.unit!r}")
        told: dict[str, Any] = {"when": when}
        told |= {"unit": figure.unit, "meaning": figure.meaning} if figure else {}
        unit = number.unit or (figure.unit if figure else "")
        if isinstance(number.value, Reader):
            told["value"] = self.reader(number.value, where, unit)
        elif isinstance(number.value, Metric):
            raise SetupError(
                f"{where}: a page has no metric; write a Reader, or leave it to the answer"
            )
        else:
            check_unit(number.value, unit, self.units_of_terms, where)
        original = figure.text() if figure else ""
        return self.encoded(number, where, **told) | {"original": original}

    def reader(self, reader: Reader, where: str, unit: str) -> dict[str, Any]:
        """Return how a number is read, in this unit where it has that of a column alone."""
        names = [run.name for run in self.live.runs]
        if reader.kind not in READERS:
            raise SetupError(f"{where}: {reader.kind!r} must be one of {', '.join(READERS)}")
        if reader.run and reader.run not in names:
            raise SetupError(f"{where}: there is no run {reader.run!r}, only {', '.join(names)}")
        if reader.kind in ("amplitude", "phase") and reader.window != REVOLUTION:
            raise SetupError(f"{where}: {reader.kind} needs the window {REVOLUTION!r}")
        angle = reader.angle or self.live.angle
        require_angle_for_window(reader, where, angle)
        if angle:
            self.record(angle, where)
        run = names.index(reader.run) if reader.run else 0
        is_alone = reader.column in self.fmu_outputs
        own = str(self.network.port(reader.column).unit) if is_alone else ""
        check_unit(reader.level, own, self.units_of_terms, f"{where}: level")
        if not is_alone and reader.kind in UNIT_OF_COLUMN:
            check_unit(reader.column, unit, self.units_of_terms, where)
        column = self.formula_of_columns(reader.column, where, reader.factor(own, unit, where))
        return self.encoded(reader, where, column=column, run=run, angle=angle)

    def chart(self, chart: RunChart) -> dict[str, Any]:
        """Return a chart of runs, or over a sweep: what its traces are, and how plotly draws them."""
        where, sweep = f"chart {chart.title!r}", self.live.sweep
        require_angle_for_window(chart, where, self.live.angle)
        is_swept = sweep is not None and chart is sweep.chart
        runs = [LiveRun()] if is_swept else self.live.runs
        of_value = self.formula_of_values if is_swept else self.formula_of_numbers
        traces: list[dict[str, Any]] = []
        panels = []
        for panel in chart.panels:
            for text in panel.curves:
                is_known = text in (*CLOCK, *self.values) or text.startswith("figures.")
                if DOTTED.fullmatch(text) and not is_known:
                    self.record(text, where)
            columns = {
                x: str(self.network.port(x).unit) for x in panel.curves if x in self.fmu_outputs
            }
            unit, factors = panel.units(
                columns, self.units_of_terms, f"{where}: panel {panel.quantity!r}"
            )
            if is_swept:
                traces += [
                    {"formula": self.formula_of_numbers(text, where), "sweep": "figures." in text}
                    for text in panel.curves
                ]
            else:
                traces += [
                    {"run": run, **self.formula_of_columns(text, where, factor)}
                    for run in range(len(runs))
                    for text, factor in factors.items()
                ]
            traces += [{"level": of_value(x, where)} for x in panel.levels.values()]
            # from 0 to 2, since what steps between 0 and 1 is no and yes
            curves = [
                Curve(x.name, [0.0, 1.0], [0.0, 2.0], x.color, x.look) for x in panel.looks(runs)
            ]
            levels = [Mark(0.5, text) for text in panel.levels]
            panels.append(Panel(panel.quantity, unit, curves, levels, panel.includes))
        marks = [
            {"text": text, "unit": unit, "value": of_value(value, where)}
            for text, (value, unit) in chart.marks.items()
        ]
        empty = [Mark(math.nan, text) for text in chart.marks]
        known = {"marks": marks, **({"x": None} if is_swept else {})}
        return self.encoded(chart, where, **known) | {
            "traces": traces, "picture": figure(Chart(chart.title, chart.label, panels, empty), has_data=False),
            "includes": [list(panel.includes) for panel in chart.panels],
        }  # fmt: skip

    def motion(self, motion: LiveMotion) -> dict[str, Any] | None:
        """Return the table of a motion, and what stands below it; None where its drawing has no table.

        A start value of the user may be the reason, which must not cost the answer, so it is a warning.
        """
        where = f"motion {motion.title!r}"
        require_angle_for_window(motion, where, self.live.angle)
        for coordinate in motion.coordinates:
            self.record(coordinate.column, where)
        try:
            table = drawing.coefficient_table(motion, len(self.live.runs))
        except drawing.NonlinearDrawingError as problem:
            logging.getLogger("cosim").warning(str(problem))
            return None
        pace = (
            "In real time." if motion.slow == 1 else f"{motion.slow:g} times slower than real time."
        )
        note = f"{pace} {motion.note}".strip()
        known = table | {"note": note, "letters": font_size_css(table["size"])}
        return known | self.encoded(motion, where, **known)

    def check_sweep(self) -> None:
        """Refuse a sweep over what does not exist, or of less than two values."""
        sweep = self.live.sweep
        if sweep is None:
            return
        if sweep.over not in self.values:
            raise SetupError(f"sweep over {sweep.over!r}, which is no option or start value")
        if len(sweep.values) <= 1:
            raise SetupError("a sweep needs two values or more")
        self.positive(sweep.step, "step of the sweep")
