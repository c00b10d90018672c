"""Units are what they are defined as, not what they are called, wherever two of them meet."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim import Series, SetupError, System, run
from cosim.formats.ssp.read import read_ssp
from cosim.formats.ssp.write import write_ssp
from cosim.formats.values import read_values
from cosim.system import Network, connect, conversion_to
from cosim.system.base_units import BaseUnit, Unit, common_unit, unit_conversion
from tests.conftest import described, rewritten

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="x"><ssv:Parameters>"""
VALUE = (
    '<ssv:Parameter name="{0}"><ssv:Real value="{1}" unit="{2}"/></ssv:Parameter></ssv:Parameters>'
)
UNITS = (
    '<ssv:Units><ssc:Unit name="{0}"><ssc:BaseUnit {1}/></ssc:Unit></ssv:Units></ssv:ParameterSet>'
)
TORQUE = re.escape('<BaseUnit kg="1" m="2" s="-2" />')
Make = Callable[..., Path]


@pytest.fixture
def motor(fmus: Path, tmp_path: Path) -> Make:
    """The motor whose model description was edited."""

    def make(*swaps: tuple[str, str], name: str = "Motor") -> Path:
        return rewritten(fmus / "DriveMotor.fmu", tmp_path / f"{name}.fmu", described(*swaps))

    return make


def defines(unit: str, base: str, display: str = "") -> tuple[str, str]:
    """An edit by which an FMU defines a unit so."""
    pattern = rf'(?s)<Unit name="{re.escape(unit)}">.*?</Unit>'
    return pattern, f'<Unit name="{unit}">{f"<BaseUnit {base}/>" if base else ""}{display}</Unit>'


@pytest.mark.parametrize(
    ("theirs", "factor", "offset"),
    [
        ('kg="1" m="2" s="-2"', 1.0, 0.0),
        ('kg="1" m="2" s="-2" factor="1000"', 1000.0, 0.0),
        ('kg="1" m="2" s="-2" factor="2" offset="3"', 2.0, 3.0),
        ('kg="1" m="2" s="-2" factor="1.35581795"', 1.35581795, 0.0),
        ('kg="1" m="2" s="-2" factor="1.0000000001"', 1.0, 0.0),
        ('kg="1" m="2" s="-2" rad="-1"', 1.0, 0.0),
        ("", 1.0, 0.0),
    ],
)
def test_a_wire_between_units_of_one_name_converts_by_their_definitions(
    theirs: str, factor: float, offset: float, fmus: Path, motor: Make
) -> None:
    """A torque in the motor's N.m, which are 1000 of the conveyor's: not the same number.

    What the wire does by itself comes first, in the unit of its source.
    """
    parts = {"m": motor(defines("N.m", theirs)), "c": fmus / "CrankConveyor.fmu"}
    (wire,) = connect(System(parts, ["m.tau -> c.tau"])).wires
    assert (wire.factor, wire.offset) == (factor, offset)
    (wire,) = connect(System(parts, ["m.tau * 5 + 7 -> c.tau"])).wires
    assert (wire.factor, wire.offset) == (5 * factor, 7 * factor + offset)
    (wire,) = connect(System(parts, ["m.tau => c.tau"])).wires
    assert (wire.factor, wire.offset) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("theirs", "why"),
    [
        ('m="1"', "N.m is 1 m, N.m is 1 kg.m2.s-2"),
        ('kg="1" m="2" s="-2" rad="-1" factor="2"', "N.m is 2 kg.m2.s-2.rad-1, N.m is 1 kg.m2.s-2"),
        ('kg="1" m="2" s="-2" factor="0"', "unit 'N.m' has the factor 0.0"),
        ('kg="1" m="2" s="-2" factor="INF"', "unit 'N.m' has the factor inf"),
    ],
)
def test_a_wire_between_units_of_one_name_that_do_not_fit_shows_both(
    theirs: str, why: str, fmus: Path, motor: Make
) -> None:
    parts = {"m": motor(defines("N.m", theirs)), "c": fmus / "CrankConveyor.fmu"}
    with pytest.raises(SetupError, match=re.escape(why)):
        connect(System(parts, ["m.tau -> c.tau"]))


