"""The default experiment of a component, for the FMU to carry: what a host should see."""

import csv
import io
from pathlib import Path
from zipfile import ZipFile

from ..declare.variables import Interface, Variable, class_name
from .python.instance import ModelSlave

Rows = list[list[float | int]]
FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiLayeredStandardManifest
    xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref"
    fmi-ls:fmi-ls-version="0.1.0-alpha.1"
    fmi-ls:fmi-ls-description="Reference results of the default experiment"/>
"""


def entries(interface: Interface, rows: Rows) -> dict[str, bytes]:
    """The files by their path in the FMU: a manifest, and the outputs at every step as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *(v.name for v in outputs(interface))])
    writer.writerows(rows)
    return {
        f"{FOLDER}/fmi-ls-manifest.xml": MANIFEST.encode(),
        f"{FOLDER}/{class_name(interface.model)}_ref.csv": text.getvalue().encode(),
    }


def carried(fmu: Path) -> Rows:
    """The rows that an FMU carries: time and outputs."""
    with ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith("_ref.csv")]
        lines = archive.read(name).decode().splitlines()
    return [[float(number) for number in line.split(",")] for line in lines[1:]]


def outputs(interface: Interface) -> list[Variable]:
    """The variables that the experiment records."""
    return [v for v in interface.variables if v.causality == "output"]


def experiment(slave_class: type[ModelSlave]) -> Rows:
    """Time and outputs at every communication point; Booleans as 0 and 1."""
    interface = slave_class.interface
    stop, step = interface.model.EXPERIMENT
    references = {
        kind: [v.reference for v in outputs(interface) if v.kind == kind]
        for kind in ("Real", "Integer", "Boolean")
    }
    slave = slave_class(instance_name=slave_class.__name__)
    slave.setup_experiment(0.0, stop, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    found = []
    for n in range(round(stop / step) + 1):
        if n:
            slave.do_step((n - 1) * step, step)
        values: dict[int, float | int] = {}
        for kind, vrs in references.items():
            got = getattr(slave, f"get_{kind.lower()}")(vrs) if vrs else []
            values |= {vr: int(x) if kind == "Boolean" else x for vr, x in zip(vrs, got)}
        found.append([n * step, *(values[vr] for vr in sorted(values))])
    return found
