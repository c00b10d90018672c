"""The recorded values of wired parts at a communication point."""

from __future__ import annotations

from collections.abc import Sequence

from ..fmu.buffers import Slot
from ..series import Column, Kind
from ..system import Port
from ..system.description import Variable
from .part import I, WiredPart


class RowReader:
    """Reads the recorded variables, those that are wired from the wires' buffers."""

    def __init__(self, parts: Sequence[WiredPart[I]], ports: Sequence[Port]) -> None:
        slots: dict[str, Slot] = {}
        for block in (block for part in parts for block in part.outputs):
            slots |= block.slots()
        unread: dict[str, dict[str, Variable]] = {part.name: {} for part in parts}
        self.recorded: list[Column] = [port.column for port in ports]
        self.names = [column.name for column in self.recorded]
        for port in ports:
            if port.name not in slots:
                unread[port.part][port.name] = port.variable
        self.extra = [
            b for p in parts for b in p.instance.session.blocks("Get", [*unread[p.name].values()])
        ]
        for block in self.extra:
            slots |= block.slots()
        self.columns = [slots[port.name] for port in ports]
        self._cells = [(slot.cells, slot.element) for slot in self.columns]
        held = [k for k, column in enumerate(self.recorded) if column.kind is not Kind.CONTINUOUS]
        self.discrete = [k + 1 for k in held]
        self.held = {self.names[k]: ports[k].part for k in held}

    def __call__(self, t: float) -> list[float]:
        """The time and the values of the columns; raises FmuError."""
        for block in self.extra:
            block(t)
        return [t, *(cells[i] for cells, i in self._cells)]
