"""What the paper of the orientator neglects: Coriolis forces, friction at the catcher, the spring's direction.

Orientation times and largest rotor speeds with each of these effects are compared with those of the
paper's equations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cosim import System
from cosim.accuracy.limit import limit
from cosim.system import Value
from workbench import Chart, Context, Curve, Figure, Judgement, Mark, Panel, Table
from workbench.answer import parameters
from workbench.charts.model import SERIES
from workbench.charts.motion import Motion
from workbench.figure import ROUNDING, figure_of_figures, scaled

from . import motion
from .limit_formula import OrientatorParameters, rpm_of_squared
from .products import STEP, fastest, run_product, simulate

NEGLECTED = "orientator.neglected."
CREEP = f"{NEGLECTED}creep"
#: Start values that a comparison of the effects sets itself.
NEGLECTED_STARTS = tuple(
    f"{NEGLECTED}{name}" for name in ("mu_side", "mu_catcher", "rim", "anchored", "length")
)
TABLE = "orientator_neglect.csv"
PLAIN = "paper"
JAMS = "a product jams"
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


@dataclass(frozen=True)
class Effects:
    """What is neglected: friction at all walls of the chute and between cup and catcher; radius of the rim's
    edge and length of the spring at the stop [m].
    """

    friction: float
    catcher: float
    rim: float
    length: float

    def machines(self, base: System) -> dict[str, System]:
        """Return the machine of the paper, and with each effect; "corner" has the hook's friction, too."""
        sides: dict[str, Value] = {"mu_side": self.friction}
        hook: dict[str, Value] = {"mu_catcher": self.catcher}
        corner: dict[str, Value] = {**hook, "rim": self.rim}
        spring: dict[str, Value] = {"anchored": True, "length": self.length}
        together = {**sides, **corner, **spring}
        settings = dict(zip((PLAIN, *EFFECTS), ({}, sides, hook, corner, spring, together)))
        return {
            name: replace(
                base, start={**base.start, **{NEGLECTED + key: x for key, x in values.items()}}
            )
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


def compare_with_effects(
    context: Context, base: System, effects: Effects, speed: float, table_speeds: Sequence[float]
) -> NeglectedComparison:
    """Run all machines at all speeds [rpm], and find where each of them jams.

    The figures are those of `speed`, the rows of the table those of `table_speeds`.
    """
    speeds = speed, *table_speeds
    kinds, mu = effects.machines(base), effects.friction
    cases = [(system, n) for system in kinds.values() for n in speeds]
    times = [*context.each(partial(time_of_orientation, mu), cases, "effects", probes=True)]
    taken = {name: times[k * len(speeds) : (k + 1) * len(speeds)] for k, name in enumerate(kinds)}
    rows = (
        [n, *(of_kind[k].value for of_kind in taken.values())] for k, n in enumerate(speeds) if k
    )
    table = context.record_rows(TABLE, {"n": "rpm", **dict.fromkeys(kinds, "s")}, rows)
    all_figures = figures({name: of_kind[0] for name, of_kind in taken.items()})
    ends = context.each(partial(fastest_oriented, mu), [*kinds.values()], "limits", probes=True)
    for name, end in zip(kinds, ends):
        which = f"with {EFFECTS[name]}" if name in EFFECTS else "of the paper"
        all_figures[f"limit_{name}"] = end._replace(meaning=f"largest rotor speed {which}")
    return NeglectedComparison(kinds, mu, speed, all_figures, {TABLE: table})


def with_slower_creep(system: System) -> list[System]:
    """The machine with a quarter, a half and all of the speed below which what would stick creeps; the
    machine alone where nothing does.
    """
    values = parameters(system)
    if not any(values[f"{NEGLECTED}{mu}"].value for mu in ("mu_side", "mu_catcher")):
        return [system]
    creeps = (float(values[CREEP].value) / n for n in (4, 2, 1))
    return [replace(system, start={**system.start, CREEP: creep}) for creep in creeps]


def creep_error(values: Sequence[float]) -> float:
    """What the creep still makes of the first of values of `with_slower_creep` machines: they are linear in it."""
    return float(limit(values, 1.0).error) if len(values) > 1 else 0.0


def time_of_orientation(mu: float, case: tuple[System, float]) -> Figure:
    """A time of orientation; its error is what half the step changes, and what is left of the creep."""
    system, n = case
    machines = with_slower_creep(system)
    times = [simulate(machine, mu, n).orientation_time for machine in machines]
    halved = simulate(machines[0], mu, n, STEP / 2).orientation_time
    if not np.isfinite([*times, halved]).all():
        return Figure.undetermined("s", JAMS)
    return Figure(times[0], "s", creep_error(times) + abs(times[0] - halved) + ROUNDING)


def fastest_oriented(mu: float, system: System) -> Figure:
    """The fastest rotor that orients, sought below where friction holds cups in the chute; its error
    is the bracket, and what is left of the creep.
    """
    first, *more_machines = with_slower_creep(system)
    speeds = np.arange(SLOWEST, FASTEST, SPACING) * rpm_of_squared(
        OrientatorParameters.of(system).sticking
    )
    fastest_rotor = fastest(first, speeds.tolist(), mu)
    near = (np.linspace(*CREEP_SPEEDS) * fastest_rotor.value).tolist()
    ends = [
        fastest_rotor,
        *(fastest(machine, near, mu) for machine in more_machines if fastest_rotor.error),
    ]
    refused = next((end for end in ends if end.error is None), None)
    width = (fastest_rotor.error or 0.0) + creep_error([end.value for end in ends])
    return refused or fastest_rotor._replace(error=width)


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
