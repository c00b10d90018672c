"""The foreign FMU behaves, and misbehaves, as its names promise; driven by fmpy, without a master."""

import math
import subprocess
import sys
from collections.abc import Callable
from ctypes import byref
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2Discard,
    fmi2Error,
    fmi2Fatal,
    fmi2LastSuccessfulTime,
    fmi2Terminated,
)
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from tests.conftest import ROOT
from tests.cosim.foreign import DEFECTS, REFERENCES, TOKEN, VARIABLES, Value, pack, pack_broken
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


@pytest.mark.parametrize("dependencies", [True, False])
def test_the_description_is_valid(dependencies: bool, tmp_path: Path) -> None:
    fmu = pack(tmp_path / "A.fmu", dependencies=dependencies)
    assert validate_fmu(str(fmu)) == []
    z = next(u for u in fmpy.read_model_description(fmu).outputs if u.variable.name == "z")
    assert [v.name for v in z.dependencies or []] == (["u"] if dependencies else [])
    assert (z.dependencies is None) is not dependencies


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


def test_input_derivatives_hold_for_one_step(make: Make) -> None:
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


@pytest.mark.parametrize(("fresh", "z"), [(False, 1.0), (True, 2.0)])
def test_feedthrough_is_cached_or_fresh(fresh: bool, z: float, make: Make) -> None:
    unit = make(a=0.0, b=0.0, d=0.5, fresh=fresh).start()
    assert unit.step(0.0, H).set(u=2.0).get("z") == z
    assert unit.step(H, H).get("z") == 2.0


def test_in_initialisation_every_output_follows_its_input(make: Make) -> None:
    unit = make()
    unit.fmi.setupExperiment()
    unit.fmi.enterInitializationMode()
    for n in (1, 2):
        unit.set(u=float(n), x0=3.0, integer_in=n)
        assert (unit.get("y"), unit.get("z"), unit.get("integer_out")) == (3.0, 3.0 + 0.5 * n, n)
    assert unit.get("gets_after_set") == 0


@pytest.mark.parametrize(
    ("kind", "value"),
    [("integer", 7), ("boolean", True), ("string", "ä 100 %"), ("enumeration", 5)],
)
def test_echo_shows_what_was_set_before_the_step(kind: str, value: Any, make: Make) -> None:
    unit = make().start()
    before = unit.get(f"{kind}_out")
    unit.set(**{f"{kind}_in": value})
    assert unit.get(f"{kind}_out") == before
    after = unit.step(0.0, H).get(f"{kind}_out")
    assert (after.decode() if kind == "string" else after) == value
    assert after != before


@pytest.mark.parametrize("stop", [None, 0.0, 9.0])
@pytest.mark.parametrize("tolerance", [None, 1e-5])
def test_what_the_master_hands_over_is_told(
    stop: float | None, tolerance: float | None, make: Make
) -> None:
    unit = make()
    unit.fmi.setupExperiment(tolerance=tolerance, startTime=-2.5, stopTime=stop)
    unit.fmi.enterInitializationMode()
    told = [unit.get(name) for name in ("start_time", "stop_time", "tolerance")]
    assert told == [-2.5, stop or 0.0, tolerance or 0.0]
    defined = [unit.get("stop_time_defined"), unit.get("tolerance_defined")]
    assert defined == [stop is not None, tolerance is not None]
    assert unit.get("token").decode() == TOKEN


def test_calls_are_counted_through_rollback_and_reset(make: Make) -> None:
    unit = make().start()
    counters = ("steps", "states_alive", "restores", "gets_after_set")
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


def test_a_state_brings_everything_back(make: Make) -> None:
    unit = make().start(u=1.0).step(0.0, H)
    saved, before = state(unit), unit.outputs()[:6]
    unit.set(u=5.0, string_in="other", boolean_in=True).step(H, H)
    assert unit.outputs()[:6] != before
    unit.fmi.setFMUState(saved)
    assert unit.outputs()[:6] == before
    unit.step(H, H)


def test_a_return_that_was_excluded_is_refused(make: Make) -> None:
    unit = make().start()
    saved = state(unit)
    unit.fmi.doStep(0.0, H, 0)
    unit.fmi.doStep(H, H, 0)
    unit.fmi.setFMUState(saved)
    unit.fmi.doStep(0.0, H, 1)
    unit.fmi.setFMUState(saved)
    unit.fmi.doStep(0.0, H, 1)
    unit.fmi.doStep(H, H, 1)
    assert "before 0.1 s was excluded" in refused(unit.fmi.setFMUState, saved)


