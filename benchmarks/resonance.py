"""Do the stated errors of `resonance` hold?

Draws drives, asks the scenario for a sweep of each, many drives in one batch, and compares its figures with the exact
orbits of tests/scenarios/orbit_oracle.py. Drives whose orbit is unstable somewhere in the sweep, or is not found because
the crank would stop or nearly so, are skipped and counted in the words of the drive that is taken instead.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np

from benchmarks.coverage import Demand, Stated, Study, Trial, main, rng_of
from cosim import SetupError
from scenarios.project import PROJECT
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


STUDY = Study(
    __doc__, {"resonance": drives}, number=100, demands={"resonance": Demand()}, at_once=20
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
