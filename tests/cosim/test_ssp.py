"""SSP packages, written here feature by feature, give the numbers of the system they describe."""

import logging
import math
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import pytest
from lxml import etree
from numpy.testing import assert_allclose, assert_array_equal

from cosim import Package, SetupError, System, oracle, read_ssp, run, write_ssp
from cosim.system import Network, connect
from tests.conftest import described, rewritten

STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"
NAMES = {"ssd": "Description", "ssc": "Common", "ssv": "ParameterValues", "ssm": "ParameterMapping"}
SPACES = " ".join(f'xmlns:{prefix}="{STANDARD}{name}"' for prefix, name in NAMES.items())
RPM = f'<ssc:Unit name="rpm"><ssc:BaseUnit s="-1" rad="1" factor="{math.pi / 30!r}"/></ssc:Unit>'

MOTOR = """
<ssd:Component name="motor" source="resources/DriveMotor.fmu"><ssd:Connectors>
  <ssd:Connector name="w" kind="input"><ssc:Real unit="rad/s"/></ssd:Connector>
  <ssd:Connector name="tau" kind="output"/></ssd:Connectors>{}</ssd:Component>"""
CONVEYOR = """
<ssd:Component name="conveyor" source="resources/CrankConveyor.fmu"><ssd:Connectors>
  <ssd:Connector name="tau" kind="input"/><ssd:Connector name="w" kind="output"/>
  </ssd:Connectors>{}</ssd:Component>"""
TAU = (
    '<ssd:Connection startElement="motor" startConnector="tau" endElement="{}" endConnector="tau"/>'
)
W = '<ssd:Connection startElement="{}" startConnector="{}" endElement="motor" endConnector="w"{}'
ENDS = W.format("conveyor", "w", "/>")
SPACE = '<ssd:Connection startElement="{}" startConnector="{}" endElement="{}" endConnector="{}"/>'


def ssd(elements: str, connections: str = "", more: str = "", tail: str = "") -> str:
    """An SSD: `more` comes before the elements of the system, `tail` after it."""
    if connections:
        connections = f"<ssd:Connections>{connections}</ssd:Connections>"
    return (
        f'<ssd:SystemStructureDescription {SPACES} version="1.0" name="test"><ssd:System name="all">'
        f"{more}<ssd:Elements>{elements}</ssd:Elements>{connections}</ssd:System>{tail}"
        "</ssd:SystemStructureDescription>"
    )


def system_in(name: str, inner: str, ports: str = "", connections: str = "") -> str:
    """A system within another."""
    if connections:
        connections = f"<ssd:Connections>{connections}</ssd:Connections>"
    elements = inner and f"<ssd:Elements>{inner}</ssd:Elements>"
    return f'<ssd:System name="{name}">{ports}{elements}{connections}</ssd:System>'


def connectors(*triples: tuple[str, str, str]) -> str:
    """Connectors of a system: name, kind, content."""
    inner = "".join(
        f'<ssd:Connector name="{name}" kind="{kind}">{content}</ssd:Connector>'
        for name, kind, content in triples
    )
    return f"<ssd:Connectors>{inner}</ssd:Connectors>"


def values(parameters: str, more: str = "") -> str:
    """A parameter set: text with {} -> as 'name Type attributes;...'."""
    rows = "".join(
        f'<ssv:Parameter name="{name}"><ssv:{content}/></ssv:Parameter>'
        for name, content in (row.strip().split(" ", 1) for row in parameters.split(";"))
    )
    return (
        f'<ssv:ParameterSet {SPACES} version="1.0" name="set">'
        f"<ssv:Parameters>{rows}</ssv:Parameters>{more}</ssv:ParameterSet>"
    )


def mapping(*entries: tuple[str, str, str]) -> str:
    """A parameter mapping: source, rest of the attributes, content."""
    rows = "".join(
        f'<ssm:MappingEntry source="{source}" {target}>{content}</ssm:MappingEntry>'
        for source, target, content in entries
    )
    return f'<ssm:ParameterMapping {SPACES} version="1.0">{rows}</ssm:ParameterMapping>'


def bindings(*sets: str, mapped: str = "", attributes: str = "") -> str:
    """Parameter bindings with inline sets."""
    if mapped:
        mapped = f"<ssd:ParameterMapping>{mapped}</ssd:ParameterMapping>"
    inner = "".join(
        f"<ssd:ParameterBinding {attributes}><ssd:ParameterValues>{parameter_set}</ssd:ParameterValues>"
        f"{mapped}</ssd:ParameterBinding>"
        for parameter_set in sets
    )
    return f"<ssd:ParameterBindings>{inner}</ssd:ParameterBindings>"


Files = dict[str, str | bytes | Path]
Read = Callable[..., Package]


def pack(path: Path, files: Files) -> Path:
    """A zip file with these texts and files."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            if isinstance(content, Path):
                archive.write(content, name)
            else:
                archive.writestr(name, content)
    return path


@pytest.fixture
def resources(fmus: Path, echo: Path) -> Files:
    """The FMUs of all tests as files of a package."""
    names = ("DriveMotor", "CrankConveyor", "LinearSystem")
    return {f"resources/{name}.fmu": fmus / f"{name}.fmu" for name in names} | {
        "resources/Echo.fmu": echo
    }


@pytest.fixture
def read(resources: Files, tmp_path: Path) -> Read:
    """Read a package of this SSD and these other files, beside the FMUs."""

    def read(structure: str, **added: str | bytes | Path) -> Package:
        files = {"SystemStructure.ssd": structure, **resources, **added}
        return read_ssp(pack(tmp_path / "test.ssp", files), tmp_path / "unpacked")

    return read


def same(package: Package, system: System, rtol: float = 0.0, **names: str) -> None:
    """The package and the system give the same torque and speed; `names` are parts' other names."""
    settings: dict[str, Any] = {"stop": 0.02, "step": 1e-3, "algorithm": "jacobi"}
    result, expected = run(package.system, **settings), run(system, **settings)
    for name in expected.names[1:]:
        part, _, variable = name.partition(".")
        column = f"{names.get(part, part)}.{variable}"
        assert_allclose(result[column], expected[name], rtol=rtol, atol=rtol, err_msg=column)
    assert len(result.columns) == len(expected.columns)


