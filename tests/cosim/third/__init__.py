"""An FMU of FMI 3.0 with a sample of each type, a ball that bounces, and a clock that samples.

`T_out` shows `T_in` for each type T, and `T_outs` shows `T_ins`, arrays of `rows` x 2 elements, of which there
are 2 x 2. The ball falls from `h` = 1 m without air; at each landing, an event, it keeps the share `e`
of its speed, and `hits` is the number of `bounces` as a Float64. At each tick of `clock`, `y` takes the value of `u`; after the fifth one its interval
changes from 0.1 s to 0.25 s where the clock is one that tells. Steps beyond `fail_at` are errors, those
longer than `discard_above` are discarded, those beyond `end_at` end the simulation. `events` counts
event modes that were entered. Calls out of order are errors: discrete inputs take event mode where it
is used.
"""

from collections.abc import Iterator
from pathlib import Path

from tests.cosim.compiled import packed

BASES = {
    "Float32": 100, "Float64": 200, "Int8": 300, "UInt8": 400, "Int16": 500, "UInt16": 600,
    "Int32": 700, "UInt32": 800, "Int64": 900, "UInt64": 1700, "Boolean": 1800,
}  # fmt: skip
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="third" instantiationToken="third">
<CoSimulation modelIdentifier="third" canHandleVariableCommunicationStepSize="true"
 canGetAndSetFMUState="true" canSerializeFMUState="true" hasEventMode="true" mightReturnEarlyFromDoStep="true"
 providesIntermediateUpdate="true"/>
<TypeDefinitions><EnumerationType name="Gear"><Item name="low" value="1"/>
<Item name="high" value="5"/></EnumerationType></TypeDefinitions>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="h" valueReference="1000" causality="output" initial="exact" start="1"
 intermediateUpdate="true"/>
<Float64 name="v" valueReference="1001" causality="output" initial="exact" start="0"
 intermediateUpdate="true"/>
<Float64 name="e" valueReference="1002" causality="parameter" variability="tunable" start="0.5"/>
<Float64 name="fail_at" valueReference="1006" causality="parameter" variability="fixed" start="1e300"/>
<Float64 name="discard_above" valueReference="1007" causality="parameter" variability="fixed"
 start="1e300"/>
<Float64 name="end_at" valueReference="1008" causality="parameter" variability="fixed" start="1e300"/>
<Int32 name="bounces" valueReference="1100" causality="output" variability="discrete"
 initial="exact" start="0"/>
<Int32 name="ticks" valueReference="1101" causality="output" variability="discrete"
 initial="exact" start="0"/>
<Int32 name="events" valueReference="1102" causality="output" variability="discrete"
 initial="exact" start="0"/>
<Float64 name="u" valueReference="1003" causality="input" start="0"/>
<Float64 name="y" valueReference="1004" causality="output" variability="discrete" initial="exact"
 start="0"/>
<Float64 name="hits" valueReference="1009" causality="output" variability="discrete" initial="exact"
 start="0"/>
<Float64 name="last_tick" valueReference="1005" causality="output" variability="discrete"
 initial="exact" start="0"/>
"""
CLOCK = '<Clock name="clock" valueReference="1200" causality="input" {}/>\n'
DIMENSIONS = '<Dimension valueReference="1900"/><Dimension start="2"/>'
OUTPUTS = [1000, 1001, 1004, 1005, 1009, 1100, 1101, 1102]


def _samples() -> Iterator[str]:
    for kind, base in BASES.items():
        start = "false" if kind == "Boolean" else "0"
        moves = "continuous" if kind.startswith("Float") else "discrete"
        for k, (name, size) in enumerate((("", ""), ("s", DIMENSIONS))):
            for out in (0, 1):
                causality = "output" if out else "input"
                attribute = "" if out else f' start="{start}"'
                yield (
                    f'<{kind} name="{kind}_{causality[:-3]}{name}" valueReference="{base + 2 * k + out}"'
                    f' causality="{causality}" variability="{moves}"{attribute}>{size}</{kind}>'
                )
    yield '<UInt64 name="rows" valueReference="1900" causality="structuralParameter" start="2"/>'
    for n, (kind, inner) in enumerate((("String", "grün"), ("Binary", "c0ffee"))):
        yield (
            f'<{kind} name="{kind}_in" valueReference="{2000 + 2 * n}" causality="input">'
            f'<Start value="{inner}"/></{kind}>'
            f'<{kind} name="{kind}_out" valueReference="{2001 + 2 * n}" causality="output"/>'
        )
    yield '<Enumeration name="Gear_in" valueReference="950" causality="input" declaredType="Gear" start="1"/>'
    yield '<Enumeration name="Gear_out" valueReference="951" causality="output" declaredType="Gear"/>'


def pack(path: Path, clock: str = "", **swaps: str) -> Path:
    """Write an FMU, with a clock of these attributes, and with capabilities set to other values."""
    text = HEAD + (CLOCK.format(clock) if clock else "") + "\n".join(_samples())
    following = [951, 2001, 2003, *(b + k for b in BASES.values() for k in (1, 3))]
    unknowns = "".join(f'<Output valueReference="{n}" dependencies=""/>' for n in OUTPUTS)
    for tag in ("Output", "InitialUnknown"):
        unknowns += "".join(
            f'<{tag} valueReference="{n}" dependencies="{n - 1}"/>' for n in following
        )
    text += f"</ModelVariables><ModelStructure>{unknowns}</ModelStructure></fmiModelDescription>"
    for name, value in swaps.items():
        assert f'{name}="true"' in text
        text = text.replace(f'{name}="true"', f'{name}="{value}"', 1)
    return packed(path, "third", text, Path(__file__).with_name("third.c"))
