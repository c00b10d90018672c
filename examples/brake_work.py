"""How much work does a motor that brakes take from the conveyor?"""

from cosim import System
from workbench import Question, Run, Table, option
from workbench.live import Live, Number, Reader, RunChart, RunPanel, Slider
from workbench.measure import extended, integral, largest


class BrakeWork(Question, Run):
    parts = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
    wires = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")

    stop: float = option(0.5, "simulated time", "s", above=0.0)

    def system(self, fmus):
        return System(fmus, self.wires, {"motor.A": 0.0, "conveyor.w": 40.0, **self.start})

    def process(self, r):
        return extended(r, "W", {"power": -r["motor.tau"] * r["conveyor.w"]})

    def figures(self, r):
        work, brake = integral(r["time"], r["power"]), largest(r["time"], -r["motor.tau"])
        return {
            "work": work.figure("J", "work on the motor"),
            "brake": brake.figure("N.m", "brake"),
        }

    def tables(self, f, r):
        return {"brake_steps.csv": Table.of_rows([(f["brake"].value,)], {"brake": "N.m"})}

    def live(self, f, r):
        return Live(
            sliders=(Slider("motor.B", 5.0, 90.0),),
            charts=[RunChart("Braking", "time [s]", [RunPanel("torque", {"motor.tau": "red"})])],
            numbers=[Number("brake", Reader("max", "-motor.tau"))],
        )
