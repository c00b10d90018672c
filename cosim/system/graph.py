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
    rings = strongly_connected([onto[wire.target.name] for wire in wires])
    return [
        [wires[k] for k in sorted(ring)]
        for ring in sorted(rings, key=min)
        if len(ring) > 1 or ring[0] in onto[wires[ring[0]].target.name]
    ]


def strongly_connected(leads: Sequence[Sequence[int]]) -> list[list[int]]:
    """The sets of nodes that lead to each other, where node k leads to the nodes leads[k].

    Kosaraju's algorithm: two searches, the second against the arrows, in the order in which the
    first one left the nodes.
    """
    left: list[int] = []
    seen: set[int] = set()
    for root in range(len(leads)):
        path = [] if root in seen else [(root, iter(leads[root]))]
        seen.add(root)
        while path:
            node, ahead = path[-1]
            fresh = next((k for k in ahead if k not in seen), None)
            if fresh is None:
                left.append(node)
                path.pop()
            else:
                seen.add(fresh)
                path.append((fresh, iter(leads[fresh])))
    back = defaultdict(list)
    for node, ends in enumerate(leads):
        for end in ends:
            back[end].append(node)
    rings = []
    while left:
        nodes, ring = [left.pop()], []
        while nodes:
            node = nodes.pop()
            if node in seen:
                seen.remove(node)
                ring.append(node)
                nodes += back[node]
        rings += [ring] if ring else []
    return rings


def describe_loop(loop: Sequence[Connection]) -> str:
    """A loop as text: its inputs and what drives them."""
    return ", ".join(f"{wire.source.name} -> {wire.target.name}" for wire in loop)
