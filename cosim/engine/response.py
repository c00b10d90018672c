"""What parts show right after a jump: at once, or by a step too short to matter that is taken back."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import isfinite
from typing import Any

from ..errors import NonFiniteValueError, StepDiscarded
from .changes import Jump
from .part import Part
from .schedule import Advance
from .settle import settle_wires
from .snapshot import Snapshot

#: The values of columns by name.
Values = dict[str, float]
#: Length of a step that is taken back, over the one at hand. Derived: the values of two such steps, of which one is half
#: as long, are extrapolated to none, so that what remains is of the order of the square of this, 4e-15.
PROBE = 2.0**-24


def values_of_wired_outputs(parts: Sequence[Part]) -> dict[str, Any]:
    """The present values of the wired outputs by name."""
    blocks = [block for part in parts for block in part.outputs]
    return {name: value for block in blocks for name, value in zip(block.names, block.cells)}


def values_after_jump(
    parts: Sequence[Part],
    read: Callable[[], Values],
    t: float,
    jump: Jump,
    before: Mapping[str, Any],
) -> tuple[Values | None, bool]:
    """What `read` gives right after a jump at t [s] whose changes are made, and whether all parts have answered.

    Inputs over time take their value at that time in place of a mean, and wires bring what outputs show to
    inputs until nothing changes any more. The buffers are then as before, so that the next step is the same.
    None stands for values that are not finite, and for a loop through outputs that does not settle.

    Parts need not compute outputs from new inputs before they step. One has not answered if an output with
    direct feedthrough from what has changed has the value of `before`, or, where the FMU does not say what its
    outputs depend on, if all of them have.
    """
    blocks = [block for part in parts for block in (*part.inputs, *part.outputs)]
    feeds = [feed for part in parts for feed in part.feeds]
    cells = [block.cells for block in blocks] + [feed.cell for feed in feeds]
    kept = [list(each) for each in cells]
    entered = {part.name: _input_values(part) for part in parts}
    try:
        for feed in feeds:
            feed.cell[0] = float(feed.profile.at(max(t, jump.time)))
        # other values than Reals are events, which parts see at their next turn
        if settle_wires(parts, len(parts) + 2, takes=lambda block: block.real) is None:
            return None, False
        after = read()
        shown = {**values_of_wired_outputs(parts), **after}
        if not all(isfinite(x) for x in shown.values() if isinstance(x, float)):
            return None, False
        return after, all(
            _has_answered(part, jump, entered[part.name], before, shown) for part in parts
        )
    except NonFiniteValueError:
        return None, False
    finally:
        for each, values in zip(cells, kept):
            each[:] = values


def values_after_probing_steps(
    parts: Sequence[Part],
    advance: Advance,
    read: Callable[[], Values],
    step: tuple[float, float],
    *,
    held: Collection[str],
) -> Values | None:
    """What `read` gives right after a jump, from steps that are taken back; None if a part discards one.

    All parts must be able to restore their state and to vary their step. From the start of the `step`, begin and
    size [s], so many steps of PROBE times its size are taken that values come over all wires, and as many of half
    that. Values other than those of the columns `held` are extrapolated to steps of length zero.
    """
    t, h = step
    snapshot, sizes = Snapshot(parts), (PROBE * h, 0.5 * PROBE * h)
    snapshot.take()
    counts = [(part, part.do_steps, part.instance.forward) for part in parts]
    noted = [
        (p.instance.intermediate_values, len(p.instance.intermediate_values))
        for p in parts
        if p.instance.watched
    ]
    shown: list[Values] = []
    try:
        for part in parts:
            part.instance.go_forward_only(forward=False)
        for size in sizes:
            for k in range(len(parts) + 1):
                advance(t + k * size, size)
            shown.append(read())
            snapshot.restore()
    except (NonFiniteValueError, StepDiscarded):
        snapshot.restore()
        return None
    finally:
        for part, count, forward in counts:
            part.do_steps = count
            part.instance.go_forward_only(forward=forward)
        for observations, count in noted:
            del observations[count:]
    whole, half = shown
    return {n: x if n in held else 2.0 * x - whole[n] for n, x in half.items()}


def _input_values(part: Part) -> dict[str, Any]:
    """The values in the buffers of a part's inputs by name."""
    return {n: x for block in part.inputs for n, x in zip(block.names, block.cells)}


def _has_answered(
    part: Part,
    jump: Jump,
    entered: Mapping[str, Any],
    before: Mapping[str, Any],
    after: Mapping[str, Any],
) -> bool:
    """Whether the outputs of a part follow what has changed of it, as far as it says or shows.

    `entered` are the values of its inputs before.
    """
    now = {name for block in part.inputs if block.real for name in block.names}
    new = {
        name
        for name, value in _input_values(part).items()
        if name in now and value != entered[name]
    }
    changes = [c.variable for c in jump.changes if c.instance is part.instance]
    new |= {f"{part.name}.{v.name}" for v in changes}
    if not new:
        return True
    may_act_on_all = any(v.causality != "input" for v in changes)
    declared, others = list[str](), list[str]()
    for output in part.description.outputs:
        name = f"{part.name}.{output.variable.name}"
        if name not in before:
            continue
        if output.dependencies is None or may_act_on_all:
            others.append(name)
        elif any(f"{part.name}.{v.name}" in new for v in output.dependencies):
            declared.append(name)
    follows = {name: before[name] != after[name] for name in (*declared, *others)}
    return all(follows[n] for n in declared) and (not others or any(follows.values()))
