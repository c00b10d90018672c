"""The machines against another compiler and another integrator.

The machines are written in Modelica from textbooks, as free bodies held together by constraints, in the
files beside this one. rumoca reduces their index and integrates them; `oracle` integrates the FMUs.
"""

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import System, oracle

rumoca: Any = pytest.importorskip(
    "rumoca", reason="rumoca, the Modelica compiler of the group dev, is not installed"
)

FILES = ("motors.mo", "machines.mo", "shafts.mo", "drives.mo")
#: share of a column's range by which the two may differ beyond the error that `oracle` states, which is
#: larger only where flanks meet within a step: a promise of the docs
AGREEMENT = 1e-9
#: tolerance of both integrators, relative to a state: the tightest that `oracle` takes
TOLERANCE = 1e-13
#: tolerance of rumoca where its own rounding is larger than that, which it refuses
LOOSER = {"ControlledChain": 3e-13}
#: share by which drawn parameters differ from those of the Modelica model
SPREAD = 0.2
#: rows at which the two are compared
ROWS = 200


@dataclass(frozen=True)
class Part:
    """A Modelica class, the FMU of the same machine, and what the two call the same thing."""

    fmu: str
    parameters: Mapping[str, str]
    """names of the FMU by names in Modelica, of parameters and start values"""
    outputs: Mapping[str, str]
    """names of the FMU by names in Modelica"""
    switches: Mapping[str, Any] = field(default_factory=dict)
    """start values of the FMU that choose between the classes"""


def same(*names: str) -> dict[str, str]:
    """Names that are the same on both sides."""
    return {name: name for name in names}


CRANK = {
    "theta": "rotor.J", "r": "crank.r", "m": "trough.m", "alpha": "trough.d", "c": "spring.c",
    "phi0": "phi", "w0": "w",
}  # fmt: skip
COMPARED_STATES = same("phi", "w", "x", "v")
PARTS = {
    "LinearMotor": Part("DriveMotor", same("A", "B", "T") | {"tau0": "tau"}, same("tau")),
    "KlossMotor": Part(
        "DriveMotor",
        {"tau_b": "kloss.tau_b", "s_b": "kloss.s_b", "w_s": "kloss.w_s", "T": "T", "tau0": "tau"},
        same("tau"),
        {"characteristic": 1},
    ),
    "DirectCurrentMotor": Part("DCMotor", same("R", "L", "k") | {"i0": "i"}, same("i", "tau")),
    "Controller": Part(
        "SpeedController",
        same("K", "T_i", "T_t") | {"limit": "tau_max", "integral0": "tau_i"},
        {"integral": "tau_i", "wanted": "tau_free", "tau": "tau"},
    ),
    "Conveyor": Part("CrankConveyor", CRANK, COMPARED_STATES | {"force": "f_rod"}),
    "SliderCrank": Part(
        "CrankConveyor", CRANK | {"l": "rod.l"}, COMPARED_STATES | {"force": "f_rod"}, {"rod.finite": True}
    ),
    "Yoke": Part(
        "SlottedLink", CRANK | {"m_load": "load.m"}, COMPARED_STATES | {"force": "f_pin", "load": "f_load"}
    ),
    "SwingingLink": Part(
        "SlottedLink",
        CRANK | {"m_load": "load.m", "l": "link.l"},
        COMPARED_STATES | {"normal": "f_pin", "load": "f_load"},
        {"link.swings": True},
    ),
    "Exciter": Part(
        "UnbalanceExciter",
        {
            "J": "rotor.J", "m_u": "rotor.m", "r": "rotor.r", "friction": "rotor.d",
            "m": "mount.m", "c": "mount.c", "d": "mount.d",
            "phi0": "phi", "w0": "w", "x0": "x", "v0": "v",
        },
        COMPARED_STATES,
    ),
    "Shaft": Part(
        "ShaftLink", same("c", "d") | {"twist0": "twist"}, same("twist", "tau_a", "tau_b"), {"b": 0.0}
    ),
    "PlayingShaft": Part(
        "ShaftLink", same("c", "d", "b") | {"twist0": "twist"}, same("twist", "tau_a", "tau_b")
    ),
    "Gear": Part(
        "Gearbox",
        same("eta", "J") | {"ratio": "i", "w_small": "w_0", "w0": "w_a"},
        same("w_a", "w_b"),
    ),
}  # fmt: skip
INPUTS = {
    "LinearMotor": {"w": 39.0}, "KlossMotor": {"w": 45.0}, "Exciter": {"tau": 0.6},
    "DirectCurrentMotor": {"v": 48.0, "w": 180.0}, "Controller": {"w_ref": 40.0, "w": 35.0},
    "Conveyor": {"tau": 8.0}, "SliderCrank": {"tau": 8.0}, "Yoke": {"tau": 8.0},
    "SwingingLink": {"tau": 8.0}, "Shaft": {"w_a": 1.0, "w_b": 0.0},
    "PlayingShaft": {"w_a": 1.0, "w_b": 0.0}, "Gear": {"tau_a": 2.0, "tau_b": -15.0},
}  # fmt: skip
CHAIN = [
    "gear.w_a -> motor.w", "motor.tau -> gear.tau_a", "shaft.tau_a -> gear.tau_b",
    "gear.w_b -> shaft.w_a",
]  # fmt: skip
DRIVES: dict[str, tuple[dict[str, str], list[str]]] = {
    "DriveA": (
        {"motor": "LinearMotor", "conveyor": "Conveyor"},
        ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"],
    ),
    "DriveB": (
        {"motor": "KlossMotor", "conveyor": "SliderCrank"},
        ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"],
    ),
    "ControlledChain": (
        {"controller": "Controller", "motor": "DirectCurrentMotor", "gear": "Gear", "shaft": "Shaft",
         "conveyor": "Conveyor"},
        [*CHAIN, "controller.tau * 2.5 => motor.v", "gear.w_a -> controller.w",
         "conveyor.w -> shaft.w_b", "shaft.tau_b -> conveyor.tau"],
    ),
    "ShakenMotor": (
        {"motor": "DirectCurrentMotor", "exciter": "Exciter"},
        ["motor.tau -> exciter.tau", "exciter.w -> motor.w"],
    ),
    "LinkDrive": (
        {"motor": "LinearMotor", "link": "SwingingLink"},
        ["motor.tau -> link.tau", "link.w -> motor.w"],
    ),
    "GearedExciter": (
        {"motor": "DirectCurrentMotor", "gear": "Gear", "shaft": "Shaft", "exciter": "Exciter"},
        [*CHAIN, "exciter.w -> shaft.w_b", "shaft.tau_b -> exciter.tau"],
    ),
    "LooseChain": (
        {"motor": "LinearMotor", "gear": "Gear", "shaft": "PlayingShaft", "yoke": "Yoke"},
        [*CHAIN, "yoke.w -> shaft.w_b", "shaft.tau_b -> yoke.tau"],
    ),
}  # fmt: skip
#: inputs of drives that no wire feeds: the name of the FMU, and the parameter of the drive
SUPPLIES = {
    "ControlledChain": {"w_ref": "controller.w_ref"}, "ShakenMotor": {"supply": "motor.v"},
    "GearedExciter": {"supply": "motor.v"},
}  # fmt: skip
LONG = ("ControlledChain", "LooseChain")


