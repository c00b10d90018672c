"""What happens at one time happens by one rule, the same for every algorithm and step, as an exact solution has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cosim import ALGORITHMS, Adaptive, Result, SetupError, run

from .event_exact import NEAR, Drawn, draw

#: Drawn systems by default, and in the long run.
FEW, MANY = 4, 60
#: Exponentials of the parts and of the solution differ by rounding [relative].
ROUNDING = 1e-9


def seeds(*, coupled: bool) -> list[Any]:
    """Drawn systems, all but a few of them slow."""
    return [
        pytest.param(
            seed, coupled, marks=[] if seed < FEW else [pytest.mark.slow],
            id=f"{seed}{' coupled' * coupled}",
        )
        for seed in range(MANY)
    ]  # fmt: skip


def compared_columns(drawn: Drawn) -> list[str]:
    """What the solution knows of the outputs."""
    known = {2: "xe", 3: "xyen"}
    return [f"{p}.{v}" for p, version in drawn.versions.items() for v in known[version]]


def deviations(drawn: Drawn, result: Result) -> dict[str, float]:
    """The largest distance of each column from the solution; at an event from the nearer side of it."""
    worst = dict.fromkeys(compared_columns(drawn), 0.0)
    for k, t in enumerate(result["time"]):
        before, after = drawn.exact.at(float(t))
        for name in worst:
            x = float(result[name][k])
            worst[name] = max(worst[name], min(abs(x - before[name]), abs(x - after[name])))
    return worst


def require_after(drawn: Drawn, result: Result) -> None:
    """The last row at the time of an event shows samples as they are after it."""
    times = result["time"]
    for k, t in enumerate(times):
        is_last = k + 1 == len(times) or times[k + 1] > t + NEAR
        if is_last and t < drawn.stop - NEAR:
            after = drawn.exact.at(float(t))[1]
            for p in (p for p, version in drawn.versions.items() if version == 3):
                for name in (f"{p}.y", f"{p}.n"):
                    assert result[name][k] == after[name], (name, t)


def settings_of(drawn: Drawn, algorithm: str) -> dict[str, Any]:
    return {"stop": drawn.stop, "step": drawn.step, "algorithm": algorithm, "order": drawn.order}


@pytest.mark.parametrize(("seed", "coupled"), [*seeds(coupled=False), *seeds(coupled=True)])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_samples_and_held_signals_are_those_of_the_solution(
    seed: int, coupled: bool, algorithm: str, tmp_path: Path
) -> None:
    """Parts whose states do not drive each other are exact as well; if they do, samples still are."""
    drawn = draw(seed, coupled=coupled)
    result = run(drawn.system(tmp_path), **settings_of(drawn, algorithm))
    worst = deviations(drawn, result)
    for name, error in worst.items():
        if name.endswith(".x"):
            assert coupled or error < ROUNDING * (1.0 + float(np.abs(result[name]).max())), name
        else:
            assert error == 0.0, name
    require_after(drawn, result)


@pytest.mark.parametrize(("seed", "coupled"), seeds(coupled=True))
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_states_converge_with_the_order_of_the_algorithm(
    seed: int, coupled: bool, algorithm: str, tmp_path: Path
) -> None:
    """From h to h/8 the error falls by at least half of 8^p."""
    drawn = draw(seed, coupled=coupled)
    system, settings = drawn.system(tmp_path), settings_of(drawn, algorithm)
    errors = []
    for step in (0.1 / 4, 0.1 / 32):
        result = run(system, **settings | {"step": step})
        order = result.provenance["convergence_order"]
        errors.append(max(e for n, e in deviations(drawn, result).items() if n.endswith(".x")))
    assert errors[1] < max(errors[0] / (0.5 * 8.0**order), 1e-9)


@pytest.mark.parametrize(("seed", "coupled"), [*seeds(coupled=False), *seeds(coupled=True)])
def test_adaptive_steps_end_at_what_is_known(seed: int, coupled: bool, tmp_path: Path) -> None:
    """Samples are exact whatever the steps, and states are within the tolerance."""
    drawn = draw(seed, coupled=coupled)
    settings = settings_of(drawn, "strang") | {"step": Adaptive(1e-4)}
    result = run(drawn.system(tmp_path), **settings)
    for name, error in deviations(drawn, result).items():
        size = float(np.abs(result[name]).max())
        assert error <= (1e-2 * (1.0 + size) if name.endswith(".x") else 0.0), name
    times = result["time"]
    exact = drawn.exact
    for t in (t for t, a, b in zip(exact.events, exact.before, exact.after) if a != b):
        assert np.abs(times - t).min() < NEAR, t
    require_after(drawn, result)


def pair(**more: Any) -> Drawn:
    """p counts the ticks of a clock of 0.25 s, q samples the count by the same clock, in steps of 0.1 s."""
    start = {"p.q": 1.0, "p.g": 1.0, "p.d": 1.0, "q.q": 0.0, "q.g": 1.0}
    ticks = {"p": (0.25, 0.25), "q": (0.25, 0.25)}
    return Drawn({"p": 3, "q": 3}, {"q.d": "p.y"}, start, ticks=ticks, **more)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("step", [0.1, 0.25, 0.05, 0.3])
@pytest.mark.parametrize("order", [["p", "q"], ["q", "p"]])
def test_parts_of_one_clock_tick_in_the_stepping_order(
    algorithm: str, step: float, order: list[str], tmp_path: Path
) -> None:
    """q sees the count of this tick if p steps before it, else that of the last one; none is lost."""
    drawn = pair(order=order, step=step)
    result = run(drawn.system(tmp_path), **settings_of(drawn, algorithm))
    assert deviations(drawn, result)["q.y"] == 0.0
    seen = [float(x) for x in np.unique(result["q.y"])]
    if step <= 0.25:
        assert seen == ([0, 1, 2, 3, 4] if order == ["p", "q"] else [0, 1, 2, 3])
    require_after(drawn, result)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_parts_tick_at_the_start_by_the_same_rule(algorithm: str, tmp_path: Path) -> None:
    """The first tick is at the start: q samples 1 at once."""
    drawn = pair()
    drawn = Drawn(drawn.versions, drawn.wires, drawn.start, ticks=dict.fromkeys("pq", (0.25, 0.0)))
    result = run(drawn.system(tmp_path), **settings_of(drawn, algorithm))
    assert [float(x) for x in dict.fromkeys(result["q.y"].tolist())] == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("kind", ["table", "change"])
@pytest.mark.parametrize("event", ["clock", "time"])
@pytest.mark.parametrize("at", [0.5, 0.45])
def test_an_input_changes_before_the_event_of_that_time(
    algorithm: str, kind: str, event: str, at: float, tmp_path: Path
) -> None:
    """The part samples at `at` what its input takes there; what is set after the last event is not sampled."""
    start = {"p.g": 1.0, "p.d": 1.0}
    if event == "time":
        start |= {"p.period": 10.0, "p.first": at}
    drawn = Drawn(
        {"p": 3}, {}, start, {"p.d": ([0.0, at, at + 0.2], [1.0, 106.0, 7.0])},
        ticks={"p": (10.0, at)} if event == "clock" else {},
        changed=frozenset({"p.d"} if kind == "change" else ()),
    )  # fmt: skip
    result = run(drawn.system(tmp_path), **settings_of(drawn, algorithm))
    assert result["p.y"][-1] == 106.0
    assert deviations(drawn, result)["p.y"] == 0.0


def test_a_part_that_cannot_vary_its_step_is_refused_or_told(tmp_path: Path) -> None:
    """A tick inside its step cannot be met: the run does not give a late sample without a word."""
    drawn = pair()
    try:
        result = run(drawn.system(tmp_path, varies=False), **settings_of(drawn, "strang"))
    except SetupError as error:
        assert "p" in str(error) and "0.25" in str(error)
    else:
        assert any("tick" in text or "event" in text for text in result.warnings)
    exact = pair(step=0.05)
    result = run(exact.system(tmp_path, varies=False), **settings_of(exact, "gauss-seidel"))
    assert_allclose(list(deviations(exact, result).values()), 0.0)
