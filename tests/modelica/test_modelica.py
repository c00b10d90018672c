"""The machines agree with Modelica models of theirs, which another compiler and integrator solve.

Each model beside this file is written from free-body diagrams: with forces of rods, pins and links as unknowns,
and velocities as derivatives of positions. Our components reduce the same machines by Lagrange's equations. The
compiler is rumoca; it differentiates the constraints itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import cosim
from cosim import System, Wire
from tests.conftest import ROOT

rumoca = pytest.importorskip("rumoca", reason="rumoca, the Modelica compiler, is not installed")

MODELS = Path(__file__).parent
#: ends of the runs [s]: some twenty revolutions at 40 rad/s would be 3 s; errors of a wrong term show in 0.5 s
STOP = 0.5
#: rows compared in each run, including the start
ROWS = 51
#: largest accepted difference, as a share of the largest value of the column; both integrations use
#: relative tolerances of 1e-12 or less
AGREEMENT = 1e-9
#: share by which each parameter of a drawn machine differs at most from its default
SPREAD = 0.2


class Case(NamedTuple):
    """A system of ours, and the Modelica model of the same machine."""

    model: str
    parts: dict[str, str]
    wires: dict[str, str]
    fixed: dict[str, float | bool | int]
    parameters: dict[str, str]
    states: dict[str, str]


MOTOR = {"motor.tau": "tau"}
CRANK = {"crank.phi": "phi", "crank.w": "w"}
LINEAR = {"motor.A": "A", "motor.B": "B", "motor.T": "T"}
TROUGH = {
    "crank.rotor.J": "J", "crank.crank.r": "r", "crank.trough.m": "m", "crank.trough.d": "d",
    "crank.spring.c": "c",
}  # fmt: skip
DRIVE = {"motor.tau": "crank.tau", "crank.w": "motor.w"}
CASES = (
    Case(
        "MotorConveyor",
        {"motor": "DriveMotor", "crank": "CrankConveyor"},
        DRIVE,
        {"crank.rod.finite": True},
        LINEAR | TROUGH | {"crank.rod.l": "l"},
        MOTOR | CRANK | {"crank.x": "x", "crank.v": "v", "crank.f_rod": "S"},
    ),
    Case(
        "InductionConveyor",
        {"motor": "DriveMotor", "crank": "CrankConveyor"},
        DRIVE,
        {"motor.characteristic": 1},
        TROUGH
        | {
            "motor.kloss.tau_b": "tau_b", "motor.kloss.s_b": "s_b", "motor.kloss.w_s": "w_s",
            "motor.T": "T",
        },
        MOTOR | CRANK | {"crank.x": "x", "crank.v": "v", "crank.f_rod": "F"},
    ),
    Case(
        "MotorSwingingLink",
        {"motor": "DriveMotor", "crank": "SlottedLink"},
        DRIVE,
        {"crank.link.swings": True},
        LINEAR | TROUGH | {"crank.link.l": "l", "crank.load.m": "m_load"},
        MOTOR | CRANK | {"crank.x": "x", "crank.v": "v", "crank.f_pin": "N"},
    ),
    Case(
        "GearedExciter",
        {"motor": "DCMotor", "gear": "Gearbox", "shaft": "ShaftLink", "rotor": "UnbalanceExciter"},
        {
            "motor.tau": "gear.tau_a", "gear.w_a": "motor.w", "gear.w_b": "shaft.w_a",
            "shaft.tau_a": "gear.tau_b", "rotor.w": "shaft.w_b", "shaft.tau_b": "rotor.tau",
        },
        {"shaft.b": 0.0, "motor.i": 10.0, "gear.w_a": 100.0, "shaft.twist": 0.001, "rotor.w": 20.0},
        {
            "motor.v": "U", "motor.R": "R", "motor.L": "L", "motor.k": "k", "gear.i": "i_gear", "gear.eta": "eta",
            "gear.J": "J_gear", "shaft.c": "c_shaft", "shaft.d": "d_shaft", "rotor.rotor.J": "J",
            "rotor.rotor.m": "m_u", "rotor.rotor.r": "r", "rotor.rotor.d": "d_r",
            "rotor.mount.m": "m", "rotor.mount.c": "c", "rotor.mount.d": "d",
        },
        {
            "motor.i": "i", "gear.w_a": "w_a", "shaft.twist": "twist", "rotor.phi": "phi",
            "rotor.w": "w", "rotor.x": "x", "rotor.v": "v", "shaft.tau_b": "T_shaft",
        },
    ),
)  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.model)
def test_a_modelica_model_gives_the_same_motion(case: Case, seed: int) -> None:
    """The defaults (seed 0) and machines drawn around them."""
    rng = np.random.default_rng(seed)
    model = rumoca.Session().load(MODELS / f"{case.model}.mo", model=case.model)
    scales = 1.0 + SPREAD * rng.uniform(-1.0, 1.0, len(case.parameters)) * (seed > 0)
    values = {
        ours: scale * model.parameters[theirs].value
        for (ours, theirs), scale in zip(case.parameters.items(), scales)
    }
    system = System(
        {name: ROOT / "fmus" / "native" / f"{fmu}.fmu" for name, fmu in case.parts.items()},
        [Wire(source, target) for source, target in case.wires.items()],
        case.fixed | values,
    )
    result = cosim.oracle(
        system, stop=STOP, output_step=STOP / (ROWS - 1), record=[*case.states], tolerance=1e-13
    )
    solution = model.simulate(
        (0.0, STOP),
        dt=STOP / (ROWS - 1),
        config=rumoca.SimConfig(solver="rk-like", rtol=1e-12, atol=1e-14),
        params={theirs: values[ours] for ours, theirs in case.parameters.items()},
    )
    # rumoca adds rows at events; the row of a time is the first that is not before it
    rows = np.searchsorted(solution.time, result["time"] - 1e-9 * STOP)
    assert np.asarray(solution.time)[rows] == pytest.approx(result["time"], abs=1e-9 * STOP)
    for ours, theirs in case.states.items():
        expected = np.asarray(solution[theirs])[rows]
        largest = np.abs(expected).max()
        assert result[ours] == pytest.approx(expected, rel=0.0, abs=AGREEMENT * largest), ours
