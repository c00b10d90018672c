"""What does neglecting Coriolis forces, friction at the catcher and the spring's direction cost?

Orientation times and largest rotor speeds with each of these effects are compared with those of the
paper's equations.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

import workbench
from cosim import System
from cosim.accuracy.extrapolation import bound_coupling_error
from cosim.system import Value, connect
from workbench import Chart, Context, Curve, Figure, Findings, Mark, Panel, Show, option
from workbench.answer import parameters
from workbench.charts.model import SERIES
from workbench.figure import refusals
from workbench.measure import ROUNDING, Measured

from .. import machine as orientator
from .. import motion
from ..limit_formula import Machine, rpm
from ..products import STEP, fastest, run_product, simulate

PARTS = orientator.PARTS
NEGLECTED = "orientator.neglected."
CREEP = f"{NEGLECTED}creep"
FIXED_STARTS = (
    "orientator.chute.mu", "orientator.w", "orientator.release", f"{NEGLECTED}mu_side",
    f"{NEGLECTED}mu_catcher", f"{NEGLECTED}rim", f"{NEGLECTED}anchored", f"{NEGLECTED}length",
)  # fmt: skip
TABLE = "orientator_neglect.csv"
PLAIN = "paper"
#: Spacing of the speeds at which a limit is sought, over that at which friction holds a cup; a convention.
SPACING = 0.03
#: Speeds at which the limit with another creep is sought, over the first limit, and their number; a convention.
NEAR_LIMIT = (0.98, 1.02, 3)
EFFECTS = {
    "coriolis": "Coriolis forces",
    "hook": "friction on the hook",
    "corner": "friction in the corner",
    "spring": "the spring's direction",
    "together": "all of them",
}


@dataclass(frozen=True, kw_only=True)
class Options(workbench.Options):
    speed: float = option("40rpm", "speed of the rotor", "rad/s", least=0.0)
    speeds: tuple[float, ...] = option("0:70rpm:15", "speeds of the curves", "rad/s", least=0.0)
    friction: float = option(0.35, "friction at all walls of the chute", "1", above=0.0)
    catcher: float = option(0.35, "friction between cup and catcher", "1", least=0.0, most=1.0)
    rim: float = option("0.5mm", "radius of the rim's edge", "m", least=0.0)
    length: float = option("100mm", "length of the spring at the stop", "m", above=0.0)


def machines(o: Options, context: Context) -> dict[str, System]:
    """The machine of the paper, and with each of what it neglects; "corner" has the hook's friction."""
    base = orientator.system(context.fmus, 0.0, o.friction, o.start)
    connect(base)
    sides: dict[str, Value] = {"mu_side": o.friction}
    hook: dict[str, Value] = {"mu_catcher": o.catcher}
    corner: dict[str, Value] = {**hook, "rim": o.rim}
    spring: dict[str, Value] = {"anchored": True, "length": o.length}
    all_effects = {**sides, **corner, **spring}
    settings = dict(zip((PLAIN, *EFFECTS), ({}, sides, hook, corner, spring, all_effects)))
    return {
        name: replace(
            base, start={**base.start, **{NEGLECTED + key: x for key, x in values_of.items()}}
        )
        for name, values_of in settings.items()
    }


def solve(o: Options, context: Context) -> Findings:
    """All machines at all speeds, and where each of them jams."""
    kinds = machines(o, context)
    speeds = [round(w * 30 / math.pi, 9) for w in (o.speed, *o.speeds)]
    cases = [(system, n) for system in kinds.values() for n in speeds]
    orientation_times = [*context.each(partial(takes, o.friction), cases, "speeds", probes=True)]
    taken = {
        name: orientation_times[k * len(speeds) : (k + 1) * len(speeds)]
        for k, name in enumerate(kinds)
    }
    rows = ([n, *(times[k].value for times in taken.values())] for k, n in enumerate(speeds) if k)
    table = context.record_rows(TABLE, {"n": "rpm", **dict.fromkeys(kinds, "s")}, rows)
    all_figures = figures({name: times[0] for name, times in taken.items()})
    ends = context.each(partial(ending, o.friction), [*kinds.values()], "limits", probes=True)
    for name, limit in zip(kinds, ends):
        which = (
            f"largest rotor speed with {EFFECTS[name]}"
            if name in EFFECTS
            else "largest rotor speed of the paper"
        )
        all_figures[f"limit_{name}"] = limit._replace(meaning=which)
    base = kinds[PLAIN]
    return Findings(
        all_figures, (kinds, table.frame), base, {}, f"steps of {STEP} s", tables={TABLE: table}
    )


def creeping(system: System) -> list[System]:
    """The machine with a quarter, a half and all of the speed below which what would stick creeps; the
    machine alone where nothing does.
    """
    orientation_times = parameters(system)
    if not any(orientation_times[f"{NEGLECTED}{mu}"].value for mu in ("mu_side", "mu_catcher")):
        return [system]
    creeps = (float(orientation_times[CREEP].value) / n for n in (4, 2, 1))
    return [replace(system, start={**system.start, CREEP: creep}) for creep in creeps]


