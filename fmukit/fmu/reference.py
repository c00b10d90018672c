"""The default experiment of a component, for the FMU to carry: what a host should see, and how exactly.

The outputs at every communication point are those of the equations of the component, integrated by the kit. Their
errors come from the same experiment with communication steps that are two, three and four times shorter, by the
functions printed for the FMU, which give the same numbers in a quarter of the time. Where the
integrator takes one sub-step per communication step, its error of order 5 becomes 32 to 1024 times smaller, and the
differences are the error. Where its tolerance decides, or where a slope jumps within a sub-step, the errors of all runs
are alike and random, so that the largest of three differences counts SAFETY times.
"""

import csv
import io
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from ..codegen import entries as codegen
from ..declare.interface import Interface, Variable, class_name
from ..runtime import equations
from .python import instance

Rows = list[list[float | int]]

#: A convention of the layered standard FMI-LS-REF, which fixes its name.
NAME = "org.fmi-standard.fmi-ls-ref"

#: A convention of FMI-LS-REF 1.0.0-beta.1 (July 2026): its text still asks for the version of its draft.
LAYERED_VERSION = "1.0.0-alpha.1"

#: A convention of FMI-LS-REF, which fixes its description.
DESCRIPTION = "Layered Standard providing information on related files included in an FMU."
RESULTS_FOLDER = f"extra/{NAME}"
#: Name of the file of results after that of the component: a convention of this kit.
RESULT = "_ref.csv"
#: Name of the file of their errors, which has the same heading and times: a convention of this kit.
ERRORS = "_ref_error.csv"
#: Communication steps in place of one in the runs that show the error: chosen as the first ones. One alone may by
#: chance be as wrong as the experiment where a slope jumps (gearbox at 0.75 s: 5e-11 to 1e-8 rad/s).
REFINEMENTS = (2, 3, 4)
#: Factor on a difference between two step sizes whose order of convergence is unknown: a convention of Roache
#: (J. Fluids Eng. 116, 1994).
SAFETY = 3.0
#: Rounding of a column per communication step, as a share of its largest value: derived as one unit of double
#: precision, since each step rounds the state it adds to.
ROUNDING = sys.float_info.epsilon
#: Share of the run before and after a row within which its error is the largest one: chosen, since the difference
#: of two runs crosses zero where the error does not.
ENVELOPE = 0.01
#: Factor with which rounding to two digits never makes a number smaller: derived from their spacing, 1.0 to 1.1.
UPWARDS = 1.05
MANIFEST = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiReferences
    xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="{name}"
    fmi-ls:fmi-ls-version="{version}"
    fmi-ls:fmi-ls-description="{description}">
  <Related type="text/csv" source="{file}" role="result"
      description="Outputs of the default experiment at every communication point"/>
  <Related type="text/csv" source="{errors}" role="report"
      description="Largest error of each of these results"/>
</fmiReferences>
"""


def files_of_reference(interface: Interface) -> dict[str, bytes]:
    """The files by their path in the FMU: a manifest, and as CSV the outputs at every step and their errors."""
    model = interface.model
    result, errors = (f"{class_name(model)}{end}" for end in (RESULT, ERRORS))
    manifest = MANIFEST.format(
        name=NAME, version=LAYERED_VERSION, description=DESCRIPTION, file=result, errors=errors
    )
    return {
        f"{RESULTS_FOLDER}/fmi-ls-manifest.xml": manifest.encode(),
        f"{RESULTS_FOLDER}/{result}": _csv(interface, default_experiment(model)),
        f"{RESULTS_FOLDER}/{errors}": _csv(interface, default_experiment_errors(model)),
    }


def _csv(interface: Interface, rows: Rows) -> bytes:
    """The rows below a heading with the names of their columns."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *(v.name for v in outputs(interface))])
    writer.writerows(rows)
    return text.getvalue().encode()


def carried_rows(fmu: Path) -> Rows:
    """The rows that an FMU carries: time and outputs."""
    with ZipFile(fmu) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(RESULT)]
        lines = archive.read(name).decode().splitlines()
    return [[float(number) for number in line.split(",")] for line in lines[1:]]


