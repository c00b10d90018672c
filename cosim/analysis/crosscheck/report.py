"""The findings of a crosscheck as text, as JUnit XML for a test server, and as an HTML page."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ...describe import table
from ...report_files import (
    AMBER,
    GREEN,
    GREY,
    RED,
    ReportFile,
    html_table,
    junit,
    page,
    paragraphs,
)
from .checks import FAILED, NOT_OFFERED, NOT_RUN, PASSED, CheckResult

COLORS = {PASSED: GREEN, FAILED: RED, NOT_OFFERED: GREY, NOT_RUN: AMBER}
#: Width of a letter of a badge [px]: derived from a sans-serif font of 11 px, whose letters are about 0.6 as wide.
BADGE_LETTER = 6.6
#: Space around the text of a field of a badge [px]: a convention.
BADGE_MARGIN = 12.0
BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="20" role="img" \
aria-label="{left}: {right}"><title>{left}: {right}</title>
<rect width="{begin:.0f}" height="20" fill="#424a53"/>
<rect x="{begin:.0f}" width="{rest:.0f}" height="20" fill="{color}"/>
<g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="{first:.0f}" y="14">{left}</text><text x="{second:.0f}" y="14">{right}</text></g></svg>
"""


@dataclass(frozen=True)
class Crosscheck(ReportFile):
    """The verdicts on an FMU, and how it was run for them."""

    FORMATS: ClassVar = {".txt": "text", ".xml": "junit", ".html": "html", ".svg": "badge"}

    fmu: str
    model: str
    standard: str
    how: str
    verdicts: tuple[CheckResult, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(verdict.status != FAILED for verdict in self.verdicts)

    def __getitem__(self, check: str) -> CheckResult:
        """The verdict of the check of this name."""
        return next(verdict for verdict in self.verdicts if verdict.check == check)

    def summary(self) -> str:
        """How many checks ended how."""
        counts = Counter(verdict.status for verdict in self.verdicts)
        return ", ".join(f"{counts[status]} {status}" for status in COLORS if counts[status])

    def text(self) -> str:
        """A line for each check, and how to repeat each failed one by hand."""
        rows = [(v.check, v.clause, v.status.upper() if v.status == FAILED else v.status, v.detail)
                for v in self.verdicts]  # fmt: skip
        failed = (v for v in self.verdicts if v.status == FAILED)
        instructions = [f"{v.check}, {self.standard}, {v.clause}: {v.instructions}" for v in failed]
        first = f"{self.model}, {self.fmu}"
        return "\n".join([first, self.how, *table(rows), *instructions, self.summary()])

    def junit(self) -> str:
        """JUnit's XML; what is not offered or not run is skipped."""

        def case(v: CheckResult) -> tuple[str, str, str, str]:
            if v.status == FAILED:
                text = f"{self.standard}, {v.clause}\n{v.instructions}\n{self.how}"
                return v.check, "failure", v.detail, text
            if v.status == PASSED:
                return v.check, "system-out", "", v.detail
            return v.check, "skipped", f"{v.status}: {v.detail}", ""

        return junit(f"crosscheck of {self.model}", self.fmu, [case(v) for v in self.verdicts])

    def html(self) -> str:
        """A page that needs nothing else."""
        heading = ("Check", self.standard, "Verdict", "Found", "By hand")
        title = f"{self.model}: crosscheck of {Path(self.fmu).name}"
        return page(
            title,
            paragraphs([f"{self.summary()}; {self.how}"]),
            html_table([heading, *self.verdicts], COLORS),
        )

    def badge(self) -> str:
        """A badge as SVG: the standard, and how many checks passed or failed."""
        failed = sum(verdict.status == FAILED for verdict in self.verdicts)
        passed = sum(verdict.status == PASSED for verdict in self.verdicts)
        outcome = f"{failed} failed" if failed else f"{passed} passed"
        texts = (f"{self.standard} crosscheck", outcome)
        left, right = (BADGE_MARGIN + BADGE_LETTER * len(text) for text in texts)
        return BADGE.format(
            left=texts[0], right=texts[1], color=COLORS[FAILED if failed else PASSED],
            width=left + right, begin=left, rest=right, first=left / 2, second=left + right / 2,
        )  # fmt: skip
