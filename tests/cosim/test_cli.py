"""The command line of the master, used as a user would."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from cosim import System, certify, run, write_ssp
from cosim.cli.main import main
from scenarios.conveyor.first_order import SETS
from tests.conftest import ROOT, described, rewritten
from tests.cosim.conftest import CommandOutput
from tests.cosim.test_cosim import NU, pair


@pytest.fixture
def drive(fmus: Path, tmp_path: Path) -> Path:
    """Motor and conveyor at resonance as an .ssp of one second."""
    path = tmp_path / "drive.ssp"
    write_ssp(pair(fmus / "native"), path, stop=1.0)
    return path


def test_fmus_are_coupled_on_the_command_line(
    fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """Parts may come after options too; what their FMUs agree on is the stop time."""
    motor, conveyor = fmus / "native" / "DriveMotor.fmu", fmus / "native" / "CrankConveyor.fmu"
    out, shaft = tmp_path / "out.csv", "motor.flange -- conveyor.flange"
    parts = {"motor": motor, "conveyor": conveyor}
    options = ["--step", "0.001", "--stop", "0.2", "--out", out]
    command_output("run", f"motor={motor}", f"conveyor={conveyor}", "--wire", shaft, *options)
    result = run(System(parts, [shaft]), stop=0.2, step=0.001)
    assert_array_equal(pd.read_csv(out).to_numpy(), result.data)
    text = command_output("info", f"motor={motor}", "--wire", shaft, f"conveyor={conveyor}")
    assert "motor.tau [N.m] -> conveyor.tau [N.m]" in text
    command_output("export", f"motor={motor}", f"conveyor={conveyor}", "--wire", shaft, "--to", "ssp", "--out", tmp_path / "drive.ssp")  # fmt: skip
    assert command_output("info", tmp_path / "drive.ssp").count("->") == text.count("->")


def test_run_writes_what_the_api_computes(
    drive: Path, fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    out = tmp_path / "out.csv"
    options = [
        "--stop", "0.5", "--step", "0.001", "--algorithm", "gauss-seidel", "--set", "motor.T=0.05",
    ]  # fmt: skip
    text = command_output("run", drive, "--out", out, "--plot", tmp_path / "out.png", *options)
    assert "gauss-seidel, steps of 0.001 s: 500 steps" in text
    assert "motor.tau * conveyor.w" in text
    system = pair(fmus, SETS["A"].start(NU) | {"motor.T": 0.05})
    ours = run(system, stop=0.5, step=1e-3, algorithm="gauss-seidel")
    frame = pd.read_csv(out)
    assert frame.columns.tolist() == ours.names
    assert_array_equal(frame.to_numpy(), ours.data)
    content = json.loads(out.with_suffix(".json").read_text())
    assert content["parts"]["motor"]["parameters"]["T"] == 0.05
    assert content["units"]["motor.tau"] == "N.m"
    assert (tmp_path / "out.png").exists()


def test_a_single_fmu_is_run_over_its_default_experiment(
    fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    fmu, out = fmus / "native" / "DriveMotor.fmu", tmp_path / "out.csv"
    assert "steps of 0.001 s: 1000 steps" in command_output("run", fmu, "--out", out)
    assert pd.read_csv(out)["time"].iloc[-1] == 1.0
    assert "default experiment: 0 to 1 s" in command_output("info", fmu)
    later = described(('startTime="0.0" stopTime="1.0"', 'startTime="0.5" stopTime="0.7"'))
    assert "200 steps" in command_output("run", rewritten(fmu, tmp_path / "later.fmu", later))
    silent = rewritten(fmu, tmp_path / "silent.fmu", described(("<DefaultExperiment .*?/>", "")))
    assert "silent.fmu states no stop time: give --stop" in command_output("run", silent, code=2)


@pytest.mark.parametrize("has_file", [False, True])
def test_the_errors_of_certify_are_those_of_three_different_runs(
    drive: Path, fmus: Path, tmp_path: Path, command_output: CommandOutput, has_file: bool
) -> None:
    """The command runs in another process, which writes one file after another; the figures are the same."""
    out = ("--out", tmp_path / "rows.csv") if has_file else ()
    options = ("--stop", 0.1, "--step", 1e-3, "--certify", "--record", "motor.tau")
    text = command_output("run", drive, *options, *out)
    system = pair(fmus / "native")
    certified = certify(system, stop=0.1, step=1e-3, record=["motor.tau"])
    for name, figure in certified.figures.items():
        assert figure.error is not None and figure.error > 1e-6
        (line,) = [line for line in text.splitlines() if f"{name} " in line]
        assert str(figure) in line


def test_held_angles_are_warned_of(
    fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """A crank that hears an angle of another over a wire."""
    parts = {"crank": fmus / "CrankConveyor.fmu", "other": fmus / "LinearSystem.fmu"}
    start = {"crank.tau": 0.0} | {f"other.u[{i}]": 0.0 for i in (2, 3, 4)}
    path = tmp_path / "angle.ssp"
    write_ssp(System(parts, ["crank.phi => other.u[1]"], start), path, stop=1.0)
    assert "an angle held over a step pushes a stiff shaft" in command_output("check", path)


def test_check_names_every_obstacle(
    drive: Path, fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    text = command_output("check", drive)
    assert "order of steps: motor, conveyor" in text
    assert "recommended step: 0.001 s, preferred by motor" in text
    assert text.endswith("ready to run\n")
    parts = {"a": fmus / "LinearSystem.fmu", "b": fmus / "LinearSystem.fmu"}
    wires = ["a.z[1] -> b.u[1]", "b.z[1] -> a.u[1]"]
    start = {f"{part}.u[{i}]": 0.0 for part in parts for i in (2, 3, 4)}
    loop = tmp_path / "loop.ssp"
    write_ssp(System(parts, wires, start), loop, stop=1.0)
    text = command_output("check", loop, "--step", 0.01, code=1)
    assert "error: algebraic loop: a.z[1] -> b.u[1], b.z[1] -> a.u[1]" in text
    command_output("check", loop, "--step", 0.01, "--algorithm", "iterated")


def test_exports_are_files_of_their_kind(
    drive: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """Whose step and stop a run takes."""
    again = ("--out", tmp_path / "again.ssp", "--step", 2e-3)
    command_output("export", drive, "--to", "ssp", *again)
    command_output("export", drive, "--to", "osp", "--out", tmp_path / "osp")
    command_output("export", drive, "--to", "container", "--out", tmp_path / "drive.fmu")
    assert "steps of 0.002 s: 500" in command_output("run", tmp_path / "again.ssp")
    assert (tmp_path / "osp" / "OspSystemStructure.xml").exists()
    assert "drive: " in command_output("info", tmp_path / "drive.fmu")


def test_output_that_nobody_reads_any_more_is_no_traceback(drive: Path) -> None:
    """And there is nothing else on what is no terminal."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "cosim", "run", drive, "--stop", "0.1"]
    done = subprocess.run(command, cwd=ROOT, stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")


def test_times_and_start_values_take_units_and_either_option(
    drive: Path,
    tmp_path: Path,
    command_output: CommandOutput,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "new" / "inner" / "out.csv"

    def rows(*options: object) -> Any:
        text = command_output("run", drive, "--out", out, *options)
        assert f"rows written to {out}, units and provenance to {out.with_suffix('.json')}" in text
        return text, out.read_bytes()

    text, plain = rows("--start", 0.1, "--stop", 0.2, "--step", 1e-3, "--set", "motor.T=0.005")
    assert f"new folder: {tmp_path / 'new'}" in text
    for options in (
        ("--from", "100ms", "--stop", "200ms", "--step", "1ms", "--start", "motor.T=5ms"),
        ("--start", "100 ms", "--stop", 0.2, "--step", "1000us", "--start", "motor.T=5 ms"),
        ("--start", "motor.T=7", "--start", "0.1", "--set", "motor.T=0.005", "--stop", "0.2"),
    ):
        text, same = rows(*options)
        assert same == plain and "new folder" not in text
    assert "motor.T [s] = 0.005" in command_output("info", drive, "--start", "motor.T=5ms")
    assert main(["check", str(drive), "--start", "0.1"]) == 0
    assert capsys.readouterr().err == "warning: the start time is given with --from: write that\n"
    rpm = command_output("info", drive, "--set", "motor.w=60rpm")
    assert f"motor.w [rad/s] = {2 * np.pi!r}" in rpm


def test_help_imports_nothing_that_only_a_command_needs() -> None:
    code = (
        "import sys; from cosim.cli.main import parser; parser().format_help();"
        "print(sorted({'matplotlib', 'pandas', 'rich', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == "[]"


def test_a_former_name_of_an_option_is_told(fmus: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motor = str(fmus / "DriveMotor.fmu")
    assert main(["check", motor, "--stop", "1", "--tolerance", "1e-5"]) == 0
    told = "warning: --tolerance is called --fmu-tolerance: write that\n"
    assert told in capsys.readouterr().err
    assert main(["check", motor, "--stop", "1", "--fmu-tolerance", "1e-5"]) == 0
    assert "tolerance" not in capsys.readouterr().err
