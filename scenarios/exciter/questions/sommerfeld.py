"""How much supply voltage does it take to pass the resonance of the mount, and is the motor caught there?

The supply voltage of a motor is raised and lowered in levels, each held until the speed of its
unbalanced rotor is steady. The voltages at which the speed jumps are the folds of the steady motions,
which are found by shooting over one revolution.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cosim import (
    CONVERGENCE_ORDERS,
    Result,
    SetupError,
    System,
    run,
)
from cosim.metrics import change_to_come
from cosim.system import connect
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Mark,
    Number,
    Panel,
    Question,
    Reader,
    RunChart,
    RunPanel,
    Show,
    Slider,
    Table,
    option,
)
from workbench.answer import parameters
from workbench.charts.model import Arrow
from workbench.figure import listed
from workbench.live import Live, LiveRun, LiveSweep, drawn, moved
from workbench.orbits import STEP_MULTIPLES, at_zero_step, figure_of

from .. import motion
from ..orbits import (
    ROOT_ROUNDING,
    STEPS_PER_REV,
    Averaged,
    Jumps,
    Shooting,
    averaged,
    constants,
    steps_at_folds,
)

WIRES = ("motor.tau -> exciter.tau", "exciter.w -> motor.w")
STATES = ("motor.i", "exciter.phi", "exciter.w", "exciter.x", "exciter.v")
POWERS = ("motor.P", "exciter.P_loss")
UNITS = {"falling": "1", "supply": "V", "speed": "rad/s", "shake": "m"}
DIRECTIONS = {"up": "supply raised", "down": "supply lowered"}
MEANINGS = {
    "supply": ("V", "voltage at which the speed jumps"),
    "before": ("rad/s", "steady speed before the jump"),
    "after": ("rad/s", "steady speed after the jump"),
}
#: Largest drift of the speed that a level may still have before it, as the drifts of its holds fall [rad/s].
STEADY = 0.01
#: Largest share of the motor's work in a hold that a level may store in the motion; a convention.
BALANCED = 0.01
#: Holds after which a level is given up.
MAX_HOLDS = 40
#: Steps in a revolution at the no-load speed, which the motor does not reach.
LEVEL_STEPS = 16
#: Share of the resonance by which two speeds at one voltage must differ to count as two.
MIN_GAP = 0.02
STARTS = (0.8, 1.05)
#: Share of such a start from which on its mean speed is taken.
LAST = 0.9


RESONANCE = "sqrt(exciter.mount.c / (exciter.mount.m + exciter.rotor.m))"
RESONANCE_NAME = "resonance of the mount"
SWITCHED_ON = "Supply switched on at once, from rest"
STARTS_CHART = RunChart(
    SWITCHED_ON,
    "time [s]",
    [
        RunPanel("speed", {"exciter.w": "red"}, levels={RESONANCE_NAME: "figures.nu_res"}),
        RunPanel("displacement", {"exciter.x": "red"}, "mm"),
    ],
)
FROM_REST_NUMBERS = (
    Number(
        "w_end", Reader("mean", "exciter.w", "stop - 1"), "rad/s", "mean speed in the last second"
    ),
    Number("x_end", Reader("max", "abs(exciter.x)", "stop - 1"), "m", "largest displacement"),
)
FROM_REST_CHART = RunChart(
    f"{SWITCHED_ON}: what it leads to",
    "supply [V]",
    [
        RunPanel(
            "mean speed at the end",
            {"figures.w_end": ("from rest", "red", "points")},
            "rad/s",
            {RESONANCE_NAME: RESONANCE},
        ),
        RunPanel(
            "displacement at the end", {"1e3 * figures.x_end": ("from rest", "red", "points")}, "mm"
        ),
    ],
)


class Sommerfeld(Question):
    """The voltages, how long each is held, and the longest step."""

    parts = {"motor": "DCMotor", "exciter": "UnbalanceExciter"}
    fixed_starts = ("motor.v",)
    is_sequential = True

    sliders = (
        Slider("motor.R", 4.0, 8.0),
        Slider("exciter.rotor.m", 0.3, 1.0),
        Slider("exciter.mount.d", 20.0, 200.0),
    )
    charts = (STARTS_CHART,)

    supplies: tuple[float, ...] = option("14:32:19", "voltage levels", "V", above=0.0)
    hold: float = option(5.0, "time over which the speed is compared", "s", above=0.0)
    step: float = option("10ms", "longest communication step", "s", above=0.0)

    def solve(self, context: Context) -> Findings:
        """The levels up and down, and the folds in three step sizes; raises SetupError for one level.

        This replaces the single certified run, because the voltages are folds of steady motions, which a search
        finds, and each level starts from the end of the one before.
        """
        if len(self.supplies) <= 1:
            raise SetupError(f"supplies = {self.supplies} V must be two levels or more")
        system = System(
            context.fmus, WIRES, {"motor.R": 5.0, "motor.v": self.supplies[0], **self.start}
        )
        connect(system)
        if constants(system)[1] == 0.0:
            raise SetupError("motor.k = 0 V.s/rad gives no torque; the motor needs a larger one")
        case, theory = HeldDrive(system, self.hold, self.step), averaged(system)
        levels = case.levels(self.supplies)
        count = steps_at_folds(theory, self.step)
        which = np.arange(len(count)).repeat(len(STEP_MULTIPLES))
        if len(count):
            with Shooting.of(system, theory) as shooting:
                jumps = shooting.jumps(which, count.ravel())
        observed = Observed(case, levels, theory)
        warn(levels, case)
        rows = [(int(k >= len(self.supplies)), *level[:3]) for k, level in enumerate(levels)]
        table = Table.of_rows(rows, UNITS)
        figures = {
            "nu_res": Figure(theory.resonance, "rad/s", 0.0, "resonance of the mount by formula")
        }
        for k, (direction, word) in enumerate(DIRECTIONS.items()):
            mine = Jumps(*(x[which == k] for x in jumps)) if len(count) else None
            figures |= {f"{x}_{direction}": figure(mine, x, word, observed) for x in MEANINGS}
            if len(count):
                meaning = f"voltage of the jump by averaged theory, {word}"
                figures[f"theory_{direction}"] = Figure(
                    float(theory.folds[k, 1]), "V", 0.0, meaning
                )
        steps = f"steps of at most {self.step:g} s, in the folds at least {STEPS_PER_REV} in a revolution"
        data = (observed, table.frame)
        return Findings(figures, data, system, {}, steps, "strang", {"sommerfeld.csv": table})

    def judgements(self, f: Mapping[str, Figure], r: tuple[Observed, Any]) -> list[Judgement]:
        """Whether the motor passes the resonance in these levels, what it takes, and the way back."""
        observed, up, down = r[0], f["supply_up"], f["supply_down"]
        top = observed.raised[-1]
        where = f"it turns at {top.speed:.4g} rad/s at {top.supply:g} V, the highest level"
        if not top.is_steady:
            where += f", and is not steady after {MAX_HOLDS * observed.case.hold:g} s"
        resonance = f"the resonance of the mount at {f['nu_res'].brief()}"
        passes = (
            f"the motor passes {resonance} when its supply is raised slowly to {top.supply:g} V"
        )
        yes = f"The motor passes {resonance} when its supply is raised slowly"
        no = f"A supply raised slowly to {top.supply:g} V does not take the motor past {resonance}"
        if constants(observed.case.system)[6] == 0.0 or (
            not len(observed.theory.folds)
            and (up.reason != no_jump(observed) or two_speeds(observed))
        ):
            return [Judgement(passes, up, most=top.supply, note=where)]
        if not len(observed.theory.folds):
            is_above = top.speed >= observed.theory.resonance
            note = f"its speed does not jump; {where}"
            return [Judgement(passes, is_so=is_above, note=note, yes=yes, no=no)]
        edge, least = f["before_up"], up.value - (up.error or 0.0)
        early = [
            x.supply for x in observed.raised if x.speed > edge.value + STEADY and x.supply < least
        ]
        if early:
            where = f"the steps between these levels throw it past at {early[0]:g} V; {where}"
        yes = f"The motor passes {resonance}; supply needed, raised slowly"
        return [
            Judgement(passes, up, most=top.supply, note=where, yes=yes, no=no),
            *from_rest(f, observed),
            Judgement("speed before the jump past the resonance", f["before_up"]),
            Judgement("speed after the jump past the resonance", f["after_up"]),
            Judgement("supply that keeps it above the resonance when lowered again", down),
        ]

    def show(self, f: Mapping[str, Figure], r: tuple[Observed, Any]) -> Show:
        """Steady speed and displacement over the supply, and two starts from rest on either side."""
        starts, of = starts_of(self, f)
        shares = " and ".join(f"{100 * share:g} %" for share in STARTS)
        title = f"{SWITCHED_ON}: {shares} of the {of}"
        runs = {x.name: r[0].case.run(float(x.start["motor.v"]), {}) for x in starts}
        chart = drawn(STARTS_CHART, list(runs.values()), self, f, runs=starts)
        pictures = [steady_motion(self, f, r), chart._replace(title=title)]
        moving = motion.live_motion(title, parameters(r[0].case.system))
        return Show(pictures, [moved(moving, *runs.values(), names=[*runs])])

    def live(self, f: Mapping[str, Figure], r: tuple[Observed, Any]) -> Live:
        """Two starts from rest on either side of the voltage of the jump, and such starts at all voltages."""
        runs, _ = starts_of(self, f)
        step = f"min(step, 2 * pi * motor.k / (motor.v * {LEVEL_STEPS}))"
        ends = [
            Number(
                f"end_{k}",
                Reader("mean", "exciter.w", "stop - 1", run=run.name),
                "rad/s",
                f"mean speed in the last second, started with {run.name}",
            )
            for k, run in enumerate(runs, 1)
        ]
        return self.page(
            f,
            r,
            runs=runs,
            stop="hold",
            step=step,
            numbers=[Number("nu_res", RESONANCE), *ends],
            motion=motion.live_motion(SWITCHED_ON, parameters(r[0].case.system)),
            sweep=LiveSweep("motor.v", self.supplies, step, FROM_REST_NUMBERS, FROM_REST_CHART),
        )


class HeldVoltage(NamedTuple):
    """A voltage [V], the mean speed in the last hold [rad/s], the largest displacement [m], the states at
    the end, and whether the motion is steady.
    """

    supply: float
    speed: float
    shake: float
    states: Mapping[str, float]
    is_steady: bool


class HeldDrive(NamedTuple):
    """A system, the time of each hold [s], the longest communication step [s]."""

    system: System
    hold: float
    step: float

    def run(self, supply: float, states: Mapping[str, float]) -> Result:
        """Run one voltage from these states."""
        start = {**self.system.start, **states, "motor.v": supply}
        system = replace(self.system, start=start)
        step, record = self.step_at(supply), (*STATES, *POWERS)
        return run(system, stop=self.hold, step=step, record=record)

    def levels(self, supplies: Sequence[float]) -> list[HeldVoltage]:
        """All levels up and down again, each from the states at the end of the one before."""
        levels: list[HeldVoltage] = []
        for supply in (*supplies, *supplies[::-1]):
            levels.append(self.level(supply, levels[-1].states if levels else {}))
        return levels

    def step_at(self, supply: float) -> float:
        """The communication step at a voltage, which resolves a revolution at its no-load speed [s]."""
        period = 2 * math.pi * constants(self.system)[1] / supply
        return min(self.step, period / LEVEL_STEPS)

    def level(self, supply: float, states: Mapping[str, float]) -> HeldVoltage:
        """Hold one voltage until the rest of the drift is below STEADY and what the motor gives is lost."""
        speeds, is_steady = [math.inf, math.inf], False
        while not is_steady and len(speeds) < 2 + MAX_HOLDS:
            r = self.run(supply, states)
            t, phi, x = r["time"], r["exciter.phi"], r["exciter.x"]
            states = {name: float(r[name][-1]) for name in STATES}
            speeds.append(float((phi[-1] - phi[0]) / t[-1]))
            work, loss = (float(r[name].mean()) for name in POWERS)
            rest = change_to_come(*speeds[:-4:-1])
            is_steady = rest < STEADY and abs(work - loss) < BALANCED * abs(work)
        return HeldVoltage(supply, speeds[-1], float(np.abs(x).max()), states, is_steady)


class Observed(NamedTuple):
    """The case and its levels, raised and then lowered, and averaged theory."""

    case: HeldDrive
    levels: Sequence[HeldVoltage]
    theory: Averaged

    @property
    def raised(self) -> Sequence[HeldVoltage]:
        """The levels of the rising supply."""
        return self.levels[: len(self.levels) // 2]

    @property
    def lowered(self) -> Sequence[HeldVoltage]:
        """The levels of the falling supply, by rising voltage."""
        return self.levels[: len(self.levels) // 2 - 1 : -1]


def starts_of(o: Sommerfeld, f: Mapping[str, Figure]) -> tuple[list[LiveRun], str]:
    """Return two starts from rest, on either side of the voltage of the jump or of the highest level, and of which."""
    up = f["supply_up"]
    has_jump = up.error is not None and up.value <= o.supplies[-1]
    supply = up.value if has_jump else o.supplies[-1]
    runs = [
        LiveRun(f"{share * supply:.3g} V", color, {"motor.v": share * supply})
        for share, color in zip(STARTS, ("red", "blue"))
    ]
    return runs, "voltage of the jump" if has_jump else "highest level"


def warn(levels: Sequence[HeldVoltage], case: HeldDrive) -> None:
    """Name the levels at which the motion does not settle."""
    open_ends = dict.fromkeys(f"{level.supply:g}" for level in levels if not level.is_steady)
    if open_ends:
        time = MAX_HOLDS * case.hold
        logging.getLogger("cosim").warning(
            f"at {listed([*open_ends])} V the motion is not steady after {time:g} s; the table has its last speed"
        )


def figure(jumps: Jumps | None, name: str, direction: str, observed: Observed) -> Figure:
    """What the searches with falling numbers of steps state of a jump, where they all have one."""
    unit, meaning = MEANINGS[name][0], f"{MEANINGS[name][1]}, {direction}"
    if jumps is None:
        return Figure.undetermined(unit, no_jump(observed), meaning)
    values = jumps._asdict()[name]
    why = "" if np.isfinite(values).all() else next(filter(None, jumps.reason))
    found = at_zero_step(values, CONVERGENCE_ORDERS["strang"], ROOT_ROUNDING * values)
    return figure_of(found, (), unit, meaning, why)


def no_jump(observed: Observed) -> str:
    """Why there is no jump, where averaged theory has no fold."""
    if constants(observed.case.system)[6] == 0.0:
        return "a mount without damping has no steady motion at its resonance"
    if two_speeds(observed):
        return "the levels have two speeds at one voltage, and averaged theory has no fold"
    return "the speed does not jump"


def two_speeds(observed: Observed) -> bool:
    """Whether a voltage has another speed when it is raised than when it is lowered."""
    pairs = zip(observed.raised, observed.lowered)
    gap = MIN_GAP * observed.theory.resonance
    return any(abs(up.speed - down.speed) > gap for up, down in pairs)


def from_rest(f: Mapping[str, Figure], observed: Observed) -> list[Judgement]:
    """What a supply does that is switched on at once: a slow rise needs more, since it is steady at each voltage."""
    up, before = f["supply_up"], f["before_up"]
    if up.error is None or before.error is None:
        return []
    supply = STARTS[0] * up.value
    run = observed.case.run(supply, {})
    last = run["time"] >= LAST * run["time"][-1]
    mean = float(run["exciter.w"][last].mean())
    passes = mean > 1.1 * before.value
    what = f"{supply:.4g} V, {100 * STARTS[0]:g} % of the supply of the jump, passes the resonance when switched on at once from rest"
    note = f"it turns at {mean:.4g} rad/s after {run['time'][-1]:g} s"
    return [Judgement(what, is_so=passes, note=note)]


def steady_motion(o: Sommerfeld, f: Mapping[str, Figure], r: tuple[Observed, Any]) -> Chart:
    """Return speed and displacement of the levels over the supply, beside averaged theory."""
    (_, _, theory), rows = r
    v, w, fastest = theory.supplies, theory.speeds, rows["speed"].max()
    inside = (v >= o.supplies[0]) & (v <= o.supplies[-1]) & (w < 1.1 * fastest)
    steady = [Curve("averaged theory", v[inside], w[inside], "grey", "theory")]
    shakes, arrows = [], []
    for falls, (direction, color) in enumerate(zip(DIRECTIONS, ("red", "blue"))):
        label, jump = DIRECTIONS[direction], f[f"supply_{direction}"]
        x, y, shake = rows[rows["falling"] == falls][["supply", "speed", "shake"]].to_numpy().T
        breaks: list[int] = []
        if jump.error is not None:
            breaks = (np.flatnonzero(np.diff(np.sign(x - jump.value))) + 1).tolist()
        steady.append(Curve(label, x, y, color, "linked", breaks=breaks))
        shakes.append(Curve(label, x, 1e3 * shake, color, "linked", breaks=breaks))
        ends = f[f"before_{direction}"], f[f"after_{direction}"]
        if len(breaks) and all(end.error is not None for end in ends):
            arrows.append(Arrow(jump.value, ends[0].value, ends[1].value, color))
    level = Mark.of("resonance", f["nu_res"])
    panels = [
        Panel("steady speed", "rad/s", steady, [level], arrows=arrows),
        Panel("displacement", "mm", shakes),
    ]
    title = "Steady motion while the supply is raised and lowered"
    return Chart(title, "supply [V]", panels, jump_marks(o, f))


def jump_marks(o: Sommerfeld, f: Mapping[str, Figure]) -> list[Mark]:
    """Return the voltages of the jumps that lie among the levels."""
    jumps = {word: f[f"supply_{direction}"] for direction, word in DIRECTIONS.items()}
    return [
        Mark.of(word, jump)
        for word, jump in jumps.items()
        if jump.error is not None and o.supplies[0] <= jump.value <= o.supplies[-1]
    ]
