"""Systems in which something has been lost, crossed or not converted, and the causes that they stand for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from ...errors import SetupError
from ...system import Network, System, Wire, connect
from .causes import Cause

#: Most variants of one kind that are tried: a convention, to limit the time.
MOST_VARIANTS = 30
#: A reduction of the difference from which on no other cause is sought: what is left is a thousandth of it.
DECISIVE_REDUCTION = 1e3
#: What is said of a cause that makes the difference only some times smaller: another cause may do so, too.
IMITATIONS = {
    "lost start value": "a lost start value imitates it",
    "lost input": "a lost input imitates it",
    "lost factor": "another factor imitates it",
    "lost wire": "a lost wire imitates it",
    "wires crossed": "crossed wires imitate it",
    "late input": "a late input imitates it",
}


@dataclass(frozen=True)
class Variant:
    """A changed system and the cause that it stands for, as a clause; `subject` is what it is about."""

    kind: str
    text: str
    system: System
    subject: str

    def clause(self, cause: Cause) -> Cause:
        """The cause in words that fit its reduction: only a decisive one is told from what imitates it."""
        if cause.reduction >= DECISIVE_REDUCTION:
            return replace(cause, kind=self.kind, text=self.text)
        text = f"{IMITATIONS[self.kind]}: {self.subject}"
        return replace(cause, kind=self.kind, text=text, is_certain=False)


def wrongly_connected(network: Network) -> Iterator[Variant]:
    """Systems in which something has been lost, crossed or not converted."""
    for make in (
        _missing_values,
        _missing_inputs,
        _missing_factors,
        _missing_wires,
        _crossed_wires,
    ):
        count = 0
        for variant in make(network):
            try:
                connect(variant.system)
            except SetupError:
                continue
            yield variant
            count += 1
            if count == MOST_VARIANTS:
                break


def _missing_values(network: Network) -> Iterator[Variant]:
    system = network.system
    for name, value in system.start.items():
        start = {other: v for other, v in system.start.items() if other != name}
        text = f"the start value {name} = {value} is lost: the FMU has its own"
        yield Variant("lost start value", text, replace(system, start=start), f"{name} = {value}")
    if len(system.start) > 1:
        text = "all start values are lost: the FMUs have their own"
        yield Variant("lost start value", text, replace(system, start={}), "all start values")
    for part in system.parts:
        start = {n: v for n, v in system.start.items() if network.port(n).part != part}
        if 0 < len(start) < len(system.start) - 1:
            text = f"all start values of {part} are lost: its FMU has its own"
            yield Variant(
                "lost start value",
                text,
                replace(system, start=start),
                f"all start values of {part}",
            )


def _missing_inputs(network: Network) -> Iterator[Variant]:
    system = network.system
    driven = {port.name: value for port, value in network.open if port.type == "Real" and value}
    for names in ([name] for name in driven) if len(driven) > 1 else ():
        yield _zeroed(system, names)
    if driven:
        yield _zeroed(system, list(driven))
    for change in system.changes:
        changes = [other for other in system.changes if other != change]
        yield Variant(
            "lost input",
            f"the change {change!r} is missed",
            replace(system, changes=changes),
            f"the change {change!r}",
        )
    for name in system.inputs:
        inputs = {other: v for other, v in system.inputs.items() if other != name}
        yield Variant(
            "lost input", f"nothing drives the input {name}", replace(system, inputs=inputs), name
        )


def _zeroed(system: System, names: Sequence[str]) -> Variant:
    """Inputs that nothing drives, at 0 in place of the start values of their FMUs."""
    text = f"the open inputs {', '.join(names)} are 0, not the start values of their FMUs"
    return Variant(
        "lost input",
        text,
        replace(system, start={**system.start, **dict.fromkeys(names, 0.0)}),
        f"{', '.join(names)} at 0",
    )


def plain_wires(network: Network) -> list[Wire]:
    """The checked wires with their total factors and offsets."""
    sums = network.sums()
    return [
        Wire(
            c.source.name,
            c.target.name,
            c.factor,
            c.offset,
            converts=False,
            adds=c.target.name in sums,
        )
        for c in network.wires
    ]


def _rewired(network: Network, changed: Mapping[int, Wire | None]) -> System:
    """The system with some of its wires replaced, or left out."""
    wires = [changed.get(k, wire) for k, wire in enumerate(plain_wires(network))]
    return replace(network.system, wires=[w for w in wires if w is not None], bonds=())


def _missing_factors(network: Network) -> Iterator[Variant]:
    for k, wire in enumerate(plain_wires(network)):
        ends = f"{wire.source} to {wire.target}"
        if (wire.factor, wire.offset) != (1.0, 0.0):
            text = f"the wire from {ends} lacks its factor {wire.factor:.6g}"
            text += f" and offset {wire.offset:.6g}" if wire.offset else ""
            yield Variant(
                "lost factor",
                text,
                _rewired(network, {k: wire._replace(factor=1.0, offset=0.0)}),
                f"1 from {ends}",
            )
        if network.wires[k].source.type == "Real":
            opposite = wire._replace(factor=-wire.factor, offset=-wire.offset)
            text = f"the wire from {ends} has the opposite sign"
            yield Variant(
                "lost factor",
                text,
                _rewired(network, {k: opposite}),
                f"{opposite.factor:.6g} from {ends}",
            )


def _missing_wires(network: Network) -> Iterator[Variant]:
    for k, wire in enumerate(plain_wires(network)):
        text = f"the wire from {wire.source} to {wire.target} is lost"
        yield Variant(
            "lost wire", text, _rewired(network, {k: None}), f"from {wire.source} to {wire.target}"
        )


def _crossed_wires(network: Network) -> Iterator[Variant]:
    wires = plain_wires(network)
    for (i, first), (j, second) in combinations(enumerate(wires), 2):
        if (
            first.source == second.source
            or network.wires[i].source.type != network.wires[j].source.type
        ):
            continue
        changed = {i: first._replace(source=second.source), j: second._replace(source=first.source)}
        text = f"{first.target} and {second.target} are crossed: each is driven by the source of the other"
        yield Variant(
            "wires crossed",
            text,
            _rewired(network, changed),
            f"those to {first.target} and {second.target}",
        )
