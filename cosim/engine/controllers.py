"""Step controllers: what the next step of a run is, and whether it is taken again."""

from __future__ import annotations

import time as clock
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from itertools import accumulate

from ..errors import EventReached, FmuError, NonFiniteValueError, StepDiscarded
from ..fmu.times import coincide, is_reached
from .changes import Jump
from .control import END_ROUNDING, Adaptive, EqualSteps, Mesh
from .jumps import KnownJumps
from .loop import Loop
from .moments import EventDueError
from .schedule import Advance
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
#: Share of the size that the error allows. A convention: Hairer, Norsett and Wanner, Solving Ordinary
#: Differential Equations I, section II.4, use 0.8 to 0.9.
SAFETY = 0.9
#: The first step over the run. A convention: short enough that a wrong guess costs a few rejected steps.
FIRST = 1e-4
#: The least factor from one step to the next. A convention: the same section uses 0.2 to 0.5.
SHRINK = 0.2
#: The largest factor from one step to the next. A convention: the same section uses 1.5 to 5.
GROW = 3.0
#: Share of the permitted error up to which a step counts. Derived: errors of a run add up, and steps that
#: use a little more are made up for by SAFETY, which lets the others use less.
ACCEPT = 1.2
#: The shortest step over the run, below which the tolerance cannot be met. A convention: a run of 1e9 steps
#: does not end.
LEAST = 1e-9
#: Exponent of the error of this step, over the order. A convention: PI control after Gustafsson, ACM Trans.
#: Math. Softw. 17 (1991), whose pair is 0.7 and 0.4.
THIS_ERROR = 0.7
#: Exponent of the error of the step before, over the order: a convention of this project, less than the 0.4
#: of Gustafsson.
PREVIOUS_ERROR = 0.3
#: Least share of the permitted error that counts as used, for a power of it. Derived: an error is the difference of
#: two doubles near a signal's largest value, whose last place is 2^-53 of it. Over a tolerance of 1e-4 that is
#: 1.1e-12; what is less is an error of 0. GROW limits the next step already from a share of
#: (SAFETY / GROW)^(order / THIS_ERROR), which is 0.18 for order 1 and 0.03 for order 2. Measured by Strang on
#: motor and conveyor at rest, whose supply is switched on and off: 1e-4 and 3e-2 in its place change 340 and 1033
#: steps by 2 each.
LEAST_USED = 1e-12