def crept(values: Sequence[float]) -> float:
    """What the creep still makes of the first of values of `creeping` machines: they are linear in it."""
    return bound_coupling_error(values, 1.0) if len(values) > 1 else 0.0


def takes(mu: float, case: tuple[System, float]) -> Measured:
    """A time of orientation; its error is what half the step changes, and what is left of the creep."""
    system, n = case
    machines = creeping(system)
    times = [simulate(machine, mu, n).orientation_time for machine in machines]
    halved = simulate(machines[0], mu, n, STEP / 2).orientation_time
    if not np.isfinite([*times, halved]).all():
        return Measured(math.nan, math.nan)
    return Measured(times[0], crept(times) + abs(times[0] - halved) + ROUNDING)


def ending(mu: float, system: System) -> Figure:
    """The fastest rotor that orients, sought below where friction holds cups in the chute; its error
    is the bracket, and what is left of the creep.
    """
    first, *more_machines = creeping(system)
    speeds = np.arange(0.3, 1.0, SPACING) * rpm(Machine.of(system).sticks)
    fastest_rotor = fastest(first, speeds.tolist(), mu)
    near = (np.linspace(*NEAR_LIMIT) * fastest_rotor.value).tolist()
    ends = [
        fastest_rotor,
        *(fastest(machine, near, mu) for machine in more_machines if fastest_rotor.error),
    ]
    for end in ends:
        if end.error is None:
            return end
    return fastest_rotor._replace(
        error=(fastest_rotor.error or 0.0) + crept([end.value for end in ends])
    )


def figures(orientation_times: Mapping[str, Measured]) -> dict[str, Figure]:
    """The time of orientation, and what each effect adds to it."""
    plain = orientation_times[PLAIN]
    meaning = "orientation time of the paper"
    jams = Figure.undetermined("s", "a product jams", meaning)
    all_figures = {
        "orientation_time": jams if math.isnan(plain.value) else plain.figure("s", meaning)
    }
    for name, label in EFFECTS.items():
        base, more = (
            orientation_times["hook" if name == "corner" else PLAIN],
            orientation_times[name],
        )
        cost, uncertainty = more.value - base.value, more.error + base.error
        for key, unit, scale in ((name, "ms", 1e3), (f"{name}_share", "%", 100 / plain.value)):
            meaning = f"change of the orientation time due to {label}"
            all_figures[key] = (
                Figure.undetermined(unit, "a product jams", meaning)
                if math.isnan(cost)
                else Figure(scale * cost, unit, abs(scale) * uncertainty, meaning)
            )
    return all_figures


def verdict(o: Options, f: Mapping[str, Figure], r: object) -> str:
    """What each effect costs in time, and how it moves the limit."""
    if f["orientation_time"].error is None:
        return " ".join(refusals({"the equations of the paper": f["orientation_time"]}))
    costs = [
        f"{label}: {f[name].text()} ({f[f'{name}_share'].text()})"
        for name, label in reversed(EFFECTS.items())
        if f[name].error is not None
    ]
    limits = [
        f"{label}: {f[f'limit_{name}'].text()}"
        for name, label in {PLAIN: "none of them", **EFFECTS}.items()
        if f[f"limit_{name}"].error is not None and name not in ("hook", "corner")
    ]
    lines = [
        f"At {o.speed * 30 / math.pi:g} rpm and friction {o.friction:g} a product takes "
        f"{f['orientation_time'].text()} by the equations of the paper."
    ]
    if costs:
        lines.append(f"What they neglect adds to this, {'; '.join(costs)}.")
    if limits:
        lines.append(f"The largest rotor speed with these effects, {'; '.join(limits)}.")
    return "\n".join(lines)


def show(o: Options, f: Mapping[str, Figure], r: tuple[Mapping[str, System], Any]) -> Show:
    """What each effect costs over the speed, and a cup with and without all of them."""
    kinds, table = r
    panels = []
    for unit, scale in (("ms", 1e3), ("%", 100 / table[PLAIN])):
        curves = []
        for (name, label), color in zip(EFFECTS.items(), SERIES):
            base = table["hook" if name == "corner" else PLAIN]
            cost = (scale * (table[name] - base)).to_numpy()
            curves.append(Curve(label, table["n"].to_numpy(), cost, color, "linked"))
        panels.append(Panel("added time", unit, curves, includes=(0.0,)))
    n = o.speed * 30 / math.pi
    chart = Chart("What the paper neglects", "rotor speed [rpm]", panels, [Mark(n, f"{n:g} rpm")])
    names = {PLAIN: "paper", "together": "all"}
    runs = {word: run_product(kinds[name], o.friction, n, 1e-3) for name, word in names.items()}
    last = max(float(orientator.shortened(x)["time"][-1]) for x in runs.values())
    return Show([chart], [motion.motion("Without and with the neglected effects", runs, last)])
