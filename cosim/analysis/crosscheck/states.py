"""Checks of states: saved, restored, and carried to another instance as bytes."""

from __future__ import annotations

from contextlib import nullcontext

from .subject import Subject


def states(s: Subject) -> str:
    """Two states that are kept at the same time, and each restored."""
    s.needs("canGetAndSetFMUstate")
    third = s.steps // 3
    with s.running(third) as part:
        first, second = part.session.new_state(), part.session.new_state()
        part.save(first)
        s.same(s.go(part, third, 2 * third), s.reference[third:], "after a state is saved", third)
        part.save(second)
        s.go(part, 2 * third, s.steps)
        for state, row in ((first, third), (second, 2 * third), (first, third)):
            part.restore(state)
            s.same([s.row(part)], [s.reference[row - 1]], "when the state is set", row - 1)
            rows = s.go(part, row, s.steps)
            s.same(rows, s.reference[row:], "after the state is set", row)
    return f"{s.steps - third} rows from two states, bit for bit"


def serialized(s: Subject) -> str:
    """A state carried as bytes from one instance to another."""
    s.needs("canSerializeFMUstate")
    half = s.steps // 2
    with s.running(half) as part, nullcontext(part) if s.once else s.running() as receiver:
        state = part.session.new_state()
        part.save(state)
        serialized_state = part.session.serialized(state)
        receiver.restore(receiver.session.deserialized(serialized_state))
        rows = s.go(receiver, half, s.steps)
    s.same(rows, s.reference[half:], "after the state was carried over as bytes", half)
    return f"{s.steps - half} rows from {len(serialized_state.content)} bytes, bit for bit"
