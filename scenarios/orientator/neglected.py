"""What the paper of the orientator neglects: Coriolis forces, friction at the catcher, the spring's direction.

Orientation times and largest rotor speeds with each of these effects are compared with those of the
paper's equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from cosim import System
from cosim.system import Value
from workbench import Chart, Context, Curve, Figure, Judgement, Mark, Panel, Table
from workbench.answer import parameters
from workbench.charts.model import SERIES
from workbench.charts.motion import Motion
from workbench.figure import figure_of_figures, scaled
from workbench.method import Method, Run

from . import motion
from .limit_formula import OrientatorParameters
from .products import RPM, Product, fastest, run_product

NEGLECTED = "orientator.neglected."
CREEP = f"{NEGLECTED}creep"
#: Start values that a comparison of the effects sets itself.
NEGLECTED_STARTS = tuple(
    f"{NEGLECTED}{name}" for name in ("mu_side", "mu_catcher", "rim", "anchored", "length")
)
TABLE = "orientator_neglect.csv"
PLAIN = "paper"
#: Spacing of the speeds at which a limit is sought, over that at which friction holds a cup; a convention.
SPACING = 0.03
#: The slowest of these speeds over that one; a convention, since limits are well above a third of it.
SLOWEST = 0.3
#: Their end, over the same speed: where friction holds every cup.
FASTEST = 1.0
#: Speeds at which the limit with another creep is sought, over the first limit, and their number; a convention.
CREEP_SPEEDS = (0.98, 1.02, 3)
EFFECTS = {
    "coriolis": "Coriolis forces",
    "hook": "friction on the hook",
    "corner": "friction in the corner",
    "spring": "the spring's direction",
    "together": "all of them",
}


def machines(
    base: System, friction: float, catcher: float, rim: float, length: float
) -> dict[str, System]:
    """Return the machine of the paper, and with each effect that it neglects; "corner" has the hook's friction, too.

    These are friction at all walls of the chute and between cup and catcher; radius of the rim's edge and length of the
    spring at the stop [m].
    """
    sides: dict[str, Value] = {"mu_side": friction}
    hook: dict[str, Value] = {"mu_catcher": catcher}
    corner: dict[str, Value] = {**hook, "rim": rim}
    spring: dict[str, Value] = {"anchored": True, "length": length}
    together = {**sides, **corner, **spring}
    settings = dict(zip((PLAIN, *EFFECTS), ({}, sides, hook, corner, spring, together)))
    start = {**base.start, CREEP: float(parameters(base)[CREEP].value) / 4}
    return {
        name: replace(base, start={**start, **{NEGLECTED + key: x for key, x in values.items()}})
        for name, values in settings.items()
    }


@dataclass(frozen=True)
class NeglectedComparison:
    """Each effect beside the paper's equations, at a friction: figures at a rotor speed [rpm], a table over others."""

    machines: Mapping[str, System]
    friction: float
    speed: float
    figures: Mapping[str, Figure]
    tables: Mapping[str, Table]

    def judgements(self) -> list[Judgement]:
        """Return what the effects cost in time, and how they move the limit."""
        f = self.figures
        at = f"at {self.speed:g} rpm and friction {self.friction:g}"
        effects = {
            label: f[f"{name}_share"] for name, label in EFFECTS.items() if name != "together"
        }
        return [
            Judgement(f"a product takes by the equations of the paper {at}", f["orientation_time"]),
            Judgement("the neglected effects together change this by", f["together_share"]),
            *(Judgement(f"{label} alone changes it by", x) for label, x in effects.items()),
            Judgement("largest rotor speed by the equations of the paper", f["limit_paper"]),
            Judgement("largest rotor speed with the neglected effects", f["limit_together"]),
        ]

    def charts(self) -> list[Chart]:
        """Return what each effect costs over the speed."""
        table, panels = self.tables[TABLE].frame, []
        for unit, scale in (("ms", 1e3), ("%", 100 / table[PLAIN])):
            curves = []
            for (name, label), color in zip(EFFECTS.items(), SERIES):
                base = table["hook" if name == "corner" else PLAIN]
                cost = (scale * (table[name] - base)).to_numpy()
                curves.append(Curve(label, table["n"].to_numpy(), cost, color, "linked"))
            panels.append(Panel("added time", unit, curves, includes=(0.0,)))
        mark = Mark(self.speed, f"{self.speed:g} rpm")
        return [Chart("What the paper neglects", "rotor speed [rpm]", panels, [mark])]

    def motions(self) -> list[Motion]:
        """Return a cup with and without all of the effects."""
        names = {PLAIN: "paper", "together": "all"}
        runs = {
            text: run_product(self.machines[name], self.friction, self.speed, 1e-3)
            for name, text in names.items()
        }
        return [motion.motion("Without and with the neglected effects", runs)]


