"""Source of an FMU with a parameter of every type that the project's own FMUs do not have."""

from pythonfmu import (
    Boolean,
    Fmi2Causality,
    Fmi2Initial,
    Fmi2Slave,
    Fmi2Variability,
    Integer,
    Real,
    String,
)


class Echo(Fmi2Slave):
    """Says what it was given as one number, y = r + 10 i + 1000 b + 1e4 first letter of s + u + x.

    `x` is a guess that may be set, `g` a constant that may not, `twice` a calculated parameter.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.r, self.i, self.b, self.s, self.u, self.y = 0.0, 0, False, "A", 0.0, 0.0
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        for kind, name in ((Real, "r"), (Integer, "i"), (Boolean, "b"), (String, "s")):
            self.register_variable(kind(name, **fixed))
        self.twice, self.x, self.g = 0.0, 0.0, 9.81
        guess = {"causality": Fmi2Causality.local, "initial": Fmi2Initial.approx}
        self.register_variable(Real("x", variability=Fmi2Variability.continuous, **guess))
        self.register_variable(
            Real("g", causality=Fmi2Causality.local, variability=Fmi2Variability.constant)
        )
        attributes = {"causality": Fmi2Causality.calculatedParameter}
        self.register_variable(Real("twice", variability=Fmi2Variability.fixed, **attributes))
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def exit_initialization_mode(self):
        self.do_step(0.0, 0.0)

    def do_step(self, t, h):
        self.y = self.r + 10 * self.i + 1000 * self.b + 1e4 * ord(self.s[0]) + self.u + self.x
        return True
