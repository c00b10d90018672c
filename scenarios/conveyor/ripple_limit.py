"""The limit of the torque ripple: at which speeds it is passed, and what a sweep says of it in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from workbench import Figure, Judgement
from workbench.find import Found
from workbench.judgement import Holds

from .speed_sweep import SpeedSweep


@dataclass(frozen=True)
class RippleLimit:
    """A limit of the torque ripple [N.m], a sweep, and the speeds at which the ripple passes the limit."""

    limit: float
    sweep: SpeedSweep
    crossings: Sequence[Found]

    @property
    def stretches(self) -> list[tuple[float, float]]:
        """The stretches of the sweep in which the torque ripple is above its limit [rad/s]."""
        ends = [x.x if x.place.error is None else x.place.value for x in self.crossings]
        starts_above = (
            not self.crossings[0].rises
            if self.crossings
            else all(x is Holds.YES for x in self.answers)
        )
        if starts_above:
            ends.insert(0, self.sweep.speeds[0])
        return list(zip(ends[::2], [*ends[1::2], self.sweep.speeds[-1]]))

    @property
    def answers(self) -> list[Holds]:
        """Whether the torque ripple is above its limit, speed by speed."""
        ripple, error = (self.sweep.columns[x] for x in ("tau2", "tau2_error"))
        above, below = ripple - error > self.limit, ripple + error <= self.limit
        return [
            Holds.YES if a else Holds.NO if b else Holds.OPEN
            for a, b in zip(above.tolist(), below.tolist())
        ]

    @property
    def is_certain(self) -> bool:
        """Whether every end of a stretch has an error."""
        return all(crossing.place.error is not None for crossing in self.crossings)

    def figures(self) -> dict[str, Figure]:
        """Return the ends of the stretches to avoid, by number from the second stretch on."""
        figures = {}
        first = 1 if self.crossings and not self.crossings[0].rises else 0
        for k, crossing in enumerate(self.crossings, first):
            name = "avoid_from" if crossing.rises else "avoid_to"
            figures[f"{name}_{k // 2 + 1}" if k > 1 else name] = crossing.place
        return figures

    def judgements(self) -> list[Judgement]:
        """Return at how many speeds of the sweep the ripple is above its limit."""
        answers = self.answers
        counts = {
            "above its limit": answers.count(Holds.YES),
            "below its limit": answers.count(Holds.NO),
            "not determined": answers.count(Holds.OPEN),
        }
        rows = ", ".join(f"{text} at {count}" for text, count in counts.items() if count)
        total = f"{len(answers)} speed{'s' * (len(answers) > 1)} of the sweep"
        return [Judgement("torque ripple", note=f"{rows} of {total}")]
