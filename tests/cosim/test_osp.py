"""OSP system structures: what is written is read again to the bit; what libcosim's own files hold."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from cosim import (
    SetupError,
    System,
    Wire,
    read_osp,
    read_ssp,
    run,
    write_container,
    write_osp,
    write_ssp,
)
from cosim.system import connect
from tests.cosim.conftest import CommandOutput
from tests.cosim.test_cosim import halves
from tests.cosim.test_ssp import everything, pair, ssd
from tests.cosim.test_ssp import wired as ends

FILE = "OspSystemStructure.xml"
SPACE = "http://opensimulationplatform.com/MSMI/OSPSystemStructure"


def osp(inner: str, connections: str = "", functions: str = "", times: str = "") -> str:
    """A system structure of these pieces."""
    return (
        f'<OspSystemStructure xmlns="{SPACE}" version="0.1">{times}<Simulators>{inner}</Simulators>'
        f"<Functions>{functions}</Functions><Connections>{connections}</Connections>"
        "</OspSystemStructure>"
    )


def simulator(name: str, fmu: str, values: str = "", more: str = "") -> str:
    """A simulator; values as 'name Type value;...'."""
    rows = "".join(
        '<InitialValue variable="{}"><{} value="{}"/></InitialValue>'.format(*row.split())
        for row in filter(None, values.split(";"))
    )
    return (
        f'<Simulator name="{name}" source="{fmu}.fmu" {more}>'
        f"<InitialValues>{rows}</InitialValues></Simulator>"
    )


def wired(*ends: tuple[str, str], bond: str = "", kind: str = "Variable") -> str:
    """A connection of variables or, where an owner is "f", of signals of a function."""
    inner = "".join(
        f'<Signal function="f" name="{name}"/>'
        if owner == "f"
        else f'<Variable simulator="{owner}" name="{name}"/>'
        for owner, name in ends
    )
    bond = f' powerBond="{bond}"' if bond else ""
    return f"<{kind}Connection{bond}>{inner}</{kind}Connection>"


MOTOR, CONVEYOR = simulator("motor", "DriveMotor"), simulator("conveyor", "CrankConveyor")
TAU = wired(("motor", "tau"), ("conveyor", "tau"))
W = wired(("motor", "w"), ("conveyor", "w"))


@pytest.fixture
def structure_folder(fmus: Path, tmp_path: Path) -> Path:
    """A folder of FMUs for a system structure."""
    for path in (*(fmus / "native").glob("*.fmu"), fmus / "LinearSystem.fmu"):
        (tmp_path / path.name).symlink_to(path)
    return tmp_path


def test_what_is_written_is_read_again(fmus: Path, echo: Path, tmp_path: Path) -> None:
    """Names, values of every type, factors, offsets and wires of other units; and the same bits."""
    system = everything(fmus, echo)
    enumerations = ("line.motor.characteristic", "iron.spring.side")
    start = {name: value for name, value in system.start.items() if name not in enumerations}
    write_osp(System(system.parts, system.wires, start), tmp_path, step=1e-3, start=0.5, stop=2.0)
    package = read_osp(tmp_path)
    assert (package.start, package.stop, package.step) == (0.5, 2.0, 1e-3)
    written, original = connect(package.system), connect(System(system.parts, system.wires, start))
    assert ends(written) == ends(original)
    preserved = {p.name: v for p, v in written.start if p.name in start}
    assert {p.name: v for p, v in original.start} == preserved
    ours, theirs = (run(s, stop=0.1, step=1e-3) for s in (original.system, package.system))
    assert_array_equal(ours.data, theirs.data)


@pytest.mark.parametrize("name", ["", FILE])
def test_a_folder_and_its_file_run_with_the_step_that_they_state(
    name: str, structure_folder: Path, command_output: CommandOutput
) -> None:
    times = "<StartTime>0.5</StartTime><EndTime>0.7</EndTime><BaseStepSize>0.002</BaseStepSize>"
    (structure_folder / FILE).write_text(osp(MOTOR + CONVEYOR, TAU + W, times=times))
    assert "strang, steps of 0.002 s: 100 steps" in command_output(
        "run", structure_folder / name, "--out", structure_folder / "out.csv"
    )
    assert "communication step: 0.002 s, given by the file" in command_output(
        "check", structure_folder / name
    )
    command_output = command_output("info", structure_folder / name)
    assert "default experiment: 0.5 to 0.7 s\ncommunication step: 0.002 s\n" in command_output


def test_connections_functions_and_bonds(fmus: Path, structure_folder: Path) -> None:
    """A function of two targets, a connection written from its end, a bond, an open input."""
    scale = '<LinearTransformation name="f" factor="0.5" offset="-1"/>'
    half = wired(("motor", "tau"), ("f", "in"), kind="Signal")
    half += "".join(wired(("f", "out"), (c, "tau"), kind="Signal") for c in ("conveyor", "other"))
    other = simulator("other", "CrankConveyor", "trough.m Real 150;rod.finite Boolean 1")
    elements = MOTOR + CONVEYOR + other + simulator("free", "LinearSystem", "u[2] Real 0.25")
    (structure_folder / FILE).write_text(osp(elements, half + W, scale))
    system = read_osp(structure_folder / FILE).system
    assert [*map(str, system.wires)] == [
        "motor.tau * 0.5 - 1.0 -> conveyor.tau",
        "motor.tau * 0.5 - 1.0 -> other.tau",
        "conveyor.w -> motor.w",
    ]
    assert system.start["other.rod.finite"] is True
    assert system.start["free.u[2]"] == 0.25
    assert [p.name for p, _ in connect(system).open] == [f"free.u[{i}]" for i in (1, 3, 4)]
    bonded = [wired(("motor", "tau"), ("conveyor", "tau"), bond="b")]
    bonded += [wired(("motor", "w"), ("conveyor", "w"), bond="b")]
    (structure_folder / FILE).write_text(osp(MOTOR + CONVEYOR, "".join(bonded)))
    system = read_osp(structure_folder).system
    assert system.bonds == ["motor.tau * conveyor.w"]
    result = run(system, stop=0.02, step=1e-3)
    assert_array_equal(result.data, run(pair(fmus / "native"), stop=0.02, step=1e-3).data)


GROUPS = """<OspModelDescription xmlns="{}" version="1.0"><VariableGroups>
<RotationalMechanicalPort name="shaft"><Torque name="moment"><Variable ref="tau"/></Torque>
<AngularVelocity name="speed"><Variable ref="w"/></AngularVelocity></RotationalMechanicalPort>
</VariableGroups></OspModelDescription>"""


def grouped(*names: str) -> str:
    """A bond of two groups, of the motor and the conveyor."""
    pairs = zip(("motor", "conveyor"), names)
    ends = "".join(f'<VariableGroup simulator="{part}" name="{name}"/>' for part, name in pairs)
    return f'<VariableGroupConnection powerBond="b">{ends}</VariableGroupConnection>'


def test_groups_are_connected_variable_by_variable(structure_folder: Path) -> None:
    """In the order of their file, which stands beside the FMU."""
    for name in ("DriveMotor", "CrankConveyor"):
        text = GROUPS.format("http://opensimulationplatform.com/MSMI/OSPModelDescription")
        (structure_folder / f"{name}_OspModelDescription.xml").write_text(text)
    (structure_folder / FILE).write_text(osp(MOTOR + CONVEYOR, grouped("shaft", "shaft")))
    system = read_osp(structure_folder).system
    assert [*map(str, system.wires)] == ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    assert system.bonds == ["motor.tau * conveyor.w"]
    for names, message in (
        (("shaft", "moment"), "groups of 2 and 1 variables, not two of the same size"),
        (("shaft", "axle"), "there is no 'conveyor.axle'"),
    ):
        (structure_folder / FILE).write_text(osp(MOTOR + CONVEYOR, grouped(*names)))
        with pytest.raises(SetupError, match=rf"line 1: VariableGroupConnection: {message}"):
            read_osp(structure_folder)


@pytest.mark.parametrize("factor", ["", " * 0.5"])
def test_bonds_are_written_and_read(
    factor: str, fmus: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """But one that goes through a function, for which an OSP structure has no place."""
    plain = pair(fmus / "native")
    wires = [f"motor.tau{factor} -> conveyor.tau", "conveyor.w -> motor.w"]
    system = System(plain.parts, wires, bonds=["motor.tau * conveyor.w"])
    write_osp(system, tmp_path / "osp", step=1e-3)
    assert read_osp(tmp_path / "osp").system.bonds == ([] if factor else system.bonds)
    left = "bond motor.tau * conveyor.w goes through a function and is left out"
    assert caplog.messages == ([left] if factor else [])
    write_ssp(system, tmp_path / "pair.ssp")
    assert read_ssp(tmp_path / "pair.ssp", tmp_path / "ssp").system.bonds == system.bonds
    inner = (tmp_path / "ssp" / "SystemStructure.ssd").read_text()
    assert inner.index("</ssd:Connections>") < inner.index("Bond>")
    nested = '<ssd:Component name="line" type="application/x-ssp-package" source="pair.ssp"/>'
    (tmp_path / "SystemStructure.ssd").write_text(ssd(nested))
    read = read_ssp(tmp_path / "SystemStructure.ssd", tmp_path / "nested")
    assert read.system.bonds == ["line.motor.tau * line.conveyor.w"]


def test_names_that_no_part_can_have_are_changed(structure_folder: Path) -> None:
    motor = simulator("DP motor", "DriveMotor", "T Real 0.05")
    wires = wired(("DP motor", "tau"), ("conveyor", "tau"))
    (structure_folder / FILE).write_text(osp(motor + CONVEYOR, wires))
    system = read_osp(structure_folder).system
    assert [*map(str, system.wires)] == ["DP_motor.tau -> conveyor.tau"]
    assert system.start["DP_motor.T"] == 0.05


def test_numbers_pass_wires_as_they_stand(structure_folder: Path) -> None:
    """A torque as a speed: libcosim knows no units."""
    (structure_folder / FILE).write_text(osp(MOTOR, wired(("motor", "tau"), ("motor", "w"))))
    assert [*map(str, read_osp(structure_folder).system.wires)] == ["motor.tau => motor.w"]


@pytest.mark.parametrize(
    ("step", "substeps", "message"),
    [
        ("0.002", {}, ""),
        ("0.001", {"motor": 2}, ""),
        ("0.0006666666666666667", {"motor": 3}, ""),
        ("0.0015", {"motor": 2}, "stepSize 0.0015 s becomes 0.001 s, the BaseStepSize of 0.002 s in 2 steps"),
        ("0.004", {}, "stepSize 0.004 s becomes 0.002 s, the BaseStepSize of 0.002 s in 1 step"),
    ],
)  # fmt: skip
def test_steps_of_single_simulators_become_substeps(
    step: str,
    substeps: dict[str, int],
    message: str,
    structure_folder: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """None of them longer than its own step; aloud where the two differ."""
    motor = simulator("motor", "DriveMotor", more=f'stepSize="{step}"')
    (structure_folder / FILE).write_text(osp(motor, times="<BaseStepSize>0.002</BaseStepSize>"))
    with caplog.at_level(logging.WARNING, "cosim"):
        package = read_osp(structure_folder)
    assert (package.step, package.substeps) == (0.002, substeps)
    assert caplog.messages == ([f"motor: {message}"] if message else [])


def test_steps_without_a_base_step_are_ignored_aloud(
    structure_folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    motor = simulator("motor", "DriveMotor", more='stepSize="0.004"')
    ecco = "<EccoConfiguration><SafetyFactor>0.9</SafetyFactor></EccoConfiguration>"
    text = osp(motor, times="<Algorithm>ecco</Algorithm>")
    text = text.replace("</OspSystemStructure>", f"{ecco}</OspSystemStructure>")
    (structure_folder / FILE).write_text(text)
    with caplog.at_level(logging.WARNING, "cosim"):
        assert read_osp(structure_folder).substeps == {}
    assert "motor: stepSize 0.004 s is ignored: there is no BaseStepSize" in caplog.messages
    assert "algorithm ecco is ignored" in caplog.messages


def test_the_shell_takes_the_substeps_of_a_file(
    structure_folder: Path, command_output: CommandOutput
) -> None:
    """As if they were asked for; not for another step than the file's, and not over --substeps."""
    slow = simulator("motor", "DriveMotor", more='stepSize="0.0005"')
    times = "<EndTime>0.1</EndTime><BaseStepSize>0.002</BaseStepSize>"

    def rows(part: str, *options: str) -> bytes:
        (structure_folder / FILE).write_text(osp(part + CONVEYOR, TAU + W, times=times))
        out = structure_folder / "out.csv"
        command_output("run", structure_folder, "--out", out, "--algorithm", "jacobi", *options)
        return out.read_bytes()

    assert rows(slow) == rows(MOTOR, "--substeps", "motor=4") != rows(MOTOR)
    for options in (("--substeps", "motor=1"), ("--step", "0.001")):
        assert rows(slow, *options) == rows(MOTOR, *options)


