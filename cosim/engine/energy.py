"""Energy over each power bond: what one side delivers, the other receives, and the coupling creates."""

from __future__ import annotations

import ctypes
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from ..errors import SetupError
from ..fmu.buffers import Slot, address
from ..fmu.operations import Code, COperation, Operation
from ..system import Connection, Network, Port, unit_exponents

#: Of a power bond, energies [J] by what they are.
Balance = dict[str, float]
ENERGY, EXCHANGED, BEFORE = range(3)
#: The powers of the base units in a W, without angles.
POWER = (1, 2, -3, 0, 0, 0, 0)
#: The relative difference of two factors that mean the same power. A convention: unit files give six digits.
SAME_POWER = 1e-6
#: Share of the energy carried above which what the coupling made is worth a warning. A convention: the
#: share of error that engineers accept of an energy balance.
NOTICEABLE = 0.05
#: Share of the energy to and fro below which it is not, where little is carried on the whole. A
#: convention: a tenth of the share above.
NEGLIGIBLE = 0.005


class Bond(NamedTuple):
    """Two wires between two parts, there and back, whose signals multiply to a power."""

    forth: Connection
    back: Connection

    @property
    def name(self) -> str:
        """The outputs whose product is the power, as a report names them."""
        return f"{self.forth.source.name} * {self.back.source.name}"


class BondSide(Operation):
    """One side of a bond: a part's output times its input, integrated by the trapezoidal rule.

    `output` is the slot of the output, `first` and `last` those of the input's values in a step;
    `scale` makes W of their product. `totals` are the energy, that to and fro added up [J], and the
    output at the last booking.
    """

    def __init__(
        self, bond: str, side: int, output: Slot, *, first: Slot, last: Slot, scale: float
    ) -> None:
        self.bond, self.side = bond, side
        self.output, self.first, self.last, self.scale = output, first, last, scale
        self.totals = (ctypes.c_double * 3)()

    @property
    def energy(self) -> float:
        """What went over the side so far [J]."""
        return self.totals[ENERGY]

    def begin_with_present_output(self) -> None:
        """Let the first step of a run begin with it."""
        self.totals[:] = [0.0, 0.0, self.output.value]

    def __call__(self, t: float, h: float) -> None:
        """Add the work of a step of size h [s] that ends with the present output."""
        totals, now = self.totals, self.output.value
        work = h * 0.5 * (totals[BEFORE] * self.first.value + now * self.last.value) * self.scale
        totals[ENERGY] += work
        totals[EXCHANGED] += abs(work)
        totals[BEFORE] = now

    def c_operation(self) -> COperation:
        """The trapezoidal rule in C, on the same totals."""
        return COperation(
            Code.BOOK,
            cells=address(self.totals),
            source=self.output.address,
            first=self.first.address,
            last=self.last.address,
            factor=self.scale,
        )


def find_bonds(network: Network) -> list[Bond]:
    """The declared bonds, and those of other wires whose units and factors show them beyond doubt.

    Raises SetupError for a declared bond that is not two wires there and back.
    """
    named = [declared_bond(network, text) for text in network.system.bonds]
    taken = {wire.target.name for bond in named for wire in bond}
    taken |= network.sums().keys()
    free = [w for w in network.wires if w.target.name not in taken and w.source.type == "Real"]
    pairs = [bond for bond in _wires_there_and_back(free) if _is_power(network, *bond)]
    shared = Counter(wire.target.name for bond in pairs for wire in bond)
    return named + [b for b in pairs if all(shared[wire.target.name] == 1 for wire in b)]


def _wires_there_and_back(wires: Sequence[Connection]) -> Iterator[Bond]:
    """Every two wires there and back between two parts, in their order."""
    by_direction = defaultdict(list)
    for n, wire in enumerate(wires):
        by_direction[wire.source.part, wire.target.part].append((n, wire))
    for n, forth in enumerate(wires):
        for k, back in by_direction.get((forth.target.part, forth.source.part), ()):
            if k > n and forth.source.part != forth.target.part:
                yield Bond(forth, back)


