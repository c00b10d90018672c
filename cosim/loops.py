"""Which inputs act on themselves at once: algebraic loops in the declared dependencies."""

from __future__ import annotations

import numpy as np

from .system import Network, Wire, feedthrough


def algebraic_loops(network: Network) -> list[list[Wire]]:
    """The wires of each loop of direct feedthrough, in the order of the system.

    Only what a model description declares counts: an FMU that says nothing of its outputs'
    dependencies is taken to have a state in between.
    """
    wires = network.wires
    leads = np.array([[acts(network, first, then) for then in wires] for first in wires], bool)
    for k in range(len(wires)):
        leads |= np.outer(leads[:, k], leads[k])
    both = leads & leads.T
    return [
        [wires[j] for j in np.flatnonzero(ring)]
        for i, ring in enumerate(both)
        if ring[i] and not ring[:i].any()
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
