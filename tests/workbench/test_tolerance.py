"""The share of machines that scatter for which a judgement is yes: a question whose share is known exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scipy.stats import beta

from scenarios.project import PROJECT
from workbench import cli
from workbench.study.words import interval

BEAM = '''"""Is the beam short enough?"""
from workbench import Figure, Findings, Judgement, Question, option

class Beam(Question):
    length: float = option(1.0, "length", "m", above=0.0)
    gap: float = option(1.05, "gap", "m")

    def solve(self, context):
        return Findings({"length": Figure(self.length, "m", 1e-9)})

    def judgements(self, f, r):
        return [Judgement("the beam fits", f["length"], most=self.gap, yes="The beam fits"), Judgement("length", f["length"])]
'''


def told(capsys: Any, tmp_path: Path, *more: str) -> list[str]:
    page = tmp_path / "beam.py"
    page.write_text(BEAM)
    words = ["run", str(page), "--jobs", "1", "--out", str(tmp_path / "out"), *more]
    capsys.readouterr()
    cli.main(words, PROJECT, "scenarios")
    streams = capsys.readouterr()
    return [*streams.out.splitlines(), *streams.err.splitlines()]


def test_the_share_is_that_of_the_distribution_and_its_interval_that_of_the_beta_one(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = told(
        capsys, tmp_path, "--tolerance", "length=10%"
    )  # 0.9 to 1.1, of which three quarters fit
    assert lines[0].startswith("The beam fits")
    low, high = (100 * beta.ppf(q, a, b) for q, a, b in ((0.025, 48, 17), (0.975, 49, 16)))
    assert lines[1] == f"The beam fits: yes in 48 of 64 machines ({low:.2g} % to {high:.2g} %)"
    assert lines[2] == "Length: 1 m" or lines[2].startswith("Length: 1")
    assert (tmp_path / "out" / "tolerances" / "table.csv").exists()


def test_all_and_none_have_one_end_and_other_machines_replace_the_study(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = told(capsys, tmp_path, "--tolerance", "length=+-0.04")
    assert lines[1] == "The beam fits: yes in 64 of 64 machines (at least 94 %)"
    lines = told(capsys, tmp_path, "--tolerance", "length=1%", "--length", "2", "--machines", "20")
    assert lines[1] == "The beam fits: yes in 0 of 20 machines (at most 17 %)"
    assert interval(20, 20)[0] == pytest.approx(0.025 ** (1 / 20))
    many = told(capsys, tmp_path, "--tolerance", "length=normal:+-0.05", "--machines", "256")
    assert (
        "yes in 215 of 256" in many[1] or "yes in 216 of 256" in many[1]
    )  # a standard deviation: 84.13 %


@pytest.mark.parametrize("text", ["width=5%", "length=wide", "length"])
def test_a_tolerance_of_nothing_is_refused(
    text: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert any("error: " in line for line in told(capsys, tmp_path, "--tolerance", text))
