"""What an input does within a step: a polynomial through what its source has shown so far."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from .clock import same
from .feed import Feed
from .part import Part


class Node(NamedTuple):
    """What an output was at a time [s], and its rate where the FMU tells it."""

    time: float
    value: float
    rate: float | None


class Signal:
    """The last nodes of a Real output, enough for a polynomial of a degree.

    While a step is repeated, nodes of its end from the time before serve as predictions.
    """

    def __init__(self, degree: int) -> None:
        self.degree = degree
        self.nodes: list[Node] = []

    def add(self, node: Node) -> None:
        """Put a node in its place, instead of one of the same time."""
        later = [n for n in self.nodes if n.time > node.time and not same(n.time, node.time)]
        earlier = [n for n in self.nodes if n.time < node.time and not same(n.time, node.time)]
        self.nodes = [*earlier, node, *later][-self.degree - 4 :]

    def forget_after(self, time: float) -> None:
        """Drop the nodes after a time."""
        self.nodes = [n for n in self.nodes if n.time < time or same(n.time, time)]

    def taylor(self, begin: float, _: float = 0.0) -> list[float]:
        """Coefficients about `begin` of the polynomial through the newest of what is known.

        The nodes from `begin` on come first, then their rates, then older nodes.
        """
        newest = self.nodes[::-1]
        inside = [n for n in newest if n.time >= begin or same(n.time, begin)]
        older = newest[len(inside) :]
        known = [(n, 0) for n in inside] + [(n, 1) for n in inside]
        known += [(n, order) for n in older for order in (0, 1)]
        known = [(n, order) for n, order in known if order == 0 or n.rate is not None]
        chosen = sorted((n.time, order, n) for n, order in known[: self.degree + 1])
        return expand(*divided_differences([n for _, _, n in chosen]), begin)


def divided_differences(nodes: list[Node]) -> tuple[list[float], list[float]]:
    """Times and Newton coefficients; a node that stands twice gives its rate too."""
    times = [n.time for n in nodes]
    c = [n.value for n in nodes]
    for j in range(1, len(nodes)):
        for i in range(len(nodes) - 1, j - 1, -1):
            rate = nodes[i].rate
            if times[i] == times[i - j] and rate is not None:
                c[i] = rate
            else:
                c[i] = (c[i] - c[i - 1]) / (times[i] - times[i - j])
    return times, c


def expand(times: list[float], newton: list[float], origin: float) -> list[float]:
    """A Newton polynomial in powers of (t - origin)."""
    power = [0.0]
    for time, c in zip(reversed(times), reversed(newton)):
        shift = origin - time
        power = [
            (power[k] * shift if k < len(power) else 0.0) + (power[k - 1] if k else c)
            for k in range(len(power) + 1)
        ]
    return power[:-1]


def value(taylor: list[float], s: float) -> float:
    """The polynomial at s."""
    total = 0.0
    for a in reversed(taylor):
        total = total * s + a
    return total


def mean(taylor: list[float], h: float) -> float:
    """The polynomial's mean over [0, h]."""
    return value([a / (k + 1) for k, a in enumerate(taylor)], h)


class Entry:
    """A Real input that follows factor * signal + offset; `first` and `last` in the last step."""

    def __init__(
        self, cells: Any, i: int, signal: Signal | Feed, factor: float, offset: float
    ) -> None:
        self.cells, self.i = cells, i
        self.signal, self.factor, self.offset = signal, factor, offset
        self.first, self.last = [0.0], [0.0]


class Curves:
    """The moving inputs and watched outputs of a part.

    An FMU that can interpolate gets an input's value and derivatives at the beginning of the step,
    any other its mean over the step.
    """

    def __init__(self, part: Part, degree: int) -> None:
        self.part = part
        self.degree = degree
        self.capable = bool(part.description.coSimulation.canInterpolateInputs)
        self.entries: list[Entry] = []
        self.signals: list[tuple[Signal, Any, int]] = []
        self._derivatives: Any = None
        self._set_derivatives: Callable[[], int] | None = None
        self._rates: Any = None
        self._get_rates: Callable[[], int] | None = None

    def prepare(self, inputs: Sequence[int], outputs: Sequence[int]) -> None:
        """Make ready the calls for derivatives; value references in the order of the lists."""
        part = self.part
        orders = range(1, self.degree + 1)
        if self.capable and inputs:
            self._derivatives = (ctypes.c_double * (len(inputs) * self.degree))()
            self._set_derivatives = _call(
                part.library.fmi2SetRealInputDerivatives,
                part,
                [(reference, order) for reference in inputs for order in orders],
                self._derivatives,
            )
        if part.description.coSimulation.maxOutputDerivativeOrder and outputs:
            self._rates = (ctypes.c_double * len(outputs))()
            self._get_rates = _call(
                part.library.fmi2GetRealOutputDerivatives,
                part,
                [(reference, 1) for reference in outputs],
                self._rates,
            )

    def read(self, t: float) -> None:
        """Remember the watched outputs as they stand, and their rates, as nodes at time t [s]."""
        if self._get_rates is not None:
            status = self._get_rates()
            if status:
                self.part.answered("GetRealOutputDerivatives", status)
        for k, (signal, cells, i) in enumerate(self.signals):
            signal.add(Node(t, cells[i], None if self._rates is None else self._rates[k]))

    def bring(self, t: float, h: float, *, first: bool) -> None:
        """Fill inputs and derivatives for a step from t by h [s], the first of its turn or not."""
        for k, entry in enumerate(self.entries):
            taylor = [entry.factor * a for a in entry.signal.taylor(t, h)]
            taylor[0] += entry.offset
            if self.capable:
                begin, entry.last[0] = taylor[0], value(taylor, h)
                for order in range(1, self.degree + 1):
                    a = taylor[order] if order < len(taylor) else 0.0
                    self._derivatives[k * self.degree + order - 1] = math.factorial(order) * a
            else:
                begin = entry.last[0] = mean(taylor, h)
            entry.cells[entry.i] = begin
            if first:
                entry.first[0] = begin

    def entry(self, cells: Any, i: int) -> Entry:
        """The entry of an input cell."""
        return next(e for e in self.entries if e.cells is cells and e.i == i)

    def send(self) -> None:
        """Hand the derivatives over."""
        if self._set_derivatives is not None:
            status = self._set_derivatives()
            if status:
                self.part.answered("SetRealInputDerivatives", status)


def _call(
    function: Any, part: Part, places: Sequence[tuple[int, int]], values: Any
) -> Callable[[], int]:
    """A prepared call for derivatives at these references and orders."""
    count = len(places)
    references = (ctypes.c_uint * count)(*(reference for reference, _ in places))
    orders = (ctypes.c_int * count)(*(order for _, order in places))
    return partial(function, part.component, references, ctypes.c_size_t(count), orders, values)
