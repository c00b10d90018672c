"""The command `cosim sweep`."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...dense import Array, Curves
from ...errors import SetupError, pluralize
from ...metrics import (
    Integral,
    Largest,
    Last,
    Mean,
    Metric,
    Rms,
    Smallest,
    Swing,
    TimeOfLargest,
    TimeOfSmallest,
)
from ...result import growth_start, write_table
from ...result import partial as partial_file
from ...series import Series
from ...system import Network, Port, Value
from ...system.start_values import checked_start, value_of_text
from ...threads import available_cores
from ..options import Parser, assignment, parse_time
from ..output import new_folders, print_table, print_written_files, require_outputs
from ..system_file import add_stepping_options, add_system_options, open_system

SUMMARY = "Run many cases of a system and make a table of figures."

if TYPE_CHECKING:
    import pandas as pd

#: What may be asked of a column.
METRICS: dict[str, Any] = {
    "largest": Largest, "smallest": Smallest, "swing": Swing, "mean": Mean, "rms": Rms, "last": Last,
    "integral": Integral, "time_of_largest": TimeOfLargest, "time_of_smallest": TimeOfSmallest,
}  # fmt: skip
FIGURE = re.compile(r"(?P<kind>[^:]*):(?P<column>[^@]+?)(?:@(?P<begin>[^@]*?)\.\.(?P<end>[^@]*))?")
SPAN = re.compile(r"(?P<low>[^:]+):(?P<high>[^:]+):\s*(?P<n>\d+)\s*")
#: How --vary reads.
VARIED = "NAME=from:to:n with n of at least 2, or NAME=a,b,c"
#: Runs of a sweep. A convention: their cases and figures fit into memory.
MOST_RUNS = 1_000_000
#: Rows of a table that is printed; a longer one is written. A convention: more do not fit on a screen.
MOST_PRINTED = 20


@dataclass(frozen=True)
class GrowthStart(Metric):
    """From when on a column grows without bound; nan if it does not."""

    def measure(self, curves: Curves) -> Array:
        """The time [s] of each curve."""
        return growth_start(curves.t, curves.x)


def execute(options: argparse.Namespace) -> int:
    """Run all cases of a system, and write and print the table; 1 if every run failed."""
    from ...prepared import How
    from ...progress import bar_of_runs
    from ...sweeps import sweep

    with open_system(options) as file:
        cases = cases_of(options, file.network)
        _require_effect(cases, file.network)
        figures = dict(figure_of(text, file.network) for text in options.figure)
        if not figures:
            raise SetupError(
                "name a figure for each run: --figure largest:motor.tau; "
                f"there are {', '.join(METRICS)}"
            )
        require_outputs(options)
        if not options.timeout > 0.0:
            raise SetupError(f"--timeout {options.timeout:g} s must be above 0")
        settings = vars(file.settings(options)) | {"record": None}
        folders = new_folders(options)
        journal = None if options.out is None else partial_file(options.out).with_suffix(".journal")
        runs = len(next(iter(cases.values())))
        named = {c: f"{c} grows" for metric in figures.values() for c in metric.columns}
        asked = figures | ({} if options.certify else {n: GrowthStart(c) for c, n in named.items()})
        with bar_of_runs(file.title, runs) as progress:
            how = How(options.jobs, isolated=True, timeout=options.timeout, progress=progress)
            table = sweep(
                file.system, cases, asked, certified=options.certify, how=how, journal=journal,
                **settings,
            )  # fmt: skip
        _tell_growth(table, {} if options.certify else named)
        units = _units(file.network, cases, figures)
        table.insert(0, "run", range(1, runs + 1))
        if options.out is not None:
            facts = {str(k): v for k, v in table.attrs.items()}
            columns = {name: units[name] for name in map(str, table) if name in units}
            write_table(table, options.out, facts | {"units": columns})
        if options.plot is not None:
            _plot(table, list(cases), list(figures), units, options.plot)
    failed = int(table[next(iter(figures))].isna().sum())
    print(f"{pluralize(runs, 'run')}, {failed} failed")
    _print(table, figures, written=options.out is not None)
    print_written_files(options, folders)
    return 1 if failed == runs else 0


def _tell_growth(table: pd.DataFrame, named: Mapping[str, str]) -> None:
    """Put a column `unbounded`, what grows in each run and from when on, in place of those times."""
    times = {column: table.pop(name).tolist() for column, name in named.items()}
    texts = [
        "; ".join(
            f"{column} from {t[k]:g} s" for column, t in times.items() if not math.isnan(t[k])
        )
        for k in range(len(table))
    ]
    if times:
        table.insert(list(table).index("warnings"), "unbounded", texts)


def cases_of(options: argparse.Namespace, network: Network) -> Mapping[str, Sequence[Any]]:
    """The columns of start values that the options ask for; raises SetupError."""
    from ...sweeps import combinations, sample

    ways = {"--vary": options.vary, "--table": options.table, "--sample": options.sample}
    given = [name for name, value in ways.items() if value]
    if len(given) != 1:
        raise SetupError(
            f"{' and '.join(given)} cannot be used together" if given else
            "say what differs from run to run: --vary NAME=from:to:n, --table FILE, or --sample N "
            "--within NAME=a..b"
        )  # fmt: skip
    if options.within and not options.sample:
        raise SetupError("--within needs --sample N")
    if options.together and not options.vary:
        raise SetupError("--together needs --vary")
    if options.table:
        return _table(options.table, network)
    if options.sample:
        if not options.within:
            raise SetupError("--sample needs --within NAME=a..b")
        _require_few_runs(options.sample)
        bounds = _distinct([_bounds(text, network) for text in options.within])
        return sample(bounds, options.sample, options.seed)
    axes = _distinct([_axis(text, network) for text in options.vary])
    lengths = {name: len(values) for name, values in axes.items()}
    if not options.together:
        _require_few_runs(math.prod(lengths.values()))
        return combinations(axes)
    if len(set(lengths.values())) != 1:
        text = ", ".join(f"{name} has {n}" for name, n in lengths.items())
        raise SetupError(f"--together: as many values of each: {text}")
    return axes


def _require_effect(cases: Mapping[str, Any], network: Network) -> None:
    """Raise SetupError for start values of inputs that something drives: all runs would be the same."""
    driven = {wire.target.name: f"by {wire.source}" for wire in network.wires}
    driven |= {port.name: "over time" for port, _ in network.inputs}
    for name in cases:
        if name in driven:
            raise SetupError(f"{name} is driven {driven[name]}: its start value changes no run")


def _require_few_runs(runs: int) -> None:
    """Raise SetupError for more runs than a sweep may have."""
    if runs > MOST_RUNS:
        raise SetupError(f"{runs} runs are more than a sweep may have: at most {MOST_RUNS}")


def _distinct(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Pairs by name; raises SetupError for a name that is there twice."""
    for k, (name, _) in enumerate(pairs):
        if name in [other for other, _ in pairs[:k]]:
            raise SetupError(f"{name} is given twice")
    return dict(pairs)


