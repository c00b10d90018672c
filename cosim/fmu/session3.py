"""FMI 3.0: an instance and its variables, with types of many widths and arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

from ..system.description import ModelDescription, Value, Variable
from .blocks import VariableBlock, read_blocks
from .blocks3 import block3
from .library import Library
from .messages import MessageLog
from .session import Session


class Session3(Session):
    """An instance of FMI 3.0, and its variables; with `event_mode`, that alone takes what is not continuous."""

    prefix, state_name, deserialize = "fmi3", "FMUState", "deserializeFMUState"
    derivatives, update = "GetContinuousStateDerivatives", "updateDiscreteStates"

    def __init__(
        self,
        name: str,
        description: ModelDescription,
        fmu: Library,
        side: str,
        *,
        event_mode: bool,
        **options: object,
    ) -> None:
        """Instantiate with these options of FMPy more; raises FmuError."""
        messages = MessageLog(name)

        def log(_: object, status: int, __: object, text: bytes | None) -> None:
            messages.on_log(status, text)

        self.event_mode = event_mode
        super().__init__(
            messages, description, fmu, side, loggingOn=True, logMessage=log, **options
        )

    def enter_initialisation(
        self, tolerance: float | None, start: float, stop: float | None
    ) -> None:
        """Hand over the tolerance and the times [s] as far as they are defined; enter initialisation mode."""
        self.call("enterInitializationMode", tolerance, start, stop)

    def blocks(self, action: str, variables: Sequence[Variable]) -> list[VariableBlock]:
        """One block per type, or two where event mode takes some of the inputs."""
        kinds: dict[tuple[str, bool], list[Variable]] = {}
        for v in variables:
            name = "Real" if v.type == "Real" else v.native
            held = self.event_mode and action == "Set" and v.variability != "continuous"
            kinds.setdefault((name, held), []).append(v)
        return [block3(self, action, some, held=held) for (_, held), some in kinds.items()]

    def derivative_block(
        self, action: str, variables: Sequence[Variable], orders: Sequence[int]
    ) -> VariableBlock:
        """A block of derivatives of Real outputs over time, all of the first of these orders."""
        return block3(self, action, variables, orders)

    def set(self, variable: Variable, value: Value) -> None:
        """Set one variable."""
        if variable.type == "Binary":
            self.set_binary(variable, str(value))
        else:
            self.element_block(variable, value).move()

    def set_binary(self, variable: Variable, digits: str) -> None:
        """Set one element of a Binary to what hexadecimal digits say."""
        contents = self._binaries(variable)
        contents[variable.family.index(variable)] = bytes.fromhex(digits)
        self.call("setBinary", [variable.valueReference], contents)

    def element_block(self, variable: Variable, value: Value) -> VariableBlock:
        """A block to set one variable to a value, with the other elements of its array as they are."""
        [block] = self.blocks("Set", [variable])
        if len(block.cells) > 1:
            present = block3(self, "Get", [variable])
            present.move()
            block.cells[:] = present.cells
        block.put(block.variables.index(variable), value)
        return block

    def reader(self, variables: Sequence[Variable]) -> Callable[[], dict[str, Value]]:
        """What reads the values of variables, Binary ones as hexadecimal digits; Clocks have none."""
        plain = [v for v in variables if v.type not in ("Binary", "Clock")]
        blocks = self.blocks("Get", plain)

        def read() -> dict[str, Value]:
            values = read_blocks(blocks, plain, self.name)
            for v in variables:
                if v.type == "Binary":
                    values[v.name] = self._binaries(v)[v.family.index(v)].hex()
            return {v.name: values[v.name] for v in variables if v.name in values}

        return read

    def values(self, variables: Sequence[Variable]) -> dict[str, Value]:
        """The values of variables, Binary ones as hexadecimal digits; Clocks have none."""
        return self.reader(variables)()

    def slopes(self, unknown: Sequence[Variable], by: Variable) -> list[float]:
        """The directional derivatives of variables by one, as the FMU has them."""
        families = list({id(v.family): v.family for v in unknown}.values())
        references = [family[0].valueReference for family in families]
        seed, count = [float(v is by) for v in by.family], sum(map(len, families))
        arguments = references, [by.valueReference], seed, count
        derivatives = self.call("getDirectionalDerivative", *arguments)
        by_element = dict(zip(map(id, chain.from_iterable(families)), derivatives))
        return [by_element[id(v)] for v in unknown]

    def _binaries(self, variable: Variable) -> list[bytes]:
        """All elements of a Binary."""
        elements: list[Any] = self.call(
            "getBinary", [variable.valueReference], len(variable.family)
        )
        return [element or b"" for element in elements]
