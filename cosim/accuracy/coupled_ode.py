"""The model-exchange sides of all parts of a system, coupled as one ordinary differential equation."""

from __future__ import annotations

import ctypes
import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import chain
from typing import NamedTuple

import numpy as np

from ..engine.changes import discrete_changes
from ..engine.initialise import WiredParts
from ..engine.newton import SINGULAR_EXACT, condition
from ..engine.part import WiredPart
from ..engine.row import RowReader
from ..engine.settings import RunSettings
from ..engine.settle import settle_wires, solve_loops
from ..errors import FmuError, SetupError
from ..fmu.blocks import VariableBlock
from ..fmu.exchange import Array, EvaluationError, ModelExchange
from ..system import Network, Port
from ..system.graph import algebraic_loops, describe_loop, stepping_order
from ..system.inputs import TableInput

#: A part that offers model exchange.
ExchangePart = WiredPart[ModelExchange]
#: Change of an input over its size, below which it is settled. A convention: the tolerance of the reference
#: solution, below which an error is none.
SETTLED = 1e-12


class Blocks(NamedTuple):
    """Derivatives of rates (A, B) and outputs (C, D) by states and inputs, and the wires (F).

    The matrices consist of one block for each part; F holds the outputs that each input receives.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    F: Array


class CoupledOde:
    """A coupled system at a time `t` [s] as one differential equation dx/dt = f(t, x), from `open`.

    `states`, `inputs` and `outputs` are its Real ports, part by part; `stops` are the times at which
    something changes from outside. After the `deadline`, a reading of the monotonic clock [s], no rates are
    computed any more.
    """

    def __init__(
        self, network: Network, models: Mapping[str, ExchangePart], start: float, stop: float
    ) -> None:
        self.network, self.models, self.t, self.stop = network, models, start, stop
        self.parts = list(models.values())
        self.states = [Port(p.name, v) for p in self.parts for v in p.instance.states]
        self.inputs = [Port(p.name, v) for p in self.parts for v in p.instance.continuous_inputs()]
        self.outputs = [Port(p.name, v) for p in self.parts for v in p.instance.real_outputs()]
        self.feeds = [feed for part in self.parts for feed in part.feeds]
        self.changes = discrete_changes(network, models, start, stop)
        knots = [f.profile.times for f in self.feeds if isinstance(f.profile, TableInput)]
        self.stops = sorted({change.time for change in self.changes}.union(*knots))
        self.until = math.inf
        self.deadline = math.inf
        self.jump(start)

    @classmethod
    @contextmanager
    def open(cls, network: Network, start: float, stop: float) -> Iterator[CoupledOde]:
        """The system at `start` [s], its start values consistent; at the end of the context all instances are freed.

        Raises SetupError for a part without model exchange or with a clock that is to tick, FmuError
        where an FMU refuses.
        """
        for name, description in network.descriptions.items():
            if description.modelExchange is None:
                raise SetupError(f"{name}: {network.system.parts[name]} offers no model exchange")
            for v in description.modelVariables:
                if v.type == "Clock" and v.causality == "input":
                    raise SetupError(
                        f"{name}.{v.name} is a clock, which ticks in co-simulation only"
                    )
        with ExitStack() as stack:
            sequence = stepping_order(network, None)
            settings = RunSettings(stop, math.inf, start)
            wired = WiredParts(network, stack, ModelExchange)
            wired.begin(network, settings, sequence)
            yield cls(network, wired.parts, start, stop)

    @property
    def x(self) -> Array:
        """The continuous states."""
        return np.array([value for part in self.parts for value in part.instance.x])

    @property
    def nominals(self) -> Array:
        """The nominal values of the states, as the parts give them; 1 for what cannot be a nominal value.

        FMI wants them above 0, and some tools give 0.
        """
        values = []
        for part in self.parts:
            cells = (ctypes.c_double * len(part.instance.x))()
            part.instance.array("GetNominalsOfContinuousStates", cells)
            values += list(cells)
        sizes = np.abs(values)
        return np.where((sizes > 0.0) & (sizes < math.inf), sizes, 1.0)

    def at(self, t: float, x: Array) -> None:
        """Be at a time [s] and a state, all wires settled; raises EvaluationError, FmuError."""
        self.t = t
        values = iter(x.tolist())
        for part in self.parts:
            instance = part.instance
            instance.session.call("setTime", t)
            instance.x[:] = [next(values) for _ in instance.x]
            instance.set_states()
        self._exchange_until_settled(lambda block: block.real)

    def slopes(self, t: float, x: Array) -> Array:
        """The rates of the states; NaN where a part refuses them. Raises FmuError after the deadline."""
        if clock.monotonic() > self.deadline:
            raise FmuError(f"not finished within the timeout: the integrator is at t = {t!r} s")
        try:
            self.at(t, x)
            for part in self.parts:
                part.instance.get_rates()
        except EvaluationError:
            return np.full(len(x), math.nan)
        return np.array([value for part in self.parts for value in part.instance.dx])

    def reader(self, ports: Sequence[Port]) -> Callable[[], list[float]]:
        """What gives the values of variables at the time and state that the system is at."""
        row = RowReader(self.parts, ports)
        outputs = [block for part in self.parts for block in part.outputs]

        def read() -> list[float]:
            for block in outputs:
                block.move()
            return row(self.t)[1:]

        return read

    def signs(self) -> list[float]:
        """Values whose change is an event.

        These are the indicators, as at least zero or not, and the outputs on wires that are not Real,
        in case no indicator guards them.
        """
        signs: list[float] = []
        for part in self.parts:
            indicators = part.instance.z
            part.instance.array("GetEventIndicators", indicators)
            signs += [value >= 0.0 for value in indicators]
            for block in part.outputs:
                if not block.real:
                    block.move()
                    signs += list(block.cells)
        return signs

    def wants_event_after_step(self) -> bool:
        """Notify the parts that a step of the integrator is complete; returns whether one wants an event."""
        wants = False
        for part in self.parts:
            session = part.instance.session
            if session.interface.needsCompletedIntegratorStep:
                event, end = session.call("completedIntegratorStep")
                self._require_going(part, end=end)
                wants = wants or event
        return wants

    def jump(self, t: float) -> None:
        """An event at a time [s]: changes from outside, then discrete states until all agree."""
        self.t, again = t, True
        for part in self.parts:
            if part.instance.is_started:
                part.instance.session.call("enterEventMode")
        for change in self.changes:
            if change.time == t:
                change.instance.set(change.variable, change.value)
        for block in chain.from_iterable(part.inputs for part in self.parts):
            block.move()  # what arrived on the way to the event, when only Real inputs are set
        while again:
            again = self._exchange_until_settled(lambda _: True)
            for part in self.parts:
                more, end = part.instance.update()
                self._require_going(part, end=end)
                again = again or more
            again = self._exchange_until_settled(lambda _: True) or again
        for part in self.parts:
            part.instance.enter_continuous_time()

    def next_stop(self, stop: float) -> float:
        """The next time [s] of an event that is known in advance, at most `stop`."""
        times = chain(self.stops, (part.instance.next_time for part in self.parts), [stop])
        return min(time for time in times if time > self.t)

    def blocks(self) -> Blocks:
        """The derivatives of all parts at the present point."""
        from scipy.linalg import block_diag

        pieces = []
        for part in self.parts:
            n, (by_states, by_inputs) = len(part.instance.rates), part.instance.jacobian()
            pieces.append((by_states[:n], by_inputs[:n], by_states[n:], by_inputs[n:]))
        F = np.zeros((len(self.inputs), len(self.outputs)))
        row, column = (
            {port.name: k for k, port in enumerate(p)} for p in (self.inputs, self.outputs)
        )
        for source, target, factor, _ in self.network.wires:
            if target.name in row:
                F[row[target.name], column[source.name]] = factor
        A, B, C, D = (block_diag(*each) for each in zip(*pieces))
        return Blocks(A, B, C, D, F)

    def loop_matrix(self, blocks: Blocks) -> Array:
        """I - F D, by which the inputs follow what is put on them; SetupError if it is singular."""
        loop = blocks.F @ blocks.D
        index_of = {port.name: k for k, port in enumerate(self.inputs)}
        for ring in algebraic_loops(self.network):
            indices = [index_of[w.target.name] for w in ring if w.target.name in index_of]
            if not indices:
                continue
            if condition(np.eye(len(indices)) - loop[np.ix_(indices, indices)]) > SINGULAR_EXACT:
                raise SetupError(f"the algebraic loop has no solution: {describe_loop(ring)}")
        return np.eye(len(self.inputs)) - loop

    def _exchange_until_settled(self, is_exchanged: Callable[[VariableBlock], bool]) -> bool:
        """Bring outputs over the wires until the inputs agree with them; whether any has changed."""
        for feed in self.feeds:
            feed.cell[0] = float(
                feed.profile.at(min(self.t, math.nextafter(self.until, -math.inf)))
            )
        inputs = [block for p in self.parts for block in p.inputs if is_exchanged(block)]
        entered = [list(block.cells) for block in inputs]
        sweeps = 2 + len(self.network.wires)
        taken = settle_wires(self.parts, sweeps, takes=is_exchanged, reads=is_exchanged)
        if taken is not None:
            return taken > 0
        self._solve_loops()
        left = [list(block.cells) for block in inputs]
        return any(
            abs(new - old) > SETTLED * (1.0 + abs(old)) if isinstance(new, float) else new != old
            for before, after in zip(entered, left)
            for old, new in zip(before, after)
        )

    def _solve_loops(self) -> None:
        """The Real inputs of an algebraic loop, from the exact derivatives; raises FmuError."""
        names = [n for part in self.parts for b in part.inputs if b.real for n in b.names]
        index_of = {port.name: k for k, port in enumerate(self.inputs)}
        indices = [index_of[name] for name in names]

        def derivative() -> Array:
            return np.eye(len(names)) - self.loop_matrix(self.blocks())[np.ix_(indices, indices)]

        def check(z: Array) -> None:
            if not np.isfinite(z).all():
                raise EvaluationError("the values of an algebraic loop are no longer finite")

        if worst := solve_loops(self.parts, check, derivative=derivative, tolerance=SETTLED):
            loops = "; ".join(describe_loop(loop) for loop in algebraic_loops(self.network))
            raise FmuError(
                f"the algebraic loop was not solved at t = {self.t!r} s, {worst} off: {loops}"
            )

    def _require_going(self, part: ExchangePart, *, end: bool) -> None:
        if end:
            raise FmuError(
                f"{part.name} ended the simulation at t = {self.t!r} s: {part.messages.reason()}"
            )
