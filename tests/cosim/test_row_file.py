"""All rows of a run, beside those that its result keeps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Adaptive, run
from cosim.accuracy.nested import stored_column
from tests.cosim.test_cosim import pair


def stored(path: Path, width: int) -> Any:
    """All rows of a file, by its columns."""
    return np.column_stack([stored_column(path, width, k) for k in range(width)])


@pytest.mark.parametrize("record", [["motor.tau"], ["motor.tau", "conveyor.phi"]])
@pytest.mark.parametrize("every", [1, 7])
def test_all_rows_are_those_of_each_step_and_the_result_is_the_same_without_them(
    record: list[str], every: int, native: Path, tmp_path: Path
) -> None:
    """Also where the last step is shorter than the others."""
    step, stop = 1e-3, 0.05 + 2e-4
    settings = {"stop": stop, "step": step, "record": record}
    without_file = run(pair(native), output_step=every * step, **settings)
    path = tmp_path / "rows"
    result = run(pair(native), output_step=every * step, all_rows=path, **settings)
    dense = run(pair(native), output_step=step, **settings)
    np.testing.assert_array_equal(result.data, without_file.data)
    np.testing.assert_array_equal(stored(path, len(result.columns)), dense.data)


def test_all_rows_of_adaptive_steps_and_of_a_grid_with_events(native: Path, tmp_path: Path) -> None:
    path = tmp_path / "rows"
    adaptive = {"stop": 0.05, "step": Adaptive(1e-4), "record": ["motor.tau"]}
    run(pair(native), output_step=0.01, all_rows=path, **adaptive)
    np.testing.assert_array_equal(stored(path, 2), run(pair(native), **adaptive).data)
