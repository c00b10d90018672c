"""How does the drive turn at one speed: its ripple and lag, its mean values, its rod force?

Motor and conveyor are coupled until their orbit is steady. The ripple of order 2 and the mean values are compared with
theory. An induction motor may have several steady motions; the figures are those of the one with the largest torque ripple.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cosim import SetupError, System
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Number,
    Panel,
    Question,
    Reader,
    Show,
    option,
)
from workbench.charts import model as colors
from workbench.figure import figure_of_figures, listed, scaled
from workbench.live import REVOLUTION
from workbench.orbits import SteadyMotion

from .drive_orbits import CRANK_TURN, STATES, Drive, near
from .first_order import FIELDS, SETS, Machine, rod_force
from .machine import (
    PARTS,
    conveyor_drive,
    has_kloss_characteristic,
    linearised,
    refusals,
    require_torque,
    start_values,
)
from .options import RippleOptions, by_set
from .papers import cited
from .rod_waveform import peak, waveform
from .second_order import means

#: Operating speeds of the sets [rad/s].
OPERATING = {"A": 40.0, "B": 60.0}
#: Shares of the slope at the working point with which first-order theory gives starts: a motion in which the torque
#: swings far beyond that slope is that of a motor with less, as by the describing function of a characteristic that
#: bends; the lowest is that of a motor whose torque does not swing.
SLOPE_SHARES = (1.0, 0.5, 0.25, 0.125, 0.0)
#: Means of a turn: unit, and what they are.
MEANS = {
    "speed": ("rad/s", "mean speed over time"),
    "angle": ("rad/s", "mean speed over the crank angle"),
    "torque": ("N.m", "mean torque"),
    "supply": ("W", "power from the supply"),
    "trough": ("W", "power into the resistance of the trough"),
    "motor": ("W", "power into heat in the motor"),
}
THEORIES = {"theory": "to second order in the ripple", "plain": "without ripple"}
GUIDES = {
    "tau2_theory": ("N.m", 0.0, "torque ripple by (26)"),
    "w2_theory": ("rad/s", 0.0, "speed ripple by first-order theory"),
    "lag_theory": ("deg", 0.0, "lag by first-order theory"),
}
FORCE = "conveyor.f_rod"


def ripple(kind: str, column: str) -> Reader:
    """Amplitude or phase of order 2."""
    return Reader(kind, column, REVOLUTION, 2)


def mean(name: str, column: str) -> Number:
    """A mean over time."""
    return Number(name, Reader("mean", column, REVOLUTION), *MEANS[name])


class DriveOrbit(Question, RippleOptions):
    """The machine and its speed."""

    parts = PARTS
    fixed_starts = ("motor.A", "motor.tau", "conveyor.phi", "conveyor.w")
    decisive = ("tau2",)
    sources = cited(18, 24, 26)
    at_once = 64
    method = CRANK_TURN
    numbers = (
        Number("tau2", ripple("amplitude", "motor.tau"), "N.m", "torque ripple, order 2"),
        Number("w2", ripple("amplitude", "conveyor.w"), "rad/s", "speed ripple, order 2"),
        Number("tau2_phase", ripple("phase", "motor.tau"), "deg", "phase of the torque ripple"),
        Number("w2_phase", ripple("phase", "conveyor.w"), "deg", "phase of the speed ripple"),
        mean("speed", "conveyor.w"),
        Number("angle", Reader("amplitude", "conveyor.w", REVOLUTION, 0), *MEANS["angle"]),
        mean("torque", "motor.tau"),
        mean("trough", "conveyor.P_loss"),
        mean("motor", "motor.tau * motor.tau / motor.B"),
        Number("pull", Reader("max", FORCE, REVOLUTION), "N", "largest rod force"),
        Number("push", Reader("min", FORCE, REVOLUTION), "N", "least rod force, of the other sign"),
        Number(
            "f_rod_peak", "max(figures.pull, -figures.push)", "N", "largest size of the rod force"
        ),
    )

    speed: float | None = option(None, f"operating speed, {by_set(OPERATING)}", "rad/s", above=0.0)
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "speed", self.speed or OPERATING[self.set])

    @classmethod
    def of(cls, machine: Machine, drive: Drive, nu: float) -> DriveOrbit:
        """Return the question of a machine, run as a drive, at a speed [rad/s]."""
        fields = {name: float(vars(machine)[field]) for name, field in FIELDS.items()}
        if has_kloss_characteristic(machine):
            del fields[
                "motor.B"
            ]  # which its motor does not use, and which differs from speed to speed
        steps: Any = {"algorithm": drive.algorithm, "steps_per_rev": drive.steps_per_rev}
        return cls(start={**fields, **machine.more}, speed=nu, **steps)

    @property
    def nu(self) -> float:
        """The operating speed [rad/s]."""
        return self.speed or OPERATING[self.set]

    @cached_property
    def given(self) -> Machine:
        """The machine with its start values."""
        return SETS[self.set].follow(self.start)

    @cached_property
    def machine(self) -> Machine:
        """The same with the slope that its motor has at the speed."""
        return linearised(self.given, self.nu)

    def system(self, fmus: Mapping[str, Path]) -> System:
        """The drive near the orbit of first-order theory."""
        state = dict(zip(STATES, near(self.machine, self.nu).tolist()))
        starts = {**start_values(self.machine, self.nu), "conveyor.phi": 0.0, **state}
        return conveyor_drive(
            fmus,
            {
                name: x if isinstance(x, str) or name == "motor.characteristic" else float(x)
                for name, x in starts.items()
            },
        )

    def starts(self, _system: System) -> Any:
        """States on the orbits of first-order theory; of a motor that is not linear with several slopes."""
        shares = SLOPE_SHARES if has_kloss_characteristic(self.machine) else (1.0,)
        return np.array(
            [near(replace(self.machine, B=x * self.machine.B), self.nu) for x in shares]
        )

    @classmethod
    def solve_all(
        cls, context: Context, questions: Sequence[DriveOrbit]
    ) -> list[Findings | SetupError]:
        """Return what the turns of many machines say, or why one is refused."""
        found: dict[int, Findings | SetupError] = {}
        good = []
        for k, (o, why) in enumerate(
            zip(questions, refusals(context.fmus, [o.given for o in questions]))
        ):
            try:
                if why:
                    raise SetupError(why)
                require_torque(o.given, o.nu)
                Drive(context, o.algorithm, o.steps_per_rev).require_enough_steps_per_rev(
                    o.machine, o.nu
                )
                good.append(k)
            except SetupError as error:
                found[k] = error
        found |= zip(good, cls.method.measure(context, [questions[k] for k in good]))
        return [found[k] for k in range(len(questions))]

    def solve(self, context: Context) -> Findings:
        """Return what the turn says, or refuse a machine that has none."""
        (found,) = self.solve_all(context, [self])
        if isinstance(found, SetupError):
            raise found
        return found

    def formulas(self) -> Mapping[str, float]:
        """Ripple and lag by first-order theory."""
        m, nu = self.machine, self.nu
        torque = m.torque_ripple(nu)
        lag = float(np.angle(m.load_ripple(nu) / torque, deg=True)) % 360.0
        return {
            "tau2_theory": float(abs(torque)),
            "w2_theory": float(abs(m.speed_ripple(nu))),
            "lag_theory": lag,
        }

    def more_figures(
        self, figures: Mapping[str, Figure], values: Mapping[str, float]
    ) -> Mapping[str, Figure]:
        """Return lag, gain and supply, and what theory says of the same; `values` are those of all parameters."""
        m, nu = self.machine, self.nu
        length = values["conveyor.rod.l"] if values["conveyor.rod.finite"] else math.inf
        load = complex(m.load_ripple(nu))
        phase = math.degrees(np.angle(load))
        more = {
            "lag": figure_of_figures(lambda x: (phase - x) % 360.0, figures["tau2_phase"], unit="deg", meaning="lag of the torque ripple behind its load"),
            **{name: Figure(x, *GUIDES[name]) for name, x in self.formulas().items()},
            "f_rod_formula": Figure(abs(rod_force(m, nu)), "N", 0.0, "largest rod force by (17)"),
            "f_rod_theory": Figure(
                peak(waveform(m, length, nu)), "N", 0.0, "largest rod force to first order in the ripple"
            ),
        }  # fmt: skip
        if load:
            more["gain"] = scaled(figures["tau2"], 1.0 / abs(load), "1", "torque over load ripple")
        if not has_kloss_characteristic(m):
            more["supply"] = scaled(figures["torque"], float(m.A(nu) / m.B), *MEANS["supply"])
            for end, has_ripple in (("theory", True), ("plain", False)):
                of_theory = means(m, nu, ripple=has_ripple)._asdict()
                more |= {
                    f"{x}_{end}": Figure(
                        float(of_theory[x]), unit, 0.0, f"{meaning}, {THEORIES[end]}"
                    )
                    for x, (unit, meaning) in MEANS.items()
                }
        return more

    def judgements(self, f: Mapping[str, Figure], r: Sequence[SteadyMotion]) -> list[Judgement]:
        """Whether the torque ripple is below its limit, in the worst of all steady motions, and what the others are."""
        others = [
            f"{x.figures['tau2'].brief()} with a lag of {x.figures['lag'].brief()}" for x in r[1:]
        ]
        return [
            Judgement(
                f"torque ripple below its limit at {self.nu:g} rad/s", f["tau2"], most=self.torque_ripple_limit,
                note=self.default_rating_note,
            ),
            Judgement("lag of the torque ripple behind its load", f["lag"]),
            *([Judgement("the drive has another steady motion", note=listed(others))] if others else []),
        ]  # fmt: skip

    def show(self, _figures: Mapping[str, Figure], r: Sequence[SteadyMotion]) -> Show:
        """Speed, torque and rod force over the last revolution."""
        panels = []
        for column, quantity, unit, color in (
            ("conveyor.w", "crank speed", "rad/s", colors.SPEED), ("motor.tau", "motor torque", "N.m", colors.TORQUE),
            (FORCE, "rod force", "N", colors.FORCE),
        ):  # fmt: skip
            curves = [
                Curve(
                    f"motion {k}" if len(r) > 1 else quantity,
                    np.linspace(0.0, 360.0, len(x.turn[column]), endpoint=False),
                    x.turn[column],
                    color if k == 1 else "gray",
                )
                for k, x in enumerate(r, 1)
            ]
            panels.append(Panel(quantity, unit, curves))
        return Show([Chart("One revolution", "crank angle [deg]", panels)])
