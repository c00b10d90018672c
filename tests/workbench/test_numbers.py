"""The numbers that a question declares: figures by metrics, with the errors of a certified run."""

import math
from pathlib import Path

import pytest

from cosim import SetupError
from tests.conftest import fmus_of
from workbench.question import load
from workbench.run import found

PAGE = '''"""Does a number have its error?"""

from cosim.metrics import Integral
from workbench import Number, Question, Reader, RunOptions, option


class Turning(Question, RunOptions):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    start_values = {"conveyor.w": "speed"}

    speed: float = option(40.0, "speed at the start", "rad/s", above=0.0)
    stop: float = option(0.5, "simulated time", "s", above=0.0)

    numbers = (
        Number("largest", Reader("max", "abs(motor.tau)"), "N.m", "up to {stop:g} s"),
        Number("time", Reader("time_of_max", "abs(motor.tau)"), "N.m"),
        Number("late", Reader("min", "conveyor.w", "stop / 2")),
        Number("turned", Reader("change", "conveyor.phi / (2 * pi)"), "1"),
        Number("whole", Integral("conveyor.w"), "rad"),
        Number("turn", Reader("mean", "conveyor.w", "revolution", angle="conveyor.phi")),
        Number("half_turn", "figures.turn / 2", "rad/s"),
        Number("never", Reader("first_crossing", "conveyor.w", level="10 * speed")),
    )
'''


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "turning.py"
    path.write_text(PAGE)
    return path


def figures(page: Path, **options: object) -> dict:
    question = load(str(page))
    with found(question, question.parse(options), fmus_of(question.module)) as findings:
        return dict(findings.figures)


def test_numbers_of_a_run_hold_those_of_a_finer_one(page: Path) -> None:
    coarse, fine = figures(page, step=1e-3), figures(page, step=1.25e-4)
    for name, x in fine.items():
        if name == "never":
            assert x.error is None and "stays below 400 rad/s" in x.reason
            continue
        error = abs(coarse[name].value - x.value)
        assert 0.0 < error <= coarse[name].error + x.error, name
        assert coarse[name].error < 0.05 * abs(x.value), name
    assert fine["half_turn"].error == pytest.approx(fine["turn"].error / 2, rel=1e-9)
    assert coarse["largest"].meaning == "up to 0.5 s"
    assert fine["whole"].value == pytest.approx(2 * math.pi * fine["turned"].value, rel=1e-6)
    assert (fine["late"].unit, fine["turned"].unit) == ("rad/s", "1")


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (
            'Reader("max", "abs(motor.torque)"), "N.m"',
            "uses 'motor.torque', which is no option, start",
        ),
        ('Reader("first_crossing", "motor.tau", level="2 * sped")', "'sped'.*did you mean 'speed'"),
        ('Reader("max", "motor.tau"), "", "up to {stopp:g} s"', "the meaning of 'x' names 'stopp'"),
        ('Reader("max", "motor.torque")', "there is no column 'motor.torque'; did you mean"),
        ('Reader("max", "abs(motor.tau)")', "needs a unit"),
        ('Reader("phase", "motor.tau"), "deg"', "must be one of last, change, max"),
    ],
)
def test_a_number_that_cannot_be_read_is_one_line(page: Path, number: str, message: str) -> None:
    head, _ = PAGE.split("    numbers = ")
    page.write_text(f'{head}    numbers = (Number("x", {number}),)\n')
    with pytest.raises(SetupError, match="(?s)" + message.replace("(", r"\(")):
        figures(page)
