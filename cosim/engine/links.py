"""The end of a wire at an input: what it brings before a step, and within one."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from itertools import groupby, zip_longest

from ..errors import FmuError
from ..fmu.blocks import VariableBlock
from ..fmu.buffers import Slot, python_slot
from ..fmu.instance import Instance
from ..fmu.operations import Code, COperation, Operation
from ..fmu.session import CO_SIMULATION
from .hermite import Node, SignalHistory, polynomial_mean, polynomial_value
from .sources import InputSource


class Link(Operation):
    """The input in the slot `target` follows factor * source + offset.

    It `adds` to what the links before it have brought to the input. Where it has a `signal`, it moves
    within a step on that of the source: `first` and `last` are then the values of the last step, and
    otherwise the target itself. If source or target is discrete, it `is_held` all the same.
    """

    def __init__(
        self, target: Slot, source: Slot, factor: float = 1.0, offset: float = 0.0
    ) -> None:
        self.target, self.source = target, source
        self.factor, self.offset, self.adds, self.is_held = factor, offset, False, False
        self.signal: SignalHistory | InputSource | None = None
        self.first = self.last = target
        self._cells, self._i = target.cells, target.element
        self._source, self._j = source.cells, source.element

    @property
    def real(self) -> bool:
        """Whether it carries a Real."""
        return self.target.kind is ctypes.c_double

    def __call__(self, t: float, h: float) -> None:
        """Set the input, or add to what other links have brought to it."""
        if self.adds:
            self._cells[self._i] += self.factor * self._source[self._j] + self.offset
        elif self.factor == 1.0 and self.offset == 0.0:
            self._cells[self._i] = self._source[self._j]
        else:
            self._cells[self._i] = self.factor * self._source[self._j] + self.offset

    def c_operation(self) -> COperation | None:
        """How loop.c does it; None for a text, whose memory is Python's, and between types of two widths."""
        kind = self.target.kind
        if kind is ctypes.c_char_p or kind is not self.source.kind:
            return None
        plain = (self.factor, self.offset) == (1.0, 0.0)
        code = Code.ADD if self.adds else Code.COPY if plain else Code.SCALE
        scale = {"factor": self.factor, "offset": self.offset}
        cells, source = self.target.address, self.source.address
        return COperation(code, ctypes.sizeof(kind), cells=cells, source=source, **scale)

    def follow(self, signal: SignalHistory | InputSource) -> None:
        """Move with a signal from now on."""
        self.signal = signal
        self.first, self.last = python_slot(self.target.name), python_slot(self.target.name)

    def taylor(self, t: float, h: float) -> list[float]:
        """What it brings over a step from t by h [s], as a polynomial."""
        assert self.signal is not None
        moving = [float(self.source.value)] if self.is_held else self.signal.taylor(t, h)
        taylor = [self.factor * a for a in moving]
        taylor[0] += self.offset
        return taylor


class CastLink(Link):
    """A link between two types of whole numbers or truth values, which must be able to hold the value."""

    def __call__(self, t: float, h: float) -> None:
        """Set the input; raises FmuError if its type cannot hold the value."""
        super().__call__(t, h)
        if self.target.value != (value := self.source.value):
            raise FmuError(
                f"{self.target.name} cannot take {value!r}, which a wire brings at t = {t!r} s"
            )


class InputPolynomials(Operation):
    """The moving inputs and observed outputs of a part; called, it remembers the outputs.

    `inputs` and `outputs` are the buffers of its Real variables, if any; links lead to each of the
    inputs. An FMU that can interpolate gets an input's value and derivatives at the beginning of the
    step, any other its mean over the step.
    """

    def __init__(
        self,
        instance: Instance,
        degree: int,
        inputs: VariableBlock | None,
        links: Sequence[Link],
        outputs: VariableBlock | None,
    ) -> None:
        ability = instance.session.description.offered_interface(CO_SIMULATION)
        self.degree, self.capable = degree, bool(ability.canInterpolateInputs)
        self.links = sorted(links, key=lambda link: link.target.element)
        by_input = groupby(self.links, lambda link: link.target.element)
        self._by_input = [list(group) for _, group in by_input]
        self.signals = [SignalHistory(degree) for _ in (outputs.cells if outputs else ())]
        self._inputs, self._outputs = inputs, outputs
        self._derivatives: VariableBlock | None = None
        self._rates: VariableBlock | None = None
        if self.capable and inputs:
            orders = range(1, degree + 1)
            variables = [v for v in inputs.variables for _ in orders]
            self._derivatives = instance.session.derivative_block(
                "Set", variables, [*orders] * len(inputs.variables)
            )
        if ability.maxOutputDerivativeOrder and outputs:
            self._rates = instance.session.derivative_block(
                "Get", outputs.variables, [1] * len(outputs.variables)
            )

    def histories_by_output(self) -> dict[str, SignalHistory]:
        """The history of each output by its name."""
        return dict(zip(self._outputs.names if self._outputs else (), self.signals))

    def __call__(self, t: float, h: float) -> None:
        """Remember the present outputs and their rates as nodes at time t [s]."""
        if self._rates is not None:
            self._rates.move()
        self.remember_outputs(t, self._rates)

    def remember_outputs(self, t: float, rates: VariableBlock | None = None) -> None:
        """Take the present outputs as those of time t [s]."""
        for k, signal in enumerate(self.signals):
            assert self._outputs is not None
            signal.add(Node(t, self._outputs.cells[k], rates.cells[k] if rates else None))

    def hand_over(self, t: float, h: float, *, first: bool) -> None:
        """Hand over inputs for a step from t by h [s], the first of its turn or not."""
        for k, (link, *further) in enumerate(self._by_input):
            taylor = link.taylor(t, h)
            for other in further:
                taylor = [a + b for a, b in zip_longest(taylor, other.taylor(t, h), fillvalue=0.0)]
            if self._derivatives is not None:
                begin, link.last.cells[0] = taylor[0], polynomial_value(taylor, h)
                for order in range(1, self.degree + 1):
                    a = taylor[order] if order < len(taylor) else 0.0
                    index = k * self.degree + order - 1
                    self._derivatives.cells[index] = math.factorial(order) * a
            else:
                begin = link.last.cells[0] = polynomial_mean(taylor, h)
            link.target.cells[link.target.element] = begin
            if first:
                link.first.cells[0] = begin
        for block in filter(None, (self._inputs, self._derivatives)):
            block.move()
