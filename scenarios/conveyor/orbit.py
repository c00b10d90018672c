"""How does the drive turn at one speed: its ripple and lag, its mean values, its rod force?

Motor and conveyor are coupled until their orbit is steady. The ripple of order 2 and the mean values are compared with
theory. An induction motor may have several steady motions; the figures are those of the one with the largest torque ripple.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim import SetupError, System
from cosim.system import Value
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Number,
    Panel,
    Plan,
    Question,
    Reader,
    Show,
    option,
)
from workbench.charts import model as colors
from workbench.figure import listed
from workbench.live import REVOLUTION
from workbench.orbits import STEP_MULTIPLES, FigureColumn, Motions, SteadyMotion

from .drive_orbits import CRANK_TURN, ORBIT_STATES, near, require_enough_steps_per_rev
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
FORCE = "conveyor.f_rod"


def ripple(kind: str, column: str) -> Reader:
    """Amplitude or phase of order 2."""
    return Reader(kind, column, REVOLUTION, 2)


def mean(name: str, column: str) -> Number:
    """A mean over time."""
    return Number(name, Reader("mean", column, REVOLUTION), *MEANS[name])


#: Figures whose course theory guides, and the ripple on which each hangs: its amplitude and its phase.
GUIDED = {
    "lag": ("tau2", "tau2_phase"),
    "tau2": ("tau2", "tau2_phase"),
    "gain": ("tau2", "tau2_phase"),
    "w2": ("w2", "w2_phase"),
}
#: Half width of the nodes around a peak, over damping ratio and speed. The part of the height that four of
#: five nodes miss falls with its fourth power: 1.3e-5 of the torque peak of set A with 0.5, 8e-7 with 0.25.
PEAK_WIDTH = 0.25
#: Largest half width over x, for drives with much damping.
WIDEST_PEAK = 0.1


class RippleGuide(NamedTuple):
    """The course of a ripple, or of its lag, over the speed or a parameter.

    Load over response, 1 / H, is smooth even where the response has a sharp resonance: by first-order theory it is a
    quadratic polynomial of the speed for the torque ripple, and that over a linear one for the speed ripple.
    """

    name: str
    machine: Machine
    speed: float
    over: str

    @property
    def figures(self) -> tuple[str, ...]:
        """What is measured."""
        return GUIDED[self.name]

    @property
    def period(self) -> float:
        """After what the figure repeats."""
        return 360.0 if self.name == "lag" else math.inf

    def at(self, x: Any) -> tuple[Machine, Any]:
        """The machine and its mean speed at x."""
        machine = self.machine
        if self.over != "speed":
            machine = replace(machine, **{FIELDS[self.over]: x})
        nu = x if self.over == "speed" else self.speed + 0.0 * x
        return linearised(machine, nu), nu

    def load(self, x: Any) -> Any:
        """The load ripple at constant speed [N.m]."""
        machine, nu = self.at(x)
        return machine.load_ripple(nu) + 0.0 * x

    def theory(self, x: Any) -> Any:
        """Load over response by theory, the same for every load: without a spring, which may leave 0 / 0."""
        machine, nu = self.at(x)
        free = replace(machine, c=0.0)
        ripple = free.speed_ripple if self.name == "w2" else free.torque_ripple
        return free.load_ripple(nu) / ripple(nu) + 0.0 * x

    def smooth(self, x: Any, values: Any) -> Any:
        """Load over response of amplitudes and phases."""
        amplitude, phase = values
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.load(x) / (amplitude * np.exp(1j * np.radians(phase)))

    def figure(self, x: Any, smooth: Any) -> Any:
        """The figure of what is smooth."""
        if self.name == "lag":
            return np.degrees(np.angle(smooth)) % 360.0
        with np.errstate(divide="ignore", invalid="ignore"):
            return (np.abs(self.load(x)) if self.name != "gain" else 1.0) / np.abs(smooth)

    def half_width(self, x: Any) -> Any:
        """Half the range of nodes around a peak: PEAK_WIDTH of the width of the resonance there.

        That width is zeta x / |d ln(nu_res / nu) / d ln x|; a neighbour 0.1 % away gives the derivative.
        """
        (machine, nu), (neighbour, nu_neighbour) = self.at(x), self.at(1.001 * x)
        tuning = np.abs(np.log(neighbour.nu_res / machine.nu_res * nu / nu_neighbour)) / 0.001
        return x * np.minimum(PEAK_WIDTH * machine.zeta / np.maximum(tuning, 1e-9), WIDEST_PEAK)


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
            "f_rod_peak",
            Reader("max", f"abs({FORCE})", REVOLUTION),
            "N",
            "largest size of the rod force",
        ),
    )

    speed: float | None = option(None, f"operating speed, {by_set(OPERATING)}", "rad/s", above=0.0)
    steps_per_rev: int = option(512, "communication steps per revolution", least=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "speed", self.speed or OPERATING[self.set])

    @classmethod
    def of(cls, machine: Machine, nu: float, o: Any) -> DriveOrbit:
        """Return the question of a machine at a speed [rad/s], run as another question says."""
        return cls(
            start=start_of(machine), speed=float(nu), algorithm=o.algorithm, steps_per_rev=o.steps_per_rev
        )  # fmt: skip

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

    @property
    def coarsest(self) -> int:
        """How many times the step may be with which runs give the errors."""
        try:
            require_enough_steps_per_rev(self, self.machine, self.nu, STEP_MULTIPLES[-1])
        except SetupError:
            return 1
        return STEP_MULTIPLES[-1]

    def system(self, fmus: Mapping[str, Path]) -> System:
        """The drive near the orbit of first-order theory."""
        state = dict(zip(ORBIT_STATES, near(self.machine, self.nu).tolist()))
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
        refused = refusals(context.fmus, [o.given for o in questions])
        for k, (o, why) in enumerate(zip(questions, refused)):
            try:
                if why:
                    raise SetupError(why)
                require_torque(o.given, o.nu)
                require_enough_steps_per_rev(o, o.machine, o.nu)
                good.append(k)
            except SetupError as error:
                found[k] = error
        found |= zip(good, cls.method.measure(context, [questions[k] for k in good]))
        return [found[k] for k in range(len(questions))]

    def guide(self, figure: str, over: str) -> RippleGuide | None:
        """What is smooth of a figure along a line: load over response less that of theory, even at a sharp resonance."""
        if figure not in GUIDED or over not in ("speed", *FIELDS):
            return None
        return RippleGuide(figure, self.given, self.nu, over)

    @classmethod
    def more_columns(
        cls, asked: Sequence[DriveOrbit], columns: Mapping[str, FigureColumn]
    ) -> Mapping[str, Callable[[], FigureColumn]]:
        """Return lag, gain and supply of many motions, and what theory says of the same."""
        m, nu = Machine.of([o.machine for o in asked]), np.array([o.nu for o in asked])
        load, ripples = m.load_ripple(nu), {"tau2": m.torque_ripple(nu), "w2": m.speed_ripple(nu)}
        phase = np.degrees(np.angle(load))
        with np.errstate(divide="ignore"):
            gain = np.where(load == 0.0, np.nan, 1.0 / np.abs(load))

        def formula(
            unit: str, meaning: str, value: Callable[[], Any]
        ) -> Callable[[], FigureColumn]:
            def column() -> FigureColumn:
                x = np.broadcast_to(np.asarray(value(), float), nu.shape)
                return FigureColumn(x, 0.0 * nu, unit, meaning, x[None])

            return column

        more: dict[str, Callable[[], FigureColumn]] = {
            "lag": lambda: columns["tau2_phase"].each(
                lambda x: (phase - x) % 360.0, "deg", "lag of the torque ripple behind its load"
            ),
            "gain": lambda: columns["tau2"].each(
                lambda x: gain * x, "1", "torque over load ripple", gain
            ),
            "tau2_theory": formula(
                "N.m", "torque ripple by (26)", lambda: np.abs(ripples["tau2"])
            ),
            "w2_theory": formula(
                "rad/s", "speed ripple by first-order theory", lambda: np.abs(ripples["w2"])
            ),
            **{
                f"{x}_phase_theory": formula(
                    "deg", f"phase of {x} by first-order theory", partial(np.angle, y, deg=True)
                )
                for x, y in ripples.items()
            },
            "f_rod_formula": formula(
                "N", "largest rod force by (17)", lambda: np.abs(rod_force(m, nu))
            ),
        }  # fmt: skip
        if not has_kloss_characteristic(m):
            share = m.A(nu) / m.B
            more["supply"] = lambda: columns["torque"].each(
                lambda x: share * x, *MEANS["supply"], share
            )
            for end, has_ripple in (("theory", True), ("plain", False)):
                of_theory = means(m, nu, ripple=has_ripple)._asdict()
                more |= {
                    f"{x}_{end}": formula(
                        unit, f"{meaning}, {THEORIES[end]}", partial(np.asarray, of_theory[x])
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


def start_of(machine: Machine) -> dict[str, Value]:
    """Return start values of a machine, without the slope that an induction motor does not use and that differs from speed to speed."""
    fields = {name: float(vars(machine)[field]) for name, field in FIELDS.items()}
    if has_kloss_characteristic(machine):
        del fields["motor.B"]
    return {**fields, **machine.more}


def plan_of(machine: Machine, o: Any, grid: Mapping[str, Sequence[float]], **more: Any) -> Plan:
    """Return the plan of a machine's orbits over a grid, run as a question says."""
    fixed = {**start_of(machine), "algorithm": o.algorithm, "steps_per_rev": o.steps_per_rev}
    fixed = {name: x for name, x in fixed.items() if name not in grid}
    return Plan(question=DriveOrbit, fixed=fixed, grid=grid, **more)


