"""How much sooner does the conveyor stop with a quicker motor?"""

from dataclasses import dataclass

from cosim import System
from workbench import Figure, Judgement, Run, option
from workbench.measure import crossing

PARTS = {"motor": "DriveMotor", "conveyor": "CrankConveyor"}
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
RECORD = ("motor.tau", "conveyor.w")
LAGS = {"quick": 0.005, "slow": 0.1}


@dataclass(frozen=True, kw_only=True)
class Options(Run):
    speed: float = option(40.0, "speed at the start", "rad/s", above=0.0)
    stop: float = option(0.5, "simulated time", "s", above=0.0)


def system(o, fmus):
    start = {"motor.A": 0.0, "motor.B": 35.8, "conveyor.w": o.speed}
    return {x: System(fmus, WIRES, {**start, "motor.T": T, **o.start}) for x, T in LAGS.items()}


def figures(o, r):
    half = crossing(r["time"], r["conveyor.w"], 0.5 * o.speed)
    return {"half": half.figure("s", "until half the speed is left")}


def more_figures(o, f, results):
    quick, slow = f["quick_half"], f["slow_half"]
    error = quick.error + slow.error
    return {"sooner": Figure(slow.value - quick.value, "s", error, "sooner with the quick motor")}


def judgements(o, f, results):
    return [Judgement("half the speed is left sooner by", f["sooner"])]
