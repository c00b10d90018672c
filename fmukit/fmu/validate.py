"""Is an FMU valid? fmpy's checks, and the rules of FMI 2.0 that no public checker covers."""

import math
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fmpy import extract, platform, supported_platforms
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription, ScalarVariable, read_model_description
from fmpy.validation import validate_fmu

from .reference import carried_rows


def problems(fmu: Path) -> list[str]:
    """All that is wrong with an FMU; empty if it is valid."""
    errors: list[str] = validate_fmu(str(fmu))
    if errors:
        return errors
    description = read_model_description(str(fmu))
    name = description.coSimulation.modelIdentifier
    if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
        return [f"modelIdentifier {name} is not a C identifier"]
    return [x for variable in description.modelVariables for x in _variable(variable)]


def differences_from_reference(fmu: Path) -> Iterator[str]:
    """Where the default experiment of an FMU, played, leaves the reference that it carries.

    Raises RuntimeError if a call fails. An FMU without a binary for this platform is not played.
    """
    description = read_model_description(str(fmu))
    if platform not in supported_platforms(str(fmu)):
        return
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    for expected, played in zip(carried_rows(fmu), play(fmu, description, outputs), strict=True):
        for variable, value, wanted in zip(outputs, played[1:], expected[1:]):
            if value != wanted:
                yield (
                    f"{variable.name} = {value!r} at {expected[0]!r} s in the FMU, "
                    f"{wanted!r} by its equations"
                )
                return


def play(
    fmu: Path, description: ModelDescription, outputs: list[ScalarVariable]
) -> Iterator[list[float]]:
    """Time and outputs of the default experiment at every communication point."""
    stop, step = (
        float(getattr(description.defaultExperiment, n)) for n in ("stopTime", "stepSize")
    )
    slave, old = description.coSimulation, description.fmiVersion == "2.0"
    with tempfile.TemporaryDirectory(prefix="played_") as folder:
        extract(str(fmu), folder)
        unit = (FMU2Slave if old else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=slave.modelIdentifier,
            instanceName="played",
        )
        try:
            unit.instantiate()
            if old:
                unit.setupExperiment()
            unit.enterInitializationMode()
            unit.exitInitializationMode()
            for n in range(round(stop / step) + 1):
                if n:
                    unit.doStep((n - 1) * step, step)
                yield [n * step, *(value_of(unit, output) for output in outputs)]
            unit.terminate()
        except FMICallException as error:
            raise RuntimeError(f"the default experiment fails: {error}") from None
        finally:
            unit.freeInstance()


def value_of(unit: FMU2Slave | FMU3Slave, variable: ScalarVariable) -> float:
    """The value of a variable in a running FMU, whatever its type."""
    number = "Integer" if isinstance(unit, FMU2Slave) else "Int64"
    kind = number if variable.type == "Enumeration" else variable.type
    (value,) = getattr(unit, f"get{kind}")([variable.valueReference])
    return float(value)


def _variable(variable: ScalarVariable) -> Iterator[str]:
    if variable.type == "Boolean":
        return
    limits = {
        name: float(text)
        for name in ("min", "max", "start", "nominal")
        if (text := getattr(variable, name)) is not None
    }
    yield from (
        f"{name} of {variable.name} is not finite"
        for name, value in limits.items()
        if not math.isfinite(value)
    )
    if limits.get("nominal") == 0.0:
        yield f"nominal of {variable.name} is 0"
    low, high = limits.get("min", -math.inf), limits.get("max", math.inf)
    if low > high:
        yield f"min {low} of {variable.name} is above max {high}"
    if "start" in limits and not low <= limits["start"] <= high:
        yield f"start {limits['start']} of {variable.name} is outside {low} .. {high}"
