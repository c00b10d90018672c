"""Many runs of one system: the values in which they differ, and what they give, as arrays with an axis for the members."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .dense import MOST_POINTS, Curves
from .engine.energy import balance
from .engine.snapshot import Case
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
    """The start values in which the members of an ensemble differ: a column of values for each port, shape (members,)."""

    ports: tuple[Port, ...]
    columns: tuple[NDArray[Any], ...]
    members: int

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
                f"{type(cases).__name__}; a run that begins with a state is one by itself: write run(Case(begin=state))"
            )
        ports = tuple(network.port(str(name)) for name in cases)
        columns = tuple(np.asarray(cases[name]) for name in cases)
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
        return Case(dict(zip(self.names, plain)))

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


@dataclass(frozen=True)
class Ensemble:
    """What many runs of one system give.

    Attributes
    ----------
    cases
        The start values in which they differ.
    members
        The numbers of the members, shape (members,).
    columns
        What each column is; the first is the time.
    rows
        The rows of each member, nan beyond its `counts`, shape (members, rows, columns).
    counts
        How many rows each has, shape (members,).
    reasons
        Why a member failed; empty for one that came to its end.
    warnings
        By the sentence, the numbers of the members that it is about.
    energy
        By power bond, energy given, taken and exchanged [J], shape (members, 3).
    facts
        What the run of each member says of itself; None for one that never began.
    notes
        What is worth to know of how they were run.
    figures
        Numbers of each member by name, shape (members,), where they were made instead of rows.
    """

    cases: Cases
    members: Numbers
    columns: tuple[Column, ...]
    rows: Array
    counts: Numbers
    reasons: list[str]
    warnings: Mapping[str, list[int]]
    energy: Mapping[str, Array]
    facts: list[Facts | None]
    notes: tuple[str, ...] = ()
    figures: Mapping[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.members)

    @property
    def names(self) -> list[str]:
        """The names of the columns; the first is "time"."""
        return [column.name for column in self.columns]

    @property
    def failed(self) -> Numbers:
        """The numbers of the members that did not come to their end."""
        wrong = [bool(reason) for reason in self.reasons]
        return np.asarray(self.members[np.array(wrong, dtype=bool)])

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
        n, number, rows = int(self.counts[k]), int(self.members[k]), self.rows[k, : self.counts[k]]
        start = self.cases.case(number).start if number < self.cases.members else {}
        if (facts := self.facts[k]) is None:
            never = {
                "start_values": start,
                "status": "failed",
                "reason": self.reasons[k],
                "rows": n,
            }
            return Result(self.columns, {**never, "warnings": []}, rows.T.__getitem__)
        said = facts.provenance
        provenance = {
            **said,
            "start_values": said["start_values"] | start,
            "parts": _with_parameters(said["parts"], facts.shown, self.cases.ports, start),
            "status": "failed" if self.reasons[k] else "complete",
            "reason": self.reasons[k] or said["reason"],
            "reached": float(rows[-1, 0]) if n else said["start"],
            "rows": n,
            "bonds": {bond: balance(*values[k].tolist()) for bond, values in self.energy.items()},
            "warnings": [text for text, members in self.warnings.items() if number in members],
        }
        return Result(self.columns, provenance, rows.T.__getitem__, breaks=facts.breaks)

    def evaluate(self, metrics: Mapping[str, Metric]) -> dict[str, Array]:
        """The numbers that metrics make of the members, shape (members,) each; nan for one that failed."""
        values = {name: np.full(len(self), np.nan) for name in metrics}
        columns = dict.fromkeys(column for metric in metrics.values() for column in metric.columns)
        for members in self._groups_with_same_times():
            t, facts = self.rows[members[0], : self.counts[members[0]], 0], self.facts[members[0]]
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
        rest = np.flatnonzero([not reason for reason in self.reasons])
        most = max(1, MOST_POINTS // max(1, self.rows.shape[1]))
        while len(rest):
            n, some = self.counts[rest[0]], rest[:most]
            times = self.rows[some, :n, 0]
            same = (self.counts[some] == n) & (times == times[0]).all(axis=1)
            same &= [self._breaks_are_equal(rest[0], k) for k in some]
            yield some[same]
            rest = np.concatenate([some[~same], rest[most:]])

    def _breaks_are_equal(self, first: int, second: int) -> bool:
        """Whether two members may jump at the same times."""
        one, other = self.facts[first], self.facts[second]
        return one is other or (
            one is not None and other is not None and np.array_equal(one.breaks, other.breaks)
        )

    def frame(self, metrics: Mapping[str, Metric] | None = None) -> pd.DataFrame:
        """The cases, the numbers that metrics make of them, and why members failed, as a frame of pandas."""
        import pandas as pd

        columns: dict[str, Any] = {
            name: column[self.members] for name, column in zip(self.cases.names, self.cases.columns)
        }
        columns |= self.evaluate(metrics or {})
        return pd.DataFrame(columns | {"reason": self.reasons}, index=self.members)

    def head(self, n: int) -> Ensemble:
        """The first n of its members."""
        return replace(
            self, members=self.members[:n], rows=self.rows[:n], counts=self.counts[:n],
            reasons=self.reasons[:n], facts=self.facts[:n], energy={k: e[:n] for k, e in self.energy.items()},
        )  # fmt: skip


def joined(blocks: Sequence[Ensemble]) -> Ensemble:
    """All members of some ensembles of the same cases, in the order of their numbers."""
    if len(blocks) == 1:
        return blocks[0]
    members = np.concatenate([block.members for block in blocks])
    order = np.argsort(members)
    most = max(block.rows.shape[1] for block in blocks)
    rows = np.full((len(members), most, len(blocks[0].columns)), np.nan)
    reasons: list[str] = []
    facts: list[Facts | None] = []
    first = 0
    for block in blocks:
        rows[first : first + len(block), : block.rows.shape[1]] = block.rows
        first += len(block)
        reasons += block.reasons
        facts += block.facts
    warnings: dict[str, list[int]] = {}
    for block in blocks:
        for text, numbers in block.warnings.items():
            warnings[text] = sorted([*warnings.get(text, ()), *numbers])
    nothing = {len(block): np.full((len(block), 3), np.nan) for block in blocks}
    energy = {
        bond: np.concatenate([block.energy.get(bond, nothing[len(block)]) for block in blocks])[
            order
        ]
        for bond in dict.fromkeys(bond for block in blocks for bond in block.energy)
    }
    return replace(
        max(blocks, key=lambda block: block.cases.members),
        members=members[order],
        rows=rows[order],
        counts=np.concatenate([block.counts for block in blocks])[order],
        reasons=[reasons[k] for k in order],
        facts=[facts[k] for k in order],
        warnings=warnings,
        energy=energy,
        notes=tuple(dict.fromkeys(note for block in blocks for note in block.notes)),
    )


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
