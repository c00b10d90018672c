"""Model exchange: the native FMUs integrated by CVode, and called in every order that is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable
from ctypes import POINTER, c_double
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Model, fmi2Discard

from fmukit.declare.record import declarations
from fmukit.declare.record import start as begin
from fmukit.runtime import hybrid
from tests.fmukit.test_native import MODELS, NAMES, built
from tests.hosts.host import Unit, unpacked
from tests.oracle import events_and_end

STUCK = {"phi": 0.3, "w_cam": 3.0, "friction.K_up": 0.6, "friction.K_down": -0.9, "on_invalid": 1}
FLYING = {"stage": 3, "phi1": 0.7, "phi2": 5.8, "w1": -1.0, "w2": 15.0, "vyc": 1.0, "w": 2.0}
EXPERIMENTS: list[tuple[str, dict[str, Any], float]] = [
    *((name, {}, MODELS[name].EXPERIMENT.stop) for name in NAMES),
    ("DriveMotor", {"tau": 0.0, "characteristic": 1}, 0.3),
    ("CrankConveyor", {"rod.finite": True}, 0.3),
    ("IronDrive", STUCK | {"tau": 0.03}, 0.3),
    ("IronDrive", STUCK | {"tau": 0.0}, 0.3),
    ("IronDrive", {"tau": 0.1, "on_invalid": 1, "phi": 1.0, "w_cam": 12.0}, 0.2),
    *(("GravityOrientator", {"chute.mu": mu, "w": rpm * math.pi / 30}, 0.6)
      for mu, rpm in ((0.2, 100), (0.5, 60), (0.5, 75))),
    ("GravityOrientator", FLYING | {"release": False}, 0.3),
]  # fmt: skip


def simulate_case(fmu: Path, start: dict[str, Any], stop: float, kind: str, step: float) -> Any:
    """The outputs at every communication point, and the times of the events of model exchange."""
    outputs = [v.name for v in unpacked(str(fmu))[0].modelVariables if v.causality == "output"]
    actual = simulate_fmu(
        str(fmu), fmi_type=kind, stop_time=stop, output_interval=step, relative_tolerance=1e-13,
        start_values=start, output=outputs, record_events=True,
    )  # fmt: skip
    time = actual["time"]
    events = [before for before, after in pairwise(time) if before == after]
    last = np.append(time[1:] != time[:-1], True)
    regular = last & np.isclose(time / step, np.round(time / step), rtol=0.0, atol=1e-9)
    return actual[regular], events


def events_of(name: str, start: dict[str, Any], stop: float, step: float) -> list[float]:
    """The times of all events, from the equations as they are written."""
    model: Any = MODELS[name]
    p, x, u = (
        begin(cls, **{k: v for k, v in start.items() if k in dict(declarations(cls))})
        for cls in (model.Parameters, model.State, model.Inputs)
    )
    x = hybrid.sample(model, p, 0.0, model.complete_state(p, x), None, u)
    actual = []
    for n in range(round(stop / step)):
        *events, (_, x, _) = events_and_end(model, p, n * step, x, u, step)
        actual += [n * step + s for s, *_ in events]
        x = model.complete_state(p, x)
    return actual


#: Experiments that are played with FMUs of FMI 3.0, too; the others are slow there.
TRIED_3 = ("DriveMotor", {}), ("IronDrive", STUCK | {"tau": 0.03}), ("GravityOrientator", {})


@pytest.mark.parametrize(
    ("folder", "case"),
    [
        pytest.param(
            folder, case, id=f"{folder}-{case[0]}-{case[1]}-{case[2]}",
            marks=[pytest.mark.slow] if folder == "fmi3" and case[:2] not in TRIED_3 else [],
        )
        for folder in ("native", "fmi3")
        for case in EXPERIMENTS
    ],
)  # fmt: skip
def test_cvode_and_our_steps_agree(folder: str, case: Any, fmus: Path) -> None:
    """States and outputs to 1e-8 of their range or nominal, discrete ones and events at all points."""
    name, start, stop = case
    step = MODELS[name].EXPERIMENT.step
    fmu = built(name) if folder == "fmi3" else fmus / folder / f"{name}.fmu"
    ours, _ = simulate_case(fmu, start, stop, "CoSimulation", step)
    theirs, events = simulate_case(fmu, start, stop, "ModelExchange", step)
    assert len(ours) == len(theirs) == round(stop / step) + 1
    for variable in unpacked(str(fmu))[0].modelVariables:
        if variable.causality != "output":
            continue
        a, b = ours[variable.name], theirs[variable.name]
        if variable.type not in ("Real", "Float64"):
            assert np.array_equal(a, b), variable.name
            continue
        scale = max(np.max(np.abs(a)), float(variable.nominal or 0.0)) or 1.0
        assert np.max(np.abs(a - b)) <= 1e-8 * scale, variable.name
    if MODELS[name].event_indicators:
        expected = events_of(name, start, stop, step)
        assert events == pytest.approx(expected, rel=0.0, abs=1e-9)


def test_an_input_event_drops_a_product(fmus: Path) -> None:
    """The rising edge of `release` at 0.1 s, in event mode and at a communication point."""
    kinds = [("time", float), ("w", float), ("release", bool)]
    signals = np.array([(0.0, 4.0, False), (0.1, 4.0, False), (0.1, 4.0, True)], dtype=kinds)
    ends = [
        simulate_fmu(
            str(fmus / "native" / "GravityOrientator.fmu"), fmi_type=kind, stop_time=0.5,
            output_interval=0.01, relative_tolerance=1e-12, start_values={"release": False},
            input=signals, output=["since", "stage", "w2"], record_events=False,
        )[-1]
        for kind in ("CoSimulation", "ModelExchange")
    ]  # fmt: skip
    assert ends[0]["stage"] == ends[1]["stage"] > 0
    assert ends[0]["since"] > 0.1
    assert list(ends[1])[1:] == pytest.approx(list(ends[0])[1:], rel=0.0, abs=1e-8)


class Model(Unit):
    """An instance for model exchange; continuous states, derivatives and indicators as arrays."""

    def __init__(self, fmu: Path, **start: Any) -> None:
        super().__init__(fmu, "unit", FMU2Model)
        self.nx = self.description.numberOfContinuousStates
        self.nz = self.description.numberOfEventIndicators
        self.states = [u.variable.derivative.name for u in self.description.derivatives]
        self.start(**start)

    def all(self, what: str, count: int) -> np.ndarray:
        values = np.zeros(count)
        getattr(self.fmi, f"get{what}")(pointer(values), count)
        return values

    @property
    def x(self) -> np.ndarray:
        return self.all("ContinuousStates", self.nx)

    def at(self, x: Any) -> np.ndarray:
        """The derivatives and the Real outputs at these continuous states."""
        self.fmi.setContinuousStates(pointer(np.array(x)), self.nx)
        rates = self.all("Derivatives", self.nx)
        return np.array([*rates, *(self.get(n) for n in self.real_outputs())])

    def real_outputs(self) -> list[str]:
        return [
            n for n, v in self.variables.items() if v.causality == "output" and v.type == "Real"
        ]

    def iterate(self) -> int:
        """Update discrete states until they stay; how often."""
        for count in range(1, 9):
            if not self.fmi.newDiscreteStates()[0]:
                return count
        raise AssertionError

    def integrate(self) -> Model:
        self.iterate()
        self.fmi.enterContinuousTimeMode()
        return self


def pointer(values: np.ndarray) -> Any:
    return values.ctypes.data_as(POINTER(c_double))


REFUSED: tuple[tuple[str, Callable[[Model], Any], str], ...] = (
    ("event", lambda m: m.fmi.completedIntegratorStep(),
     "completedIntegratorStep is not allowed in event mode, only in continuous-time mode"),
    ("time", lambda m: m.fmi.newDiscreteStates(),
     "newDiscreteStates is not allowed in continuous-time mode, only in event mode"),
    ("time", lambda m: m.fmi.enterContinuousTimeMode(),
     "enterContinuousTimeMode is not allowed in continuous-time mode, only in event mode"),
    ("time", lambda m: m.fmi.setContinuousStates(pointer(np.zeros(3)), 3),
     "setContinuousStates takes all 2 values at once, not 3"),
    ("time", lambda m: m.fmi.getEventIndicators(pointer(np.zeros(3)), 3),
     "getEventIndicators takes all 0 values at once, not 3"),
    ("time", lambda m: m.set(w=1.0),
     "w = 1.0 rad/s cannot be set: continuous output, in continuous-time mode"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "call", "message"), REFUSED, ids=[message[:40] for *_, message in REFUSED]
)
def test_calls_out_of_order_are_refused_and_survived(
    mode: str, call: Callable[[Model], Any], message: str, fmus: Path
) -> None:
    model = Model(fmus / "native" / "CrankConveyor.fmu")
    if mode == "time":
        model.integrate()
    assert f"unit: {message}" in model.refusal(call)  # type: ignore[arg-type]
    assert math.isnan(model.get("w"))
    model.fmi.reset()
    model.start()
    assert model.integrate().get("w") == 40.0


def test_the_two_kinds_of_instance_refuse_each_other(fmus: Path) -> None:
    fmu = fmus / "native" / "IronDrive.fmu"
    slave, model = Unit(fmu).start(), Model(fmu)
    state = slave.fmi.getFMUstate()
    assert "is of an instance for co-simulation, but this one is for model exchange" in (
        model.refusal(lambda m: m.fmi.setFMUstate(state))
    )


def test_what_an_integrator_tries_is_discarded_where_it_has_no_value(fmus: Path) -> None:
    model = Model(fmus / "native" / "CrankConveyor.fmu").integrate()
    for tried in ([math.nan, 1.0], [1e300, 1e200]):
        with pytest.raises(FMICallException) as raised:
            model.at(tried)
        assert raised.value.status == fmi2Discard
    assert model.at([0.0, 40.0])[0] == 40.0


def test_a_host_that_overlooks_an_event_gets_a_message(fmus: Path) -> None:
    """The indicator is below zero only where the guard is; at zero it is not."""
    model = Model(fmus / "native" / "IronDrive.fmu", phi=0.9, w_cam=1.0).integrate()
    assert model.all("EventIndicators", model.nz)[0] > 0.0
    assert model.fmi.completedIntegratorStep() == (False, False)
    model.at([0.9, 0.0, 0.0])
    assert 0.0 < model.all("EventIndicators", model.nz)[0] < 1e-300
    model.at([0.9, -0.01, 0.0])
    assert model.all("EventIndicators", model.nz)[0] < 0.0
    assert model.fmi.completedIntegratorStep() == (True, False)
    model.fmi.enterEventMode()
    assert model.fmi.newDiscreteStates()[3]
    assert model.get("w_cam") == 0.0
    assert model.get("direction") == -1
