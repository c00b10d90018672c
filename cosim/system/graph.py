"""The wires as a graph: the stepping order, and algebraic loops in the declared dependencies."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from heapq import heappop, heappush

from .description import feedthrough
from .network import Connection, Network


def stepping_order(network: Network, order: Sequence[str] | None) -> list[str]:
    """The parts, each after those that drive it where the wires allow it, else as declared."""
    if order is not None:
        return list(order)
    parts = list(network.descriptions)
    index = {name: k for k, name in enumerate(parts)}
    arrows = {(index[wire.source.part], index[wire.target.part]) for wire in network.wires}
    waits = Counter(target for source, target in arrows if source != target)
    targets = defaultdict(list)
    for source, target in arrows:
        targets[source].append(target)
    ready, declared = [k for k in range(len(parts)) if not waits[k]], iter(range(len(parts)))
    sequence: dict[int, str] = {}
    while len(sequence) < len(parts):
        k = heappop(ready) if ready else next(declared)
        if k not in sequence:
            sequence[k] = parts[k]
            for target in targets[k]:
                waits[target] -= 1
                if not waits[target]:
                    heappush(ready, target)
    return list(sequence.values())


def algebraic_loops(network: Network) -> list[list[Connection]]:
    """The wires of each loop of direct feedthrough, in the order of the system.

    Only what a model description declares counts: an FMU that says nothing of its outputs'
    dependencies is taken to have a state in between.
    """
    wires = network.wires
    from_output = defaultdict(list)
    for k, wire in enumerate(wires):
        from_output[wire.source.name].append(k)
    onto: dict[str, list[int]] = defaultdict(list)
    for name, description in network.descriptions.items():
        for output, inputs in feedthrough(description).items():
            for entry in inputs:
                onto[f"{name}.{entry}"] += from_output[f"{name}.{output}"]
    leads = [onto[wire.target.name] for wire in wires]
    arrows = [(k, end) for k, ends in enumerate(leads) for end in ends]
    if not arrows:
        return []
    from scipy.sparse import coo_array  # which takes longer to import than most systems need
    from scipy.sparse.csgraph import connected_components

    graph = coo_array(([1] * len(arrows), tuple(zip(*arrows))), shape=(len(wires), len(wires)))
    rings: dict[int, list[int]] = defaultdict(list)
    for k, ring in enumerate(connected_components(graph, connection="strong")[1].tolist()):
        rings[ring].append(k)
    return [
        [wires[k] for k in ring]
        for ring in rings.values()
        if len(ring) > 1 or ring[0] in leads[ring[0]]
    ]


def describe_loop(loop: Sequence[Connection]) -> str:
    """A loop as text: its inputs and what drives them."""
    return ", ".join(f"{wire.source.name} -> {wire.target.name}" for wire in loop)
