"""The foreign FMU steps exactly, and refuses and counts what a master must not do to it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Discard, fmi2Error, fmi2Fatal
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from tests.cosim.foreign import REFERENCES, Value, pack
from tests.hosts.host import MESSAGES, Unit

Make = Callable[..., Unit]
H = 0.1


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """An instance of an FMU with these start values and capabilities, not yet initialised."""

    def unit(**start: Value) -> Unit:
        MESSAGES.clear()
        return Unit(pack(tmp_path / f"{len(list(tmp_path.iterdir()))}.fmu", **start), "unit 7")

    return unit


def refused(call: Callable[..., Any], *arguments: Any, status: int = fmi2Error) -> str:
    """What was logged last when a call returns this status."""
    with pytest.raises(FMICallException) as failure:
        call(*arguments)
    assert failure.value.status == status
    return MESSAGES[-1] if MESSAGES else ""


def references(*names: str) -> list[int]:
    return [REFERENCES[name] for name in names]


def integrated(a: float, b: float, x: float, u: Callable[[float], float]) -> float:
    """x(H) of x' = a x + b u(t)."""
    path = solve_ivp(lambda t, y: a * y + b * u(t), (0.0, H), [x], "DOP853", rtol=1e-13, atol=1e-13)
    return float(path.y[0, -1])


def state(unit: Unit) -> Any:
    return unit.fmi.getFMUState()


def test_the_description_is_valid(tmp_path: Path) -> None:
    assert validate_fmu(str(pack(tmp_path / "A.fmu"))) == []


@pytest.mark.parametrize("a", [-3.0, 0.0, 40.0, -40.0])
@pytest.mark.parametrize(("slope", "bend"), [(0.0, 0.0), (7.0, 0.0), (7.0, -30.0)])
def test_a_step_is_exact(a: float, slope: float, bend: float, make: Make) -> None:
    unit = make(a=a, b=2.0, x0=0.5).start(u=1.5)
    if slope:
        unit.fmi.setRealInputDerivatives(2 * references("u"), [1, 2], [slope, bend])
    unit.step(0.0, H)
    end = integrated(a, 2.0, 0.5, lambda t: 1.5 + slope * t + bend * t * t / 2)
    assert unit.get("y") == pytest.approx(end, rel=1e-11)
    u = 1.5 + slope * H + bend * H * H / 2
    assert unit.get("z") == pytest.approx(end + 0.5 * u, rel=1e-11)
    assert unit.get("u") == pytest.approx(u, rel=1e-14)


def test_input_derivatives_hold_for_a_single_step(make: Make) -> None:
    unit = make().start()
    unit.fmi.setRealInputDerivatives(references("u"), [1], [1.0])
    unit.step(0.0, H).step(H, H)
    assert unit.get("u") == pytest.approx(H)


def test_output_derivatives_are_those_at_the_end_of_the_step(make: Make) -> None:
    unit = make(a=-2.0, b=3.0, d=0.5).start(u=1.0)
    unit.fmi.setRealInputDerivatives(2 * references("u"), [1, 2], [4.0, 6.0])
    unit.step(0.0, H)
    y, u, du, ddu = unit.get("y"), 1.0 + 4.0 * H + 3.0 * H * H, 4.0 + 6.0 * H, 6.0
    dy = -2.0 * y + 3.0 * u
    ddy = -2.0 * dy + 3.0 * du
    got = unit.fmi.getRealOutputDerivatives(references("y", "y", "z", "z"), [1, 2, 1, 2])
    assert got == pytest.approx([dy, ddy, dy + 0.5 * du, ddy + 0.5 * ddu], rel=1e-13)


def test_calls_are_counted_through_rollback_and_reset(make: Make) -> None:
    unit = make().start()
    counters = ("steps", "live_states", "restores", "gets_after_set")
    saved = state(unit)
    other = state(unit)
    unit.step(0.0, H).step(H, H / 2)
    assert unit.get("last_step") == H / 2
    unit.set(u=1.0).get("y")
    unit.fmi.freeFMUState(other)
    unit.fmi.reset()
    unit.start()
    assert unit.get("y") == 1.0
    assert [unit.get(name) for name in counters] == [2, 1, 0, 1]
    for n in (1, 2):
        unit.fmi.setFMUState(saved)
        assert [unit.get(name) for name in counters] == [2, 1, n, 1]


def test_a_get_after_a_set_is_counted_until_the_next_step(make: Make) -> None:
    unit = make().start()
    unit.step(0.0, H).get("y")
    assert unit.get("gets_after_set") == 0
    unit.set(integer_in=3).get("u")
    assert unit.step(H, H).get("gets_after_set") == 0
    unit.set(u=1.0).get("y")
    unit.get("string_out")
    assert unit.step(2 * H, H).get("gets_after_set") == 2
    unit.fmi.setRealInputDerivatives(references("u"), [1], [1.0])
    unit.fmi.getRealOutputDerivatives(references("y"), [1])
    unit.step(3 * H, H).fmi.getRealOutputDerivatives(references("y"), [1])
    assert unit.get("gets_after_set") == 3