@pytest.mark.parametrize(("stubborn", "reached"), [(False, 0.04), (True, 0.0)])
def test_a_long_step_is_discarded(stubborn: bool, reached: float, make: Make) -> None:
    unit = make(a=0.0, b=1.0, x0=0.0, longest_step=0.04, stubborn=stubborn).start(u=1.0)
    saved = state(unit)
    refused(unit.fmi.doStep, 0.0, H, status=fmi2Discard)
    assert unit.fmi.getRealStatus(fmi2LastSuccessfulTime) == reached
    assert not unit.fmi.getBooleanStatus(fmi2Terminated)
    assert unit.get("y") == pytest.approx(reached)
    unit.fmi.setFMUState(saved)
    assert unit.step(0.0, 0.04).get("y") == pytest.approx(0.04)


@pytest.mark.parametrize("resumes", [True, False])
def test_after_a_discarded_step_some_go_on(resumes: bool, make: Make) -> None:
    unit = make(longest_step=0.04, resumes=resumes).start()
    refused(unit.fmi.doStep, 0.0, H, status=fmi2Discard)
    if resumes:
        assert unit.step(0.04, 0.02).get("y") == pytest.approx(math.exp(-0.06))
    else:
        assert refused(unit.fmi.doStep, 0.04, 0.02) == "fmi2DoStep while discarded"


