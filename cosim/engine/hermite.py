"""What an output has shown so far, and the polynomials through it: Hermite interpolation by divided differences.

The Newton form with nodes that stand twice: J. Stoer and R. Bulirsch, Introduction to Numerical
Analysis, section 2.1.5.
"""

from __future__ import annotations

from typing import NamedTuple

from ..fmu.times import coincide


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

    def taylor(self, begin: float, _: float = 0.0) -> list[float]:
        """Coefficients about `begin` of the polynomial through the newest of its nodes.

        The nodes from `begin` on come first, then their rates, then older nodes.
        """
        newest = self.nodes[::-1]
        inside = [n for n in newest if n.time >= begin or coincide(n.time, begin)]
        older = newest[len(inside) :]
        conditions = [(n, 0) for n in inside] + [(n, 1) for n in inside]
        conditions += [(n, order) for n in older for order in (0, 1)]
        conditions = [(n, order) for n, order in conditions if order == 0 or n.rate is not None]
        chosen = sorted((n.time, order, n) for n, order in conditions[: self.degree + 1])
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
