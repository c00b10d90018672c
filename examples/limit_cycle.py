"""Which limit cycle has the oscillator of van der Pol, VanDerPol.fmu beside this file?"""

from cosim import System
from workbench import Chart, Curve, Judgement, Panel, Question, Run, Show, option
from workbench.measure import Measured, crossing, largest, since


class LimitCycle(Question, Run):
    parts = {"oscillator": "VanDerPol.fmu"}

    mu: float = option(1.0, "damping", "1", above=0.0)
    stop: float = option(60.0, "simulated time", "s", above=0.0)
    step: float = option("10ms", "finest of three communication steps", "s", above=0.0)

    def system(self, fmus):
        return System(fmus, start={"oscillator.mu": self.mu, **self.start})

    def figures(self, r):
        t, x = r["time"], r["oscillator.x0"]
        end, mid, first = (crossing(t, x, 0.0, -k) for k in (1, 3, 5))
        error = end.error + mid.error + abs(end.value - 2.0 * mid.value + first.value)
        top = largest(*since(t, x, mid.value)).figure("1", "amplitude")
        cycle = Measured(end.value - mid.value, error)
        return {"period": cycle.figure("s", "period"), "amplitude": top}

    def judgements(self, f, r):
        return [Judgement("period", f["period"]), Judgement("amplitude", f["amplitude"])]

    def show(self, f, r):
        curve = Curve("x0", r["time"], r["oscillator.x0"], "blue")
        return Show([Chart("To the limit cycle", "time [s]", [Panel("state", "1", [curve])])])
