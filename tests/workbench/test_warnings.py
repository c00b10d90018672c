"""What FMUs warn of, and what the coupling made, reaches whoever asks for the answer."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cosim import SimulationError, certify, run, run_isolated, write_ssp
from cosim.cli.main import main
from tests.cosim.foreign import pack, single_fmu_system
from tests.cosim.test_cosim import WIRES
from tests.cosim.test_library import drive
from tests.linear_systems import SPRING_AND_MASS, couple

PERIOD = 2 * math.pi / 5
COARSE: dict[str, Any] = {"algorithm": "jacobi", "step": 2e-3, "stop": 0.5}


def test_energy_that_the_coupling_created_is_warned_of(fmus: Path) -> None:
    system = drive(fmus / "native")
    (warning,) = run(replace(system, start={}), **COARSE).warnings
    balance = run(replace(system, start={}), **COARSE).energy["motor.tau * conveyor.w"]
    assert balance["taken"] > balance["given"] > 0.0
    share = (balance["taken"] - balance["given"]) / balance["taken"]
    assert share > 0.05
    assert warning == (
        f"bond motor.tau * conveyor.w: the coupling created "
        f"{balance['taken'] - balance['given']:.3g} J, {share:.0%} of the {balance['taken']:.3g} J carried: "
        "use smaller steps or another algorithm; see diagnose"
    )
    for algorithm, step in (("jacobi", 2e-4), ("gauss-seidel", 2e-3), ("strang", 2e-3)):
        settings = COARSE | {"algorithm": algorithm, "step": step}
        assert run(replace(system, start={}), **settings).warnings == []


@pytest.mark.parametrize(("algorithm", "warned"), [("jacobi", 1), ("gauss-seidel", 0)])
def test_a_bond_that_carries_to_and_fro_is_judged_by_its_gross_energy(
    algorithm: str, warned: int, fmus: Path
) -> None:
    """A spring and a mass keep their energy: over whole periods the bond carries nothing net."""
    system = couple(SPRING_AND_MASS, fmus / "LinearSystem.fmu", bond=("spring.1", "mass.1"))
    result = run(system, stop=2 * PERIOD, step=PERIOD / 50, algorithm=algorithm)
    (bond,) = result.energy.values()
    assert bond["exchanged"] > 5.0 * abs(bond["given"])
    assert len(result.warnings) == warned


def test_wires_that_do_not_keep_a_power_are_no_bond(fmus: Path) -> None:
    """A torque that is turned round by its wire gives what the other side does not take."""
    system = drive(fmus / "native")
    turned = replace(system, wires=["motor.tau * -0.01 -> conveyor.tau", WIRES[1]])
    assert run(turned, stop=0.01, step=1e-3).energy == {}
    geared = ["motor.tau * 2 -> conveyor.tau", "conveyor.w * 2 -> motor.w"]
    assert len(run(replace(system, wires=geared), stop=0.01, step=1e-4).energy) == 1


def test_every_kind_of_run_carries_the_warnings(fmus: Path, tmp_path: Path) -> None:
    system = replace(drive(fmus / "native"), start={})
    warnings = run(system, **COARSE).warnings
    assert len(warnings) == 1
    assert run_isolated(system, csv=tmp_path / "a.csv", **COARSE).warnings == warnings
    assert json.loads((tmp_path / "a.json").read_text())["warnings"] == warnings
    certified = certify(system, lambda r: {"end": r["motor.tau"][-1]}, **COARSE)
    assert "the coupling created" in certified.result.warnings[0]


def test_a_run_that_fails_and_a_process_that_dies_keep_their_warnings(tmp_path: Path) -> None:
    for runner, end in ((run, {"error_at": 0.5}), (run_isolated, {"crash_at": 0.55})):
        system = single_fmu_system(pack(tmp_path / "A.fmu", warn_at=0.2, **end))
        with pytest.raises(SimulationError) as caught:
            runner(system, stop=1.0, step=0.1, csv=tmp_path / "a.csv")
        assert caught.value.result.warnings == ["A: t = 0.2 s in A"]


@pytest.mark.parametrize("more", [[], ["--certify"]])
def test_the_command_line_warns_once_and_last(
    more: list[str], fmus: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_ssp(replace(drive(fmus / "native"), start={}), tmp_path / "drive.ssp", stop=0.5)
    arguments = [
        "run", str(tmp_path / "drive.ssp"), "--algorithm", "jacobi", "--step", "2e-3", *more
    ]  # fmt: skip
    assert main(arguments) == 0
    output, warned = capfd.readouterr()
    assert "warning" not in output
    assert re.search(r" J received, \+[0-9.e+]+ J created by the coupling", output)
    (line,) = warned.splitlines()
    assert line.startswith("warning: bond motor.tau * conveyor.w: the coupling created ")


def test_the_command_line_warns_of_a_run_that_failed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    fmu = pack(tmp_path / "A.fmu", warn_at=0.2, error_at=0.5)
    assert main(["run", str(fmu), "--stop", "1", "--step", "0.1"]) == 1
    warning, error = capfd.readouterr().err.splitlines()
    assert warning == "warning: A: t = 0.2 s in A"
    assert error.startswith("error: A: doStep")
