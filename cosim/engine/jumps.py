"""Jumps on the way of a run: changes and inputs that jump, with rows before and after each, and the breaks they make."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from operator import attrgetter

from ..fmu.times import coincide, is_reached
from .changes import Jump, discrete_changes, known_jumps, source_jumps, value_before
from .control import Adaptive
from .moments import Moments
from .output import Output
from .response import values_after_jump, values_after_probing_steps, values_of_wired_outputs
from .schedule import Advance
from .settings import RunSettings
from .system_instance import SystemInstance


class KnownJumps:
    """What is known to happen at once in a run of an instance that has begun, and the step by way of that.

    Attributes
    ----------
    begin
        Where the run begins [s].
    known, times
        The jumps, in their order, and their times between the start and the stop [s].
    moments
        The events that parts tell.
    can_go_back
        Whether all parts can come back to a state and vary their step.
    advance
        The step of the instance, with what is to happen before it, within it, and at its end.
    breaks
        The intervals, begin and end [s], in which columns may jump, see `Result`.
    outputs
        Where rows go.
    """

    def __init__(self, instance: SystemInstance, settings: RunSettings) -> None:
        setup, state = instance.setup, instance.state
        self._instance, self._plain = instance, instance.advance()
        self.begin = settings.start if state is None else state.time
        if state is not None and not isinstance(settings.step, Adaptive):
            self.begin = settings.start + (settings.steps_until(state.time) or 0) * settings.step
        self.known = _jumps_after(instance, settings, self.begin)
        self.times = [settings.start, *(jump.time for jump in self.known), settings.stop]
        self.moments = Moments(instance.stepped, setup.fixed)
        self.can_go_back = not (setup.stateless or setup.fixed)
        advance = self.moments.met(self._plain, self._are_at)
        self.advance = self._split(advance) if self.known else advance
        self.outputs: list[Output] = []
        self.breaks: list[tuple[float, float]] = []
        if state is not None and state.broken_until > self.begin:
            self.breaks.append((self.begin, state.broken_until))
        self._last = math.nan  # the time of the last jump
        self._unanswered: float | None = None  # where a break has begun

    def end_break(self, t: float) -> None:
        """Let a break that has begun end at a communication point [s]."""
        if self._unanswered is not None:
            insort(self.breaks, (self._unanswered, t))
            self._unanswered = None

    def _are_at(self, t: float) -> bool:
        """Whether something jumps at a time [s] before which events of that time are not to happen."""
        k = bisect_left(self.known, t, key=attrgetter("time"))
        return any(coincide(jump.time, t) for jump in self.known[max(0, k - 1) : k + 1])

    def _split(self, advance: Advance) -> Advance:
        """The same step, before which a jump at its begin occurs, and which changes inside it split.

        An input that jumps inside a step does not split it: its part gets the mean.
        """
        times = self.times[1:-1]

        def go(t: float, h: float) -> None:
            end, near = t + h, 64 * math.ulp(t)
            first, last = bisect_left(times, t - near), bisect_right(times, end)
            for jump in self.known[first:last]:
                if coincide(jump.time, end):
                    break
                if not coincide(jump.time, t):
                    if not jump.changes:
                        continue
                    advance(t, jump.time - t)
                    t, h = jump.time, end - jump.time
                self._occur(t, h, jump)
            advance(t, h)

        return go

    def _occur(self, t: float, h: float, jump: Jump) -> None:
        """Make the changes of a jump before a step from t by h [s], then what is due at that time.

        At the first time there are rows before and after it.

        Where the values after it are not known, a break begins.
        """
        is_first = not (t <= self._last or coincide(t, self._last))
        parts, row = self._instance.stepped, self._instance.row
        before = {}
        if is_first:
            self._last = t
            values = row(t)
            for output in self.outputs:
                output.add_unless_shown(values)
            before = values_of_wired_outputs(parts) | dict(zip(row.names, values[1:]))
        for change in jump.changes:
            change.instance.set(change.variable, change.value)
        happened = self.moments.happen(t)
        if not is_first:
            return

        def read() -> dict[str, float]:
            return dict(zip(row.names, row(t)[1:]))

        after, answered = values_after_jump(parts, read, t, jump, before)
        if not answered and self.can_go_back:
            probed = values_after_probing_steps(parts, self._plain, read, (t, h), held=row.held)
            after, answered = (after, False) if probed is None else (probed, True)
        shown = self.outputs[0].shown
        if after is not None:
            changed = {c.instance.session.name for c in jump.changes}
            # Other parts see an event at their next turn, but for events of which parts have told.
            seen = row.held.items() if not happened else ()
            kept = {name: before[name] for name, part in seen if part not in changed}
            for output in self.outputs:
                output.add([output.shown, *(after | kept).values()])
            insort(self.breaks, (shown, shown))
        if not answered:
            self._unanswered = shown


def _jumps_after(instance: SystemInstance, settings: RunSettings, t: float) -> list[Jump]:
    """What is known to happen at once from time t [s] on; where a run goes on, inputs that were other ones jump there."""
    state = instance.state
    since = settings.start if state is None else state.start
    changes = discrete_changes(instance.setup.network, instance.parts, since, settings.stop)
    sources = [feed for part in instance.stepped for feed in part.feeds]
    times = source_jumps(sources, since, settings.stop)
    if state is None:
        return known_jumps(changes, times)
    times += [
        t
        for each in sources
        if value_before(each.profile, state.time) != state.inputs_before[each.name]
    ]
    return [jump for jump in known_jumps(changes, times) if is_reached(t, jump.time)]
