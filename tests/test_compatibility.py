"""The folder for the page of FMI tools keeps its rules, and holds no FMU that an importer finds wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from fmpy import read_model_description

from tests.conftest import rewritten
from tools.compatibility import MOST_VARIABLES, write_compatibility


@pytest.mark.parametrize("name", ["DriveMotor", "SpeedController"])
def test_the_files_of_an_fmu_keep_the_rules(native: Path, tmp_path: Path, name: str) -> None:
    """Inputs and outputs over growing times, few enough, from the start to the stop that the options state."""
    write_compatibility([native / f"{name}.fmu"], tmp_path)
    folder = tmp_path / "FMI_2.0" / name
    lines = (folder / f"{name}_ref.opt").read_text().splitlines()
    options = dict(line.split(", ") for line in lines)
    description = read_model_description(str(folder / f"{name}.fmu"))
    variables = {v.name: v.causality for v in description.modelVariables}
    for end, kind in (("_ref.csv", "output"), ("_in.csv", "input")):
        table = pd.read_csv(folder / f"{name}{end}")
        time, *names = table.columns
        assert time == "time" and len(names) <= MOST_VARIABLES
        assert {variables[x] for x in names} == {kind}
        assert table["time"].is_monotonic_increasing and table["time"].is_unique
        ends = [float(options[x]) for x in ("StartTime", "StopTime")]
        assert table["time"].iloc[[0, -1]].tolist() == ends


def test_results_that_an_importer_does_not_get_are_refused(native: Path, tmp_path: Path) -> None:
    def edit(files: dict[str, Any]) -> None:
        (name,) = (n for n in files if n.endswith(".csv") and not n.endswith("_error.csv"))
        heading, *rows = files[name].decode().splitlines()
        moved = [
            ",".join([row.split(",")[0], *(str(1.001 * float(x)) for x in row.split(",")[1:])])
            for row in rows
        ]
        files[name] = "\n".join([heading, *moved, ""]).encode()

    wrong = rewritten(native / "DriveMotor.fmu", tmp_path / "DriveMotor.fmu", edit)
    with pytest.raises(ValueError, match=r"DriveMotor.fmu in FMPy: off by"):
        write_compatibility([wrong], tmp_path / "out")
