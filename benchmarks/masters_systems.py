"""The five systems that `masters.py` runs in every master."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cosim import System

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Case:
    """A system, for how long it runs, with which steps [s], and a signal whose end is certified."""

    title: str
    system: System
    stop: float
    figure: str
    steps: tuple[float, ...] = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)


def cases(models: Path) -> dict[str, Case]:
    """The five systems; `models` is a folder for FMUs that are made here."""
    native = ROOT / "fmus" / "native"
    built = models / "native"
    turn = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    conveyor = {"motor": native / "DriveMotor.fmu", "conveyor": native / "CrankConveyor.fmu"}
    inertia = {"i": 1.0, "eta": 1.0}
    masses = {f"{part}.{x}": y for part in ("first", "second") for x, y in inertia.items()}
    return {
        "drive A": Case(
            "conveyor with a stiff drive", System(conveyor, turn), 0.5, "motor.tau"
        ),
        "drive B": Case(
            "conveyor with a soft drive",
            System(conveyor, turn, {"motor.A": 1440.0, "motor.B": 35.8, "motor.T": 0.02}),
            0.5,
            "motor.tau",
        ),
        "two masses": Case(
            "two masses on an elastic shaft",
            System(
                {"first": native / "Gearbox.fmu", "shaft": native / "ShaftLink.fmu",
                 "second": native / "Gearbox.fmu"},
                ["first.w_b -> shaft.w_a", "shaft.tau_a -> first.tau_b",
                 "second.w_a -> shaft.w_b", "shaft.tau_b -> second.tau_a"],
                masses | {"first.J": 1.1, "second.J": 2.2, "first.tau_a": 0.0,
                          "second.tau_b": 0.0, "first.w_a": 10.0, "second.w_a": 10.0,
                          "shaft.b": 0.0, "shaft.c": 1e4, "shaft.d": 1.0, "shaft.twist": 0.01},
            ),
            1.0,
            "shaft.twist",
        ),
        "controlled": Case(
            "direct-current motor with controller, gearbox and elastic shaft",
            System(
                {"controller": native / "SpeedController.fmu", "motor": native / "DCMotor.fmu",
                 "gear": native / "Gearbox.fmu", "shaft": native / "ShaftLink.fmu",
                 "conveyor": native / "CrankConveyor.fmu"},
                ["controller.tau => motor.v", "gear.w_a -> motor.w", "gear.w_a -> controller.w",
                 "motor.tau -> gear.tau_a", "shaft.tau_a -> gear.tau_b", "gear.w_b -> shaft.w_a",
                 "conveyor.w -> shaft.w_b", "shaft.tau_b -> conveyor.tau"],
                {"controller.K": 5.0, "controller.tau_max": 75.0, "controller.w_ref": 150.0,
                 "shaft.b": 0.0, "shaft.c": 4000.0, "shaft.twist": 0.0, "conveyor.w": 20.0},
            ),
            1.0,
            "conveyor.w",
        ),
        "quarter car": Case(
            "quarter car on a step of the road",
            System(
                {"wheel": built / "Wheel.fmu", "chassis": built / "Chassis.fmu"},
                ["wheel.z -> chassis.z_w", "wheel.v -> chassis.v_w", "chassis.z -> wheel.z_c",
                 "chassis.v -> wheel.v_c"],
            ),
            2.0,
            "chassis.z",
        ),
    }  # fmt: skip


def wire_ends(system: System) -> list[tuple[str, str]]:
    """Source and target of each wire; the wires here have no factors."""
    return [(a, b) for a, _, b in (str(wire).split() for wire in system.wires)]


def exchanged(system: System) -> list[str]:
    """The outputs that others take, in the order of the wires."""
    return list(dict.fromkeys(source for source, _ in wire_ends(system)))
