"""Many runs of one system: the values in which they differ, and what they give, as arrays with an axis for the members."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .dense import MOST_POINTS, Curves
from .engine.energy import balance
from .engine.snapshot import Case, SystemState
from .errors import SetupError
from .metrics import Metric
from .names import only
from .result import Result
from .series import Column
from .system import Network, Port, Value, enumeration
from .system.start_values import checked_start

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Cases:
    """The start values in which the members of an ensemble differ: a column of values for each port, shape (members,).

    Without any, all may `begin` with a state.
    """

    ports: tuple[Port, ...]
    columns: tuple[NDArray[Any], ...]
    members: int
    begin: SystemState | None = None

    @classmethod
    def of(cls, cases: Any, network: Network) -> Cases:
        """Read a mapping from names to values, a frame with a row for each member, or a number of equal members.

        Raises
        ------
        SetupError
            For what has no names, a name that the system does not have, columns of several lengths, and without a member.
        """
        if isinstance(cases, Cases):
            return cases
        if isinstance(cases, int):
            return cls((), (), cases)
        if not hasattr(cases, "keys"):
            raise SetupError(
                f"cases must be columns of start values by name, {{'motor.T': [0.04, 0.05]}}, or a number of runs, not a "
                f"{type(cases).__name__}; a run that begins with a state is one by itself: write run(Case(begin=state)), or so many: write map(2, begin=state)"
            )
        ports = tuple(network.port(str(name)) for name in cases)
        columns = tuple(_column(cases[name]) for name in cases)
        lengths = {str(port.name): column.shape for port, column in zip(ports, columns)}
        if len(set(lengths.values())) != 1 or any(len(shape) != 1 for shape in lengths.values()):
            text = ", ".join(f"{name} {shape}" for name, shape in lengths.items()) or "none"
            raise SetupError(f"cases must be columns of one length, a row for each run, not {text}")
        if not len(columns[0]):
            raise SetupError("there are no cases: give at least one")
        return cls(ports, columns, len(columns[0]))

    @property
    def names(self) -> list[str]:
        """The names of the start values."""
        return [port.name for port in self.ports]

    def case(self, k: int) -> Case:
        """The start values of a member."""
        values = (column[k] for column in self.columns)
        plain = (value.item() if isinstance(value, np.generic) else value for value in values)
        return Case(dict(zip(self.names, plain)), self.begin)

    def checked(
        self, network: Network, members: Sequence[int]
    ) -> tuple[list[tuple[Value, ...]], dict[int, str]]:
        """The values of members in the types of their ports, and by position why the others cannot have theirs."""
        wrong: dict[int, str] = {}
        columns = []
        for port, column in zip(self.ports, self.columns):
            some = column[members]
            values = some.tolist()
            for k in _positions_to_check(port, some).tolist():
                value = values[k].item() if isinstance(values[k], np.generic) else values[k]
                try:
                    values[k] = checked_start(network, port, value)[1]
                except SetupError as error:
                    wrong.setdefault(k, str(error))
            columns.append(values)
        checked = list(zip(*columns)) if columns else [()] * len(members)
        return [() if k in wrong else values for k, values in enumerate(checked)], wrong


def _positions_to_check(port: Port, values: NDArray[Any]) -> Numbers:
    """The positions of values that a port must be asked about one by one: the first, and what no limits allow."""
    is_sound = np.zeros(len(values), bool)
    if port.type == "Real" and port.native != "Float32" and values.dtype.kind == "f":
        low, high = (
            end if limit is None else float(limit)
            for end, limit in ((-np.inf, port.variable.min), (np.inf, port.variable.max))
        )
        is_sound = np.isfinite(values) & (values >= low) & (values <= high)
        is_sound[:1] = False
    return np.flatnonzero(~is_sound)


#: Where cases are known anyway.
NO_CASES = Cases((), (), 0)


class Facts(NamedTuple):
    """What a run says of itself: its provenance, and intervals in which columns may jump, as of `Result`.

    Members with the same step and stop may share it. Of such, `shown` are by the name of a start value the parts and
    parameters in which the value is seen.
    """

    provenance: Mapping[str, Any]
    breaks: Array
    shown: Mapping[str, Sequence[tuple[str, str]]]


def _column(values: Any) -> NDArray[Any]:
    """Start values as an array; a Boolean among numbers stays one, so that it is refused."""
    is_mixed = not isinstance(values, np.ndarray) and any(isinstance(x, bool) for x in values)
    return np.asarray(values, dtype=object if is_mixed else None)


class Member(NamedTuple):
    """What one run of an ensemble gives: of its number the rows, shape (rows, columns), and why it failed, if it did.

    Of one that never began there are no `facts`. `energy` is given, taken and exchanged over each power bond [J];
    `figures` are numbers that were made in place of rows.
    """

    number: int
    rows: Array
    reason: str = ""
    warnings: Sequence[str] = ()
    energy: Mapping[str, tuple[float, float, float]] = {}
    facts: Facts | None = None
    figures: Mapping[str, float] = {}


@dataclass(frozen=True)
class Ensemble:
    """What many runs of one system give.

    Attributes
    ----------
    cases
        The start values in which they differ.
    columns
        What each column is; the first is the time.
    runs
        What each run gives.
    notes
        What is worth to know of how they were run.
    """

    cases: Cases
    columns: tuple[Column, ...]
    runs: list[Member]
    notes: tuple[str, ...] = ()

    @cached_property
    def members(self) -> Numbers:
        """The numbers of the members, shape (members,)."""
        return np.array([run.number for run in self.runs], np.int64)

    @cached_property
    def counts(self) -> Numbers:
        """How many rows each has, shape (members,)."""
        return np.array([len(run.rows) for run in self.runs], np.int64)

    @cached_property
    def rows(self) -> Array:
        """The rows of each member, nan beyond its `counts`, shape (members, rows, columns)."""
        shape = len(self), int(self.counts.max(initial=0)), len(self.columns)
        rows = np.full(shape, np.nan)
        for k, run in enumerate(self.runs):
            rows[k, : len(run.rows)] = run.rows
            self.runs[k] = run._replace(rows=rows[k, : len(run.rows)])
        return rows

    @cached_property
    def reasons(self) -> list[str]:
        """Why a member failed; empty for one that came to its end."""
        return [run.reason for run in self.runs]

    @cached_property
    def warnings(self) -> dict[str, list[int]]:
        """By the sentence, the numbers of the members that it is about."""
        warnings: dict[str, list[int]] = {}
        for run in self.runs:
            for text in run.warnings:
                warnings.setdefault(text, []).append(run.number)
        return warnings

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def names(self) -> list[str]:
        """The names of the columns; the first is "time"."""
        return [column.name for column in self.columns]

    @property
    def failed(self) -> Numbers:
        """The numbers of the members that did not come to their end."""
        return np.array([run.number for run in self.runs if run.reason], np.int64)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Array:
        """A column of all members, shape (members, rows); raises KeyError for one that was not recorded."""
        return np.asarray(self.rows[:, :, self._index(name)])

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise KeyError(f"{name} was not recorded, {only(name, self.names)}")
        return self.names.index(name)

    def result(self, k: int) -> Result:
        """The result of the member at position k, as `run` gives it; of one that never began only why."""
        run = self.runs[k]
        start = self.cases.case(run.number).start if run.number < self.cases.members else {}
        ran = {
            "status": "failed" if run.reason else "complete",
            "rows": len(run.rows),
            "warnings": list(run.warnings),
        }
        if (facts := run.facts) is None:
            never = {"start_values": start, "reason": run.reason}
            return Result(self.columns, {**ran, **never}, run.rows.T.__getitem__)
        said = facts.provenance
        provenance = {
            **said,
            "start_values": said["start_values"] | start,
            "parts": _with_parameters(said["parts"], facts.shown, self.cases.ports, start),
            "reason": run.reason or said["reason"],
            "reached": float(run.rows[-1, 0]) if len(run.rows) else said["start"],
            "bonds": {bond: balance(*carried) for bond, carried in run.energy.items()},
            **ran,
        }
        return Result(self.columns, provenance, run.rows.T.__getitem__, breaks=facts.breaks)

    def evaluate(self, metrics: Mapping[str, Metric]) -> dict[str, Array]:
        """The numbers that metrics make of the members, shape (members,) each; nan for one that failed."""
        values = {name: np.full(len(self), np.nan) for name in metrics}
        columns = dict.fromkeys(column for metric in metrics.values() for column in metric.columns)
        for members in self._groups_with_same_times():
            t, facts = (
                self.rows[members[0], : self.counts[members[0]], 0],
                self.runs[members[0]].facts,
            )
            assert facts is not None
            curves = {name: self._curves(t, members, name, facts.breaks) for name in columns}
            for name, metric in metrics.items():
                values[name][members] = metric(*(curves[column] for column in metric.columns))
        return values

    def _curves(self, t: Array, members: Numbers, name: str, breaks: Array) -> Curves:
        """The curves of a column of members with the same times [s] and breaks."""
        column = self._index(name)
        x = self.rows[members, : len(t), column]
        is_held = self.columns[column].kind.is_held
        return Curves.of_rows(t, x, is_held=is_held, breaks=breaks)

    def _groups_with_same_times(self) -> Iterator[Numbers]:
        """The positions of members that came to their end, as many with the same times and breaks as may be looked at at once."""
        groups: dict[tuple[bytes, bytes], list[int]] = {}
        for k, run in enumerate(self.runs):
            if not run.reason and run.facts is not None:
                key = run.rows[:, 0].tobytes(), run.facts.breaks.tobytes()
                groups.setdefault(key, []).append(k)
        most = max(1, MOST_POINTS // max(1, self.rows.shape[1]))
        for some in groups.values():
            yield from (np.array(some[k : k + most]) for k in range(0, len(some), most))

    def frame(self, metrics: Mapping[str, Metric] | None = None) -> pd.DataFrame:
        """The cases, the numbers that metrics make of them, and why members failed, as a frame of pandas."""
        import pandas as pd

        columns: dict[str, Any] = {
            name: column[self.members] for name, column in zip(self.cases.names, self.cases.columns)
        }
        columns |= self.evaluate(metrics or {})
        return pd.DataFrame(columns | {"reason": self.reasons}, index=self.members)


def joined(blocks: Sequence[Ensemble]) -> Ensemble:
    """All members of some ensembles of the same cases, in the order of their numbers."""
    runs = sorted((run for block in blocks for run in block.runs), key=attrgetter("number"))
    notes = tuple(dict.fromkeys(note for block in blocks for note in block.notes))
    return replace(blocks[0], runs=runs, notes=notes)


def _with_parameters(
    parts: Mapping[str, Any],
    shown: Mapping[str, Sequence[tuple[str, str]]],
    ports: Sequence[Port],
    start: Mapping[str, Value],
) -> dict[str, Any]:
    """What a result says of the parts, with these start values among their parameters."""
    changed = {
        name: {**facts, "parameters": dict(facts["parameters"])} for name, facts in parts.items()
    }
    for port in ports:
        value = start[port.name]
        if port.type == "Enumeration" and isinstance(value, str):
            value = enumeration(port.variable)[value]
        for part, parameter in shown.get(port.name, ()):
            changed[part]["parameters"][parameter] = value
    return changed
