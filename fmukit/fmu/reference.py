"""The default experiment of a component, for the FMU to carry: what a host should see."""

import csv
import io
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from zipfile import ZipFile

from ..declare.interface import Interface, Variable, class_name, complete_model
from ..runtime import equations
from .python import instance

Rows = list[list[float | int]]

#: A convention of the layered standard FMI-LS-REF, which fixes its name.
NAME = "org.fmi-standard.fmi-ls-ref"

#: A convention of FMI-LS-REF 1.0.0-beta.1 (July 2026): its text still asks for the version of its draft.
VERSION = "1.0.0-alpha.1"

#: A convention of FMI-LS-REF, which fixes its description.
DESCRIPTION = "Layered Standard providing information on related files included in an FMU."
FOLDER = f"extra/{NAME}"
MANIFEST = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiReferences
    xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="{name}"
    fmi-ls:fmi-ls-version="{version}"
    fmi-ls:fmi-ls-description="{description}">
  <Related type="text/csv" source="{file}" role="result"
      description="Outputs of the default experiment at every communication point"/>
</fmiReferences>
"""


def entries(interface: Interface, rows: Rows) -> dict[str, bytes]:
    """The files by their path in the FMU: a manifest, and the outputs at every step as CSV."""
    file = f"{class_name(interface.model)}_ref.csv"
    manifest = MANIFEST.format(name=NAME, version=VERSION, description=DESCRIPTION, file=file)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *(v.name for v in outputs(interface))])
    writer.writerows(rows)
    return {
        f"{FOLDER}/fmi-ls-manifest.xml": manifest.encode(),
        f"{FOLDER}/{file}": text.getvalue().encode(),
    }


def carried_rows(fmu: Path) -> Rows:
    """The rows that an FMU carries: time and outputs."""
    with ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith("_ref.csv")]
        lines = archive.read(name).decode().splitlines()
    return [[float(number) for number in line.split(",")] for line in lines[1:]]


def outputs(interface: Interface) -> list[Variable]:
    """The variables that the experiment records."""
    return [v for v in interface.variables if v.causality == "output"]


def table(interface: Interface) -> dict[str, Any]:
    """What a slave in Python knows of the variables of a model."""
    rows = []
    for v in interface.variables:
        unit = "" if v.unit in ("", "1") else f" {v.unit}"
        start = v.declaration.start if v.kind != "Integer" else int(v.declaration.start)
        settable, calculated = v.settable_before_start, v.initial == "calculated"
        fields = (
            v.name,
            unit,
            v.declaration.kind,
            v.causality,
            v.variability,
            settable,
            calculated,
            start,
        )
        rows.append(instance.Variable(*fields))
    ranges = ("inputs", "states", "outputs", "input_hold")
    return {"variables": tuple(rows)} | {name: getattr(interface, name) for name in ranges}


def by_equations(model: ModuleType, guid: str = "") -> type[instance.Slave]:
    """The slave that calls the functions of a model as they stand."""
    complete_model(model)
    interface = Interface(model)
    body = table(interface) | {"guid": guid, "functions": equations.functions(interface)}
    return type(class_name(model), (instance.Slave,), body)


@cache
def experiment(model: ModuleType) -> Rows:
    """Time and outputs at every communication point; Booleans as 0 and 1."""
    stop, step = model.EXPERIMENT
    slave = by_equations(model)(instance_name=class_name(model))
    references = {
        kind: [v.reference for v in outputs(Interface(model)) if v.kind == kind]
        for kind in ("Real", "Integer", "Boolean")
    }
    slave.setup_experiment(0.0, stop, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    rows = []
    for n in range(round(stop / step) + 1):
        if n:
            slave.do_step((n - 1) * step, step)
        values: dict[int, float | int] = {}
        for kind, vrs in references.items():
            values_of_kind = getattr(slave, f"get_{kind.lower()}")(vrs) if vrs else []
            values |= {vr: int(x) if kind == "Boolean" else x for vr, x in zip(vrs, values_of_kind)}
        rows.append([n * step, *(values[vr] for vr in sorted(values))])
    return rows
