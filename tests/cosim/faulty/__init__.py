"""An FMU that keeps all its promises, and one for each way to break one."""

from pathlib import Path

from tests.cosim.compiled import packed

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="faulty" guid="faulty {fault}">
<CoSimulation modelIdentifier="faulty" canHandleVariableCommunicationStepSize="true"
 canGetAndSetFMUstate="true" canSerializeFMUstate="true" providesDirectionalDerivative="true"/>
<DefaultExperiment startTime="0" stopTime="5" stepSize="0.01"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input"><Real start="1"/></ScalarVariable>
<ScalarVariable name="w" valueReference="1" causality="input"><Real start="0.5"/></ScalarVariable>
<ScalarVariable name="a" valueReference="2" causality="parameter" variability="fixed"
 initial="exact"><Real start="2"/></ScalarVariable>
<ScalarVariable name="b" valueReference="3" causality="parameter" variability="fixed"
 initial="exact"><Real start="1"/></ScalarVariable>
<ScalarVariable name="c" valueReference="4" causality="parameter" variability="fixed"
 initial="exact"><Real start="0.5"/></ScalarVariable>
<ScalarVariable name="x0" valueReference="5" causality="parameter" variability="fixed"
 initial="exact"><Real start="1"/></ScalarVariable>
<ScalarVariable name="y" valueReference="6" causality="output" initial="calculated"><Real/></ScalarVariable>
<ScalarVariable name="z" valueReference="7" causality="output" initial="calculated"><Real/></ScalarVariable>
<ScalarVariable name="n" valueReference="0" causality="output" variability="discrete"
 initial="calculated"><Integer/></ScalarVariable>
<ScalarVariable name="time" valueReference="9" causality="independent" variability="continuous"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="7" dependencies=""/>
<Unknown index="8" dependencies="1 2" dependenciesKind="fixed dependent"/>
<Unknown index="9" dependencies=""/></Outputs>
<InitialUnknowns><Unknown index="7" dependencies="6"/><Unknown index="8" dependencies="1 2 5"/>
<Unknown index="9" dependencies=""/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""
DESCRIPTION3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="faulty" instantiationToken="faulty {fault}">
<CoSimulation modelIdentifier="faulty" canHandleVariableCommunicationStepSize="true"
 canGetAndSetFMUState="true" canSerializeFMUState="true" providesDirectionalDerivatives="true"/>
<DefaultExperiment startTime="0" stopTime="5" stepSize="0.01"/>
<ModelVariables>
<Float64 name="time" valueReference="9" causality="independent" variability="continuous"/>
<Float64 name="u" valueReference="0" causality="input" start="1"/>
<Float64 name="w" valueReference="1" causality="input" start="0.5"/>
<Float64 name="a" valueReference="2" causality="parameter" variability="fixed" start="2"/>
<Float64 name="b" valueReference="3" causality="parameter" variability="fixed" start="1"/>
<Float64 name="c" valueReference="4" causality="parameter" variability="fixed" start="0.5"/>
<Float64 name="x0" valueReference="5" causality="parameter" variability="fixed" start="1"/>
<Float64 name="y" valueReference="6" causality="output" initial="calculated"/>
<Float64 name="z" valueReference="7" causality="output" initial="calculated"/>
<Int32 name="n" valueReference="8" causality="output" initial="calculated"/>
</ModelVariables>
<ModelStructure><Output valueReference="6" dependencies=""/>
<Output valueReference="7" dependencies="0 1" dependenciesKind="fixed dependent"/>
<Output valueReference="8" dependencies=""/>
<InitialUnknown valueReference="6" dependencies="5"/>
<InitialUnknown valueReference="7" dependencies="0 1 4"/>
<InitialUnknown valueReference="8" dependencies=""/></ModelStructure>
</fmiModelDescription>
"""
FAULTS = {
    "not valid": "description",
    "version": "binary",
    "not finite": "run, directional derivatives",
    "terminate refused": "termination",
    "fails": "run",
    "other start": "start values, reset",
    "runs to the stop time": "stop time",
    "ignores the start time": "start time",
    "not repeatable": "repetition",
    "answers in another order": "getting",
    "getting moves": "getting, state",
    "reset keeps a parameter": "reset",
    "reset keeps a count": "reset",
    "shared state": "instances, state",
    "state lacks a value": "state, serialization",
    "one place for states": "state",
    "bytes lack a value": "serialization",
    "ignores the step size": "step size, directional derivatives",
    "one step size": "step size, output dependencies, directional derivatives",
    "undeclared feedthrough": "output dependencies",
    "kind": "output dependencies",
    "hidden start": "initial dependencies",
    "wrong sign": "directional derivatives",
    "derivative of another point": "directional derivatives",
    "does not tell its time": "discard",
    "tells a wrong time": "discard",
    "crashes when called wrongly": "call order",
    "leaks": "memory",
    "leaks when freed": "memory",
}
TIME_FAULTS = ("does not tell its time", "tells a wrong time")
FAULTS3 = {fault: checks for fault, checks in FAULTS.items() if fault not in TIME_FAULTS}
FAULTS3["moves in a discard"] = "discard"
DEADLY = {
    "crashes": "memory",
    "freeing a state crashes": "state, serialization",
    "hangs in reset": "reset",
}
SWAPS = {
    "not valid": ('<Unknown index="9" dependencies=""/></InitialUnknowns>', "</InitialUnknowns>"),
    "undeclared feedthrough": ('"1 2" dependenciesKind="fixed dependent"', '"1"'),
    "kind": ('"fixed dependent"', '"fixed fixed"'),
    "once": ("<CoSimulation", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"'),
}
SWAPS3 = SWAPS | {
    "not valid": ('<InitialUnknown valueReference="8" dependencies=""/>', ""),
    "undeclared feedthrough": ('"0 1" dependenciesKind="fixed dependent"', '"0"'),
}


def pack(path: Path, fault: str = "", version: str = "2.0") -> Path:
    """Write an FMU of a version of FMI with this fault, or with none."""
    third = version == "3.0"
    text = (DESCRIPTION3 if third else DESCRIPTION).format(fault=fault)
    swaps = SWAPS3 if third else SWAPS
    if fault in swaps:
        assert swaps[fault][0] in text
        text = text.replace(*swaps[fault])
    flags = ['-DVERSION="2.1"', '-DVERSION3="2.1"'] if fault == "version" else []
    source = Path(__file__).with_name("faulty3.c" if third else "faulty.c")
    return packed(path, "faulty", text, source, *flags)
