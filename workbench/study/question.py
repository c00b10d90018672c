"""Questions that are answered by plans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..answer import Findings, Show
from ..context import Context
from ..figure import Figure
from ..judgement import Judgement
from ..options import Option
from ..plan import Measured, Plan, measure
from ..question import Question
from . import charts


class PlanQuestion(Question):
    """A question that follows from others, which it asks by plans.

    It defines `plans`. Without `conclude` its figures are what is found and the largest value of every figure that has a
    limit, and it is judged whether these keep their limits.
    """

    def plans(self, context: Context) -> Mapping[str, Plan]:
        """Return its plans, by the files of their tables; raises SetupError for options that cannot give an answer."""
        raise NotImplementedError

    def conclude(self, context: Context, measured: Mapping[str, Measured]) -> Findings:
        """Return what follows from the answers to its plans."""
        figures: dict[str, Figure] = {}
        for x in measured.values():
            for name, found in x.found.items():
                lines = x.plan.lines(x.plan.find[name].over)
                places = [
                    (y, line)
                    for line, of_line in zip(lines, found)
                    for one in of_line
                    for y in (one.place, one.height)
                    if y
                ]
                for k, (y, line) in enumerate(places, 1):
                    at = [f"{y.meaning}", *(f"{key} = {value}" for key, value in line.items())]
                    figures[f"{name}_{k}" if k > 1 else name] = y._replace(meaning=", ".join(at))
            figures |= {f"{name}_largest": x.largest(name) for name in x.plan.limits}
        warnings = [
            f"{csv}: {len(lost)} of {len(x.table)} rows have no answer; the first: {lost[0]}"
            for csv, x in measured.items()
            if (lost := [*filter(None, x.motions.problems)])
        ]
        first = next(iter(measured.values())).motions.asked[0]
        return Findings(
            figures,
            measured,
            first.system(context.fmus),
            tables={name: x.table for name, x in measured.items()},
            warnings=warnings,
        )

    def judgements(self, f: Mapping[str, Figure], r: Any) -> Sequence[Judgement]:
        """Return whether all rows keep the limits."""
        limits = {name: x for of_plan in r.values() for name, x in of_plan.plan.limits.items()}
        return [
            Judgement(
                f"{name} keeps its limit in all rows",
                (largest := f[f"{name}_largest"]),
                most=Option(name, float, unit=largest.unit).read(limit, f"limits: {name}"),
            )
            for name, limit in limits.items()
        ]

    def show(self, _figures: Mapping[str, Figure], r: Any) -> Show:
        """Return the tables over what varies."""
        pictures = []
        for x in r.values():
            inputs = {name: key for key, name in x.plan.names.items()}
            frame = x.table.frame.rename(columns=inputs)
            units = {inputs.get(name, name): unit for name, unit in x.table.units.items()}
            figures = [y for y in frame if y not in x.plan.varied and not y.endswith(charts.ERROR)]
            pictures += charts.overview(x.plan, frame, figures, units)
        return Show(pictures)

    def solve(self, context: Context) -> Findings:
        """Ask what its plans say, and conclude."""
        return self.conclude(context, measure(context, self.plans(context)))
