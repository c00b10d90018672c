"""What an input does within a step: a polynomial through what its source has shown so far."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from itertools import groupby, zip_longest
from typing import Any, NamedTuple

from ..errors import FmuError
from .instance import Instance, VariableBlock
from .operations import ADD, COPY, SCALE, Layout, Operation, address
from .sources import InputSource
from .times import coincide


class Node(NamedTuple):
    """What an output was at a time [s], and its rate where the FMU gives it."""

    time: float
    value: float
    rate: float | None


class SignalHistory:
    """The last nodes of a Real output, enough for a polynomial of a degree.

    While a step is repeated, nodes of its end from the time before serve as predictions.
    """

    def __init__(self, degree: int) -> None:
        self.degree = degree
        self.nodes: list[Node] = []

    def add(self, node: Node) -> None:
        """Put a node in its place, instead of one of the same time."""
        later = [n for n in self.nodes if n.time > node.time and not coincide(n.time, node.time)]
        earlier = [n for n in self.nodes if n.time < node.time and not coincide(n.time, node.time)]
        self.nodes = [*earlier, node, *later][-self.degree - 4 :]

    def forget_after(self, time: float) -> None:
        """Drop the nodes after a time."""
        self.nodes = [n for n in self.nodes if n.time < time or coincide(n.time, time)]

    def taylor(self, begin: float, _: float = 0.0) -> list[float]:
        """Coefficients about `begin` of the polynomial through the newest of what is known.

        The nodes from `begin` on come first, then their rates, then older nodes.
        """
        newest = self.nodes[::-1]
        inside = [n for n in newest if n.time >= begin or coincide(n.time, begin)]
        older = newest[len(inside) :]
        known = [(n, 0) for n in inside] + [(n, 1) for n in inside]
        known += [(n, order) for n in older for order in (0, 1)]
        known = [(n, order) for n, order in known if order == 0 or n.rate is not None]
        chosen = sorted((n.time, order, n) for n, order in known[: self.degree + 1])
        return taylor_coefficients(*divided_differences([n for _, _, n in chosen]), begin)


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


def taylor_coefficients(times: list[float], newton: list[float], origin: float) -> list[float]:
    """A Newton polynomial in powers of (t - origin)."""
    power = [0.0]
    for time, c in zip(reversed(times), reversed(newton)):
        shift = origin - time
        power = [
            (power[k] * shift if k < len(power) else 0.0) + (power[k - 1] if k else c)
            for k in range(len(power) + 1)
        ]
    return power[:-1]


def polynomial_value(taylor: list[float], s: float) -> float:
    """The polynomial at s."""
    total = 0.0
    for a in reversed(taylor):
        total = total * s + a
    return total


def polynomial_mean(taylor: list[float], h: float) -> float:
    """The polynomial's mean over [0, h]."""
    return polynomial_value([a / (k + 1) for k, a in enumerate(taylor)], h)


class Link(Operation):
    """The end of a wire: input cell cells[i] follows factor * source[j] + offset.

    It `adds` to what the links before it have brought to the cell.
    Where it has a `signal`, it moves within a step on that of the source: `first` and `last` are
    then the values of the last step, and otherwise the cell itself.
    """

    def __init__(
        self, cells: Any, i: int, source: Any, j: int, factor: float = 1.0, offset: float = 0.0
    ) -> None:
        self.cells, self.i, self.source, self.j = cells, i, source, j
        self.factor, self.offset, self.adds = factor, offset, False
        self.signal: SignalHistory | InputSource | None = None
        self.first = self.last = (cells, i)

    @property
    def real(self) -> bool:
        """Whether it carries a Real."""
        return isinstance(self.cells, ctypes.Array) and self.cells._type_ is ctypes.c_double

    def __call__(self, t: float, h: float) -> None:
        if self.adds:
            self.cells[self.i] += self.factor * self.source[self.j] + self.offset
        elif self.factor == 1.0 and self.offset == 0.0:
            self.cells[self.i] = self.source[self.j]
        else:
            self.cells[self.i] = self.factor * self.source[self.j] + self.offset

    def layout(self) -> Layout | None:
        """None for a text, whose memory is Python's, and between types of two widths."""
        kind = self.cells._type_
        if kind is ctypes.c_char_p or kind is not self.source._type_:
            return None
        plain = (self.factor, self.offset) == (1.0, 0.0)
        code = ADD if self.adds else COPY if plain else SCALE
        scale = {"factor": self.factor, "offset": self.offset}
        cells, source = address(self.cells, self.i), address(self.source, self.j)
        return Layout(code, ctypes.sizeof(kind), cells=cells, source=source, **scale)

    def follow(self, signal: SignalHistory | InputSource) -> None:
        """Move with a signal from now on."""
        self.signal = signal
        self.first, self.last = ([0.0], 0), ([0.0], 0)

    def taylor(self, t: float, h: float) -> list[float]:
        """What it brings over a step from t by h [s], as a polynomial."""
        assert self.signal is not None
        taylor = [self.factor * a for a in self.signal.taylor(t, h)]
        taylor[0] += self.offset
        return taylor


