"""The referee's report: a sentence, a table, a picture, a page, JSON, and JUnit's XML for a test server."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any
from xml.etree import ElementTree

from ...describe import table
from ...errors import SetupError, pluralize
from ...files import replacement
from ...json_values import without_infinities
from .causes import Cause
from .signals import SignalJudgement, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Panels of a picture: a convention, what fits a page.
MOST_PANELS = 8
#: Width of a picture [inch]: a convention, that of all pictures of results.
WIDTH = 9.0
#: Height of what is around its panels [inch]: a convention.
FRAME_HEIGHT = 1.0
#: Height of a panel [inch]: a convention.
PANEL_HEIGHT = 2.2
#: Dots per inch of a picture: a convention of printers, halved.
RESOLUTION = 150
#: A reduction of a difference from which on its size does not matter to a reader: a convention.
WORTH_STATING = 1e6
NO_CAUSE = "cause not found"
COLORS = {Verdict.AGREES: "#1a7f37", Verdict.DIFFERS: "#cf222e", Verdict.UNDECIDED: "#9a6700"}
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.4 sans-serif; max-width: 64em; margin: 2em auto; padding: 0 1em; color: #1f2328 }}
table {{ border-collapse: collapse; width: 100%; margin: 1em 0 }}
td, th {{ text-align: left; vertical-align: top; padding: .35em .8em .35em 0; border-bottom: 1px solid #d0d7de }}
img {{ max-width: 100% }}
</style></head><body><h1>{title}</h1><p style="color:{color}"><b>{sentence}</b></p>
{causes}<p>{method}</p>
<table><tr><th>Signal</th><th>Column</th><th>Verdict</th><th>Off by</th><th>Allowed</th><th>From</th></tr>
{signals}
</table>
<table><tr><th>Signal</th><th>Figure</th><th>Result</th><th>Reference</th><th>Off by</th></tr>
{figures}
</table>
<img alt="the signals and the reference" src="data:image/png;base64,{picture}">
{notes}</body></html>
"""


