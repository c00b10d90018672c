"""From the start to the stop of a run: communication points, rows, and steps taken again."""

from __future__ import annotations

import math
import time as clock
from array import array
from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Any, BinaryIO

from ..errors import EventReached, FmuError, StepDiscarded
from ..fmu.times import coincide, is_reached
from .algorithms import find_algorithm
from .changes import (
    Jump,
    discrete_changes,
    known_jumps,
    source_jumps,
    value_before,
    with_jumps,
)
from .control import (
    Adaptive,
    Controller,
    EqualSteps,
    Mesh,
    step_ends_by_doubling,
    step_ends_by_energy,
)
from .iteration import Iteration
from .loop import Loop
from .moments import EventDueError, Moments
from .output import IntermediateValues, Output, OutputGrid
from .recorder import Recorder
from .response import values_after_jump, values_after_probing_steps, values_of_wired_outputs
from .schedule import Advance, explicit
from .settings import RunSettings
from .snapshot import Snapshot, StepMemory
from .system_instance import SystemInstance

#: Steps between two saved states. A convention: taken again, they cost less than a saved state in each step.
CHECKPOINT = 1000
#: The shortest piece of a step that parts discard, over the step. Derived: twenty halvings.
SHORTEST = 2.0**-20
#: Longest piece that is tried after a discarded step because the part came so far, over that step; a longer one is
#: halved instead. A convention of step size control, see SAFETY in control.py. Each discarded step is then followed
#: by one of 0.9 of it at most, so that parts that come almost as far each time reach SHORTEST after
#: 20 ln 2 / -ln 0.9 = 132 of them, where halvings are 20.
LONGEST_RETRY = 0.9
#: Seconds between two looks at signals and progress. A convention: people notice a tenth of a second.
PATIENCE = 0.05
#: Rows that the compiled loop gives at once. A convention: a page or two of memory for each column.
MOST_ROWS = 1 << 12
#: The share of a run that is done.
ShareDone = float


class KnownSteps:
    """Steps that are known before a run, numbered from its start: `stretches` of equal ones, none where control chooses them.

    `firsts` are the numbers of the first step of each stretch, `count` is that of all.
    """

    def __init__(self, plan: RunSettings, jumps: Sequence[Jump]) -> None:
        self.stop, self._jumps = plan.stop, jumps
        if isinstance(plan.step, Mesh):
            times = [plan.start, *(jump.time for jump in jumps), plan.stop]
            self.stretches = plan.step.stretches(times)
        elif isinstance(plan.step, Adaptive):
            self.stretches = []
        else:
            self.stretches = [EqualSteps(plan.start, plan.step, plan.number())]
        if self.stretches:
            self.stretches[-1] = self.stretches[-1]._replace(stop=plan.stop)
        numbers = [0, *accumulate(steps.number for steps in self.stretches)]
        self.firsts, self.count = numbers[:-1], numbers[-1]

    def stretch_of(self, n: int) -> tuple[int, EqualSteps]:
        """The first step of the stretch that step number n is in, and that stretch."""
        k = bisect_right(self.firsts, n) - 1
        return self.firsts[k], self.stretches[k]

    def step(self, n: int) -> tuple[float, float]:
        """When step number n begins, and its size [s]."""
        first, steps = self.stretch_of(n)
        return steps.at(n - first)

    def begin_of(self, n: int) -> float:
        """When step number n begins, or the one before it ends [s]."""
        return self.stop if n == self.count else self.step(n)[0]

    def number_at(self, time: float) -> int:
        """The number of the step that a time lies in, or that begins there."""
        k = max(0, bisect_right([steps.begin for steps in self.stretches], time) - 1)
        n = self.firsts[k] + int((time - self.stretches[k].begin) / self.stretches[k].size)
        return n + 1 if coincide(self.begin_of(n + 1), time) else n

    def interrupted(self) -> list[int]:
        """The numbers of the steps at whose beginning a jump occurs, or inside which a change does."""
        return [n for n, jump in self._numbered_jumps() if self._is_seen(n, jump)]

    def breaks(self) -> list[tuple[float, float]]:
        """The breaks that jumps of inputs inside steps make.

        Such a step gets the mean, and what outputs show at its end is made of that: it and the next one are a break.
        """
        breaks: list[tuple[float, float]] = []
        for n, jump in self._numbered_jumps():
            broken = self.begin_of(n), self.begin_of(n + 2)
            if not self._is_seen(n, jump) and broken not in breaks[-1:]:
                breaks.append(broken)
        return breaks

    def _numbered_jumps(self) -> Iterator[tuple[int, Jump]]:
        # beyond the stop, another run may go on with a break
        return ((min(self.number_at(jump.time), self.count - 1), jump) for jump in self._jumps)

    def _is_seen(self, n: int, jump: Jump) -> bool:
        return bool(jump.changes) or coincide(self.begin_of(n), jump.time)


