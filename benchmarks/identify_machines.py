"""How often the questions of the iron and the orientator hold the truth.

Machines are drawn at random, recorded by `examples/measured_iron.py` and `examples/measured_orientator.py`,
which share no equation with the FMUs, and asked about by the question, with no guess of its own.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.coverage import Demand, Stated, Study, Trial, main
from cosim import System, quiet
from examples import measured_iron, measured_orientator
from scenarios.iron import machine
from scenarios.orientator.products import simulated_limit
from scenarios.project import PROJECT
from workbench.question import Question
from workbench.run import answer

#: The page that this backs, and its heading.
CLAIM = ("docs/identify.md", "The iron and the orientator")

STAGES = [f"t_{stage}" for stage in measured_orientator.STAGES]
#: Lowest speed at which the orientator is recorded [rpm]. Chosen: a slow line.
LOWEST_SPEED = 25.0
#: How many speeds it is recorded at. Chosen: an afternoon with a camera.
SPEEDS = 10


def draw_iron(rng: np.random.Generator, seed: int) -> tuple[Any, dict[str, Any], dict[str, float]]:
    """A record of an iron drive, what is asked, and what is true."""
    p = {x: v * 1.2 ** rng.uniform(-1.0, 1.0) for x, v in measured_iron.TRUTH.items()}
    m = p["iron.iron.m"]
    options = {
        "map": ["time=t", "iron.w=n", f"motor.tau=M*{measured_iron.RATED / 100}:N.m"],
        "known": [f"iron.iron.m={m * (1 + 0.01 * rng.standard_normal())}+-{0.01 * m}"],
    }
    up, down = 1 + p["iron.friction.K_up"], 1 + p["iron.friction.K_down"]
    system = System({"iron": PROJECT.folders["native"] / "IronDrive.fmu"},
                    start={x: v for x, v in p.items() if x.startswith("iron.")})  # fmt: skip
    true = {
        "mu": (up - down) / (up + down),
        "loss": float(machine.turn(system, 1.0, 360)["iron.E_friction"][-1]),
        "follower_limit": machine.limits(system)["follower_limit"].value,
        **{x.replace(".", "_").lower(): p[x] for x in ("iron.spring.c", "iron.friction.K_up")},
    }
    return measured_iron.record(seed, p), options, true


def draw_orientator(
    rng: np.random.Generator, seed: int
) -> tuple[Any, dict[str, Any], dict[str, float]]:
    """Stage times of products at speeds up to nine tenths of the limit, what is asked, what is true."""
    H = 0.04 * (1 + 0.01 * rng.standard_normal())
    p = {"orientator.chute.mu": rng.uniform(0.15, 0.55), "orientator.chute.H": H}
    system = System({"orientator": PROJECT.folders["native"] / "GravityOrientator.fmu"}, start=p)
    with quiet():
        limit = simulated_limit(system, p["orientator.chute.mu"])[1].value
    speeds = np.linspace(LOWEST_SPEED, 0.9 * limit, SPEEDS).round(1).tolist()
    options = {
        "map": ["orientator.w=n", *(f"orientator.{x}={x[2:]}" for x in STAGES)],
        "known": ["orientator.chute.H=0.04+-1%"],
        "noise": [f"orientator.{x}={measured_orientator.NOISE}ms" for x in STAGES],
    }
    true = {"orientator_chute_mu": p["orientator.chute.mu"], "limit": limit}
    return measured_orientator.record(seed, p, speeds), options, true


KINDS = {"iron_identify": draw_iron, "orientator_identify": draw_orientator}


def trial(name: str, seed: int) -> Trial:
    """One machine, asked about."""
    rng = np.random.default_rng([seed, [*KINDS].index(name)])
    rows, options, true = KINDS[name](rng, seed)
    question: type[Question] = PROJECT.load(name)
    began = time.process_time()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        rows.to_csv(path, index=False)
        o = question.parse({**options, "data": str(path), "starts": 6})
        result = answer(question, o, PROJECT.fmus(question, "native"))
    seconds = time.process_time() - began
    figures = {}
    for key, truth in true.items():
        figure = result.figures.get(key)
        value, error = (figure.value, figure.error) if figure else (None, None)
        figures[key] = Stated.of(value, error, truth)
    return Trial(name, seed, figures, seconds, result.verdict)


STUDY = Study(
    __doc__,
    {name: partial(trial, name) for name in KINDS},
    number=30,
    demands={name: Demand(within=0.9) for name in KINDS},  # 95 % intervals of some figures each
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