def declared_bond(network: Network, text: str) -> Bond:
    """The bond of a text; raises SetupError if it is none."""
    factors = [network.port(name) for name in text.split("*")]
    if text.count("*") != 1:
        raise SetupError(f"bond {text!r} must read 'part.output * part.output'")
    wires = [wire for wire in network.wires if wire.source in factors]
    matches = [
        bond for bond in _wires_there_and_back(wires) if {w.source for w in bond} == {*factors}
    ]
    if len(matches) != 1 or any(wire.source.type != "Real" for wire in matches[0]):
        raise SetupError(f"bond {text!r} must name two Real outputs, wired there and back once")
    if summed := network.sums().keys() & {wire.target.name for wire in matches[0]}:
        raise SetupError(f"bond {text!r} ends at {min(summed)}, which is a sum of wires")
    return Bond(*sorted(matches[0], key=lambda wire: factors.index(wire.source)))


def _is_power(network: Network, forth: Connection, back: Connection) -> bool:
    first, second = (network.base_unit(wire.source) for wire in (forth, back))
    if first is None or second is None:
        return False
    first_scale, second_scale = (
        into.factor * watts_per_product(network, out.source, into.target)
        for out, into in ((forth, back), (back, forth))
    )
    powers = tuple(map(sum, zip(unit_exponents(first), unit_exponents(second))))[:-1]
    return powers == POWER and math.isclose(first_scale, second_scale, rel_tol=SAME_POWER)


def watts_per_product(network: Network, output: Port, entry: Port) -> float:
    """From the product of an output and an input, each in its own unit, to W."""
    units = [network.base_unit(port) for port in (output, entry)]
    return math.prod(1.0 if unit is None else unit.factor for unit in units)


def balance(given: float, taken: float, exchanged: float) -> Balance:
    """What the sides of a bond gave and took, and how much went to and fro [J].

    The residual is what the coupling removed, or created where it is below 0.
    """
    return {"given": given, "taken": taken, "residual": given - taken, "exchanged": exchanged}


def energies(sides: Sequence[BondSide]) -> tuple[float, float, float]:
    """What the two sides of a bond gave and took, and how much went to and fro [J]."""
    first, second = sides
    return first.energy, second.energy, max(side.totals[EXCHANGED] for side in sides)


def by_bond(sides: Iterable[BondSide]) -> dict[str, list[BondSide]]:
    """The two sides of each bond, that of its first output first."""
    pairs: dict[str, list[BondSide]] = {}
    for side in sides:
        pairs.setdefault(side.bond, []).append(side)
    return {bond: sorted(pair, key=lambda side: side.side) for bond, pair in pairs.items()}


def is_noticeable(given: Any, taken: Any, exchanged: Any) -> Any:
    """Whether the coupling changed a noticeable share of energies [J], numbers or arrays, that a bond carried."""
    change = abs(given - taken)
    is_share = (change > NOTICEABLE * abs(given)) & (change > NOTICEABLE * abs(taken))
    return is_share & (change > NEGLIGIBLE * exchanged)


def bond_warnings(balances: Mapping[str, Balance]) -> Iterator[str]:
    """A sentence for every bond on which the coupling changed a noticeable share of the energy carried.

    Amounts that are negligible compared with the energy exchanged to and fro are not reported.
    """
    for bond, energy in balances.items():
        if is_noticeable(energy["given"], energy["taken"], energy["exchanged"]):
            change = abs(energy["residual"])
            carried = max(abs(energy["given"]), abs(energy["taken"]))
            verb = "removed" if energy["residual"] > 0.0 else "created"
            yield (
                f"bond {bond}: the coupling {verb} {change:.3g} J, {change / carried:.0%} of the "
                f"{carried:.3g} J carried: use smaller steps or another algorithm; see diagnose"
            )
