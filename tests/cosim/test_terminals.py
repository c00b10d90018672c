"""Terminals are joined as the wires between their members would be."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest

from cosim import SetupError, System, run
from cosim.system import TERMINALS, connect
from tests.conftest import rewritten

DRIVE = {
    "motor": "DriveMotor",
    "conveyor": "CrankConveyor",
    "gears": "Gearbox",
    "link": "ShaftLink",
}


@pytest.fixture
def parts(fmus: Path) -> dict[str, Path]:
    return {part: fmus / "native" / f"{name}.fmu" for part, name in DRIVE.items()}


def joined(parts: dict[str, Path], *names: str, wires: tuple[str, ...]) -> System:
    return System({name: parts[name] for name in names}, wires)


def wires(system: System) -> set[tuple[str, str]]:
    return {(wire.source.name, wire.target.name) for wire in connect(system).wires}


def test_two_flanges_are_a_drive(parts: dict[str, Path]) -> None:
    """To the bit, with its power bond, whichever side comes first."""
    single = joined(
        parts, "motor", "conveyor", wires=("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
    )
    plain = run(single, stop=0.02, step=1e-3)
    for wire in ("motor.flange -- conveyor.flange", "conveyor.flange  --  motor.flange"):
        system = joined(parts, "motor", "conveyor", wires=(wire,))
        assert wires(system) == wires(single)
        result = run(system, stop=0.02, step=1e-3)
        assert (result["conveyor.w"] == plain["conveyor.w"]).all()
        assert result.energy.keys() == plain.energy.keys() != set()
        assert result.provenance["wires"] == [wire]


def test_each_end_of_a_shaft_has_a_terminal(parts: dict[str, Path]) -> None:
    ends = ("motor.flange -- gears.flange_a", "gears.flange_b -- link.flange_a",
            "link.flange_b -- conveyor.flange")  # fmt: skip
    system = joined(parts, *DRIVE, wires=ends)
    assert wires(system) == {
        ("motor.tau", "gears.tau_a"), ("gears.w_a", "motor.w"), ("gears.w_b", "link.w_a"),
        ("link.tau_a", "gears.tau_b"), ("conveyor.w", "link.w_b"), ("link.tau_b", "conveyor.tau"),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("wire", "message"),
    [
        ("motor.shaft -- conveyor.flange", "motor has no terminal 'shaft'; it has flange"),
        ("crank.flange -- conveyor.flange", "crank.flange names no part, only motor, conveyor"),
        (
            "conveyor.flange -- gears.flange_b",
            r"one of conveyor.tau \[N.m\] and gears.tau_b \[N.m\] must be an output, one an input",
        ),
        ("motor.flange--conveyor.flange", "must read .* 'part.terminal -- part.terminal'"),
    ],
)
def test_what_cannot_be_joined_is_refused(wire: str, message: str, parts: dict[str, Path]) -> None:
    with pytest.raises(SetupError, match=message):
        connect(joined(parts, *DRIVE, wires=(wire,)))


def test_terminals_that_cannot_be_read_hinder_nobody(
    parts: dict[str, Path], tmp_path: Path
) -> None:
    """They are told as a schema warning; a terminal of other members has nothing to join."""

    def edit(text: bytes) -> Any:
        def change(files: dict[str, Any]) -> None:
            files[TERMINALS] = text

        return change

    broken = parts | {
        "motor": rewritten(parts["motor"], tmp_path / "broken.fmu", edit(b"<fmiTerminals"))
    }
    system = joined(broken, "motor", "conveyor", wires=("motor.tau -> conveyor.tau",))
    assert TERMINALS in connect(system).flaws["motor"][0]
    with ZipFile(broken["motor"], "a") as archive:
        archive.getinfo(TERMINALS).CRC += 1
        archive.writestr("more.txt", "")
    assert "Bad CRC-32" in connect(system).flaws["motor"][0]
    other = (
        b'<a><Terminals><Terminal name="flange"><TerminalMemberVariable memberName="torque" '
        b'variableName="tau"/></Terminal></Terminals></a>'
    )
    renamed = parts | {"motor": rewritten(parts["motor"], tmp_path / "other.fmu", edit(other))}
    with pytest.raises(SetupError, match="torque and tau, w, phi have no member in common"):
        connect(joined(renamed, "motor", "conveyor", wires=("motor.flange -- conveyor.flange",)))
