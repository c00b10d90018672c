"""Source of an FMU that is half of any system: x1' = f1, x2' = f2, given as expressions.

They see x1, x2, the inputs u1, u2, held over a step, the time t and the functions of `math`.
"""

import math

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real, String

PIECES = 3


class Half(Fmi2Slave):
    """Integrates by the classical Runge-Kutta method, PIECES steps within one."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.f1, self.f2 = "0.0", "0.0"
        self.x1 = self.x2 = self.u1 = self.u2 = 0.0
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        for name in ("f1", "f2"):
            self.register_variable(String(name, **fixed))
        for name in ("u1", "u2"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("x1", "x2"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact)
            )

    def exit_initialization_mode(self):
        text = f"lambda t, x1, x2, u1, u2: ({self.f1}, {self.f2})"
        self.rates = eval(text, vars(math).copy())

    def do_step(self, t, size):
        h, u = size / PIECES, (self.u1, self.u2)
        x1, x2 = self.x1, self.x2
        for k in range(PIECES):
            s = t + k * h
            a1, a2 = self.rates(s, x1, x2, *u)
            b1, b2 = self.rates(s + h / 2, x1 + h / 2 * a1, x2 + h / 2 * a2, *u)
            c1, c2 = self.rates(s + h / 2, x1 + h / 2 * b1, x2 + h / 2 * b2, *u)
            d1, d2 = self.rates(s + h, x1 + h * c1, x2 + h * c2, *u)
            x1 += h / 6 * (a1 + 2 * b1 + 2 * c1 + d1)
            x2 += h / 6 * (a2 + 2 * b2 + 2 * c2 + d2)
        self.x1, self.x2 = x1, x2
        return True