@dataclass(frozen=True)
class RefereeReport:
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

    def __getitem__(self, name: str) -> SignalJudgement:
        """The judgement of the variable of this name.

        Raises
        ------
        KeyError
            For a variable that was not judged.
        """
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise KeyError(f"{name} was not judged, only {', '.join(s.name for s in self.signals)}")

    @property
    def exit_status(self) -> int:
        """0 if the result agrees, 1 if it differs, 2 if that cannot be told."""
        return {Verdict.AGREES: 0, Verdict.DIFFERS: 1, Verdict.UNDECIDED: 2}[self.verdict]

    def explained(self, name: str) -> Cause | None:
        """The best cause for a signal, None if there is none.

        Parameters
        ----------
        name : str
            The dotted name of a signal.
        """
        return next((cause for cause in self.causes if name in cause.signals), None)

    def sentence(self) -> str:
        """The verdict in a sentence."""
        differing = [signal for signal in self.signals if signal.verdict is Verdict.DIFFERS]
        if self.verdict is Verdict.UNDECIDED:
            vague = ", ".join(s.name for s in self.signals if s.verdict is Verdict.UNDECIDED)
            reason = f"the reference is not exact enough for {vague}" if vague else self.method
            return f"It cannot be told whether {self.source} is right: {reason}."
        times = next((cause for cause in self.causes if cause.kind == "time unit"), None)
        if not differing:
            allowed = f"within {self.tolerance:.3g} of its range"
            many = pluralize(len(self.signals), "signal")
            if times is not None:
                return f"{self.source} differs from the reference solution in its times: {times.text}; {self._in_seconds()}."
            return f"{self.source} agrees with the reference solution: {many}, each {allowed} and the error of the reference."
        worst = max(differing, key=_severity)
        first = (
            f"{self.source} differs from the reference solution in {len(differing)} of "
            f"{pluralize(len(self.signals), 'signal')}: {worst.name} {_distance(worst)} at {worst.time:.4g} s"
        )
        second = f"; and {times.text}" if times is not None else ""
        return f"{first}; {_because(self.explained(worst.name))}{second}."

    def _in_seconds(self) -> str:
        """What is said of the signals once their times are in s, where none differs."""
        vague = [s.name for s in self.signals if s.verdict is Verdict.UNDECIDED]
        if vague:
            return f"with times in s, none differs, but the reference is not exact enough for {', '.join(vague)}"
        return f"with times in s, {pluralize(len(self.signals), 'signal')} would agree"

    def text(self) -> str:
        """The verdict, how it was reached, and a line for each signal and each figure that is off."""
        rows = [
            (s.name, s.column if s.column != s.name else "", str(s.verdict), _deviation(s),
             f"allowed {_quantity(s.allowed, s.unit)}", _since(s))
            for s in self.signals
        ]  # fmt: skip
        figures = [
            (f"{s.name} {f.name}", _quantity(f.value, s.unit), f"reference {_with_error(f.reference, f.error, s.unit)}",
             f"off by {_with_error(f.deviation, f.error, s.unit)}")
            for s in self.signals for f in s.figures if abs(f.deviation) > s.allowed + f.error
        ]  # fmt: skip
        causes = [
            f"{'cause' if c.is_certain else 'not certain'}: {c.text} (the difference of {', '.join(c.signals)} is {_smaller(c)} with it)"
            if c.signals
            else f"cause: {c.text}"
            for c in self.causes
        ]
        method = f"reference: {self.method}; tolerance {self.tolerance:g} of the range of a signal"
        return "\n".join(
            [self.sentence(), method, *table(rows), *table(figures), *causes, *self.notes]
        )

    def to_json(self) -> dict[str, Any]:
        """The report for programs."""
        return {
            "source": self.source,
            "verdict": str(self.verdict),
            "sentence": self.sentence(),
            "method": self.method,
            "tolerance": self.tolerance,
            "signals": [_signal_json(signal) for signal in self.signals],
            "causes": [
                {
                    "kind": c.kind,
                    "text": c.text,
                    "is_certain": c.is_certain,
                    "reduction": c.reduction,
                    "signals": list(c.signals),
                }
                for c in self.causes
            ],
            "notes": list(self.notes),
        }

    def junit(self) -> str:
        """JUnit's XML: a test for each signal, and one for the times where they are in another unit.

        A signal of which nothing can be told is skipped.
        """
        counts = {v: sum(s.verdict is v for s in self.signals) for v in Verdict}
        times = [cause for cause in self.causes if cause.kind == "time unit"]
        suite = ElementTree.Element(
            "testsuite", name=f"referee of {Path(self.source).name}", tests=str(len(self.signals) + len(times)),
            failures=str(counts[Verdict.DIFFERS] + len(times)), errors="0", skipped=str(counts[Verdict.UNDECIDED]),
        )  # fmt: skip
        for unit in times:
            case = ElementTree.SubElement(suite, "testcase", classname=self.source, name="time")
            ElementTree.SubElement(case, "failure", message=unit.text).text = unit.text
        for signal in self.signals:
            case = ElementTree.SubElement(
                suite, "testcase", classname=self.source, name=signal.name
            )
            if signal.verdict is Verdict.DIFFERS:
                cause = self.explained(signal.name)
                failure = ElementTree.SubElement(
                    case, "failure", message=f"{_distance(signal)} {_since(signal)}"
                )
                failure.text = _because(cause)
            elif signal.verdict is Verdict.UNDECIDED:
                ElementTree.SubElement(case, "skipped", message="the reference is not exact enough")
        ElementTree.indent(suite)
        return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"

    def html(self) -> str:
        """A page that needs nothing else."""
        signals = "\n".join(
            _row(
                s.name,
                s.column,
                str(s.verdict),
                _deviation(s),
                _quantity(s.allowed, s.unit),
                _since(s),
            )
            for s in self.signals
        )
        figures = "\n".join(
            _row(
                s.name,
                f.name,
                _quantity(f.value, s.unit),
                _with_error(f.reference, f.error, s.unit),
                _with_error(f.deviation, f.error, s.unit),
            )
            for s in self.signals
            for f in s.figures
        )
        image = BytesIO()
        self.plot(image)
        causes = [
            f"{'Probable' if c.is_certain else 'No certain'} cause for {', '.join(c.signals)}: {c.text}. With it, the difference is {_smaller(c)}."
            if c.signals
            else f"Cause: {c.text}."
            for c in self.causes
        ]
        return PAGE.format(
            title=html.escape(f"Is {Path(self.source).name} right?"), color=COLORS[self.verdict],
            sentence=html.escape(self.sentence()), causes="".join(map(_paragraph, causes)),
            method=html.escape(f"Reference: {self.method}. Tolerance: {self.tolerance:g} of the range of a signal."),
            signals=signals, figures=figures, picture=base64.b64encode(image.getvalue()).decode(),
            notes="".join(map(_paragraph, self.notes)),
        )  # fmt: skip

    def plot(self, path: Path | str | IO[bytes] | None = None) -> Figure:
        """Plot the signals beside the reference, the worst first; `path` also writes the picture."""
        from ...picture import Picture

        signals = sorted(self.signals, key=_severity, reverse=True)[:MOST_PANELS]
        size = (WIDTH, FRAME_HEIGHT + PANEL_HEIGHT * max(1, len(signals)))
        figure = Picture(figsize=size, layout="constrained")
        axes = figure.subplots(max(1, len(signals)), sharex=True, squeeze=False)[:, 0]
        for axis, s in zip(axes, signals):
            band = s.allowed + s.errors
            axis.fill_between(
                s.t,
                s.reference - band,
                s.reference + band,
                color="0.85",
                linewidth=0,
                label="allowed",
            )
            axis.plot(s.t, s.reference, color="0.4", linewidth=1, label="reference")
            axis.plot(s.t, s.values, color=COLORS[s.verdict], linewidth=1, label=s.name)
            if math.isfinite(s.since):
                axis.axvline(s.since, color="0.4", linewidth=0.5, linestyle="--")
            axis.set_ylabel(s.unit or "1")
            axis.grid(alpha=0.3)
            axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
        axes[-1].set_xlabel("time / s")
        if path is not None:
            figure.savefig(path, dpi=RESOLUTION)
        return figure

    def write(self, path: Path | str) -> None:
        """Write a .txt, .json, JUnit's .xml, a page .html, or a picture .png, .svg or .pdf.

        Raises SetupError for another suffix.

        Parameters
        ----------
        path : path
            The file, whose suffix decides the format.
        """
        path = Path(path)
        write = writer(path)
        with replacement(path) as fresh:
            write(self, fresh)