@cache
def compile_model(name: str) -> Any:
    """The Modelica class; a single machine with its inputs as parameters of a bench."""
    folder = Path(__file__).parent
    source = "\n".join((folder / file).read_text(encoding="utf-8") for file in FILES)
    inputs = INPUTS.get(name, {})
    if inputs:
        lines = [
            "model Bench", f"  {name} part;",
            *(f"  parameter Real {x} = {value!r};" for x, value in inputs.items()),
            "equation", *(f"  part.{x} = {x};" for x in inputs), "end Bench;",
        ]  # fmt: skip
        source, name = source + "\n".join(lines), "Bench"
    return rumoca.Session().loads(source, model=name)


def parts_wires_names(name: str) -> tuple[dict[str, str], list[str], dict[str, str]]:
    """The parts of a drive by their classes, its wires, and names of the FMUs by those in Modelica."""
    parts, wires = DRIVES.get(name, ({"part": name}, []))
    names = {x: f"part.{x}" for x in INPUTS.get(name, {})} | SUPPLIES.get(name, {})
    for part, kind in parts.items():
        names |= {f"{part}.{x}": f"{part}.{y}" for x, y in PARTS[kind].parameters.items()}
    return parts, wires, names


@pytest.mark.parametrize("seed", [None, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=pytest.mark.slow if x in LONG else ()) for x in (*INPUTS, *DRIVES)],
)
def test_a_machine_moves_as_its_free_bodies_do(name: str, seed: int | None, native: Path) -> None:
    """With the parameters of the Modelica model, and with drawn ones; forces and all motions."""
    model = compile_model(name)
    parts, wires, names = parts_wires_names(name)
    draw = random.Random(seed)
    values = {x: model.parameters[x].value for x in names}
    if seed is not None:
        values = {x: y * draw.uniform(1 - SPREAD, 1 + SPREAD) for x, y in values.items()}
        values |= {x: min(y, 1.0) for x, y in values.items() if x.endswith(".eta")}
    kinds = {part: PARTS[kind] for part, kind in parts.items()}
    switches = {f"{p}.{x}": y for p, kind in kinds.items() for x, y in kind.switches.items()}
    system = System(
        {part: native / f"{kind.fmu}.fmu" for part, kind in kinds.items()},
        wires,
        {names[x]: y for x, y in values.items()} | switches,
    )
    columns = {f"{p}.{x}": f"{p}.{y}" for p, kind in kinds.items() for x, y in kind.outputs.items()}
    stop = 1.0
    ours = oracle(
        system, stop=stop, output_step=stop / ROWS, record=[*columns.values()], tolerance=TOLERANCE
    )
    tolerance = LOOSER.get(name, TOLERANCE)
    theirs = model.simulate(
        t=(0.0, stop),
        dt=stop / ROWS,
        params=values,
        config=rumoca.SimConfig(solver="rk-like", rtol=tolerance, atol=tolerance),
    )
    assert np.allclose(theirs.time, ours["time"], rtol=0.0, atol=1e-12)
    for modelica, column in columns.items():
        error = float(np.abs(theirs[modelica] - ours[column]).max())
        allowed = AGREEMENT * float(np.ptp(ours[column])) + ours.provenance["errors"][column]
        assert error <= allowed, (column, error, allowed)
