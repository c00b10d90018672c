"""What a column of a table is: its name, unit and kind, as the master or a file knows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """What the values of a column are; all but continuous ones hold from a row to the next."""

    CONTINUOUS = "continuous"
    DISCRETE = "discrete"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    ENUMERATION = "enumeration"
    TEXT = "text"

    @property
    def is_held(self) -> bool:
        """Whether a value holds from its row to the next, so that nothing lies between two values."""
        return self is not Kind.CONTINUOUS


@dataclass(frozen=True)
class Column:
    """A column of a table: `order` is the convergence order of its values, `source` where they come from."""

    name: str
    unit: str = ""
    kind: Kind = Kind.CONTINUOUS
    order: int | None = None
    source: str = ""


#: The first column of every table.
TIME = Column("time", "s")


def described_columns(
    names: Sequence[str], units: Mapping[str, str], kinds: Mapping[str, str]
) -> tuple[Column, ...]:
    """The columns that the entries `units` and `kinds` of a JSON file describe; kinds that lack are continuous."""
    return tuple(
        Column(name, units.get(name, ""), Kind(kinds.get(name, Kind.CONTINUOUS.value)))
        for name in names
    )


def column_facts(columns: Sequence[Column]) -> dict[str, dict[str, str]]:
    """The entries `units` and `kinds` of a JSON file, the latter for columns that are not continuous."""
    held = {column.name: column.kind.value for column in columns if column.kind.is_held}
    return {"units": {column.name: column.unit for column in columns}, "kinds": held}
