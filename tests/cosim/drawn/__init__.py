"""Parts with a state, discrete Reals and samples, by FMI 2.0 and 3.0, of which systems are drawn.

x' = a x + b u + c d is taken exactly for inputs that hold, u continuous, d discrete; e shows d at once. By FMI 3.0, at
each tick of a clock, or at each event that it tells in advance, the first one at `first`, the others every `period`, y
becomes q y + g d + w and n counts. By FMI 2.0, y changes from 0 to 1 behind `switch_at`, and x keeps the share `kept`
of its value at `reset_at`: nobody is told.
"""

from collections.abc import Iterable
from pathlib import Path

from tests.cosim.compiled import packed

HERE = Path(__file__).parent
REALS = {
    "u": 1, "d": 2, "x": 3, "y": 4, "e": 5, "a": 6, "b": 7, "c": 8, "q": 9, "g": 10, "period": 11,
    "first": 12,
}  # fmt: skip
REALS2 = {
    "u": 1, "d": 2, "x": 3, "e": 5, "a": 6, "b": 7, "c": 8, "reset_at": 9, "kept": 10, "switch_at": 11,
    "y": 12,
}  # fmt: skip
#: What is not 0 by default.
STARTS = {"reset_at": 1e300, "kept": 1.0, "switch_at": 1e300}


def _attributes(name: str, discrete: Iterable[str]) -> str:
    """Causality, variability and start of a variable."""
    causality = "input" if name in "ud" else "output" if name in "xye" else "parameter"
    moves = "discrete" if name in discrete else "continuous"
    moves = "fixed" if causality == "parameter" else moves
    start = f' start="{STARTS.get(name, 0.0)!r}"'
    if causality == "output":
        exact = name != "e"
        return f'causality="output" variability="{moves}"' + (
            ' initial="exact"' + start if exact else ""
        )
    return f'causality="{causality}" variability="{moves}"' + start


def pack3(
    path: Path,
    clock: tuple[float, float] | None = None,
    *,
    discrete: str = "dye",
    returns_early: bool = True,
    varies: bool = True,
) -> Path:
    """Write a part by FMI 3.0, with a clock of this interval and shift [s]; `discrete` are its Reals of that kind."""
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="3.0" modelName="drawn"'
        ' instantiationToken="drawn"><CoSimulation modelIdentifier="drawn" canGetAndSetFMUState="true"'
        f' canSerializeFMUState="true" canHandleVariableCommunicationStepSize="{str(varies).lower()}"'
        f' hasEventMode="true" mightReturnEarlyFromDoStep="{str(returns_early).lower()}"/>\n'
        '<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>\n<ModelVariables>'
        '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>\n'
    )
    for name, ref in REALS.items():
        text += f'<Float64 name="{name}" valueReference="{ref}" {_attributes(name, discrete)}'
        first = clock is not None and name == "y"
        text += ' clocks="50"/>\n' if first else "/>\n"
    text += (
        '<Int32 name="w" valueReference="40" causality="input" variability="discrete" start="0"/>\n'
    )
    text += '<Int32 name="n" valueReference="41" causality="output" variability="discrete" initial="exact" start="0"/>\n'
    if clock is not None:
        interval, shift = clock
        text += (
            '<Clock name="tick" valueReference="50" causality="input" intervalVariability="constant"'
            f' intervalDecimal="{interval!r}" shiftDecimal="{shift!r}"/>\n'
        )
    text += "</ModelVariables><ModelStructure>"
    text += "".join(f'<Output valueReference="{ref}" dependencies=""/>' for ref in (3, 4, 41))
    text += '<Output valueReference="5" dependencies="2"/>'
    text += '<InitialUnknown valueReference="5" dependencies="2"/></ModelStructure></fmiModelDescription>'
    return packed(path, "drawn", text, HERE / "drawn3.c")


def pack2(path: Path, *, discrete: str = "dye", varies: bool = True) -> Path:
    """Write a part by FMI 2.0; `discrete` are its Reals of that kind."""
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="drawn"'
        ' guid="drawn" numberOfEventIndicators="1"><CoSimulation modelIdentifier="drawn"'
        ' canGetAndSetFMUstate="true" canSerializeFMUstate="true"'
        f' canHandleVariableCommunicationStepSize="{str(varies).lower()}"/>\n<ModelVariables>'
    )
    for name, ref in REALS2.items():
        start = f'start="{STARTS.get(name, 0.0)!r}"'
        attributes = _attributes(name, discrete).replace(" " + start, "")
        if name in "ye":
            attributes, start = attributes.replace(' initial="exact"', ""), ""
        text += f'<ScalarVariable name="{name}" valueReference="{ref}" {attributes}><Real {start}/></ScalarVariable>\n'
    text += '</ModelVariables><ModelStructure><Outputs><Unknown index="3" dependencies=""/>'
    text += '<Unknown index="4" dependencies="2"/><Unknown index="11" dependencies=""/></Outputs>'
    text += '<InitialUnknowns><Unknown index="4" dependencies="2"/><Unknown index="11" dependencies=""/>'
    text += "</InitialUnknowns></ModelStructure></fmiModelDescription>"
    return packed(path, "drawn", text, HERE / "drawn2.c")
