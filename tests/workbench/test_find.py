"""Where figures reach levels: those of closed form, and of the drive by its theory."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import SetupError
from scenarios.conveyor.orbit import DriveOrbit
from tests.conftest import fmus_of
from workbench import Context, Figure, Findings, Question, option
from workbench.find import Find, find

NOWHERE = Context({})


class About:
    """The wave with 10 % more."""

    figures, period = ("y",), math.inf

    def theory(self, _x: Any) -> Any:
        return np.array(1.0)

    def smooth(self, x: Any, values: Any) -> Any:
        return values[0] / (2.2 + 1.1 * np.sin(5.0 * x))

    def figure(self, x: Any, smooth: Any) -> Any:
        return (2.2 + 1.1 * np.sin(5.0 * x)) * smooth.real

    def half_width(self, _x: Any) -> float:
        return 0.05


class Curve(Question):
    """A curve with a shape, and its error."""

    at_once = 4
    x: float = option(1.0, "place", "m")
    shape: str = option("sine", "its course")

    def solve(self, _context: Context) -> Findings:
        x, unknown = self.x, Figure.undetermined("1", "there is none")
        y = {
            "sine": math.sin(x), "kink": abs(x - 2.0), "plateau": min(max(x - 2.0, 0.0), x - 3.0) if x > 3.0 else min(x - 2.0, 0.0),
            "narrow": math.tanh(300.0 * (x - 2.5)) * math.tanh(300.0 * (2.53 - x)), "hole": x - 2.0,
            "jump": -1.0 if x < 2.7 else 3.0, "cliff": math.atan(1e4 * (x - 2.7)), "wave": 2.0 + math.sin(5.0 * x),
            "hump": 1.0 / (1.0 + (x - 0.6) ** 2),
        }[self.shape]  # fmt: skip
        if self.shape == "hole" and x > 3.0:
            return Findings({"y": unknown, "square": unknown})
        unit = "N" if self.shape in ("wave", "hump") else "1"
        return Findings({"y": Figure(y, unit, 1e-9), "square": Figure(y * y, "1", 1e-9)})

    def guide(self, figure: str, over: str) -> Any:
        return About() if (self.shape, figure) == ("wave", "y") else None


def curve(shape: str = "sine") -> Question:
    return Curve.parse({"shape": shape})


def places(
    shape: str, level: Any = 0.0, low: float = 0.5, high: float = 10.0, **more: Any
) -> list[Figure]:
    (found,) = find(
        NOWHERE,
        [(curve(shape), Find("x", low, high, "y", level, which="all", unit="m", **more))],
    )
    return found


def test_all_crossings_are_found_within_their_errors() -> None:
    found = places("sine", 0.5, 0.1)
    truth = [
        math.asin(0.5),
        math.pi - math.asin(0.5),
        2.0 * math.pi + math.asin(0.5),
        3.0 * math.pi - math.asin(0.5),
    ]
    assert len(found) == 4
    for figure, x in zip(found, truth):
        assert (
            figure.error is not None
            and abs(figure.value - x) <= figure.error < 1e-6
            and figure.unit == "m"
        )


def test_a_level_may_be_a_figure_of_the_same_case_and_a_search_the_first_of_many() -> None:
    (one,) = find(NOWHERE, [(curve(), Find("x", 2.0, 4.0, "y", "square"))])
    assert one[0].value == pytest.approx(math.pi)  # where the sine and its square are 0
    both = find(NOWHERE, [(curve(), Find("x", 2.0, high, "y", 0.0)) for high in (4.0, 7.0)])
    assert [x.value for y in both for x in y] == pytest.approx([math.pi, math.pi])


def test_a_kink_is_a_crossing_and_a_plateau_a_stretch() -> None:
    assert [x.value for x in places("kink", 0.5)] == pytest.approx([1.5, 2.5])
    (flat,) = places("plateau", high=4.0)
    assert flat.error is None and "is at its level, within its error, from 2" in flat.reason


def test_two_crossings_close_together_are_told_apart_where_the_grid_is_halved_far_enough() -> None:
    assert len(places("narrow", low=2.4, high=2.7)) == 2


def test_a_guide_shows_what_the_grid_is_too_coarse_for() -> None:
    """Nine points see nothing of a wave with ten crossings that theory has with 10 % more."""
    wave = curve("wave")
    (found,) = find(NOWHERE, [(wave, Find("x", 0.1, 6.5, "y", 2.0, "all"))])
    assert [x.value for x in found] == pytest.approx(math.pi / 5.0 * np.arange(1, 11), abs=1e-6)


def test_what_is_not_there_says_where_it_was_looked_for() -> None:
    (never,) = places("sine", 2.0)
    assert never.error is None and never.reason == "y stays below its level from 0.5 to 10 m"
    (before,) = places("hole", 2.0)
    assert before.reason == "y stays below its level from 0.5 to 2.875 m"
    with pytest.raises(SetupError, match="no figure 'z', only y, square"):
        find(NOWHERE, [(curve(), Find("x", 1.0, 2.0, "z", 0.0))])


@pytest.mark.parametrize("shape", ["wave", "hump"])
def test_a_largest_value_is_found_with_its_height_with_a_guide_or_without(shape: str) -> None:
    (found,) = find(NOWHERE, [(curve(shape), Find("x", 0.1, 1.0, "y", "largest", unit="m"))])
    place, height = found
    top, most = (math.pi / 10.0, 3.0) if shape == "wave" else (0.6, 1.0)
    assert place.error is not None and abs(place.value - top) <= place.error < 1e-3
    assert height.error is not None and abs(height.value - most) <= height.error < 1e-3
    assert (place.unit, height.unit) == ("m", "N")
    ((edge, _),) = find(NOWHERE, [(curve(shape), Find("x", 1.2, 1.5, "y", "largest"))])
    assert edge.error is None and "edge" in edge.reason


def test_the_lag_of_a_motor_that_puts_the_resonance_at_a_speed_is_that_of_formula_22() -> None:
    """All searches go on together, and in small steps the error of theory is of the order of the ripple squared."""
    from scenarios.conveyor import orbit

    o = DriveOrbit.parse({"speed": 40.0, "steps_per_rev": 256})
    lag = Find("motor.T", 0.04, 0.09, "lag", 90.0, unit="s")
    edges = Find("speed", 20.0, 60.0, "tau2", 50.0, which="all")
    (found,), ends = find(Context(fmus_of(orbit)), [(o, lag), (o, edges)])
    machine = o.machine
    truth = machine.slope / (machine.theta0 * (2.0 * 40.0) ** 2)
    assert found.error is not None and found.error < 1e-4 * truth
    assert found.value == pytest.approx(truth, rel=3e-4)
    assert [x.value for x in ends] == pytest.approx([25.97585, 45.18200], abs=1e-3)


def test_a_study_may_only_seek(tmp_path: Path) -> None:
    from scenarios import study

    path = tmp_path / "lag.toml"
    path.write_text(
        'scenario = "orbit"\n[fixed]\nspeed = 40.0\nsteps_per_rev = 128\n[find]\n'
        'lag_for_resonance = { over = "motor.T", from = 0.04, to = 0.09, figure = "lag", level = 90 }\n'
    )
    table = study(path, out=tmp_path / "out", jobs=1).first_table
    assert table["lag_for_resonance"][0] == pytest.approx(0.0625, rel=1e-3)
    for wrong, message in (
        ("level = 90", 'must be { over, from, to, figure, level }'),
        ('nothing = { over = "speed", from = 0, to = 1, figure = "lag", level = 1 }', "must be above 0"),
        ('nothing = { over = "sped", from = 1, to = 2, figure = "lag", level = 1 }', "did you mean 'speed'"),
    ):  # fmt: skip
        path.write_text(f'scenario = "orbit"\n[find]\n{wrong}\n')
        with pytest.raises(SetupError) as refused:
            study(path, out=tmp_path / "wrong")
        assert message in str(refused.value)


def test_a_jump_over_the_level_is_an_interval() -> None:
    for shape in ("jump", "cliff"):
        (figure,) = places(shape)
        assert figure.error is not None
        assert abs(figure.value - 2.7) <= figure.error < 1e-4