class Fixed:
    """Steps that are known before a run, numbered from its start: `stretches` of equal ones.

    They end at the next communication point whatever jumps; as many as nothing interrupts are one call of the loop in C.
    Where a part discards one, steps go on in pieces, from a checkpoint, if all can come back to that.

    Attributes
    ----------
    t, accepted, count
        The last communication point they reached [s], the number of steps up to it, and that of all.
    every
        After how many steps there is a row.
    loop
        How the steps are taken.
    breaks
        The intervals, begin and end [s], in which columns may jump since inputs do inside steps.
    """

    memory, rejected = None, 0

    def __init__(
        self,
        instance: SystemInstance,
        settings: RunSettings,
        jumps: KnownJumps,
        *,
        until: float,
        every: int,
        compiles: bool,
    ) -> None:
        """Go on up to the first step that ends from `until` [s] on, in C if that `compiles`."""
        self._instance, self._advance = instance, jumps.advance
        self._stop, step = settings.stop, settings.step
        self.control = "fixed"
        if isinstance(step, Mesh):
            self.control = "mesh"
            self.stretches = step.stretches(jumps.times)
        else:
            assert not isinstance(step, Adaptive)
            self.stretches = [EqualSteps(settings.start, step, settings.number())]
        self.stretches[-1] = self.stretches[-1]._replace(stop=settings.stop)
        numbers = [0, *accumulate(steps.number for steps in self.stretches)]
        self._firsts, self.count = numbers[:-1], numbers[-1]
        self.breaks, interrupted = self._meet(jumps.known)
        self._split = sorted({*interrupted, *self._firsts[1:], self.count})
        self.t, self.accepted, self.discarded, self.every = jumps.begin, 0, 0, every
        if instance.state is not None:
            self.accepted = settings.steps_until(self.t) or 0
        self._goal = self.count
        if until < settings.stop:
            n = self._number_at(until)
            self._goal = n if coincide(self._begin_of(n), until) else n + 1
        self._checkpoint: tuple[int, Snapshot] | None = None
        if jumps.can_go_back:
            self._checkpoint = (self.accepted - CHECKPOINT, Snapshot(instance.stepped))
        self._failure: FmuError | None = None
        self._has_event = False
        self._compiled: Loop | None = None
        self.loop = "Python"
        loop = instance.loop() if compiles else None
        if isinstance(loop, OSError):
            self.loop = f"Python, since the compiled loop is missing: {loop}"
        elif loop is not None:
            self._compiled, self.loop = loop, "compiled"

    def take(self) -> array[float]:
        """Take a step, or several; the rows that are due after them. Raises FmuError."""
        failure, self._failure = self._failure, None
        if failure is not None:
            self._come_back(failure)
        n, instance = self.accepted, self._instance
        if self._checkpoint is not None:
            before, snapshot = self._checkpoint
            if n >= before + CHECKPOINT:
                snapshot.take()
                self._checkpoint = (n, snapshot)
        if self._compiled is not None and not self._has_event:
            last = min(n + instance.chunk, self._goal, self._split[bisect_left(self._split, n)])
            if n < last:
                return self._take_by_loop(self._compiled, n, last)
        self._has_event = False
        t, h = self._step(n)
        try:
            self._advance(t, h)
        except StepDiscarded as discarded:
            self._come_back(discarded)
            self._advance(t, h)
        end = self._begin_of(n + 1)
        is_due = n + 1 == self.count or (n + 1) % self.every == 0
        row = array("d", instance.row(end) if is_due else ())
        self.accepted, self.t = n + 1, end
        return row

    def _take_by_loop(self, loop: Loop, n: int, last: int) -> array[float]:
        """Take steps up to number `last`, or to an event or a failure, which is raised before the next one."""
        instance, began = self._instance, clock.perf_counter()
        first, steps = self._stretch_of(n)
        rows, done, failure = loop.run(steps, n - first, last - first, self.every)
        self.accepted = first + done
        self.t = self._begin_of(self.accepted)
        self._has_event = isinstance(failure, EventDueError)
        if not self._has_event:
            self._failure = failure
        if clock.perf_counter() - began > PATIENCE:
            instance.chunk = max(instance.chunk // 2, 1)
        elif done == last - first:
            instance.chunk = min(2 * instance.chunk, MOST_ROWS * self.every)
        return rows

    def _meet(self, jumps: Sequence[Jump]) -> tuple[list[tuple[float, float]], list[int]]:
        """The breaks that jumps of inputs inside steps make, and the numbers of the steps that other jumps interrupt.

        A step with such a jump gets the mean, and what outputs show at its end is made of that: it and the next one are a
        break. Others have a jump at their beginning, or a change inside.
        """
        breaks: list[tuple[float, float]] = []
        interrupted = []
        for jump in jumps:
            # beyond the stop, another run may go on with a break
            n = min(self._number_at(jump.time), self.count - 1)
            broken = self._begin_of(n), self._begin_of(n + 2)
            if jump.changes or coincide(broken[0], jump.time):
                interrupted.append(n)
            elif broken not in breaks[-1:]:
                breaks.append(broken)
        return breaks, interrupted

    def _stretch_of(self, n: int) -> tuple[int, EqualSteps]:
        """The first step of the stretch that step number n is in, and that stretch."""
        k = bisect_right(self._firsts, n) - 1
        return self._firsts[k], self.stretches[k]

    def _step(self, n: int) -> tuple[float, float]:
        """When step number n begins, and its size [s]."""
        first, steps = self._stretch_of(n)
        return steps.at(n - first)

    def _begin_of(self, n: int) -> float:
        """When step number n begins, or the one before it ends [s]."""
        return self._stop if n == self.count else self._step(n)[0]

    def _number_at(self, time: float) -> int:
        """The number of the step that a time lies in, or that begins there."""
        k = max(0, bisect_right([steps.begin for steps in self.stretches], time) - 1)
        n = self._firsts[k] + int((time - self.stretches[k].begin) / self.stretches[k].size)
        return n + 1 if coincide(self._begin_of(n + 1), time) else n

    def _come_back(self, failure: FmuError) -> None:
        """After a discarded step, come back to before it, from now on ready to step less; raises any other failure."""
        if not isinstance(failure, StepDiscarded):
            raise failure
        if self._checkpoint is None:
            raise FmuError(
                f"{failure}; it computed up to t = {failure.reached!r} s; for a shorter step, "
                "every part must be able to restore its state and to vary its step"
            )
        before, snapshot = self._checkpoint
        self._checkpoint = self._compiled = None
        for part in self._instance.stepped:
            part.instance.go_forward_only(forward=False)
        met = isinstance(failure, EventReached)
        self.loop = f"Python, since {'steps end at events' if met else 'a part discards steps'}"
        snapshot.restore()
        self._advance = self._in_pieces(self._advance, snapshot)
        for n in range(before, self.accepted):
            self._advance(*self._step(n))

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


class _Controlled:
    """Steps whose sizes [s] a PI controller chooses, between times [s] each of which is met, as are events that parts tell.

    The next size follows from how much of the tolerance this step and the last one used. `largest` are the largest values
    so far, of what the control compares. It goes on with the `memory` of the same control.
    """

    control = ""
    loop = "Python"
    discarded = count = 0
    every = 1

    def __init__(self, instance: SystemInstance, settings: RunSettings, jumps: KnownJumps) -> None:
        assert isinstance(settings.step, Adaptive)
        self._instance, self._settings, self._advance = instance, settings.step, jumps.advance
        self._times, self._next_event = list(jumps.times), jumps.moments.next
        self.accepted = self.rejected = 0
        self.t, self._span = jumps.begin, settings.stop - settings.start
        first = settings.step.first
        self._h = FIRST * self._span if first is None else first
        self._before = 1.0
        self._largest: list[float] = []
        memory = None if instance.state is None else instance.state.memory
        if memory is not None and memory.control == self.control:
            _, self._h, self._before, self._largest = memory
        self._h = min(self._h, settings.step.longest)

    @property
    def memory(self) -> StepMemory:
        """What another run goes on with."""
        return StepMemory(self.control, self._h, self._before, self._largest)

    def _choose(self) -> tuple[float, float]:
        """The time and the size of the next step.

        A step ends at the next of the times or events, or half-way there where it would leave a crumb.
        """
        while len(self._times) > 1 and is_reached(self._times[0], self.t):
            del self._times[0]
        end, event = self._times[0], self._next_event()
        goal = end if is_reached(event, self.t) or is_reached(end, event) else event
        rest = goal - self.t
        is_last = self._h >= rest * (1 - END_ROUNDING)
        self._h = rest if is_last else min(self._h, rest / 2)
        self._end = goal if coincide(self.t + self._h, goal) else self.t + self._h
        return self.t, self._h

    def _accept(self, share: float) -> array[float]:
        """Go on from the end of a step that used this share of what it may, with the row there."""
        row = array("d", self._instance.row(self._end))
        used = max(share, LEAST_USED)
        factor = SAFETY * used ** (-THIS_ERROR / self._instance.order)
        factor *= self._before ** (PREVIOUS_ERROR / self._instance.order)
        self._before = used
        self.t, self.accepted = self._end, self.accepted + 1
        self._h = min(self._settings.longest, self._h * float(min(GROW, max(SHRINK, factor))))
        return row


class Doubling(_Controlled):
    """Each step is taken once whole and once in two halves, and again where the two differ too much.

    The whole step's end serves the halves as a prediction where inputs move within a step.
    """

    control = "doubling"

    def __init__(self, instance: SystemInstance, settings: RunSettings, jumps: KnownJumps) -> None:
        super().__init__(instance, settings, jumps)
        self._snapshot = Snapshot(instance.stepped)
        self._blocks = [b for part in instance.stepped for b in part.outputs if b.real]
        names = [name for block in self._blocks for name in block.names]
        self._absolute = [self._settings.absolute.get(name) for name in names]
        self._instant = [name in instance.instant for name in names]
        if not self._largest:
            self._largest = [size for block in self._blocks for size in block.nominals()]

    def take(self) -> array[float]:
        """Take a step, again until it is accepted; the row at its end."""
        while True:
            t, h = self._choose()
            self._snapshot.take()
            reason = ""
            try:
                self._advance(t, h)
                full = self._values()
                self._snapshot.restore(keeps_nodes=True)
                self._advance(t, h / 2)
                self._advance(t + h / 2, h / 2)
            except (StepDiscarded, NonFiniteValueError) as failure:
                reached = failure.reached if isinstance(failure, StepDiscarded) else t
                self._h = min(h / 2, max(0.0, reached - t)) or h / 2
                reason = f"{failure}; "
            else:
                values = self._values()
                used = self._share([a - b for a, b in zip(values, full)], self._span / h)
                if used <= ACCEPT:
                    self._largest = [max(a, abs(b)) for a, b in zip(self._largest, values)]
                    return self._accept(used)
                self._h *= float(max(SHRINK, SAFETY * used ** (-1.0 / self._instance.order)))
            self.rejected += 1
            if self._h < LEAST * self._span:
                raise FmuError(f"{reason}the tolerance requires steps below {self._h:.2g} s")
            self._snapshot.restore()

    def _values(self) -> list[float]:
        """The present wired outputs."""
        return [cell for block in self._blocks for cell in block.cells]

    def _share(self, errors: Sequence[float], steps: float) -> float:
        """The worst error over what is allowed, if as many steps like this one make the run.

        The errors of a run add up, except those of an output with direct feedthrough: it shows
        the error of its own instant, which the next step does not inherit.
        """
        allowed = (
            self._settings.tolerance * size if absolute is None else absolute
            for size, absolute in zip(self._largest, self._absolute)
        )
        times = (1.0 if instant else steps for instant in self._instant)
        return max((abs(e) / a * n for e, a, n in zip(errors, allowed, times)), default=0.0)


class Energy(_Controlled):
    """The size of the next step follows from the energy that each bond made in the last; none is taken again.

    After the energy-conservation-based co-simulation of Sadjina et al. (2017), with the power that
    a bond may create held to the tolerance times the largest power so far.
    """

    control = "energy"

    def take(self) -> array[float]:
        """Take a step; the row at its end."""
        sides = list(self._instance.bonds.values())
        t, h = self._choose()
        before = [[end.energy for end in pair] for pair in sides]
        self._advance(t, h)
        energies = [[end.energy - e for end, e in zip(p, b)] for p, b in zip(sides, before)]
        largest = max([*self._largest, *(abs(e) / h for pair in energies for e in pair)])
        self._largest = [largest]
        created = max(abs(first - second) for first, second in energies) / h
        allowed = self._settings.tolerance * largest
        return self._accept(created / allowed if largest else 0.0)


#: Any of them.
StepController = Fixed | Doubling | Energy
