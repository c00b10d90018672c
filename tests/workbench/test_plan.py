"""Plans in questions: tables, what is found along the lines of a grid, and judgements over all rows."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cosim import SetupError
from scenarios.conveyor import orbit
from scenarios.conveyor.first_order import SETS
from tests.conftest import ROOT, fmus_of
from workbench import Answer, Context, Find, Plan
from workbench.plan import measure
from workbench.project import NO_PROJECT
from workbench.run import ask

#: The height over (x, y) is 3 x + y, with an error of 1e-3 |x|.
TEXT = '''"""Where is the plane high?"""

from workbench import Figure, Find, Findings, Judgement, Plan, PlanQuestion
from workbench.catalog import load_module

Plane = load_module(__file__.replace("slopes.py", "plane.py")).Plane


class Slopes(PlanQuestion):
    def plans(self, context):
        return {"slopes.csv": Plan(question=Plane, PLAN)}

    def conclude(self, context, measured):
        slopes = measured["slopes.csv"]
        places = [x.place for name in slopes.found for line in slopes.found[name] for x in line]
        low = 100.0 * (slopes.table.frame.iloc[:, -2] < 3.9).mean()
        figures = {f"at_{k}": x for k, x in enumerate(places)} | {"low": Figure(low, "%", 0.0)}
        return Findings(figures, slopes, tables={"slopes.csv": slopes.table})

    def judgements(self, f, r):
        return [Judgement("nearly all of the plane is low", f["low"], least=80.0)]
'''


def answer(folder: Path, plan: str) -> Answer:
    """The answer of a question with a plan beside that of the plane."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", folder)
    (folder / "slopes.py").write_text(TEXT.replace("PLAN", plan))
    return ask(NO_PROJECT, str(folder / "slopes.py"), {})


def test_levels_are_found_along_each_line_of_the_grid_and_the_table_is_judged(
    tmp_path: Path,
) -> None:
    found = answer(
        tmp_path,
        "grid={'y': (0.0, 1.0), 'x': (1.0, 0.1, 0.5)}, names={'x': 'at'}, columns={'height': 'z'}, "
        "find={'reached': Find('x', 0.1, 1.0, 'height', 2.0)}",
    )
    table = found.first_table
    assert [*table] == ["at", "y", "z", "z_error"]
    heights = [3.0 * x + y for x, y in zip(table["at"], table["y"])]
    assert table["z"].to_list() == pytest.approx(heights)
    for k, y in enumerate((0.0, 1.0)):
        x = found.figures[f"at_{k}"]
        assert abs(x.value - (2.0 - y) / 3.0) <= x.known_error < 1e-3
        assert (x.unit, x.meaning) == ("m", "x at which height is 2.0")
    assert found.verdict == "Nearly all of the plane is low: yes, 83.33 % (at least 80)"


def test_a_search_that_theory_guides_goes_by_rising_values_in_whatever_order_they_are_given() -> (
    None
):
    drives = Plan(
        question=orbit.DriveOrbit,
        fixed={"steps_per_rev": 128},
        grid={"speed": (60.0, 30.0, 45.0, 37.5)},
        find={"nu_90": Find("speed", 30.0, 60.0, "lag", 90.0)},
    )
    found = measure(Context(fmus_of(orbit)), {"drives.csv": drives})["drives.csv"].found
    (place,) = (x.place for line in found["nu_90"] for x in line)
    assert place.value == pytest.approx(SETS["A"].nu_res, rel=3e-4)


def test_what_is_over_no_input_of_the_grid_is_found_in_each_row(tmp_path: Path) -> None:
    found = answer(
        tmp_path, "grid={'y': (-1.0, 1.0)}, find={'reached': Find('x', 0.01, 2.0, 'height', 2.0)}"
    )
    assert found.figures["at_0"].value == pytest.approx(1.0, abs=1e-3)
    assert found.figures["at_1"].value == pytest.approx(1.0 / 3.0, abs=1e-3)


def test_a_row_that_is_refused_costs_no_other_one(tmp_path: Path) -> None:
    plan = "fixed={'x': 0.5}, grid={'mood': ('good', 'refuse', 'fail', 'good')}, columns={'height': 'height'}"
    found = answer(tmp_path, plan)
    assert found.first_table["height"].isna().to_list() == [False, True, True, False]
    assert found.first_table["mood"].to_list() == ["good", "refuse", "fail", "good"]
    with pytest.raises(SetupError, match=r"no row of slopes\.csv has an answer; the first: this"):
        answer(tmp_path, plan.replace("good", "refuse"))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ("fixed={'x': 1.0}, grid={'x': (1.0,)}", "'x' is given in two of [fixed], [grid]"),
        ("grid={'xs': (1.0,)}", "plane has no option 'xs': did you mean 'x'?"),
        ("grid={'x': ('wide',)}", "x = 'wide' must be a number"),
        ("grid={'x': (1.0, 2.0)}, columns={'depth': 'z'}", "there is no figure 'depth', only"),
        ("grid={'x': (1.0, 2.0)}, find={'a': Find('w', 1.0, 2.0, 'height')}", "find.a: plane has no option 'w'"),
    ],
)  # fmt: skip
def test_a_wrong_plan_is_refused_in_a_line(tmp_path: Path, plan: str, words: str) -> None:
    with pytest.raises(SetupError) as refused:
        answer(tmp_path, plan)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
