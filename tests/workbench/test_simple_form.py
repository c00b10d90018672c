"""The simple form of a question: several certified runs, processed results, further figures and tables."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim import SetupError
from scenarios.project import PROJECT
from tests.conftest import ROOT
from workbench.answer import Answer
from workbench.run import ask

EXAMPLES = ROOT / "examples"


def answer_of(name: str, **options: Any) -> Answer:
    return ask(PROJECT, str(EXAMPLES / f"{name}.py"), options, flavour="native", jobs=1)


def test_two_systems_are_certified_and_compared() -> None:
    """Their difference is that of the speeds in the two tables, read without the workbench."""
    answer = answer_of("stop_compared")
    times = {}
    for name in ("quick", "slow"):
        frame = answer.tables[f"{name}.csv"].frame
        times[name] = float(np.interp(-20.0, -frame["conveyor.w"], frame["time"]))
    sooner = answer.figures["sooner"]
    assert 0.0 < (sooner.error or 0.0) < 1e-4
    assert sooner.value == pytest.approx(times["slow"] - times["quick"], abs=1e-5)
    assert sooner.brief() in answer.verdict


def test_a_processed_result_is_what_figures_and_tables_see() -> None:
    answer = answer_of("brake_work")
    frame = answer.tables["brake_work.csv"].frame
    power = -frame["motor.tau"] * frame["conveyor.w"]
    assert np.asarray(frame["power"]) == pytest.approx(np.asarray(power))
    work = answer.figures["work"]
    assert work.value == pytest.approx(float(np.trapezoid(power, frame["time"])), rel=1e-3)
    assert answer.tables["brake_steps.csv"].frame["brake"][0] == answer.figures["brake"].value


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, with the FMU of its equations beside it."""
    folder = tmp_path_factory.mktemp("oscillator")
    shutil.copy(EXAMPLES / "limit_cycle.py", folder)
    model = ROOT / "tests" / "fmukit" / "models" / "van_der_pol.py"
    command = [
        sys.executable,
        "-m",
        "fmukit",
        "build",
        model,
        "--flavour",
        "native",
        "--out",
        folder,
    ]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    shutil.copy(folder / "native" / "VanDerPol.fmu", folder)
    return folder / "limit_cycle.py"


def test_a_question_on_an_fmu_next_to_it_finds_the_limit_cycle(oscillator: Path) -> None:
    for mu in (1.0, 2.0):
        answer = ask(PROJECT, str(oscillator), {"mu": mu}, jobs=1)
        for name, exact in zip(("period", "amplitude"), cycle(mu), strict=True):
            figure = answer.figures[name]
            assert figure.error is not None and figure.error < 1e-4
            assert abs(figure.value - exact) <= figure.error, (mu, name)
            assert figure.brief() in answer.verdict


def cycle(mu: float) -> tuple[float, float]:
    """Period and amplitude by one integration with events, without FMUs."""

    def slope(t: float, x: Any) -> list[float]:
        return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]

    def top(t: float, x: Any) -> float:
        return float(x[1])

    top.direction = -1.0  # type: ignore[attr-defined]
    solution = solve_ivp(
        slope, (0.0, 100.0), [2.0, 0.0], method="DOP853", events=top, rtol=1e-12, atol=1e-12
    )
    times, states = solution.t_events[0], solution.y_events[0]
    return float(times[-1] - times[-2]), float(states[-1][0])


def test_an_example_without_its_fmu_says_what_is_missing() -> None:
    with pytest.raises(SetupError, match=r"parts: oscillator = 'VanDerPol\.fmu': no file "):
        answer_of("limit_cycle")
