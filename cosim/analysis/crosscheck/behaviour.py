"""Checks of a run and of instances: that they repeat, bit for bit, whatever was done before or is done beside them."""

from __future__ import annotations

import math
from contextlib import suppress

from fmpy.validation import validate_fmu

from ...errors import FmuError
from ...system import Value, declared_start
from ...system.description import Variable
from .subject import CheckFailed, NotOffered, Row, Subject, differ, nudged
from .tolerances import ROUNDING

#: Problems of a model description that a verdict names. Chosen: the first few.
MOST_PROBLEMS = 3


def description(s: Subject) -> str:
    """The XML schema, and what FMPy looks for beyond it."""
    if problems := validate_fmu(str(s.path)):
        raise CheckFailed(
            "; ".join(" ".join(problem.split()) for problem in problems[:MOST_PROBLEMS])
        )
    return f"{len(s.description.modelVariables)} variables; FMPy reports no problem"


def binary(s: Subject) -> str:
    """What the binary says of itself."""
    with s.instance() as part:
        stated = part.session.binding.getVersion()
        platform = "default" if s.is_fmi3 else part.session.binding.getTypesPlatform()
    version = s.description.fmiVersion
    if (platform, stated.partition("-")[0]) != ("default", version):
        differences = f"types platform {platform!r} and version {stated!r}"
        raise CheckFailed(f"{differences}, not 'default' and {version!r}")
    return f"version {stated}" if s.is_fmi3 else f"version {stated}, types platform {platform}"


def runs(s: Subject) -> str:
    """All outputs are finite numbers."""
    for k, row in enumerate(s.reference, 1):
        for v, value in zip(s.observed, row):
            if v.causality == "output" and isinstance(value, float) and not math.isfinite(value):
                raise CheckFailed(f"{v.name} after step {k} is {value!r}")
    excitation = "" if s.is_excited or not s.inputs else "; its inputs had to be kept constant"
    return f"{s.steps} steps of {s.h:g} s{excitation}"


def starts(s: Subject) -> str:
    """Exact outputs while initialising, and parameters after it; an FMU may round them."""
    exact = [
        v for v in s.description.modelVariables if v.initial == "exact" and v.start is not None
    ]
    outputs = [v for v in exact if v.causality == "output"]
    parameters = [v for v in exact if v.causality == "parameter"]
    with s.instance() as part:
        s.enter(part)
        values = part.session.values(outputs)
        part.leave_initialisation()
        values |= part.session.values(parameters)
    for v in [*outputs, *parameters]:
        value, start = values[v.name], declared_start(v)
        match value, start:
            case float(), float() if math.isclose(value, start, rel_tol=ROUNDING):
                continue
        if value != start:
            raise CheckFailed(f"{v.name} is {value!r}, not {start!r}")
    return f"{len(values)} start values"


def terminates(s: Subject) -> str:
    """The last values remain after termination."""
    with s.running(s.steps - 1) as part:
        last = s.go(part, s.steps - 1, s.steps)
        part.session.terminate()
        s.same([s.row(part)], last, "after it is terminated", s.steps - 1)
    return "the last values stay"


def repeats(s: Subject) -> str:
    """A second instance gives the rows of the first."""
    for k, (row, reference) in enumerate(zip(s.second_rows, s.reference), 1):
        for v, value, expected in zip(s.observed, row, reference):
            if differ(value, expected):
                raise CheckFailed(
                    f"{v.name} after step {k} is {value!r} in a new instance, not {expected!r}; "
                    f"the other checks leave out {', '.join(sorted(s.unsteady))}"
                )
    return f"{s.steps} rows of {len(s.observed)} variables, bit for bit"


def getting(s: Subject) -> str:
    """Getting values again, in the opposite order or one at a time, does not change them."""
    with s.running() as part:
        rows: list[Row] = []
        for k in range(s.steps):
            rows += s.go(part, k, k + 1)
            s.same([s.row(part)], rows[-1:], "when it is got again", k)
            if k in (0, s.steps // 2, s.steps - 1):
                back = tuple(part.session.values(s.observed[::-1]).values())[::-1]
                s.same([back], rows[-1:], "when the values are got in the opposite order", k)
                single = tuple(part.session.values([v])[v.name] for v in s.observed)
                s.same([single], rows[-1:], "when it is got alone", k)
    s.same(rows, s.reference, "where values are got twice")
    return f"{s.steps} rows got twice, three of them in the opposite order and one value at a time"


def resets(s: Subject) -> str:
    """A reset after a run with other parameters, if it runs with them."""
    parameters = [v for v in s.description.modelVariables if v.causality == "parameter"]
    values = {v: nudged(v) for v in parameters if v.type == "Real" and v.variability != "constant"}
    for changed in ({v: x for v, x in values.items() if x is not None}, {}):

        def work(changed: dict[Variable, Value] = changed) -> list[Row] | None:
            with s.instance() as part:
                try:
                    for v, value in changed.items():
                        part.set(v, value)
                    s.initialise(part)
                    s.go(part, 0, s.steps // 2)
                except FmuError:
                    return None
                part.session.reset()
                s.initialise(part)
                return s.go(part, 0, s.steps)

        if (rows := s.in_process(work)) is not None:
            s.same(rows, s.reference, "after a reset")
            return f"{s.steps} rows after a run with {len(changed)} other parameters, bit for bit"
    raise CheckFailed("it does not run a second time")


def instances(s: Subject) -> str:
    """An instance stepped in turn with another one whose inputs are ahead."""
    if s.can.canBeInstantiatedOnlyOncePerProcess:
        raise NotOffered("canBeInstantiatedOnlyOncePerProcess is true")
    with s.running() as part, s.running(s.steps // 3) as second:
        rows: list[Row] = []
        for k in range(s.steps):
            rows += s.go(part, k, k + 1)
            with suppress(FmuError):
                s.go(second, k + s.steps // 3, k + s.steps // 3 + 1)
    s.same(rows, s.reference, "beside another instance")
    return f"{s.steps} rows beside another instance, bit for bit"
