"""Two systems that others published: error against cost, below theirs."""

from pathlib import Path

import pytest

from benchmarks.published import ALGORITHMS, CASES, cost, system

ORDER_6, HELD = "Gauss-Seidel, inputs of order 6", "Strang, inputs held"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "tolerance", "error", "steps"),
    [("quarter car", 0.1, 3.2e-4, 150 * 3), ("predators and prey", 1e-3, 1e-4, 2000)],
)
def test_coupled_runs_cost_less_than_published(
    name: str, tolerance: float, error: float, steps: int, tmp_path: Path
) -> None:
    coupled = system(CASES[name], tmp_path)
    measured = cost(CASES[name], coupled, tolerance, **ALGORITHMS[ORDER_6])
    assert measured.error < error
    assert measured.do_steps < steps
    held = cost(CASES[name], coupled, tolerance, **ALGORITHMS[HELD])
    assert held.error > error, "held inputs are as bad as theirs, so that the bound can fail"
