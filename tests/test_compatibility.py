"""The folder for the page of FMI tools keeps its rules, and holds no FMU that an importer finds wrong."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import __version__ as fmpy_version
from fmpy import read_model_description

from tests.conftest import rewritten
from tools import compatibility
from tools.compatibility import MOST_VARIABLES, write_compatibility

#: Keys of an entry and what their values may be: CONTRIBUTING.md of modelica/fmi-standard.org.
TEXTS = {"name", "license", "url", "vendor", "vendorURL", "examplesURL", "description"}
LISTS = {
    "features": set[str](), "platforms": {"macOS", "Linux", "Windows"}, "interfaces": {"GUI", "CLI", "library"},
    "fmiVersions": {"1.0", "2.0", "3.0"}, "fmuExport": {"CS", "ME", "SE"}, "fmuImport": {"CS", "ME", "SE"},
    "layeredStandards": {"BUS", "XCP", "REF", "STRUCT"},
}  # fmt: skip


@pytest.mark.parametrize("name", ["DriveMotor", "SpeedController"])
def test_the_files_of_an_fmu_keep_the_rules(native: Path, tmp_path: Path, name: str) -> None:
    write_compatibility([native / f"{name}.fmu"], tmp_path)
    folder = tmp_path / "FMI_2.0" / name
    names = {f"{name}{end}" for end in (".fmu", "_ref.csv", "_in.csv", "_ref.opt")}
    assert {path.name for path in folder.iterdir()} == names | {"Readme.txt"}
    options = dict(
        line.split(", ") for line in (folder / f"{name}_ref.opt").read_text().splitlines()
    )
    variables = {
        v.name: v.causality
        for v in read_model_description(str(folder / f"{name}.fmu")).modelVariables
    }
    for end, kind in (("_ref.csv", "output"), ("_in.csv", "input")):
        text = (folder / f"{name}{end}").read_text()
        heading, *rows = csv.reader(text.splitlines())
        assert text.startswith('"time",') and len(heading) <= 1 + MOST_VARIABLES
        assert {variables[x] for x in heading[1:]} == {kind}
        time = np.array([float(row[0]) for row in rows])
        assert (np.diff(time) > 0.0).all()
        assert (time[0], time[-1]) == (float(options["StartTime"]), float(options["StopTime"]))
    assert set(heading[1:]) == {x for x, causality in variables.items() if causality == "input"}
    page = (tmp_path / "README.md").read_text()
    assert f"| {name} | 2.0 | " in page and f"FMPy {fmpy_version}" in page


def test_the_entry_keeps_the_rules(tmp_path: Path) -> None:
    write_compatibility([], tmp_path)
    entry = json.loads((tmp_path / "tools.json").read_text())
    assert entry.keys() == TEXTS | LISTS.keys()
    assert all(isinstance(entry[key], str) for key in TEXTS)
    assert all(set(entry[key]) <= allowed for key, allowed in LISTS.items())
    assert entry["license"] in ("osi", "commercial") and not entry["description"].endswith(".")


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


def test_a_file_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compatibility, "MOST_BYTES", 10)
    with pytest.raises(ValueError, match="more than 10"):
        compatibility.write_csv(tmp_path / "x.csv", ["time", "x"], np.ones((3, 2)))
