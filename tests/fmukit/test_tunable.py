"""Tunable parameters: changed in motion, against closed solutions and other integrators."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Series, System, run
from fmukit.declare.interface import Interface
from tests.fmukit.test_native import built
from tests.hosts.host import Unit

FOLDERS = {"python": ".", "native": "native", "fmi3": "fmi3"}


#: machines of these tests, made for FMI 3.0 where that is tried
TUNED = ("DriveMotor", "SpeedController", "IronDrive")


@pytest.fixture(params=["python", "native", pytest.param("fmi3", marks=pytest.mark.slow)])
def folder(request: pytest.FixtureRequest, fmus: Path) -> Path:
    """The FMUs of one flavour and version."""
    for name in TUNED if request.param == "fmi3" else ():
        built(name)
    return fmus / FOLDERS[request.param]


def held(*rows: tuple[float, float]) -> Series:
    """A table that holds each value until the next time."""
    times, values = zip(*rows)
    return Series.of({"t": times, "value": values}).held()


def test_a_motor_follows_the_changes_of_its_line_and_its_lag(folder: Path) -> None:
    """tau' = (A - B w - tau)/T at a constant speed: exponentials from change to change."""
    system = System(
        {"motor": folder / "DriveMotor.fmu"},
        start={"motor.w": 40.0, "motor.tau": 8.0},
        inputs={"motor.A": held((0.0, 8000.0), (0.1, 8010.0))},
        changes=["at 0.25 s motor.T = 0.02", "at 0.313 s motor.B = 200.0"],
    )
    result = run(system, stop=0.5, step=0.01)
    tau, before = 8.0, 0.0
    line = {"A": 8000.0, "B": 199.8, "T": 0.0625}
    for time, name, value in (
        (0.1, "A", 8010.0),
        (0.25, "T", 0.02),
        (0.313, "B", 200.0),
        (0.5, "T", 1.0),
    ):
        final = line["A"] - line["B"] * 40.0
        tau = final + (tau - final) * math.exp(-(time - before) / line["T"])
        line[name], before = value, time
    assert result["motor.tau"][-1] == pytest.approx(tau, rel=1e-12)


def test_gains_of_a_controller_change_without_a_bump_of_its_integral_part(folder: Path) -> None:
    """tau_i' = K/T_i e at a constant deviation: straight lines, and a torque that steps with K."""
    system = System(
        {"controller": folder / "SpeedController.fmu"},
        start={"controller.tau_max": 1e6},
        changes=["at 0.5 s controller.K = 3", "at 1 s controller.T_i = 0.25"],
    )
    result = run(system, stop=1.5, step=0.01)
    integral = 5.0 * (0.5 * 2.0 / 0.5 + 0.5 * 3.0 / 0.5 + 0.5 * 3.0 / 0.25)
    assert result["controller.tau_i"][-1] == pytest.approx(integral, rel=1e-9)
    assert result["controller.tau"][-1] == pytest.approx(integral + 3.0 * 5.0, rel=1e-9)


def test_an_iron_that_sticks_lets_go_when_its_guide_is_freed(folder: Path) -> None:
    """Stuck with a rough guide; less friction in motion lets it move in the next step, as from the start."""
    stuck = {"phi": 0.9, "friction.K_up": 0.6, "friction.K_down": -0.9, "on_invalid": 1}
    system = System(
        {"iron": folder / "IronDrive.fmu"},
        start={f"iron.{name}": value for name, value in stuck.items()},
        changes=["at 0.02 s iron.friction.K_down = -0.01"],
    )
    result = run(system, stop=0.04, step=1e-3)
    speed = np.abs(result["iron.w_cam"])
    assert speed[:21].max() == 0.0
    free = stuck | {"friction.K_down": -0.01}
    freed = System(
        {"iron": folder / "IronDrive.fmu"}, start={f"iron.{n}": v for n, v in free.items()}
    )
    after, fresh = result["iron.w_cam"][21:], run(freed, stop=0.02, step=1e-3)["iron.w_cam"]
    assert np.abs(fresh).max() > 1e-3
    assert after == pytest.approx(fresh, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("flavour", ["python", "native"])
def test_outputs_follow_a_parameter_at_once_and_a_state_brings_it_back(
    flavour: str, fmus: Path
) -> None:
    unit = Unit(fmus / FOLDERS[flavour] / "DriveMotor.fmu").start(w=40.0).step(0.0, 0.1)
    before, state = unit.outputs(), unit.fmi.getFMUState()
    unit.set(A=8100.0)
    assert unit.get("tau_static") == pytest.approx(8100.0 - 199.8 * 40.0)
    assert unit.get("tau") == before[0]
    after = unit.step(0.1, 0.1).outputs()
    unit.fmi.setFMUState(state)
    assert [unit.get("A"), unit.outputs()] == [8000.0, before]
    assert unit.set(A=8100.0).step(0.1, 0.1).outputs() == after


@pytest.mark.parametrize("flavour", ["python", "native"])
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("T", -1.0, "T = -1.0 s must be > 0"),
        ("T", math.nan, "T = nan s must be a finite number"),
        (
            "characteristic",
            1,
            "characteristic = 1 cannot be set: fixed parameter, after initialisation",
        ),
    ],
)
def test_an_impossible_value_in_motion_is_refused(
    flavour: str, name: str, value: float, message: str, fmus: Path
) -> None:
    unit = Unit(fmus / FOLDERS[flavour] / "DriveMotor.fmu").start().step(0.0, 0.1)
    assert message in unit.refusal(lambda u: u.set(**{name: value}).step(0.1, 0.1))


def test_the_check_of_a_model_also_holds_in_motion(fmus: Path) -> None:
    unit = Unit(fmus / "native" / "IronDrive.fmu").start()
    call: Callable[[Unit], Any] = lambda u: u.set(**{"friction.K_down": -1.5}).step(0.0, 1e-3)
    assert "friction: -1 < K_down <= 0 <= K_up violated" in unit.refusal(call)


def test_only_a_parameter_is_tunable(tmp_path: Path) -> None:
    from fmukit.fmu.load import load

    file = tmp_path / "wrong.py"
    file.write_text(
        '"""Wrong"""\nfrom fmukit import Experiment, real, record\nfrom fmukit.si import Ratio\n'
        "EXPERIMENT = Experiment(stop=1.0, step=0.1)\n"
        '@record\nclass Inputs:\n    u: Ratio = real(0.0, "Input", tunable=True)\n'
    )
    with pytest.raises(TypeError, match="u is declared tunable, which only a parameter can be"):
        Interface(load(file))
