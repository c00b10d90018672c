"""The FMI variables of a component; their order is both XML index and value reference."""

from __future__ import annotations

from collections import Counter
from enum import IntEnum
from typing import Any, NamedTuple

from ..si import Quantity, per_second
from .model import Model, complete_model
from .record import Declaration, declarations, discrete


class InputHold(IntEnum):
    """What an input does between two communication points."""

    zero = 0
    extrapolate = 1
    interpolate = 2


INPUT_HOLD: Declaration = discrete(
    InputHold.zero,
    "Inputs over a communication step: held at the value set (0), extrapolated through the "
    "last two values (1), interpolated from the previous value to the one just set (2)",
)


class Variable(NamedTuple):
    """One FMI variable: its declaration and its role."""

    name: str
    reference: int
    causality: str
    variability: str
    initial: str
    declaration: Declaration

    @property
    def settable_before_start(self) -> bool:
        """Inputs, parameters and exact outputs may be set until initialisation ends."""
        return self.initial == "exact" or self.causality == "input"

    @property
    def access_type(self) -> str:
        """The FMI type that gets and sets it: an Enumeration is an Integer there."""
        fmi_type = self.declaration.fmi_type
        return "Integer" if fmi_type == "Enumeration" else fmi_type

    @property
    def unit(self) -> str:
        """The unit, or an empty string if there is none."""
        return self.declaration.quantity.unit if self.declaration.quantity else ""


class Interface:
    """All variables of a component and where each kind starts in the list of values."""

    def __init__(self, model: Any) -> None:
        self.model: Model = complete_model(model)
        self.variables: list[Variable] = []
        self.parameters = self._add(model.Parameters, "parameter", "exact")
        self.input_hold = len(self.variables)
        self._append("input_hold", "parameter", "exact", INPUT_HOLD)
        self.inputs = self._add(model.Inputs, "input", "")
        self.states = self._add(model.State, "output", "exact")
        self.outputs = self._add(model.Outputs, "output", "calculated")
        self.continuous = [v for v in self.variables[self.states] if v.variability == "continuous"]
        first = len(self.variables)
        self.derivatives = slice(first, first + len(self.continuous))
        self.by_name = {v.name: v for v in self.variables}
        for name, times in Counter(v.name for v in self.variables).items():
            if times > 1:
                raise ValueError(f"{name} is declared twice: every state is also an output")
        inputs = [v.name for v in self.variables[self.inputs]]
        for variable in self.variables:
            for name in variable.declaration.feedthrough:
                if name not in inputs:
                    raise ValueError(
                        f"{variable.name} declares feedthrough of {name!r}, which is no input: "
                        f"{', '.join(inputs) or 'there is none'}"
                    )

    def _add(self, cls: Any, causality: str, initial: str) -> slice:
        first = len(self.variables)
        for name, declaration in declarations(cls):
            start_kind = "calculated" if declaration.follows else initial
            self._append(name, causality, start_kind, declaration)
        return slice(first, len(self.variables))

    def _append(self, name: str, causality: str, initial: str, declaration: Declaration) -> None:
        if declaration.tunable and causality != "parameter":
            raise TypeError(f"{name} is declared tunable, which only a parameter can be")
        variability = "discrete"
        if causality == "parameter":
            variability = "tunable" if declaration.tunable else "fixed"
        if causality != "parameter" and declaration.fmi_type == "Real" and not declaration.held:
            variability = "continuous"
        self.variables.append(
            Variable(name, len(self.variables), causality, variability, initial, declaration)
        )

    @property
    def rates(self) -> list[Variable]:
        """The derivatives of the continuous states, which a native FMU has after all others."""
        return [
            Variable(
                f"der({state.name})",
                self.derivatives.start + index,
                "local",
                "continuous",
                "calculated",
                Declaration(
                    0.0, f"Derivative of {state.name}", quantity=rate_quantity(state.declaration)
                ),
            )
            for index, state in enumerate(self.continuous)
        ]

    def feedthrough(self, variable: Variable) -> list[Variable]:
        """The inputs that act on an output without delay, in index order."""
        names = variable.declaration.feedthrough
        return [v for v in self.variables[self.inputs] if v.name in names]


def rate_quantity(declaration: Declaration) -> Quantity | None:
    """The quantity of a derivative by time."""
    return per_second(declaration.quantity) if declaration.quantity else None


def co_simulation_only_reason(model: Model) -> str:
    """Why a model can only be stepped, not integrated by others; empty if it can be integrated."""
    declared = [d for _, d in declarations(model.State)]
    discrete = all(d.fmi_type != "Real" or d.held for d in declared)
    if discrete and (model.sample or model.exact):
        return "it has no continuous state and changes only at communication points"
    return model.CO_SIMULATION_ONLY


def title(model: Model) -> str:
    """The first line of a component's docstring."""
    return (model.__doc__ or "").strip().splitlines()[0].rstrip(".")


def component_name(model: Model) -> str:
    """The name of a model: drive_motor for the file drive_motor.py or drive_motor/model.py."""
    parent, name = ("", *model.__name__.split("."))[-2:]
    return parent if name == "model" else name


def class_name(model: Model) -> str:
    """drive_motor -> DriveMotor, DC_motor -> DCMotor, the FMU's name."""
    return "".join(word[:1].upper() + word[1:] for word in component_name(model).split("_"))
