"""What a run does to the process that it runs in: nothing that the rest of it would notice."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim import Result, System, run
from cosim.cli.system_file import single_fmu_system
from tests.cosim.foreign import pack


@pytest.fixture
def system(tmp_path: Path) -> System:
    return single_fmu_system(pack(tmp_path / "A.fmu"))


@pytest.mark.parametrize("output_step", [0.3, 1.0, 7.3, 2.0**64 * 0.1, 1e300])
def test_rows_further_apart_than_a_run_is_long_are_its_first_and_last(
    output_step: float, system: System
) -> None:
    """2^64 steps are no number of C, and none of them a division by zero."""
    result: Result = run(system, stop=0.3, step=0.1, output_step=output_step, record=["A.y"])
    assert result["time"].tolist() == [0.0, 0.3]
    assert result.provenance["loop"] == "compiled"
