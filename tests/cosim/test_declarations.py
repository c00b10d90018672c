"""Numbers are what a file says, or refused; what a description must not declare is named, with its line."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest

from cosim import SetupError, System, run
from cosim.numbers import real, truth, whole
from cosim.system import connect
from cosim.system.reading import read_fmu
from tests.conftest import described, rewritten
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack, single_fmu_system
from tests.cosim.third import pack as third

Edited = Callable[..., Path]


@pytest.fixture
def fmi2(tmp_path: Path) -> Edited:
    """An FMU of FMI 2.0 with other texts in its description."""
    return lambda *swaps: rewritten(
        pack(tmp_path / "A0.fmu"), tmp_path / "A.fmu", described(*swaps)
    )


@pytest.fixture
def fmi3(tmp_path: Path) -> Edited:
    """An FMU of FMI 3.0 with other texts in its description."""
    return lambda *swaps: rewritten(
        third(tmp_path / "A0.fmu"), tmp_path / "A.fmu", described(*swaps)
    )


def test_numbers_are_those_of_xml_schema() -> None:
    numbers = [" 1.5\n", ".5", "5.", "-1e-3", "+1E5", "INF", "-INF", "007"]
    assert [real(text) for text in numbers] == [
        1.5,
        0.5,
        5.0,
        -1e-3,
        1e5,
        float("inf"),
        -float("inf"),
        7.0,
    ]
    assert real("NaN") != real("NaN")
    assert [whole(text) for text in ("+3", "-0", "007", "\t12 ")] == [3, 0, 7, 12]
    assert [truth(text) for text in ("true", " false ", "1", "0")] == [True, False, True, False]
    for text in (
        "1_5",
        "٣",
        "1,5",
        "0x10",
        "0x1p3",
        "1d3",
        "",
        " ",
        "inf",
        "nan",
        "infinity",
        "1e400",
        "1 2",
        "\u00a01",
        "--1",
        "e5",
    ):
        with pytest.raises(ValueError):
            real(text)
        with pytest.raises(ValueError):
            whole(text)
    for text in ("1.0", "1e3", "2.5", "9" * 5000):
        with pytest.raises(ValueError):
            whole(text)
    for text in ("True", "yes", "TRUE", "2", "", "on"):
        with pytest.raises(ValueError):
            truth(text)


UNREADABLE = {
    "Real": (('<Real start="0.0"/>', '<Real start="1_5"/>'), "start of u: '1_5' is not a number"),
    "Integer": (('<Integer start="0"/>', '<Integer start="1e3"/>'), "start of integer_in: '1e3' is not a 32-bit integer"),
    "Boolean": (('<Boolean start="false"/>', '<Boolean start="True"/>'), "start of boolean_in: 'True' is not true or false"),
    "two starts": (('<Real start="0.0"/>', '<Real start="1 2"/>'), "start of u: '1 2' is not a number"),
    "causality": (('name="u" valueReference="0" causality="input"', 'name="u" valueReference="0" causality="inputs"'), "causality of u: [facet 'enumeration'] The value 'inputs' is not an element of the set {'parameter'"),
    "no name": (('name="u" ', ""), "there is no name"),
    "no value reference": (('name="u" valueReference="0"', 'name="u"'), "there is no valueReference of u"),
    "type": (('<Real start="0.0"/>', '<Float64 start="0.0"/>'), "u has the type Float64, which is not known, only Real"),
    "declared type": (('<Real start="0.0"/>', '<Real start="0.0" declaredType="Gears"/>'), "u has declaredType Gears, which is not defined, only Gear; did you mean Gear?"),
    "type of another kind": (('<Real start="0.0"/>', '<Real start="0.0" declaredType="Gear"/>'), "u is Real, and its declaredType Gear is Enumeration"),
    "too large an Integer": (('<Integer start="0"/>', '<Integer start="3000000000"/>'), "'3000000000' is not a 32-bit integer"),
    "too large a Real": (('<Real start="0.0"/>', '<Real start="1e400"/>'), "'1e400' is too large"),
    "bound": (('<Real start="0.0"/>', '<Real start="0.0" min="zero"/>'), "min of u: 'zero' is not a number"),
    "nominal": (('<Real start="0.0"/>', '<Real start="0.0" nominal="1_0"/>'), "nominal of u: '1_0' is not a number"),
    "reference": (('name="u" valueReference="0"', 'name="u" valueReference="1_0"'), "valueReference of u: '1_0' is not a 32-bit unsigned integer"),
    "negative reference": (('name="u" valueReference="0"', 'name="u" valueReference="-1"'), "'-1' is not a 32-bit unsigned integer"),
    "ability": (('canInterpolateInputs="true"', 'canInterpolateInputs="True"'), "canInterpolateInputs: 'True' is not true or false"),
    "item": (('name="high" value="5"', 'name="high" value="5.0"'), "value of high: '5.0' is not a 32-bit integer"),
    "unit": (("<TypeDefinitions>", '<UnitDefinitions><Unit name="m"><BaseUnit m="1" factor="1,5"/></Unit></UnitDefinitions><TypeDefinitions>'), "factor of m: '1,5' is not a number"),
    "power": (("<TypeDefinitions>", '<UnitDefinitions><Unit name="m"><BaseUnit m="1.0"/></Unit></UnitDefinitions><TypeDefinitions>'), "m of m: '1.0' is not a 32-bit integer"),
    "index 0": (('<Unknown index="6" dependencies=""/>', '<Unknown index="0"/>'), "index 0 of Outputs is not a variable: indices are 1 to"),
    "dependency beyond": (('<Unknown index="7" dependencies="1"/>', '<Unknown index="7" dependencies="1 999"/>'), "dependencies 999 of Outputs is not a variable"),
    "derivative of nothing": (("<Real/>", '<Real derivative="0"/>'), "derivative 0 of y is not a variable"),
    "no guid": ((' guid="[^"]*"', ""), "there is no guid"),
    "behind an unknown element": (("<ModelVariables>(.*)<Real start=\"0.0\"/>", r'<Vendor/><ModelVariables>\1<Real start="1_5"/>'), "'1_5' is not a number"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "command"),
    [("Real", "info"), ("Real", "run"), *((name, "check") for name in UNREADABLE)],
)
def test_what_is_no_number_is_refused_with_its_line(
    name: str, command: str, fmi2: Edited, command_output: CommandOutput
) -> None:
    """By all commands alike, in one line, where some were tracebacks and some other numbers."""
    (old, new), message = UNREADABLE[name]
    times = [] if command == "info" else ["--stop", "1", "--step", "0.1"]
    error = command_output(command, fmi2((old, new)), *times, code=2)
    assert "is not a valid FMU: modelDescription.xml, line 1: " in error and message in error


UNREADABLE_3 = {
    "UInt16": (('(name="UInt16_in".*?)start="0"', r'\1start="-1"'), "'-1' is not a 16-bit unsigned integer"),
    "Float32": (('(name="Float32_in".*?)start="0"', r'\1start="1e39"'), "'1e39' is too large for a 32-bit floating-point"),
    "array": (('(name="Float64_ins".*?)start="0"', r'\1start="0 1 x 3"'), "start of Float64_ins: 'x' is not a number"),
    "array of bytes": (('(name="UInt8_ins".*?)start="0"', r'\1start="0 1 256 3"'), "'256' is not an 8-bit unsigned integer"),
    "unknown": (('<Output valueReference="1000"', '<Output valueReference="77"'), "valueReference 77 of Output is not a variable"),
    "no token": ((' instantiationToken="third"', ""), "there is no instantiationToken"),
}  # fmt: skip


@pytest.mark.parametrize("name", UNREADABLE_3)
def test_the_types_of_fmi_3_hold_what_they_hold(
    name: str, fmi3: Edited, command_output: CommandOutput
) -> None:
    swap, message = UNREADABLE_3[name]
    error = command_output("check", fmi3(swap), "--stop", "1", "--step", "0.1", code=2)
    assert re.search(r"modelDescription\.xml, line \d+: ", error) and message in error


@pytest.mark.parametrize("text", [None, "x", "-1"])
def test_no_attribute_that_is_wrong_or_missing_is_a_traceback(
    text: str | None, fmi2: Edited, fmi3: Edited, tmp_path: Path
) -> None:
    rng = random.Random(text)
    for fmu in (fmi2(("guid", "guid")), fmi3(("third", "third"))):
        with ZipFile(fmu) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        attributes = [(element, name) for element in root.iter() for name in element.attrib]
        for element, name in rng.sample(attributes, 80):
            right = element.attrib.pop(name)
            element.attrib |= {} if text is None else {name: text}
            with ZipFile(tmp_path / "B.fmu", "w") as archive:
                archive.writestr("modelDescription.xml", ElementTree.tostring(root))
            with suppress(SetupError):
                read_fmu("B", tmp_path / "B.fmu", runnable=False)
            element.set(name, right)


WRONG_STARTS = {
    "item": ((r'start="1" declaredType', 'start="4" declaredType'), "start 4 of enumeration_in must be one of 1 (low), 2 (middle), 5 (high)"),
    "low": (('<Real start="0.0"/>', '<Real start="0.0" min="5"/>'), "start 0.0 of u must be at least 5.0"),
    "high": (('<Real start="0.0"/>', '<Real start="0.0" max="-1"/>'), "start 0.0 of u must be at most -1.0"),
    "parameter": (('<Real start="-1.0"/>', '<Real start="-1.0" min="0"/>'), "start -1.0 of a must be at least 0.0"),
    "Integer": (('<Integer start="0"/>', '<Integer start="0" min="3"/>'), "start 0 of integer_in must be at least 3"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_STARTS)
def test_start_values_of_files_are_checked_as_those_of_set(
    name: str, fmi2: Edited, command_output: CommandOutput
) -> None:
    """And may be given anew, as the one that breaks no bound."""
    swap, message = WRONG_STARTS[name]
    fmu, times = fmi2(swap), ["--stop", "1", "--step", "0.1"]
    for command in ("check", "run"):
        assert message in command_output(command, fmu, *times, code=2)
    command_output("info", fmu)
    given = {
        "enumeration_in": "5",
        "u": "7" if name == "low" else "-7",
        "a": "2",
        "integer_in": "3",
    }
    variable = message.split()[3]
    assert variable in given
    start = ["--set", f"A.{variable}={given[variable]}"]
    assert message in command_output("check", fmu, *times, *start)
    command_output("run", fmu, *times, *start)
    assert message in command_output("run", fmu, *times, *start, "--strict", code=2)


UNIT = "<UnitDefinitions>{}</UnitDefinitions><TypeDefinitions>"
METRE = '<Unit name="m"><BaseUnit m="1"{}/>{}</Unit>'
FORBIDDEN = {
    "parameter in InitialUnknowns": ((r"<InitialUnknowns>", '<InitialUnknowns><Unknown index="27"/>'), "InitialUnknowns lists x0, which has causality parameter"),
    "input in Outputs": (("<Outputs>", '<Outputs><Unknown index="1"/>'), "Outputs lists u, which has causality input"),
    "no outputs": ((r"<Outputs>.*</Outputs>", ""), "the model structure does not list the output y"),
    "an output twice": (("<Outputs>", '<Outputs><Unknown index="6"/>'), "Outputs lists y 2 times"),
    "kinds": (('<Unknown index="7" dependencies="1"/>', '<Unknown index="7" dependencies="1" dependenciesKind="constant fixed"/>'), "Outputs gives z 1 dependencies and 2 kinds"),
    "derivative": (("<InitialUnknowns>", '<Derivatives><Unknown index="6"/></Derivatives><InitialUnknowns>'), "Derivatives lists y, which is the derivative of nothing"),
    "items": (('name="middle" value="2"', 'name="middle" value="1"'), "value 1 of Gear is given twice"),
    "bounds": (("<Real/>", '<Real min="2" max="1"/>'), "y has min 2 above max 1"),
    "nominal": (("<Real/>", '<Real nominal="-1"/>'), "y has nominal -1, which must be above 0"),
    "unit twice": (("<TypeDefinitions>", UNIT.format(METRE.format("", "") + METRE.format(' factor="2"', ""))), "name m of a unit is given twice"),
    "factor 0": (("<TypeDefinitions>", UNIT.format(METRE.format(' factor="0"', ""))), "unit m has the factor 0, which must be above 0"),
    "display unit": (("<TypeDefinitions>", UNIT.format(METRE.format("", '<DisplayUnit name="mm" factor="0"/>'))), "unit mm has the factor 0"),
    "no start": (('<Real start="-1.0"/>', "<Real/>"), "a has no start, which initial exact requires"),
    "a start too many": (("<Real/>", '<Real start="1"/>'), "y must not have start 1: it is calculated"),
    "variability": ((r'(name="integer_in" [^>]*variability=)"discrete"', r'\1"continuous"'), "integer_in is Integer and must not have variability continuous"),
    "causality and variability": ((r'(name="u" [^>]*variability=)"continuous"', r'\1"fixed"'), "u has causality input and must have variability discrete or continuous, not fixed"),
    "initial": (('name="u" valueReference="0"', 'name="u" valueReference="0" initial="approx"'), "must have initial exact, not approx"),
    "unit": (("<Real/>", '<Real unit="furlong"/>'), "y has unit furlong, which is not defined: define it in UnitDefinitions"),
    "shown unit": (("<TypeDefinitions>(.*?)<Real/>", UNIT.format(METRE.format("", "")) + r'\1<Real unit="m" displayUnit="mm"/>'), "y has displayUnit mm, which is not defined for unit m"),
    "empty name": (('name="steps"', 'name=""'), "the name is empty"),
    "output and parameter": (('name="y" valueReference="1"', 'name="y" valueReference="8"'), "output y has the value reference of parameter b"),
    "input and parameter": (('name="u" valueReference="0"', 'name="u" valueReference="8"'), "parameter b has the value reference of input u"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORBIDDEN)
def test_what_the_standard_forbids_is_named_with_its_line(
    name: str, fmi2: Edited, command_output: CommandOutput
) -> None:
    swap, message = FORBIDDEN[name]
    fmu, times = fmi2(swap), ["--stop", "0.1", "--step", "0.1"]
    flaws = connect(System({"A": fmu}), runnable=False).flaws["A"]
    (flaw,) = [flaw for flaw in flaws if message in flaw]
    assert flaw.startswith("modelDescription.xml, line 1: ") or "times" in flaw
    assert "modelDescription.xml" in command_output("run", fmu, *times, "--strict", code=2)


def test_a_description_without_fault_has_no_flaws(fmi2: Edited, fmi3: Edited, fmus: Path) -> None:
    parts = {"A": fmi2(("guid", "guid")), "C": fmus / "CrankConveyor.fmu"}
    parts["B"] = rewritten(
        third(parts["A"].with_name("B0.fmu")), parts["A"].with_name("B.fmu"), described()
    )
    assert connect(System(parts), runnable=False).flaws == {}


def test_a_run_warns_of_flaws_in_one_line(fmi2: Edited, command_output: CommandOutput) -> None:
    """All of them are in the check."""
    fmu = fmi2((r"<Outputs>.*</Outputs>", ""))
    (warning,) = run(single_fmu_system(fmu), stop=0.1, step=0.1).warnings
    assert warning.endswith("; and 15 more, see cosim check")
    assert (
        command_output("check", fmu, "--stop", "1", "--step", "0.1").count(
            "does not list the output"
        )
        == 18
    )


def test_check_says_what_a_run_warns_of(fmi2: Edited, command_output: CommandOutput) -> None:
    """A flaw, and that there is nothing to record."""
    silent = (r"<Outputs>.*</Outputs>|causality=\"output\"", "")
    fmu = fmi2(silent, ("<Real/>", '<Real nominal="-1"/>'))
    warnings = run(single_fmu_system(fmu), stop=0.1, step=0.1).warnings
    said = command_output("check", fmu, "--stop", "0.1", "--step", "0.1")
    assert any("rows contain only the time" in text for text in warnings)
    assert all(text.partition("; ")[0] in said for text in warnings) and "has nominal -1" in said


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("u", "1_5"), ("u", ""), ("integer_in", "٣"), ("integer_in", "2.5"), ("boolean_in", "TRUE"),
        ("integer_in", "3000000000"), ("u", "1e400"), ("enumeration_in", "4"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("option", ["--set", "--start"])
def test_numbers_of_the_command_line_are_those_of_a_file(
    option: str, name: str, text: str, fmi2: Edited, command_output: CommandOutput
) -> None:
    start = [option, f"A.{name}={text}"]
    assert f"A.{name} " in command_output("info", fmi2(("guid", "guid")), *start, code=2)


@pytest.mark.parametrize("option", ["--stop", "--step", "--fmu-tolerance", "--output-step"])
@pytest.mark.parametrize("text", ["1_0", "1,5"])
def test_options_are_such_numbers_too(
    option: str, text: str, fmi2: Edited, command_output: CommandOutput
) -> None:
    said = command_output("check", fmi2(("guid", "guid")), option, text, code=2)
    assert f"argument {option}" in said and f": '{text}' is not a" in said


def test_a_number_of_32_bits_does_not_become_infinite(fmi3: Edited) -> None:
    """Neither a start value, nor what a wire brings."""
    fmu = fmi3(("guid|instantiationToken", "instantiationToken"))
    for value in (1e39, -1e39):
        with pytest.raises(
            SetupError, match=r"must be a 32-bit floating-point number, at most 3\.402823e\+38"
        ):
            run(System({"A": fmu}, start={"A.Float32_in": value}), stop=0.1, step=0.1)
    system = System(
        {"A": fmu, "B": fmu}, ["A.Float64_out * 1e39 -> B.Float32_in"], {"A.Float64_in": 1.0}
    )
    with pytest.raises(SetupError, match=r"B\.Float32_in cannot take 1e\+39"):
        run(system, stop=0.2, step=0.1)


def test_check_refuses_an_input_without_start(fmi2: Edited, command_output: CommandOutput) -> None:
    swap = (
        '<String start=""/></ScalarVariable><ScalarVariable name="enumeration_in"',
        '<String/></ScalarVariable><ScalarVariable name="enumeration_in"',
    )
    fmu, times = fmi2(swap), ["--stop", "1", "--step", "0.1"]
    for command in ("check", "run"):
        assert "A.string_in is not connected and has no start" in command_output(
            command, fmu, *times, code=2
        )


def test_check_finds_a_loop_without_solution(
    fmi2: Edited, tmp_path: Path, command_output: CommandOutput
) -> None:
    """z = x + d u, and u = z with d = 1: no u has x = 1."""
    fmu, times = fmi2(("guid", "guid")), ["--stop", "1", "--step", "0.1"]
    wired = ["--wire", "A.z -> A.u", "--set", "A.d=1", "--algorithm", "iterated"]
    text = "the start values of an algebraic loop were not found"
    assert text in command_output("check", f"A={fmu}", *wired, *times, code=1)
    assert text in command_output("run", f"A={fmu}", *wired, *times, code=2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("5 A.u=1", "5.0 s is not in the run, from 0.0 to 1.0 s"),
        ("-1 A.u=1", "-1.0 s is not in the run"),
        ("0.5 A.u=1_0", "A.u = '1_0' must be a finite number"),
        ("0.5 A.u=1ms", "A.u cannot be given in ms"),
    ],
)
def test_a_change_that_does_nothing_is_refused(
    change: str, message: str, fmi2: Edited, command_output: CommandOutput
) -> None:
    times = ["--stop", "1", "--step", "0.1", "--at", change]
    assert message in command_output("run", fmi2(("guid", "guid")), *times, code=2)


def test_a_change_takes_units_as_a_start_value_does(fmus: Path) -> None:
    system = System({"m": fmus / "DriveMotor.fmu"}, changes=["at 0.5 s m.w = 300rpm"])
    result = run(system, stop=1.0, step=0.1, record=["m.w"])
    assert result["m.w"][-1] == pytest.approx(10.0 * 3.141592653589793)


def test_python_reads_texts_as_the_command_line_does(fmus: Path) -> None:
    """A start value in quotes, with a unit or without."""
    for text in ("50ms", "0.05", "5e-2 s"):
        network = connect(System({"m": fmus / "DriveMotor.fmu"}, start={"m.T": text}))
        (value,) = (value for port, value in network.start if port.name == "m.T")
        assert value == pytest.approx(0.05, rel=1e-15)
    with pytest.raises(
        SetupError, match=r"m\.T \[s\] = '5x' must be a finite number|cannot be given in x"
    ):
        connect(System({"m": fmus / "DriveMotor.fmu"}, start={"m.T": "5x"}))


@pytest.mark.parametrize(("command", "code"), [("run", 2), ("check", 1)])
def test_an_fmu_for_model_exchange_is_not_asked_for_times_first(
    command: str, code: int, fmi2: Edited, command_output: CommandOutput
) -> None:
    fmu = fmi2((r"<CoSimulation [^>]*/>", '<ModelExchange modelIdentifier="foreign"/>'))
    assert "offers model exchange only" in command_output(command, fmu, code=code)


def test_what_is_asynchronous_is_said_before(fmi2: Edited, command_output: CommandOutput) -> None:
    fmu = fmi2(("<CoSimulation ", '<CoSimulation canRunAsynchronuously="true" '))
    text = "a step that goes on after doStep has returned is not supported"
    assert text in command_output("check", fmu, "--stop", "1", "--step", "0.1")
    assert "may step asynchronously" in command_output("info", fmu)
