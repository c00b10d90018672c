"""What a run says of itself: what was set, what it took, how it ended, and what the coupling made of the energy.

`to_json` gives the entries of the JSON file beside the rows; their names do not change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .json_values import Json
from .system import Value


@dataclass(frozen=True)
class PartIdentity:
    """An FMU of a run: file, model, unique identifier, relative tolerance, tool, and its parameters' values."""

    fmu: str
    model: str
    guid: str
    tolerance: float | None
    tool: str | None
    parameters: Mapping[str, Value]


@dataclass(frozen=True)
class BondEnergy:
    """The energy that a power bond transferred [J].

    Attributes
    ----------
    given, taken
        What the first side delivered and what the second received.
    residual
        `given` less `taken`: what the coupling removed, or created where it is below 0.
    exchanged
        The integral of the absolute power, of the side where it is larger.
    """

    given: float
    taken: float
    residual: float
    exchanged: float


@dataclass(frozen=True)
class RunSetup:
    """What was run, complete enough to run it again; times in s."""

    algorithm: str
    communication: str
    order: Sequence[str]
    input_order: int
    substeps: Mapping[str, int]
    start: float
    stop: float
    tolerance: float | None
    stop_time_defined: bool
    wires: Sequence[str]
    inputs: Mapping[str, Mapping[str, Json]]
    changes: Sequence[str]
    start_values: Mapping[str, Value]
    open_inputs: Mapping[str, Value]
    unrecorded: Sequence[str]
    parts: Mapping[str, PartIdentity]
    versions: Mapping[str, str]

    def to_json(self) -> dict[str, Json]:
        """Its entries of the JSON file."""
        parts = {name: dict(vars(identity)) for name, identity in self.parts.items()}
        return vars(self) | {"parts": parts}


@dataclass(frozen=True)
class Statistics:
    """What a run took, and the orders with which its results converge.

    Attributes
    ----------
    control
        "fixed", or the step control of adaptive steps.
    convergence_order
        That of the states; `first_order` are the recorded outputs that converge with order 1 nevertheless.
    steps, rejected, discarded
        Communication steps taken, rejected by the step control, and refused by FMUs.
    do_steps
        By part, the steps that its FMU was asked for.
    loop
        "compiled" or "Python", with the reason where one is known.
    """

    control: str
    convergence_order: int
    first_order: Sequence[str]
    steps: int
    rejected: int
    discarded: int
    do_steps: Mapping[str, int]
    loop: str


@dataclass(frozen=True)
class Outcome:
    """How a run ended: "complete", "interrupted" or "failed", why, at which time [s], with how many rows."""

    status: str
    reason: str
    reached: float
    rows: int


@dataclass(frozen=True)
class RunReport:
    """All that a run says of itself; `wall_time` [s] is what it took, without reading the FMUs."""

    setup: RunSetup
    statistics: Statistics
    outcome: Outcome
    bonds: Mapping[str, BondEnergy]
    warnings: Sequence[str]
    wall_time: float

    def to_json(self) -> dict[str, Json]:
        """The entries of the JSON file."""
        return {
            **self.setup.to_json(),
            **vars(self.statistics),
            **vars(self.outcome),
            "bonds": {bond: dict(vars(energy)) for bond, energy in self.bonds.items()},
            "warnings": list(self.warnings),
            "wall_time": self.wall_time,
        }