class CastLink(Link):
    """A link between two types of whole numbers or truth values, which must be able to hold the value."""

    def __init__(self, name: str, *ends: Any) -> None:
        super().__init__(*ends)
        self.name = name

    def __call__(self, t: float, h: float) -> None:
        super().__call__(t, h)
        if self.cells[self.i] != (value := self.source[self.j]):
            raise FmuError(f"{self.name} cannot take {value!r}, which a wire brings at t = {t!r} s")


class InputPolynomials(Operation):
    """The moving inputs and watched outputs of a part; called, it remembers the outputs.

    `entries` and `shown` are the buffers of its Real inputs and outputs, if any; links lead to
    each of the inputs. An FMU that can interpolate gets an input's value and derivatives at the
    beginning of the step, any other its mean over the step.
    """

    def __init__(
        self,
        part: Instance,
        degree: int,
        entries: VariableBlock | None,
        links: Sequence[Link],
        shown: VariableBlock | None,
    ) -> None:
        ability = part.description.coSimulation
        self.degree, self.capable = degree, bool(ability.canInterpolateInputs)
        self.links = sorted(links, key=lambda link: link.i)
        self._by_input = [list(own) for _, own in groupby(self.links, lambda link: link.i)]
        self.signals = [SignalHistory(degree) for _ in (shown.cells if shown else ())]
        self._entries, self._shown = entries, shown
        self._derivatives = self._rates = None
        if self.capable and entries:
            orders = range(1, degree + 1)
            variables = [v for v in entries.variables for _ in orders]
            self._derivatives = part.BLOCK(
                part, "Set", variables, [*orders] * len(entries.variables)
            )
        if ability.maxOutputDerivativeOrder and shown:
            self._rates = part.BLOCK(part, "Get", shown.variables, [1] * len(shown.variables))

    def __call__(self, t: float, h: float) -> None:
        """Remember the outputs as they stand, and their rates, as nodes at time t [s]."""
        if self._rates is not None:
            self._rates.move()
        self.suppose(t, self._rates)

    def suppose(self, t: float, rates: VariableBlock | None = None) -> None:
        """Let the outputs as they stand be those of time t [s]."""
        for k, signal in enumerate(self.signals):
            assert self._shown is not None
            signal.add(Node(t, self._shown.cells[k], rates.cells[k] if rates else None))

    def bring(self, t: float, h: float, *, first: bool) -> None:
        """Hand over inputs for a step from t by h [s], the first of its turn or not."""
        for k, (link, *others) in enumerate(self._by_input):
            taylor = link.taylor(t, h)
            for other in others:
                taylor = [a + b for a, b in zip_longest(taylor, other.taylor(t, h), fillvalue=0.0)]
            if self._derivatives is not None:
                begin, link.last[0][0] = taylor[0], polynomial_value(taylor, h)
                for order in range(1, self.degree + 1):
                    a = taylor[order] if order < len(taylor) else 0.0
                    place = k * self.degree + order - 1
                    self._derivatives.cells[place] = math.factorial(order) * a
            else:
                begin = link.last[0][0] = polynomial_mean(taylor, h)
            link.cells[link.i] = begin
            if first:
                link.first[0][0] = begin
        for block in filter(None, (self._entries, self._derivatives)):
            block.move()
