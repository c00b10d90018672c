"""Each member of an ensemble speaks for itself: all that a run says of itself is that of a single run, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Adaptive, Result, Series, System, certify, run, sweep
from cosim.engine.settings import RunSettings
from cosim.metrics import Crossing, Largest, Last, Mean, Metric, Rms, TimeOfLargest
from cosim.prepared import How, Prepared
from cosim.result import SimulationError

from .drawn import pack2, pack3

#: Drawn ensembles by default, and in the long run.
FEW, MANY = 6, 60
SEEDS = [pytest.param(k, marks=[] if k < FEW else [pytest.mark.slow]) for k in range(MANY)]
#: How long a run takes is its own.
OWN = {"wall_time"}
MEMBERS = 4


def draw(seed: int, folder: Path) -> tuple[System, dict[str, list[float]], dict[str, Any]]:
    """Two coupled parts with a jump of an input or a change, start values of the members, and settings."""
    rng = np.random.default_rng([seed, 63])
    version = int(rng.choice([2, 3]))
    part = (pack3 if version == 3 else pack2)(folder / "drawn.fmu")
    start = {"p.a": -1.0, "q.a": -2.0, "p.b": -3.0, "q.b": 1.0, "p.x": 1.0, "q.c": 2.0, "q.d": 0.0}
    at = float(rng.choice([0.3, 0.301, 0.303, 0.3 + 1e-9, 0.256]))
    system = System({"p": part, "q": part}, ["p.x -> q.u", "q.x -> p.u"], start)
    kind = rng.choice(["change", "free", "none"], p=[0.4, 0.5, 0.1])
    if kind == "change":
        system = replace(system, changes=[f"at {at!r} s q.d = 1"])
    elif kind == "free":
        table = Series.of({"t": [0.0, at, at, 1.0], "v": [0.0, 0.5, 2.0, 1.0]})
        system = replace(system, wires=system.wires[:1], inputs={"p.u": table})
    cases = {"p.x": rng.normal(size=MEMBERS).tolist(), "q.a": (-rng.random(MEMBERS)).tolist()}
    settings: dict[str, Any] = {
        "stop": 0.5,
        "step": 4e-3,
        "algorithm": str(rng.choice(["strang", "jacobi", "gauss-seidel"])),
    }
    return system, cases, settings


def members_one_by_one(
    system: System, cases: dict[str, list[float]], settings: dict[str, Any], **varied: Any
) -> list[Result]:
    """Single runs of the members, each with its own of the settings that vary."""
    results = []
    for k in range(MEMBERS):
        start = {**system.start, **{name: column[k] for name, column in cases.items()}}
        own = settings | {name: values[k] for name, values in varied.items()}
        try:
            results.append(run(replace(system, start=start), **own))
        except SimulationError as error:
            results.append(error.result)
    return results


def require_equal(member: Result, single: Result) -> None:
    """Rows, breaks, and what the run says of itself are those of a single run."""
    assert member.names == single.names
    assert member.data.shape == single.data.shape
    assert member.data.tobytes() == single.data.tobytes()
    assert member.breaks.tolist() == single.breaks.tolist()
    facts = {k: v for k, v in member.provenance.items() if k not in OWN}
    assert facts == {k: v for k, v in single.provenance.items() if k not in OWN}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("jobs", [1, 2])
def test_members_with_other_steps_and_stops_are_single_runs(
    seed: int, jobs: int, tmp_path: Path
) -> None:
    """Steps and stops in any order, beside a jump at, or between, communication points."""
    system, cases, settings = draw(seed, tmp_path)
    rng = np.random.default_rng(seed)
    steps = rng.permutation([1e-3, 2e-3, 4e-3, 0.8e-3]).tolist()
    stops = rng.choice([0.304, 0.3045, 0.31, 0.4, 0.5], MEMBERS).tolist()
    if seed % 3 == 0:
        settings["output_step"] = 4e-3
    if seed % 3 == 1:
        steps = [Adaptive(t) for t in (1e-3, 1e-4, 1e-2, 1e-3)]
    with Prepared.open(system, RunSettings(**settings)) as prepared:
        ensemble = prepared.map(cases, jobs=jobs, steps=steps, stops=stops)
    singles = members_one_by_one(system, cases, settings, step=steps, stop=stops)
    for k, single in enumerate(singles):
        require_equal(ensemble.result(k), single)


def test_rows_at_a_jump_are_there_whichever_member_is_first(tmp_path: Path) -> None:
    """Steps of 2 ms and 1 ms beside a jump at 301 ms: only the second has a row before and after it."""
    part = pack2(tmp_path / "p.fmu")
    table = Series.of({"t": [0.0, 0.301, 0.301, 1.0], "v": [0.0, 0.0, 1.0, 1.0]})
    system = System({"p": part}, [], {"p.b": 1.0}, inputs={"p.u": table})
    settings = RunSettings(0.4, 2e-3, output_step=2e-3)
    for steps in ([2e-3, 1e-3], [1e-3, 2e-3]):
        with Prepared.open(system, settings) as prepared:
            ensemble = prepared.map(2, steps=steps)
        for k, step in enumerate(steps):
            require_equal(ensemble.result(k), run(system, stop=0.4, step=step, output_step=2e-3))


FIGURES: dict[str, Metric] = {
    "last": Last("q.x"), "largest": Largest("p.x"), "when": TimeOfLargest("p.x"),
    "mean": Mean("q.x"), "rms": Rms("p.x"), "crossing": Crossing("q.x", level=0.1),
}  # fmt: skip


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("adaptive", [False, True])
def test_errors_of_a_certified_sweep_are_those_of_single_runs(
    seed: int, adaptive: bool, tmp_path: Path
) -> None:
    """Values, errors and reasons of every member are those of `certify`, whichever member is the first."""
    system, cases, settings = draw(seed, tmp_path)
    settings["step"] = (
        Adaptive(1e-3) if adaptive else float(np.random.default_rng(seed).choice([1e-3, 2e-3]))
    )
    settings["stop"] = [0.312, 0.5, 0.35][seed % 3]
    table = sweep(system, cases, FIGURES, certified=True, how=How(jobs=1), **settings)
    for k in range(MEMBERS):
        start = {**system.start, **{name: column[k] for name, column in cases.items()}}
        alone = certify(replace(system, start=start), FIGURES, **settings).figures
        for name, estimate in alone.items():
            value, error = table[name].iloc[k], table[f"{name} error"].iloc[k]
            np.testing.assert_equal(
                float(value), float(np.nan if estimate.value is None else estimate.value)
            )
            np.testing.assert_equal(
                float(error), float(np.nan if estimate.error is None else estimate.error), name
            )