def valued(path: Path, base: str, unit: str = "s", name: str = "T") -> Path:
    """A parameter set with 5 of a unit that it defines."""
    path.write_text(HEAD + VALUE.format(name, 5, unit) + UNITS.format(unit, base))
    return path


@pytest.mark.parametrize("unit", ["s", "tick"])
@pytest.mark.parametrize(
    ("base", "value"),
    [
        ('s="1"', 5.0),
        ('s="1" factor="60"', 300.0),
        ('s="1" factor="0.001"', 0.005),
        ('s="1" factor="2" offset="3"', 13.0),
        ('m="1"', "is 1 m, s is 1 s"),
        ('s="1" factor="0"', "has the factor 0.0"),
    ],
)
def test_a_parameter_set_means_its_own_units(
    unit: str, base: str, value: float | str, fmus: Path, tmp_path: Path
) -> None:
    network = connect(System({"m": fmus / "DriveMotor.fmu"}))
    path = valued(tmp_path / "v.ssv", base, unit)
    if isinstance(value, str):
        with pytest.raises(SetupError, match=re.escape(value)):
            read_values(path, network)
    else:
        assert read_values(path, network) == {"m.T": pytest.approx(value, rel=1e-15)}


@pytest.fixture
def given(fmus: Path, tmp_path: Path) -> Callable[[Path, str, str], tuple[float, float]]:
    """What a text in a unit is in a unit of an FMU."""

    def convert(fmu: Path, name: str, unit: str) -> tuple[float, float]:
        network: Network = connect(
            System({"m": fmu, "c": fmus / "CrankConveyor.fmu"}), runnable=False
        )
        return conversion_to(network, network.port(name), unit, "be given")

    return convert


@pytest.mark.parametrize(
    ("own", "unit", "wanted"),
    [
        (('s="1"', ""), "ms", 1e-3),
        (('s="1" factor="60"', ""), "ms", 1e-3 / 60),
        (('s="1" factor="60"', ""), "h", 60.0),
        (('s="1"', '<DisplayUnit name="ms" factor="10"/>'), "ms", 0.1),
        (("", ""), "ms", 1e-3),
        (("", '<DisplayUnit name="beat" factor="2"/>'), "beat", 0.5),
    ],
)
def test_the_own_definition_of_an_fmu_comes_first(
    own: tuple[str, str],
    unit: str,
    wanted: float,
    motor: Make,
    given: Callable[..., tuple[float, float]],
) -> None:
    assert given(motor(defines("s", *own)), "m.T", unit) == pytest.approx((wanted, 0.0), rel=1e-15)


@pytest.mark.parametrize(
    ("own", "unit", "why"),
    [
        (('s="1"', '<DisplayUnit name="ms" factor="0"/>'), "ms", "unit 'ms' has the factor 0.0"),
        (
            ('s="1"', '<DisplayUnit name="Hz" factor="1" inverse="true"/>'),
            "Hz",
            "Hz shows the inverse of a value in s",
        ),
        (('m="1"', ""), "ms", "ms is 0.001 s, s is 1 m"),
        (('s="1"', ""), "furlong", "no FMU here defines that unit"),
    ],
)
def test_a_unit_that_converts_nothing_is_refused(
    own: tuple[str, str],
    unit: str,
    why: str,
    motor: Make,
    given: Callable[..., tuple[float, float]],
) -> None:
    with pytest.raises(SetupError, match=re.escape(why)):
        given(motor(defines("s", *own)), "m.T", unit)


