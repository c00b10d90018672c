"""Shares of a study's runs above limits: their intervals cover what they promise, their sentences say from where to where."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from cosim import SetupError
from tests.conftest import ROOT
from workbench import study
from workbench.answer import Table
from workbench.study.words import interval, sentence, share_above

LIMITS = """
scenario = "plane.py"
figures = ["height"]
[sampling]
method = "lhs"
number = 64
seed = 1
[tolerances]
x = { from = 4.0, to = 7.0 }
[limits]
height = "1500cm"
root = 3.0
"""


def write(folder: Path, text: str) -> Path:
    """A study file beside the plane."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", folder)
    (folder / "some.toml").write_text(text)
    return folder / "some.toml"


@pytest.mark.parametrize("number", [5, 64])
def test_an_interval_covers_the_true_share_at_least_as_often_as_it_says(number: int) -> None:
    """Whatever the share is: summed over all counts; Wilson's covers some shares in 84 % of studies."""
    ends = np.array([interval(k, number) for k in range(number + 1)])
    for share in np.linspace(0.001, 0.999, 400):
        covers = (ends[:, 0] <= share) & (share <= ends[:, 1])
        assert binom.pmf(np.arange(number + 1), number, share)[covers].sum() >= 0.95
    assert ends[0, 1] == pytest.approx(1.0 - 0.025 ** (1.0 / number), rel=1e-9)


def test_a_limit_gives_the_share_above_it(tmp_path: Path) -> None:
    """A run whose figure has the limit within its error counts for neither side."""
    answer = study.run(study.load(write(tmp_path, LIMITS)), out=tmp_path / "out", jobs=1)
    rows = answer.first_table
    above = rows["height"] - rows["height_error"] > 15.0
    near = (rows["height"] - 15.0).abs() <= rows["height_error"]
    assert 38 <= above.sum() <= 46  # two thirds of 64 in a Latin hypercube: 43 within one
    written = pd.read_csv(tmp_path / "out" / "limits.csv").set_index("figure")
    row = written.loc["height"]
    assert row[["limit", "above", "open", "runs"]].tolist() == [15.0, above.sum(), near.sum(), 64]
    low, high = interval(above.sum(), 64)[0], interval(above.sum() + near.sum(), 64)[1]
    assert row[["low", "high"]].tolist() == [low, high]
    for raw, wanted in (("20.0", "above 20 m in "), ('"16m"', "above 16 m in ")):
        other = write(tmp_path, LIMITS.replace('"1500cm"', raw))
        again = study.run(study.load(other), out=tmp_path / "out", jobs=1)
        assert wanted in again.verdict and "64 runs, 0 of them now" in again.verdict


def test_a_limit_within_errors_leaves_the_share_open(tmp_path: Path) -> None:
    """Of four runs two may be on either side: the interval holds the shares of one and of three."""
    table = Table(
        {"height": np.array([14.0, 14.9, 15.1, 16.0]), "height_error": np.full(4, 0.2)}, {}
    )
    plan = study.load(write(tmp_path, LIMITS))
    share = share_above(plan, table, "height", 15.0, np.ones(4, bool))
    assert (share.above, share.open, share.runs) == (1, 2, 4)
    assert (share.low, share.high) == (interval(1, 4)[0], interval(3, 4)[1])


def test_limits_at_the_points_of_a_grid(tmp_path: Path) -> None:
    """The sentence names the point where most are above; without samples there is no interval."""
    text = LIMITS.replace("[sampling]", "[grid]\ntimes = [1, 2]\n[sampling]")
    text = text.replace("[limits]", "y = { from = 0.0, to = 3.0 }\n[limits]").replace(
        "1500cm", "20m"
    )
    answer = study.run(study.load(write(tmp_path, text)), out=tmp_path / "out", jobs=1)
    shares = pd.read_csv(tmp_path / "out" / "limits.csv")
    shares = shares[shares["figure"] == "height"]
    assert shares["times"].tolist() == [1, 2] and shares["above"].is_monotonic_increasing
    assert " at times = 2, nowhere more often" in answer.verdict.splitlines()[0]
    tied = write(tmp_path, text.replace("20m", "0m"))
    told = study.run(study.load(tied), out=tmp_path / "tied", jobs=1).verdict.splitlines()[0]
    assert " at times = 1, nowhere more often" in told
    text = 'scenario = "plane.py"\n[grid]\nx = { from = 0.0, to = 4.0, number = 5 }\n[limits]\nheight = 5.0'
    answer = study.run(study.load(write(tmp_path, text)), out=tmp_path / "grid", jobs=1)
    assert answer.verdict.startswith("height is above 5 m in 3 of 5 runs; for x = 2 to 4 m.\n")
    assert np.isnan(pd.read_csv(tmp_path / "grid" / "limits.csv")["low"]).all()


