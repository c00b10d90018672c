"""Does a number have its error?"""

# ruff: noqa: F401, RUF012 - the mistakes of refusals.toml use what is imported here

from cosim import System
from cosim.metrics import Integral
from workbench import (
    Judgement,
    Number,
    Question,
    Reader,
    RunChart,
    RunOptions,
    RunPanel,
    Slider,
    option,
)


class Turning(Question, RunOptions):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    start_values = {"conveyor.w": "speed"}

    speed: float = option(40.0, "speed at the start", "rad/s", above=0.0)
    stop: float = option(0.5, "simulated time", "s", above=0.0)

    numbers = (
        Number("torque", Reader("max", "motor.tau"), "kN.m"),
        Number("time", Reader("time_of_max", "motor.tau")),
    )
    record = ("conveyor.w",)
    charts = (RunChart("Turning", "time [s]", [RunPanel("torque", {"motor.tau": "red"})]),)
    sliders = (Slider("speed", 20.0, 60.0),)

    def judgements(self, f, r):
        return [Judgement("in time", f["time"], most=0.4)]
