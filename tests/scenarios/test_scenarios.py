"""The questions as a user asks them: command lines, figures, files, verdicts and refusals."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from scenarios.conveyor.first_order import SETS, longest_step
from scenarios.iron.questions import iron_orders
from scenarios.project import PROJECT
from tests.conftest import ROOT, ask, restore_ctrl_c
from workbench import cli

EXPECTED: dict[str, Any] = {
    "A": {
        "nu_res": 40.0,
        "count": 31,
        "nu_peak_tau": 39.053,
        "nu_peak_w": 39.475,
        36.0: (2.098724270, -129.318486, 90.9984270, -26.805683, 35.997870289, 4900.1039),
        40.0: (2.676625330, -169.435021, 104.9679504, -68.167724, 39.996704787, 4651.8145),
        60.0: (0.352741650, -173.772629, 9.3145045, -76.181685, 60.000000001, 2316.2294),
    },
    "B": {
        "nu_res": 30.0,
        "count": 33,
        "nu_peak_tau": 20.962,
        "nu_peak_w": 25.041,
        21.0: (1.482231005, 178.564296, 40.6594720, -41.438537, 20.968965968, 6424.1581),
        30.0: (1.428260459, 152.778003, 32.7524623, -77.426929, 29.984102423, 5676.7526),
    },
}
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


def turn(a: float, b: float) -> float:
    """Distance of two angles in degrees."""
    return abs((a - b + 180) % 360 - 180)


@pytest.fixture(
    scope="module",
    params=["A native", "B native", pytest.param("A python", marks=pytest.mark.slow)],
)
def sweep(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The resonance with its defaults: name of the set, figures, JSON, rows, what it printed."""
    folder = tmp_path_factory.mktemp("resonance")
    name, flavour = request.param.split()
    with redirect_stdout(StringIO()) as output:
        arguments = ("--set", name, "--out", folder, "--flavour", flavour, "--jobs", 1)
        assert main("run", "resonance", *arguments) == 0
    return name, *read_answer(folder, "resonance"), output.getvalue()


def test_ripple_follows_first_order_theory_at_every_speed(sweep: Any) -> None:
    name, _, _, rows, _ = sweep
    assert len(rows) == EXPECTED[name]["count"]
    for x, rel in (("w2", 4e-3), ("tau2", 3e-3)):
        assert rows[x].to_list() == pytest.approx(rows[f"{x}_theory"].to_list(), rel=rel)
        assert max(map(turn, rows[f"{x}_phase"], rows[f"{x}_phase_theory"])) < 0.2


def test_reference_points_are_met(sweep: Any) -> None:
    name, _, _, rows, _ = sweep
    for nu, want in EXPECTED[name].items():
        if isinstance(nu, float):
            row = rows[rows["nu"] == nu].iloc[0]
            got = [row[k] for k in ("w2", "tau2", "w_mean", "f_rod_peak")]
            assert got == pytest.approx([want[0], want[2], want[4], want[5]], rel=5e-4)
            assert turn(row["w2_phase"], want[1]) < 0.02 > turn(row["tau2_phase"], want[3])


def test_resonance_and_peaks_lie_where_theory_puts_them(sweep: Any) -> None:
    name, figures, facts, _, output = sweep
    wanted = EXPECTED[name]
    assert figures["nu_res"] == pytest.approx(wanted["nu_res"], rel=1e-12)
    assert figures["nu_90"] == pytest.approx(wanted["nu_res"], rel=5e-4)
    for peak in ("nu_peak_tau", "nu_peak_w"):
        assert figures[peak] == pytest.approx(wanted[peak], rel=3e-3)
    assert 0.0 < facts["figures"]["nu_90"]["error"] < 1e-4 * figures["nu_90"]
    assert facts["algorithm"] == "strang"
    assert facts["options"]["set"]["value"] == name
    assert facts["options"]["speed"]["value"] == {"A": 40.0, "B": 60.0}[name]
    assert facts["options"]["rated_torque"]["value"] == facts["rated_torque"]
    assert facts["options"]["speeds"]["value"][:2] == {"A": [20.0, 24.0], "B": [6.0, 8.0]}[name]
    assert re.search(rf"resonance by formula \(22\) +{wanted['nu_res']:g} rad/s\n", output)
    assert f"\nOn resonance: {'yes' if name == 'A' else 'no'}, " in output


