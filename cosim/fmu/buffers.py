"""Places for values: a slot is one element of a buffer, found by the name of its variable."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple


class Slot(NamedTuple):
    """Element `element` of a buffer, which is a ctypes array, or a list where only Python uses it.

    `name` is that of the variable whose value stands there, "part.variable".
    """

    name: str
    cells: Any
    element: int

    @property
    def value(self) -> Any:
        """What stands there."""
        return self.cells[self.element]

    @property
    def kind(self) -> Any:
        """The ctypes type of the buffer's elements."""
        return self.cells._type_

    @property
    def address(self) -> int:
        """Where it stands in memory."""
        return address(self.cells, self.element)


def address(cells: Any, index: int = 0) -> int:
    """Where an element of a ctypes array stands in memory."""
    return ctypes.addressof(cells) + index * ctypes.sizeof(cells._type_)


def python_slot(name: str) -> Slot:
    """A slot for a number that only Python uses."""
    return Slot(name, [0.0], 0)
