"""How long does the conveyor run on when its motor is switched off?"""

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


class RunDown(Question, RunOptions):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    start_values = {"motor.A": 0.0, "motor.B": 35.8, "motor.T": "lag", "conveyor.w": "speed"}
    record = ("motor.tau", "conveyor.w", "conveyor.x")

    speed: float = option(40.0, "speed at the start", "rad/s", above=0.0)
    lag: float = option("20ms", "lag of the motor", "s", above=0.0)
    stop: float = option(0.5, "simulated time", "s", above=0.0)

    numbers = (
        Number(
            "tenth",
            Reader("first_crossing", "conveyor.w", level="0.1 * speed"),
            meaning="until a tenth of the speed is left",
        ),
        Number("brake", Reader("max", "-motor.tau"), "N.m", "largest braking torque"),
    )
    charts = (
        RunChart(
            "Run-down",
            "time [s]",
            [
                RunPanel("speed", {"conveyor.w": "blue"}, levels={"a tenth": "0.1 * speed"}),
                RunPanel("torque", {"motor.tau": "red"}),
            ],
        ),
    )
    sliders = (Slider("speed", 20.0, 60.0), Slider("lag", 0.005, 0.1))

    def judgements(self, f, r):
        return [
            Judgement("a tenth of the speed is left within half a second", f["tenth"], most=0.5),
            Judgement("largest braking torque", f["brake"]),
        ]
