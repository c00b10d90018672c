"""How much supply voltage does it take to pass the resonance of the mount, and is the motor caught there?

The supply voltage of a motor with 5 Ohm is raised and lowered in levels, each held until the speed of
its unbalanced rotor is steady. Where the speed jumps, ever smaller steps locate the voltage.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import cosim
import workbench
from cosim import Result, SetupError, System
from cosim.system import connect
from workbench import Bench, Chart, Curve, Figure, Findings, Mark, Panel, Show, Table, option
from workbench.answer import parameters
from workbench.limit import coupling
from workbench.live import Live, LiveChart, LivePanel, LiveRun, LiveSweep, Number, Reader, Slider
from workbench.measure import Measured, Samples

from . import mechanism

PARTS = {"motor": "DCMotor", "exciter": "UnbalanceExciter"}
WIRES = ("motor.tau -> exciter.tau", "exciter.w -> motor.w")
OWN = ("motor.v",)
STATES = ("motor.i", "exciter.phi", "exciter.w", "exciter.x", "exciter.v")
UNITS = {"falling": "1", "supply": "V", "speed": "rad/s", "shake": "m"}
WAYS = {"up": "supply raised", "down": "supply lowered"}
TOLD = {
    "supply": ("V", "voltage at which the speed jumps"),
    "before": ("rad/s", "steady speed before the jump"),
    "after": ("rad/s", "steady speed after the jump"),
}
RUNS = ((1.0, 1), (1.0, 2), (1.0, 4), (0.5, 1))
FINEST, NEAR, SMALL, STEADY, MOST = 256, 1.05, 0.02, 0.01, 40
STARTS = (0.8, 1.05)


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    supplies: tuple[float, ...] = option("14:32:19", "voltage levels", "V", above=0.0)
    hold: float = option(5.0, "time over which the speed is compared", "s", above=0.0)
    step: float = option("10ms", "finest of three communication steps", "s", above=0.0)


class Level(NamedTuple):
    """A voltage [V], the steady speed [rad/s], the largest displacement [m], the states at the end."""

    supply: float
    speed: float
    shake: float
    states: Mapping[str, float]


class Case(NamedTuple):
    """A system, the time of each level [s], the communication step [s]."""

    system: System
    hold: float
    step: float

    def run(self, supply: float, states: Mapping[str, float]) -> Result:
        """With one voltage from these states."""
        system = replace(self.system, start={**self.system.start, **states, "motor.v": supply})
        return cosim.run(system, stop=self.hold, step=self.step, record=STATES)

    def level(self, supply: float, states: Mapping[str, float]) -> Level:
        """Where one voltage leads to from these states, once the speed moves by less than STEADY."""
        speed, before = np.inf, -np.inf
        for _ in range(MOST):
            r = self.run(supply, states)
            t, phi, x = r["time"], r["exciter.phi"], r["exciter.x"]
            states = {name: float(r[name][-1]) for name in STATES}
            before, speed = speed, float((phi[-1] - phi[0]) / t[-1])
            if abs(speed - before) < STEADY:
                break
        else:
            logging.getLogger("cosim").warning(f"at {supply:g} V the speed does not settle")
        return Level(supply, speed, float(np.abs(x).max()), states)


def solve(o: Options, bench: Bench) -> Findings:
    """Up and down with three steps, and again with half the time; raises SetupError for one level."""
    if len(o.supplies) < 2:
        raise SetupError(f"supplies = {o.supplies} V must be two levels or more")
    system = System(bench.fmus, WIRES, {"motor.R": 5.0, "motor.v": o.supplies[0], **o.start})
    connect(system)
    cases = [(o.supplies, Case(system, t * o.hold, n * o.step)) for t, n in RUNS]
    (levels, *_), jumps = zip(*bench.each(sweep, cases, "supplies"))
    rows = [(int(k >= len(o.supplies)), *level[:3]) for k, level in enumerate(levels)]
    table = Table.of_rows(rows, UNITS)
    w = np.linspace(1.0, 1.02 * table.frame["speed"].max(), 20_001)
    v, resonance = averaged(system, w)
    curve = CubicSpline(w, v)
    folds = curve(curve.derivative().roots(extrapolate=False))
    found = {"nu_res": Figure(resonance, "rad/s", 0.0, "resonance of the mount by formula")}
    for k, (way, word) in enumerate(WAYS.items()):
        told = [x[k] for x in jumps]
        found |= {f"{name}_{way}": figure(told, name, word) for name in TOLD}
        if len(folds) > k:
            theory = f"voltage of the jump by averaged theory, {word}"
            found[f"theory_{way}"] = Figure(float(folds[k]), "V", 0.0, theory)
    steps, data = f"steps of {o.step:g} s, levels of {o.hold:g} s", (cases[0][1], table.frame, w, v)
    return Findings(found, data, system, {}, steps, "strang", {"sommerfeld.csv": table})


def figure(jumps: Sequence[Mapping[str, Measured]], name: str, way: str) -> Figure:
    """What the runs tell of a jump, in the order of RUNS, where they all have one."""
    unit, meaning = TOLD[name][0], f"{TOLD[name][1]}, {way}"
    if not all(jumps):
        return Figure.refused(unit, "the speed does not jump", meaning)
    fine, *others, hasty = (jump[name].value for jump in jumps)
    off = coupling([fine, *others], cosim.ORDERS["strang"]) + abs(fine - hasty)
    return Figure(fine, unit, jumps[0][name].error + off, meaning)


def sweep(task: tuple[Sequence[float], Case]) -> tuple[list[Level], list[dict[str, Measured]]]:
    """All levels up and down again, and what there is of a jump on either way."""
    supplies, case = task
    levels: list[Level] = []
    for supply in (*supplies, *supplies[::-1]):
        levels.append(case.level(supply, levels[-1].states if levels else {}))
    return levels, [jump(case, levels[: len(supplies)]), jump(case, levels[len(supplies) :])]


def jump(case: Case, levels: Sequence[Level]) -> dict[str, Measured]:
    """The jump past the resonance with its voltage located, if the speed does not pass steadily.

    The steps towards it shrink where they fail, and only there: a large one may throw a motor off
    that a small one does not.
    """
    _, resonance = averaged(case.system, np.ones(1))
    passes = [
        (abs(levels[k + 1].speed - level.speed), k)
        for k, level in enumerate(levels[:-1])
        if min(level.speed, levels[k + 1].speed) < NEAR * resonance
        and max(level.speed, levels[k + 1].speed) > resonance
    ]
    if not passes:
        return {}
    at = max(passes)[1]
    last, caught, free = levels[max(at - 1, 0)], levels[at], levels[at + 1]
    step = free.supply - caught.supply
    finest = abs(step) / FINEST
    while abs(step) > finest:
        tried = case.level(caught.supply + step / 2, caught.states)
        if abs(tried.speed - caught.speed) < abs(tried.speed - free.speed):
            last, caught = caught, tried
        else:
            step /= 2
    after = case.level(caught.supply + step, free.states).speed
    if abs(after - caught.speed) < SMALL * resonance:
        return {}
    return {
        "supply": Measured(caught.supply + step / 2, abs(step) / 2),
        "before": Measured(caught.speed, abs(caught.speed - last.speed)),
        "after": Measured(after, abs(free.speed - after) / FINEST),
    }


def averaged(system: System, w: Samples) -> tuple[Samples, float]:
    """The voltage [V] of steady speeds w [rad/s] by the formula of the exciter's page, and the
    resonance of the mount [rad/s].
    """
    told = parameters(system)
    names = ("motor.R", "motor.k", "exciter.rotor.d", "exciter.rotor.m", "exciter.rotor.r")
    R, k, d_r, m_u, r = (float(told[name].value) for name in names)
    m, c, d = (float(told[f"exciter.mount.{name}"].value) for name in "mcd")
    off = (c - (m + m_u) * w**2) ** 2 + (d * w) ** 2
    tau = d_r * w + d * (m_u * r) ** 2 * w**5 / (2 * off)
    return np.asarray(R / k * tau + k * w), math.sqrt(c / (m + m_u))


def verdict(o: Options, f: Mapping[str, Figure], r: Any) -> str:
    """What it takes to pass, where the motor is caught, and the way back."""
    told = {name: figure.text() for name, figure in f.items()}
    if f["supply_up"].error is None:
        rows, high = r[1], f"up to {o.supplies[-1]:g} V"
        if rows["speed"].max() < f["nu_res"].value:
            return f"The motor stays caught {high}, below the resonance at {told['nu_res']}."
        return f"The motor is not caught: {high} its speed does not jump."
    said = (
        f"When raised slowly, the supply must reach {told['supply_up']} to pass the resonance. Below that "
        f"the motor is caught, finally at {told['before_up']}; then its speed jumps to "
        f"{told['after_up']}."
    )
    back = (
        f" When lowered again, it keeps the motor above the resonance down to {told['supply_down']}, where "
        f"the speed falls from {told['before_down']} to {told['after_down']}."
    )
    return said if f["supply_down"].error is None else said + back


def show(o: Options, f: Mapping[str, Figure], r: Any) -> Show:
    """Steady speed and displacement over the supply, and two starts from rest on either side."""
    case, rows, w, v = r
    seen = (v >= o.supplies[0]) & (v <= o.supplies[-1])
    steady = [Curve("averaged theory", v[seen], w[seen], "grey", "theory")]
    shakes = []
    for falls, (word, color) in enumerate(zip(WAYS.values(), ("red", "blue"))):
        x, y, shake = rows[rows["falling"] == falls][["supply", "speed", "shake"]].to_numpy().T
        steady.append(Curve(word, x, y, color, "linked"))
        shakes.append(Curve(word, x, 1e3 * shake, color, "linked"))
    jumps = {word: f[f"supply_{way}"] for way, word in WAYS.items()}
    marks = [Mark.of(word, jump) for word, jump in jumps.items() if jump.error is not None]
    level = Mark.of("resonance", f["nu_res"])
    panels = [Panel("steady speed", "rad/s", steady, [level]), Panel("displacement", "mm", shakes)]
    charts = [Chart("Both branches of the steady motion", "supply [V]", panels, marks)]
    takes = f["supply_up"].value if f["supply_up"].error is not None else o.supplies[-1]
    runs = {f"{share:.0%}": case.run(share * takes, {}) for share in STARTS}
    title = f"Starts from rest at shares of {takes:.4g} V"
    curves = [
        Curve(share, run["time"], run["exciter.w"], color)
        for (share, run), color in zip(runs.items(), ("red", "blue"))
    ]
    charts.append(Chart(title, "time [s]", [Panel("speed", "rad/s", curves)]))
    return Show(charts, [mechanism.starts(title, runs)])


def live_part(o: Options, f: Mapping[str, Figure], r: Any) -> Live:
    """Two starts from rest on either side of the voltage of the jump, and such starts at all voltages."""
    jump = f["supply_up"]
    supply = o.supplies[-1] if jump.error is None else jump.value
    runs = [
        LiveRun(f"{share * supply:.3g} V", color, {"motor.v": share * supply})
        for share, color in zip(STARTS, ("red", "blue"))
    ]
    end = Reader("mean", "exciter.w", "stop - 1")
    resonance = "sqrt(exciter.mount.c / (exciter.mount.m + exciter.rotor.m))"
    level = {"resonance of the mount": resonance}
    return Live(
        sliders=(
            Slider("motor.R", 4.0, 8.0),
            Slider("exciter.rotor.m", 0.3, 1.0),
            Slider("exciter.mount.d", 20.0, 200.0),
        ),
        runs=runs,
        stop="hold",
        numbers=[
            Number("nu_res", resonance),
            *(
                Number(
                    f"end_{k}",
                    Reader("mean", "exciter.w", "stop - 1", run=run.name),
                    "rad/s",
                    f"mean speed in the last second, started with {run.name}",
                )
                for k, run in enumerate(runs, 1)
            ),
        ],
        charts=[
            LiveChart(
                "Two starts from rest",
                "time [s]",
                [
                    LivePanel("speed", {"exciter.w": "red"}, levels=level),
                    LivePanel("displacement", {"exciter.x": "red"}, "mm"),
                ],
            )
        ],
        motion=mechanism.live_motion("Two starts from rest", parameters(r[0].system)),
        sweep=LiveSweep(
            over="motor.v",
            values=o.supplies,
            step="step",
            numbers=[
                Number("w_end", end, "rad/s", "mean speed in the last second"),
                Number(
                    "x_end",
                    Reader("max", "abs(exciter.x)", "stop - 1"),
                    "m",
                    "largest displacement",
                ),
            ],
            chart=LiveChart(
                "What a start from rest leads to",
                "supply [V]",
                [
                    LivePanel(
                        "mean speed at the end",
                        {"figures.w_end": ("from rest", "red", "points")},
                        "rad/s",
                        level,
                    ),
                    LivePanel(
                        "displacement at the end",
                        {"1e3 * figures.x_end": ("from rest", "red", "points")},
                        "mm",
                    ),
                ],
            ),
        ),
    )


LIVE = live_part
