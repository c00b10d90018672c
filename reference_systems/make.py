"""Write the reference systems with their exact answers: python -m reference_systems.make FOLDER.

Each system gets a folder: NAME.ssp (SSP 1.0, FMI 2.0), NAME_fmi3.ssp (SSP 2.0, FMI 3.0), NAME_ref.csv, NAME_ref_error.csv,
NAME_ref.json and the page NAME.md. A system whose two solutions do not agree is not written.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim import System, oracle, write_ssp
from reference_systems.equations import EQUATIONS, Solution, solve
from reference_systems.systems import ROOT, SYSTEMS, ReferenceSystem, build_fmus

Array = NDArray[np.float64]
HERE = Path(__file__).parent
#: Time between the rows of an answer [s]: the shortest communication step.
SPACING = 2.5e-4
#: Tolerance of the second solution: the least that it takes.
TOLERANCE = 1e-13


class ReferenceAnswer(NamedTuple):
    """Exact rows of a system: values, the error of each, events [s], and the share of the error that two solutions differ by."""

    time: Array
    values: Mapping[str, Array]
    errors: Mapping[str, Array]
    events: list[float]
    agreement: float


def judged_answer(equations: Solution, time: Array, system: System) -> ReferenceAnswer:
    """What the equations give, judged by the model-exchange sides of all FMUs, integrated as one system.

    The error of a value is that of its own integration and that of the judge, each from two tolerances. The two
    solutions must not differ by more, but their difference is in no error.

    Parameters
    ----------
    equations : Solution
        The signals of the equations.
    time : array of shape (rows,)
        Their times [s].
    system : System
        The FMUs.
    """
    names = list(equations.values)
    judge = oracle(
        system, stop=float(time[-1]), output_step=float(time[1]), record=names, tolerance=TOLERANCE
    )
    rows = np.searchsorted(judge["time"], time * (1.0 - 1e-12))
    rounding = np.finfo(float).eps
    errors = {
        name: equations.errors[name]
        + judge.provenance["errors"][name]
        + rounding * np.abs(equations.values[name])
        for name in names
    }
    shares = [
        np.abs(judge[name][rows] - equations.values[name]) / np.fmax(errors[name], rounding)
        for name in names
    ]
    return ReferenceAnswer(
        time,
        equations.values,
        errors,
        equations.events,
        float(max(share.max() for share in shares)),
    )


def exact_answer(
    key: str, system: System | None = None, stop: float | None = None
) -> ReferenceAnswer:
    """The answer of a reference system to its stop time or another [s], or what is judged of it by another `system`."""
    reference = SYSTEMS[key]
    rows = round((stop or reference.stop) / SPACING) + 1
    time: Array = np.arange(rows, dtype=np.float64) * SPACING
    solution = solve(EQUATIONS[key](reference.start), time)
    return judged_answer(solution, time, system or reference.system())


def write_system(key: str, reference: ReferenceSystem, folder: Path) -> str:
    """Write the files of a system; a line that says how closely the two solutions agree.

    Raises ValueError if they do not.
    """
    found = exact_answer(key)
    if not found.agreement <= 1.0:
        raise ValueError(
            f"{key}: the two solutions differ by {found.agreement:.3g} times their error"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for name, flavour in ((key, "native"), (f"{key}_fmi3", "fmi3")):
        write_ssp(reference.system(flavour), folder / f"{name}.ssp", stop=reference.stop, step=1e-3)
    write_rows(folder / f"{key}_ref.csv", found.time, found.values)
    write_rows(folder / f"{key}_ref_error.csv", found.time, found.errors)
    largest = max(float(e.max() / np.ptp(found.values[n])) for n, e in found.errors.items())
    facts: dict[str, Any] = {
        "title": reference.title, "stop": reference.stop, "steps": list(reference.steps),
        "orders": dict(reference.orders), "breaks": [[t, t] for t in found.events],
        "largest_error": largest, "difference_of_two_solutions": found.agreement,
    }  # fmt: skip
    (folder / f"{key}_ref.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    shutil.copy(HERE / "pages" / f"{key}.md", folder / f"{key}.md")
    return f"{key}: error at most {largest:.1g} of the range; the two solutions differ by {found.agreement:.2g} of it"


def write_rows(path: Path, time: Array, columns: Mapping[str, Array]) -> None:
    """Write a CSV file as the FMI cross-check has it: comma, names in quotes, all digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
        writer.writerow(["time", *columns])
        writer.writerows(zip(time.tolist(), *(x.tolist() for x in columns.values())))


def write_all(folder: Path, keys: list[str]) -> None:
    """Write these systems, with the licence and the page on how to enter the scoreboard."""
    for key in keys:
        print(write_system(key, SYSTEMS[key], folder / key), flush=True)
    shutil.copy(HERE / "README.md", folder / "README.md")
    shutil.copy(ROOT / "LICENSE", folder / "LICENSE")


def main() -> int:
    """Build the FMUs that are not up to date, and write all systems or those that are named."""
    parser = argparse.ArgumentParser(description="Write the reference systems.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("systems", nargs="*", help=f"some of {', '.join(SYSTEMS)} (default: all)")
    parser.add_argument(
        "--platforms", choices=("host", "all"), default="host", help="where the FMUs run"
    )
    options = parser.parse_args()
    if unknown := [name for name in options.systems if name not in SYSTEMS]:
        parser.error(f"unknown system {unknown[0]!r}; there are {', '.join(SYSTEMS)}")
    if build_fmus(options.platforms):
        return 1
    write_all(options.folder, options.systems or list(SYSTEMS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
