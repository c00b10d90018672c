"""An FMU of FMI 3.0 for model exchange only, whose state, input and output are arrays.

z' = u[2] - z, x[1]' = x[2], x[2]' = k u[1] - 4 x[1] and y = x + u / 2, with a discrete input k, which is
refused outside of event mode. At 0.5 s, an event of time, x[1] changes its sign.
"""

from pathlib import Path

from tests.cosim.compiled import packed

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="vector" instantiationToken="vector">
<ModelExchange modelIdentifier="vector" providesDirectionalDerivatives="{slopes}"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="z" valueReference="1" causality="local" initial="exact" start="1"/>
<Float64 name="x" valueReference="2" causality="local" initial="exact" start="0.2 0"><Dimension start="2"/></Float64>
<Float64 name="u" valueReference="3" causality="input" start="0 0"><Dimension start="2"/></Float64>
<Float64 name="y" valueReference="4" causality="output"><Dimension start="2"/></Float64>
<Float64 name="k" valueReference="5" causality="input" variability="discrete" start="1"/>
<Float64 name="der(z)" valueReference="6" causality="local" derivative="1"/>
<Float64 name="der(x)" valueReference="7" causality="local" derivative="2"><Dimension start="2"/></Float64>
</ModelVariables>
<ModelStructure><Output valueReference="4"/><ContinuousStateDerivative valueReference="6"/>
<ContinuousStateDerivative valueReference="7"/><InitialUnknown valueReference="4"/>
<InitialUnknown valueReference="6"/><InitialUnknown valueReference="7"/></ModelStructure>
</fmiModelDescription>
"""


def pack(path: Path, *, slopes: bool = True) -> Path:
    """Write the FMU, which gives directional derivatives or not."""
    text = DESCRIPTION.format(slopes=str(slopes).lower())
    return packed(path, "vector", text, Path(__file__).with_name("vector.c"))
