"""The findings of a crosscheck as text, as JUnit XML for a test server, and as an HTML page."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from ...describe import table
from ...errors import SetupError
from ...files import replacement
from .checks import FAILED, NOT_OFFERED, NOT_RUN, PASSED, CheckResult

COLORS = {PASSED: "#1a7f37", FAILED: "#cf222e", NOT_OFFERED: "#6e7781", NOT_RUN: "#9a6700"}
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.4 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #1f2328 }}
table {{ border-collapse: collapse; width: 100% }}
td, th {{ text-align: left; vertical-align: top; padding: .35em .8em .35em 0; border-bottom: 1px solid #d0d7de }}
td:nth-child(3) {{ white-space: nowrap; font-weight: bold }}
</style></head><body><h1>{title}</h1><p>{summary}; {how}</p>
<table><tr><th>Check</th><th>{standard}</th><th>Verdict</th><th>Found</th><th>By hand</th></tr>
{rows}
</table></body></html>
"""
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
class Crosscheck:
    """The verdicts on an FMU, and how it was run for them."""

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
        counts = Counter(verdict.status for verdict in self.verdicts)
        skipped = counts[NOT_OFFERED] + counts[NOT_RUN]
        suite = ElementTree.Element(
            "testsuite", name=f"crosscheck of {self.model}", tests=str(len(self.verdicts)),
            failures=str(counts[FAILED]), errors="0", skipped=str(skipped),
        )  # fmt: skip
        for v in self.verdicts:
            case = ElementTree.SubElement(suite, "testcase", classname=self.fmu, name=v.check)
            if v.status == FAILED:
                failure = ElementTree.SubElement(case, "failure", message=v.detail)
                failure.text = f"{self.standard}, {v.clause}\n{v.instructions}\n{self.how}"
            elif v.status == PASSED:
                ElementTree.SubElement(case, "system-out").text = v.detail
            else:
                ElementTree.SubElement(case, "skipped", message=f"{v.status}: {v.detail}")
        ElementTree.indent(suite)
        return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"

    def html(self) -> str:
        """A page that needs nothing else."""
        rows = []
        for v in self.verdicts:
            check, clause, status, detail, instructions = map(html.escape, v)
            color = COLORS[v.status]
            rows.append(
                f'<tr><td>{check}</td><td>{clause}</td><td style="color:{color}">{status}</td>'
                f"<td>{detail}</td><td>{instructions}</td></tr>"
            )
        title = html.escape(f"{self.model}: crosscheck of {Path(self.fmu).name}")
        fields = {"title": title, "summary": self.summary(), "how": html.escape(self.how)}
        return PAGE.format(**fields, standard=self.standard, rows="\n".join(rows))

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

    def write(self, path: Path | str) -> None:
        """Write `path`, a .txt, JUnit's .xml, a page .html or a badge .svg; raise SetupError for another suffix.

        Parameters
        ----------
        path : path
            The file, whose suffix decides the format.
        """
        path = Path(path)
        text = writer(path)(self)
        with replacement(path) as fresh:
            fresh.write_text(text, encoding="utf-8")


WRITERS: dict[str, Callable[[Crosscheck], str]] = {
    ".txt": lambda report: report.text() + "\n",
    ".xml": Crosscheck.junit,
    ".html": Crosscheck.html,
    ".svg": Crosscheck.badge,
}


def writer(path: Path) -> Callable[[Crosscheck], str]:
    """What makes the content of a file; raises SetupError for a suffix that is not known."""
    if path.suffix not in WRITERS:
        raise SetupError(f"{path} must end in {' or '.join(WRITERS)}")
    return WRITERS[path.suffix]