class Driver:
    """The parts of a system on their way; `t` is the last communication point they reached [s].

    `breaks` are the intervals, begin and end [s], in which columns may jump, see `Result`. It goes on from the state
    of the instance, if that has one, where inputs that were other ones jump, and ends at the first communication point
    from `until` [s] on; it `is_paused` there, in a break that ends at `broken_until` if that is later. A file may take
    `all_rows`, those of each communication point, as numbers of this machine.
    """

    def __init__(
        self,
        instance: SystemInstance,
        plan: RunSettings,
        recorder: Recorder,
        *,
        until: float = math.inf,
        all_rows: BinaryIO | None = None,
    ) -> None:
        """The instance has begun."""
        self.instance, self.parts, self.row = instance, instance.stepped, instance.row
        self.plan, self.recorder = plan, recorder
        begin, self._until = instance.state, until
        self.t, self._begin = plan.start, begin
        self.accepted = self.discarded = 0
        if begin is not None:
            self.t = begin.time
            if not isinstance(plan.step, Adaptive):
                self.accepted = plan.steps_until(begin.time) or 0
                self.t = plan.start + self.accepted * plan.step
        self._first = self.accepted
        self.controller: Controller | None = None
        self.breaks: list[tuple[float, float]] = []
        self._jumps = self._known_jumps()
        if begin is not None and begin.broken_until > self.t:
            self.breaks.append((self.t, begin.broken_until))
        self.is_paused, self.broken_until = False, self.t
        loop = instance.loop()
        self._plain_advance: Advance
        if isinstance(loop, Loop):
            self._plain_advance = loop.advance
        elif instance.steps is None:
            self._plain_advance = Iteration(find_algorithm(plan.algorithm), self.parts)
        else:
            self._plain_advance = explicit(instance.steps)
        self._moments = Moments(self.parts, instance.setup.fixed)
        self._advance = self._moments.met(self._plain_advance, self._jumps_at)
        self._advance = with_jumps(self._advance, self._jumps, self._occur)
        self._jumped = math.nan  # the time of the last jump
        self._unanswered: float | None = None  # where a break has begun
        self._known = KnownSteps(plan, self._jumps)
        self._grid: OutputGrid | None = None
        self._outputs = list(self._open_outputs(all_rows))
        self._every = min(output.every for output in self._outputs)
        self._checkpoint: tuple[int, Snapshot] | None = None
        self.compiled_loop: Loop | None = None
        self.control = "fixed"
        self.loop = "Python"
        if isinstance(plan.step, Adaptive):
            self.control = plan.step.control or (
                "energy" if instance.setup.stateless else "doubling"
            )
        self._can_probe = not (instance.setup.stateless or instance.setup.fixed)
        if self._known.count and self._can_probe:
            self._checkpoint = (self.accepted - CHECKPOINT, Snapshot(self.parts))
        self._moments.refuses = self.control == "doubling"
        forward = instance.steps is not None and self.control != "doubling"
        back = self._checkpoint is not None or self.control == "doubling"
        for part in self.parts:
            part.instance.go_forward_only(forward=forward)
            part.instance.refuse_steps_across_events(
                refuses=back and part.instance.has_event_outputs(part.outputs)
            )
        if not self._known.count or (self._grid is not None and self._intermediate_values()):
            return
        if isinstance(loop, OSError):
            self.loop = f"Python, since the compiled loop is missing: {loop}"
        elif loop is not None:
            self.compiled_loop, self.loop = loop, "compiled"

    def _open_outputs(self, all_rows: BinaryIO | None) -> Iterator[Output]:
        """Where rows go: to the result, and all of them to a file."""
        settings, last = self.plan, self._known.count
        every = settings.steps_per_row(self.row.recorded)
        if every is not None:
            yield Output(self.recorder.add, every, last)
        else:
            assert settings.output_step is not None
            self._grid = OutputGrid(
                self.recorder.add, settings.output_step, self.row.discrete, self.breaks, self._intermediate_values()
            )  # fmt: skip
            yield Output(self._grid.add, 1, last)
        if all_rows is not None:
            yield Output(lambda rows: all_rows.write(array("d", rows)), 1, last)

    def _known_jumps(self) -> list[Jump]:
        """What is known before to happen at once on the way."""
        plan, begin, instance = self.plan, self._begin, self.instance
        since = plan.start if begin is None else begin.start
        changes = discrete_changes(instance.setup.network, instance.parts, since, plan.stop)
        sources = [feed for part in self.parts for feed in part.feeds]
        times = source_jumps(sources, since, plan.stop)
        if begin is None:
            return known_jumps(changes, times)
        times += [
            self.t
            for each in sources
            if value_before(each.profile, begin.time) != begin.inputs_before[each.name]
        ]
        jumps = known_jumps(changes, times)
        return [jump for jump in jumps if is_reached(self.t, jump.time)]

    def steps(self) -> Iterator[ShareDone]:
        """Take the steps; the share of the run that is done after each or a few of them."""
        try:
            self._add_row(self.row(self.t))
            if self._known.count:
                yield from self._fixed()
            elif isinstance(self.plan.step, Adaptive):
                yield from self._adaptive(self.plan.step)
            if self._is_there:
                self._pause()
            self.breaks = [(b, min(end, self.t)) for b, end in self.breaks if b < self.t]
        finally:
            if self._grid is not None:
                self._grid.flush()

    def add_end_row(self, time: float) -> None:
        """Add the row of the time [s] at which a part has ended the simulation.

        Of coupled parts, not all have come to that time: the last row stays that of the last
        communication point. Raises FmuError.
        """
        if self.t < time and len(self.parts) == 1:
            for block in self.parts[0].outputs:
                block.move()
            self._add_row(self.row(time))
            self.t = time

    def _add_row(self, row: Sequence[float]) -> None:
        """Let all outputs have a row."""
        for output in self._outputs:
            output.add(row)

    def _jumps_at(self, t: float) -> bool:
        """Whether something jumps at a time [s] before which events of that time are not to happen."""
        k = bisect_left(self._jumps, t, key=lambda jump: jump.time)
        return any(coincide(jump.time, t) for jump in self._jumps[max(0, k - 1) : k + 1])

    def _occur(self, t: float, h: float, jump: Jump) -> None:
        """Make the changes of a jump before a step from t by h [s], then what is due at that time.

        At the first time there are rows before and after it.

        Where the values after it are not known, a break begins.
        """
        if t <= self._jumped or coincide(t, self._jumped):
            for change in jump.changes:
                change.instance.set(change.variable, change.value)
            self._moments.happen(t)
            return
        self._jumped = t
        row = self.row(t)
        for output in self._outputs:
            output.add_unless_shown(row)
        before = values_of_wired_outputs(self.parts) | dict(zip(self.row.names, row[1:]))
        for change in jump.changes:
            change.instance.set(change.variable, change.value)
        happened = self._moments.happen(t)

        def read() -> dict[str, float]:
            return dict(zip(self.row.names, self.row(t)[1:]))

        held = self.row.held
        after, answered = values_after_jump(self.parts, read, t, jump, before)
        if not answered and self._can_probe:
            probed = values_after_probing_steps(
                self.parts, self._plain_advance, read, (t, h), held=held
            )
            after, answered = (after, False) if probed is None else (probed, True)
        if after is not None:
            changed = {c.instance.session.name for c in jump.changes}
            # Other parts see an event at their next turn, but for events of which parts have told.
            seen = held.items() if not happened else ()
            kept = {name: before[name] for name, part in seen if part not in changed}
            for output in self._outputs:
                output.add([output.shown, *(after | kept).values()])
            insort(self.breaks, (self._shown, self._shown))
        if not answered:
            self._unanswered = self._shown

    def _end_break(self, t: float) -> None:
        """Let a break that has begun end at a communication point [s]."""
        if self._unanswered is not None:
            insort(self.breaks, (self._unanswered, t))
            self._unanswered = None

    @property
    def _shown(self) -> float:
        """The time of the last row of the result [s]."""
        return self._outputs[0].shown

    def _intermediate_values(self) -> list[IntermediateValues]:
        """What parts show of columns within their steps."""
        columns = {f: k for k, f in enumerate(self.row.names, 1)}
        return [
            (p.intermediate_values, [columns[name] for name in p.watched])
            for p in (part.instance for part in self.parts)
            if p.watched
        ]

    def _adaptive(self, settings: Adaptive) -> Iterator[ShareDone]:
        start, stop = self.plan.start, self.plan.stop
        times = [start, *(jump.time for jump in self._jumps), stop]
        self.controller = Controller(
            self.control, self.instance.order, settings, times, self.instance.instant,
            next_event=self._moments.next,
        )  # fmt: skip
        if self._begin is not None:
            self.controller.resume(self.t, self._begin.memory)
        method = step_ends_by_doubling if self.control == "doubling" else step_ends_by_energy
        for t in method(self.parts, self._advance, self.controller):
            row = self.row(t)
            self.accepted, self.t = self.accepted + 1, t
            self._end_break(t)
            self._add_row(row)
            yield (t - start) / (stop - start)
            if self._is_there:
                return

    def _fixed(self) -> Iterator[ShareDone]:
        count, known = self._known.count, self._known
        every, instance = self._every, self.instance
        split = sorted({*known.interrupted(), *known.firsts[1:], count})
        self.breaks += known.breaks()
        goal = count if self._until >= known.stop else self._goal()
        has_event = False
        while self.accepted < goal:
            n = self.accepted
            if self._checkpoint is not None:
                before, snapshot = self._checkpoint
                if n >= before + CHECKPOINT:
                    snapshot.take()
                    self._checkpoint = (n, snapshot)
            last = n
            if self.compiled_loop is not None and not has_event:
                last = min(n + instance.chunk, goal, split[bisect_left(split, n)])
            has_event = False
            if self.compiled_loop is not None and n < last:
                began = clock.perf_counter()
                first, steps = known.stretch_of(n)
                rows, done, failure = self.compiled_loop.run(steps, n - first, last - first, every)
                self.accepted = first + done
                for output in self._outputs:
                    output.take(rows, len(self.recorder.names), n + 1, every)
                self.t = known.begin_of(self.accepted)
                has_event = isinstance(failure, EventDueError)
                if failure is not None and not has_event:
                    self._redo_from_checkpoint(failure)
                elif clock.perf_counter() - began > PATIENCE:
                    instance.chunk = max(instance.chunk // 2, 1)
                elif done == last - first:
                    instance.chunk = min(2 * instance.chunk, MOST_ROWS * every)
            else:
                t, h = known.step(n)
                try:
                    self._advance(t, h)
                except StepDiscarded as failure:
                    self._redo_from_checkpoint(failure)
                    self._advance(t, h)
                end = known.begin_of(n + 1)
                due = [output for output in self._outputs if output.is_due(n + 1)]
                row = self.row(end) if due else ()
                self.accepted, self.t = n + 1, end
                self._end_break(end)
                for output in due:
                    output.add(row)
            yield self.accepted / count

    def _goal(self) -> int:
        """The number of steps from the start to where it is to end before the stop."""
        n = self._known.number_at(self._until)
        return n if coincide(self._known.begin_of(n), self._until) else n + 1

    def _pause(self) -> None:
        """Show where it has come to, if no row does, and note whether a break goes on."""
        if not coincide(self.t, self._shown):
            self._add_row(self.row(self.t))
        self.broken_until = max([self.t, *(end for begin, end in self.breaks if begin < self.t)])
        self.is_paused = True

    def _redo_from_checkpoint(self, failure: FmuError) -> None:
        """After a discarded step, come back to before it, from now on ready to step less."""
        if not isinstance(failure, StepDiscarded):
            raise failure
        if self._checkpoint is None:
            raise FmuError(
                f"{failure}; it computed up to t = {failure.reached!r} s; for a shorter step, "
                "every part must be able to restore its state and to vary its step"
            )
        before, snapshot = self._checkpoint
        self._checkpoint = self.compiled_loop = None
        for part in self.parts:
            part.instance.go_forward_only(forward=False)
        met = isinstance(failure, EventReached)
        self.loop = f"Python, since {'steps end at events' if met else 'a part discards steps'}"
        snapshot.restore()
        self._advance = self._in_pieces(self._advance, snapshot)
        for n in range(before, self.accepted):
            self._advance(*self._known.step(n))

    def _in_pieces(self, advance: Advance, snapshot: Snapshot) -> Advance:
        """The same step in as many pieces as the parts ask for."""

        def go(t: float, h: float) -> None:
            end, size = t + h, h
            while True:
                snapshot.take()
                try:
                    advance(t, size)
                except StepDiscarded as discarded:
                    self.discarded += 1
                    snapshot.restore()
                    reached = discarded.reached - t
                    most = 1.0 if isinstance(discarded, EventReached) else LONGEST_RETRY
                    size = reached if SHORTEST * h < reached < most * size else size / 2
                    if size < SHORTEST * h:
                        raise FmuError(
                            f"{discarded}; it takes no step from t = {t!r} s, however short"
                        ) from discarded
                    continue
                t += size
                if t >= end or coincide(t, end):
                    return
                size = end - t

        return go

    @property
    def _is_there(self) -> bool:
        """Whether it has come to where it is to end."""
        return is_reached(self._until, self.t)

    @property
    def memory(self) -> StepMemory | None:
        """What adaptive steps go on with in another run."""
        return None if self.controller is None else self.controller.memory()

    def statistics(self) -> dict[str, Any]:
        """What the run took, and the orders with which its results converge.

        Those `first_order` are the recorded outputs that converge with order 1 whatever the order of the states.
        """
        return {
            "control": self.control,
            "convergence_order": self.instance.order,
            "first_order": [n for n in self.recorder.names if n in self.instance.first_order],
            "steps": self.accepted - self._first,
            "rejected": self.controller.rejected if self.controller else 0,
            "discarded": self.discarded,
            "do_steps": {part.name: part.do_steps for part in self.parts},
            "loop": self.loop,
        }
