"""Options that questions about the conveyor share, and how a sweep of its speed begins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import workbench
from cosim.system import Value
from workbench import Figure, Judgement, option
from workbench.judgement import Holds

from ..motor import FORM, INERTIA, Nameplate, nameplate, read_nameplate
from .drive_orbits import ORBIT_ALGORITHMS
from .first_order import FIELDS, SETS
from .machine import has_kloss_characteristic

#: Rated torque of the motors of the sets, at the crank [N.m].
RATED = {"A": 100.0, "B": 88.0}
#: Distance of a lag from that of its slip, over it, that the digits of a nameplate leave: a speed of 1440 rpm is known to
#: 1 rpm of 60 rpm of slip, and the ratio of the torques to 0.05 of 2.8.
LAG_TOLERANCE = 0.05
#: Start values that a question on the speeds of a linear motor sets itself.
LINEAR_MOTOR_STARTS = ("motor.characteristic", "motor.A", "motor.tau", "conveyor.phi", "conveyor.w")


def by_set(values: Mapping[str, float]) -> str:
    """Return the values of the sets for a help text, "100 in set A and 88 in set B by default"."""
    return (
        " and ".join(f"{value:g} in set {name}" for name, value in values.items()) + " by default"
    )


@dataclass(frozen=True, kw_only=True)
class NameplateOptions(workbench.Options):
    """An induction motor by its nameplate; start values that are given as well override it."""

    #: Start values that follow from the nameplate and that the question sets itself.
    of_question: ClassVar[Sequence[str]] = ()
    nameplate: str = option(
        "", f"nameplate of an induction motor, {FORM}; gear and inertia may be left out"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "start", {**self.plate_start, **self.start})

    @property
    def plate_start(self) -> dict[str, Value]:
        """The start values that follow from the nameplate."""
        fixed = (*self.of_question, *getattr(self, "fixed_starts", ()))
        start = nameplate(self.nameplate) if self.nameplate else {}
        return {name: value for name, value in start.items() if name not in fixed}

    @property
    def given_start(self) -> dict[str, Value]:
        """The start values that the nameplate does not have."""
        of_plate = self.plate_start.items()
        return {name: value for name, value in self.start.items() if (name, value) not in of_plate}

    def contradictions(self) -> list[Judgement]:
        """Return a lag that contradicts the slip of the motor on the nameplate."""
        lag = self.start.get("motor.T")
        if not self.plate or lag is None:
            return []
        least, most = ((1.0 + s * LAG_TOLERANCE) * self.plate.lag for s in (-1, 1))
        agrees = Judgement(
            "motor.T is that of the breakdown slip",
            Figure(float(lag), "s", 0.0),
            least,
            most,
            note=f"it contradicts the nameplate, whose slip gives {self.plate.lag:.4g} s",
        )
        return [agrees] if agrees.answer is Holds.NO else []

    def taken(self, parameter_set: str, *lacking: str) -> list[Judgement]:
        """Return what a machine of one's own has from a set, by names and what else is `lacking`; and the inertia that it has
        from the nameplate, which is that of the rotor alone.
        """
        names = [x for x in FIELDS if x not in (*self.start, *self.of_question)]
        if self.plate or has_kloss_characteristic(SETS[parameter_set].follow(self.start)):
            names = [x for x in names if x != "motor.B"]
        judgements = []
        if self.start and (names or lacking):
            what = f"taken from set {parameter_set} because not given"
            judgements.append(Judgement(what, note=", ".join([*names, *lacking])))
        inertia = self.plate_start.get(INERTIA)
        if inertia is not None and self.start[INERTIA] == inertia:
            note = (
                "that of the rotor on the nameplate alone: crank, pulleys and flywheel weigh nothing here; add theirs, and "
                f"write the sum as --start {INERTIA}="
            )
            judgements.append(
                Judgement("inertia at the crank", Figure(float(inertia), "kg.m2", 0.0), note=note)
            )
        return judgements

    @property
    def plate(self) -> Nameplate | None:
        """What the nameplate says."""
        return read_nameplate(self.nameplate) if self.nameplate else None


@dataclass(frozen=True, kw_only=True)
class RippleOptions(workbench.Options):
    """Options of the torque ripple, at one speed or in a plane."""

    set: str = option("A", "parameter set", choices=SETS)
    limit: float = option(
        50.0, "limit of the torque ripple, as a share of the rated torque", "%", above=0.0
    )
    rated_torque: float | None = option(
        None, f"rated motor torque at the crank, {by_set(RATED)}", "N.m", above=0.0
    )
    algorithm: str = option("strang", "coupling algorithm", choices=ORBIT_ALGORITHMS)

    @property
    def rated_torque_or_default(self) -> float:
        """The rated torque [N.m]."""
        return self.rated_torque or RATED[self.set]

    @property
    def torque_ripple_limit(self) -> float:
        """The limit of the torque ripple [N.m]."""
        return self.limit / 100 * self.rated_torque_or_default

    def ripple_below_limit(self, tau2: Figure, speed: float) -> Judgement:
        """Return whether a torque ripple is below its limit at a speed [rad/s]."""
        at = f"{speed:.4g} rad/s ({speed * 30 / math.pi:.4g} rpm)"
        return Judgement(
            f"torque ripple below its limit at {at}",
            tau2,
            most=self.torque_ripple_limit,
            yes=f"{at} is safe for torque",
            no=f"Avoid {at} for its torque",
            note=self.default_rating_note,
        )

    @property
    def default_rating_note(self) -> str:
        """Where the limit of the torque ripple comes from, if nobody has given the rated torque."""
        default = f"the limit is {self.limit:g} % of the default rated torque of {self.rated_torque_or_default:g} N.m"
        return default if self.rated_torque is None else ""


def speeds_of(text: str) -> tuple[float, ...]:
    """Return the numbers of a text with commas."""
    return tuple(map(float, text.split(",")))