def writer(path: Path) -> Callable[[RefereeReport, Path], object]:
    """What writes a file of this suffix; raises SetupError for one that is not known."""
    if path.suffix not in WRITERS:
        raise SetupError(f"{path} must end in one of {', '.join(WRITERS)}")
    return WRITERS[path.suffix]


WRITERS: dict[str, Callable[[RefereeReport, Path], object]] = {
    ".txt": lambda report, path: path.write_text(report.text() + "\n", encoding="utf-8"),
    ".json": lambda report, path: path.write_text(
        json.dumps(without_infinities(report.to_json()), indent=2) + "\n", encoding="utf-8"
    ),
    ".xml": lambda report, path: path.write_text(report.junit(), encoding="utf-8"),
    ".html": lambda report, path: path.write_text(report.html(), encoding="utf-8"),
    ".png": lambda report, path: report.plot(path),
    ".svg": lambda report, path: report.plot(path),
    ".pdf": lambda report, path: report.plot(path),
}


def _signal_json(signal: SignalJudgement) -> dict[str, Any]:
    return {
        "name": signal.name, "column": signal.column, "unit": signal.unit,
        "verdict": str(signal.verdict), "deviation": signal.deviation, "error": signal.error, "time": signal.time,
        "allowed": signal.allowed, "since": signal.since, "rows_beyond": signal.rows_beyond,
        "figures": [
            {"name": f.name, "value": f.value, "reference": f.reference, "error": f.error, "deviation": f.deviation}
            for f in signal.figures
        ],
    }  # fmt: skip


def _because(cause: Cause | None) -> str:
    """A cause as the rest of a sentence."""
    if cause is None:
        return NO_CAUSE
    return f"probable cause: {cause.text}" if cause.is_certain else f"{NO_CAUSE}; {cause.text}"


def _severity(signal: SignalJudgement) -> float:
    """The largest difference as a share of the range."""
    return signal.deviation / signal.scale


def _quantity(value: float, unit: str) -> str:
    return f"{value:.6g} {unit}".rstrip() if unit != "1" else f"{value:.6g}"


def _with_error(value: float, error: float, unit: str) -> str:
    return f"{value:.6g} +- {error:.1g} {unit}".rstrip()


def _distance(signal: SignalJudgement) -> str:
    """How far a signal is off, as the rest of a sentence."""
    if not math.isfinite(signal.deviation):
        return "has no finite value"
    return f"is off by up to {_deviation(signal)}"


def _deviation(signal: SignalJudgement) -> str:
    if not math.isfinite(signal.deviation):
        return "no finite value"
    return f"{signal.deviation:.4g} +- {signal.error:.1g} {signal.unit}".rstrip()


def _smaller(cause: Cause) -> str:
    if cause.reduction >= WORTH_STATING:
        return f"more than {WORTH_STATING:.0e} times smaller"
    return f"{cause.reduction:.3g} times smaller"


def _since(signal: SignalJudgement) -> str:
    if math.isfinite(signal.since):
        return f"from {signal.since:.4g} s on"
    return f"{pluralize(signal.rows_beyond, 'single row')} beyond" if signal.rows_beyond else ""


def _row(*cells: str) -> str:
    return f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in cells)}</tr>"


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(text)}</p>"