def outputs(interface: Interface) -> list[Variable]:
    """The variables that the experiment records."""
    return [v for v in interface.variables if v.causality == "output"]


def slave_table(interface: Interface) -> dict[str, Any]:
    """What a slave in Python knows of the variables of a model."""
    rows = []
    for v in interface.variables:
        unit = "" if v.unit in ("", "1") else f" {v.unit}"
        start = v.declaration.start if v.access_type != "Integer" else int(v.declaration.start)
        settable, calculated = v.settable_before_start, v.initial == "calculated"
        fields = (
            v.name,
            unit,
            v.declaration.fmi_type,
            v.causality,
            v.variability,
            settable,
            calculated,
            start,
        )
        rows.append(instance.Variable(*fields))
    ranges = ("inputs", "states", "outputs", "input_hold")
    return {"variables": tuple(rows)} | {name: getattr(interface, name) for name in ranges}


def by_equations(model: ModuleType) -> type[instance.Slave]:
    """The slave that calls the functions of a model as they stand."""
    interface = Interface(model)
    return _slave(interface, equations.functions(interface))


def by_printed(model: ModuleType) -> type[instance.Slave]:
    """The slave that calls the functions printed for the FMU of a model, which must be one that can be traced."""
    printed = ModuleType(class_name(model))
    code = compile(codegen.generate(model).python, printed.__name__, "exec")
    exec(code, vars(printed))  # noqa: S102 (it is what the Python FMU imports)
    return _slave(Interface(model), printed)


def _slave(interface: Interface, functions: Any) -> type[instance.Slave]:
    body = slave_table(interface) | {"guid": "", "functions": functions}
    return type(class_name(interface.model), (instance.Slave,), body)


@cache
def default_experiment(model: ModuleType, steps_per_row: int = 1) -> Rows:
    """Time and outputs at every communication point; Booleans as 0 and 1.

    Parameters
    ----------
    model : module
        The component.
    steps_per_row : int
        How many steps are taken from one communication point to the next. Rows with one step are those of the
        equations as they stand.
    """
    stop, step = model.EXPERIMENT
    as_they_stand = steps_per_row == 1 or model.PYTHON_ONLY
    slave = (by_equations if as_they_stand else by_printed)(model)(instance_name=class_name(model))
    recorded = outputs(Interface(model))
    slave.setup_experiment(0.0, stop, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    rows = []
    size = step / steps_per_row
    for n in range(round(stop / step) + 1):
        for k in range(steps_per_row if n else 0):
            slave.do_step((n - 1) * step + k * size, size)
        values = [
            getattr(slave, f"get_{v.access_type.lower()}")([v.reference])[0] for v in recorded
        ]
        rows.append([n * step, *(int(x) if isinstance(x, bool) else x for x in values)])
    return rows


@cache
def default_experiment_errors(model: ModuleType) -> Rows:
    """Time and, for each output at every communication point, how far it may be from the exact solution.

    error = SAFETY * max |x(h) - x(h / k)| nearby + rounding, over the REFINEMENTS k, for Real outputs. Other outputs
    are right or wrong, so that their error is the largest difference itself.
    """
    rows = np.array(default_experiment(model), float)
    finer = np.array([default_experiment(model, k) for k in REFINEMENTS], float)
    errors = np.abs(finer - rows).max(0)
    errors[:, 0] = rows[:, 0]
    table: Rows = errors.tolist()
    for k, v in enumerate(outputs(Interface(model)), 1):
        column: list[float] = errors[:, k].astype(int).tolist()
        if v.access_type == "Real":
            column = _real_errors(rows[:, k], errors[:, k])
        for row, error in zip(table, column):
            row[k] = error
    return table


def _real_errors(column: NDArray[np.float64], differences: NDArray[np.float64]) -> list[float]:
    """The errors of a Real output, rounded up to two digits."""
    rounding = ROUNDING * len(column) * np.abs(column).max()
    width = max(1, round(ENVELOPE * len(column)))
    around = np.pad(differences, width, mode="edge")
    nearby = np.lib.stride_tricks.sliding_window_view(around, 2 * width + 1).max(axis=1)
    return [float(f"{x:.1e}") for x in UPWARDS * (SAFETY * nearby + rounding)]