def test_a_return_that_was_excluded_is_refused(make: Make) -> None:
    unit = make(commits=True).start()
    saved = state(unit)
    unit.fmi.doStep(0.0, H, 0)
    unit.fmi.doStep(H, H, 0)
    unit.fmi.setFMUState(saved)
    unit.fmi.doStep(0.0, H, 1)
    unit.fmi.setFMUState(saved)
    unit.fmi.doStep(0.0, H, 1)
    unit.fmi.doStep(H, H, 1)
    assert "before 0.1 s was excluded" in refused(unit.fmi.setFMUState, saved)


STEADY = "canHandleVariableCommunicationStepSize"


def drifting(unit: Unit) -> Unit:
    return unit.step(0.0, H).step(H, H * (1 + 8e-10)).step(2 * H, H * (1 + 2e-9))


def sloped(order: int) -> Callable[[Unit], Any]:
    return lambda unit: unit.fmi.setRealInputDerivatives(references("u"), [order], [1.0])


def second_rate(unit: Unit) -> Any:
    return unit.fmi.getRealOutputDerivatives(references("y"), [2])


def after_discard(unit: Unit) -> Unit:
    refused(unit.fmi.doStep, 0.0, H, status=fmi2Discard)
    return unit


@pytest.mark.parametrize(
    ("start", "call", "reason"),
    [
        ({STEADY: False}, drifting, "h = 0.1000000002 s differs from the first one, 0.1 s"),
        ({"canGetAndSetFMUstate": False}, state, "fmi2GetFMUstate while stepping"),
        ({"canInterpolateInputs": False}, sloped(1), "inputs are not interpolated"),
        ({}, sloped(3), "no derivative of order 3"),
        ({"maxOutputDerivativeOrder": 1}, second_rate, "order 2, at most 1"),
        ({}, lambda unit: unit.step(0.0, 0.0), "h = 0 s must be above 0"),
        ({}, lambda unit: unit.step(0.0, H).step(0.11, H), "step from t = 0.11 s, not 0.1 s"),
        ({}, lambda unit: unit.set(b=-2.0), "cannot be set"),
        ({}, lambda unit: unit.set(y=1.0), "cannot be set"),
        ({}, lambda unit: unit.fmi.getReal([99]), "no such variable, reference 99"),
        ({}, lambda unit: unit.fmi.enterInitializationMode(), "while stepping"),
        ({"longest_step": 0.01}, lambda unit: after_discard(unit).step(0.01, H), "while discarded"),
        ({"error_at": 0.2}, lambda unit: unit.step(0.0, H).step(H, H), "t = 0.2 s, step 2"),
    ],
)
def test_what_it_cannot_do_ends_in_an_error(
    start: dict[str, Value], call: Callable[[Unit], Any], reason: str, make: Make
) -> None:
    unit = make(**start).start()
    assert reason in refused(call, unit)
    assert "while failed" in refused(unit.fmi.terminate)


def test_a_step_beyond_the_stop_time_is_refused(make: Make) -> None:
    unit = make()
    unit.fmi.setupExperiment(stopTime=0.3)
    unit.fmi.enterInitializationMode()
    unit.fmi.exitInitializationMode()
    unit.step(0.0, 0.1).step(0.1, 0.2)
    assert "beyond the stop time 0.3 s" in refused(unit.fmi.doStep, 0.3, 0.001)


@pytest.mark.parametrize("is_set", [True, False])
def test_some_need_their_input_in_initialisation(is_set: bool, make: Make) -> None:
    unit = make(needs_input=True, u=1.0).set(u=2.0)
    unit.fmi.setupExperiment()
    unit.fmi.enterInitializationMode()
    unit.set(integer_in=3)
    if is_set:
        unit.set(u=3.0).fmi.exitInitializationMode()
    else:
        reason = refused(unit.fmi.exitInitializationMode)
        assert reason == "unit 7: u was not set while initializing"


@pytest.mark.parametrize("at", [0.0, 0.1])
def test_after_a_breakdown_nothing_may_be_called(at: float, make: Make, tmp_path: Path) -> None:
    diary = tmp_path / "diary.txt"
    unit = make(fatal_at=at, diary=str(diary))
    reason = refused(lambda: unit.start().step(0.0, H), status=fmi2Fatal)
    assert reason == f"unit 7 broke down at t = {at:g} s"
    assert not diary.exists()
    refused(unit.fmi.terminate, status=fmi2Fatal)
    unit.fmi.freeInstance()
    assert diary.read_text() == 2 * "used after fatal unit 7\n" + "freed unit 7\n"


def test_the_diary_says_how_an_instance_ended(make: Make, tmp_path: Path) -> None:
    diary = tmp_path / "diary.txt"
    unit = make(diary=str(diary)).start()
    state(unit)
    unit.fmi.terminate()
    assert diary.read_text() == "terminated unit 7\n"
    unit.fmi.freeInstance()
    assert diary.read_text() == "terminated unit 7\nleaked states unit 7\nfreed unit 7\n"
