"""The questions as a user asks them: command lines, figures, files, verdicts and refusals."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from scenarios.conveyor.first_order import SETS, longest_step
from scenarios.project import PROJECT
from tests.conftest import ROOT, ask, restore_ctrl_c
from workbench import cli

NATIVE = ("--flavour", "native")


def main(*arguments: object) -> int:
    """The command line, in this process."""
    return cli.main([*map(str, arguments)], PROJECT, "scenarios")


def read_answer(
    folder: Path, name: str, table: str = ""
) -> tuple[dict[str, float], Any, pd.DataFrame]:
    """The values of the figures, all that the JSON holds, a table."""
    facts = json.loads((folder / f"{name}.json").read_text())
    values = {key: figure["value"] for key, figure in facts["figures"].items()}
    return values, facts, pd.read_csv(folder / f"{table or name}.csv")


def test_stability_limits_are_those_of_the_linearised_map() -> None:
    for name, algorithm, steps in (
        ("A", "jacobi", 61.24),
        ("A", "gauss-seidel", 6.24),
        ("A", "strang", 6.24),
        ("B", "jacobi", 14.87),
        ("B", "strang", 5.53),
    ):
        machine = SETS[name]
        limit = 2 * math.pi / (machine.nu_res * longest_step(machine, algorithm))
        assert limit == pytest.approx(steps, abs=0.01)
    ideal = SETS["A"].J / SETS["A"].B
    assert longest_step(SETS["A"], "jacobi") == pytest.approx(ideal, rel=1e-3)


FAILED = [
    ("run packing_line --iron-speed 9", "iron: doStep(t = 0.4", "cam follower lifts off", 0.45),
    ("run iron_start --motor-A 8", "iron: doStep(t = 0.4", "cam follower lifts off", 0.47),
]


@pytest.mark.parametrize(
    ("command_line", "begins", "message", "reached"), FAILED, ids=lambda x: str(x)[:40]
)
def test_a_run_that_fails_gets_a_line_and_code_1_and_keeps_its_rows(
    command_line: str,
    begins: str,
    message: str,
    reached: float,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Those with the step that was asked for, as far as it went, not those with a longer one."""
    assert main(*command_line.split(), "--out", str(tmp_path), *NATIVE) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {begins}")
    assert message in error
    assert error.count("\n") == 1
    (csv,) = tmp_path.glob("*.csv")
    t = pd.read_csv(csv)["time"]
    assert t.iloc[-1] > reached
    assert t.diff()[1:].max() < 0.0019


def test_the_end_of_a_run_up_begins_at_its_time_wherever_the_rows_lie() -> None:
    """Where the torque falls at the beginning of the end, it is smallest later than a row near there."""
    coarse, fine = (
        ask("run_up", speed=69.76, stop=0.2760445, step=step).figures
        for step in (8.015110880914531e-05, 3e-5)
    )
    for name in ("kloss_w_end_min", "kloss_tau_end_min"):
        difference = abs(coarse[name].value - fine[name].value)
        assert difference <= coarse[name].error + fine[name].error


EXAMPLE = (ROOT / "examples" / "run_down.py").read_text()


def test_a_users_question_runs_and_is_studied_anywhere(tmp_path: Path) -> None:
    """Any FMU by its path, a list of runs by a file beside it, on two processes."""
    other = EXAMPLE.replace('"DriveMotor"', f'"{ROOT / "fmus" / "native" / "DriveMotor.fmu"}"')
    (tmp_path / "run_down.py").write_text(other)
    (tmp_path / "some.toml").write_text((ROOT / "examples" / "run_down.toml").read_text())
    assert len(EXAMPLE.splitlines()) <= 50
    assert EXAMPLE in (ROOT / "docs" / "scenarios.md").read_text()
    line = [sys.executable, "-m", "scenarios"]
    for arguments in (
        ["run", "run_down.py", *NATIVE, "--speed", "400rpm", "--out", "one"],
        ["study", "some.toml", *NATIVE, "--out", "many"],
    ):
        done = subprocess.run(
            [*line, *arguments], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)},
            check=False, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    figures, facts, rows = read_answer(tmp_path / "one", "run_down")
    assert facts["options"]["speed"]["value"] == pytest.approx(400 * math.pi / 30)
    assert facts["options"]["lag"]["value"] == 0.02
    at = rows.iloc[(rows["time"] - figures["tenth"]).abs().argmin()]
    assert at["conveyor.w"] == pytest.approx(0.1 * 400 * math.pi / 30, abs=0.5)
    assert (tmp_path / "one" / "report.html").is_file()
    table = pd.read_csv(tmp_path / "many" / "table.csv")
    assert (table["status"] == "ok").sum() == 8
    same = table[(table["lag"] == 0.02) & (table["speed"] > 40)].iloc[0]
    assert same["tenth"] == pytest.approx(figures["tenth"], rel=1e-9)


@pytest.mark.parametrize("module", ["workbench.cli", "cosim.errors", "numpy", "scipy"])
def test_ctrl_c_during_an_import_is_one_line(module: str, tmp_path: Path) -> None:
    code = f"""
import os, signal, sys
class Pressed:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Pressed())
sys.argv = ["scenarios", "run", "resonance", "--out", {str(tmp_path)!r}]
import runpy
runpy.run_module("scenarios", run_name="__main__")
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT, check=False, capture_output=True, text=True, preexec_fn=restore_ctrl_c,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_a_follower_that_its_rocker_lifts_at_rest_has_no_speed_that_is_safe() -> None:
    heavy = ask("iron_cycle", start={"iron.rocker.m": 40.0, "iron.rocker.gamma": -1.5})
    assert heavy.figures["follower_limit"].value == 0.0
    assert heavy.figures["share"].reason == "the first limit is 0"
    assert any("cam follower lifts off" in warning for warning in heavy.warnings)


def test_a_speed_without_steady_motion_is_warned_of() -> None:
    """A motor with a slope too small to turn the cam past its dead centres."""
    answer = ask("iron_orders", speeds="0.3", start={"motor.B": 1e-4})
    assert any("no steady motion at 0.3 rad/s with a lag of" in x for x in answer.warnings)
    rows = answer.tables["iron_orders.csv"].frame
    assert rows["torque"].isna().all() and rows["excitation"].notna().all()


def test_orientation_time_finds_the_limits() -> None:
    answer = ask("orientation_time", speeds="0,20,40,60,80,102rpm")
    rows = answer.tables["orientation_time.csv"].frame.set_index(["mu", "n"])
    wanted = {
        (0.2, 0.0): 0.2387752354, (0.35, 20.0): 0.2441613488,
        (0.5, 40.0): 0.2777869131, (0.5, 60.0): 0.3991961493,
    }  # fmt: skip
    got = {key: rows.loc[key]["orientation_time"] for key in wanted}
    assert got == pytest.approx(wanted, abs=1e-7)
    for mu, n in (("0_2", 100.23145), ("0_35", 77.75026), ("0_5", 62.12296)):
        limit = answer.figures[f"limit_mu_{mu}"]
        assert limit.value <= n <= limit.value + limit.error
    assert answer.figures["shortest_time"].text() == "0.238775 ± 0.000001 s"
    assert answer.figures["limit_mu_0_2"].meaning.endswith("beyond it: catcher back at stop")
    assert answer.warnings == []
