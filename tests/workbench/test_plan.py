"""Plans in questions: tables, what is found along the lines of a grid, and judgements over all rows."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from cosim import SetupError
from tests.conftest import ROOT
from workbench import Answer
from workbench.project import NO_PROJECT
from workbench.run import ask

#: The height over (x, y) is 3 x + y, with an error of 1e-3 |x|.
TEXT = '''"""Where is the plane high?"""

from workbench import Find, Plan, PlanQuestion, option
from workbench.catalog import load_module

Plane = load_module(__file__.replace("slopes.py", "plane.py")).Plane


class Slopes(PlanQuestion):
    most: float = option(4.0, "highest that is allowed", "m")

    def plans(self, context):
        return {"slopes.csv": Plan(question=Plane, PLAN)}
'''


def answer(folder: Path, plan: str, **options: Any) -> Answer:
    """The answer of a question with a plan beside that of the plane."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", folder)
    (folder / "slopes.py").write_text(TEXT.replace("PLAN", plan))
    return ask(NO_PROJECT, str(folder / "slopes.py"), options)


def test_levels_are_found_along_each_line_of_the_grid_and_all_rows_judged(tmp_path: Path) -> None:
    found = answer(
        tmp_path,
        "grid={'y': (0.0, 1.0), 'x': (0.1, 0.5, 1.0)}, names={'x': 'at'}, columns={'height': 'z'}, "
        "find={'reached': Find('x', 0.1, 1.0, 'height', 2.0)}, limits={'height': self.most}",
    )
    table = found.first_table
    assert [*table] == ["at", "y", "z", "z_error"]
    assert table["z"].to_list() == pytest.approx(
        [3.0 * x + y for x, y in zip(table["at"], table["y"])]
    )
    for name, y in (("reached", 0.0), ("reached_2", 1.0)):
        x = found.figures[name]
        assert abs(x.value - (2.0 - y) / 3.0) <= x.known_error < 1e-3
        assert (x.unit, x.meaning) == ("m", f"x at which height is 2.0, y = {y}")
    largest = found.figures["height_largest"]
    assert (largest.value, largest.error, largest.unit) == pytest.approx((4.0, 1e-3, "m"))
    assert "not determined" in found.verdict.partition("\n")[0]  # the limit lies within the error
    assert [x.x for x in found.show().charts] and len(found.show().charts) == 1


def test_a_limit_that_all_rows_keep_and_one_that_one_row_does_not(tmp_path: Path) -> None:
    plan = "fixed={'y': 1.0}, grid={'x': (0.1, 1.0)}, limits={'height': self.most}"
    for most, verdict in ((4.1, "yes"), (3.9, "no"), ("390cm", "no")):
        first = answer(tmp_path, plan, most=most).verdict.partition("\n")[0]
        assert first.startswith(f"Height keeps its limit in all rows: {verdict}, 4.0000 ± 0.0010 ")


def test_what_is_over_no_input_of_the_grid_is_found_in_each_row(tmp_path: Path) -> None:
    found = answer(
        tmp_path, "grid={'y': (-1.0, 1.0)}, find={'reached': Find('x', 0.01, 2.0, 'height', 2.0)}"
    )
    assert found.figures["reached"].value == pytest.approx(1.0, abs=1e-3)
    assert found.figures["reached_2"].value == pytest.approx(1.0 / 3.0, abs=1e-3)


def test_a_row_that_is_refused_costs_no_other_one(tmp_path: Path) -> None:
    plan = "fixed={'x': 0.5}, grid={'mood': ('good', 'refuse', 'fail', 'good')}, columns={'height': 'height'}, limits={'height': 2.0}"
    found = answer(tmp_path, plan)
    assert found.first_table["height"].isna().to_list() == [False, True, True, False]
    assert (
        "slopes.csv: 2 of 4 rows have no answer; the first: this point is refused" in found.warnings
    )
    assert found.first_table["mood"].to_list() == ["good", "refuse", "fail", "good"]
    with pytest.raises(
        SetupError, match=r"no row of slopes\.csv has an answer; the first: this point is refused"
    ):
        answer(tmp_path, plan.replace("good", "refuse"))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ("grid={'xs': (1.0,)}", "plane has no option 'xs': did you mean 'x'?"),
        ("grid={'x': ('wide',)}", "x = 'wide' must be a number"),
        (
            "grid={'x': (1.0, 2.0)}, columns={'depth': 'z'}",
            "there is no figure 'depth', only height",
        ),
        (
            "grid={'x': (1.0, 2.0)}, find={'a': Find('w', 1.0, 2.0, 'height')}",
            "find.a: plane has no option 'w'",
        ),
        (
            "grid={'x': (1.0, 2.0)}, limits={'height': '2kg'}",
            "limits: height = '2kg' must be a number in m",
        ),
    ],
)
def test_a_wrong_plan_is_refused_in_a_line(tmp_path: Path, plan: str, words: str) -> None:
    with pytest.raises(SetupError) as refused:
        answer(tmp_path, plan)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
