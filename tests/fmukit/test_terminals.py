"""terminalsAndIcons of our FMUs by the schema, and what is no shaft end."""

from __future__ import annotations

import io
from pathlib import Path
from types import ModuleType, SimpleNamespace
from zipfile import ZipFile

import fmpy
import pytest
from lxml import etree
from PIL import Image

from components.gearbox import model as gearbox
from fmukit.declare.interface import Interface
from fmukit.fmu.terminals import flanges

SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"


def test_every_fmu_has_a_valid_folder_with_its_icon(both: Path) -> None:
    schema = etree.XMLSchema(etree.parse(str(SCHEMA)))
    terminals_by_fmu = {}
    for fmu in both.glob("*.fmu"):
        with ZipFile(fmu) as archive:
            root = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            icon = Image.open(io.BytesIO(archive.read("terminalsAndIcons/icon.png")))
        schema.assertValid(root)
        (corners,) = root.iter("Icon")
        shape = int(corners.get("y2")) / int(corners.get("x2"))
        assert icon.size == (256, pytest.approx(256 * shape, abs=1.0))
        shades = icon.convert("L").getcolors()
        assert shades and len(shades) > 8
        terminals_by_fmu[fmu.stem] = {terminal.get("name") for terminal in root.iter("Terminal")}
    assert terminals_by_fmu["Gearbox"] == terminals_by_fmu["ShaftLink"] == {"flange_a", "flange_b"}
    assert terminals_by_fmu["GravityOrientator"] == set()
    assert all(
        terminals_by_fmu[name] == {"flange"}
        for name in ("DriveMotor", "CrankConveyor", "IronDrive")
    )


def with_flanges(ends: dict[str, tuple[str, ...]]) -> ModuleType:
    return SimpleNamespace(**vars(gearbox) | {"FLANGES": ends})  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("ends", "message"),
    [
        (("tau_a",), "must name torque, speed and, if there is one, the angle"),
        (("tau_a", "w_c"), "'w_c' is neither an input nor an output"),
        (("tau_a", "i"), "'i' is neither an input nor an output"),
        (("w_a", "tau_a"), r"w_a \[rad/s\] cannot be tau \[N.m\]"),
        (("tau_a", "a_a"), r"a_a \[rad/s2\] cannot be w \[rad/s\]"),
    ],
)
def test_what_is_no_shaft_end_is_refused(ends: tuple[str, ...], message: str) -> None:
    with pytest.raises(ValueError, match=r"FLANGES\['end'\].*" + message):
        flanges(Interface(with_flanges({"end": ends})))
