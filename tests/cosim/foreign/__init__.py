"""FMUs as others build them: one C file, packed with any start values, capabilities and defects.

x' = a x + b u from x(start) = x0 is stepped exactly for an input with up to two derivatives, which
hold for one step; y = x, z = x + d u. Each `..._out` is the `..._in` set before the last step, or
(`counts`) tells how many steps of the first one's size were taken; `spelled` is string_out as a number. In
step mode outputs are those of the last step (`fresh`: z follows u at once). Steps above
`longest_step` end there with Discard (`stubborn`: do not start); afterwards only a saved state helps.
So do steps beyond `pause_at`, once. Discard at `end_at` says Terminated. A `..._at` is the time at
which the call that reaches it, also the end of initialisation, logs and returns that status (`talks`: and says more), kills
the process (`crash`: SIGSEGV, also `crash_at_end`, when terminated; `exit`: code 3), never returns (`hang`, also `hang_at_end`, when freed),
changes folder, locale and what hears Ctrl-C (`meddle`) or rounds upwards (`round`), or makes y NaN, as do steps above `nan_above`. `needs_input`: u must be set while
initialising. One that `forgets` goes back to the start values of its file when an experiment is set up,
one that `overrules` takes its own x0 at the end of initialisation, one that `commits` steps only where noSetFMUStatePriorToCurrentPoint is true, and then never goes back, one that is `punctual` steps
to the stop time and no bit further, one that `needs_stop` does not initialise without a stop time, one
that `wears` begins 1 above x0 from its second reset on, one
that `runs_ahead` computes all up to a defined stop time in its first step, one that `chats` logs from a thread that its step waits for. Other calls out of order, wrong times, steps beyond the stop time and, of one that commits,
returns to times that noSetFMUStatePriorToCurrentPoint excluded are errors, after which a state or a reset helps.

`steps` (doStep calls), `restores`, `live_states` and `gets_after_set` (calls that get outputs after
a set without a step between) count over the life of an instance. Lines of the file `diary`:
"terminated NAME", "refused NAME" (a call out of order), "leaked states NAME", "used after fatal NAME", "hangs NAME", "freed NAME".
"""

import zipfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple
from uuid import NAMESPACE_URL, uuid5
from xml.sax.saxutils import quoteattr

import fmpy

from cosim import System
from cosim.system import legal_part_name
from tests.cosim.compiled import binary

Value = float | int | bool | str
GEARS = {"low": 1, "middle": 2, "high": 5}
TOKEN = "grün, 100 %"
NEVER = 1e300
BINARY = f"binaries/{fmpy.platform}/foreign{fmpy.sharedLibraryExtension}"


class Variable(NamedTuple):
    """A variable of the binary; a capability is an attribute in the model description instead.

    `feedthrough` names what acts on an output without delay, `initial` what acts on its start.
    """

    name: str
    type: str
    causality: str
    start: Value = 0
    feedthrough: str = ""
    initial: str = ""

    @property
    def cell(self) -> str:
        """The type by which it is accessed."""
        return self.type.replace("Enumeration", "Integer")


SWITCHES = (
    "fresh", "counts", "stubborn", "needs_input", "talks", "crash_at_end", "hang_at_end", "forgets",
    "overrules", "commits", "punctual", "chats", "needs_stop", "runs_ahead", "wears",
)  # fmt: skip
LIMITS = (
    "longest_step", "warn_at", "error_at", "fatal_at", "nan_at", "nan_above", "crash_at", "hang_at",
    "meddle_at", "round_at", "flush_at", "exit_at", "end_at", "pause_at",
)  # fmt: skip
VARIABLES = [
    Variable("u", "Real", "input", 0.0),
    Variable("integer_in", "Integer", "input", 0),
    Variable("boolean_in", "Boolean", "input", False),
    Variable("string_in", "String", "input", ""),
    Variable("enumeration_in", "Enumeration", "input", 1),
    Variable("y", "Real", "output", initial="x0"),
    Variable("z", "Real", "output", feedthrough="u", initial="u x0 d"),
    *(
        Variable(f"{kind.lower()}_out", kind, "output", initial=f"{kind.lower()}_in")
        for kind in ("Integer", "Boolean", "String", "Enumeration")
    ),
    Variable("spelled", "Integer", "output", initial="string_in"),
    *(Variable(name, "Boolean", "output") for name in ("stop_time_defined", "tolerance_defined")),
    *(
        Variable(name, "Real", "output")
        for name in ("start_time", "stop_time", "tolerance", "last_step")
    ),
    *(
        Variable(name, "Integer", "output")
        for name in ("steps", "restores", "live_states", "gets_after_set")
    ),
    Variable("token", "String", "output"),
    Variable("a", "Real", "tunable", -1.0),
    Variable("b", "Real", "parameter", 1.0),
    Variable("d", "Real", "parameter", 0.5),
    Variable("x0", "Real", "parameter", 1.0),
    Variable("diary", "String", "parameter", ""),
    *(Variable(name, "Boolean", "parameter", False) for name in SWITCHES),
    *(Variable(name, "Real", "parameter", NEVER) for name in LIMITS),
    Variable("canHandleVariableCommunicationStepSize", "Boolean", "capability", True),
    Variable("canInterpolateInputs", "Boolean", "capability", True),
    Variable("maxOutputDerivativeOrder", "Integer", "capability", 2),
    Variable("canGetAndSetFMUstate", "Boolean", "capability", True),
    Variable("canBeInstantiatedOnlyOncePerProcess", "Boolean", "capability", False),
    Variable("needsExecutionTool", "Boolean", "capability", False),
    Variable("guid", "String", "identity"),
]
CELLS = {
    cell: [v for v in VARIABLES if v.cell == cell]
    for cell in ("Real", "Integer", "Boolean", "String")
}
REFERENCES = {v.name: n for variables in CELLS.values() for n, v in enumerate(variables)}