def require_steady(motions: Motions) -> None:
    """Raise SetupError if no orbit is steady."""
    if np.isnan(motions.multipliers).all():
        raise SetupError("no orbit of the map is steady")


class Drive(NamedTuple):
    """On what machines are run, with which algorithm and steps."""

    context: Context
    algorithm: str
    steps_per_rev: int

    @classmethod
    def of(cls, context: Context, o: Any) -> Drive:
        """Return that of the options of a question."""
        return cls(context, o.algorithm, o.steps_per_rev)

    def asked(
        self, machine: Machine, nu: Any, question: type[DriveOrbit] = DriveOrbit
    ) -> list[DriveOrbit]:
        """Return the questions of machines, whose fields are arrays or not, at mean speeds [rad/s]."""
        nu = np.atleast_1d(nu).tolist()
        return [question.of(machine[k], x, self) for k, x in enumerate(nu)]

    def motions(self, machine: Machine, nu: Any, multiples: int = len(STEP_MULTIPLES)) -> Motions:
        """Return the motions of machines at speeds near first-order theory, with so many step sizes."""
        nu = np.atleast_1d(nu)
        states = np.broadcast_to(near(machine, nu), (len(nu), 2))
        return CRANK_TURN.motions(self.context, self.asked(machine, nu), states, multiples)
