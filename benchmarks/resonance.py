"""Do the stated errors of `resonance` hold?

Draws drives, asks the scenario for a sweep of each, many drives in one batch, and compares its figures with the exact
orbits of tests/scenarios/orbit_oracle.py. Rows are printed as they come; with --out they are kept as lines of JSON, and
those already kept are not run again. Drives whose orbit is unstable somewhere in the sweep, or is
not found because the crank would stop or nearly so, are skipped and counted.

Shown per figure are the drives that have it (exist), the share of the stated errors that hold
(within) and the number of those that do not (missed), the worst of error over stated error (worst),
the share that is refused or missing (refused), how often one is stated that the sweep does not hold
(invented), and the median of the stated error over the figure (median).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shlex
import statistics
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np

from cosim import SetupError
from scenarios.project import PROJECT
from tests.scenarios.orbit_oracle import (
    Drive,
    NoOrbitError,
    f_rod_peak,
    features,
    orbit,
    question,
    random_drive,
)
from workbench import Context

#: The page that this backs, and its heading.
CLAIM = ("docs/scenarios.md", "How far the errors can be trusted")

FIGURES = ("nu_90", "nu_peak_tau", "tau2_peak", "nu_peak_w", "w2_peak", "f_rod_peak")
#: Error of an exact figure, relative: a convention, which limits the stated errors that are tested.
TRUTH_ERROR = 1e-9
#: Drives that are listed with their commands: a convention, which limits the output.
LISTED = 10
Row = dict[str, Any]


def command(drive: Drive, sweep: tuple[float, float, int]) -> str:
    """The words that ask the scenario for a drive."""
    words = ["scenarios", "run", "resonance", "--flavour", "native"]
    words += ["--speeds", ":".join(map(repr, sweep))]
    for name, value in drive.start.items():
        words += ["--start", f"{name}={json.dumps(value)}"]
    return shlex.join(words)


def drawn(seed: int, number: int) -> tuple[Row, dict[str, Any]]:
    """Truth of a drive, the first of its own sequence that keeps to an orbit, and how the scenario is asked for it."""
    rng = np.random.default_rng([seed, number])
    skipped: Counter[str] = Counter()
    while True:
        drive = random_drive(rng)
        sweep = question(rng, drive)
        try:
            truth = features(drive, *sweep[:2])
            truth["f_rod_peak"] = f_rod_peak(drive, np.linspace(*sweep))
            ripple = abs(orbit(drive, drive.nu_res).w2) / drive.nu_res
            break
        except NoOrbitError as error:
            skipped["unstable" if "unstable" in str(error) else "not found"] += 1
    row = {
        "seed": seed, "number": number, "command": command(drive, sweep), "zeta": drive.zeta,
        "ripple": ripple, "finite": drive.finite, "skipped": skipped, "truth": truth,
    }  # fmt: skip
    return row, {"speeds": ":".join(map(repr, sweep)), "start": drive.start}


def judged(seed: int, numbers: Sequence[int]) -> list[Row]:
    """Truth and answer of drives, whose answers are made in one batch."""
    rows, options = zip(*(drawn(seed, number) for number in numbers))
    scenario = PROJECT.load("resonance")
    context = Context(PROJECT.fmus(scenario, "native"))
    began = time.process_time()
    answers = scenario.solve_all(context, [scenario.parse(x) for x in options])
    seconds = (time.process_time() - began) / len(rows)
    for row, answer in zip(rows, answers):
        refused = isinstance(answer, SetupError)
        figures = {} if refused else answer.figures
        row |= {
            "seconds": seconds,
            "sentence": str(answer) if refused else "",
            "stated": {
                name: {"value": figures[name].value, "error": figures[name].error}
                for name in FIGURES
                if name in figures
            },
        }
    return list(rows)


def error_over_stated(row: Row, name: str) -> float | None:
    """Error over stated error, infinite for an invented one, None where none is stated."""
    truth, stated = row["truth"][name], row["stated"].get(name, {"error": None})
    if stated["error"] is None:
        return None
    if truth is None:
        return math.inf
    error = max(0.0, abs(stated["value"] - truth) - TRUTH_ERROR * abs(truth))
    if not stated["error"]:
        return math.inf if error else 0.0
    return error / stated["error"]


def line(row: Row) -> str:
    """A drive in a line."""
    ratios = {name: error_over_stated(row, name) for name in FIGURES}
    existing = [name for name in FIGURES if row["truth"][name] is not None]
    refused = [name for name in existing if ratios[name] is None]
    worst = max(FIGURES, key=lambda name: ratios[name] or 0.0)
    text = (
        f"{row['number']:>4}  zeta {row['zeta']:<7.3g} ripple {row['ripple']:<8.2g} "
        f"{'finite' if row['finite'] else 'long':<6} {row['seconds']:6.1f} s  "
    )
    if row["sentence"]:
        return text + row["sentence"]
    text += f"worst {ratios[worst] or 0.0:.3g} ({worst})"
    return text + (f", refused {', '.join(refused)}" if refused else "")


def table(rows: Sequence[Row]) -> Iterator[str]:
    """The counts per figure and in total."""
    yield (
        f"{'':<12}{'exist':>6}{'within':>8}{'missed':>8}{'worst':>10}{'refused':>9}{'invented':>9}"
        f"{'median':>10}"
    )
    for names in (*((name,) for name in FIGURES), FIGURES):
        cases = [(row, name) for row in rows for name in names]
        existing = [case for case in cases if case[0]["truth"][case[1]] is not None]
        stated = [
            (case, error_ratio)
            for case in existing
            if (error_ratio := error_over_stated(*case)) is not None
        ]
        invented = sum(
            error_over_stated(*case) is not None
            for case in cases
            if case[0]["truth"][case[1]] is None
        )
        missed = sum(error_ratio > 1 for _, error_ratio in stated)
        relative = [
            row["stated"][name]["error"] / abs(row["truth"][name]) for (row, name), _ in stated
        ]
        yield (
            f"{names[0] if len(names) == 1 else 'all':<12}{len(existing):>6}"
            f"{percent(len(stated) - missed, len(stated)):>8}{missed:>8}"
            f"{max((error_ratio for _, error_ratio in stated), default=math.nan):>10.3g}"
            f"{percent(len(existing) - len(stated), len(existing)):>9}{invented:>9}"
            f"{statistics.median(relative) if relative else math.nan:>10.1e}"
        )


def percent(part: int, total: int) -> str:
    """A share in words."""
    return f"{100 * part / total:.1f} %" if total else "-"


def worst(rows: Sequence[Row]) -> Iterator[str]:
    """The drives with the worst figures, and how to ask them again."""
    error_ratios = [
        (error_over_stated(row, name) or 0.0, name, row) for row in rows for name in FIGURES
    ]
    listed: set[int] = set()
    for error_ratio, name, row in sorted(error_ratios, key=lambda entry: -entry[0]):
        if error_ratio > 1 and row["number"] not in listed and len(listed) < LISTED:
            listed.add(row["number"])
            truth, stated = row["truth"][name], row["stated"][name]
            exact = "none" if truth is None else f"{truth:.9g}"
            statement = f"{stated['value']:.9g} +- {stated['error']:.2g}"
            yield f"{error_ratio:.3g} times: {name} = {statement}, exact: {exact}\n    {row['command']}"


def kept_rows(path: Path | None, seed: int, number: int) -> list[Row]:
    """The rows of this seed that a file holds."""
    if path is None or not path.exists():
        return []
    rows = [json.loads(text) for text in path.read_text().splitlines()]
    return [row for row in rows if row["seed"] == seed and row["number"] < number]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=100, help="of drives")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--block", type=int, default=20, help="drives in a batch")
    parser.add_argument(
        "--out", type=Path, help="file of the rows; those it holds are not repeated"
    )
    options = parser.parse_args()
    rows = kept_rows(options.out, options.seed, options.number)
    present = {row["number"] for row in rows}
    wanted = [number for number in range(options.number) if number not in present]
    try:
        for first in range(0, len(wanted), options.block):
            for row in judged(options.seed, wanted[first : first + options.block]):
                rows.append(row)
                print(line(row), flush=True)
                if options.out:
                    options.out.parent.mkdir(parents=True, exist_ok=True)
                    with options.out.open("a") as file:
                        file.write(json.dumps(row) + "\n")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    skipped = sum((Counter(row["skipped"]) for row in rows), Counter())
    reasons = ", ".join(f"{count} {why}" for why, count in skipped.items()) or "none"
    failed = sum(bool(row["sentence"]) for row in rows)
    print(
        f"\n{len(rows)} drives of seed {options.seed}, {failed} refused as a whole; skipped: {reasons}"
    )
    print("\n".join(table(rows)))
    print("\n".join(worst(rows)))


if __name__ == "__main__":
    main()
