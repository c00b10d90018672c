"""What a declaration is as data: checked with the values of an answer, its formulas numbered."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cosim import SetupError
from cosim.engine.algorithms import find_algorithm
from cosim.system import Network, Port, Value
from cosim.system.graph import stepping_order

from ..charts.model import DISPLAY_FACTORS, Chart, Curve, Mark, Panel
from ..charts.plotly import template
from ..charts.svg import letter_sizes
from ..formula import Formula
from ..options import Options, declared
from . import drawing
from .declare import (
    READERS,
    REVOLUTION,
    Live,
    LiveMotion,
    LiveRun,
    LiveSweep,
    Number,
    Reader,
    RunChart,
    RunPanel,
)  # fmt: skip

if TYPE_CHECKING:
    from ..answer import Findings

#: what a formula of columns may use besides outputs
CLOCK = ("time", "crank_angle")
NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
#: points of a curve without numbers over a sweep, for a smooth line on a wide screen
FINE = 300


def numeric(start: Iterable[tuple[Port, Value]]) -> dict[str, float]:
    """Return start values that are numbers, by name; the modules take no texts."""
    return {port.name: float(x) for port, x in start if not isinstance(x, str)}


@dataclass
class Content:
    """Turns a declaration into data, and collects the formulas and the columns that it uses."""

    network: Network
    options: Options
    findings: Findings
    values: dict[str, float] = field(default_factory=dict)
    sources: list[str] = field(default_factory=list)
    columns: list[str] = field(default_factory=list)

    def of(self, live: Live) -> dict[str, Any]:
        """Return the data of a declaration."""
        sliders = self.sliders(live)
        scope = dict(self.values)
        if self.network.inputs:
            names = ", ".join(port.name for port, _ in self.network.inputs)
            raise SetupError(
                f"LIVE: {names} follows a table or a function, which a live page cannot do"
            )
        base = numeric(self.network.start)
        values = []
        for name, text in live.values.items():
            values.append([name, self.formula(text, f"values: {name}")])
            self.values[name] = Formula.read(text)(self.values)
        for text, where in ((live.stop, "stop"), (live.step, "step")):
            self.positive(text, where)
            self.values.setdefault(where, Formula.read(text)(self.values))
        for run in live.runs:
            self.ports(run.start, "start of a run")
        self.ports(live.start, "start")
        if live.angle:
            self.record(live.angle, "angle")
        numbers = [self.number(x, live) for x in live.numbers]
        charts = [self.chart(x, live) for x in live.charts]
        return {
            "sliders": sliders, "scope": scope, "base": base, "values": values,
            "wires": self.wires(live), "sequence": stepping_order(self.network, None),
            "schedule": self.schedule(live.algorithm or getattr(self.options, "algorithm", "strang")),
            "start": self.pairs(live.start, "start"),
            "runs": [{"name": x.name, "start": self.pairs(x.start, "runs")} for x in live.runs],
            "stop": self.formula(live.stop, "stop"), "step": self.formula(live.step, "step"),
            "angle": live.angle or None, "steady": live.steady and vars(live.steady),
            "until": None if live.until == "" else self.formula(live.until, "until", numbers=True),
            "numbers": numbers, "charts": charts,
            "motion": self.motion(live.motion, live) if live.motion else None,
            "sweep": self.sweep(live.sweep, live) if live.sweep else None,
            "columns": self.columns,
        }  # fmt: skip

    @cached_property
    def outputs(self) -> frozenset[str]:
        """The outputs of the FMUs, which formulas of columns may use."""
        return frozenset(
            f"{part}.{variable.name}"
            for part, description in self.network.descriptions.items()
            for variable in description.modelVariables
            if variable.causality == "output"
        )

    def sliders(self, live: Live) -> list[dict[str, Any]]:
        """Return the sliders, and fill the values that formulas may use."""
        from ..answer import parameters

        options, starts = declared(type(self.options)), parameters(self.findings.system)  # type: ignore[arg-type]
        for name, parameter in starts.items():
            if NAME.fullmatch(name) and isinstance(parameter.value, (int, float)):
                self.values[name] = float(parameter.value)
        sliders = []
        for slider in live.sliders:
            name = slider.name
            if name not in options and name not in starts:
                raise SetupError(f"LIVE: {name!r} is neither an option nor a start value")
            sliders.append(
                self.slider(slider.low, slider.high, name, options.get(name) or starts[name])
            )
        for name in options:
            value = getattr(self.options, name)
            if isinstance(value, (int, float)):
                self.values[name] = float(value)
        self.values |= {x["name"]: x["value"] for x in sliders}
        return sliders

    def slider(self, low: float, high: float, name: str, declaration: Any) -> dict[str, Any]:
        """Return a slider; `declaration` is the option or the parameter that it moves."""
        is_option = name in declared(type(self.options))
        value = getattr(self.options, name) if is_option else declaration.value
        value = getattr(self.findings.data, name, None) if value is None else value
        if value is None:
            raise SetupError(f"LIVE: {name!r} has no value of its own, and none in the data")
        return {
            "name": name, "meaning": _heading(declaration.meaning), "unit": declaration.unit,
            "value": float(value), "low": min(low, float(value)), "high": max(high, float(value)),
            "option": is_option,
        }  # fmt: skip

    def schedule(self, algorithm: str) -> dict[str, Any]:
        """Return the stages of a step by a coupling algorithm, and the weight of its end; refuse one that is none."""
        chosen = find_algorithm(algorithm)
        stages = chosen.stages(stepping_order(self.network, None))
        return {"stages": stages, "end_weight": chosen.end_weight}

    def wires(self, live: Live) -> list[dict[str, Any]]:
        """Return the wires with their factors, which may be formulas."""
        targets = [wire.target.name for wire in self.network.wires]
        for name in live.factors:
            if name not in targets:
                raise SetupError(
                    f"LIVE: factors: no wire leads to {name!r}, only to {', '.join(targets)}"
                )
        for name in sorted({x for x in targets if targets.count(x) > 1}):
            raise SetupError(f"LIVE: several wires add up in {name!r}, which a live page cannot do")
        return [
            {
                "from": wire.source.name, "to": wire.target.name, "factor": wire.factor, "offset": wire.offset,
                "nominal": abs(float(wire.source.variable.nominal or 0.0)) or 1.0,
                "discrete": wire.source.type != "Real",
                "formula": self.formula(live.factors.get(wire.target.name, wire.factor), "factors"),
            }
            for wire in self.network.wires
        ]  # fmt: skip

    def formula(
        self, text: Any, where: str, *, numbers: bool = False, more: Iterable[str] = ()
    ) -> int:
        """Return the number of a formula of values, which may use numbers of the page, too."""
        formula = Formula.read(text)
        for name in sorted(formula.names - self.values.keys() - set(more)):
            if not (numbers and name.startswith("figures.")):
                raise SetupError(
                    f"LIVE: {where}: the formula {text!r} uses {name!r}, which is no option, start value "
                    "or value of this page"
                )
        return self.index(formula)

    def index(self, formula: Formula) -> int:
        """Return the place of a formula in the list of the page, where it stands once."""
        if formula.source not in self.sources:
            self.sources.append(formula.source)
        return self.sources.index(formula.source)

    def functions(self) -> str:
        """Return the formulas as functions of JavaScript."""
        return "const formulas = [\n{}];\n".format("".join(f"v=>{x},\n" for x in self.sources))

    def positive(self, text: Any, where: str) -> None:
        """Check that a formula is a time above 0 [s] with the values of the options."""
        self.formula(text, where)
        value = Formula.read(text)(self.values)
        if not value > 0.0 or not math.isfinite(value):
            raise SetupError(f"LIVE: {where} = {text!r} is {value:g} s, but must be above 0")

    def ports(self, start: Mapping[str, Any], where: str) -> None:
        """Check that start values exist."""
        for name in start:
            try:
                self.network.port(name)
            except SetupError as error:
                raise SetupError(f"LIVE: {where}: {error}") from error

    def pairs(self, formulas: Mapping[str, Any], where: str) -> list[list[Any]]:
        """Return names, each with the number of its formula."""
        return [[name, self.formula(text, f"{where}: {name}")] for name, text in formulas.items()]

    def record(self, name: str, where: str) -> None:
        """Record an output."""
        try:
            self.network.port(name)
        except SetupError as error:
            raise SetupError(f"LIVE: {where}: {error}") from error
        if name not in self.columns:
            self.columns.append(name)

    def column(self, text: Any, where: str, live: Live, factor: float = 1.0) -> dict[str, Any]:
        """Return a formula of columns: its number, and the columns that it uses."""
        formula = Formula.read(text if factor == 1.0 else f"{factor!r} * ({text})")
        if "crank_angle" in formula.names and not live.angle:
            raise SetupError(
                f"LIVE: {where}: crank_angle needs `angle`, the output of the crank angle"
            )
        columns = sorted(formula.names & {*CLOCK, *self.outputs})
        for name in columns:
            if name not in CLOCK:
                self.record(name, where)
        return {
            "formula": self.formula(formula.text, where, numbers=True, more=columns),
            "columns": columns,
        }

    def window(self, window: Any, where: str, angle: str) -> Any:
        """Return the number of the formula of a window, a word, or None for all rows."""
        if window == "":
            return None
        if window == REVOLUTION:
            if not angle:
                raise SetupError(
                    f"LIVE: {where}: a revolution needs `angle`, the output of the crank angle"
                )
            return REVOLUTION
        return self.formula(window, where)

    def number(self, number: Number, live: Live) -> dict[str, Any]:
        """Return a live number, with unit and meaning of the figure beside it."""
        original_figure = self.findings.figures.get(number.name)
        where = f"number {number.name!r}"
        if original_figure is None and not (number.unit and number.meaning):
            raise SetupError(
                f"LIVE: {where} is no figure of the answer, so it must have unit and meaning"
            )
        rest: dict[str, Any] = {
            "name": number.name,
            "unit": number.unit or (original_figure.unit if original_figure else ""),
            "meaning": number.meaning or (original_figure.meaning if original_figure else ""),
            "original": original_figure.text() if original_figure else "",
            "when": self.formula(number.when, where, numbers=True), "otherwise": number.otherwise,
            "is_visible": number.is_visible,
        }  # fmt: skip
        if original_figure and number.unit and number.unit != original_figure.unit:
            raise SetupError(
                f"LIVE: {where} has the unit {number.unit!r}, its figure {original_figure.unit!r}"
            )
        if isinstance(number.value, Reader):
            return rest | self.reader(number.value, where, live)
        return rest | {"value": self.formula(number.value, where, numbers=True)}

    def reader(self, reader: Reader, where: str, live: Live) -> dict[str, Any]:
        """Return how a number is read."""
        if reader.kind not in READERS:
            raise SetupError(f"LIVE: {where}: {reader.kind!r} must be one of {', '.join(READERS)}")
        names = [run.name for run in live.runs]
        if reader.run and reader.run not in names:
            raise SetupError(
                f"LIVE: {where}: there is no run {reader.run!r}, only {', '.join(names)}"
            )
        if reader.kind in ("amplitude", "phase") and reader.window != REVOLUTION:
            raise SetupError(f"LIVE: {where}: {reader.kind} needs the window {REVOLUTION!r}")
        angle = reader.angle or live.angle
        if angle:
            self.record(angle, where)
        return {
            "kind": reader.kind, "column": self.column(reader.column, where, live),
            "window": self.window(reader.window, where, angle), "order": reader.order,
            "angle": angle or None,
            "level": self.formula(reader.level, where, numbers=True),
            "run": names.index(reader.run) if reader.run else 0,
        }  # fmt: skip

    def chart(self, chart: RunChart, live: Live) -> dict[str, Any]:
        """Return a chart of the run: what its traces are, and how plotly draws them."""
        where = f"chart {chart.title!r}"
        traces: list[dict[str, Any]] = []
        for panel in chart.panels:
            for run in range(len(live.runs)):
                traces += [
                    {"run": run, **self.column(text, where, live, self.scale(text, panel, where))}
                    for text in panel.curves
                ]
            traces += [
                {"level": self.formula(x, where, numbers=True)} for x in panel.levels.values()
            ]
        window = self.window(chart.window, where, live.angle)
        x = self.column(chart.x, where, live)
        return {"x": x, "window": window, "traces": traces, **self.picture(chart, live.runs)}

    def unit_of(self, text: str, where: str) -> str:
        """Return the unit of a formula that is one column; none of another."""
        if text not in self.outputs:
            return ""
        self.record(text, where)
        return str(self.network.port(text).unit)

    def unit(self, panel: RunPanel, where: str) -> str:
        """Return the unit of a panel."""
        unit = panel.unit or self.unit_of(next(iter(panel.curves)), where)
        if not unit:
            raise SetupError(f"LIVE: {where}: the panel {panel.quantity!r} needs a unit")
        return unit

    def scale(self, text: str, panel: RunPanel, where: str) -> float:
        """Return the factor from the unit of a column to that of its panel."""
        unit, target = self.unit_of(text, where), self.unit(panel, where)
        if unit in ("", target):
            return 1.0
        if (unit, target) not in DISPLAY_FACTORS:
            raise SetupError(
                f"LIVE: {where}: {text} is in {unit}, and the panel {panel.quantity!r} in {target}: "
                "no conversion is known"
            )
        return DISPLAY_FACTORS[unit, target]

    def picture(self, chart: RunChart, runs: Sequence[LiveRun]) -> dict[str, Any]:
        """Return plotly's traces and layouts without data, with the texts of marks."""
        panels = []
        for panel in chart.panels:
            # from 0 to 2, since what steps between 0 and 1 is no and yes
            curves = [
                Curve(x.name, [0.0, 1.0], [0.0, 2.0], x.color, x.look) for x in panel.looks(runs)
            ]
            levels = [Mark(0.5, text) for text in panel.levels]
            panels.append(
                Panel(panel.quantity, self.unit(panel, chart.title), curves, levels, panel.includes)
            )
        marks = [Mark(math.nan, text) for text in chart.marks]
        picture = template(Chart(chart.title, chart.label, panels, marks))
        return {
            "title": chart.title, "picture": picture,
            "includes": [list(panel.includes) for panel in chart.panels],
            "marks": [
                {"text": text, "unit": unit, "value": self.formula(value, chart.title, numbers=True)}
                for text, (value, unit) in chart.marks.items()
            ],
        }  # fmt: skip

    def motion(self, motion: LiveMotion, live: Live) -> dict[str, Any] | None:
        """Return the table of a motion, and what stands below it; None where its drawing has no table.

        A start value of the user may be the reason, which must not cost the answer, so it is a warning.
        """
        where = f"motion {motion.title!r}"
        for coordinate in motion.coordinates:
            self.record(coordinate.column, where)
        try:
            table = drawing.table(motion, len(live.runs))
        except drawing.NonlinearDrawingError as problem:
            logging.getLogger("cosim").warning(str(problem))
            return None
        captions = [
            {
                "text": x.text, "unit": x.unit, "decimals": x.decimals, "texts": x.texts,
                **self.column(x.value, where, live),
            }
            for x in motion.captions
        ]  # fmt: skip
        pace = (
            "In real time." if motion.slow == 1 else f"{motion.slow:g} times slower than real time."
        )
        return table | {
            "title": motion.title, "slow": motion.slow, "note": f"{pace} {motion.note}".strip(),
            "letters": letter_sizes(table["size"]), "captions": captions,
            "window": self.window(motion.window, where, live.angle),
            "coordinates": [[x.column, list(x.turns)] for x in motion.coordinates],
        }  # fmt: skip

    def sweep(self, sweep: LiveSweep, live: Live) -> dict[str, Any]:
        """Return a sweep, its numbers and its chart."""
        if sweep.over not in self.values:
            raise SetupError(f"LIVE: sweep over {sweep.over!r}, which is no option or start value")
        if len(sweep.values) <= 1:
            raise SetupError("LIVE: a sweep needs two values or more")
        self.positive(sweep.step, "step of the sweep")
        numbers, traces = [self.number(x, live) for x in sweep.numbers], []
        for panel in sweep.chart.panels:
            for text in panel.curves:
                formula = Formula.read(text)
                read = any(name.startswith("figures.") for name in formula.names)
                traces.append({"formula": self.formula(text, "sweep", numbers=True), "sweep": read})
            traces += [{"level": self.formula(x, "sweep")} for x in panel.levels.values()]
        return {
            "over": sweep.over, "values": [float(x) for x in sweep.values],
            "step": self.formula(sweep.step, "step of the sweep"), "numbers": numbers, "fine": FINE,
            "steady": sweep.steady and vars(sweep.steady), "traces": traces,
            **self.picture(sweep.chart, [LiveRun()]),
        }  # fmt: skip


def _heading(meaning: str) -> str:
    """A meaning above a slider: without what is said of its default."""
    first = meaning.partition(", ")[0]
    return first[:1].upper() + first[1:]
