"""Systems in which something is lost, crossed or not converted, and numbers of a system that may be other ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, islice
from typing import Any, NamedTuple

from ...system import Network, System, Wire
from .causes import DECISIVE_REDUCTION, Cause
from .conversions import CELSIUS_ZERO, conversion_of, wrong_factors
from .whole import wires_with_total_factors

#: Most variants of one kind that are tried: a convention, to limit the time.
MOST_VARIANTS = 30
#: Largest factor by which a wire is tried to be wrong: a larger one makes most systems fail at once.
MOST_WRONG = 1e4
#: Units of temperatures whose zeros differ.
TEMPERATURES = ("K", "degC")


@dataclass(frozen=True)
class Variant:
    """A changed system and the cause that it stands for, as a clause.

    `subject` is what is said of it where it makes the difference only some times smaller: another cause may do so, too.
    A guess is one of a long list.
    """

    kind: str
    text: str
    subject: str
    system: System
    is_guess: bool = False

    def clause(self, cause: Cause) -> Cause:
        """The cause in words that fit its reduction: only a decisive one is told from what imitates it."""
        is_certain = cause.reduction >= DECISIVE_REDUCTION
        text = self.text if is_certain else self.subject
        return replace(cause, kind=self.kind, text=text, is_certain=is_certain)


class FreeNumber(NamedTuple):
    """A number of a system that may be another one: what it is, as a clause says it, its value, and the system with another."""

    kind: str
    name: str
    unit: str
    value: float
    system: Callable[[float], System]

    def seems(self, value: float) -> str:
        """What is said where it is another number, with the conversion that makes this of it."""
        conversion = conversion_of(value / self.value, self.unit) if self.value else ""
        return f"{self.name} seems to be {value:.6g}, not {self.value:.6g}{conversion}"


def variants(network: Network) -> Iterator[Variant]:
    """Systems in which something has been lost, crossed or not converted."""
    for kind in (_lost_values, _lost_inputs, _lost_factors, _lost_wires, _crossed_wires):
        yield from islice(kind(network), MOST_VARIANTS)
    yield from _wrong_conversions(network)


def numbers(network: Network) -> Iterator[FreeNumber]:
    """The start values and the factors of wires."""
    system = network.system

    def with_start(name: str, value: float) -> System:
        return replace(system, start={**system.start, name: value})

    def with_factor(k: int, wire: Wire, value: float) -> System:
        return rewired(network, {k: wire._replace(factor=value)})

    for name, value in system.start.items():
        if isinstance(value, float):
            what = f"the start value {name}"
            change = partial(with_start, name)
            yield FreeNumber("wrong start value", what, network.port(name).unit, value, change)
    for k, wire in enumerate(wires_with_total_factors(network)):
        if network.wires[k].source.type == "Real":
            what = f"the factor of the wire from {wire.source} to {wire.target}"
            unit, change = network.wires[k].target.unit, partial(with_factor, k, wire)
            yield FreeNumber("lost factor", what, unit, wire.factor, change)


def rewired(network: Network, changed: Mapping[int, Wire | None]) -> System:
    """The system with some of its wires replaced, or left out."""
    wires = [changed.get(k, wire) for k, wire in enumerate(wires_with_total_factors(network))]
    return replace(network.system, wires=[w for w in wires if w is not None], bonds=())


def _lost_values(network: Network) -> Iterator[Variant]:
    system = network.system

    def lost(names: list[str], what: str, text: str) -> Variant:
        start = {name: value for name, value in system.start.items() if name not in names}
        imitation = f"a lost start value imitates it: {what}"
        return Variant("lost start value", text, imitation, replace(system, start=start))

    for name, value in system.start.items():
        what = f"{name} = {value}"
        yield lost([name], what, f"the start value {what} is lost: the FMU has its own")
    if len(system.start) > 1:
        text = "all start values are lost: the FMUs have their own"
        yield lost([*system.start], "all start values", text)
    for part in system.parts:
        names = [name for name in system.start if network.port(name).part == part]
        if 1 < len(names) < len(system.start):
            what = f"all start values of {part}"
            yield lost(names, what, f"{what} are lost: its FMU has its own")


def _lost_inputs(network: Network) -> Iterator[Variant]:
    system = network.system

    def lost(text: str, what: str, **changes: Any) -> Variant:
        imitation = f"a lost input imitates it: {what}"
        return Variant("lost input", text, imitation, replace(system, **changes))

    driven = [port.name for port, value in network.open if port.type == "Real" and value]
    for names in [*([name] for name in driven if len(driven) > 1), *([driven] if driven else [])]:
        zeros = {**system.start, **dict.fromkeys(names, 0.0)}
        text = f"the open inputs {', '.join(names)} are 0, not the start values of their FMUs"
        yield lost(text, f"{', '.join(names)} at 0", start=zeros)
    for change in system.changes:
        others = [other for other in system.changes if other != change]
        yield lost(f"the change {change!r} is missed", f"the change {change!r}", changes=others)
    for name in system.inputs:
        inputs = {other: value for other, value in system.inputs.items() if other != name}
        yield lost(f"nothing drives the input {name}", name, inputs=inputs)


def _other(network: Network, k: int, said: str, factor: float, offset: float) -> Variant:
    """Another factor and offset of a wire; {} in what is said of it is the one that has changed."""
    wire = wires_with_total_factors(network)[k]
    ends = f"from {wire.source} to {wire.target}"
    number = f"{factor:.6g}" if factor != wire.factor else f"{offset:+.6g}"
    imitation = f"another factor imitates it: {number} {ends}"
    system = rewired(network, {k: wire._replace(factor=factor, offset=offset)})
    return Variant("lost factor", f"the wire {ends} {said.format(number)}", imitation, system)


def _lost_factors(network: Network) -> Iterator[Variant]:
    for k, (source, _, factor, offset) in enumerate(network.wires):
        if (factor, offset) != (1.0, 0.0):
            shift = f" and offset {offset:.6g}" if offset else ""
            yield _other(network, k, f"lacks its factor {factor:.6g}{shift}", 1.0, 0.0)
        if source.type == "Real":
            yield _other(network, k, "has the opposite sign", -factor, -offset)


def _wrong_conversions(network: Network) -> Iterator[Variant]:
    """Wires that convert what needs no conversion, or convert it wrongly."""
    for k, (source, target, factor, offset) in enumerate(network.wires):
        for what, times in wrong_factors(target.unit) if source.type == "Real" else ():
            if not 1.0 / MOST_WRONG <= times <= MOST_WRONG:
                continue
            said = f"brings {{}} times its source: {what}?"
            guess = _other(network, k, said, times * factor, times * offset)
            yield replace(guess, is_guess=True)
        for shift in (CELSIUS_ZERO, -CELSIUS_ZERO) if target.unit in TEMPERATURES else ():
            said = "brings its source {}: degC for K, or K for degC?"
            yield _other(network, k, said, factor, offset + shift)


def _lost_wires(network: Network) -> Iterator[Variant]:
    for k, wire in enumerate(wires_with_total_factors(network)):
        ends = f"from {wire.source} to {wire.target}"
        imitation = f"a lost wire imitates it: {ends}"
        yield Variant(
            "lost wire", f"the wire {ends} is lost", imitation, rewired(network, {k: None})
        )


def _crossed_wires(network: Network) -> Iterator[Variant]:
    for (i, a), (j, b) in combinations(enumerate(wires_with_total_factors(network)), 2):
        types = {network.wires[k].source.type for k in (i, j)}
        if a.source != b.source and len(types) == 1:
            crossed = {i: a._replace(source=b.source), j: b._replace(source=a.source)}
            text = (
                f"{a.target} and {b.target} are crossed: each is driven by the source of the other"
            )
            imitation = f"crossed wires imitate it: those to {a.target} and {b.target}"
            yield Variant("wires crossed", text, imitation, rewired(network, crossed))
