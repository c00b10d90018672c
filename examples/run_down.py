"""How long does the conveyor run on when its motor is switched off?"""

from cosim import System
from workbench import Chart, Curve, Judgement, Mark, Panel, Question, Run, Show, option
from workbench.measure import crossing, largest


class RunDown(Question, Run):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    record = ("motor.tau", "conveyor.w", "conveyor.x")

    speed: float = option(40.0, "speed at the start", "rad/s", above=0.0)
    lag: float = option("20ms", "lag of the motor", "s", above=0.0)
    stop: float = option(0.5, "simulated time", "s", above=0.0)

    def system(self, fmus):
        no_supply = {"motor.A": 0.0, "motor.B": 35.8, "motor.T": self.lag, "conveyor.w": self.speed}
        return System(fmus, self.wires, {**no_supply, **self.start})

    def figures(self, r):
        t, w, unit = r["time"], r["conveyor.w"], r.units["motor.tau"]
        down = crossing(t, w, 0.1 * self.speed)
        return {
            "tenth": down.figure("s", "until a tenth of the speed is left"),
            "brake": largest(t, -r["motor.tau"]).figure(unit, "largest braking torque"),
        }

    def judgements(self, f, r):
        return [
            Judgement("a tenth of the speed is left within half a second", f["tenth"], most=0.5),
            Judgement("largest braking torque", f["brake"]),
        ]

    def show(self, f, r):
        level = Mark(0.1 * self.speed, "a tenth")
        speed = Curve("crank", r["time"], r["conveyor.w"], "blue")
        torque = Curve("motor", r["time"], r["motor.tau"], "red")
        panels = [Panel("speed", "rad/s", [speed], [level]), Panel("torque", "N.m", [torque])]
        return Show([Chart("Run-down", "time [s]", panels)])
