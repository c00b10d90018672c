"""Our own view of a model description: immutable, and the same for FMI 2.0 and 3.0.

Attributes carry FMI's names, so that the standard is their documentation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..numbers import real, truth, whole
from .base_units import Unit

Value = float | int | bool | str
#: Capabilities by FMI's names of them.
STATE, VARIABLE_STEP = "canGetAndSetFMUstate", "canHandleVariableCommunicationStepSize"
#: The types whose values are numbers, and what Python calls such a value.
NUMERIC = {"Real": float, "Integer": int, "Enumeration": int, "Boolean": int}
#: What reads the text of a value in XML, by type; it raises ValueError.
READ: dict[str, Callable[[str], Value]] = {
    "Real": real,
    "Integer": whole,
    "Boolean": truth,
    "String": str,
    "Enumeration": str,
}


@dataclass(frozen=True)
class Item:
    """An item of an enumeration."""

    name: str
    value: int


@dataclass(frozen=True)
class SimpleType:
    """A type that variables declare."""

    name: str
    unit: str | None = None
    min: str | None = None
    max: str | None = None
    nominal: str | None = None
    items: tuple[Item, ...] = ()


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Variable:
    """A scalar variable, or an element of an array of FMI 3.0.

    Attributes
    ----------
    type
        Real, Integer, Enumeration, Boolean, String, Binary or Clock.
    native
        The type in the words of the FMU's own version, such as Float64 or UInt8.
    shape
        The dimensions of the array; empty for a scalar.
    family
        The elements that are got and set together, in FMI's sequence; the variable alone if it is no array.
    derivative
        The variable that this is the derivative of.
    relativeQuantity
        Whether it is a difference, for which the offset of its unit is ignored.
    interval, shift
        Of a clock [s].
    """

    name: str
    valueReference: int
    type: str
    native: str
    causality: str
    variability: str
    initial: str | None = None
    description: str | None = None
    start: str | None = None
    unit: str | None = None
    min: str | None = None
    max: str | None = None
    nominal: str | None = None
    declaredType: SimpleType | None = None
    derivative: Variable | None = None
    relativeQuantity: bool = False
    shape: tuple[int, ...] = ()
    family: Sequence[Variable] = ()
    intermediateUpdate: bool = False
    intervalVariability: str | None = None
    interval: float | None = None
    shift: float = 0.0

    def __init__(self, **facts: object) -> None:
        """All at once: a frozen dataclass sets one after the other, which takes three times as long."""
        vars(self).update(facts)

    def __repr__(self) -> str:
        return f"Variable({self.name!r}, {self.native})"


@dataclass(frozen=True)
class Unknown:
    """A variable that others determine; `dependencies` is None where the FMU does not say which."""

    variable: Variable
    dependencies: tuple[Variable, ...] | None
    dependenciesKind: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Interface:
    """What an FMU can do by one of its interfaces, co-simulation or model exchange."""

    modelIdentifier: str
    needsExecutionTool: bool = False
    canBeInstantiatedOnlyOncePerProcess: bool = False
    canGetAndSetFMUstate: bool = False
    canSerializeFMUstate: bool = False
    providesDirectionalDerivative: bool = False
    canHandleVariableCommunicationStepSize: bool = False
    canInterpolateInputs: bool = False
    canRunAsynchronuously: bool = False
    maxOutputDerivativeOrder: int = 0
    providesIntermediateUpdate: bool = False
    mightReturnEarlyFromDoStep: bool = False
    hasEventMode: bool = False
    needsCompletedIntegratorStep: bool = False


@dataclass(frozen=True)
class DefaultExperiment:
    """The default experiment of an FMU: times [s] and relative tolerance, None for what it does not state.

    A step or a tolerance that is not above 0, which no run can have, counts as not stated.
    """

    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None


@dataclass(frozen=True, eq=False)
class ModelDescription:
    """What an FMU says of itself."""

    fmiVersion: str
    modelName: str
    guid: str
    description: str | None
    generationTool: str | None
    coSimulation: Interface | None
    modelExchange: Interface | None
    defaultExperiment: DefaultExperiment
    unitDefinitions: tuple[Unit, ...]
    modelVariables: tuple[Variable, ...]
    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initialUnknowns: tuple[Unknown, ...]
    eventIndicators: tuple[Unknown, ...]
    numberOfEventIndicators: int

    def offered_interface(self, name: str = "") -> Interface:
        """The interface of this name, "coSimulation" or "modelExchange"; by default the first that is offered.

        Raises
        ------
        LookupError
            If the FMU does not offer it.
        """
        offered = {"coSimulation": self.coSimulation, "modelExchange": self.modelExchange}
        for key, interface in offered.items():
            if interface is not None and name in ("", key):
                return interface
        raise LookupError(f"{self.modelName} offers no {name or 'interface'}")


@dataclass(frozen=True)
class Fmu:
    """The model description of a file, its variables and its units by name.

    Attributes
    ----------
    flaws
        What is wrong in the description but does not affect a run, a sentence each.
    wrong_starts
        By variable, what is wrong with a start value of the file.
    terminals
        The variables of each terminal by member.
    shapes
        The dimensions of arrays, of which the elements are variables.
    obstacle
        Why the FMU cannot run here, but only be described.
    """

    path: Path
    description: ModelDescription
    variables: Mapping[str, Variable]
    units: Mapping[str, Unit]
    flaws: tuple[str, ...] = ()
    wrong_starts: Mapping[str, str] = field(default_factory=dict)
    terminals: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    shapes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    obstacle: str = ""


def declared_start(variable: Variable) -> Value | None:
    """The start value that the model description gives a variable, if any."""
    if variable.start is None:
        return None
    kind = "Integer" if variable.type == "Enumeration" else variable.type
    return READ.get(kind, str)(variable.start)


def enumeration(variable: Variable) -> dict[str, int]:
    """The names of an enumeration and what they stand for."""
    if variable.type != "Enumeration" or variable.declaredType is None:
        return {}
    return {item.name: item.value for item in variable.declaredType.items}


def feedthrough(description: ModelDescription) -> dict[str, frozenset[str]]:
    """By output, the inputs with direct feedthrough to it; only what the model description declares."""
    return {
        unknown.variable.name: frozenset(
            v.name for v in unknown.dependencies or () if v.causality == "input"
        )
        for unknown in description.outputs
    }


def parts_without(descriptions: Mapping[str, ModelDescription], ability: str) -> list[str]:
    """The parts whose FMUs do not have a capability, by FMI's name of it."""
    return [
        name
        for name, d in descriptions.items()
        if not getattr(d.offered_interface("coSimulation"), ability)
    ]


def is_positive(value: float | None) -> bool:
    """Whether it is a number above 0."""
    return value is not None and 0.0 < value < math.inf