def test_a_name_with_two_meanings_is_refused(motor: Make) -> None:
    units = (
        f'<Unit name="kip"><BaseUnit s="1" factor="{n}"/></Unit></UnitDefinitions>' for n in (2, 3)
    )
    parts = {
        "m": motor(),
        **{
            f"p{k}": motor(("</UnitDefinitions>", text), name=f"P{k}")
            for k, text in enumerate(units)
        },
    }
    network = connect(System(parts, start={f"{p}.w": 1.0 for p in parts}))
    assert conversion_to(network, network.port("p1.T"), "kip", "be given") == (3.0, 0.0)
    with pytest.raises(SetupError, match=r"unit 'kip' has two meanings, kip is 2 s and kip is 3 s"):
        conversion_to(network, network.port("m.T"), "kip", "be given")


@pytest.mark.parametrize("relative", [True, False])
def test_a_difference_knows_no_offset(relative: bool, motor: Make, tmp_path: Path) -> None:
    """10 degC more are 10 K more."""
    celsius = '<Unit name="s"><BaseUnit K="1"/><DisplayUnit name="degC" offset="-273.15"/></Unit>'
    flag = f'relativeQuantity="{str(relative).lower()}" '
    fmu = motor(
        (r'(?s)<Unit name="s">.*?</Unit>', celsius),
        (r'(<ScalarVariable name="T"(?s:.*?)<Real )', rf"\1{flag}"),
    )
    network = connect(System({"m": fmu}))
    wanted = 10.0 if relative else 283.15
    factor, offset = conversion_to(network, network.port("m.T"), "degC", "be given")
    assert factor * 10.0 + offset == pytest.approx(wanted)
    (tmp_path / "v.csv").write_text("name,value,unit\nT,10,degC\n")
    assert read_values(tmp_path / "v.csv", network)["m.T"] == pytest.approx(wanted)


def test_an_angle_may_be_a_base_unit_or_a_number() -> None:
    """FMI leaves it to the tool; a revolution per second is none the less no rad/s."""
    rpm = Unit("rpm", BaseUnit(s=-1, rad=0, factor=common_unit("rpm").baseUnit.factor))
    bare = Unit("rad/s", BaseUnit(s=-1))
    for source in (rpm, common_unit("rpm")):
        for target in (bare, common_unit("rad/s")):
            assert unit_conversion(source, target) == (rpm.baseUnit.factor, 0.0)
    with pytest.raises(SetupError, match="cannot be converted"):
        unit_conversion(Unit("Hz", BaseUnit(s=-1)), common_unit("rad/s"))


def test_20_degrees_celsius_are_68_fahrenheit() -> None:
    celsius = Unit("degC", BaseUnit(K=1, offset=273.15))
    fahrenheit = Unit("degF", BaseUnit(K=1, factor=5 / 9, offset=273.15 - 32 * 5 / 9))
    factor, offset = unit_conversion(celsius, fahrenheit)
    assert factor * 20.0 + offset == pytest.approx(68.0, rel=1e-12)


def test_a_table_in_a_unit_is_read_as_the_fmu_defines_it(motor: Make) -> None:
    fmu = motor(defines("rad/s", 's="-1" rad="1" factor="2"'))
    table = Series.of({"t": [0.0, 1.0], "n [rpm]": [30.0, 30.0]})
    result = run(System({"m": fmu}, inputs={"m.w": table}), stop=0.1, step=0.1, record=["m.w"])
    assert result["m.w"] == pytest.approx(30.0 * 3.141592653589793 / 30 / 2)


def test_a_package_keeps_what_its_units_mean(fmus: Path, motor: Make, tmp_path: Path) -> None:
    parts = {
        "m": motor(defines("N.m", 'kg="1" m="2" s="-2" factor="1000"')),
        "c": fmus / "CrankConveyor.fmu",
    }
    system = System(parts, ["m.tau -> c.tau", "c.w -> m.w"])
    write_ssp(system, tmp_path / "s.ssp")
    again = read_ssp(tmp_path / "s.ssp", tmp_path / "read").system
    assert [w[2:4] for w in connect(again).wires] == [(1000.0, 0.0), (1.0, 0.0)]