class SlowlyCreeping(Product):
    """A product whose errors are those of slower creeping, on which times depend linearly, and of the step."""

    method: ClassVar[Method] = Run(finer=({CREEP: f"{CREEP} / 4"}, {"step": "step / 2"}))


def compare_with_effects(
    context: Context,
    kinds: Mapping[str, System],
    mu: float,
    speed: float,
    table_speeds: Sequence[float],
) -> NeglectedComparison:
    """Run all machines with a friction at all speeds [rad/s], and find where each of them jams.

    The figures are those of `speed`, the rows of the table those of `table_speeds`.
    """
    speeds = [speed, *table_speeds]
    asked = [x for system in kinds.values() for x in SlowlyCreeping.of(system, mu, speeds)]
    times = [*context.each(partial(orientation, context.fmus), asked, "effects", probes=True)]
    taken = {name: times[k * len(speeds) : (k + 1) * len(speeds)] for k, name in enumerate(kinds)}
    columns = {name: np.array([x.value for x in some[1:]]) for name, some in taken.items()}
    n = np.round(np.array(table_speeds) * RPM, 9)
    table = Table({"n": n, **columns}, {"n": "rpm", **dict.fromkeys(kinds, "s")})
    all_figures = figures({name: of_kind[0] for name, of_kind in taken.items()})
    ends = context.each(partial(fastest_oriented, mu), [*kinds.values()], "limits", probes=True)
    for name, end in zip(kinds, ends):
        which = f"with {EFFECTS[name]}" if name in EFFECTS else "of the paper"
        all_figures[f"limit_{name}"] = end._replace(meaning=f"largest rotor speed {which}")
    return NeglectedComparison(kinds, mu, speed * RPM, all_figures, {TABLE: table})


def orientation(fmus: Mapping[str, Path], product: Product) -> Figure:
    """The time of orientation of a product."""
    return product.solve(Context(fmus)).figures["orientation_time"]


def fastest_oriented(mu: float, system: System) -> Figure:
    """The fastest rotor that orients, sought below where friction holds cups in the chute; its error
    is the bracket, and what is left of the creep.
    """
    held = math.sqrt(OrientatorParameters.of(system).sticking)
    rotor = fastest(system, mu, np.arange(SLOWEST, FASTEST, SPACING) * held)
    if rotor.error is None:
        return rotor
    slower = replace(system, start={**system.start, CREEP: float(system.start[CREEP]) / 4})
    other = fastest(slower, mu, np.linspace(*CREEP_SPEEDS) * rotor.value / RPM)
    if other.error is None:
        return other
    return rotor._replace(error=rotor.error + 2.0 * abs(other.value - rotor.value))


def figures(times: Mapping[str, Figure]) -> dict[str, Figure]:
    """The time of orientation, and what each effect adds to it."""
    plain = times[PLAIN]
    result = {"orientation_time": plain._replace(meaning="orientation time of the paper")}
    for name, label in EFFECTS.items():
        base, more = times["hook" if name == "corner" else PLAIN], times[name]
        meaning = f"change of the orientation time due to {label}"
        for key, unit, scale in ((name, "ms", 1e3), (f"{name}_share", "%", 100 / plain.value)):
            cost = figure_of_figures(lambda x, less: x - less, more, base, unit="s")
            result[key] = scaled(cost, scale, unit, meaning)
    return result
