"""Do the stated errors of `resonance` hold?

Draws drives, asks the scenario for a sweep of each, many drives in one batch, and compares its figures with the exact
orbits of tests/scenarios/orbit_oracle.py. Drives whose orbit is unstable somewhere in the sweep, or is not found because
the crank would stop or nearly so, are skipped and counted in the words of the drive that is taken instead.

Drives with an induction motor, whose rotors are light and heavy, may have several steady motions at a speed: those of
the answer are compared with the stable ones that shooting finds from many starts.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
import time
from collections import Counter
from collections.abc import Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np

from benchmarks.coverage import Demand, Stated, Study, Trial, main, rng_of
from cosim import SetupError
from scenarios.conveyor.machine import start_values
from scenarios.conveyor.questions.resonance import Resonance
from scenarios.motor import nameplate
from scenarios.project import PROJECT
from tests.scenarios import shooting
from tests.scenarios.orbit_oracle import (
    Drive,
    NoOrbitError,
    edges,
    f_rod_peak,
    features,
    orbit,
    question,
    random_drive,
)
from workbench import Context

#: The page that this backs, and its heading.
CLAIM = ("docs/scenarios.md", "How far the errors can be trusted")

EDGE = "edge_{}"
FIGURES = ("nu_90", "nu_peak_tau", "tau2_peak", "nu_peak_w", "w2_peak", "f_rod_peak")
#: Levels of the torque ripple over its peak whose edges are asked for, one for each drive in turn: of a sharp resonance the higher ones
#: are passed twice between two speeds of a sweep.
LEVELS = (0.5, 0.8, 0.95)
#: Error of an exact figure, relative: a convention, which limits the stated errors that are tested.
TRUTH_ERROR = 1e-9
#: Speeds of a drive whose motions are sought, and states at each from which they are; difference of two that are one.
SPEEDS, STARTS, SAME = 8, 30, 1e-3
LARGEST = "largest ripple"
#: Speed over the nominal one below which a motion is that of a motor caught below its breakdown, to which no start leads.
SLOWEST = 0.7
#: Damping ratios of the drives with an induction motor, by first-order theory. Chosen: from sharp to hardly any resonance.
DAMPING = (0.03, 0.5)


def command(drive: Drive, sweep: tuple[float, float, int]) -> str:
    """The words that ask the scenario for a drive."""
    words = ["scenarios", "run", "resonance", "--flavour", "native"]
    words += ["--speeds", ":".join(map(repr, sweep))]
    for name, value in drive.start.items():
        words += ["--start", f"{name}={json.dumps(value)}"]
    return shlex.join(words)


def draw(seed: int) -> tuple[dict[str, float | None], str, dict[str, Any], str]:
    """Truth of a drive, the first of its own sequence that keeps to an orbit, words that ask for it, options, what it is."""
    rng = rng_of(seed)
    skipped: Counter[str] = Counter()
    while True:
        drive = random_drive(rng)
        sweep = question(rng, drive)
        try:
            truth = features(drive, *sweep[:2])
            truth["f_rod_peak"] = f_rod_peak(drive, np.linspace(*sweep))
            ripple = abs(orbit(drive, drive.nu_res).w2) / drive.nu_res
            level = LEVELS[seed % len(LEVELS)] * (
                truth["tau2_peak"] or ripple_at_ends(drive, sweep)
            )
            passed = edges(drive, *sweep[:2], level)
            truth |= {EDGE.format(k): x for k, x in enumerate(passed, 1)}
            break
        except NoOrbitError as error:
            skipped["unstable" if "unstable" in str(error) else "not found"] += 1
    rod = "finite" if drive.finite else "long"
    words = f"zeta {drive.zeta:.3g}, ripple {ripple:.2g}, {rod} rod"
    words += "".join(f", {count} skipped: {why}" for why, count in skipped.items())
    options = {
        "speeds": ":".join(map(repr, sweep)),
        "start": drive.start,
        "limit": 100.0,
        "rated_torque": level,
    }
    return truth, command(drive, sweep), options, words


def ripple_at_ends(drive: Drive, sweep: tuple[float, float, int]) -> float:
    """The larger torque ripple at the two ends of a sweep [N.m]."""
    return max(abs(orbit(drive, nu).tau2) for nu in sweep[:2])


def drives(seeds: Sequence[int]) -> list[Trial]:
    """Truth and answer of drives, whose answers are made in one batch."""
    drawn = [draw(seed) for seed in seeds]
    scenario = PROJECT.load("resonance")
    context = Context(PROJECT.fmus(scenario, "native"))
    began = time.process_time()
    answers = scenario.solve_all(context, [scenario.parse(options) for _, _, options, _ in drawn])
    seconds = (time.process_time() - began) / len(drawn)
    trials = []
    for seed, (truth, case, _, words), answer in zip(seeds, drawn, answers):
        refused = isinstance(answer, SetupError)
        figures = {} if refused else dict(answer.figures)
        passed = (x for name, x in figures.items() if name.startswith("avoid_"))
        figures |= {EDGE.format(k): x for k, x in enumerate(sorted(passed), 1)}
        names = [*FIGURES, *(x for x in {**truth, **figures} if x.startswith(EDGE.format("")))]
        stated = {name: _stated(figures.get(name), truth.get(name)) for name in names}
        text = str(answer) if refused else words
        trials.append(Trial("resonance", seed, stated, seconds, text, case))
    return trials


def _stated(figure: Any, truth: float | None) -> Stated:
    if figure is None or figure.error is None:
        return Stated(None, None, None, truth)
    known = 0.0 if truth is None else TRUTH_ERROR * abs(truth)
    return Stated.of(figure.value, figure.error + known, truth)


def draw_induction(seed: int) -> tuple[str, dict[str, Any], list[float]]:
    """The nameplate of a motor, the conveyor that it turns, and speeds about the resonance [rad/s]."""
    rng = rng_of(seed, 1)

    def spread(low: float, high: float) -> float:
        return float(f"{low * (high / low) ** rng.uniform():.3g}")

    zeta = 0.0
    while not DAMPING[0] < zeta < DAMPING[1]:
        power, poles, breakdown = spread(0.5, 30.0), 2 * int(rng.integers(1, 5)), spread(1.8, 3.8)
        rpm, gear = round(6000.0 / poles * (1.0 - spread(0.015, 0.08))), spread(0.5, 4.0)
        plate = f"{power} kW, {rpm} rpm, 50 Hz, {poles} poles, {breakdown}, {gear}:1"
        motor, resonance = nameplate(plate), spread(20.0, 150.0)
        B, w_s, T, s_b = (float(motor[f"motor.{x}"]) for x in ("B", "kloss.w_s", "T", "kloss.s_b"))
        zeta = 1.0 / (4.0 * T * resonance)
    # the speed ripple there, of the slip at which the motor breaks down
    swing = min(spread(0.1, 2.0) * s_b * w_s, 0.4 * resonance)
    inertia = B / (4.0 * T * resonance**2)
    trough = inertia * spread(0.02, 0.7)
    load = 0.4 * float(motor["motor.kloss.tau_b"]) / resonance * rng.uniform()
    gain = math.hypot(1.0, 1.0 / (2.0 * T * resonance)) / (2.0 * inertia * resonance)
    stiffness = trough * resonance**2 + swing / gain * rng.choice([1.0, -0.5])
    r = spread(0.004, 0.03)
    start = {
        "conveyor.rotor.J": inertia - trough, "conveyor.crank.r": r, "conveyor.trough.m": 2.0 * trough / r**2,
        "conveyor.trough.d": 2.0 * load / r**2, "conveyor.spring.c": 2.0 * max(float(stiffness), 0.0) / r**2,
        "conveyor.rod.l": r * spread(4.0, 40.0), "conveyor.rod.finite": bool(rng.integers(2)),
    }  # fmt: skip
    return plate, start, (np.linspace(0.7, 1.5, SPEEDS) * resonance).tolist()


def motions(seed: int) -> list[Trial]:
    """The motions of an induction drive at each of several speeds: of the answer, and by shooting from random states."""
    plate, start, speeds = draw_induction(seed)
    o = Resonance.parse({"nameplate": plate, "start": start, "speeds": speeds, "speed": speeds[0]})
    began = time.process_time()
    (found,) = Resonance.solve_all(Context(PROJECT.fmus(Resonance, "native")), [o])
    seconds = (time.process_time() - began) / len(speeds)
    case = f"--nameplate '{plate}' {start}"
    if isinstance(found, SetupError):
        nothing = {LARGEST: Stated(None, None, None, math.nan)}
        return [Trial("motions", seed, nothing, seconds, str(found), case)]
    fed = start_values(found.data.base, np.array(speeds))
    drive, motor = Drive.of(fed), shooting.Motor.of(fed)
    steady = [
        (speeds.index(nu), part.motions.states[k], part.motions.figure("tau2", k))
        for part in found.data.sweep.parts for k, nu in enumerate(part.speeds) if not part.motions.problems[k]
    ]  # fmt: skip
    bounds = [[[0.3]], [[-0.5]]], [[[1.3]], [[1.0]]]
    starts = rng_of(seed, 2).uniform(*bounds, (2, len(speeds), STARTS)) * motor.size[..., None]
    drawn = shooting.stable_motions(drive, motor, starts)
    own = shooting.Motor(*(x[[k for k, *_ in steady]] for x in motor))
    states = np.array([x for _, x, _ in steady])
    confirmed = shooting.stable_motions(drive, own, states.T[:, :, None]) if steady else []

    def is_same(k: int, state: Any, motion: shooting.Motion) -> bool:
        return bool((np.abs(state - motion.state) < SAME * motor.size[:, k]).all())

    trials = []
    for k, (nu, true) in enumerate(zip(speeds, drawn)):
        ours = [(x, figure) for j, x, figure in steady if j == k]
        figures = {}
        sought = [x for x in true if x.state[0] > SLOWEST * nu]
        for name, motion in zip(chain([LARGEST, "next"], repeat("others")), sought):
            same = next((figure for x, figure in ours if is_same(k, x, motion)), None)
            figures[name] = _stated(same, abs(motion.tau2))
        for (j, x, figure), again in zip(steady, confirmed):
            if j == k and not (again and is_same(k, x, again[0])):
                figures["not stable"] = _stated(figure, None)
        ripples = [f"{abs(x.tau2):.6g} (multiplier {x.multiplier:.3g})" for x in true]
        words = f"{nu:.4g} rad/s: {', '.join(ripples)} N.m, stated {', '.join(y.brief() for _, y in ours)}"
        words += found.data.sweep.problems().get(nu, "")
        trials.append(Trial("motions", seed, figures, seconds, words, f"{case} {nu!r}"))
    return trials


def motions_of(seeds: Sequence[int]) -> list[Trial]:
    """The motions of drives."""
    return [trial for seed in seeds for trial in motions(seed)]


STUDY = Study(
    __doc__,
    {"resonance": drives, "motions": motions_of},
    number=100,
    demands={"resonance": Demand(), "motions": Demand(0.995, refused=0.02)},
    at_once=20,
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
