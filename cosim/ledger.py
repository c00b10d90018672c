"""Energy over each power bond: what one side gives and the other takes, and what the coupling made."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

from .errors import SetupError
from .system import Network, Port, Wire, base_unit, exponents

if TYPE_CHECKING:
    from .part import Part

POWER = (1, 2, -3, 0, 0, 0, 0)


class Bond(NamedTuple):
    """Two wires between two parts, there and back, whose signals multiply to a power."""

    there: Wire
    back: Wire

    @property
    def name(self) -> str:
        return f"{self.there.source.name} * {self.back.source.name}"


class End:
    """One side of a bond: a part's output times its input, integrated by the trapezoidal rule."""

    def __init__(
        self,
        bond: str,
        side: int,
        output: tuple[Any, int],
        first: tuple[Any, int],
        last: tuple[Any, int],
        scale: float,
    ) -> None:
        self.bond, self.side = bond, side
        self.output, self.first, self.last, self.scale = output, first, last, scale
        self.energy = 0.0
        self.before = 0.0

    def value(self) -> float:
        """The output as it stands."""
        cells, i = self.output
        return float(cells[i])

    def book(self, h: float) -> None:
        """Add the work of a step of size h [s] that ends with the output as it stands."""
        (first, i), (last, j) = self.first, self.last
        now = self.value()
        self.energy += h * 0.5 * (self.before * first[i] + now * last[j]) * self.scale
        self.before = now


def bonds(network: Network) -> list[Bond]:
    """The declared bonds, and those of other wires whose units show them beyond doubt.

    Raises SetupError for a declared bond that is not two wires there and back.
    """
    declared = [_declared(network, text) for text in network.system.bonds]
    taken = {wire.target.name for bond in declared for wire in bond[:2]}
    free = [w for w in network.wires if w.target.name not in taken and w.source.type == "Real"]
    pairs = [
        Bond(there, back)
        for n, there in enumerate(free)
        for back in free[n + 1 :]
        if _opposite(there, back) and _is_power(network, there, back)
    ]
    wires = [wire.target.name for bond in pairs for wire in bond[:2]]
    return declared + [b for b in pairs if all(wires.count(w.target.name) == 1 for w in b[:2])]


def _declared(network: Network, text: str) -> Bond:
    factors = [network.port(name) for name in text.split("*")]
    if len(factors) != 2:
        raise SetupError(f"bond {text!r} must read 'part.output * part.output'")
    there, back = ([w for w in network.wires if w.source == port] for port in factors)
    found = [pair for pair in product(there, back) if _opposite(*pair)]
    if len(found) != 1 or found[0][0].source.type != "Real" or found[0][1].source.type != "Real":
        raise SetupError(f"bond {text!r} must be two Real outputs, wired there and back once")
    return Bond(*found[0])


def _opposite(there: Wire, back: Wire) -> bool:
    ends = (there.source.part, there.target.part)
    return ends == (back.target.part, back.source.part) and ends[0] != ends[1]


def _is_power(network: Network, there: Wire, back: Wire) -> bool:
    units = [base_unit(network.descriptions, wire.source) for wire in (there, back)]
    if None in units:
        return False
    return tuple(map(sum, zip(*map(exponents, units))))[:-1] == POWER


def watt(network: Network, output: Port, entry: Port) -> float:
    """From the product of an output and an input, each in its own unit, to W."""
    units = [base_unit(network.descriptions, port) for port in (output, entry)]
    return math.prod(1.0 if unit is None else unit.factor for unit in units)


def balance(parts: Iterable[Part]) -> dict[str, dict[str, float]]:
    """By bond: what the first side gave, the second took, and the residual that neither has [J]."""
    sides: dict[str, list[float]] = {}
    for part in parts:
        for end in part.ends:
            sides.setdefault(end.bond, [0.0, 0.0])[end.side] = end.energy
    return {
        bond: {"given": given, "taken": taken, "residual": given - taken}
        for bond, (given, taken) in sides.items()
    }