@cache
def library() -> bytes:
    """The binary for this platform, compiled once per process."""
    flags = ["-pthread"]
    for cell, variables in CELLS.items():
        flags.append(f"-D{cell}_NAMES={','.join(v.name for v in variables)}")
        flags.append(f"-D{cell}_CAUSALITIES={','.join(v.causality.upper() for v in variables)}")
    return binary(Path(__file__).with_name("foreign.c"), *flags)


def single_fmu_system(path: Path) -> System:
    """A single FMU as a system; its part is named like the file as far as that is a name."""
    return System({legal_part_name(path.stem): path})


def pack(path: Path, **start: Value) -> Path:
    """Write an FMU that starts with these inputs, parameters and capabilities (see VARIABLES).

    Raises TypeError for a name that has no start value.
    """
    startable = [v for v in VARIABLES if v.causality not in ("output", "identity")]
    values = {v.name: v.start for v in startable}
    if unknown := start.keys() - values.keys():
        raise TypeError(f"{', '.join(sorted(unknown))}: no start value of the foreign FMU")
    values |= start
    guid = f"{{{uuid5(NAMESPACE_URL, repr(values))}}}"
    cells = [(v.cell, v.name, values[v.name]) for v in startable] + [("String", "guid", guid)]
    lines = [
        f"{cell[0]} {REFERENCES[name]} {int(x) if isinstance(x, bool) else x}"
        for cell, name, x in cells
        if x != ""
    ]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", _description(guid, values))
        archive.writestr("resources/start.txt", "\n".join(lines))
        archive.writestr("resources/token.txt", TOKEN)
        archive.writestr(BINARY, library())
    return path


def _element(tag: str, content: str = "", **attributes: Value) -> str:
    text = "".join(
        f" {name}={quoteattr(str(x).lower() if isinstance(x, bool) else str(x))}"
        for name, x in attributes.items()
    )
    return f"<{tag}{text}>{content}</{tag}>" if content else f"<{tag}{text}/>"


def _description(guid: str, values: Mapping[str, Value]) -> str:
    connectors = [
        v for v in VARIABLES if v.causality in ("input", "output", "parameter", "tunable")
    ]
    index = {v.name: n for n, v in enumerate(connectors, 1)}

    def scalar(v: Variable) -> str:
        kind: dict[str, Value] = {"start": values[v.name]} if v.name in values else {}
        if v.type == "Enumeration":
            kind["declaredType"] = "Gear"
        variability = "continuous" if v.type == "Real" else "discrete"
        return _element(
            "ScalarVariable",
            _element(v.type, **kind),
            name=v.name,
            valueReference=REFERENCES[v.name],
            causality=v.causality.replace("tunable", "parameter"),
            variability={"parameter": "fixed", "tunable": "tunable"}.get(v.causality, variability),
        )

    def unknown(v: Variable, dependencies: str) -> str:
        acting = " ".join(str(n) for n in sorted(index[name] for name in dependencies.split()))
        return _element("Unknown", index=index[v.name], dependencies=acting)

    outputs = [v for v in connectors if v.causality == "output"]
    gears = "".join(_element("Item", name=name, value=value) for name, value in GEARS.items())
    gear = _element("SimpleType", _element("Enumeration", gears), name="Gear")
    capabilities = {v.name: values[v.name] for v in VARIABLES if v.causality == "capability"}
    structure = _element("Outputs", "".join(unknown(v, v.feedthrough) for v in outputs))
    structure += _element("InitialUnknowns", "".join(unknown(v, v.initial) for v in outputs))
    return _element(
        "fmiModelDescription",
        _element("CoSimulation", modelIdentifier="foreign", **capabilities)
        + _element("TypeDefinitions", gear)
        + _element("ModelVariables", "".join(map(scalar, connectors)))
        + _element("ModelStructure", structure),
        fmiVersion="2.0",
        modelName="foreign",
        guid=guid,
    )


def idle(parts: str, *driven: str) -> dict[str, Value]:
    """Start values for the inputs of foreign parts that are called by a letter, but the driven."""
    inputs = {v.name: v.start for v in VARIABLES if v.causality == "input"}
    start = {f"{part}.{name}": value for part in parts for name, value in inputs.items()}
    return {name: value for name, value in start.items() if name not in driven}