def test_a_sum_is_as_many_wires_into_the_same_input(structure_folder: Path) -> None:
    """Through further functions: 2 (motor + half the other - 1) + 3 + motor."""
    functions = """<LinearTransformation name="half" factor="0.5" offset="-1"/>
    <Sum name="first" inputCount="2"/><LinearTransformation name="twice" factor="2" offset="3"/>
    <Sum name="last" inputCount="2"/>"""
    routes = [("motor", "first", "in[0]"), ("other", "half", "in"), ("motor", "last", "in[1]")]
    routes += [("conveyor", "last", "out"), ("", "first", "in[1]"), ("", "twice", "in")]
    ends = [f'Variable simulator="{part}" name="tau"' for part, _, _ in routes]
    ends[4:] = [f'Signal function="{name}" name="out"' for name in ("half", "first", "twice")]
    connections = "".join(
        f'<SignalConnection><{end}/><Signal function="{f}" name="{signal}"/></SignalConnection>'
        for end, (_, f, signal) in zip(ends, [*routes, ("", "last", "in[0]")])
    )
    elements = MOTOR + CONVEYOR + simulator("other", "DriveMotor")
    (structure_folder / FILE).write_text(osp(elements, connections, functions))
    system = read_osp(structure_folder).system
    assert [*map(str, system.wires)] == [
        "motor.tau * 3.0 + 3.0 => conveyor.tau",
        "other.tau - 2.0 +=> conveyor.tau",
    ]
    assert [Wire.read(str(wire)) for wire in system.wires] == [
        wire._replace(source=".".join(wire.source), target=".".join(wire.target))
        for wire in system.wires
    ]


