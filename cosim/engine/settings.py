"""How a system is run: all that a run takes, and what in it makes no run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ..errors import SetupError
from ..fmu.times import coincide
from ..series import Column, Kind
from ..system import NUMERIC, Network, Port
from .control import Adaptive

#: The shortest step over the largest time of a run. Derived: 64 units in the last place of a double,
#: the distance below which two times are the same.
SHORTEST_TIME = 2.0**-46
#: Share of a step that may be left at the stop without a step of its own; the last step is longer by it. Derived: the
#: number of steps is a quotient of two decimals from a start at 0, whose three roundings are 3 * 2^-53 of it. They
#: stay below this share up to 3e9 steps. A last step of this share is as short as SHORTEST_TIME permits in a run of
#: 2^46 * 1e-6 = 7e7 steps; a smaller share would permit steps shorter than that in shorter runs.
LEFT_OVER = 1e-6
#: Relative difference up to which a distance of rows is a multiple of the step. Derived: a number that is written with
#: ten significant digits is off by up to 5e-10 of itself, and a quotient of two by twice that. Rows bear the times
#: of their steps, so that no row is at a wrong time.
MULTIPLE_ROUNDING = 1e-9


class StepAndStop(NamedTuple):
    """The communication step of a member and its stop [s]."""

    step: float | Adaptive
    stop: float


@dataclass(frozen=True)
class RunSettings:
    """How a system is run.

    Attributes
    ----------
    stop, start
        When the run ends and begins [s].
    step
        The communication step [s], or adaptive steps.
    algorithm
        The coupling algorithm, one of `ALGORITHMS`.
    order
        The order in which Gauss-Seidel and Strang step the parts. By default each part steps after those that drive
        it, or as declared where that is impossible.
    input_order
        The degree of the polynomials that Real inputs follow within a step; 0 holds them.
    substeps
        Sub-steps of a communication step, by part.
    tolerance
        The relative tolerance that FMUs get. By default it is the one that the default experiment of each FMU
        states, or that of the adaptive steps.
    record
        The columns, by default all outputs.
    output_step
        The distance of the rows [s].
    stop_time_defined
        Whether the FMUs are told the stop time before the start. Some then compute all of the run in their first
        step, so that by default only an FMU that does not initialise without it is told it.
    """

    stop: float
    step: float | Adaptive
    start: float = 0.0
    algorithm: str = "strang"
    order: Sequence[str] | None = None
    input_order: int = 0
    substeps: Mapping[str, int] = field(default_factory=dict)
    tolerance: float | None = None
    record: Sequence[str] | None = None
    output_step: float | None = None
    stop_time_defined: bool = False

    def ports(self, network: Network) -> list[Port]:
        """What is recorded, by default all outputs; raises SetupError for what cannot be."""
        if self.record is None:
            return [port for port in _outputs(network) if port.type in NUMERIC]
        ports = [port for name in self.record for port in network.array(name)[1]]
        for port in ports:
            if port.type not in NUMERIC:
                raise SetupError(f"{port} is a {port.type} and cannot be recorded")
        return ports

    def foreseen_warnings(self, network: Network, *, in_full: bool = False) -> Iterator[str]:
        """What a run warns of before its first step: the flaws of FMUs, and that there is nothing to record."""
        yield from network.flaw_texts(in_full=in_full)
        if self.record is None and not self.ports(network):
            yield "no FMU has an output to record: the rows contain only the time"

    def unrecorded_texts(self, network: Network) -> list[str]:
        """The outputs that a run which names no columns leaves out, since their values are texts."""
        if self.record is not None:
            return []
        return [port.name for port in _outputs(network) if port.type in ("String", "Binary")]

    def check(self) -> None:
        """Raise SetupError for what makes no run."""
        times: dict[str, float] = {"start": self.start, "stop": self.stop}
        sizes = {} if isinstance(self.step, Adaptive) else {"step": self.step}
        sizes |= {} if self.output_step is None else {"output_step": self.output_step}
        for name, value in (times | sizes).items():
            if not math.isfinite(value):
                raise SetupError(f"{name} = {value!r} s must be a finite number")
        for name, value in sizes.items():
            if value <= 0.0:
                raise SetupError(f"{name} = {value!r} s must be above 0")
            if value < SHORTEST_TIME * max(abs(self.start), abs(self.stop)):
                raise SetupError(
                    f"{name} = {value!r} s is too short: its times would differ only by rounding"
                )
        if self.stop <= self.start:
            raise SetupError(f"stop = {self.stop!r} s must be after start = {self.start!r} s")
        if isinstance(self.step, Adaptive):
            self.step.check()

    @property
    def told_tolerance(self) -> float | None:
        """The tolerance that FMUs get, that of adaptive steps unless another one is given; None for that of each."""
        if self.tolerance is None and isinstance(self.step, Adaptive):
            return self.step.tolerance
        return self.tolerance

    def number(self) -> int:
        """Fixed steps from start to stop, the last one as long as what is left."""
        assert not isinstance(self.step, Adaptive)
        return max(1, math.ceil((self.stop - self.start) / self.step - LEFT_OVER))

    def steps_until(self, time: float) -> int | None:
        """How many fixed steps end at a time [s]; None if no step ends there."""
        assert not isinstance(self.step, Adaptive)
        steps = round((time - self.start) / self.step)
        return steps if coincide(self.start + steps * self.step, time) else None

    def steps_per_row(self, columns: Iterable[Column] = ()) -> int | None:
        """After how many fixed steps a row is due; None if rows lie between steps, or at events of held columns too."""
        if self.output_step is not None and any(c.kind is not Kind.CONTINUOUS for c in columns):
            return None
        if isinstance(self.step, Adaptive):
            return 1 if self.output_step is None else None
        ratio = 1.0 if self.output_step is None else self.output_step / self.step
        if ratio >= (number := self.number()):
            return number  # the last step has a row anyhow
        steps = round(ratio)
        return steps if steps and abs(ratio / steps - 1) < MULTIPLE_ROUNDING else None

    def stepping_text(self) -> str:
        """How the run steps."""
        if isinstance(self.step, Adaptive):
            return str(self.step)
        return f"steps of {self.step:.6g} s"


def _outputs(network: Network) -> list[Port]:
    """All outputs of all parts."""
    return [
        Port(name, v)
        for name, description in network.descriptions.items()
        for v in description.modelVariables
        if v.causality == "output"
    ]