def _axis(text: str, network: Network) -> tuple[str, list[Value]]:
    """The values of "motor.T=5ms:50ms:10", or of "motor.T=5ms,20ms"; raises SetupError."""
    name, content = assignment(text, VARIED)
    port = network.port(name)
    span = SPAN.fullmatch(content)
    if span is not None and int(span["n"]) > 1:
        _require_few_runs(int(span["n"]))
        low, high = (_number(network, port, span[key]) for key in ("low", "high"))
        values: list[Value] = np.linspace(low, high, int(span["n"])).tolist()
    elif ":" in content and port.type not in ("String", "Enumeration"):
        raise SetupError(f"{text!r} must read {VARIED}")
    else:
        values = [value_of_text(network, port, piece.strip()) for piece in content.split(",")]
    return port.name, [checked_start(network, port, value)[1] for value in values]


def _bounds(text: str, network: Network) -> tuple[str, tuple[float, float]]:
    """The bounds of "motor.T=5ms..50ms"; raises SetupError."""
    name, content = assignment(text, "NAME=a..b")
    port = network.port(name)
    low, dots, high = content.partition("..")
    if not dots:
        raise SetupError(f"{text!r} must read NAME=a..b")
    bounds = _number(network, port, low), _number(network, port, high)
    if not bounds[0] < bounds[1]:
        raise SetupError(f"{text!r}: the first value must be below the second")
    if port.type != "Real":
        raise SetupError(f"{port} is a {port.type} and cannot be sampled: use --vary or --table")
    for value in bounds:
        checked_start(network, port, value)
    return port.name, bounds


def _number(network: Network, port: Port, text: str) -> float:
    """A number, with a unit if needed; raises SetupError."""
    value = value_of_text(network, port, text.strip())
    if isinstance(value, str | bool):
        raise SetupError(f"{port.name} = {text.strip()!r} must be a number")
    return float(value)