def test_a_sum_of_vectors_is_a_sum_of_each_of_their_elements(structure_folder: Path) -> None:
    space = "http://opensimulationplatform.com/MSMI/OSPModelDescription"
    three = "".join(f'<Variable ref="u[{i}]"/>' for i in (1, 2, 3))
    groups = "".join(
        f'<Generic name="u">{three}</Generic>'.replace("u", name) for name in ("u", "y", "z")
    )
    (structure_folder / "LinearSystem_OspModelDescription.xml").write_text(
        f'<OspModelDescription xmlns="{space}" version="1.0"><VariableGroups>{groups}'
        "</VariableGroups></OspModelDescription>"
    )
    connections = "".join(
        f'<SignalGroupConnection><VariableGroup simulator="{part}" name="{group}"/>'
        f'<SignalGroup function="f" name="{signal}"/></SignalGroupConnection>'
        for part, group, signal in (("a", "y", "in[0]"), ("b", "z", "in[1]"), ("c", "u", "out"))
    )
    parts = "".join(simulator(name, "LinearSystem") for name in "abc")
    function = '<VectorSum name="f" inputCount="2" dimension="3"/>'
    (structure_folder / FILE).write_text(osp(parts, connections, function))
    assert [*map(str, read_osp(structure_folder).system.wires)] == [
        f"{source}[{i}] {arrow} c.u[{i}]"
        for i in (1, 2, 3)
        for source, arrow in (("a.y", "=>"), ("b.z", "+=>"))
    ]


