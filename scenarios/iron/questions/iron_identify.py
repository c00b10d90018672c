"""Which friction, mass and spring does a measured sealing iron have, and how fast may its cam turn?

Motor and drive are fitted to a record of the motor's speed, and of its torque if that was measured.
Friction is proportional to the load. The record therefore shows (1 + K) m and (1 + K) c, with one K for
the way up and one for the way down, but not m and c themselves. One of them must be known, such as the
mass of an iron that was weighed. A record that no drive of this kind fits is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import cosim
from cosim import Advice, Identified, SetupError, System
from cosim.dense import Array as Samples
from cosim.system import Value
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Findings,
    Judgement,
    Panel,
    Question,
    Show,
    fitting,
    option,
)
from workbench.charts.model import SPEED as BLUE
from workbench.charts.model import TORQUE as RED
from workbench.figure import figure_of_figures
from workbench.fitting import RecordOptions, figure_of
from workbench.live import moved

from .. import machine as iron
from .. import motion

SPEED, TORQUE, SUPPLY = "iron.w", "motor.tau", "motor.A"
STATES = ("iron.phi", "iron.w_cam", TORQUE)
LOADS = ("iron.iron.m", "iron.spring.c", "iron.friction.K_up", "iron.friction.K_down")
FREE = ("motor.B", "motor.T", *LOADS)
EXACT = ("iron.reducer.J", "iron.reducer.i_g", "iron.spring.e_0")
#: Rows of a turn from which a loss is taken; a convention.
SAMPLES = 360
#: Noise of a torque that a further record would have, over the rated torque; a convention.
FORESEEN = 0.02
#: Even angles at which two turns are correlated; a power of 2 for the FFT.
ANGLES = 256
#: Cam angle of a communication step of the run that begins a fit [rad]; a convention.
TURN = 5e-3
#: Mean torque of the motor at the start of a fit [N.m]; a convention.
LOAD = 0.1
DERIVED = {
    "mu": ("1", "guide friction over the pull of the chain"),
    "loss": ("J", "work of the guide friction per turn"),
    "follower_limit": ("rad/s", "cam speed where the follower lifts off"),
}


class IronIdentify(Question, RecordOptions):
    """The record to fit, and the torque that the noise of further records is measured by."""

    parts = iron.PARTS
    fixed_starts = (SUPPLY, *STATES[1:])
    error_scope = fitting.FIT_ERROR_SCOPE
    is_sequential = True

    rated_torque: float = option(
        2.0,
        "rated torque of the motor, for the noise of a torque not yet measured",
        "N.m",
        above=0.0,
    )

    def solve(self, context: Context) -> Findings:
        """Fit, and ask the drive that fits.

        This replaces the single certified run, because the answer comes from a fit to a record and from many
        machines that fit it.
        """
        record = self.columns(SPEED)
        if not self.priors.keys() & {*LOADS}:
            raise SetupError(
                f"{self.data}: the record shows only (1 + K) m and (1 + K) c; give what is known, as in "
                "--known iron.iron.m=4+-1%"
            )
        system = guess(self, context.fmus, record[SPEED])
        free = [SUPPLY, *FREE, *STATES]
        fit = self.identify(system, record, free, first=("iron.phi", SUPPLY))
        machine = drive(fit, fit.start_values)
        iron_data = IdentifiedIron(fit, machine, () if fit.misfit else advice(self, fit))
        return Findings(
            figures(iron_data),
            iron_data,
            fit.problem.system,
            fit.result.provenance,
            tables=fitting.tables(fit, iron_data.advice, "iron_identify", "1"),
            facts=fitting.facts(fit, iron_data.advice, EXACT),
        )

    def judgements(self, f: Mapping[str, Figure], r: IdentifiedIron) -> list[Judgement]:
        """What was found, how far the record is from the lift-off, and what to record next."""
        if r.fit.misfit:
            return fitting.misfit("a drive of this kind fits this record", r.fit.misfit)
        mean = mean_cam_speed(r.fit)
        return [
            Judgement(
                "the follower stays on the cam at the speed of the record",
                Figure(mean, "rad/s", 0.0),
                most=f["follower_limit"],
                yes=f"The cam may turn at the {mean:.4g} rad/s of the record",
                no=f"Avoid the {mean:.4g} rad/s of the record: the follower lifts off",
            ),
            Judgement("guide friction over the pull of the chain", f["mu"]),
            Judgement("mass of the iron", f["iron_iron_m"]),
            Judgement("stiffness of its spring", f["iron_spring_c"]),
            fitting.next_record(r.advice, f["mu"].error or math.inf, "the friction", ""),
        ]

    def show(self, f: Mapping[str, Figure], r: IdentifiedIron) -> Show:
        """The torque over the cam angle with its band; each column measured and fitted; the mechanism."""
        styles = {SPEED: ("speed of the motor", BLUE), "iron.w_cam": ("speed of the cam", BLUE),
                 TORQUE: ("torque of the motor", RED)}  # fmt: skip
        charts = fitting.charts(r.fit, styles)
        if not r.fit.misfit:
            charts.insert(0, slow_torque_chart(r))
        result = r.fit.result
        last = float(result["time"][0]) + 2 * math.pi / mean_cam_speed(r.fit)
        moving = motion.live_motion("A turn of the fitted drive", result, r.machine, 4.0)
        return Show(charts, [moved(moving, result, last=last)])


class IdentifiedIron(NamedTuple):
    """A fit, its drive with the values found, and what each further record would leave of mu."""

    fit: Identified
    machine: System
    advice: Sequence[Advice]


def guess(o: IronIdentify, fmus: Mapping[str, Path], speed: cosim.Series) -> System:
    """The drive near the motion of a record: fed for its mean speed, and as far in its turn as makes
    the last turn of the record most like one of the drive.
    """
    fixed: dict[str, Any] = {"iron.on_invalid": 1, **iron.MOTOR, **o.start}
    gear = float(fixed.get("iron.reducer.i_g", 36.0))
    w, turned = o.speeds_and_angles(speed, "cam", gear)
    nu = float(np.median(w)) / gear
    fixed |= {SUPPLY: float(fixed["motor.B"]) * gear * nu + LOAD, "iron.w_cam": nu, TORQUE: LOAD}
    system = System(fmus, iron.WIRES, fixed)
    run = cosim.run(system, stop=4 * math.pi / nu, step=TURN / nu)
    angles = np.linspace(0.0, 2 * math.pi, ANGLES, endpoint=False)
    theirs = np.interp(angles + run["iron.phi"][-1] - 2 * math.pi, run["iron.phi"], run[SPEED])
    ours = np.interp(angles + turned[-1] - 2 * math.pi, turned, w)
    correlation = np.fft.irfft(np.fft.rfft(theirs) * np.fft.rfft(ours).conj())
    ahead = run["iron.phi"][-1] + angles[int(np.argmax(correlation))] - turned[-1]
    phi = (ahead + math.pi) % (2 * math.pi) - math.pi
    first = max(0.0, float(np.median(w[:5]))) / gear
    return replace(system, start={**fixed, "iron.phi": phi, "iron.w_cam": first})


def drive(fit: Identified, values: Mapping[str, float]) -> System:
    """The drive with these values."""
    system = fit.problem.system
    mine = {
        name: x for name, x in values.items() if name in (*FREE, *fit.names) and "(" not in name
    }
    return replace(system, start={**system.start, **mine})


def derived_quantities(fit: Identified) -> dict[str, Callable[[Mapping[str, float]], float]]:
    """What follows from the values found, by the names of DERIVED."""

    @cache
    def turned(system: tuple[tuple[str, Value], ...]) -> tuple[float, float]:
        machine = replace(fit.problem.system, start=dict(system))
        loss = iron.turn(machine, 1.0, SAMPLES)["iron.E_friction"][-1]
        return float(loss), iron.limits(machine)["follower_limit"].value

    def derived(which: int, v: Mapping[str, float]) -> float:
        return turned(tuple(drive(fit, v).start.items()))[which]

    def mu(v: Mapping[str, float]) -> float:
        up, down = 1 + v["iron.friction.K_up"], 1 + v["iron.friction.K_down"]
        return (up - down) / (up + down)

    return {"mu": mu, "loss": partial(derived, 0), "follower_limit": partial(derived, 1)}


def figures(iron_data: IdentifiedIron) -> dict[str, Figure]:
    """Friction, what it takes, the speed where the follower lifts off, how far the record is from it,
    and all values that were free.
    """
    fit, margin = (
        iron_data.fit,
        ("%", "cam speed where the follower lifts off, above that of the record"),
    )
    if fit.misfit:
        why = "no drive of this kind fits the record"
        each = {**DERIVED, "away": margin}
        return {name: Figure.undetermined(unit, why, text) for name, (unit, text) in each.items()}
    quantities = derived_quantities(fit)
    all_figures = {
        name: figure_of(fit.interval(quantities[name], unit), text)
        for name, (unit, text) in DERIVED.items()
    }
    fixed = iron.limits(iron_data.machine)["follower_limit"].error or 0.0
    limit, mean = all_figures["follower_limit"], mean_cam_speed(fit)
    limit = all_figures["follower_limit"] = limit._replace(error=(limit.error or 0.0) + fixed)
    all_figures["away"] = figure_of_figures(
        lambda x: 100.0 * (x / mean - 1.0), limit, unit=margin[0], meaning=margin[1]
    )
    return all_figures | fitting.fitted_figures(fit)


def mean_cam_speed(fit: Identified) -> float:
    """Mean speed of the cam in the record [rad/s]."""
    t, phi = fit.result["time"], fit.result["iron.phi"]
    return float((phi[-1] - phi[0]) / (t[-1] - t[0]))


def advice(o: IronIdentify, fit: Identified) -> list[Advice]:
    """What further records would leave of the interval of the friction, the best first."""
    records = fitting.further_records(
        fit,
        STATES,
        rest={"iron.phi": -math.pi / 3, "iron.w_cam": 0.0, TORQUE: 0.0},
        supply=SUPPLY,
        steps={"a step of the supply to 120 %": 1.2, "a step of the supply to half": 0.5},
        torque={TORQUE: FORESEEN * o.rated_torque},
    )
    return cosim.advise(fit, records, derived_quantities(fit)["mu"])


def slow_torque_chart(r: IdentifiedIron) -> Chart:
    """The torque that turns the cam slowly, with the band of its interval."""

    @cache
    def torque(start: tuple[tuple[str, Value], ...]) -> tuple[Samples, Samples]:
        turn = iron.turn(replace(r.machine, start=dict(start)), 1.0, SAMPLES)
        return np.degrees(turn["iron.phi"]), turn["iron.tau_cam"]

    def at(k: int, v: Mapping[str, float]) -> float:
        return float(torque(tuple(drive(r.fit, v).start.items()))[1][k])

    phi = torque(tuple(r.machine.start.items()))[0]
    each: list[Any] = [r.fit.interval(partial(at, k), "N.m") for k in range(len(phi))]
    curve = Curve(
        "slow cam", phi, [x.value for x in each], RED, "line", [x.error for x in each]
    )  # fmt: skip
    spans = iron.phases(r.fit.result.provenance["parts"]["iron"]["parameters"])
    title = "Torque at the cam of the fitted drive, with its 95 % band"
    return Chart(title, "cam angle [deg]", [Panel("torque", "N.m", [curve])], spans=spans)
