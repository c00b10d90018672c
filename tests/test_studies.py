"""Studies: what files say, what becomes of runs, what is kept, and what the tables tell."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, hear_ctrl_c
from fmpy.model_description import read_model_description

from cosim import SetupError
from scenarios import study
from scenarios.study import journal, sensitivity
from scenarios.study.command import command
from scenarios.study.identity import identity
from scenarios.study.sampling import Sampling

GRID = """
scenario = "plane.py"
[grid]
x = { from = 0.0, to = 1.0, number = 5 }
y = [10, 20.0]
"""
TOLERANCES = """
scenario = "plane.py"
[fixed]
times = 2
[sampling]
method = "lhs"
number = 1000
seed = 4
[tolerances]
x = { nominal = 1.0, uniform = "10 %" }
y = { nominal = -2.0, normal = 0.1 }
pause = { nominal = 2.0, normal = "5 %", within = 0.15 }
"""

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a study file beside the scenario of the plane."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", tmp_path)

    def file(text: str, name: str = "some.toml") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return file


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def lines(folder: Path) -> list[str]:
    path = folder / "journal.jsonl"
    return path.read_text().splitlines()[1:] if path.exists() else []


def test_a_grid_is_every_combination_in_order(write: Write) -> None:
    plan = study.load(write(GRID))
    assert plan.varied == ["x", "y"]
    assert plan.runs() == [(x, y) for x in (0.0, 0.25, 0.5, 0.75, 1.0) for y in (10.0, 20.0)]
    log = study.load(write(GRID.replace("= 0.0, to = 1.0", "= 1.0, to = 16.0, spacing = 'log'")))
    assert [x for x, _ in log.runs()[::2]] == pytest.approx([1.0, 2.0, 4.0, 8.0, 16.0], rel=1e-12)
    whole = study.load(write("scenario = 'plane.py'\n[grid]\ntimes = {from=1, to=3, number=3}"))
    assert whole.runs() == [(1,), (2,), (3,)]
    assert all(type(times) is int for (times,) in whole.runs())


def test_samples_have_the_distributions_that_the_file_names(write: Write) -> None:
    x, y, pause = np.array(study.load(write(TOLERANCES)).runs()).T
    assert (x.min(), x.max()) == pytest.approx((0.9, 1.1), abs=1e-3)
    assert np.sort(x) == pytest.approx(np.linspace(0.9, 1.1, 1000), abs=2.1e-4)
    assert (y.mean(), y.std()) == pytest.approx((-2.0, 0.1), abs=2e-3)
    assert np.quantile(y, 0.975) == pytest.approx(-2.0 + 0.196, abs=4e-3)
    assert (pause.min(), pause.max()) == pytest.approx((1.85, 2.15), abs=2e-3)
    assert pause.std() == pytest.approx(0.07396, abs=1e-3)
    assert abs(np.corrcoef([x, y, pause]) - np.eye(3)).max() < 0.1


def test_samples_are_those_of_the_seed(write: Write) -> None:
    for method in ("lhs", "sobol", "saltelli"):
        text = TOLERANCES.replace("lhs", method).replace("1000", "32")
        runs = study.load(write(text)).runs()
        assert runs == study.load(write(text)).runs()
        assert runs != study.load(write(text.replace("seed = 4", "seed = 5"))).runs()
        assert len(runs) == (32 * 5 if method == "saltelli" else 32)


def test_ranges_are_sampled_evenly_or_by_decades(write: Write) -> None:
    for spacing, middle in (("linear", 50.5), ("log", 10.0)):
        spec = f"x = {{ from = 1.0, to = 100.0, spacing = '{spacing}' }}"
        text = TOLERANCES.replace('x = { nominal = 1.0, uniform = "10 %" }', spec)
        x = np.array(study.load(write(text)).runs())[:, 0]
        assert np.median(x) == pytest.approx(middle, rel=5e-3)
        assert 1.0 <= x.min() < x.max() <= 100.0


def test_each_point_of_a_grid_gets_the_same_samples(write: Write) -> None:
    plan = study.load(write(TOLERANCES.replace("1000", "64") + "[grid]\nmood = ['good', 'fail']"))
    runs = plan.runs()
    assert len(runs) == 128
    assert [mood for mood, *_ in runs] == ["good"] * 64 + ["fail"] * 64
    assert [rest for _, *rest in runs[:64]] == [rest for _, *rest in runs[64:]]


X = "x = { from = 0.0, to = 1.0, number = 5 }"
LHS = 'method = "lhs"\nnumber = 1000'
TOLERANCE = 'x = { nominal = 1.0, uniform = "10 %" }'
REFUSED = [
    (GRID, 'scenario = "plane.py"', 'scenario = "plain.py"', "scenario = 'plain.py' must be one of"),
    (GRID, 'scenario = "plane.py"', "", "scenario = nothing must be the name of one"),
    (GRID, "[grid]", "[gird]", "unknown key 'gird', expected scenario, timeout, figures, fixed"),
    (GRID, "[grid]", "grid = 3\n[fixed]", "grid = 3 must be a table [grid]"),
    (GRID, "x = {", "z = {", "grid.z: plane has no option 'z', only x, y, times, mood"),
    (GRID, "x = {", '"motor.T" = {', "grid.\"motor.T\": plane has no start values"),
    (GRID, "number = 5", "number = 1", "grid.x.number = 1 must be a whole number above 1"),
    (GRID, "number = 5", "n = 5", "grid.x: unknown key 'n', expected from, to, number, spacing"),
    (GRID, "to = 1.0", "to = 0.0", "grid.x.to = 0 must be above from = 0"),
    (GRID, "to = 1.0", "to = 'far'", "grid.x.to = 'far' must be a finite number"),
    (GRID, "number = 5", "number = 5, spacing = 'log'", "from = 0.0 must be above 0 with spacing"),
    (GRID, "number = 5", "number = 5, spacing = 'even'", "spacing = 'even' must be 'linear' or"),
    (GRID, "[10, 20.0]", "[10, 10.0]", "grid.y names 10.0 twice"),
    (GRID, "[10, 20.0]", "[]", "grid.y = [] must name at least one value"),
    (GRID, "[10, 20.0]", "[nan]", "grid.y = nan must be finite"),
    (GRID, "[10, 20.0]", "['low']", "grid.y = 'low' must be a number"),
    (GRID, "[10, 20.0]", "[true]", "grid.y = True must be a number"),
    (GRID, "[10, 20.0]", "10", "grid.y = 10 must be a list of values or { from, to, number }"),
    (GRID, X, "times = [1.5]", "grid.times = 1.5 must be a whole number"),
    (GRID, X, "mood = ['bad']", "grid.mood = 'bad' must be one of good, refuse, fail, segfault"),
    (GRID, X, "motor.T = [1.0]", "grid.motor: write a start value in quotes, \"motor.T\" = …"),
    (GRID, X, "start = ['a=1']", "grid.start: plane has no option 'start'"),
    (GRID, X, "jobs = [2]", "grid.jobs: plane has no option 'jobs'"),
    (GRID, "[grid]", "[fixed]\ny = 1.0\n[grid]", "'y' stands in two of [fixed], [grid] and"),
    (GRID, "y = [", "x = [", "is no TOML file: Cannot overwrite a value"),
    (GRID, "[grid]", "timeout = 0\n[grid]", "timeout = 0 must be a number above 0 [s]"),
    (GRID, "[grid]", "figures = 'z'\n[grid]", "figures = 'z' must be a list of names"),
    (GRID, "[grid]", "[sampling]\n[grid]", "[sampling] needs a table [tolerances]"),
    (GRID, GRID, "scenario = 'plane.py'", "nothing varies: it needs a table [grid] or"),
    (TOLERANCES, "lhs", "dice", "sampling.method = 'dice' must be one of lhs, sobol, saltelli"),
    (TOLERANCES, "lhs", "sobol", "number = 1000 must be a power of 2 with 'sobol', for example 512"),
    (TOLERANCES, "1000", "1", "sampling.number = 1 must be a whole number, at least 2"),
    (TOLERANCES, "seed = 4", "", "sampling.seed = nothing must be a whole number, at least 0"),
    (TOLERANCES, f"[sampling]\n{LHS}\nseed = 4", "", "[tolerances] need a table [sampling]"),
    (TOLERANCES, TOLERANCE, "x = 1.0", "tolerances.x = 1.0 must be { nominal, uniform }"),
    (TOLERANCES, TOLERANCE, "x = { nominal = 1.0 }", "must be { nominal, uniform }, { nominal, nor"),
    (TOLERANCES, '"10 %"', '"10"', "tolerances.x.uniform = '10' must be a number above 0, or a share"),
    (TOLERANCES, '"10 %"', "-0.1", "tolerances.x.uniform = -0.1 must be a number above 0"),
    (TOLERANCES, "nominal = 1.0", "nominal = 0", "(the nominal value is 0)"),
    (TOLERANCES, '"10 %"', '"10 %", normal = 0.1', "must be { nominal, uniform }, { nominal, normal"),
    (TOLERANCES, '"10 %"', '"10 %", within = 0.1', "must be { nominal, uniform }, { nominal, normal"),
    (TOLERANCES, '"10 %"', '"10 %", mean = 0.1', "tolerances.x: unknown key 'mean', expected nominal"),
    (TOLERANCES, "times = 2", "x = 2", "'x' stands in two of [fixed], [grid] and [tolerances]"),
    (TOLERANCES, "times = 2", "times = 2.0", "fixed.times = 2.0 must be a whole number"),
    (TOLERANCES, "times = 2", "pace = 2", "fixed.pace: plane has no option 'pace'"),
    (
        TOLERANCES.replace("times = 2", ""),
        TOLERANCE,
        "times = { from = 1, to = 4 }",
        "tolerances.times: the option takes a whole number; vary it in [grid]",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "old", "new", "message"), REFUSED, ids=lambda x: str(x)[:40])
def test_what_a_file_cannot_say_is_refused_by_name(
    text: str, old: str, new: str, message: str, write: Write
) -> None:
    assert old in text
    path = write(text.replace(old, new, 1))
    with pytest.raises(SetupError) as refusal:
        study.load(path)
    assert str(refusal.value).startswith(f"{path}")
    assert message in str(refusal.value)


def test_every_way_for_a_run_to_end_costs_its_row_and_no_more(write: Write, tmp_path: Path) -> None:
    path = write(
        f"""
        scenario = "plane.py"
        timeout = 2.0
        [fixed]
        x = 2.0
        ledger = "{tmp_path / "ledger"}"
        [grid]
        mood = ["segfault", "good", "leave", "refuse", "hang", "fail"]
        """
    )
    outcome = study.run(study.load(path), jobs=2, out=tmp_path / "out")
    told = {row["mood"]: (row["status"], row["message"]) for row in table(tmp_path / "out")}
    assert told == {
        "segfault": ("crashed", "the run ended its process: SIGSEGV"),
        "good": ("ok", ""),
        "leave": ("crashed", "the run ended its process: exit code 0"),
        "refuse": ("refused", "this point is refused"),
        "hang": ("timeout", "no answer after 2 s"),
        "fail": ("failed", "ZeroDivisionError: no plane\nat all"),
    }
    assert [row["height"] for row in table(tmp_path / "out")] == ["", "6.0", "", "", "", ""]
    assert (tmp_path / "ledger").read_text() == "2.0\n" * 6
    assert "6 runs, 6 of them now" in outcome.verdict
    assert "2 crashed, 1 ok, 1 refused, 1 timeout, 1 failed." in outcome.verdict
    assert "Run 0 crashed: the run ended its process: SIGSEGV" in outcome.verdict
    traces = {
        json.loads(line)["run"]: json.loads(line)["trace"] for line in lines(tmp_path / "out")
    }
    assert "last words" in traces[0]
    assert "ZeroDivisionError" in traces[5]


def test_a_study_without_any_answer_says_so_by_its_exit_code(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "scenario = 'plane.py'\n[fixed]\nmood = 'refuse'\n[grid]\nx = [1.0]"
    assert command(write(text), 1, None, tmp_path / "out") == 1
    assert "Run 0 refused: this point is refused" in capsys.readouterr().out


def test_a_child_killed_from_outside_has_its_run_done_again(write: Write, tmp_path: Path) -> None:
    text = "scenario = 'plane.py'\n[grid]\nmood = ['victim']\nledger = ['LEDGER']"
    path = write(text.replace("LEDGER", str(tmp_path / "ledger")))
    outcome = study.run(study.load(path), out=tmp_path / "out", jobs=1)
    assert outcome.table["message"].tolist() == ["its process was killed 3 times: SIGKILL"]
    assert (tmp_path / "ledger").read_text() == "0.0\n" * 3


def test_the_table_tells_inputs_figures_errors_and_units(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    path = write(GRID.replace("from = 0.0", "from = -1.0"))
    assert command(path, 1, None, out) == 0
    said = capsys.readouterr().out
    rows = table(out)
    assert list(rows[0]) == [
        "run", "x", "y", "height", "height_error", "answer.y", "root", "status", "message",
    ]  # fmt: skip
    for number, row in enumerate(rows):
        x, y = -1.0 + number // 2 * 0.5, (10.0, 20.0)[number % 2]
        assert [int(row["run"]), float(row["x"]), float(row["y"])] == [number, x, y]
        assert float(row["height"]) == 3.0 * x + y
        assert float(row["height_error"]) == 1e-3 * abs(x)
        assert row["root"] == ("" if x < 0.0 else repr(x**0.5))
    facts = json.loads((out / "study.json").read_text())
    assert facts["units"] == {
        "x": "m", "y": "", "height": "m", "height_error": "m", "answer.y": "m", "root": "m1/2",
    }  # fmt: skip
    assert facts["runs"] == {"all": 10, "ok": 10}
    assert facts["identity"]["file"]["grid"]["y"] == [10, 20.0]
    assert pd.read_parquet(out / "table.parquet").equals(
        pd.read_csv(out / "table.csv", keep_default_na=True).assign(message="")
    )
    assert (out / "study.toml").read_text() == path.read_text()
    assert "height: 7 to 23 m, mean 15" in said
    assert "root: 0 to 1 m1/2, mean 0.569036, standard deviation 0.46 (6 runs)." in said
    assert (out / "overview.png").stat().st_size > 10_000
    again = study.run(study.load(path), out=out)
    assert "10 runs, 0 of them now" in again.verdict
    assert again.table["height"].tolist() == [float(row["height"]) for row in rows]
    assert again.units["height_error"] == "m"


SLOW = """
scenario = "plane.py"
[fixed]
pause = 0.05
ledger = "LEDGER"
[grid]
x = { from = 1.0, to = 60.0, number = 60 }
"""


def begun(path: Path, out: Path, *options: object) -> subprocess.Popen[bytes]:
    """A study at work in a session of its own, some of its runs done."""
    arguments = map(str, ("study", path, "--out", out, *options))
    process = subprocess.Popen(
        [sys.executable, "-m", "scenarios", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=hear_ctrl_c,  # noqa: PLW1509
    )
    deadline = time.monotonic() + 60
    while len(lines(out)) < 8 and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    return process


def test_a_killed_study_goes_on_with_the_missing_runs(write: Write, tmp_path: Path) -> None:
    path = write(SLOW.replace("LEDGER", str(tmp_path / "ledger")))
    out, other = tmp_path / "out", tmp_path / "other"
    process = begun(path, out, "--jobs", 2)
    process.send_signal(signal.SIGSTOP)
    with pytest.raises(SetupError, match="another process is at work on this study"):
        study.run(study.load(path), out=out)
    process.kill()
    process.communicate()
    before = lines(out)
    assert 8 <= len(before) < 60
    assert not (out / "table.csv").exists()
    (tmp_path / "ledger").unlink()
    study.run(study.load(path), out=out, jobs=1)
    assert lines(out)[: len(before)] == before
    assert sorted(json.loads(line)["run"] for line in lines(out)) == list(range(60))
    ledger = (tmp_path / "ledger").read_text().split()
    assert 60 - len(before) <= len(ledger) <= 60 - len(before) + 2
    study.run(study.load(path), out=other, jobs=2)
    for name in ("table.csv", "table.parquet"):
        assert (out / name).read_bytes() == (other / name).read_bytes()


def test_ctrl_c_keeps_the_runs_and_says_how_to_go_on(write: Write, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = begun(write(SLOW.replace("LEDGER", "")), out, "--jobs", 1)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors.decode()
    kept = len(lines(out))
    assert errors.decode() == (
        f"interrupted, what was computed is kept: {kept} of 60 runs in {out / 'journal.jsonl'}; "
        "the same command goes on\n"
    )
    assert 8 <= kept < 60


def test_a_last_line_cut_short_is_dropped_and_other_damage_refused(tmp_path: Path) -> None:
    row = {"status": "ok", "message": "", "figures": {"a": (0.1, "m", None)}}
    who = {"file": {"x": 1}}
    with journal.opened(tmp_path, who) as book:
        for run in range(3):
            book.add(run, row)
    path = tmp_path / "journal.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-7])
    with journal.opened(tmp_path, who) as book:
        assert sorted(book.done) == [0, 1]
        book.add(2, row)
    assert path.read_bytes() == whole
    path.write_bytes(whole.replace(b'"run": 1', b'"run" 1'))
    with pytest.raises(SetupError, match="line 3 is damaged"), journal.opened(tmp_path, who):
        pass
    path.write_bytes(whole.replace(b'"run": 1', b'"run": 2'))
    with (
        pytest.raises(SetupError, match="line 4 tells run 2 a second"),
        journal.opened(tmp_path, who),
    ):
        pass
    path.write_bytes(b"x,y\n1,2\n")
    with pytest.raises(SetupError, match="it is no journal"), journal.opened(tmp_path, who):
        pass


def test_another_study_is_not_mixed_into_a_folder(write: Write, tmp_path: Path) -> None:
    out = tmp_path / "out"
    study.run(study.load(write(GRID)), out=out, jobs=1)
    kept = (out / "journal.jsonl").read_bytes()
    for new, told in (
        (GRID.replace("number = 5", "number = 6"), "file.grid.x.number was 5 and is 6"),
        (GRID.replace("[grid]", "timeout = 9.0\n[grid]"), "file.timeout was not there and is 9.0"),
    ):
        with pytest.raises(
            SetupError, match=re.escape(f"{out} holds the rows of another study")
        ) as refusal:
            study.run(study.load(write(new)), out=out)
        assert told in str(refusal.value)
        assert "--out" in str(refusal.value)
    with (tmp_path / "plane.py").open("a") as file:
        file.write("# changed\n")
    with pytest.raises(SetupError, match=r"scenario was '[0-9a-f]{16}' and is"):
        study.run(study.load(write(GRID)), out=out)
    assert (out / "journal.jsonl").read_bytes() == kept
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", tmp_path)
    commented = study.load(write(f"# a remark\nfigures = ['height']\n{GRID}"))
    assert "0 of them now" in study.run(commented, out=out).verdict
    unknown = study.load(write(f"figures = ['width']\n{GRID}"))
    with pytest.raises(SetupError, match="no run has 'width', only height, y, root"):
        study.run(unknown, out=out)


def test_the_identity_of_a_study_holds_all_that_its_rows_depend_on(tmp_path: Path) -> None:
    path = tmp_path / "cup.toml"
    path.write_text("scenario = 'orientator_cycle'\nfigures = ['t_joint']\n[grid]\nspeed = [40.0]")
    who = identity(study.load(path))
    fmu = ROOT / "fmus" / "GravityOrientator.fmu"
    guid = read_model_description(str(fmu), validate=False).guid
    assert who["fmus"] == {"orientator": guid}
    assert who["flavour"] == "python"
    assert who["file"] == {"scenario": "orientator_cycle", "grid": {"speed": [40.0]}}
    assert {"cosim/master.py", "scenarios/orientator.py", "cosim/loop.c"} <= set(who["code"])
    for name in ("cosim/master.py", "scenarios/orientator.py", "scenarios/runs/child.py"):
        content = (ROOT / name).read_bytes()
        assert hashlib.sha256(content).hexdigest().startswith(who["code"][name])
    assert not [name for name in who["code"] if name.startswith("scenarios/study/")]
    assert set(who["versions"]) == {"python", "numpy", "scipy", "fmpy"}


def test_a_start_value_that_no_fmu_has_is_named_before_the_first_run(tmp_path: Path) -> None:
    path, out = tmp_path / "cup.toml", tmp_path / "out"
    for table, value in (("grid", "[1.0]"), ("fixed", "1.0\n[grid]\nspeed = [40.0]")):
        text = f"scenario = 'orientator_cycle'\n[{table}]\n'orientator.chute.nu' = {value}"
        path.write_text(text)
        with pytest.raises(SetupError, match=r"orientator has no variable 'chute.nu', only"):
            study.run(study.load(path), out=out)
        assert not out.exists()
    path.write_text("scenario = 'orientator_cycle'\n[grid]\n'cup.m' = [1.0]")
    with pytest.raises(SetupError, match="orientator_cycle has no part 'cup', only orientator"):
        study.load(path)


def test_the_studies_of_the_project_and_of_the_page_are_sound(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "studies.md").read_text()
    (tmp_path / "page.toml").write_text(page.split("```toml mine.toml\n")[1].split("```")[0])
    sizes = {path.stem: study.load(path) for path in (ROOT / "studies").glob("*.toml")}
    assert {name: len(plan.runs()) for name, plan in sizes.items()} == {
        "cup_scatter": 11 * 256,
        "drive_tolerances": 128,
        "rotor_speed": 8,
    }
    plan = study.load(tmp_path / "page.toml")
    assert len(plan.runs()) == 2 * 6 * 128
    assert plan.varied[:3] == ["name", "motor.T", "conveyor.rotor.J"]


def test_indices_tell_the_shares_of_a_linear_figure() -> None:
    slopes = np.array([4.0, 2.0, 1.0])
    shares = slopes**2 / (slopes**2).sum()
    for method, number, kinds in (("lhs", 1024, 1), ("sobol", 1024, 1), ("saltelli", 512, 2)):
        sampling = Sampling(method, number, 7)
        x = sampling.cube(3)
        found = sensitivity.indices(sampling, "abc", x, "f", x @ slopes)
        assert not isinstance(found, str)
        assert len(found) == 3 * kinds
        for index, share in zip(found, [*shares] * kinds):
            assert index.value == pytest.approx(share, abs=0.06)
            assert abs(index.value - share) < 1.5 * index.confidence
            assert 0.0 < index.confidence < 0.15


def test_shares_and_totals_of_a_figure_that_is_not_monotonic_are_the_exact_ones() -> None:
    exact = {"S1": (0.3139, 0.4424, 0.0), "ST": (0.5576, 0.4424, 0.2437)}
    for method, kinds in (("saltelli", ("S1", "ST")), ("lhs", ("S1",))):
        sampling = Sampling(method, 1024, 7)
        u = np.pi * (2.0 * sampling.cube(3) - 1.0)
        y = np.sin(u[:, 0]) + 7.0 * np.sin(u[:, 1]) ** 2 + 0.1 * u[:, 2] ** 4 * np.sin(u[:, 0])
        found = sensitivity.indices(sampling, "abc", u, "f", y)
        assert not isinstance(found, str)
        values = {(index.kind, index.input): index.value for index in found}
        for kind in kinds:
            assert [values[kind, name] for name in "abc"] == pytest.approx(exact[kind], abs=0.05)


def test_indices_leave_out_what_failed_and_say_when_there_are_none() -> None:
    sampling = Sampling("saltelli", 64, 7)
    x = sampling.cube(2)
    y = x @ [3.0, 1.0]
    y[[0, 5, 6]] = np.nan
    found = sensitivity.indices(sampling, "ab", x, "f", y)
    assert not isinstance(found, str)
    assert {index.runs for index in found} == {4 * 62}
    assert found[0].value == pytest.approx(0.9, abs=0.1)
    y[: 4 * 50] = np.nan
    told = sensitivity.indices(sampling, "ab", x, "f", y)
    assert told == "14 whole samples are too few, it takes 16"
    assert sensitivity.indices(sampling, "ab", x, "f", 0.0 * x[:, 0] + 3.0) == "it does not vary"
    sampling = Sampling("lhs", 128, 7)
    y = np.where(np.arange(128) == 5, 0.0, 1.0)
    told = sensitivity.indices(sampling, "ab", sampling.cube(2), "f", y)
    assert told == "too few runs differ to tell a confidence interval"
