"""Variables of one type of FMI 3.0 in one buffer, with all elements of their arrays."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any

from ..errors import FmuError
from ..system.declarations import WIDTHS
from ..system.description import Variable
from .blocks import CELL, Transfer, VariableBlock
from .messages import OK, WARNING
from .operations import Code
from .session import Session

#: The C types of FMI 3.0 by its own name of the type.
NATIVE: dict[str, Any] = {name: getattr(ctypes, f"c_{name.lower()}") for name in WIDTHS} | {
    "Float32": ctypes.c_float,
    "Float64": ctypes.c_double,
    "Enumeration": ctypes.c_int64,
    "Boolean": ctypes.c_bool,
    "String": ctypes.c_char_p,
}


@dataclass(frozen=True)
class Piece:
    """Variables of one native type, a part of a block's buffer.

    `buffer` is what the call moves: the `cells` of the block themselves, or of Float32 a copy.
    """

    transfer: Transfer
    buffer: Any
    cells: Any
    names: list[str]


def block3(
    session: Session,
    action: str,
    variables: Sequence[Variable],
    orders: Sequence[int] = (),
    *,
    held: bool = False,
) -> VariableBlock:
    """A block for variables of one type of FMI 2.0 with all elements of their arrays.

    Float32 are Reals too. With `orders`, the block has derivatives of outputs, all of the first of these
    orders. If it is `held`, event mode takes it.
    """
    families = {id(v.family): v.family for v in variables}.values()
    members = sorted((v for f in families for v in f), key=lambda v: v.native)
    native = CELL["Real"] if members[0].type == "Real" else NATIVE[members[0].native]
    cells = (native * len(members))()
    groups: Iterable[tuple[str, Iterable[Variable]]] = groupby(members, lambda v: v.native)
    if orders:
        groups = [("OutputDerivatives", members)]
    pieces: list[Piece] = []
    first = 0
    for name, group in groups:
        elements = list(group)
        part = (native * len(elements)).from_buffer(cells, first * ctypes.sizeof(native))
        pieces.append(_piece(session, action, name, elements, part, orders=orders))
        first += len(elements)
    transfer = pieces[-1].transfer
    if len(pieces) > 1 or pieces[0].buffer is not pieces[0].cells:
        run = partial(_move, pieces, reads=action == "Get")
        transfer = Transfer(transfer.name, run, transfer.function, transfer.references, None)
    return VariableBlock(session, members, cells, transfer, reads=action == "Get", held=held)


def _piece(
    session: Session,
    action: str,
    native: str,
    elements: Sequence[Variable],
    cells: Any,
    *,
    orders: Sequence[int],
) -> Piece:
    """The call for elements of one native type, whose values are these cells."""
    n = len(elements)
    buffer = (ctypes.c_float * n)() if native == "Float32" else cells
    values = dict.fromkeys((id(v.family), v.valueReference) for v in elements)
    references = (ctypes.c_uint * len(values))(*(reference for _, reference in values))
    arguments = [references, ctypes.c_size_t(len(references))]
    if orders:
        arguments.append((ctypes.c_int32 * len(references))(*[orders[0]] * len(references)))
    name = f"{action}{'Int64' if native == 'Enumeration' else native}"
    function = session.function(name)
    names = [f"{session.name}.{v.name}" for v in elements]
    run: Callable[[], int] = partial(
        function, session.component, *arguments, buffer, ctypes.c_size_t(n)
    )
    return Piece(Transfer(name, run, function, references, Code.EXCHANGE3), buffer, cells, names)


def _move(pieces: Sequence[Piece], *, reads: bool) -> int:
    """Move all pieces, those of Float32 by way of their own buffer; the worst status."""
    worst = OK
    for piece in pieces:
        if not reads and piece.buffer is not piece.cells:
            piece.buffer[:] = piece.cells[:]
            for name, short, value in zip(piece.names, piece.buffer, piece.cells):
                if math.isinf(short) and math.isfinite(value):
                    raise FmuError(
                        f"{name} cannot take {value!r}: it is a 32-bit floating-point number"
                    )
        status = piece.transfer.run()
        if not OK <= status <= WARNING:
            return status
        worst = max(worst, status)
        if reads and piece.buffer is not piece.cells:
            piece.cells[:] = piece.buffer[:]
    return worst
