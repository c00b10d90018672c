"""How much work does a motor that brakes take from the conveyor?"""

from dataclasses import dataclass

from cosim import System
from workbench import Run, Table, option
from workbench.live import Live, Number, Reader, RunChart, RunPanel, Slider
from workbench.measure import extended, integral, largest

PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    stop: float = option(0.5, "simulated time", "s", above=0.0)


def system(o, fmus):
    return System(fmus, WIRES, {"motor.A": 0.0, "conveyor.w": 40.0, **o.start})


def process(o, r):
    return extended(r, "W", {"power": -r["motor.tau"] * r["conveyor.w"]})


def figures(o, r):
    work, brake = integral(r["time"], r["power"]), largest(r["time"], -r["motor.tau"])
    return {"work": work.figure("J", "work on the motor"), "brake": brake.figure("N.m", "brake")}


def tables(o, f, r):
    return {"brake_steps.csv": Table.of_rows([(f["brake"].value,)], {"brake": "N.m"})}


LIVE = Live(
    sliders=(Slider("motor.B", 5.0, 90.0),),
    charts=[RunChart("Braking", "time [s]", [RunPanel("torque", {"motor.tau": "red"})])],
    numbers=[Number("brake", Reader("max", "-motor.tau"))],
)
