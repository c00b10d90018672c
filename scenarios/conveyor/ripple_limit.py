"""The limit of the torque ripple: at which speeds it is passed, and what a sweep says of it in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from workbench import Figure
from workbench.figure import listed

from .features import Feature, Kind
from .rows import SpeedSweep

UNDETERMINED = "not determined"


@dataclass(frozen=True)
class LimitCrossing:
    """A speed at which the torque ripple passes its limit: as the sweep says, and as a figure."""

    feature: Feature
    figure: Figure

    @property
    def is_upward(self) -> bool:
        """Whether the ripple is above its limit beyond it."""
        return self.feature.kind is Kind.RISE

    @property
    def speed(self) -> float:
        """The speed as far as it is known [rad/s]."""
        return self.feature.near if self.figure.error is None else self.figure.value


@dataclass(frozen=True)
class RippleLimit:
    """A limit of the torque ripple [N.m], a sweep, and the speeds at which the ripple passes the limit."""

    limit: float
    sweep: SpeedSweep
    crossings: Sequence[LimitCrossing]

    @property
    def stretches(self) -> list[tuple[float, float]]:
        """The stretches of the sweep in which the torque ripple is above its limit [rad/s]."""
        ends = [crossing.speed for crossing in self.crossings]
        starts_above = (
            not self.crossings[0].is_upward
            if self.crossings
            else all(above_limit(self.limit, row) == "yes" for row in self.sweep.rows)
        )
        if starts_above:
            ends.insert(0, self.sweep.line.first)
        return list(zip(ends[::2], [*ends[1::2], self.sweep.line.last]))

    @property
    def is_certain(self) -> bool:
        """Whether every end of a stretch has an error."""
        return all(crossing.figure.error is not None for crossing in self.crossings)

    def figures(self) -> dict[str, Figure]:
        """Return the ends of the stretches to avoid, by number from the second stretch on."""
        figures = {}
        first = 1 if self.crossings and not self.crossings[0].is_upward else 0
        for k, crossing in enumerate(self.crossings, first):
            name = "avoid_from" if crossing.is_upward else "avoid_to"
            figures[f"{name}_{k // 2 + 1}" if k > 1 else name] = crossing.figure
        return figures

    def sentences(self, left_out: Sequence[str] = ()) -> list[str]:
        """Say which speeds to avoid, what the sweep leaves out, and at how many speeds nothing is known.

        Parameters
        ----------
        left_out : sequence of str
            What a reader asks for and the sweep does not have, such as the resonance. A ripple below its limit
            everywhere else is then no answer, and is not told.
        """
        if self.crossings:
            lines = [self.about_crossings()]
        else:
            lines = self.about_rows(is_complete=not left_out)
        return [*lines, *self.about_left_out(left_out), *self.about_unknown()]

    def about_unknown(self) -> list[str]:
        """Say at how many speeds there is no answer, for each reason, but for those at which the motor stalls."""
        total, lost = len(self.sweep.speeds), len(self.sweep.unsteady)
        answers = [above_limit(self.limit, row) for row in self.sweep.rows]
        open_rows = [
            row
            for row, answer in zip(self.sweep.rows, answers)
            if answer == UNDETERMINED and not math.isnan(row["tau2"])
        ]
        unknown = sum(math.isnan(row["tau2_error"]) for row in open_rows)
        counts = {
            f"No steady orbit is found at {lost}": lost,
            f"The error of the torque ripple is not known at {unknown}": unknown,
            f"The limit lies within the error at {len(open_rows) - unknown}": len(open_rows)
            - unknown,
        }
        return [f"{text} of the {total} speeds." for text, count in counts.items() if count]

    def about_left_out(self, left_out: Sequence[str]) -> list[str]:
        """Say what the sweep does not have, in at most one sentence."""
        first, last = self.sweep.line.first, self.sweep.line.last
        extent = f"The sweep from {first:g} to {last:g} rad/s"
        if len(self.sweep.speeds) == 1:
            extent = f"The sweep, which has the only speed {first:g} rad/s,"
        return [f"{extent} leaves out {listed(left_out)}."] if left_out else []

    def about_crossings(self) -> str:
        """Say which speeds to avoid, with the digits that hold."""
        ends = (crossing.figure for crossing in self.crossings)
        reasons = [figure.reason for figure in ends if figure.error is None]
        if not reasons:
            return f"Avoid speeds {self.avoided()}, where the torque ripple is above the limit."
        steps = f"With {self.sweep.runner.steps_per_rev} steps per revolution"
        where = f"{steps} the torque ripple is above the limit {self.avoided()}"
        return f"{where}. How far that is from the truth is not determined: {reasons[0]}."

    def about_rows(self, *, is_complete: bool) -> list[str]:
        """Say whether the ripple is above its limit where it is known, in at most one sentence.

        From one speed, and from a sweep that is not complete, no all-clear follows.
        """
        total = len(self.sweep.speeds)
        steady = sum(not math.isnan(row["tau2"]) for row in self.sweep.rows)
        answers = [above_limit(self.limit, row) for row in self.sweep.rows]
        above, decided = answers.count("yes"), len(answers) - answers.count(UNDETERMINED)
        if not decided or (not above and decided == total and not (is_complete and total > 1)):
            return []
        if 0 < above < decided:
            return [f"The torque ripple is above the limit at {above} of {total} speeds."]
        at = f"each of the {decided} of {total} speeds at which it is determined"
        if total == 1:
            at = f"{self.sweep.speeds[0]:g} rad/s, the only speed of the sweep"
        elif decided == total:
            at = "every speed of the sweep"
        elif decided == 1:
            at = f"the only one of {total} speeds at which it is determined"
        elif decided == steady:
            at = f"each of the {steady} of {total} speeds that have a steady orbit"
        return [f"The torque ripple {'is above' if above else 'stays below'} the limit at {at}."]

    def avoided(self) -> str:
        """The stretches between crossings in words, with the digits that hold; beyond the sweep nothing is known."""
        parts, last = [], len(self.crossings) - 1
        for k, crossing in enumerate(self.crossings):
            about = f"about {float(f'{crossing.feature.near:.2g}'):g} rad/s"
            where = about if crossing.figure.error is None else crossing.figure.brief()
            if crossing.is_upward:
                parts.append(f"from {where}")
                if k == last:
                    parts.append(f"to the end of the sweep, {self.sweep.line.last:g} rad/s")
            else:
                begin = f"from the start of the sweep, {self.sweep.line.first:g} rad/s, "
                parts.append(f"{begin if k == 0 else ''}to {where}{' and' if k < last else ''}")
        return " ".join(parts)


def above_limit(limit: float, row: Mapping[str, float]) -> str:
    """Say whether the torque ripple of a row is above a limit [N.m]: yes, no, or not determined."""
    value, error = row["tau2"], row["tau2_error"]
    if value - error > limit:
        return "yes"
    return "no" if value + error <= limit else UNDETERMINED
