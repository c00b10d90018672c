"""The referee's report: a sentence, a table, a picture, a page, JSON, and JUnit's XML for a test server."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, ClassVar

from ...describe import table
from ...errors import pluralize
from ...report_files import (
    AMBER,
    GREEN,
    RED,
    ReportFile,
    html_table,
    junit,
    page,
    paragraphs,
    picture,
)
from ...rounding import unit_suffix
from .causes import Cause
from .signals import SignalJudgement, Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Panels of a picture: a convention, what fits a page.
MOST_PANELS = 8
#: Dots per inch of a picture: a convention of printers, halved.
RESOLUTION = 150
#: A reduction of a difference from which on its size does not matter to a reader: a convention.
WORTH_STATING = 1e6
NO_CAUSE = "cause not found"
COLORS = {Verdict.AGREES: GREEN, Verdict.DIFFERS: RED, Verdict.UNDECIDED: AMBER}
SIGNAL_HEADING = ("Signal", "Column", "Verdict", "Off by", "Allowed", "From")
FIGURE_HEADING = ("Signal", "Figure", "Result", "Reference", "Off by")


@dataclass(frozen=True)
class RefereeReport(ReportFile):
    """The judgement of a result that another master wrote.

    Attributes
    ----------
    source : str
        What was judged.
    verdict : Verdict
        Of the whole: "differs" if a signal does, else "cannot be told" if that is so of one.
    signals : tuple of SignalJudgement
        Each column that was compared.
    causes : tuple of Cause
        What reproduces the differences, the best first; none if nothing does.
    method : str
        How the reference solution was computed.
    tolerance : float
        The difference that is allowed, as a share of the range of each signal.
    notes : tuple of str
        What was left out.
    """

    source: str
    verdict: Verdict
    signals: tuple[SignalJudgement, ...]
    causes: tuple[Cause, ...]
    method: str
    tolerance: float
    notes: tuple[str, ...] = ()

    FORMATS: ClassVar = {
        ".txt": "text", ".json": "to_json", ".xml": "junit", ".html": "html", ".png": "plot",
        ".svg": "plot", ".pdf": "plot",
    }  # fmt: skip

    def __getitem__(self, name: str) -> SignalJudgement:
        """The judgement of a variable by its dotted name; raises KeyError for one that was not judged."""
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise KeyError(f"{name} was not judged, only {', '.join(s.name for s in self.signals)}")

    @property
    def exit_status(self) -> int:
        """0 if the result agrees, 1 if it differs, 2 if that cannot be told."""
        return list(Verdict).index(self.verdict)

    def explained(self, name: str) -> Cause | None:
        """The best cause for a signal by its dotted name, None if there is none."""
        return next((cause for cause in self.causes if name in cause.signals), None)

    def _named(self, verdict: Verdict) -> str:
        """The signals with a verdict."""
        return ", ".join(s.name for s in self.signals if s.verdict is verdict)

    def sentence(self) -> str:
        """The verdict in a sentence."""
        vague, many = self._named(Verdict.UNDECIDED), pluralize(len(self.signals), "signal")
        inexact = f"the reference is not exact enough for {vague}"
        if self.verdict is Verdict.UNDECIDED:
            reason = inexact if vague else self.method
            return f"It cannot be told whether {self.source} is right: {reason}."
        if self.verdict is Verdict.AGREES:
            allowed = f"within {self.tolerance:.3g} of its range"
            return f"{self.source} agrees with the reference solution: {many}, each {allowed} and the error of the reference."
        times = next((cause.text for cause in self.causes if cause.kind == "time unit"), "")
        differs = f"{self.source} differs from the reference solution in"
        differing = [signal for signal in self.signals if signal.verdict is Verdict.DIFFERS]
        if not differing:
            others = f"none differs, but {inexact}" if vague else f"{many} would agree"
            return f"{differs} its times: {times}; with times in s, {others}."
        worst = max(differing, key=_severity)
        because = _because(self.explained(worst.name))
        return (
            f"{differs} {len(differing)} of {many}: {worst.name} {_distance(worst)} at {worst.time:.4g} s; "
            f"{because}{f'; and {times}' if times else ''}."
        )

    def _signal_rows(self) -> Iterator[tuple[str, ...]]:
        for s in self.signals:
            allowed, since = _quantity(s.allowed, s.unit), _since(s)
            yield s.name, s.column, str(s.verdict), _deviation(s), allowed, since

    def _figure_rows(self, *, all_of_them: bool) -> Iterator[tuple[str, ...]]:
        for s in self.signals:
            for f in s.figures:
                if all_of_them or abs(f.deviation) > s.allowed + f.error:
                    reference, off = (
                        f"{x:.6g} +- {f.error:.1g}{unit_suffix(s.unit)}"
                        for x in (f.reference, f.deviation)
                    )
                    yield s.name, f.name, _quantity(f.value, s.unit), reference, off

    def _cause_lines(self) -> Iterator[str]:
        for c in self.causes:
            name = "cause" if c.is_certain else "not certain"
            explained = (
                f" (the difference of {', '.join(c.signals)} is {_times_smaller(c)} with it)"
            )
            yield f"{name}: {c.text}{explained if c.signals else ''}"

    def text(self) -> str:
        """The verdict, how it was reached, and a line for each signal and each figure that is off."""
        signals = [
            (name, column if column != name else "", verdict, off, f"allowed {allowed}", since)
            for name, column, verdict, off, allowed, since in self._signal_rows()
        ]
        figures = [
            (f"{name} {figure}", value, f"reference {reference}", f"off by {off}")
            for name, figure, value, reference, off in self._figure_rows(all_of_them=False)
        ]
        tables = [*table(signals), *table(figures)]
        return "\n".join(
            [self.sentence(), self._method(), *tables, *self._cause_lines(), *self.notes]
        )

    def _method(self) -> str:
        return f"reference: {self.method}; tolerance {self.tolerance:g} of the range of a signal"

    def to_json(self) -> dict[str, Any]:
        """The report for programs."""
        return {
            "source": self.source,
            "verdict": str(self.verdict),
            "sentence": self.sentence(),
            "method": self.method,
            "tolerance": self.tolerance,
            "signals": [
                {f.name: getattr(s, f.name) for f in fields(s) if f.repr}
                | {"figures": [asdict(f) | {"deviation": f.deviation} for f in s.figures]}
                for s in self.signals
            ],
            "causes": [asdict(cause) for cause in self.causes],
            "notes": list(self.notes),
        }

    def junit(self) -> str:
        """JUnit's XML: a test for each signal, and one for the times where they are in another unit.

        A signal of which nothing can be told is skipped.
        """
        cases = [("time", "failure", c.text, c.text) for c in self.causes if c.kind == "time unit"]
        for s in self.signals:
            message, text = f"{_distance(s)} {_since(s)}", _because(self.explained(s.name))
            cases.append({
                Verdict.AGREES: (s.name, "", "", ""),
                Verdict.DIFFERS: (s.name, "failure", message, text),
                Verdict.UNDECIDED: (s.name, "skipped", "the reference is not exact enough", ""),
            }[s.verdict])  # fmt: skip
        return junit(f"referee of {Path(self.source).name}", self.source, cases)

    def html(self) -> str:
        """A page that needs nothing else."""
        return page(
            f"Is {Path(self.source).name} right?",
            paragraphs([self.sentence()], COLORS[self.verdict]),
            paragraphs([*self._cause_lines(), self._method()]),
            html_table([SIGNAL_HEADING, *self._signal_rows()]),
            html_table([FIGURE_HEADING, *self._figure_rows(all_of_them=True)]),
            picture(self.plot(), "the signals and the reference", RESOLUTION),
            paragraphs(self.notes),
        )

    def plot(self, path: Path | str | IO[bytes] | None = None) -> Figure:
        """Plot the signals beside the reference, the worst first; `path` also writes the picture."""
        from ...picture import panels

        signals = sorted(self.signals, key=_severity, reverse=True)[:MOST_PANELS]
        return panels([(s.unit, partial(_draw, s)) for s in signals], path)


def _draw(s: SignalJudgement, axis: Axes) -> None:
    """A signal in a panel, with the reference and what is allowed around it."""
    low, high = (s.reference + sign * (s.allowed + s.errors) for sign in (-1.0, 1.0))
    axis.fill_between(s.t, low, high, color="0.85", linewidth=0, label="allowed")
    axis.plot(s.t, s.reference, color="0.4", linewidth=1, label="reference")
    axis.plot(s.t, s.values, color=COLORS[s.verdict], linewidth=1, label=s.name)
    if math.isfinite(s.since):
        axis.axvline(s.since, color="0.4", linewidth=0.5, linestyle="--")


def _because(cause: Cause | None) -> str:
    """A cause as the rest of a sentence."""
    if cause is None:
        return NO_CAUSE
    return f"probable cause: {cause.text}" if cause.is_certain else f"{NO_CAUSE}; {cause.text}"


def _severity(signal: SignalJudgement) -> float:
    """The largest difference as a share of the range."""
    return signal.deviation / signal.scale


def _quantity(value: float, unit: str) -> str:
    return f"{value:.6g}{unit_suffix(unit)}"


def _distance(signal: SignalJudgement) -> str:
    """How far a signal is off, as the rest of a sentence."""
    if not math.isfinite(signal.deviation):
        return "has no finite value"
    return f"is off by up to {_deviation(signal)}"


def _deviation(signal: SignalJudgement) -> str:
    if not math.isfinite(signal.deviation):
        return "no finite value"
    return f"{signal.deviation:.4g} +- {signal.error:.1g}{unit_suffix(signal.unit)}"


def _times_smaller(cause: Cause) -> str:
    if cause.reduction >= WORTH_STATING:
        return f"more than {WORTH_STATING:.0e} times smaller"
    return f"{cause.reduction:.3g} times smaller"


def _since(signal: SignalJudgement) -> str:
    if math.isfinite(signal.since):
        return f"from {signal.since:.4g} s on"
    return f"{pluralize(signal.rows_beyond, 'single row')} beyond" if signal.rows_beyond else ""
