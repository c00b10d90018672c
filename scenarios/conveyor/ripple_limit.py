"""The limit of the torque ripple: at which speeds it is passed, and what a sweep says of it in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from workbench import Figure, Judgement
from workbench.judgement import Holds

from .response import Sought
from .speed_sweep import SpeedSweep


@dataclass(frozen=True)
class LimitCrossing:
    """A speed at which the torque ripple passes its limit: as the sweep says, and as a figure."""

    feature: Sought
    figure: Figure

    @property
    def is_upward(self) -> bool:
        """Whether the ripple is above its limit beyond it."""
        return self.feature.sense < 0.0

    @property
    def speed(self) -> float:
        """The speed as far as it is known [rad/s]."""
        return self.feature.x if self.figure.error is None else self.figure.value


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
            else all(is_above(self.limit, row) is Holds.YES for row in self.sweep.rows)
        )
        if starts_above:
            ends.insert(0, self.sweep.speeds[0])
        return list(zip(ends[::2], [*ends[1::2], self.sweep.speeds[-1]]))

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

    def judgements(self) -> list[Judgement]:
        """Return which speeds to avoid, and at how many speeds of the sweep the ripple is above its limit."""
        answers = [is_above(self.limit, row) for row in self.sweep.rows]
        counts = {
            "above its limit": answers.count(Holds.YES),
            "below its limit": answers.count(Holds.NO),
            "not determined": answers.count(Holds.OPEN),
        }
        rows = ", ".join(f"{text} at {count}" for text, count in counts.items() if count)
        total = f"{len(answers)} speed{'s' * (len(answers) > 1)} of the sweep"
        return [*self.avoided(), Judgement("torque ripple", note=f"{rows} of {total}")]

    def avoided(self) -> list[Judgement]:
        """Return the stretches between crossings with the digits that hold; beyond the sweep nothing is known."""
        ends: list[tuple[str, str]] = [
            (crossing.figure.brief(), "")
            if crossing.figure.error is not None
            else (f"about {float(f'{crossing.feature.x:.2g}'):g} rad/s", crossing.figure.reason)
            for crossing in self.crossings
        ]
        if ends and not self.crossings[0].is_upward:
            ends.insert(0, (f"the start of the sweep, {self.sweep.speeds[0]:g} rad/s,", ""))
        if len(ends) % 2:
            ends.append((f"the end of the sweep, {self.sweep.speeds[-1]:g} rad/s", ""))
        notes = []
        for (begin, why), (end, other) in zip(ends[::2], ends[1::2]):
            reason = why or other
            unsure = (
                f"; how far that is from the truth is not determined: {reason}" if reason else ""
            )
            notes.append(f"{begin} to {end}{unsure}")
        return [Judgement("avoid speeds", note=note) for note in notes]


def is_above(limit: float, row: Mapping[str, float]) -> Holds:
    """Whether the torque ripple of a row is above a limit [N.m]."""
    value, error = row["tau2"], row["tau2_error"]
    if value - error > limit:
        return Holds.YES
    return Holds.NO if value + error <= limit else Holds.OPEN
