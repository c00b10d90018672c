"""Which friction, mass and spring does a measured sealing iron have, and how fast may its cam turn?

Motor and drive are fitted to a record of the motor's speed, and of its torque if that was measured.
Friction is proportional to the load. The record therefore shows (1 + K) m and (1 + K) c, with one K for
the way up and one for the way down, but not m and c themselves. One of them must be known, such as the
mass of an iron that was weighed. A record that no drive of this kind fits is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim import Identified, Result, SetupError, System
from cosim.system import Value
from workbench import (
    Chart,
    Context,
    Curve,
    Figure,
    Judgement,
    Panel,
    Question,
    Show,
    option,
)
from workbench.charts.model import SPEED as BLUE
from workbench.charts.model import TORQUE as RED
from workbench.figure import figure_of_figures
from workbench.fit import (
    FIT_ERROR_SCOPE,
    Fitted,
    Followed,
    Guess,
    RecordFit,
    RecordOptions,
    figure_of,
    fitted_charts,
    fitted_system,
    further_records,
    misfit,
    next_record,
)
from workbench.live import moved

from .. import machine as iron
from .. import motion

SPEED, TORQUE, SUPPLY = "iron.w", "motor.tau", "motor.A"
STATES = ("iron.phi", "iron.w_cam", TORQUE)
LOADS = ("iron.iron.m", "iron.spring.c", "iron.friction.K_up", "iron.friction.K_down")
FREE = ("motor.B", "motor.T", *LOADS)
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


class IronIdentify(Question, RecordOptions):
    """The record to fit, and the torque that the noise of further records is measured by."""

    parts = iron.PARTS
    fixed_starts = (SUPPLY, *STATES[1:])
    error_scope = FIT_ERROR_SCOPE
    is_sequential = True
    method = RecordFit(
        kind="drive of this kind",
        quantities={
            "mu": ("1", "guide friction over the pull of the chain"),
            "loss": ("J", "work of the guide friction per turn"),
            "follower_limit": ("rad/s", "cam speed where the follower lifts off"),
            "away": ("%", "cam speed where the follower lifts off, above that of the record"),
        },
        exact=("iron.reducer.J", "iron.reducer.i_g", "iron.spring.e_0"),
    )

    rated_torque: float = option(
        2.0,
        "rated torque of the motor, for the noise of a torque not yet measured",
        "N.m",
        above=0.0,
    )

    def guess(self, context: Context) -> Guess:
        """Return the drive near the motion of the record."""
        record = self.columns(SPEED)
        if not {text.partition("=")[0].strip() for text in self.known} & {*LOADS}:
            raise SetupError(
                f"{self.data}: the record shows only (1 + K) m and (1 + K) c; give what is known, as in "
                "--known iron.iron.m=4+-1%"
            )
        system = nearest_drive(self, context.fmus, record[SPEED])
        free = [SUPPLY, *FREE, *STATES]
        return Guess(system, record, free, {"first": ("iron.phi", SUPPLY)})

    def follow(self, context: Context, guess: Guess, fit: Identified) -> Followed:
        """Return what follows from the fit, and records like this one, from rest, and with steps of the supply."""
        records = further_records(
            fit,
            STATES,
            rest={"iron.phi": -math.pi / 3, "iron.w_cam": 0.0, TORQUE: 0.0},
            supply=SUPPLY,
            steps={"a step of the supply to 120 %": 1.2, "a step of the supply to half": 0.5},
            torque={TORQUE: FORESEEN * self.rated_torque},
        )
        return Followed(figures(fit), friction, records)

    def judgements(self, f: Mapping[str, Figure], r: Fitted) -> list[Judgement]:
        """What was found, how far the record is from the lift-off, and what to record next."""
        if r.fit.misfit:
            return misfit("a drive of this kind fits this record", r.fit.misfit)
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
            next_record(r.advice, f["mu"], "the friction", ""),
        ]

    def show(self, f: Mapping[str, Figure], r: Fitted) -> Show:
        """The torque over the cam angle with its band; each column measured and fitted; the mechanism."""
        styles = {SPEED: ("speed of the motor", BLUE), "iron.w_cam": ("speed of the cam", BLUE),
                 TORQUE: ("torque of the motor", RED)}  # fmt: skip
        charts = fitted_charts(r.fit, styles)
        if not r.fit.misfit:
            charts.insert(0, slow_torque_chart(r.fit))
        machine, result = fitted_system(r.fit, r.fit.start_values), r.fit.result
        last = float(result["time"][0]) + 2 * math.pi / mean_cam_speed(r.fit)
        moving = motion.live_motion("A turn of the fitted drive", result, machine, 4.0)
        return Show(charts, [moved(moving, result, last=last)])


def nearest_drive(o: IronIdentify, fmus: Mapping[str, Path], speed: cosim.Series) -> System:
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


def friction(v: Mapping[str, float]) -> float:
    """Return the guide friction over the pull of the chain."""
    up, down = 1 + v["iron.friction.K_up"], 1 + v["iron.friction.K_down"]
    return (up - down) / (up + down)


def slow_turns(fit: Identified) -> Callable[[Mapping[str, float]], Result]:
    """Return a function that gives a slow turn of the drive with values, each once."""

    @cache
    def turn(start: tuple[tuple[str, Value], ...]) -> Result:
        return iron.turn(replace(fit.problem.system, start=dict(start)), 1.0, SAMPLES)

    return lambda v: turn(tuple(fitted_system(fit, v).start.items()))


def figures(fit: Identified) -> dict[str, Figure]:
    """Friction, what it takes, the speed where the follower lifts off, and how far the record is from it."""

    def lift_off(v: Mapping[str, float]) -> Figure:
        return iron.limits(fitted_system(fit, v))["follower_limit"]

    mean, turn = mean_cam_speed(fit), slow_turns(fit)
    limit = figure_of(fit.interval(lambda v: lift_off(v).value, "rad/s"))
    at_rows = lift_off(fit.start_values).error or 0.0
    limit = limit._replace(error=(limit.error or 0.0) + at_rows)
    return {
        "mu": figure_of(fit.interval(friction, "1")),
        "loss": figure_of(fit.interval(lambda v: float(turn(v)["iron.E_friction"][-1]), "J")),
        "follower_limit": limit,
        "away": figure_of_figures(lambda x: 100.0 * (x / mean - 1.0), limit, unit="%"),
    }


def mean_cam_speed(fit: Identified) -> float:
    """Mean speed of the cam in the record [rad/s]."""
    t, phi = fit.result["time"], fit.result["iron.phi"]
    return float((phi[-1] - phi[0]) / (t[-1] - t[0]))


def slow_torque_chart(fit: Identified) -> Chart:
    """The torque that turns the cam slowly, with the band of its interval."""
    turn = slow_turns(fit)

    def torque(k: int, v: Mapping[str, float]) -> float:
        return float(turn(v)["iron.tau_cam"][k])

    phi = np.degrees(turn(fit.start_values)["iron.phi"])
    each: list[Any] = [fit.interval(partial(torque, k), "N.m") for k in range(len(phi))]
    curve = Curve(
        "slow cam", phi, [x.value for x in each], RED, "line", [x.error for x in each]
    )  # fmt: skip
    spans = iron.phases(fit.result.provenance["parts"]["iron"]["parameters"])
    title = "Torque at the cam of the fitted drive, with its 95 % band"
    return Chart(title, "cam angle [deg]", [Panel("torque", "N.m", [curve])], spans=spans)
