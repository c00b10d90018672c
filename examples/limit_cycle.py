"""Which limit cycle has the oscillator of van der Pol, VanDerPol.fmu beside this file?"""

from cosim.metrics import Largest, passings
from workbench import Figure, Judgement, Question, RunChart, RunOptions, RunPanel, option


class LimitCycle(Question, RunOptions):
    parts = {"oscillator": "VanDerPol.fmu"}
    start_values = {"oscillator.mu": "mu"}

    mu: float = option(1.0, "damping", "1", above=0.0)
    stop: float = option(60.0, "simulated time", "s", above=0.0)
    step: float = option("10ms", "finest of three communication steps", "s", above=0.0)

    charts = (RunChart("To the limit cycle", "time [s]", [RunPanel("state", {"oscillator.x0": "blue"}, "1")]),)  # fmt: skip

    def figures(self, r):
        x = r.solution("oscillator.x0")
        begin, end = passings(x, 0.0)[[-3, -1]]
        top = Largest("", begin=begin)(x)[0]
        return {
            "period": Figure.measured(end - begin, "s", "period"),
            "amplitude": Figure.measured(top, "1", "amplitude"),
        }

    def judgements(self, f, r):
        return [Judgement("period", f["period"]), Judgement("amplitude", f["amplitude"])]
