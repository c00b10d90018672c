"""The checker of the SSP standard: what we write keeps it, and each broken clause is named."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim import SetupError, write_ssp
from cosim.formats.ssp.rules import Severity
from cosim.formats.ssp.standard import check_standard
from tests.cosim.conftest import CommandOutput
from tests.cosim.test_linearize import conveyor
from tests.fmukit.test_native import built

HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" '
    'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" '
    'xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" '
    'xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping" '
    'xmlns:ssb="http://ssp-standard.org/SSP1/SystemStructureSignalDictionary" name="n" version="{}">\n'
)
SYSTEM = """<ssd:System name="s">
<ssd:Connectors><ssd:Connector name="u" kind="input"><ssc:Real unit="rad"/></ssd:Connector>
<ssd:Connector name="y" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors>
<ssd:Elements>
<ssd:Component name="a" source="gone.fmu"><ssd:Connectors>
<ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector>
<ssd:Connector name="out" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors>
<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>
<ssv:Parameter name="k"><ssv:Real value="1"/></ssv:Parameter>
<ssv:Parameter name="l"><ssv:Real value="2"/></ssv:Parameter>
</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues>
<ssd:ParameterMapping><ssm:ParameterMapping version="1.0">
<ssm:MappingEntry source="k" target="K"/><ssm:MappingEntry source="l" target="L"/>
</ssm:ParameterMapping></ssd:ParameterMapping></ssd:ParameterBinding></ssd:ParameterBindings></ssd:Component>
<ssd:Component name="b" source="gone.fmu"><ssd:Connectors>
<ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector>
<ssd:Connector name="out" kind="output"><ssc:Enumeration name="mode"/></ssd:Connector></ssd:Connectors></ssd:Component>
</ssd:Elements>
<ssd:Connections>
<ssd:Connection startConnector="u" endElement="a" endConnector="in"/>
<ssd:Connection startElement="a" startConnector="out" endElement="b" endConnector="in"/>
<ssd:Connection startElement="a" startConnector="out" endConnector="y"/>
</ssd:Connections>
<ssd:SystemGeometry x1="0" y1="0" x2="1" y2="1"/>
</ssd:System>
<ssd:Enumerations><ssc:Enumeration name="mode"><ssc:Item name="off" value="0"/></ssc:Enumeration></ssd:Enumerations>
<ssd:Units><ssc:Unit name="rad"><ssc:BaseUnit rad="1"/></ssc:Unit></ssd:Units>
</ssd:SystemStructureDescription>
"""

BROKEN: dict[str, tuple[str, str, str]] = {
    "a unit that is not defined": ('unit="rad"', 'unit="turn"', "4.4.2"),
    "a unit that is defined twice": (
        "<ssd:Units>", '<ssd:Units><ssc:Unit name="rad"><ssc:BaseUnit/></ssc:Unit>', "4.4.2",
    ),
    "an enumeration that is not defined": ('<ssc:Enumeration name="mode"/>', '<ssc:Enumeration name="other"/>', "4.4.1"),
    "two elements of a name": ('<ssd:Component name="b"', '<ssd:Component name="a"', "5.2 "),
    "two connectors of a name": (
        '<ssd:Connector name="out" kind="output"><ssc:Real/>', '<ssd:Connector name="in" kind="output"><ssc:Real/>', "5.2.1",
    ),
    "an element that is not there": ('endElement="b"', 'endElement="c"', "5.3.2 "),
    "a connector that is not there": ('endElement="b" endConnector="in"', 'endElement="b" endConnector="x"', "5.2.1"),
    "two outputs that are connected": ('endElement="b" endConnector="in"', 'endElement="b" endConnector="out"', "5.3.2.1"),
    "an input that is driven twice": (
        "</ssd:Connections>",
        '<ssd:Connection startElement="a" startConnector="out" endElement="a" endConnector="in"/></ssd:Connections>',
        "5.3.2.1",
    ),
    "a geometry upside down": ('x1="0"', 'x1="2"', "5.3.4"),
    "two parameters of a name": ('<ssv:Parameter name="l">', '<ssv:Parameter name="k">', "6.2"),
    "two parameters mapped to one": ('target="L"', 'target="K"', "7.1.1"),
    "a binding without content": (
        "<ssd:ParameterBinding>", "<ssd:ParameterBinding/><ssd:ParameterBinding>", "5.2.3 ",
    ),
    "an attribute of nobody": ('<ssd:Component name="a"', '<ssd:Component color="red" name="a"', "5, 6"),
    "a system of no document": ('source="gone.fmu"', 'source="#gone"', "5.4"),
    "a value within a binding that is no number": ('<ssv:Real value="1"/>', '<ssv:Real value="fast"/>', "5, 6"),
    "a version of nobody": ('version="1.0">\n<ssd:System ', 'version="3.0">\n<ssd:System ', "5.1"),
    "a dictionary that is not there": (
        "</ssd:Elements>", '<ssd:SignalDictionaryReference name="r" dictionary="d"/></ssd:Elements>', "5.5",
    ),
}  # fmt: skip


def written(folder: Path, text: str) -> Path:
    """A system structure description with this text."""
    path = folder / "SystemStructure.ssd"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_a_correct_description_has_no_finding_of_the_standard(tmp_path: Path, version: str) -> None:
    report = check_standard(written(tmp_path, HEAD.format(version) + SYSTEM))
    assert report.passed, report.text()
    assert {f.severity for f in report.findings} <= {Severity.TOOL, Severity.MISSING}


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_clause_is_named(tmp_path: Path, name: str, version: str) -> None:
    """Alone: nothing else is reported as an error."""
    old, new, clause = BROKEN[name]
    text = HEAD.format("1.0") + SYSTEM
    assert old in text
    text = text.replace(old, new, 1)
    if version == "2.0" and clause != "5.1":
        text = text.replace('name="n" version="1.0"', 'name="n" version="2.0"')
    report = check_standard(written(tmp_path, text))
    errors = [f for f in report.findings if f.severity is Severity.ERROR]
    assert errors and not report.passed
    allowed = {clause, "5, 6"} if "geometry" not in name else {clause}
    if name.startswith("two "):
        allowed |= {"5.2.1", "5.3.2"}
    assert any(f.clause.startswith(clause) for f in errors), report.text()
    assert all(f.clause.startswith(tuple(allowed)) for f in errors), report.text()
    assert all(f.line > 0 for f in errors)


def test_a_finding_names_an_element_with_braces_and_a_folder_is_no_parameter_source(
    tmp_path: Path,
) -> None:
    old = '<ssd:Component name="a" source="gone.fmu"><ssd:Connectors>'
    double = '<ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector>'
    text = SYSTEM.replace(old, old.replace('"a"', '"a{b}"') + double)
    text = text.replace("<ssd:ParameterBinding><", '<ssd:ParameterBinding source="set"><')
    (tmp_path / "set").mkdir()
    report = check_standard(written(tmp_path, HEAD.format("1.0") + text))
    assert "a{b}: Connector 'in' is given twice" in report.text()
    assert "a{b}: there is no file 'set'" in report.text()


def test_what_is_written_keeps_the_standard(
    native: Path, fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """Packages of SSP 1.0 and of 2.0, with FMUs of FMI 2.0 and 3.0, whose connectors are their variables."""
    for name in ("DriveMotor", "CrankConveyor"):
        built(name)
    for folder in (native, fmus / "fmi3"):
        path = tmp_path / "drive.ssp"
        write_ssp(conveyor(folder, motor__T=0.05), path, stop=1.0)
        report = check_standard(path)
        assert report.passed, report.text()
        assert "keeps the SSP standard" in command_output("check", path, "--standard")


def edited(package: Path, copy: Path, edit: Callable[[str], str], **options: int) -> Path:
    """A copy of a package whose description is edited."""
    with zipfile.ZipFile(package) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "SystemStructure.ssd":
                content = edit(content.decode()).encode()
            target.writestr(name, content, **options)
    return copy


def test_connectors_are_compared_with_the_fmu(
    native: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    package = tmp_path / "drive.ssp"
    write_ssp(conveyor(native), package, stop=1.0)
    other = edited(
        package,
        tmp_path / "b.ssp",
        lambda t: re.sub(r'name="tau"', 'name="torque"', t).replace(
            'Connector="tau"', 'Connector="torque"'
        ),
    )
    text = command_output("check", other, "--standard", code=1)
    assert "5.2.1 Connectors" in text and "the FMU has no variable 'torque'" in text
    other = edited(
        package, tmp_path / "c.ssp", lambda t: t.replace('kind="input"', 'kind="parameter"')
    )
    assert "of causality input in the FMU" in command_output("check", other, "--standard", code=1)
    other = edited(package, tmp_path / "d.ssp", str, compress_type=zipfile.ZIP_LZMA)
    assert "neither stored nor deflated" in command_output("check", other, "--standard", code=1)


def test_what_other_tools_cannot_read_is_no_error(tmp_path: Path) -> None:
    """A prefix of one's own, which libcosim and Ecos do not know."""
    text = (HEAD.format("1.0") + SYSTEM).replace("ssd:", "d:").replace("xmlns:ssd=", "xmlns:d=")
    report = check_standard(written(tmp_path, text))
    assert report.passed
    assert {f.clause for f in report.findings} >= {"libcosim", "Ecos"}


def test_what_is_no_file_of_ssp_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"must be an \.ssp"):
        check_standard(tmp_path / "a.zip")
    with pytest.raises(SetupError, match="no file"):
        check_standard(tmp_path / "a.ssp")
    report = check_standard(written(tmp_path, "<html/>"))
    assert not report.passed and "not the root of an SSP file" in report.text()
