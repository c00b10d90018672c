"""Variables of one type of FMI 3.0 in one buffer, with all elements of their arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import groupby
from typing import Any

from ..fmu.operations import Code, Layout
from ..system.arrays import WIDTHS
from ..system.description import Variable
from .instance import CELL, OK, WARNING, Instance, VariableBlock

NATIVE: dict[str, Any] = {name: getattr(ctypes, f"c_{name.lower()}") for name in WIDTHS} | {
    "Float32": ctypes.c_float,
    "Float64": ctypes.c_double,
    "Enumeration": ctypes.c_int64,
    "Boolean": ctypes.c_bool,
    "String": ctypes.c_char_p,
}


class VariableBlock3(VariableBlock):
    """Variables of one type of FMI 2.0 with all elements of their arrays; Float32 are Reals too.

    Inputs that an FMU takes only in event mode, not before a step, are `held`; `entered` are the values
    that it took last.
    """

    def __init__(
        self, part: Instance, action: str, variables: Sequence[Variable], orders: Sequence[int] = ()
    ) -> None:
        families = {id(v.family): v.family for v in variables}.values()
        self.part = part
        self.variables = sorted((v for f in families for v in f), key=lambda v: v.native)
        kind = self.variables[0].type
        self.reads, self._text = action == "Get", kind == "String"
        self.held = (
            not self.reads and part.has_event_mode and self.variables[0].variability != "continuous"
        )
        self.real = kind == "Real" and not self.held
        self.names = [f"{part.name}.{v.name}" for v in self.variables]
        native = CELL["Real"] if kind == "Real" else NATIVE[self.variables[0].native]
        self.cells, self.entered = ((native * len(self.names))() for _ in range(2))
        self._pieces: list[tuple[Callable[[], int], Any, Any]] = []
        first = 0
        groups: Iterable[tuple[str, Iterable[Variable]]]
        groups = groupby(self.variables, lambda v: v.native)
        groups = [("OutputDerivatives", self.variables)] if orders else groups
        for name, members in groups:
            group = list(members)
            n = len(group)
            piece = (native * n).from_buffer(self.cells, first * ctypes.sizeof(native))
            buffer = (ctypes.c_float * n)() if name == "Float32" else piece
            references = dict.fromkeys((id(v.family), v.valueReference) for v in group)
            self.references = (ctypes.c_uint * len(references))(*(r for _, r in references))
            arguments = [self.references, ctypes.c_size_t(len(references))]
            if orders:
                arguments.append((ctypes.c_int32 * len(references))(*[orders[0]] * len(references)))
            self.call = f"{action}{'Int64' if name == 'Enumeration' else name}"
            self.function = getattr(part.library, f"fmi3{self.call}")
            call = partial(self.function, part.component, *arguments, buffer, ctypes.c_size_t(n))
            self._pieces.append((call, buffer, piece))
            first += n
        self._plain = len(self._pieces) == 1 and self._pieces[0][1] is self._pieces[0][2]
        self._call = self._pieces[0][0] if self._plain else self._piecewise

    def _piecewise(self) -> int:
        """All pieces, those of Float32 by way of their own buffer; the worst status."""
        worst = OK
        for call, buffer, piece in self._pieces:
            if not self.reads and buffer is not piece:
                buffer[:] = piece[:]
            status = call()
            if not OK <= status <= WARNING:
                return status
            worst = max(worst, status)
            if self.reads and buffer is not piece:
                piece[:] = buffer[:]
        return worst

    def layout(self) -> Layout | None:
        """None for texts, Float32, and what takes event mode."""
        layout = super().layout() if self._plain and not self.held else None
        if layout is not None:
            layout.code, layout.values = Code.EXCHANGE3, len(self.cells)
        return layout
