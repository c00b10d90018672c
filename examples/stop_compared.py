"""How much sooner does the conveyor stop with a quicker motor?"""

from cosim import System
from workbench import Figure, Judgement, Number, Question, Reader, RunOptions, option

LAGS = {"quick": 0.005, "slow": 0.1}


class StopCompared(Question, RunOptions):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    record = ("motor.tau", "conveyor.w")

    speed: float = option(40.0, "speed at the start", "rad/s", above=0.0)
    stop: float = option(0.5, "simulated time", "s", above=0.0)

    numbers = (
        Number(
            "half",
            Reader("first_crossing", "conveyor.w", level="0.5 * speed"),
            meaning="until half the speed is left",
        ),
    )

    def system(self, fmus):
        start = {"motor.A": 0.0, "motor.B": 35.8, "conveyor.w": self.speed}
        return {
            x: System(fmus, self.wires, {**start, "motor.T": T, **self.start})
            for x, T in LAGS.items()
        }

    def more_figures(self, f, results):
        quick, slow = f["quick_half"], f["slow_half"]
        error = quick.error + slow.error
        return {
            "sooner": Figure(slow.value - quick.value, "s", error, "sooner with the quick motor")
        }

    def judgements(self, f, results):
        return [Judgement("half the speed is left sooner by", f["sooner"])]