def test_a_sum_that_is_written_is_read_again(fmus: Path, tmp_path: Path) -> None:
    """Other formats have no place for it, and libcosim none for factors in it."""
    system = halves(fmus / "native")
    write_osp(system, tmp_path / "osp", step=1e-3)
    systems = (system, read_osp(tmp_path / "osp").system)
    ours, theirs = (run(s, stop=0.02, step=1e-3, algorithm="jacobi") for s in systems)
    assert_array_equal(ours.data, theirs.data)
    container = partial(write_container, step=1e-3)
    for write, where in ((write_ssp, "an .ssp"), (container, "a container")):
        with pytest.raises(SetupError, match=f"is a sum of wires, which {where} cannot express"):
            write(system, tmp_path / "file")
    scaled = replace(system, wires=[system.wires[0], "other.tau * 2 +> conveyor.tau"])
    with pytest.raises(
        SetupError, match=r"other\.tau \[N\.m\] has a factor, .* adds outputs only as they are"
    ):
        write_osp(scaled, tmp_path / "osp", step=1e-3)


LINE = f"{FILE}, line 1: "
BAD: dict[str, tuple[str, str]] = {
    "other XML": ("<html/>", f"{FILE}: the element must be OspSystemStructure, not html"),
    "broken XML": (osp(MOTOR)[:-9], LINE),
    "no parts": (osp(""), "a system needs a part"),
    "no name": ('<Simulator source="a"/>', f"{LINE}Simulator: there is no 'name'"),
    "no FMU": (simulator("a", "No"), f"{LINE}Simulator a: there is no file 'No.fmu'"),
    "proxy": (simulator("a", "proxyfmu://localhost?file=a"), "is not supported, only files"),
    "same name": (MOTOR + MOTOR, "Simulator motor: there are two elements motor"),
    "variable": (simulator("motor", "DriveMotor", "X Real 1"), "InitialValue X: there is no 'motor.X'"),
    "number": (simulator("motor", "DriveMotor", "T Real x"), "'x' is not a number"),
    "truth": (simulator("motor", "DriveMotor", "T Boolean yes"), "InitialValue T: 'yes' is not true or false"),
    "type": (simulator("motor", "DriveMotor", "T Boolean true"), "motor.T: Boolean does not fit T"),
    "time": (osp(MOTOR, times="<StartTime>soon</StartTime>"), "StartTime: 'soon' is not a number"),
    "sum of nothing": (osp(MOTOR, wired(("f", "out"), ("motor", "w"), kind="Signal"),
        '<Sum name="f" inputCount="2"/>'), "nothing drives function f.in[0], which drives motor.w"),
    "empty sum": (osp(MOTOR, functions='<Sum name="s" inputCount="0"/>'),
        f"{LINE}Sum s: inputCount and dimension must be at least 1"),
    "endless sum": (osp(MOTOR, functions='<Sum name="s" inputCount="1000000000"/>'),
        f"{LINE}Sum s: the system has too many elements"),
    "sum of itself": (osp(MOTOR, wired(("f", "out"), ("f", "in[0]"), kind="Signal")
        + wired(("f", "out"), ("motor", "w"), kind="Signal"), '<Sum name="f" inputCount="1"/>'),
        "function f.out is added to itself"),
    "sum with an input missing": (osp(MOTOR + CONVEYOR, wired(("f", "out"), ("motor", "w"), kind="Signal")
        + wired(("f", "in[0]"), ("conveyor", "w"), kind="Signal"), '<Sum name="f" inputCount="2"/>'),
        "nothing drives function f.in[1], which drives motor.w"),
    "element of a group": (osp(MOTOR, '<SignalGroupConnection><SignalGroup function="f" name="in[2]"/>'
        '<SignalGroup function="f" name="out"/></SignalGroupConnection>',
        '<VectorSum name="f" inputCount="2" dimension="3"/>'), "groups of 0 and 3 variables"),
    "switch": (osp(MOTOR, functions='<Switch name="s"/>'), f"{LINE}Switch s: is not supported"),
    "groups": (osp(MOTOR, wired(kind="VariableGroup")), "VariableGroupConnection: groups of no variables, not two"),
    "element": ("<Motor/>", f"{LINE}Motor: is not supported"),
    "two outputs": (osp(MOTOR + CONVEYOR, wired(("motor", "tau"), ("conveyor", "w"))),
        "output motor.tau and output conveyor.w cannot be connected"),
    "end": (osp(MOTOR, wired(("motor", "tau"), ("engine", "w"))), "there is no 'engine'"),
    "twice": (osp(MOTOR + CONVEYOR, W + W), "motor.w is also driven by conveyor.w"),
    "function of nothing": (osp(MOTOR, wired(("f", "out"), ("motor", "w"), kind="Signal"),
        '<LinearTransformation name="f"/>'), "nothing drives function f.in, which drives motor.w"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_structures_are_refused(name: str, structure_folder: Path) -> None:
    """In one line, with file and line of the element."""
    text, message = BAD[name]
    (structure_folder / FILE).write_text(text if "Osp" in text or "html" in text else osp(text))
    with pytest.raises(SetupError) as caught:
        read_osp(structure_folder)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_structure_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=rf"there is no file '{FILE}'"):
        read_osp(tmp_path)
