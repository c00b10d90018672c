"""A table of masters on reference systems: how far each is off, with which order that falls, and why."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, ClassVar

from .describe import table
from .report_files import ReportFile, html_table, page, paragraphs, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Differences above so many ranges are called "grows": 10 ranges are no answer to any question.
GROWS = 10.0
NOT_RUN, NO_RESULT = "not run", "no result"
HEADINGS = ("Master", "System", "Step", "Off by", "Order", "Verdict", "Cause")
#: Dots per inch of a picture: a convention of screens.
RESOLUTION = 110


@dataclass(frozen=True)
class Standing:
    """A master on a system.

    Attributes
    ----------
    master, system : str
        Who, and on what.
    steps, differences : tuple of float
        Communication steps [s], the longest first, and the largest difference with each in ranges of the signal.
    calls : float
        How often a part is stepped in a communication step; 0 where parts are integrated, nan where it is not stated.
    order : float
        With which power of the step the difference falls; nan where that cannot be told.
    verdict, cause : str
        Of the shortest step.
    reason : str
        Why there is no result; "" if there is one.
    """

    master: str
    system: str
    steps: tuple[float, ...] = ()
    differences: tuple[float, ...] = ()
    calls: float = math.nan
    order: float = math.nan
    verdict: str = NOT_RUN
    cause: str = ""
    reason: str = ""

    def cells(self) -> tuple[str, ...]:
        """The row of the table."""
        if not self.steps:
            return self.master, self.system, "", "", "", self.verdict, self.reason
        order = f"{self.order:.1f}" if math.isfinite(self.order) else ""
        step, off = f"{1e3 * self.steps[-1]:g} ms", _share(self.differences[-1])
        return self.master, self.system, step, off, order, self.verdict, self.cause


@dataclass(frozen=True)
class Scoreboard(ReportFile):
    """What `scoreboard` found; `notes` are files that are no results, a line for each."""

    standings: tuple[Standing, ...]
    notes: tuple[str, ...] = ()

    FORMATS: ClassVar = {
        ".txt": "text", ".json": "to_json", ".html": "html", ".png": "plot", ".svg": "plot", ".pdf": "plot",
    }  # fmt: skip

    @property
    def systems(self) -> list[str]:
        """The systems that somebody entered."""
        entered = (s.system for s in self.standings if s.verdict not in (NOT_RUN, NO_RESULT))
        return list(dict.fromkeys(entered))

    def best(self, system: str) -> list[tuple[float, Standing, float]]:
        """For each number of steps of a part in a second: that number, who comes closest with no more, and how close.

        Who integrates parts, or does not say how often it steps them, has no such number.
        """
        points = [
            (s.calls / step, difference, s)
            for s in self.standings
            if s.system == system and s.calls > 0.0
            for step, difference in zip(s.steps, s.differences)
            if difference < GROWS
        ]
        front: list[tuple[float, Standing, float]] = []
        for cost, difference, standing in sorted(points, key=lambda point: point[:2]):
            if not front or difference < front[-1][2]:
                front = [point for point in front if point[0] < cost]
                front.append((cost, standing, difference))
        return front

    def text(self) -> str:
        """A line for each master and system, the best by cost, and what is no result."""
        lines = list(table([HEADINGS, *(s.cells() for s in self.standings)]))
        return "\n".join([*lines, "", *self._best_lines(), *self.notes])

    def _best_lines(self) -> Iterator[str]:
        for system in self.systems:
            found = [f"{cost:g}/s {s.master} ({_share(off)})" for cost, s, off in self.best(system)]
            if found:
                yield f"closest on {system} by steps of a part in a second: {', '.join(found)}"

    def to_json(self) -> dict[str, Any]:
        """The scoreboard for programs; a number that is none or infinite is null."""
        best = {
            system: [
                {"steps_of_a_part": cost, "master": s.master, "difference": difference}
                for cost, s, difference in self.best(system)
            ]
            for system in self.systems
        }
        standings = [asdict(s) for s in self.standings]
        return {"standings": standings, "best": best, "notes": list(self.notes)}

    def html(self) -> str:
        """A page that needs nothing else."""
        rows = [
            (*s.cells(), ", ".join(f"{1e3 * h:g} ms: {_share(d)}" for h, d in zip(s.steps, s.differences)))
            for s in self.standings
        ]  # fmt: skip
        about = "The largest difference from the exact answer of any signal at any row, as a share of the signal's range."
        return page(
            "Scoreboard",
            paragraphs([about]),
            html_table([(*HEADINGS, "All steps"), *rows]),
            paragraphs([*self._best_lines(), *self.notes]),
            picture(self.plot(), "difference over step, a panel for each system", RESOLUTION),
        )

    def plot(self, path: Path | str | IO[bytes] | None = None) -> Figure:
        """Plot difference over step, a panel for each system; `path` also writes the picture."""
        from .picture import Picture

        masters = list(dict.fromkeys(s.master for s in self.standings if s.steps))
        columns = max(1, min(3, len(self.systems)))
        rows = max(1, math.ceil(len(self.systems) / columns))
        figure = Picture(figsize=(5.0 * columns, 4.0 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, system in zip(axes, self.systems):
            for s in self.standings:
                if s.system == system and s.steps:
                    k = masters.index(s.master)
                    shown = [d if 0.0 < d < GROWS else math.nan for d in s.differences]
                    style = f"{'os^vD'[k // 10 % 5]}{('-', '--', ':')[k // 10 % 3]}"
                    axis.loglog(
                        s.steps, shown, style, color=f"C{k % 10}", markersize=3, label=s.master
                    )
            axis.set(
                title=system, xlabel="communication step / s", ylabel="largest difference / range"
            )
            axis.grid(alpha=0.3)
        for axis in axes[len(self.systems) :]:
            axis.axis("off")
        lines = {line.get_label(): line for axis in axes for line in axis.get_lines()}
        if lines:
            figure.legend(
                lines.values(), lines.keys(), loc="outside lower center", ncols=3, fontsize="small"
            )
        if path is not None:
            figure.savefig(path, dpi=RESOLUTION)
        return figure


def _share(difference: float) -> str:
    if not math.isfinite(difference):
        return "no number"
    return f"{100.0 * difference:.2g} %" if difference < GROWS else "grows"
