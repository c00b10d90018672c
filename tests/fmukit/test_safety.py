"""Whatever a host does to an FMU: it is refused by name and value, and the process lives on."""

import math
from pathlib import Path

import pytest

from components.drive_motor import model as drive_motor
from fmukit.declare.interface import Interface
from fmukit.fmu.python.pythonfmu import CallError
from fmukit.fmu.reference import by_equations
from tests.fmukit.test_native import MODELS, units
from tests.hosts import safety

MOTOR, CONVEYOR = "DriveMotor.fmu", "CrankConveyor.fmu"


@pytest.mark.parametrize("unit", safety.MISUSE)
def test_a_misuse_is_refused_and_harms_nobody(unit: str, both: Path, fmus: Path) -> None:
    refusals = safety.misuse(both / f"{unit}.fmu")
    assert len(refusals) == len(safety.MISUSE[unit])
    for reason, (refusal, plausible, *rest) in refusals.items():
        assert "unit 7: " in refusal
        assert reason in refusal
        assert plausible == []
        recovered, living, paths = rest
        assert (recovered, living, paths) == (1, int(both == fmus), 0), reason


@pytest.mark.parametrize("name", MODELS)
def test_every_number_out_of_its_bounds_is_refused_by_name(name: str, fmus: Path) -> None:
    """Parameters, start values and inputs, in all flavours; a reset leads out of each refusal."""
    for unit in units(name, fmus)[1:]:
        for variable in Interface(MODELS[name]).variables:
            d = variable.declaration
            wrong = [math.nan, math.inf] if d.fmi_type == "Real" else [99] if d.items else []
            if d.min is not None:
                wrong.append(d.min - 1.0)
            if d.positive:
                wrong.append(d.min)
            if d.max is not None:
                wrong.append(d.max + 1.0)
            for value in wrong if variable.settable_before_start else ():
                values = {variable.name: value}
                refusal = unit.refusal(lambda u, values=values: u.start(**values))
                assert f"unit: {variable.name} = {value!r}" in refusal
                assert "must be" in refusal
                unit.fmi.reset()
        assert all(map(math.isfinite, unit.start().outputs()))


def test_what_is_unusual_only_warns_and_a_percent_sign_harms_no_logger(both: Path) -> None:
    warning, outputs, refusal = safety.unusual(both / CONVEYOR)
    assert "100%s%n%d: crank.r = 0.15 m is not small compared with rod.l = 0.4 m" in warning
    assert all(map(math.isfinite, outputs))
    assert "100%s%n%d: communication step = 0.0 s" in refusal


def test_a_failure_does_not_swallow_the_warnings_before_it() -> None:
    slave = by_equations(drive_motor)(instance_name="unit 7")
    slave.warn("wear at 90 %")
    with pytest.raises(CallError) as failure:
        slave.do_step(0.0, 0.1)
    assert repr(failure.value).startswith("unit 7: unit 7: wear at 90 %%; doStep is not allowed")


@pytest.mark.parametrize(
    "damage", ["another build", "one bit", "cut", "nothing", "binary", "deep", "forged"]
)
def test_a_damaged_state_is_refused_and_rollback_leads_out(damage: str, both: Path) -> None:
    refusal, observed, same = safety.foreign_state(both / MOTOR, both / CONVEYOR, damage)
    assert "unit 7: FMU state is damaged or not of this build {" in refusal
    assert all(map(math.isnan, observed))
    assert same


def test_no_number_of_a_state_may_be_crafted_to_be_none(fmus: Path) -> None:
    """A state with NaN in what inputs do within a step was accepted, and gave NaN with status OK."""
    count, *accepted = safety.crafted_states(fmus / "native" / CONVEYOR)
    assert count > 30
    assert accepted == []


def torque(t: float) -> float:
    """Torque of the default motor held at 39 rad/s."""
    final = 8000.0 - 199.8 * 39.0
    return final + (8.0 - final) * math.exp(-t / 0.0625)


def test_a_foreign_thread_that_steps_twice_is_adopted(fmus: Path) -> None:
    values, threads = safety.on_foreign_threads(fmus / MOTOR, 1, 50)
    assert values == pytest.approx([torque(0.050)], rel=1e-12)
    assert threads > 1


def test_an_interrupt_during_a_step_is_a_failure_like_any_other(fmus: Path) -> None:
    refusal, outputs = safety.interrupt(fmus / CONVEYOR)
    assert "unit 7: KeyboardInterrupt" in refusal
    assert all(map(math.isfinite, outputs))
