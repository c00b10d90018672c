"""Which calls of co-simulation FMI 2.0 and 3.0 allow in which state of an instance, a row a call.

The states are those of the figures in FMI 2.0.4, 4.2.4, and FMI 3.0.2, 4.2: instantiated, initialization mode, step mode
(in FMI 2.0 step complete), event mode and terminated, each by its first letter. What both versions have is in both
columns; None stands for a call that a version does not have, and "" for one that no state allows as it is made here.
"""

from __future__ import annotations

from typing import NamedTuple

#: The states by their letters.
STATES = {
    "I": "before initialization", "M": "in initialization mode", "S": "while stepping", "E": "in event mode",
    "T": "after it is terminated",
}  # fmt: skip


class Call(NamedTuple):
    """A call, by FMPy's name or by what it sets or gets, the states that allow it, and the state that it leads to."""

    name: str
    allowed2: str | None
    allowed3: str | None
    leads_to: str = ""

    def allowing_states(self, version: str) -> str | None:
        """The letters of the states that allow it, or None in a version without it."""
        return self.allowed3 if version == "3.0" else self.allowed2


CALLS = {call.name: call for call in (
    Call("setupExperiment", "I", None),
    Call("enterInitializationMode", "I", "I", "M"),
    Call("exitInitializationMode", "M", "M", "S"),
    Call("doStep", "S", "S"),
    Call("terminate", "S", "SE", "T"),
    Call("reset", "IMST", "IMSET", "I"),
    Call("get an output", "MST", "IMSET"),
    Call("set an input", "IMS", "IMSE"),
    Call("set a fixed parameter", "IM", "IM"),
    Call("set an output", "", ""),
    Call("getDirectionalDerivative", "MST", "MSET"),
    Call("cancelStep", "", None),
    Call("enterEventMode", None, "S", "E"),
    Call("enterStepMode", None, "E", "S"),
    Call("updateDiscreteStates", None, "E"),
    Call("evaluateDiscreteStates", None, "ME"),
    Call("exitConfigurationMode", None, ""),
)}  # fmt: skip
