"""The packing line: its FMUs, how they are coupled, and what is recorded of them."""

from cosim import Result
from cosim.series import Column
from workbench.charts.model import POWER

from ..iron import motion as iron_motion
from ..orientator import motion as orientator_motion

PARTS = {
    "iron_motor": "DriveMotor",
    "iron": "IronDrive",
    "orientator": "GravityOrientator",
    "conveyor_motor": "DriveMotor",
    "conveyor": "CrankConveyor",
}
WIRES = (
    "iron_motor.tau -> iron.tau",
    "iron.w -> iron_motor.w",
    "iron.top_dwell -> orientator.release",
    "conveyor_motor.tau -> conveyor.tau",
    "conveyor.w -> conveyor_motor.w",
)
#: Gear ratio of the reducer of the iron drive, the default of its FMU.
I_G = 36.0
RECORD = (
    "iron_motor.P", "iron_motor.tau", *(f"iron.{x}" for x in iron_motion.COLUMNS), "iron.w_cam",
    "iron.top_dwell", "iron.E_kin", "iron.E_pot", "iron.E_friction",
    *(f"orientator.{x}" for x in orientator_motion.COLUMNS), "orientator.reason",
    "orientator.orientation_time", "orientator.oriented", "orientator.jammed", "orientator.missed",
    "conveyor_motor.P", "conveyor_motor.tau", "conveyor.phi", "conveyor.w", "conveyor.x",
    "conveyor.E_kin", "conveyor.E_pot", "conveyor.P_loss",
)  # fmt: skip
POWERS = {
    "iron": ("iron_motor.P", "the iron's motor", "gold"),
    "conveyor": ("conveyor_motor.P", "the conveyor's motor", "sky"),
    "supply": ("P_supply", "the supply", POWER),
}


def add_supply_power(r: Result) -> Result:
    """Return the run with the power of the supply, which is that of both motors."""
    power = r["iron_motor.P"] + r["conveyor_motor.P"]
    of = ("iron_motor.P", "conveyor_motor.P")
    return r.with_columns({Column("P_supply", r.units["iron_motor.P"]): power}, of)
