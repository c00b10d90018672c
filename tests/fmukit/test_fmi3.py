"""FMUs of FMI 3.0: the numbers of those of 2.0, and what 3.0 has more."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, fmi3, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from fmukit.declare.interface import component_name
from fmukit.fmu.validate import problems
from tests.conftest import TRIED
from tests.fmukit.test_exchange import STUCK, events_of
from tests.fmukit.test_native import MODELS, NAMES, SCENARIOS, built
from tests.hosts.host import Unit

sampled = pytest.mark.parametrize(
    "name",
    [
        n if component_name(MODELS[n]) in TRIED else pytest.param(n, marks=pytest.mark.slow)
        for n in NAMES
    ],
)
MESSAGES: list[str] = []
FOLDERS: list[Any] = []


@functools.cache
def unpacked(fmu: Path) -> tuple[Any, str]:
    FOLDERS.append(tempfile.TemporaryDirectory(prefix="fmi3_"))
    return read_model_description(str(fmu)), extract(str(fmu), FOLDERS[-1].name)


class Unit3(Unit):
    """One instance for co-simulation, its variables by name."""

    def __init__(self, name: str, kind: Any = fmi3.FMU3Slave, **options: Any) -> None:
        self.description, folder = unpacked(built(name))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.fmi = kind(
            guid=self.description.guid, unzipDirectory=folder, modelIdentifier=name,
            instanceName="unit",
        )  # fmt: skip
        MESSAGES.clear()
        log = lambda environment, status, category, text: MESSAGES.append(text.decode())
        self.fmi.instantiate(logMessage=log, **options)

    def _access(self, verb: str, name: str) -> tuple[Callable[..., Any], list[int]]:
        kind = self.variables[name].type.replace("Enumeration", "Int64")
        return getattr(self.fmi, verb + kind), [self.variables[name].valueReference]

    def start(self, t: float = 0.0, **values: Any) -> Unit3:
        self.set(**values).fmi.enterInitializationMode(startTime=t)
        self.fmi.exitInitializationMode()
        return self

    def update(self) -> None:
        """Events until there are none, then steps."""
        while self.fmi.updateDiscreteStates()[0]:
            pass
        self.fmi.enterStepMode()


@sampled
def test_the_description_is_valid_and_has_the_same_variables(name: str, fmus: Path) -> None:
    fmu = built(name)
    assert validate_fmu(str(fmu)) == []
    assert problems(fmu) == []
    new, _ = unpacked(fmu)
    old = read_model_description(str(fmus / "native" / f"{name}.fmu"))
    more = new.modelVariables[len(old.modelVariables) :]
    for mine, theirs in zip(old.modelVariables, new.modelVariables):
        assert (mine.name, mine.valueReference) == (theirs.name, theirs.valueReference)
        assert (mine.start, mine.unit, mine.nominal) == (theirs.start, theirs.unit, theirs.nominal)
        assert (mine.derivative and mine.derivative.name) == (
            theirs.derivative and theirs.derivative.name
        )
    assert [v.name for v in more] == [
        *(f"event_indicator_{n + 1}" for n in range(old.numberOfEventIndicators)),
        "time",
    ]
    assert new.numberOfEventIndicators == old.numberOfEventIndicators
    assert new.numberOfContinuousStates == old.numberOfContinuousStates


@sampled
def test_steps_are_those_of_fmi_2_to_the_last_bit(name: str, fmus: Path) -> None:
    for case in [case for case in SCENARIOS if case[0] == name][:3]:
        _, start, inputs, h, steps = case
        old = Unit(fmus / "native" / f"{name}.fmu").start(**start, **inputs(0.0))
        new = Unit3(name).start(**start, **inputs(0.0))
        for n in range(min(steps, 400)):
            old.set(**inputs(n * h)).step(n * h, h)
            new.set(**inputs(n * h)).fmi.doStep(n * h, h)
            assert new.outputs() == old.outputs()


@pytest.mark.parametrize(
    ("name", "start", "stop"),
    [
        ("IronDrive", STUCK | {"tau": 0.03}, 0.3),
        ("IronDrive", {"tau": 0.1, "on_invalid": 1, "phi": 1.0, "w_cam": 12.0}, 0.2),
        ("GravityOrientator", {}, 0.3),
    ],
)
def test_a_step_ends_at_its_first_event_where_the_importer_allows_it(
    name: str, start: dict[str, Any], stop: float, fmus: Path
) -> None:
    unit = Unit3(name, eventModeUsed=True, earlyReturnAllowed=True).start(**start)
    unit.update()
    actual, t, h = [], 0.0, 0.05
    for n in range(1, round(stop / h) + 1):
        while t < n * h:
            event, terminate, early, t_new = unit.fmi.doStep(t, n * h - t)
            assert event == early == (t_new < n * h) and not terminate
            t = t_new
            if event:
                actual.append(t)
                unit.fmi.enterEventMode()
                unit.update()
    expected = events_of(name, start, stop, h)
    assert actual == pytest.approx(expected, rel=0.0, abs=1e-11)
    assert actual
    plain = Unit(fmus / "native" / f"{name}.fmu").start(**start)
    for n in range(round(stop / h)):
        plain.step(n * h, h)
    for mine, theirs in zip(unit.outputs(), plain.outputs(), strict=True):
        assert mine == pytest.approx(theirs, rel=1e-9, abs=1e-9)


def test_new_inputs_act_in_event_mode() -> None:
    unit = Unit3("GravityOrientator", eventModeUsed=True).start(release=False)
    unit.update()
    unit.fmi.doStep(0.0, 0.1)
    assert unit.get("stage") == 6
    unit.fmi.enterEventMode()
    unit.set(release=True).update()
    assert unit.get("stage") == 0
    assert unit.get("since") == unit.get("time") == 0.1


@pytest.mark.parametrize("events", [False, True])
def test_an_importer_sees_within_a_step_what_shorter_steps_reach(events: bool) -> None:
    observed: list[tuple[float, float]] = []

    def look(_: Any, time: float, settable: bool, gettable: bool, done: bool, *rest: Any) -> None:
        assert (settable, gettable, done) == (False, True, True)
        observed.append((time, unit.get("w_cam")))

    start = {"phi": 0.6, "w_cam": 2.0}
    options = {"eventModeUsed": events, "earlyReturnAllowed": events}
    unit = Unit3("IronDrive", intermediateUpdate=look, **options).start(**start)
    if events:
        unit.update()
    unit.fmi.doStep(0.0, 0.04)
    assert [t for t, _ in observed] == pytest.approx([0.005 * n for n in range(1, 8)], rel=1e-12)
    for time, w in observed:
        shorter = Unit3("IronDrive").start(**start)
        shorter.fmi.doStep(0.0, time)
        assert w == pytest.approx(shorter.get("w_cam"), rel=1e-10)
    plain = Unit3("IronDrive").start(**start)
    plain.fmi.doStep(0.0, 0.04)
    assert unit.outputs() == plain.outputs()


def test_what_is_not_in_order_is_refused_with_the_reason() -> None:
    def refusal(unit: Any, call: Callable[[], Any]) -> str:
        with pytest.raises(FMICallException) as raised:
            call()
        assert raised.value.status == fmi3.fmi3Error
        unit.fmi.reset()
        return MESSAGES[-1]

    unit = Unit3("DriveMotor").start()
    assert "made without event mode" in refusal(unit, unit.fmi.enterEventMode)
    unit.start()
    assert "A is of type Float64, not Int32" in refusal(unit, lambda: unit.fmi.getInt32([1]))
    message = refusal(unit, lambda: unit.set(**{"der(tau)": 1.0}))
    assert "unit: der(tau) = 1.0 N.m/s cannot be set: continuous local, before init" in message
    assert "time can only be set by setTime" in refusal(unit, lambda: unit.set(time=1.0))
    unit.start()
    assert "communication step = 0.0 s must be a finite number above 0" in refusal(
        unit, lambda: unit.fmi.doStep(0.0, 0.0)
    )
    refused: list[str] = []

    def meddle(*_: Any) -> None:
        with pytest.raises(FMICallException):
            meddled.set(w=1.0)
        refused.append(MESSAGES[-1])

    meddled = Unit3("DriveMotor", intermediateUpdate=meddle).start()
    meddled.fmi.doStep(0.0, 0.01)
    assert refused == 7 * ["unit: setFloat64 is not allowed within a step"]
    assert meddled.get("w") == 40.0
    with pytest.raises(Exception, match="Failed to instantiate"):
        Unit3("DriveMotor", fmi3.FMU3ScheduledExecution)
    assert "not for scheduled execution" in MESSAGES[-1]