def test_the_fmu_may_end_the_simulation(make: Make) -> None:
    unit = make(end_at=0.15).start().step(0.0, H)
    assert not unit.fmi.getBooleanStatus(fmi2Terminated)
    refused(unit.fmi.doStep, H, H, status=fmi2Discard)
    assert unit.fmi.getBooleanStatus(fmi2Terminated)
    assert unit.fmi.getRealStatus(fmi2LastSuccessfulTime) == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("start", "call", "reason"),
    [
        (
            {"canHandleVariableCommunicationStepSize": False},
            lambda unit: unit.step(0.0, H).step(H, H * (1 + 8e-10)).step(2 * H, H * (1 + 2e-9)),
            "h = 0.1000000002 s differs from the first one, 0.1 s",
        ),
        ({"canGetAndSetFMUstate": False}, state, "fmi2GetFMUstate while stepping"),
        (
            {"canInterpolateInputs": False},
            lambda unit: unit.fmi.setRealInputDerivatives(references("u"), [1], [1.0]),
            "inputs are not interpolated",
        ),
        (
            {},
            lambda unit: unit.fmi.setRealInputDerivatives(references("u"), [3], [1.0]),
            "no derivative of order 3",
        ),
        (
            {"maxOutputDerivativeOrder": 1},
            lambda unit: unit.fmi.getRealOutputDerivatives(references("y"), [2]),
            "order 2, at most 1",
        ),
        (
            {"providesDirectionalDerivative": False},
            lambda unit: directional(unit, "z"),
            "no directional derivatives",
        ),
        ({}, lambda unit: unit.step(0.0, 0.0), "h = 0 s must be above 0"),
        ({}, lambda unit: unit.step(0.0, H).step(0.11, H), "step from t = 0.11 s, not 0.1 s"),
        ({}, lambda unit: unit.set(a=-2.0), "cannot be set"),
        ({}, lambda unit: unit.set(y=1.0), "cannot be set"),
        ({}, lambda unit: unit.fmi.getReal([99]), "no such variable, reference 99"),
        ({}, lambda unit: unit.fmi.enterInitializationMode(), "while stepping"),
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


def directional(unit: Unit, name: str) -> float:
    return float(unit.fmi.getDirectionalDerivative(references(name), references("u"), [2.0])[0])


def test_directional_derivatives(make: Make) -> None:
    unit = make(d=0.75).start()
    assert [directional(unit, name) for name in ("y", "z")] == [0.0, 1.5]


@pytest.mark.parametrize("given", [True, False])
def test_some_need_their_input_in_initialisation(given: bool, make: Make) -> None:
    unit = make(needs_input=True, u=1.0).set(u=2.0)
    unit.fmi.setupExperiment()
    unit.fmi.enterInitializationMode()
    unit.set(integer_in=3)
    if given:
        unit.set(u=3.0).fmi.exitInitializationMode()
    else:
        reason = refused(unit.fmi.exitInitializationMode)
        assert reason == "unit 7: u was not set while initializing"


def test_a_warning_is_logged_once_with_its_numbers(make: Make) -> None:
    unit = make(warn_at=0.15).start()
    for n in range(3):
        unit.step(n * H, H)
    assert MESSAGES == ["t = 0.15 s in unit 7"]


def test_y_becomes_nan_at_its_time(make: Make) -> None:
    unit = make(nan_at=0.2).start()
    nan = [math.isnan(unit.step(n * H, H).get("y")) for n in range(3)]
    assert nan == [False, True, True]
    assert math.isfinite(unit.get("z"))


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


@pytest.mark.parametrize(("start", "code"), [({"crash_at": H}, -11), ({"exit_at": H}, 3), ({}, 0)])
def test_some_take_the_process_with_them(
    start: dict[str, Value], code: int, tmp_path: Path
) -> None:
    drive = "from tests.hosts.host import Unit; import sys; Unit(sys.argv[1]).start().step(0, 0.1)"
    fmu = pack(tmp_path / "A.fmu", **start)
    done = subprocess.run([sys.executable, "-c", drive, str(fmu)], check=False, cwd=ROOT)
    assert done.returncode == code


def test_the_diary_tells_how_an_instance_ended(make: Make, tmp_path: Path) -> None:
    diary = tmp_path / "diary.txt"
    unit = make(diary=str(diary)).start()
    state(unit)
    unit.fmi.terminate()
    assert diary.read_text() == "terminated unit 7\n"
    unit.fmi.freeInstance()
    assert diary.read_text() == "terminated unit 7\nleaked states unit 7\nfreed unit 7\n"


def test_some_live_only_once_in_a_process(tmp_path: Path) -> None:
    MESSAGES.clear()
    fmu = pack(tmp_path / "A.fmu", canBeInstantiatedOnlyOncePerProcess=True)
    first = Unit(fmu)
    with pytest.raises(Exception, match="Failed to instantiate"):
        Unit(fmu, "second")
    assert MESSAGES == ["second must wait: instances alive = 1"]
    first.fmi.freeInstance()
    Unit(fmu, "third").start()


def test_what_is_packed_is_what_starts(make: Make) -> None:
    start = {"a": -2.5, "string_in": "a b", "enumeration_in": 5, "boolean_in": True}
    unit = make(**start)
    for name, value in start.items():
        assert str(unit.variables[name].start) == str(value).lower()
    unit.start()
    assert [unit.get(n) for n in start] == [-2.5, b"a b", 5, 1]
    assert make(a=-2.5).description.guid != unit.description.guid
    with pytest.raises(TypeError, match="nonsense, y: no start value"):
        make(nonsense=1.0, y=2.0)


@pytest.mark.parametrize("capability", [v.name for v in VARIABLES if v.causality == "capability"])
def test_capabilities_stand_in_the_description(capability: str, make: Make) -> None:
    value = getattr(make().description.coSimulation, capability)
    value = value - 1 if capability == "maxOutputDerivativeOrder" else not value
    unit = make(**{capability: value})
    assert getattr(unit.description.coSimulation, capability) == value
    assert unit.start().step(0.0, H).get("y") == pytest.approx(math.exp(-H))


def test_resources_are_found_in_any_folder(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "A.fmu")
    folder = fmpy.extract(fmu, str(tmp_path / "ä + #100 %20"))
    guid = fmpy.read_model_description(fmu).guid
    unit = FMU2Slave(
        guid=guid, unzipDirectory=folder, modelIdentifier="foreign", instanceName="unit 7"
    )
    unit.instantiate()
    unit.enterInitializationMode()
    assert unit.getString(references("token"))[0].decode() == TOKEN


def test_it_does_no_model_exchange(tmp_path: Path) -> None:
    MESSAGES.clear()
    unit = Unit(pack(tmp_path / "A.fmu")).fmi
    where = Path(unit.unzipDirectory, "resources").as_uri().encode()
    call = (unit.guid.encode(), where, byref(unit.callbacks), 0, 1)
    assert unit.fmi2Instantiate(b"other", 0, *call) is None
    assert MESSAGES == ["type 0 is not co-simulation"]


@pytest.mark.parametrize("defect", DEFECTS)
def test_broken_fmus_are_broken_in_one_way(defect: str, tmp_path: Path) -> None:
    MESSAGES.clear()
    fmu = pack_broken(tmp_path / "A.fmu", defect)
    unreadable = {
        "no description": "no item named 'modelDescription.xml'",
        "malformed XML": "tag mismatch",
        "truncated": "not a zip file",
    }
    if defect in unreadable:
        with pytest.raises(Exception, match=unreadable[defect]):
            fmpy.read_model_description(fmu)
        return
    assert validate_fmu(str(fmu)) == []
    description = fmpy.read_model_description(fmu)
    assert description.fmiVersion == {"FMI 1.0": "1.0", "FMI 3.0": "3.0"}.get(defect, "2.0")
    assert (description.coSimulation is None) is (defect == "model exchange only")
    if defect in ("wrong GUID", "no binary"):
        with pytest.raises(Exception, match=r"instantiate|Cannot find shared library"):
            Unit(fmu)
        assert [m[:12] for m in MESSAGES] == (["the GUID {1}"] if defect == "wrong GUID" else [])


def test_unknown_defects_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="defect 'rust' must be one of FMI"):
        pack_broken(tmp_path / "A.fmu", "rust")