def pair(fmus: Path, wires: list[str] | None = None, **start: Any) -> System:
    """The system that most packages describe; start values with __ for the dot."""
    return System(
        {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"},
        wires or ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"],
        {name.replace("__", "."): value for name, value in start.items()},
    )


def flat(
    motor: str = "", conveyor: str = "", ends: str = ENDS, more: str = "", tail: str = ""
) -> str:
    """The pair as an SSD without nesting."""
    elements = MOTOR.format(motor) + CONVEYOR.format(conveyor)
    return ssd(elements, TAU.format("conveyor") + ends, more, tail)


def test_flat_system_and_default_experiment(fmus: Path, read: Read) -> None:
    package = read(flat(tail='<ssd:DefaultExperiment startTime="0.5" stopTime="2.5"/>'))
    assert (package.start, package.stop, package.connectors) == (0.5, 2.5, {})
    assert [*map(str, package.system.wires)] == list(pair(fmus).wires)
    same(package, pair(fmus))


INNER = connectors(("tau", "input", ""), ("w", "output", "<ssc:Real/>"))
INWARD = '<ssd:Connection startConnector="tau" endElement="conveyor" endConnector="tau"/>'
OUTWARD = '<ssd:Connection startElement="conveyor" startConnector="w" endConnector="w"{}'
INSIDE = CONVEYOR.format(""), INWARD + OUTWARD.format("/>"), INNER


def nested(kind: str, source: str, more: str = "") -> str:
    """The pair with the conveyor in a file of its own."""
    component = f'<ssd:Component name="line" type="{kind}" source="{source}">{more}</ssd:Component>'
    return ssd(MOTOR.format("") + component, TAU.format("line") + W.format("line", "w", "/>"))


def test_nested_systems_are_flattened_three_deep(fmus: Path, read: Read) -> None:
    elements, connections, ports = INSIDE
    inner = system_in("hall", elements, ports, connections)
    through = INWARD.replace("conveyor", "hall") + OUTWARD.format("/>").replace("conveyor", "hall")
    middle = system_in("line", inner, ports, through)
    outer = connectors(("speed", "output", ""))
    top = '<ssd:Connection startElement="line" startConnector="w" endConnector="speed"/>'
    ends = TAU.format("line") + W.format("line", "w", "/>") + top
    package = read(ssd(MOTOR.format("") + middle, ends, outer))
    assert list(package.system.parts) == ["motor", "line.hall.conveyor"]
    assert package.connectors == {"speed": "line.hall.conveyor.w"}
    same(package, pair(fmus), conveyor="line.hall.conveyor")


@pytest.mark.parametrize("kind", ["definition", "package"])
def test_components_may_be_structures_or_packages(
    fmus: Path, read: Read, resources: Files, tmp_path: Path, kind: str
) -> None:
    """Their own parameters give way to those of the component."""
    parameters = bindings(values('conveyor.trough.m Real value="150"'))
    inner = ssd(
        CONVEYOR.format(""),
        INSIDE[1],
        INNER
        + bindings(values('conveyor.trough.m Real value="99";conveyor.trough.d Real value="3000"')),
    )
    if kind == "definition":
        name, content = "resources/line.ssd", inner.replace("resources/", "")
    else:
        name = "resources/line.ssp"
        content = pack(tmp_path / "line.ssp", {"SystemStructure.ssd": inner, **resources})
    package = read(nested(f"application/x-ssp-{kind}", name, parameters), **{name: content})
    expected = pair(fmus, conveyor__trough__m=150.0, conveyor__trough__d=3000.0)
    same(package, expected, conveyor="line.conveyor")


def test_an_embedded_system_can_be_used_again_by_its_id(fmus: Path, read: Read) -> None:
    spring = '<ssd:Component name="spring" source="resources/LinearSystem.fmu"/>'
    first = f'<ssd:System name="first" id="one"><ssd:Elements>{spring}</ssd:Elements></ssd:System>'
    second = '<ssd:Component name="second" type="application/x-ssp-definition" source="#one">'
    parameters = bindings(values('spring.x[1] Real value="2"'))
    package = read(ssd(f"{first}{second}{parameters}</ssd:Component>"))
    result = run(package.system, stop=0.1, step=0.01)
    assert_allclose(result["second.spring.y[1]"], 2 * result["first.spring.y[1]"], rtol=1e-14)


def test_outer_connectors_that_stand_for_a_single_variable_unchanged(read: Read) -> None:
    """Not those that lead to two, or that scale or convert."""
    ports = connectors(
        ("load", "input", ""), ("half", "input", ""), ("both", "parameter", ""), ("loose", "output", ""),
        ("speed", "output", '<ssc:Real unit="rad/s"/>'), ("rpm", "output", '<ssc:Real unit="rpm"/>'),
    )  # fmt: skip
    inward = '<ssd:Connection startConnector="{}" endElement="{}" endConnector="{}"{}'
    outward = '<ssd:Connection startElement="conveyor" startConnector="w" endConnector="{}"/>'
    hold = '<ssd:Connector name="input_hold" kind="parameter"/></ssd:Connectors>'
    elements = (MOTOR + CONVEYOR).format("", "").replace("</ssd:Connectors>", hold)
    connections = inward.format("load", "conveyor", "tau", "/>") + outward.format("speed")
    connections += inward.format("half", "motor", "w", SCALED.format(0.5, 0)) + outward.format(
        "rpm"
    )
    for part in ("conveyor", "motor"):
        connections += inward.format("both", part, "input_hold", "/>")
    units = f"<ssd:Units>{RPM}</ssd:Units>"
    package = read(ssd(elements, connections, ports, units))
    assert package.connectors == {"load": "conveyor.tau", "speed": "conveyor.w"}


EVERY_TYPE = (
    'r Real value="0.5";i Integer value="3";b Boolean value="true";s String value="B";'
    'x Real value="0.25"'
)


@pytest.mark.parametrize("where", ["inline", "external", "in the FMU"])
def test_parameters_of_every_type(read: Read, resources: Files, tmp_path: Path, where: str) -> None:
    component = '<ssd:Component name="echo" source="resources/Echo.fmu">{}</ssd:Component>'
    files: Files = {}
    if where == "inline":
        binding = bindings(values(EVERY_TYPE))
    else:
        base = ' sourceBase="component"' if where == "in the FMU" else ""
        source = f'source="resources/my%20values.ssv"{base}'
        binding = f"<ssd:ParameterBindings><ssd:ParameterBinding {source}/></ssd:ParameterBindings>"
        files = {"resources/my values.ssv": values(EVERY_TYPE)}
    if where == "in the FMU":
        fmu = tmp_path / "Echo.fmu"
        echo = resources["resources/Echo.fmu"]
        assert isinstance(echo, Path)
        with zipfile.ZipFile(echo) as old:
            pack(fmu, {name: old.read(name) for name in old.namelist()} | files)
        files = {"resources/Echo.fmu": fmu}
    package = read(ssd(component.format(binding)), **files)
    result = run(package.system, stop=0.01, step=0.01)
    assert result["echo.y"][0] == 0.5 + 30 + 1000 + 1e4 * ord("B") + 0.25


def test_a_parameter_that_fits_nothing_is_ignored_aloud(
    fmus: Path, read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "cosim"):
        same(read(flat(motor=bindings(values('Tt Real value="1"')))), pair(fmus))
    (message,) = caplog.messages
    assert "parameter Tt fits no variable and is ignored" in message


def test_system_connectors_hand_parameters_down(fmus: Path, read: Read) -> None:
    """A parameter in minutes for all parts that the connector leads to, an input, an output."""
    ports = connectors(
        ("lag", "parameter", '<ssc:Real unit="min"/>'),
        ("load", "input", ""),
        ("speed", "output", '<ssc:Real unit="rpm"/>'),
    )
    parts = MOTOR.format("").replace("</ssd:Connectors>", PARAMETER) + CONVEYOR.format("")
    wires = (
        '<ssd:Connection startConnector="lag" endElement="motor" endConnector="T"/>'
        '<ssd:Connection startConnector="load" endElement="conveyor" endConnector="tau">'
        '<ssc:LinearTransformation factor="2" offset="1"/></ssd:Connection>'
        '<ssd:Connection startElement="conveyor" startConnector="w" endConnector="speed"/>'
    )
    inner = system_in("drive", parts, ports, wires)
    rows = 'drive.lag Real value="0.001";drive.load Real value="3";drive.speed Real value="300"'
    minute = '<ssc:Unit name="min"><ssc:BaseUnit s="1" factor="60"/></ssc:Unit>'
    units = f"<ssd:Units>{RPM}{minute}</ssd:Units>"
    start = read(ssd(inner, more=bindings(values(rows)), tail=units)).system.start
    assert start["drive.motor.T"] == pytest.approx(0.06, rel=1e-14)
    assert start["drive.conveyor.tau"] == 7.0
    assert start["drive.conveyor.w"] == pytest.approx(10 * math.pi, rel=1e-14)


PARAMETER = '<ssd:Connector name="T" kind="parameter"/></ssd:Connectors>'
MS = '<ssv:Units><ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="0.001"/></ssc:Unit></ssv:Units>'
LINEAR = '<ssc:LinearTransformation factor="2" offset="0.01"/>'


@pytest.mark.parametrize("external", [False, True])
def test_mapping_renames_converts_then_transforms(fmus: Path, read: Read, external: bool) -> None:
    """20 ms are 0.02 s, twice that and 0.01 more is 0.05 s; what is not mapped is not applied."""
    rows = 'lag Real value="20" unit="ms";motor.A Real value="1";flag Boolean value="false"'
    rows += ';kind Enumeration value="straight";number Integer value="7";same Real value="190"'
    tables = {
        "Boolean": '<ssc:MapEntry source="false" target="true"/>',
        "Enumeration": '<ssc:MapEntry source="straight" target="kloss"/>',
        "Integer": '<ssc:MapEntry source="1" target="0"/><ssc:MapEntry source="7" target="1"/>',
    }
    table = {
        kind: f"<ssc:{kind}MappingTransformation>{rows}</ssc:{kind}MappingTransformation>"
        for kind, rows in tables.items()
    }
    entries = mapping(
        ("lag", 'target="motor.T"', LINEAR),
        ("same", 'target="motor.B"', ""),
        ("flag", 'target="conveyor.rod.finite"', table["Boolean"]),
        ("kind", 'target="motor.characteristic"', table["Enumeration"]),
        ("number", 'target="motor.input_hold"', table["Integer"]),
        ("number", 'target="conveyor.input_hold"', table["Integer"]),
    )
    if external:
        source = (
            '<ssd:ParameterBindings><ssd:ParameterBinding source="v.ssv">'
            '<ssd:ParameterMapping source="m.ssm"/></ssd:ParameterBinding></ssd:ParameterBindings>'
        )
        package = read(flat(more=source), **{"v.ssv": values(rows, MS), "m.ssm": entries})
    else:
        package = read(flat(more=bindings(values(rows, MS), mapped=entries)))
    expected = pair(
        fmus, motor__T=2 * (20 * 0.001) + 0.01, motor__B=190.0, motor__characteristic=1,
        conveyor__rod__finite=True, motor__input_hold=1, conveyor__input_hold=1,
    )  # fmt: skip
    assert package.system.start == expected.start
    same(package, expected)


RPM_INSIDE = INSIDE[0], INWARD + OUTWARD, connectors(
    ("tau", "input", ""), ("w", "output", '<ssc:Real unit="rpm"/>')
)  # fmt: skip
OMEGA = math.pi / 30


SCALED = '><ssc:LinearTransformation factor="{}" offset="{}"/></ssd:Connection>'
AS_IT_IS = ' suppressUnitConversion="true"'


@pytest.mark.parametrize(
    ("inside", "outside", "wire"),
    [
        ("/>", "/>", "conveyor.w -> motor.w"),
        (SCALED.format(2, 3), "/>", f"conveyor.w * 2 + {3 * OMEGA!r} -> motor.w"),
        ("/>", SCALED.format(0.5, -1.5), "conveyor.w * 0.5 - 1.5 -> motor.w"),
        ("/>", f"{AS_IT_IS}/>", f"conveyor.w * {1 / OMEGA!r} -> motor.w"),
        (f"{AS_IT_IS}/>", "/>", f"conveyor.w * {OMEGA!r} -> motor.w"),
        ("/>", AS_IT_IS + SCALED.format(0.1, 0), f"conveyor.w * {0.1 / OMEGA!r} -> motor.w"),
    ],
)
def test_units_along_a_chain_of_connectors(
    fmus: Path, read: Read, inside: str, outside: str, wire: str
) -> None:
    """The speed leaves its system in rpm: convert to the target's unit, then transform."""
    elements, connections, ports = RPM_INSIDE
    line = system_in("line", elements, ports, connections.format(inside))
    ends = TAU.format("line") + W.format("line", "w", outside)
    package = read(ssd(MOTOR.format("") + line, ends, tail=f"<ssd:Units>{RPM}</ssd:Units>"))
    expected = pair(fmus, ["motor.tau -> conveyor.tau", wire])
    same(package, expected, rtol=1e-11, conveyor="line.conveyor")


def test_suppressed_conversion_lets_any_unit_pass(fmus: Path, read: Read) -> None:
    """A torque as a speed, number by number."""
    ends = (
        '<ssd:Connection startElement="motor" startConnector="tau" endElement="motor" '
        'endConnector="w" suppressUnitConversion="true"/>'
    )
    package = read(flat(ends=ends))
    assert str(package.system.wires[1]) == "motor.tau => motor.w"
    same(package, pair(fmus, ["motor.tau -> conveyor.tau", "motor.tau => motor.w"]))


def annotated(content: str) -> str:
    """A default experiment with an annotation."""
    return (
        '<ssd:DefaultExperiment stopTime="1"><ssd:Annotations><ssc:Annotation type="x">'
        f"{content}</ssc:Annotation></ssd:Annotations></ssd:DefaultExperiment>"
    )


@pytest.mark.parametrize(
    ("content", "step"),
    [
        ('<o:A xmlns:o="o"><o:FixedStepAlgorithm baseStepSize="1e-4"/></o:A>', 1e-4),
        ('<FixedStepMaster stepSize="0.002" description="oms-ma"/>', 0.002),
        ("<Other/>", None),
    ],
)
def test_the_step_of_osp_and_omsimulator_is_read(
    content: str, step: float | None, read: Read
) -> None:
    assert read(flat(tail=annotated(content))).step == step


@pytest.mark.parametrize("name", ["", "SystemStructure.ssd"])
def test_a_folder_and_its_ssd_are_read(
    name: str, fmus: Path, resources: Files, tmp_path: Path
) -> None:
    """With packages in it, and files beside it."""
    elements, connections, ports = INSIDE
    package = {"SystemStructure.ssd": ssd(elements, connections, ports), **resources}
    (tmp_path / "folder").mkdir()
    pack(tmp_path / "line.ssp", package)
    motor = tmp_path / "DriveMotor.fmu"
    motor.symlink_to(fmus / motor.name)
    structure = nested("application/x-ssp-package", "../line.ssp")
    structure = structure.replace("resources/Drive", "../Drive")
    (tmp_path / "folder" / "SystemStructure.ssd").write_text(structure)
    package = read_ssp(tmp_path / "folder" / name, tmp_path / "unpacked")
    same(package, pair(fmus), conveyor="line.conveyor")
    assert len(list((tmp_path / "unpacked").iterdir())) == 1
    with pytest.raises(SetupError, match=r"unpacked: there is no file 'SystemStructure\.ssd'"):
        read_ssp(tmp_path / "unpacked", tmp_path / "more")


def test_names_that_no_part_can_have_are_changed_aloud(
    fmus: Path, read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    """Parameters and connections still use them as they stand."""
    structure = flat(more=bindings(values('1*motor.T Real value="0.05"')))
    structure = structure.replace('name="motor"', 'name="1*motor"')
    structure = structure.replace('Element="motor"', 'Element="1*motor"')
    same(read(structure), pair(fmus, motor__T=0.05), motor="part_1_motor")
    assert "element '1*motor' becomes part_1_motor" in caplog.text


def test_dialects_of_other_tools(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    """An empty element is none, the FMU may define an enumeration, a mapping may be half filled."""
    enumeration = '<ssc:Enumeration name="E"/>'
    ports = connectors(("T", "parameter", ""), ("characteristic", "parameter", enumeration))
    mapped = mapping(("kind", 'target="characteristic"', ""), ("", 'target="A"', ""))
    kloss = bindings(values('kind Enumeration value="kloss"'), mapped=mapped)
    lag = connectors(("lag", "parameter", "")) + bindings(values('lag Real value="0.05"'))
    structure = component(FMU, ports + kloss, SPACE.format("", "lag", "part", "T"), more=lag)
    with caplog.at_level(logging.WARNING, "cosim"):
        start = read(structure).system.start
    assert start == {"part.T": 0.05, "part.characteristic": 1}
    assert [text.partition(": ")[2] for text in caplog.messages] == [
        "the enumeration 'E' is not defined in the file",
        "1 entries without a source",
    ]


def test_what_does_no_harm_is_a_warning(
    fmus: Path, read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    """Parameter connectors without a variable, a tool's own attributes, an Enumeration without a name."""
    odd = '<ssd:Connector name="{}" kind="parameter">{}</ssd:Connector>'
    extra = odd.format("fmi_rTol", "<ssc:Real/>") + odd.format("_start", "<ssc:Real/>")
    extra += odd.format("characteristic", "<ssc:Enumeration/>")
    structure = flat().replace("</ssd:Connectors>", f"{extra}</ssd:Connectors>", 1)
    structure = structure.replace("<ssd:Component ", '<ssd:Component delay="0.1" x:y="2" ')
    structure = structure.replace("<ssd:System ", '<ssd:System xmlns:x="urn:x" ', 1)
    with caplog.at_level(logging.WARNING, "cosim"):
        same(read(structure), pair(fmus))
    warnings = [text.replace("SystemStructure.ssd, line", "at") for text in caplog.messages]
    assert re.sub(r"at \d+", "at", "\n".join(warnings)).splitlines() == [
        "at: connector characteristic has an Enumeration without a name; that of the FMU is taken",
        "at: attribute delay of Component is not one of SSP and is ignored (and in 1 more places)",
        "at: attribute y of Component is not one of SSP and is ignored (and in 1 more places)",
        "motor: its FMU has no fmi_rTol and no _start; 2 parameter connectors ignored",
    ]


def stacked(*levels: str) -> str:
    """Bindings of one element, one after the other."""
    return "".join(levels).replace("</ssd:ParameterBindings><ssd:ParameterBindings>", "")


def decorated() -> str:
    """The pair with comments, graphics and annotations."""
    geometry = '<ssd:ElementGeometry x1="0" y1="0" x2="1" y2="1"/>'
    note = '<ssd:Note x1="0" y1="0" x2="1" y2="1" text="*"/>'
    graphics = f"<ssd:GraphicalElements>{note}</ssd:GraphicalElements></ssd:System>"
    structure = flat(motor=geometry, tail=annotated("<x/>")).replace("</ssd:System>", graphics, 1)
    return re.sub("(<ssd:(Elements|Connectors|Connections)>)", r"\1<!-- a --><?b c?>", structure)


def renumbered() -> str:
    """The pair in the words of SSP 2.0."""
    parameters = values('T Float64 value="0.05";input_hold Int32 value="1"')
    news = '<ssc:MetaData kind="general" type="a" source="b"/><ssc:Signature role="a" type="b"/>'
    structure = flat(motor=bindings(parameters), tail=news).replace("ssc:Real", "ssc:Float64")
    return structure.replace('version="1.0"', 'version="2.0"')


HUNDREDTH = '<ssc:LinearTransformation factor="0.01"/>'
FROM_MS = mapping(("lag", 'target="motor.T" suppressUnitConversion="true"', HUNDREDTH))
GOOD: dict[str, tuple[str, dict[str, Any]]] = {
    "plain": (flat(), {}),
    "with comments, graphics and annotations": (decorated(), {}),
    "SSP 2.0": (renumbered(), {"motor__T": 0.05, "motor__input_hold": 1}),
    "connection from its end": (flat(ends=SPACE.format("motor", "w", "conveyor", "w")), {}),
    "enumerations by item and number": (
        flat(motor=bindings(values('characteristic Enumeration value="kloss";input_hold Integer value="1"'))),
        {"motor__characteristic": 1, "motor__input_hold": 1}),
    "higher and later bindings win": (
        flat(motor=bindings(values('T Real value="1";A Real value="7000";B Real value="190"'), values('T Real value="2";A Real value="7500"')),
            more=stacked(bindings(values('motor.T Real value="0.3"'), values('motor.T Real value="0.2"')),
                bindings(values('T Real value="0.05"'), attributes='prefix="motor."'))),
        {"motor__T": 0.05, "motor__A": 7500.0, "motor__B": 190.0}),
    "unit that only the FMU knows": (flat(conveyor=bindings(values('trough.m Real value="150" unit="kg"'))), {"conveyor__trough__m": 150.0}),
    "mapping without conversion": (flat(more=bindings(values('lag Real value="20" unit="ms"', MS), mapped=FROM_MS)), {"motor__T": 0.2}),
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_a_structure_runs_as_the_system_it_describes(name: str, fmus: Path, read: Read) -> None:
    structure, start = GOOD[name]
    same(read(structure), pair(fmus, **start))


def everything(fmus: Path, echo: Path) -> System:
    """Dotted names, every type, scaled, converted and unconverted wires."""
    ours = {"line.motor": "DriveMotor", "line.conveyor": "CrankConveyor"}
    ours |= {"chute": "GravityOrientator", "iron": "IronDrive"}
    wires = ["line.motor.tau * 1.5 - 0.25 -> line.conveyor.tau", "line.conveyor.x => line.motor.w"]
    wires += ["line.motor.tau => echo.u", "iron.top_dwell -> chute.release"]
    start = {
        "line.motor.characteristic": 1,
        "line.motor.tau": 3.0,
        "line.conveyor.rod.finite": True,
    }
    start |= {"iron.tau": 0.1, "iron.spring.side": -1, "echo.i": 7, "echo.s": "Blanks & <signs>"}
    parts = {name: fmus / f"{fmu}.fmu" for name, fmu in ours.items()} | {"echo": echo}
    return System(parts, [*wires, "iron.w_cam * 2.5 -> chute.w"], start)


def wired(network: Network) -> list[Any]:
    """The wires by the names of their ends."""
    return [(w.source.name, w.target.name, *w[2:]) for w in network.wires]


def require_valid(structure: Path) -> int:
    """The schemas of SSP 1.0 accept a structure and its parameter sets; how many of these it has."""
    schemas = Path(fmpy.__file__).with_name("ssp") / "schema"
    tree = etree.parse(str(structure))
    etree.XMLSchema(file=str(schemas / "SystemStructureDescription.xsd")).assertValid(tree)
    parameters = etree.XMLSchema(file=str(schemas / "SystemStructureParameterValues.xsd"))
    sets = list(tree.iter(f"{{{STANDARD}ParameterValues}}ParameterSet"))
    for each in sets:
        parameters.assertValid(each)
    return len(sets)


def test_what_is_written_is_read_again(fmus: Path, echo: Path, tmp_path: Path) -> None:
    system = everything(fmus, echo)
    write_ssp(system, tmp_path / "all.ssp", stop=2.0, start=0.5, step=1e-3)
    assert [path.name for path in tmp_path.iterdir()] == ["all.ssp"]
    package = read_ssp(tmp_path / "all.ssp", tmp_path / "unpacked")
    assert (package.start, package.stop, package.step) == (0.5, 2.0, 1e-3)
    assert list(package.system.parts) == list(system.parts)
    for path, name in package.system.parts.items():
        assert name.read_bytes() == Path(system.parts[path]).read_bytes()
    written, original = connect(package.system), connect(system)
    assert wired(written) == wired(original)
    assert {p.name: v for p, v in written.start} == {p.name: v for p, v in original.start}
    structure = tmp_path / "unpacked" / "SystemStructure.ssd"
    assert '<osp:FixedStepAlgorithm baseStepSize="0.001"' in structure.read_text()
    assert require_valid(structure) == 4


def test_what_omsimulator_asks_for_is_written(fmus: Path, tmp_path: Path) -> None:
    """The type of every component, and a master with the step; one that the FMUs prefer, if no other."""
    oms = "{https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd}"
    for step, expected in ((2e-4, "0.0002"), (None, "0.001")):
        write_ssp(pair(fmus), tmp_path / "pair.ssp", stop=2.0, step=step)
        with zipfile.ZipFile(tmp_path / "pair.ssp") as archive:
            root = etree.fromstring(archive.read("SystemStructure.ssd"))
        kinds = [c.get("type") for c in root.iter(f"{{{STANDARD}Description}}Component")]
        assert kinds == ["application/x-fmu-sharedlibrary"] * 2
        path = "ssd:System/ssd:Annotations/ssc:Annotation[@type='org.openmodelica']"
        note = root.find(path, {k: f"{STANDARD}{name}" for k, name in NAMES.items()})
        information = note.find(f"{oms}Annotations/{oms}SimulationInformation")
        assert (information.get("method"), information.get("fixedStepSize")) == ("oms_ma", expected)
        master = information.find(f"{oms}FixedStepMaster")
        assert (master.get("description"), master.get("stepSize")) == ("oms-ma", expected)
        assert float(master.get("relativeTolerance")) > 0.0


def test_a_step_that_nobody_prefers_is_missed_aloud(
    echo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_ssp(System({"echo": echo}, [], {"echo.u": 1.0}), tmp_path / "echo.ssp")
    assert "no step is given and no FMU prefers one: OMSimulator cannot read" in caplog.text
    assert read_ssp(tmp_path / "echo.ssp", tmp_path / "unpacked").step is None


def test_model_exchange_is_run_by_co_simulation_where_the_fmu_has_it(
    fmus: Path, read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    structure = flat().replace("DriveMotor.fmu", 'Both.fmu" implementation="ModelExchange')
    native = fmus / "native"
    package = read(structure, **{"resources/Both.fmu": native / "DriveMotor.fmu"})
    warning = "the file asks for model exchange of motor: run steps by co-simulation"
    assert warning in caplog.messages
    expected = System(
        {"motor": native / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"},
        pair(fmus).wires,
    )
    same(package, expected)


def test_model_exchange_is_read_for_the_oracle(fmus: Path, read: Read, tmp_path: Path) -> None:
    """Without co-simulation in the FMU, run says what does accept it."""
    native = fmus / "native/DriveMotor.fmu"
    without = described((r"(?s)<CoSimulation.*?</CoSimulation>", ""))
    fmu = rewritten(native, tmp_path / "Me.fmu", without)
    part = '<ssd:Component name="motor" source="Me.fmu" implementation="ModelExchange"/>'
    system = read(ssd(part), **{"Me.fmu": fmu}).system
    with pytest.raises(SetupError, match="oracle and linearize accept it as it is"):
        run(system, stop=0.1, step=0.01)
    result, expected = (
        oracle(s, stop=0.1, output_step=0.05) for s in (system, System({"motor": native}))
    )
    assert_array_equal(result["motor.tau"], expected["motor.tau"])


def test_fmus_of_the_same_name_do_not_overwrite_each_other(fmus: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "LinearSystem.fmu"
    other.parent.mkdir()
    other.write_bytes((fmus / "CrankConveyor.fmu").read_bytes())
    parts = {"a": fmus / "LinearSystem.fmu", "b": other}
    start = {f"a.u[{i}]": 0.0 for i in range(1, 5)} | {"b.tau": 8.0}
    write_ssp(System(parts, [], start), tmp_path / "two.ssp")
    system = read_ssp(tmp_path / "two.ssp", tmp_path / "unpacked").system
    names = [path.name for path in system.parts.values()]
    assert names == ["LinearSystem.fmu", "LinearSystem_2.fmu"]
    assert connect(system).descriptions["b"].modelName == "CrankConveyor"


def component(attributes: str, inner: str = "", wires: str = "", **more: str) -> str:
    return ssd(f'<ssd:Component name="part" {attributes}>{inner}</ssd:Component>', wires, **more)


def echo_connectors(first: str, kind: str) -> str:
    return connectors((first, kind, ""), ("r", "parameter", ""))


FMU, ECHO = (f'source="resources/{name}.fmu"' for name in ("DriveMotor", "Echo"))
GEARS = '<{0}:Enumerations><ssc:Enumeration name="E"><ssc:Item name="linear" value="{1}"/></ssc:Enumeration></{0}:Enumerations>'
TABLE = (
    "<ssc:BooleanMappingTransformation>"
    '<ssc:MapEntry source="true" target="false"/></ssc:BooleanMappingTransformation>'
)
LOOP = '<ssd:Component name="{}" type="application/x-ssp-definition" source="{}"/>'

BAD: dict[str, Any] = {
    "missing FMU": (component('source="resources/No.fmu"'), "SystemStructure.ssd, line 1: part: there is no file 'resources/No.fmu'"),
    "missing SSV": (flat(more='<ssd:ParameterBindings><ssd:ParameterBinding source="x.ssv"/></ssd:ParameterBindings>'), "there is no file 'x.ssv'"),
    "file outside": (component('source="../other.fmu"'), "'../other.fmu' points outside the folder"),
    "file elsewhere": (component('source="http://a.b/c.fmu"'), "only files inside the package"),
    "no FMU": (component('source="text.fmu"'), "is not a valid FMU", {"text.fmu": "text"}),
    "dangling element": (flat(ends=SPACE.format("engine", "w", "motor", "w")), "the system has no element 'engine'"),
    "dangling connector": (flat(ends=SPACE.format("conveyor", "speed", "motor", "w")), "there is no connector conveyor.speed"),
    "connector without variable": (component(FMU, connectors(("speed", "input", ""))), "part has no speed"),
    "duplicate connector": (component(FMU, connectors(("w", "input", ""), ("w", "input", ""))), "part: Connector 'w' is given twice"),
    "duplicate element": (ssd(MOTOR.format("") * 2), "Component 'motor' is given twice"),
    "driven twice": (flat(ends=ENDS + ENDS), "motor.w is also driven by conveyor.w"),
    "two outputs": (flat(ends=SPACE.format("conveyor", "w", "motor", "tau")), "output conveyor.w and output motor.tau cannot be connected"),
    "wrong kind": (component(FMU, connectors(("w", "output", ""))), "connector w must be of kind input, not output"),
    "wrong type": (component(FMU, connectors(("w", "input", "<ssc:Boolean/>"))), "connector w must be of type Real, not Boolean"),
    "wrong unit": (component(FMU, connectors(("w", "input", '<ssc:Real unit="N.m"/>'))), "connector w must be in rad/s, not N.m"),
    "types on a wire": (
        component('source="resources/CrankConveyor.fmu"', connectors(("rod.finite", "parameter", "")),
            SPACE.format("", "p", "part", "rod.finite").replace('startElement="" ', ""), more=connectors(("p", "parameter", "<ssc:Real/>"))),
        "Real p cannot drive Boolean"),
    "units on a wire": (flat(ends=SPACE.format("motor", "tau", "motor", "w")), "N.m cannot be converted to rad/s"),
    "binary": (component(FMU, connectors(("w", "input", "<ssc:Binary/>"))), "connector type Binary is not supported"),
    "unit that cannot be deduced": (
        ssd(MOTOR.format("") + system_in("line", INSIDE[0], INSIDE[2], OUTWARD.format(' suppressUnitConversion="true"/>')), W.format("line", "w", "/>")),
        "its source has no unit from which to convert to rad/s"),
    "output to parameter": (component(ECHO, echo_connectors("y", "output"), SPACE.format("part", "y", "part", "r")),
        "output part.y and parameter part.r cannot be connected"),
    "unit defined twice": (ssd(MOTOR.format(""), tail=f"<ssd:Units>{RPM}{RPM}</ssd:Units>"), "Unit 'rpm' is given twice"),
    "file missing in the FMU": (
        flat(motor='<ssd:ParameterBindings><ssd:ParameterBinding source="x.ssv" ' 'sourceBase="component"/></ssd:ParameterBindings>'),
        "there is no file 'x.ssv'"),
    "broken nested package": (component('type="application/x-ssp-package" source="b.ssp"'), "b.ssp is not a readable zip file", {"b.ssp": "no zip"}),
    "id in another file": (ssd(LOOP.format("a", "b.ssd#c")), "an id in another file, 'c', is not supported", {"b.ssd": ssd("")}),
    "mapping on a connection": (flat(ends=ENDS.replace("/>", f">{TABLE}</ssd:Connection>")),
        "BooleanMappingTransformation of a connection is not supported"),
    "model exchange": (component(f'{FMU} implementation="ModelExchange"'), "part: implementation is ModelExchange, which its FMU does not offer"),
    "component type": (component(f'{FMU} type="text/x-modelica"'), "component type 'text/x-modelica' is not supported"),
    "signal dictionary": (
        ssd(MOTOR.format("")).replace("</ssd:Elements>", '</ssd:Elements><ssd:SignalDictionaries><ssd:SignalDictionary name="bus" source="b.ssb"/></ssd:SignalDictionaries>'),
        "bus: SignalDictionary is not supported"),
    "version": (ssd("").replace('version="1.0"', 'version="3.0"'), "the version is '3.0', not 1.0 or 2.0"),
    "array of 2.0": (component(FMU, connectors(("w", "input", '<ssc:Float64/><ssc:Dimension size="2"/>'))).replace("1.0", "2.0", 1),
        "connector w[1]: part has no w[1]"),
    "annotated step": (flat(tail=annotated('<FixedStepAlgorithm baseStepSize="short"/>')), "baseStepSize 'short' is not a number"),
    "unknown element": (ssd("<ssd:Motor/>"), "SystemStructure.ssd, line 1: Element 'Motor': This element is not expected"),
    "structure of a draft": (flat().replace("org/SSP1/SystemStructureDescription", "org/SSPDraft/SystemStructureDescription"),
        "SystemStructureDescription must be in the namespace http://ssp-standard.org/SSP1/SystemStructureDescription, "
        "not in http://ssp-standard.org/SSPDraft/SystemStructureDescription"),
    "wire from a connector that the FMU has not": (
        component(FMU, connectors(("w", "input", ""), ("v", "parameter", "")), SPACE.format("", "p", "part", "v").replace('startElement="" ', ""),
            more=connectors(("p", "parameter", ""))),
        "there is no connector part.v"),
    "broken XML": (ssd("")[:-9], "SystemStructure.ssd, line 1: "),
    "cyclic files": (ssd(LOOP.format("a", "a.ssd")),
        "cyclic nesting: test.ssp -> a.ssd -> SystemStructure.ssd -> a.ssd", {"a.ssd": ssd(LOOP.format("b", "SystemStructure.ssd"))}),
    "cyclic systems": (ssd(f'<ssd:System name="a" id="a"><ssd:Elements>{LOOP.format("b", "#a")}</ssd:Elements></ssd:System>'),
        "cyclic nesting: test.ssp -> a -> a"),
    "connected to itself": (
        ssd(system_in("a", "", connectors(("i", "input", ""), ("o", "output", "")), '<ssd:Connection startConnector="i" endConnector="o"/>'),
            SPACE.format("a", "o", "a", "i")),
        "a.i is connected to itself"),
    "no such id": (ssd(LOOP.format("a", "#b")), "there is no System with the id 'b'"),
    "parameter twice": (flat(motor=bindings(values('T Real value="1";T Real value="2"'))), "Parameter 'T' is given twice"),
    "parameter type": (flat(motor=bindings(values('T Boolean value="true"'))), "parameter T: Boolean does not fit T of type Real"),
    "parameter unit": (flat(motor=bindings(values('T Real value="1" unit="N.m"'))), "parameter T: N.m cannot be converted to s"),
    "undefined unit": (flat(motor=bindings(values('T Real value="1" unit="h"'))), "unit 'h' is not defined"),
    "item": (flat(motor=bindings(values('characteristic Enumeration value="round"'))), "'round' must be one of linear, kloss"),
    "out of bounds": (flat(conveyor=bindings(values('trough.m Real value="-1"'))), "conveyor.trough.m [kg] = -1.0 must be at least"),
    "not finite": (flat(motor=bindings(values('T Real value="INF"'))), "motor.T [s] = inf must be a finite number"),
    "output of the FMU": (flat(motor=bindings(values('P Real value="1"'))), "motor.P [W] has causality output and cannot be given a start value"),
    "invalid set": (flat(motor=bindings(values('T Real value="fast"'))), "'fast' is not a valid value"),
    "set and source": (flat(motor=bindings(values('T Real value="1"'), attributes='source="x.ssv"')), "ParameterBinding has both a source and its content inline"),
    "mapped name": (flat(motor=bindings(values('T Real value="1"'), mapped=mapping(("U", 'target="T"', "")))),
        "mapping U -> T: the parameter set has no U"),
    "no entry": (flat(conveyor=bindings(values('b Boolean value="false"'), mapped=mapping(("b", 'target="rod.finite"', TABLE)))),
        "there is no entry for False"),
}  # fmt: skip


def test_dotted_names_mean_a_single_variable(fmus: Path, echo: Path, tmp_path: Path) -> None:
    """motor, kloss.tau_b and motor.kloss, tau_b would be one name."""
    odd = rewritten(echo, tmp_path / "Odd.fmu", described(('name="y"', 'name="tau_b"')))
    parts = {"motor": fmus / "DriveMotor.fmu", "motor.kloss": odd}
    with pytest.raises(SetupError, match=r"motor and motor.kloss both have a motor.kloss.tau_b"):
        connect(System(parts, [], {"motor.w": 1.0, "motor.kloss.u": 1.0}))
    parts["motor.kloss"] = echo
    network = connect(System(parts, ["motor.kloss.y -> motor.w"], {"motor.kloss.u": 1.0}))
    assert network.port("motor.kloss.y").part == "motor.kloss"
    assert network.port("motor.kloss.s_b").part == "motor"
    with pytest.raises(SetupError, match=r"motor\.kloss has no variable 'speed'"):
        network.port("motor.kloss.speed")


@pytest.mark.parametrize("name", BAD)
def test_bad_packages_are_refused(read: Read, tmp_path: Path, name: str) -> None:
    """The message names file and element, and nothing is left behind."""
    structure, message, *more = BAD[name]
    if existing := name.startswith("no"):
        (tmp_path / "unpacked").mkdir()
    with pytest.raises(SetupError) as caught:
        read(structure, **(more[0] if more else {}))
    assert str(caught.value).startswith("test.ssp: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    left = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*"))
    assert left == (["test.ssp", "unpacked"] if existing else ["test.ssp"])


def test_nothing_is_mixed_into_a_folder_in_use(fmus: Path, tmp_path: Path) -> None:
    write_ssp(pair(fmus), tmp_path / "pair.ssp")
    with pytest.raises(SetupError, match="must be an empty folder"):
        read_ssp(tmp_path / "pair.ssp", tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["pair.ssp"]
