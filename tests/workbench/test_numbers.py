"""The numbers that a question declares: figures by metrics, with the errors of a certified run."""

import math
from pathlib import Path

import pytest

from scenarios import ask
from tests.conftest import ROOT, fmus_of
from workbench import Figure, Number
from workbench.method import figure_of_formula
from workbench.options import Option
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
        Number("time", Reader("time_of_max", "abs(motor.tau)")),
        Number("late", Reader("min", "conveyor.w", "stop / 2")),
        Number("turned", Reader("change", "conveyor.phi / (2 * pi)"), "1"),
        Number("whole", Integral("conveyor.w"), "rad"),
        Number("work", Integral("motor.P"), "kJ"),
        Number("same_work", Integral("motor.P")),
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


@pytest.mark.parametrize("text", ["1 / figures.a", "sqrt(figures.a)", "figures.a**3 - figures.a"])
def test_a_number_of_a_figure_has_an_error_up_and_down(text: str) -> None:
    """A curved formula changes more to one side; the other side alone would state less than half of it."""

    def at(value: float, error: float) -> Figure:
        return figure_of_formula(Number("x", text, "1"), {"a": Figure(value, "1", error)}, {})

    told = at(1.0, 0.6)
    for value in (0.4, 0.7, 1.3, 1.6):
        assert abs(at(value, 0.0).value - told.value) <= told.error * (1 + 1e-12)


def test_a_number_whose_formula_has_no_value_within_the_error_is_undetermined() -> None:
    for error in (1.0, 1.5):
        told = figure_of_formula(
            Number("x", "1 / sqrt(figures.a)", "1"), {"a": Figure(1.0, "1", error)}, {}
        )
        assert told.error is None and told.reason


def test_numbers_of_a_run_hold_those_of_a_finer_one(page: Path) -> None:
    coarse, fine = figures(page, step=1e-3), figures(page, step=1.25e-4)
    for name, x in fine.items():
        if name == "never":
            assert x.error is None and "conveyor.w stays below 400 rad/s" in x.reason
            continue
        error = abs(coarse[name].value - x.value)
        assert 0.0 < error <= coarse[name].error + x.error, name
        assert coarse[name].error < 0.05 * abs(x.value), name
    assert fine["half_turn"].error == pytest.approx(fine["turn"].error / 2, rel=1e-9)
    assert coarse["largest"].meaning == "up to 0.5 s"
    assert fine["whole"].value == pytest.approx(2 * math.pi * fine["turned"].value, rel=1e-6)
    assert fine["work"].value == pytest.approx(fine["same_work"].value / 1000, rel=1e-9)
    assert [fine[x].unit for x in ("late", "turned", "time")] == ["rad/s", "1", "s"]


def test_runs_that_show_an_error_are_coupled_as_the_options_say(page: Path) -> None:
    """Each is a plain run, whose value is nearly that of the certified ones; what does not happen stays without one."""
    certified = figures(page, algorithm="gauss-seidel", step=5e-4)
    finer = "    method = Run(finer=({'step': 'step / 2'},))\n\n    numbers = ("
    source = PAGE.replace("    numbers = (", finer).replace("Turning", "Finer")
    page.write_text(source.replace("option\n", "option\nfrom workbench.method import Run\n", 1))
    plain = figures(page, algorithm="gauss-seidel", step=5e-4)
    assert plain["never"].error is None and plain["never"].reason
    other = figures(page, algorithm="strang", step=5e-4)
    assert plain["work"].value == pytest.approx(certified["work"].value, rel=1e-4)
    assert plain["work"].value != pytest.approx(other["work"].value, rel=1e-2)
    assert plain["work"].error > 0.0


OWN = (ROOT / "tests" / "refused" / "turning.py").read_text(encoding="utf-8")


def test_the_help_of_an_option_states_its_bounds() -> None:
    bounded = Option(
        "share", float, False, 40.0, "share of all", "%", {"above": 0.0, "at most": 1e2}
    )
    assert bounded.help_text() == "share of all [%%] (above 0, at most 100, default: 40)"


def test_a_number_is_in_its_unit_and_records_its_column(page: Path) -> None:
    page.write_text(OWN.replace('"kN.m"', '"kN.m", "torque"'))
    answer = ask(str(page), stop=0.05)
    largest = answer.first_table["motor.tau"].max()
    assert answer.figures["torque"].value == pytest.approx(largest / 1000, rel=1e-3)
    assert not answer.warnings
    assert answer.live is not None and '(0.001*v["motor.tau"])' in answer.live.worker


def test_an_input_that_nothing_sets_is_a_warning(page: Path) -> None:
    page.write_text(
        OWN.replace('"motor.tau -> conveyor.tau", "conveyor', '"conveyor').replace(
            'motor.w")', 'motor.w",)'
        )
    )
    answer = ask(str(page), stop=0.05)
    assert answer.warnings == [
        "nothing drives or sets the input conveyor.tau, which stays at 8; add a wire, or give it in start_values"
    ]
