"""A part whose steps are exact for inputs that hold: two states, two inputs, and events that nobody is told.

x' = A x + B u, z = C x + D u. At `first`, and then every `period`, the states keep the shares `keep1` and `keep2` of
their values and s = `rise` t begins again. If it `swings`, x2' has a21 sin x1, and x1 bounces at the `floor`, where x2
keeps -`keep2` of its value.
"""

from pathlib import Path

from tests.cosim.compiled import packed

NAMES = [
    "u1",
    "u2",
    "x1",
    "x2",
    "z",
    "s",
    "a11",
    "a12",
    "a21",
    "a22",
    "b11",
    "b12",
    "b21",
    "b22",
    "c1",
    "c2",
    "d1",
    "d2",
    "first",
    "period",
    "keep1",
    "keep2",
    "rise",
    "swings",
    "floor",
]
STARTS = {"first": 1e300, "keep1": 1.0, "keep2": 1.0, "floor": -1e300}


def pack(path: Path, *, has_events: bool, varies: bool = True) -> Path:
    """Write the FMU; one that has events is one for co-simulation only, which does not say whether it has."""
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="linear"'
        f' guid="linear" numberOfEventIndicators="{int(has_events)}">'
    )
    if not has_events:
        text += '<ModelExchange modelIdentifier="linear"/>'
    text += (
        '<CoSimulation modelIdentifier="linear" canGetAndSetFMUstate="true" canSerializeFMUstate="true"'
        f' canHandleVariableCommunicationStepSize="{str(varies).lower()}"/>\n<ModelVariables>'
    )
    for k, name in enumerate(NAMES, 1):
        causality, start = "parameter", f'start="{STARTS.get(name, 0.0)!r}"'
        attributes = 'variability="fixed"'
        if name in ("u1", "u2"):
            causality, attributes = "input", 'variability="continuous"'
        elif name in ("x1", "x2"):
            causality, attributes = "output", 'variability="continuous" initial="exact"'
        elif name in ("z", "s"):
            causality, attributes, start = "output", 'variability="continuous"', ""
        text += (
            f'<ScalarVariable name="{name}" valueReference="{k}" causality="{causality}" {attributes}>'
            f"<Real {start}/></ScalarVariable>\n"
        )
    for k in (1, 2):
        text += (
            f'<ScalarVariable name="der(x{k})" valueReference="{len(NAMES) + k}" causality="local"'
            f' variability="continuous"><Real derivative="{k + 2}"/></ScalarVariable>\n'
        )
    ders = "".join(f'<Unknown index="{len(NAMES) + k}"/>' for k in (1, 2))
    outputs = '<Unknown index="3" dependencies=""/><Unknown index="4" dependencies=""/>'
    later = '<Unknown index="5" dependencies="1 2"/><Unknown index="6" dependencies=""/>'
    text += f"</ModelVariables><ModelStructure><Outputs>{outputs}{later}</Outputs>"
    text += f"<Derivatives>{ders}</Derivatives><InitialUnknowns>{later}{ders}</InitialUnknowns>"
    text += "</ModelStructure></fmiModelDescription>"
    return packed(path, "linear", text, Path(__file__).with_name("linear.c"))
