"""From the start to the stop of a run: the one loop over communication points."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from typing import Any, BinaryIO

from ..fmu.times import is_reached
from .control import Adaptive, Mesh
from .controllers import Doubling, Energy, Fixed, StepController
from .jumps import KnownJumps
from .output import IntermediateValues, Output, OutputGrid
from .recorder import Recorder
from .settings import RunSettings
from .system_instance import SystemInstance


class March:
    """The parts of a system on their way; `t` is the last communication point they reached [s].

    `breaks` are the intervals, begin and end [s], in which columns may jump, see `Result`. It goes on from the state
    of the instance, if that has one, where inputs that were other ones jump, and ends at the first communication point
    from `until` [s] on; it `is_paused` there, in a break that ends at `broken_until` if that is later. A file may take
    `all_rows`, those of each communication point, as numbers of this machine.
    """

    def __init__(
        self,
        instance: SystemInstance,
        settings: RunSettings,
        recorder: Recorder,
        *,
        until: float = math.inf,
        all_rows: BinaryIO | None = None,
    ) -> None:
        """The instance has begun."""
        self.instance, self.settings, self.recorder = instance, settings, recorder
        self._until, self.is_paused = until, False
        step, self._jumps = settings.step, KnownJumps(instance, settings)
        self.breaks = self._jumps.breaks
        self.t = self.broken_until = self._jumps.begin
        self._shown_within = self._intermediate_values()
        per_row = settings.steps_per_row(instance.row.recorded)
        self.controller: StepController
        if isinstance(step, Adaptive) and not isinstance(step, Mesh):
            default = "energy" if instance.setup.stateless else "doubling"
            kind = Doubling if (step.control or default) == "doubling" else Energy
            self.controller = kind(instance, settings, self._jumps)
        else:
            self.controller = Fixed(
                instance, settings, self._jumps, until=until,
                every=per_row if all_rows is None and per_row is not None else 1,
                compiles=per_row is not None or not self._shown_within,
            )  # fmt: skip
            self.breaks += self.controller.breaks
        self._first = self.controller.accepted
        self._grid: OutputGrid | None = None
        self._jumps.outputs.extend(self._open_outputs(per_row, all_rows))
        is_doubling = self._jumps.moments.refuses = isinstance(self.controller, Doubling)
        back = is_doubling or (self._jumps.can_go_back and isinstance(self.controller, Fixed))
        for part in instance.stepped:
            part.instance.go_forward_only(forward=instance.steps is not None and not is_doubling)
            part.instance.refuse_steps_across_events(
                refuses=back and part.instance.has_event_outputs(part.outputs)
            )

    def steps(self) -> Iterator[float]:
        """Take the steps; the share of the run that is done after each or a few of them."""
        controller, outputs = self.controller, self._jumps.outputs
        start, stop, row = self.settings.start, self.settings.stop, self.instance.row
        try:
            for output in outputs:
                output.add(row(self.t))
            while not is_reached(min(self._until, stop), self.t):
                first = controller.accepted + 1
                rows = controller.take()
                self.t = controller.t
                self._jumps.end_break(self.t)
                for output in outputs:
                    output.take(rows, len(self.recorder.names), first, controller.every)
                yield (self.t - start) / (stop - start)
            if self._until < math.inf:
                for output in outputs:
                    output.add_unless_shown(row(self.t))
                ends = [end for begin, end in self.breaks if begin < self.t]
                self.broken_until, self.is_paused = max([self.t, *ends]), True
            self.breaks = [(b, min(end, self.t)) for b, end in self.breaks if b < self.t]
        finally:
            if self._grid is not None:
                self._grid.flush()

    def add_end_row(self, time: float) -> None:
        """Add the row of the time [s] at which a part has ended the simulation.

        Of coupled parts, not all have come to that time: the last row stays that of the last
        communication point. Raises FmuError.
        """
        parts = self.instance.stepped
        if self.t < time and len(parts) == 1:
            for block in parts[0].outputs:
                block.move()
            for output in self._jumps.outputs:
                output.add(self.instance.row(time))
            if self._grid is not None:
                self._grid.flush()
            self.t = time

    def statistics(self) -> dict[str, Any]:
        """What the run took, and the orders with which its results converge.

        Those `first_order` are the recorded outputs that converge with order 1 whatever the order of the states.
        """
        instance, controller = self.instance, self.controller
        return {
            "control": controller.control,
            "convergence_order": instance.order,
            "first_order": [n for n in self.recorder.names if n in instance.first_order],
            "steps": controller.accepted - self._first,
            "rejected": controller.rejected,
            "discarded": controller.discarded,
            "do_steps": {part.name: part.do_steps for part in instance.stepped},
            "loop": controller.loop,
        }

    def _open_outputs(self, every: int | None, all_rows: BinaryIO | None) -> Iterator[Output]:
        """Where rows go: to the result after so many steps or on a grid, and all of them to a file."""
        settings, last = self.settings, self.controller.count
        if every is not None:
            yield Output(self.recorder.add, every, last)
        else:
            assert settings.output_step is not None
            self._grid = OutputGrid(
                self.recorder.add, settings.output_step, self.instance.row.discrete, self.breaks, self._shown_within
            )  # fmt: skip
            yield Output(self._grid.add, 1, last)
        if all_rows is not None:
            yield Output(lambda rows: all_rows.write(array("d", rows)), 1, last)

    def _intermediate_values(self) -> list[IntermediateValues]:
        """What parts show of columns within their steps."""
        names = self.recorder.names
        instances = [part.instance for part in self.instance.stepped]
        return [
            (x.intermediate_values, [names.index(name) for name in x.watched])
            for x in instances
            if x.watched
        ]
