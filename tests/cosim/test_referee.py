"""The referee's verdicts agree with independent integrations, and it names the mistakes that are put in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cosim import System, oracle, referee, run
from cosim.accuracy.referee.signals import Verdict

DRIVE_START = {
    "conveyor.phi": 0.3,
    "conveyor.w": 38.0,
    "motor.tau": 12.0,
    "motor.A": 7000.0,
    "motor.T": 0.05,
}
CHAIN_WIRES = (
    "controller.tau * 2.5 => motor.v",
    "gear.w_a -> motor.w",
    "gear.w_a -> controller.w",
    "motor.tau -> gear.tau_a",
    "shaft.tau_a -> gear.tau_b",
    "gear.w_b -> shaft.w_a",
    "load.w -> shaft.w_b",
    "shaft.tau_b -> load.tau",
)
CHAIN_START = {
    "controller.T_i": 0.2, "controller.w_ref": 100.0, "gear.i": 5.0, "gear.w_a": 0.0, "shaft.b": 0.002,
    "shaft.twist": 0.0, "load.crank.r": 0.004, "load.w": 0.0,
}  # fmt: skip


def drive(native: Path, **changes: Any) -> System:
    """The motor and the conveyor, all of whose important values are set."""
    parts = {"motor": native / "DriveMotor.fmu", "conveyor": native / "CrankConveyor.fmu"}
    wires = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    return replace(System(parts, wires, DRIVE_START), **changes)


def chain(native: Path, **changes: Any) -> System:
    """Controller, motor, gearbox, elastic shaft and a load, with a factor on a wire."""
    names = {
        "controller": "SpeedController", "motor": "DCMotor", "gear": "Gearbox", "shaft": "ShaftLink",
        "load": "SlottedLink",
    }  # fmt: skip
    parts = {name: native / f"{fmu}.fmu" for name, fmu in names.items()}
    return replace(System(parts, CHAIN_WIRES, CHAIN_START), **changes)


def orientator(native: Path, **changes: Any) -> System:
    """A hybrid machine: a product falls, tips and slides, one event after the other."""
    return replace(System({"orientator": native / "GravityOrientator.fmu"}), **changes)


def exact(system: System, stop: float, output_step: float = 1e-3) -> pd.DataFrame:
    """What a master without any error writes."""
    return oracle(system, stop=stop, output_step=output_step, tolerance=1e-11).frame


def swap(frame: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """The table with two columns crossed."""
    return frame.rename(columns={first: second, second: first})


def delayed(frame: pd.DataFrame, name: str, rows: int) -> pd.DataFrame:
    """The table with a column that is some rows late."""
    values = frame[name].to_numpy()
    return frame.assign(**{name: np.concatenate([np.full(rows, values[0]), values[:-rows]])})


def without(system: System, name: str) -> System:
    """The system without a start value."""
    return replace(system, start={k: v for k, v in system.start.items() if k != name})


def rewired(system: System, old: str, new: str) -> System:
    """The system with another wire in place of one."""
    assert old in system.wires
    return replace(system, wires=[new if wire == old else wire for wire in system.wires])


@dataclass(frozen=True)
class Mistake:
    """A mistake of a stranger: the system that he meant, what he got, and the words that name the mistake."""

    system: Callable[[Path], System]
    result: Callable[[System], pd.DataFrame]
    kind: str
    words: str


def coupled(
    algorithm: str, step: float, stop: float = 0.5, **settings: Any
) -> Callable[[System], Any]:
    """A master that couples like this."""
    return lambda s: (
        run(
            s, stop=stop, step=step, output_step=max(step, 1e-3), algorithm=algorithm, **settings
        ).frame
    )


CHANGED = {"changes": ["0.1 controller.w_ref = 140"]}
MISTAKES = {
    "Jacobi": Mistake(drive, coupled("jacobi", 1e-3), "held inputs", "0.001 s"),
    "Jacobi with short steps": Mistake(drive, coupled("jacobi", 2e-4), "held inputs", "0.0002 s"),
    "Jacobi in a chain": Mistake(chain, coupled("jacobi", 5e-4, 0.3), "held inputs", "0.0005 s"),
    "Gauss-Seidel": Mistake(
        drive, coupled("gauss-seidel", 2e-3, order=["conveyor", "motor"]), "step too long", "conveyor, motor"
    ),
    "Strang with long steps": Mistake(drive, coupled("strang", 5e-3), "step too long", "0.005 s"),
    "speed in rpm": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"conveyor.w": lambda f: f["conveyor.w"] * 30 / math.pi}),
        "unit", "rpm",
    ),
    "torque in kN.m": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"motor.tau": lambda f: f["motor.tau"] / 1000}),
        "unit", "kN.m",
    ),
    "opposite sign": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"motor.tau": lambda f: -f["motor.tau"]}), "sign", "motor.tau",
    ),
    "crossed columns": Mistake(
        drive, lambda s: swap(exact(s, 0.3), "motor.tau", "conveyor.tau_load"), "columns crossed",
        "conveyor.tau_load",
    ),
    "late column": Mistake(
        drive, lambda s: delayed(exact(s, 0.3), "conveyor.v", 4), "delay", "4 rows"
    ),
    "lost parameter": Mistake(
        drive, lambda s: exact(without(s, "motor.T"), 0.3), "lost start value", "motor.T"
    ),
    "lost state": Mistake(
        drive, lambda s: exact(without(s, "conveyor.phi"), 0.3), "lost start value", "conveyor.phi"
    ),
    "lost parameter set": Mistake(
        drive, lambda s: exact(replace(s, start={}), 0.3), "lost start value", "all start values"
    ),
    "lost parameter in a chain": Mistake(
        chain, lambda s: exact(without(s, "controller.T_i"), 0.3), "lost start value", "controller.T_i"
    ),
    "lost factor": Mistake(
        chain, lambda s: exact(rewired(s, CHAIN_WIRES[0], "controller.tau => motor.v"), 0.3), "lost factor",
        "2.5",
    ),
    "wires crossed": Mistake(
        chain,
        lambda s: exact(
            rewired(rewired(s, "motor.tau -> gear.tau_a", "shaft.tau_a -> gear.tau_a"),
                    "shaft.tau_a -> gear.tau_b", "motor.tau -> gear.tau_b"), 0.3),
        "wires crossed", "gear.tau_a",
    ),
    "wire of the opposite sign": Mistake(
        chain, lambda s: exact(rewired(s, CHAIN_WIRES[0], "controller.tau * -2.5 => motor.v"), 0.3),
        "lost factor", "opposite sign",
    ),
    "lost wire": Mistake(
        chain,
        lambda s: exact(replace(s, wires=[w for w in s.wires if not w.startswith("shaft.tau_a")]), 0.3),
        "lost wire", "shaft.tau_a",
    ),
    "missed change": Mistake(
        lambda native: chain(native, **CHANGED), lambda s: exact(replace(s, changes=()), 0.3), "lost input",
        "controller.w_ref",
    ),
    "constant offset": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"conveyor.phi": lambda f: f["conveyor.phi"] - 0.3}), "offset",
        "-0.3",
    ),
    "lost parameter and Jacobi": Mistake(
        drive, lambda s: coupled("jacobi", 1e-3)(without(s, "motor.T")), "lost start value", "motor.T"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(native: Path, name: str) -> None:
    mistake = MISTAKES[name]
    system = mistake.system(native)
    report = referee(system, mistake.result(system))
    assert report.verdict is Verdict.DIFFERS
    assert report.causes, report.text()
    cause = report.causes[0]
    assert cause.kind == mistake.kind and mistake.words in cause.text, report.text()
    assert cause.reduction >= 10.0
