"""Which inputs act on themselves at once: algebraic loops in the declared dependencies."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .system import Network, Wire, feedthrough


def algebraic_loops(network: Network) -> list[list[Wire]]:
    """The wires of each loop of direct feedthrough, in the order of the system.

    Only what a model description declares counts: an FMU that says nothing of its outputs'
    dependencies is taken to have a state in between.
    """
    wires = network.wires
    matrix = np.array(
        [[acts(network, first, then) for then in wires] for first in wires], dtype=int
    )
    if not matrix.any():
        return []
    _, label = connected_components(csr_array(matrix), connection="strong")
    groups = [[i for i in range(len(wires)) if label[i] == k] for k in sorted(set(label))]
    return [
        [wires[i] for i in group]
        for group in groups
        if len(group) > 1 or matrix[group[0], group[0]]
    ]


def acts(network: Network, first: Wire, then: Wire) -> bool:
    """Whether the input of one wire moves the source of another without delay."""
    if first.target.part != then.source.part:
        return False
    acting = feedthrough(network.descriptions[then.source.part])
    return first.target.variable.name in acting.get(then.source.variable.name, ())


def describe(loop: list[Wire]) -> str:
    """A loop as text: its inputs and what drives them."""
    return ", ".join(f"{wire.source.name} -> {wire.target.name}" for wire in loop)
