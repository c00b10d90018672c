"""Coupling algorithms are read from one registry: what is registered runs, is predicted and is verified."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from cosim import SetupError, diagnose, run
from cosim.engine.algorithms import (
    REGISTRY,
    Algorithm,
    CouplingContext,
    Feedthrough,
    Stage,
    Turn,
)
from tests.cosim.test_verification import require_theory
from tests.coupling_theory import Ideal, Scheme
from tests.linear_systems import BENCHMARKS, couple

DRIVE = BENCHMARKS["drive"]


class ReverseSplitting(Algorithm):
    """The symmetric splitting, begun with the last part."""

    name = "reverse splitting"
    summary = "Strang's schedule with the first part in the middle."
    held_order = 2

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        first, *rest = parts
        inward: list[Stage] = [(Turn(part, 0.0, 0.5),) for part in reversed(rest)]
        return [*inward, (Turn(first),), *((Turn(part, 0.5, 0.5),) for part in rest)]


class Trapezoidal(Algorithm):
    """Inputs are held at the mean of what the sources show at the beginning and the end."""

    name = "trapezoidal"
    summary = "All parts repeat the step with the mean of both ends."
    held_order, end_weight = 2, 0.5

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        return [tuple(Turn(part) for part in parts)]


class HalfIterated(Algorithm):
    """An implicit algorithm of more than one stage."""

    name, summary, end_weight = "half iterated", "It cannot be.", 1.0

    def stages(self, parts: Sequence[str]) -> list[Stage]:
        return [(Turn(part),) for part in parts]


@pytest.mark.parametrize("algorithm", [ReverseSplitting(), Trapezoidal()], ids=lambda a: a.name)
@pytest.mark.parametrize("system", ["oscillator", "drive"])
def test_a_registered_algorithm_runs_as_theory_predicts(
    fmus: Path, monkeypatch: pytest.MonkeyPatch, algorithm: Algorithm, system: str
) -> None:
    monkeypatch.setitem(REGISTRY, algorithm.name, algorithm)
    require_theory(fmus / "LinearSystem.fmu", BENCHMARKS[system], Scheme(algorithm.name))


def test_an_unknown_algorithm_is_refused(fmus: Path) -> None:
    system = couple(DRIVE.units, fmus / "LinearSystem.fmu")
    for use in (
        lambda: run(system, stop=1.0, step=0.1, algorithm="my-own"),
        lambda: diagnose(system, step=0.1, algorithm="my-own"),
        lambda: Ideal(DRIVE.units).step(Scheme("my-own"), 0.1),
    ):
        with pytest.raises(SetupError, match="'my-own' must be one of jacobi, gauss-seidel"):
            use()


def test_an_implicit_algorithm_of_several_stages_is_refused(
    fmus: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(REGISTRY, "half iterated", HalfIterated())
    with pytest.raises(SetupError, match="must have one stage, of whole steps"):
        run(
            couple(DRIVE.units, fmus / "LinearSystem.fmu"),
            stop=1.0, step=0.1, algorithm="half iterated",
        )  # fmt: skip


def test_outputs_that_show_the_end_of_a_step_keep_the_order_of_the_states() -> None:
    """On the way back of the splitting, a hears what b shows at the end; b never hears a there."""
    feedthroughs = [
        Feedthrough("a.y", "a", frozenset({"b"}), is_wired=False),
        Feedthrough("b.y", "b", frozenset({"a"}), is_wired=False),
        Feedthrough("a.z", "a", frozenset({"b", ""}), is_wired=False),
    ]
    context = CouplingContext(["a", "b"], feedthroughs)
    strang = REGISTRY["strang"]
    assert strang.convergence_order(context) == 2
    assert strang.first_order_outputs(context) == {"b.y", "a.z"}
    assert REGISTRY["gauss-seidel"].first_order_outputs(context) == {"a.y", "b.y", "a.z"}
    moving = CouplingContext(["a", "b"], feedthroughs, input_degree=2, interpolates=True)
    assert strang.convergence_order(moving) == 3 and strang.first_order_outputs(moving) == set()


def test_the_page_of_the_master_lists_the_registry() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "master.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert rows == [
        f"| `{name}` | {algorithm.summary} | {algorithm.held_order} |"
        for name, algorithm in REGISTRY.items()
    ]


def test_strang_is_symmetric_in_time() -> None:
    """Of three parts the last takes a whole step between the halves of the others, the second in reverse."""
    begin, end = (
        [(Turn(part, at, 0.5),) for part in parts] for parts, at in (("ab", 0.0), ("ba", 0.5))
    )
    assert REGISTRY["strang"].stages("abc") == [*begin, (Turn("c"),), *end]
