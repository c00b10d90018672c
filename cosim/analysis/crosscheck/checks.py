"""What an FMU for co-simulation promises and whether it keeps it, one check for each promise.

Every check runs instances of the FMU by calls that the standard allows, and compares their values.
Clauses are those of FMI 2.0.4 and 3.0.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ...errors import FmuError
from .behaviour import (
    binary,
    description,
    getting,
    instances,
    repeats,
    resets,
    runs,
    starts,
    terminates,
)
from .dependencies import outputs, unknowns
from .derivatives import derivatives
from .memory import memory
from .order import order
from .states import serialized, states
from .stepping import discards, start_time, step_sizes, stop_time
from .subject import CheckFailed, NotOffered, Subject

PASSED = "passed"
FAILED = "failed"
NOT_OFFERED = "not offered"
NOT_RUN = "not run"
#: names of the standards, by the version of a model description
STANDARD = {"2.0": "FMI 2.0.4", "3.0": "FMI 3.0.2"}


class CheckResult(NamedTuple):
    """A check, the clause it is based on, how it ended, what was found, and how to repeat it by hand."""

    check: str
    clause: str
    status: str
    detail: str
    instructions: str


class Check(NamedTuple):
    """A check, its clauses of FMI 2.0 and 3.0, its function, and how to repeat it by hand."""

    name: str
    clause2: str
    clause3: str
    function: Callable[[Subject], str]
    instructions: str

    def verdict(self, version: str, status: str, detail: str) -> CheckResult:
        """How the check of an FMU of a version ended."""
        clause = self.clause3 if version == "3.0" else self.clause2
        return CheckResult(self.name, clause, status, detail, self.instructions)


CHECKS = {check.name: check for check in (
    Check("description", "2.2", "2.4", description, "validate the FMU with FMPy"),
    Check("binary", "2.1.4", "2.2.5", binary,
          "ask the binary for its version and, in FMI 2.0, for its types platform"),
    Check("run", "4.2.2", "4.2.1", runs, "initialise; doStep and get the outputs"),
    Check("termination", "2.1.6", "2.3.8", terminates, "run, terminate, get the values again"),
    Check("start values", "2.2.7", "2.4.7.4", starts,
          "enter initialization mode, set nothing; get exact outputs, and parameters after it"),
    Check("stop time", "2.1.6", "2.3.2", stop_time,
          "run with a stop time far beyond the last step, and without one"),
    Check("start time", "2.1.6", "2.3.2", start_time,
          "run from a later start time; get the independent variable"),
    Check("repetition", "4.1.2", "4.1", repeats, "run; free the instance, run a new one"),
    Check("getting", "2.1.7", "2.2.7.2", getting, "run, and get all values twice after each step, in the opposite order, and one at a time"),
    Check("reset", "2.1.6", "2.3.1", resets, "set other parameters, run; reset, run without them"),
    Check("instances", "4.3.1", "2.2.1", instances, "step two instances in turn, one a third ahead"),
    Check("state", "2.1.8", "2.2.7.4", states,
          "get the FMU state after a third and after two thirds of the steps; set each, step on"),
    Check("serialization", "2.1.8", "2.2.7.4", serialized,
          "after half the steps serialize the state; deserialize and set it in a new instance, step on"),
    Check("step size", "4.2.2", "4.2.1", step_sizes,
          "with constant inputs: one step of 4 h against two of 2 h, one of 2 h against two of h"),
    Check("output dependencies", "2.2.8", "2.4.8", outputs,
          "a step of h / 1024, and in an equal instance with another input; the same with h / 64"),
    Check("initial dependencies", "2.2.8", "2.4.8", unknowns,
          "enter initialization mode, set one value, get the InitialUnknowns; the same without setting"),
    Check("directional derivatives", "2.1.9", "2.2.12.1", derivatives,
          "the FMU's derivative against the difference for two values of the known"),
    Check("discard", "4.2.3", "4.2.1", discards, "initialise; one step over the whole default experiment"),
    Check("call order", "4.2.4", "4.2", order,
          "make each call in each state that forbids it, in a process of its own; go on where it is taken"),
    Check("memory", "2.1.5", "2.2.1", memory, "10 000 steps, then 60 instances; watch the resident memory"),
)}  # fmt: skip


def checked(s: Subject, name: str) -> CheckResult:
    """The verdict of one check; what needs a run is not tried where there is none."""
    status, prefix = NOT_RUN, "it does not run: "
    try:
        if name not in ("description", "binary", "run"):
            s.unsteady  # noqa: B018
            s.reference  # noqa: B018
        status, prefix = FAILED, ""
        detail = s.in_process(lambda: CHECKS[name].function(s))
        status = PASSED
    except NotOffered as reason:
        status, detail = NOT_OFFERED, str(reason)
    except (CheckFailed, FmuError) as reason:
        detail = f"{prefix}{reason}"
    return CHECKS[name].verdict(s.description.fmiVersion, status, detail)
