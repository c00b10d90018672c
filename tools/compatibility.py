"""What the page of FMI tools asks of a tool that exports FMUs: a folder for each FMU, and the tool's entry.

Their rules stand in CONTRIBUTING.md of the repository modelica/fmi-standard.org. Nothing is published from here.
"""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from fmpy import __version__ as fmpy_version
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

from cosim import __version__
from cosim.fmu.reference_rows import ReferenceRows

#: Most variables of a file of results: the rules. With these no FMU here comes near their limit of 1 MB.
MOST_VARIABLES = 10
#: What of the range of a signal an importer may be off: the tolerance of the cross-check's users is 1e-2.
ALLOWED = 1e-6
#: The entry in static/assets/tools.json. A person fills in where the project and this folder are published.
ENTRY: dict[str, Any] = {
    "name": "drive-fmus",
    "license": "osi",
    "url": "",
    "vendor": "The drive FMU authors",
    "vendorURL": "",
    "examplesURL": "",
    "description": "Make FMUs of electromechanical drives and of other equations written in Python, couple FMUs, and state "
    "the error of the results",
    "features": [],
    "platforms": ["macOS", "Linux", "Windows"],
    "interfaces": ["CLI", "library"],
    "fmiVersions": ["2.0", "3.0"],
    "fmuExport": ["CS", "ME"],
    "fmuImport": ["CS", "ME"],
    "layeredStandards": ["REF"],
}  # fmt: skip


def write_compatibility(fmus: list[Path], folder: Path) -> None:
    """Write a folder FMI_VERSION/NAME for each FMU that carries results, a page with what was tried, and the entry.

    Raises ValueError for an FMU that FMPy finds invalid, or that gives other results in FMPy.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    for fmu in fmus:
        version = read_model_description(str(fmu)).fmiVersion
        lines.append(write_example(fmu, folder / f"FMI_{version}" / fmu.stem))
    page = [
        "# FMUs of drive-fmus, with reference results", "",
        f"Made by drive-fmus {__version__} for macOS, Linux and Windows. This page is the project's own, not one of the Modelica Association. "
        "Each folder has the FMU, its results (`_ref.csv`), its inputs (`_in.csv`), options (`_ref.opt`) and a Readme.", "",
        f"Checked by FMPy {fmpy_version} (`fmpy validate`): no problem. Imported and simulated, with the largest difference from `_ref.csv` as a "
        "share of a signal's range:", "",
        f"| FMU | FMI | FMPy {fmpy_version}, co-simulation |", "|---|---|---|", *lines, "",
    ]  # fmt: skip
    (folder / "README.md").write_text("\n".join(page), encoding="utf-8")
    (folder / "tools.json").write_text(json.dumps(ENTRY, indent=4) + "\n", encoding="utf-8")


def write_example(fmu: Path, folder: Path) -> str:
    """Write the files of an FMU; the line of the page that says how it ran."""
    rows, about = ReferenceRows.of_fmu(fmu), read_model_description(str(fmu))
    if rows is None:
        raise ValueError(f"{fmu} carries no results")
    if problems := validate_fmu(str(fmu)):
        raise ValueError(f"{fmu}: {'; '.join(problems)}")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(fmu, folder)
    name, values = fmu.stem, rows.values
    time, step = values.t, float(values.t[1] - values.t[0])
    names = values.names[1 : 1 + MOST_VARIABLES]
    inputs = {v.name: number(v.start) for v in about.modelVariables if v.causality == "input"}
    tables: dict[str, dict[str, Any]] = {
        "ref": {"time": time} | {n: values.numbers(n) for n in names},
        "in": {"time": time[[0, -1]], **inputs} if inputs else {},
    }
    for kind, columns in tables.items():
        if columns:
            pd.DataFrame(columns, dtype=float).to_csv(
                folder / f"{name}_{kind}.csv", index=False, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n"
            )  # fmt: skip
    options = f"StartTime, {time[0]}\nStopTime, {time[-1]}\nStepSize, {step}\nRelTol, {ALLOWED}\nOutputIntervalLength, {step}\n"
    (folder / f"{name}_ref.opt").write_text(options, encoding="utf-8")
    (folder / "Readme.txt").write_text(
        f"{name}: {about.description}.\n\nFMI {about.fmiVersion}, with its default experiment and constant inputs. "
        f"Validated and simulated with FMPy {fmpy_version}.\n",
        encoding="utf-8",
    )
    found = simulate_fmu(
        str(fmu), start_time=time[0], stop_time=time[-1], step_size=step, output_interval=step, output=names,
        fmi_type="CoSimulation",
    )  # fmt: skip
    at = np.searchsorted(found["time"], time - 0.5 * step)
    off = max(difference(np.asarray(found[n], float)[at], values.numbers(n)) for n in names)
    if not off <= ALLOWED:
        raise ValueError(f"{fmu} in FMPy: off by {off:.2g} of a signal's range")
    return f"| {name} | {about.fmiVersion} | {off:.1g} |"


def difference(found: Any, reference: Any) -> float:
    """The largest difference as a share of the range, or of the size where there is none."""
    return float(
        np.abs(found - reference).max() / (np.ptp(reference) or np.abs(reference).max() or 1.0)
    )


def number(start: str) -> float:
    """A start value as the rules have it: Booleans as 0 and 1."""
    return float({"true": "1", "false": "0"}.get(start, start))
