"""Do remedies turn an answer, and is the answer not yet turned before them?

Draws machines whose answer is not what one wants, seeks their remedies, and bisects where the answer turns by something else:
for drives the exact orbits of tests/scenarios/orbit_oracle.py, for irons and orientators the question with half the step. A
remedy is stated as the interval from the value at which the judgement is not yet turned to that at which it is. The limit of a
drive is so near to its ripple that many inputs turn it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scipy.optimize import brentq

from benchmarks.coverage import Demand, Stated, Study, Trial, main, rng_of
from scenarios.conveyor.live_ripple import SLIDERS
from scenarios.conveyor.orbit import DriveOrbit
from scenarios.project import PROJECT
from tests.scenarios.orbit_oracle import NAMES, NoOrbitError, orbit, random_drive
from workbench import Context, Slider
from workbench.answer import option_values, parameters
from workbench.context import captured_log_warnings
from workbench.orbits import solve_each
from workbench.remedies import Remedy, Search, search_for

#: The page that this backs, and its heading.
CLAIM = ("docs/scenarios.md", "What would make an answer good")
#: How far beyond its interval a turn is looked for, over its width: the truth of a remedy that is off by more is none.
BEYOND = 10.0
Excess = Callable[[Remedy, float], float]


def stated(remedy: Remedy, excess: Excess) -> Stated:
    """Return the interval of a remedy and where its judgement turns."""
    wide = BEYOND * (remedy.value - remedy.outside)
    ends = sorted((remedy.outside - wide, remedy.value + wide))
    try:
        truth: float | None = float(brentq(partial(excess, remedy), *ends, rtol=1e-9))
    except (ValueError, NoOrbitError):
        truth = None
    low, high = sorted((remedy.outside, remedy.value))
    return Stated((low + high) / 2.0, low, high, truth)


def searched(o: Any, context: Context, sliders: Sequence[Slider]) -> Search:
    """Return the search for what makes an answer good."""
    (found,) = solve_each(context, [o])
    if isinstance(found, Exception):
        raise found
    assert found.system is not None
    values = {**parameters(found.system), **option_values(o, found.defaults)}
    return search_for(o, context, found, sliders, values)


def trial(kind: str, seed: int, search: Search, excess: Excess, case: str) -> Trial:
    """Return the remedies of a machine, each beside the truth."""
    began = time.process_time()
    with captured_log_warnings():  # of values that nobody would choose
        found = [x for each in search.remedies()[:1] for x in each.found]
        seconds = time.process_time() - began
        sides = [f"{x.varied.name} {'from' if x.is_upper else 'up to'}" for x in found]
        figures = {side: stated(x, excess) for side, x in zip(sides, found)}
    return Trial(kind, seed, figures, seconds, "" if found else "no remedy", case)


def drive(seed: int) -> Trial:
    """A drive near its resonance, and the exact orbits of its changed machines."""
    rng = rng_of(seed)
    while True:
        machine = random_drive(rng)
        nu = machine.nu_res * rng.uniform(0.85, 1.15)
        try:
            level = rng.uniform(0.4, 0.9) * abs(orbit(machine, nu).tau2)
            break
        except NoOrbitError:
            continue

    def excess(remedy: Remedy, x: float) -> float:
        name = remedy.varied.name
        if name == "speed":
            return abs(orbit(machine, x).tau2) - level
        changed: Mapping[str, Any] = {NAMES[name]: x}
        return abs(orbit(replace(machine, **changed), nu).tau2) - level

    context = Context(PROJECT.fmus(DriveOrbit, "native"))
    o = DriveOrbit.parse(
        {"start": machine.start, "speed": nu, "limit": 100.0, "rated_torque": level}
    )
    sliders = [
        Slider(x.name, y / 3.0, 3.0 * y)
        for x in (*SLIDERS, Slider("motor.B", 0.0, 0.0))
        for y in [nu if x.name == "speed" else getattr(machine, NAMES[x.name])]
    ]
    return trial(
        "drive", seed, searched(o, context, sliders), excess, f"{machine} at {nu!r}, {level!r}"
    )


def asked_again(
    name: str, options: Mapping[str, Any], finer: Mapping[str, Any]
) -> tuple[Search, Excess]:
    """Return the search of a question, and the margin of its first judgement by another step."""
    question = PROJECT.load(name)
    context = Context(PROJECT.fmus(question, "native"))
    o, again = question.parse(options), question.parse({**options, **finer})
    (found,) = solve_each(context, [o])
    if isinstance(found, Exception):
        raise found
    page = o.live(found.figures, found.data)
    search = searched(o, context, getattr(page, "sliders", o.sliders))
    other = replace(search, question=again)

    def excess(remedy: Remedy, x: float) -> float:
        (here,) = other.ask(context, [(remedy.varied, x)])
        return other.margin(other.wanted[0], again.with_value(remedy.varied.name, x), here)[0]

    return search, excess


def iron(seed: int) -> Trial:
    """A sealing iron above the speed at which its follower lifts off."""
    rng = rng_of(seed, 1)
    options = {
        "speed": rng.uniform(8.3, 12.0), "samples": 360,
        "start": {"iron.iron.m": rng.uniform(3.0, 5.0), "iron.spring.c": rng.uniform(200.0, 350.0)},
    }  # fmt: skip
    return trial("iron", seed, *asked_again("iron_cycle", options, {"samples": 720}), str(options))


def orientator(seed: int) -> Trial:
    """An orientator whose wall would have to pull."""
    rng = rng_of(seed, 2)
    options = {
        "speed": rng.uniform(3.4, 4.3),
        "start": {"orientator.cup.m": rng.uniform(0.03, 0.05)},
    }
    return trial(
        "orientator",
        seed,
        *asked_again("orientator_cycle", options, {"step": "0.5ms"}),
        str(options),
    )


KINDS: dict[str, Callable[[int], Trial]] = {x.__name__: x for x in (drive, iron, orientator)}
STUDY = Study(__doc__, KINDS, number=10, demands={kind: Demand(within=0.99) for kind in KINDS})

if __name__ == "__main__":
    sys.exit(main(STUDY))
