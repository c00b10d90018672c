"""How much work does a motor that brakes take from the conveyor?"""

from cosim import Column
from cosim.metrics import Integral
from workbench import (
    Number,
    Question,
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Slider,
    Table,
    option,
)


class BrakeWork(Question, RunOptions):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    start_values = {"motor.A": 0.0, "conveyor.w": 40.0}

    stop: float = option(0.5, "simulated time", "s", above=0.0)

    numbers = (
        Number("work", Integral("power"), "J", "work on the motor"),
        Number("brake", Reader("max", "-motor.tau"), "N.m", "brake"),
    )
    charts = (RunChart("Braking", "time [s]", [RunPanel("torque", {"motor.tau": "red"})]),)
    sliders = (Slider("motor.B", 50.0, 400.0),)

    def process(self, r):
        power = -r["motor.tau"] * r["conveyor.w"]
        return r.with_columns({Column("power", "W"): power}, of=("motor.tau", "conveyor.w"))

    def tables(self, f, r):
        return {"brake_steps.csv": Table.of_rows([(f["brake"].value,)], {"brake": "N.m"})}