def test_tables_are_identical_in_parallel_and_with_native_fmus(tmp_path: Path) -> None:
    """Far from the operating speed, where no error is known, so that the answer is refused."""
    variants = {
        "two": (*NATIVE, "--speeds", "20,24", "--jobs", 2),
        "python": ("--flavour", "python", "--speeds", "20"),
    }
    for name, options in variants.items():
        out = ("--steps-per-rev", "64", "--out", tmp_path / name)
        assert main("run", "resonance", *options, *out) == cli.REFUSED
    two, python = ((tmp_path / x / "resonance.csv").read_bytes() for x in variants)
    sequential = (
        ask("resonance", speeds="20,24", steps_per_rev=64).first_table.to_csv(index=False).encode()
    )
    assert sequential == two
    assert len(sequential.splitlines()) == 3
    assert sequential.splitlines()[:2] == python.splitlines()


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
BROKEN = [
    ("    numbers = (", "    values = (", 2, "must have numbers, or define figures(self, r)"),
    (
        "RunDown(Question, RunOptions)",
        "RunDown(RunOptions)",
        2,
        "must define one class that derives from workbench.Question",
    ),
    (
        "RunDown(Question, RunOptions)",
        "RunDown(Question)",
        2,
        "must derive from workbench.RunOptions as well",
    ),
    ('"-motor.tau"), "N.m"', '"-motor.tau"), ""', 2, "the formula '-motor.tau' needs a unit"),
    ('level="0.1 * speed"', 'level="0.1 * spee"', 2, "formula '0.1 * spee' uses 'spee'"),
    ('f["tenth"], most', 'f["tent"], most', 1, "there is no figure 'tent', did you mean 'tenth'?"),
    ("def judgements(self, f, r):", "def judgements(self, f, r:", 1, "'(' was never closed"),
    ('"DriveMotor"', '"DriveMotr"', 2, "there is no machine 'DriveMotr' in components"),
    ('"DriveMotor"', '"DriveMotor.fmu"', 2, "parts: motor = 'DriveMotor.fmu': no file"),
    ('"""How long', '"""\n"""How long', 1, "mine.py"),
    ("from workbench", "import nowhere\nfrom workbench", 1, "mine.py:3: ModuleNotFoundError"),
    ("lag: float", "jobs: float", 2, "no option can be called 'jobs'"),
    ("lag: float", "lag: list", 2, "option 'lag' must be a float, int, str or bool"),
    ("parts = {", "parts = 3 or {", 2, "parts must be a dict of FMUs by part"),
    ('{"motor.tau": "red"}', '{"motor.tua": "red"}', 2, "motor has no variable 'tua'"),
    ('{"motor.tau": "red"}', '{"motor.tau": "rd"}', 2, "color 'rd' must be one of red, blue"),
    ('Slider("lag"', 'Slider("lga"', 2, "'lga' is neither an option nor a start value"),
]


@pytest.mark.parametrize(("old", "new", "code", "message"), BROKEN, ids=lambda x: str(x)[:30])
def test_what_is_wrong_with_a_users_question_is_a_line(
    old: str, new: str, code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in EXAMPLE
    path = tmp_path / "mine.py"
    path.write_text(EXAMPLE.replace(old, new, 1))
    assert main("run", path, "--out", tmp_path / "out") == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    words = {"parts", "FMUs", "option", "formula", "chart"}
    assert str(path) in error or words & set(re.findall(r"\w+", error))


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


def loaded(*words: str) -> tuple[str, set[str]]:
    """What a command prints, and what a child has imported for it."""
    code = (
        "import sys; from contextlib import suppress; from scenarios.__main__ import main\n"
        "with suppress(SystemExit): main(sys.argv[1:])\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return done.stdout, set(done.stderr.splitlines()[-1].split())


@pytest.mark.parametrize("words", [["--help"], ["list"]])
def test_what_asks_nothing_imports_neither_questions_nor_numpy(words: list[str]) -> None:
    _, modules = loaded(*words)
    light = {f"scenarios.{name}" for name in ("__main__", "fmu_files", "project")}
    assert {name for name in modules if name.startswith("scenarios.")} == light
    assert not modules & {"numpy", "fmpy", "rich", "workbench.run"}


AT_FIRST_WORD = """
import sys
from scenarios.__main__ import main
from workbench import answer
text = answer.Answer.__repr__
def spoken(self):
    print(*sys.modules, file=sys.stderr)
    return text(self)
answer.Answer.__repr__ = spoken
main(sys.argv[1:])
print(*sys.modules, file=sys.stderr)
"""


def test_an_answer_is_printed_before_anything_is_drawn(tmp_path: Path) -> None:
    """matplotlib is imported behind it; pandas and scipy.stats never are."""
    words = ["run", "resonance", "--speeds", "38:42:5", "--steps-per-rev", "128", "--out", tmp_path]
    done = subprocess.run(
        [sys.executable, "-c", AT_FIRST_WORD, *words],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )  # fmt: skip
    before, after = ({*line.split()} for line in done.stderr.splitlines()[-2:])
    assert "matplotlib" not in before and "matplotlib" in after
    assert not after & {"pandas", "scipy.stats"}


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


def test_what_the_lag_adds_lies_within_its_error_of_that_with_more_samples_of_a_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also the largest torque, of which it is a share, stands between samples."""
    estimates = ask("iron_orders", speeds="6.4").figures
    monkeypatch.setattr(iron_orders, "PER_REV", 4 * iron_orders.PER_REV)
    for name, figure in ask("iron_orders", speeds="6.4").figures.items():
        assert abs(estimates[name].value - figure.value) <= estimates[name].error + figure.error, (
            name
        )


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
