"""Variables that are got or set in one call, and the buffer of their values."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Any

from ..errors import NonFiniteValueError
from ..system.description import Value, Variable
from .buffers import Slot, address
from .messages import OK
from .operations import NOT_FINITE, Code, COperation, Operation
from .session import Session

#: The C types of FMI 2.0 by type of variable.
CELL: dict[str, Any] = {"Real": ctypes.c_double, "String": ctypes.c_char_p}
CELL |= dict.fromkeys(("Integer", "Enumeration", "Boolean"), ctypes.c_int)
#: Types that have no functions of their own in FMI 2.0, and whose they use.
CALL = {"Enumeration": "Integer"}


@dataclass(frozen=True)
class Transfer:
    """The prepared call `run` that moves all values of a buffer, and returns a status.

    Attributes
    ----------
    name
        That of the FMI function, without the version, for messages.
    function, references
        The C function and the value references that it gets.
    code
        The operation of loop.c that does the same; None where that takes Python.
    """

    name: str
    run: Callable[[], int]
    function: Any
    references: Any
    code: Code | None


class VariableBlock(Operation):
    """Variables of one type that are read or written in one call, and the buffer `cells` of their values.

    What is read must be finite where the block is called, not where its values are only moved. Inputs
    that an FMU takes only in event mode, not before a step, are `held`; `entered` are the values that it
    took last.
    """

    def __init__(
        self,
        session: Session,
        variables: Sequence[Variable],
        cells: Any,
        transfer: Transfer,
        *,
        reads: bool,
        held: bool = False,
    ) -> None:
        kind = variables[0].type
        self.session, self.variables, self.cells = session, variables, cells
        self.reads, self.held = reads, held
        self.real = kind == "Real" and not held
        self.names = [f"{session.name}.{v.name}" for v in variables]
        self.entered = type(cells)() if held else None
        self._text = kind == "String"
        self._transfer, self._run = transfer, transfer.run

    def __call__(self, t: float, h: float = 0.0) -> None:
        """Move the values, and check that Reals which are read are finite; raises FmuError."""
        self.move()
        if self.reads and self.real and not all(map(isfinite, self.cells)):
            self.answered(t, h, NOT_FINITE)

    def move(self) -> None:
        """Move the buffer's values; raises FmuError."""
        status = self._run()
        if status != OK:
            self.session.answered(self._transfer.name, status)
        if self._text:  # lasts in the FMU's memory only until its next call
            self.cells[:] = [text or b"" for text in self.cells]

    def slots(self) -> dict[str, Slot]:
        """The slots of its variables by name."""
        return {name: Slot(name, self.cells, i) for i, name in enumerate(self.names)}

    def nominals(self) -> list[float]:
        """The sizes of its variables; 1 where the FMU gives none above 0."""
        return [abs(float(v.nominal or 0.0)) or 1.0 for v in self.variables]

    def put(self, i: int, value: Any) -> None:
        """Put a value into a cell."""
        self.cells[i] = value.encode() if isinstance(value, str) else value

    def has_changed(self) -> bool:
        """Whether a held block has values other than those that event mode took last."""
        return self.entered is not None and list(self.cells) != list(self.entered)

    def remember_entered_inputs(self) -> None:
        """Note that event mode has taken the present values."""
        if self.entered is not None:
            self.entered[:] = list(self.cells)

    def c_operation(self) -> COperation | None:
        """None for texts, for several calls, and for what takes event mode."""
        return None if self.held else self.exchange_c_operation()

    def exchange_c_operation(self) -> COperation | None:
        """What moves the values in C, also in initialisation mode; None for texts and for several calls."""
        transfer = self._transfer
        if self._text or transfer.code is None:
            return None
        return COperation(
            transfer.code,
            len(transfer.references),
            len(self.cells) if self.reads and self.real else 0,
            values=len(self.cells),
            function=ctypes.cast(transfer.function, ctypes.c_void_p).value,
            component=self.session.component.value,
            references=address(transfer.references),
            cells=address(self.cells),
        )

    def answered(self, t: float, h: float, status: int) -> None:
        """Raise an error for a value that is not finite, or leave the status to the session."""
        if status != NOT_FINITE:
            self.session.answered(self._transfer.name, status)
            return
        name, value = next(pair for pair in zip(self.names, self.cells) if not isfinite(pair[1]))
        raise NonFiniteValueError(f"{name} = {value!r} at t = {t!r} s must be a finite number")


def block2(
    session: Session, action: str, variables: Sequence[Variable], orders: Sequence[int] = ()
) -> VariableBlock:
    """A block of FMI 2.0 for variables of one type; `action` is "Get" or "Set".

    With `orders`, one for each variable, these are derivatives of Real outputs or inputs.
    """
    kind, n = variables[0].type, len(variables)
    cells = (CELL[kind] * n)()
    name = f"{action}{CALL.get(kind, kind)}"
    if orders:
        name += "OutputDerivatives" if action == "Get" else "InputDerivatives"
    references = (ctypes.c_uint * n)(*(v.valueReference for v in variables))
    function = session.function(name)
    arguments = [references, ctypes.c_size_t(n)]
    arguments += [(ctypes.c_int * n)(*orders)] if orders else []
    run: Callable[[], int] = partial(function, session.component, *arguments, cells)
    transfer = Transfer(name, run, function, references, Code.EXCHANGE)
    return VariableBlock(session, variables, cells, transfer, reads=action == "Get")


def read_blocks(
    blocks: Sequence[VariableBlock], variables: Sequence[Variable], part: str
) -> dict[str, Value]:
    """The values of variables of a part, read by blocks that have them all."""
    by_name: dict[str, Any] = {}
    for block in blocks:
        block.move()
        by_name |= zip(block.names, block.cells)
    values = [by_name[f"{part}.{v.name}"] for v in variables]
    texts = (x.decode("utf-8", "replace") if isinstance(x, bytes) else x for x in values)
    return dict(zip((v.name for v in variables), texts))