def test_a_limit_of_a_figure_that_no_run_has_is_refused(tmp_path: Path) -> None:
    text = LIMITS.replace('figures = ["height"]', "").replace('height = "1500cm"', "width = 1.0")
    with pytest.raises(SetupError, match="no run has 'width', only height, y, root, high"):
        study.run(study.load(write(tmp_path, text)), out=tmp_path / "out", jobs=1)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([0, 0, 1, 1], "yes in 2 of 4 runs; for x = 3 to 4 m"),
        ([1, 0, 0, 0], "yes in 1 of 4 runs; for x = 1 m"),
        ([1, 0, 1, 1], "yes in 3 of 4 runs; for x = 1 and 3 to 4 m"),
        ([1, 1, 1, 1], "yes in 4 of 4 runs"),
        ([1, np.nan, 0, 1], "yes in 2 of 3 runs; for x = 1 and 4 m"),
        ([1, 0] * 4, "yes in 4 of 8 runs; for x in 4 stretches between 1 and 7 m"),
    ],
)
def test_a_yes_or_no_over_one_input_says_from_where_to_where(
    values: list[float], text: str, tmp_path: Path
) -> None:
    x = np.arange(len(values), 0, -1.0)
    plan = study.load(write(tmp_path, f'scenario = "plane.py"\n[grid]\nx = {x.tolist()}\n'))
    table = Table({"x": x, "high": np.array(values[::-1], float)}, {"x": "m", "high": "1"})
    assert sentence(plan, table, "high") == f"high: {text}"


def test_an_input_may_follow_from_others_by_a_formula(tmp_path: Path) -> None:
    """The height 3 x + y over the points (x, x^2 + 1); a name that is no number of the file is refused."""
    text = 'scenario = "plane.py"\n[fixed]\ntimes = 1\n[grid]\nx = [1.0, 2.0, 4.0]\n[linked]\ny = "x**2 + times"'
    table = study.run(study.load(write(tmp_path, text)), out=tmp_path / "out", jobs=1).first_table
    assert table["height"].tolist() == [5.0, 11.0, 29.0]
    for formula, message in (
        ('"x + z"', "linked.y names z, which is no number"), ('"x +"', "linked.y = 'x +' must be a formula"), ("2.0", "must be a formula"),
    ):  # fmt: skip
        wrong = write(tmp_path, text.replace('"x**2 + times"', formula))
        with pytest.raises(SetupError, match=re.escape(message)):
            study.load(wrong)


def test_a_single_run_tells_the_error_of_a_figure_and_the_unit_of_what_is_found(
    tmp_path: Path,
) -> None:
    """The level has a unit, 1500 cm of 3 x; the largest height is in that of the height."""
    text = 'scenario = "plane.py"\n[find]\nat = { over = "x", from = 1.0, to = 9.0, figure = "height", level = "1500cm" }\n'
    answer = study.run(study.load(write(tmp_path, text)), out=tmp_path / "out", jobs=1)
    assert answer.first_table["at"][0] == pytest.approx(5.0, abs=2e-3)
    assert answer.verdict.startswith("at is 5.0000 ± 0.0017 m in the only run.")


def test_the_first_run_says_which_figure_of_the_file_there_is_not(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = LIMITS.replace("root = 3.0", "roof = 3.0")
    with pytest.raises(SetupError, match="no run has 'roof'"):
        study.run(study.load(write(tmp_path, text)), out=tmp_path / "out", jobs=1)
    assert "the first run: there is no 'roof', only height, y, root, high" in capfd.readouterr().err