def _table(path: Path, network: Network) -> dict[str, list[Value]]:
    """The columns of a file, whose headings name start values; cells may have units. Raises SetupError."""
    table, columns = Series.read_cells(path), []
    for column in table.columns:
        port = network.port(column.name)
        texts = (f"{cell}{column.unit}" if cell else "" for cell in table[column.name])
        columns.append((port.name, [value_of_text(network, port, text) for text in texts]))
    if not len(table.load(0)):
        raise SetupError(f"{path} has no row below its header")
    return _distinct(columns)


def figure_of(text: str, network: Network) -> tuple[str, Metric]:
    """The figure of "largest:motor.tau" or "mean:motor.tau@0.5..2", by that name; raises SetupError."""
    match = FIGURE.fullmatch(text)
    if match is None or match["kind"] not in METRICS:
        raise SetupError(
            f"figure {text!r} must read KIND:COLUMN or KIND:COLUMN@BEGIN..END, with one of {', '.join(METRICS)}"
        )
    port = network.port(match["column"])
    times = {"begin": -math.inf, "end": math.inf}
    for key in times:
        if match[key]:
            try:
                times[key] = parse_time(match[key])
            except argparse.ArgumentTypeError as error:
                raise SetupError(f"figure {text!r}: {error}") from None
    return text, METRICS[match["kind"]](port.name, **times)


def _units(
    network: Network, cases: Mapping[str, Any], figures: Mapping[str, Metric]
) -> dict[str, str]:
    """The units of the columns of the table."""
    units = {name: network.port(name).unit for name in cases}
    for name, metric in figures.items():
        unit = metric.unit(network.port(metric.columns[0]).unit)
        units[name] = units[f"{name} error"] = unit
    return units


def _print(table: pd.DataFrame, figures: Mapping[str, Metric], *, written: bool) -> None:
    """Print the table, or of a long one that is written the extremes of its figures."""
    if len(table) <= MOST_PRINTED or not written:
        words = [n for n in ("unbounded", "warnings", "reason") if n in table]
        same = {n: table[n].iloc[0] for n in words if table[n].nunique() == 1 and len(table) > 1}
        names = [n for n in map(str, table) if n not in words or (n not in same and any(table[n]))]
        for name, text in same.items():
            if text:
                print(f"{name} of all runs: {text}")
        cells = table.loc[:, names].to_numpy(object).tolist()
        texts = [[f"{x:.6g}" if isinstance(x, float) else str(x) for x in row] for row in cells]
        print_table([names, *texts])
        return
    rows = [["figure", "smallest", "in run", "largest", "in run"]]
    for name in figures:
        column = table[name].to_numpy()
        if not np.isnan(column).all():
            ends = int(np.nanargmin(column)), int(np.nanargmax(column))
            rows.append([name, *(x for k in ends for x in (f"{column[k]:.6g}", str(k + 1)))])
    print_table(rows)


def _plot(
    table: pd.DataFrame, names: list[str], figures: list[str], units: Mapping[str, str], path: Path
) -> None:
    """Plot every figure over every start value that differs."""
    from ...picture import Picture

    picture = Picture(
        figsize=(1.5 + 3.5 * len(names), 0.7 + 2.3 * len(figures)), layout="constrained"
    )
    axes = picture.subplots(len(figures), len(names), squeeze=False, sharex="col", sharey="row")
    mark = "-o" if len(names) == 1 else "o"
    for row, figure in zip(axes, figures):
        for axis, name in zip(row, names):
            axis.plot(table[name], table[figure], mark, markersize=3, linewidth=1)
            axis.grid(alpha=0.3)
        row[0].set_ylabel(f"{figure} [{units[figure]}]")
    for axis, name in zip(axes[-1], names):
        axis.set_xlabel(f"{name} [{units[name]}]" if units[name] else name)
    picture.savefig(path, dpi=150)


def add_options(parser: Parser) -> None:
    """Add the cases, the figures, how the system is stepped, and what is written."""
    add_system_options(parser, is_timed=True)
    parser.take("--vary", "--together", "--table", "--sample", "--within", "--seed", "--figure")
    parser.take("--certify", help="also run with other steps and give every figure with its error")
    add_stepping_options(parser, records=False)
    parser.take("--out", help=".csv or .parquet file; a JSON file next to it gives units")
    parser.take("--plot", help="picture of each figure over each varied value")
    parser.take("--jobs", default=available_cores())
    parser.take("--timeout")
