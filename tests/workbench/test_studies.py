"""Studies: what files say, what becomes of runs, what is kept, and what the tables tell."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import scenarios
from cosim import SetupError
from cosim.journal import OUTCOMES, Journal
from cosim.units import in_unit
from scenarios.project import PROJECT
from tests.conftest import ROOT, restore_ctrl_c, until
from workbench import study
from workbench.cli import main
from workbench.plan import Sampling
from workbench.project import NO_PROJECT
from workbench.study import sensitivity

GRID, TOLERANCES = (
    (ROOT / "tests" / "refused" / f"{name}.toml").read_text() for name in ("grid", "tolerances")
)
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


def rows(folder: Path) -> dict[int, list[Any]]:
    """The rows in a journal: status, answer, message, wall time and trace."""
    file = Journal()
    file.read((folder / OUTCOMES).read_bytes().partition(b"\n")[2])
    return {run: json.loads(text)["tuple"] for run, (_, text) in file.rows.items()}


def test_a_grid_is_every_combination_in_order(write: Write) -> None:
    plan = study.load(write(GRID))
    assert plan.varied == ["x", "y"]
    assert plan.runs() == [(x, y) for x in (0.0, 0.25, 0.5, 0.75, 1.0) for y in (10.0, 20.0)]
    log = study.load(write(GRID.replace("= 0.0, to = 1.0", "= 1.0, to = 16.0, spacing = 'log'")))
    assert [x for x, _ in log.runs()[::2]] == pytest.approx([1.0, 2.0, 4.0, 8.0, 16.0], rel=1e-12)
    question = study.load(write("scenario = 'plane.py'\n[grid]\ntimes = {from=1, to=3, number=3}"))
    assert question.runs() == [(1,), (2,), (3,)]
    assert all(type(times) is int for (times,) in question.runs())


def test_ranges_and_nominals_of_start_values_take_units(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(
        """
        scenario = "orbit"
        [grid]
        "conveyor.spring.c" = { from = "680kN/m", to = "0.72MN/m", number = 2 }
        [sampling]
        method = "lhs"
        number = 2
        seed = 1
        [tolerances]
        "motor.T" = { nominal = "50 ms", uniform = "0.002s" }
        """
    )
    plan = study.load(tmp_path / "a.toml", PROJECT)
    assert plan.units == {"conveyor.spring.c": "kN/m", "motor.T": "ms"}
    assert [case["conveyor.spring.c"] for case in plan.cases()[::2]] == ["680.0kN/m", "720.0kN/m"]
    times = [in_unit(case["motor.T"], "s") for case in plan.cases()]
    assert 0.048 <= min(times) < 0.05 < max(times) <= 0.052


def test_samples_have_the_distributions_that_the_file_names(write: Write) -> None:
    x, y, z = np.array(study.load(write(TOLERANCES)).runs()).T
    assert (x.min(), x.max()) == pytest.approx((0.9, 1.1), abs=1e-3)
    assert np.sort(x) == pytest.approx(np.linspace(0.9, 1.1, 1000), abs=2.1e-4)
    assert (y.mean(), y.std()) == pytest.approx((-2.0, 0.1), abs=2e-3)
    assert np.quantile(y, 0.975) == pytest.approx(-2.0 + 0.196, abs=4e-3)
    assert (z.min(), z.max()) == pytest.approx((1.85, 2.15), abs=2e-3)
    assert z.std() == pytest.approx(0.07396, abs=1e-3)
    assert abs(np.corrcoef([x, y, z]) - np.eye(3)).max() < 0.1


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


def test_brackets_without_end_are_a_line(write: Write) -> None:
    with pytest.raises(SetupError, match="is not a TOML file: write KEY = VALUE"):
        study.load(write(GRID.replace("[10, 20.0]", f"{'[' * 5000}{']' * 5000}")))


MOODS = """
scenario = "plane.py"
figures = ["height", "root"]
timeout = 5.0
[fixed]
x = -2.0
[grid]
mood = ["segfault", "good", "refuse", "hang", "fail", "warn"]
"""


def test_whatever_becomes_of_a_run_costs_its_row_and_no_more(write: Write, tmp_path: Path) -> None:
    out = tmp_path / "out"
    outcome = study.run(study.load(write(MOODS)), jobs=2, out=out)
    source = (ROOT / "tests" / "hosts" / "plane.py").read_text().splitlines()
    line = 1 + next(n for n, text in enumerate(source) if "raise ZeroDivisionError" in text)
    keys = ("status", "message", "height", "root", "warnings")
    assert [tuple(row[key] for key in keys) for row in table(out)] == [
        ("crashed", "the run ended its process: SIGSEGV", "", "", ""),
        ("ok", "root not determined: x < 0", "-6.0", "", ""),
        ("refused", "this point is refused", "", "", ""),
        ("timeout", "no answer after 5 s", "", "", ""),
        ("failed", f"plane.py:{line}: ZeroDivisionError: no plane at all", "", "", ""),
        (
            "ok",
            "root not determined: x < 0",
            "-6.0",
            "",
            "the plane is steep, 0.3333333333333333 rad",
        ),
    ]
    for arguments in (
        "6 runs, 6 of them now",
        "2 ok, 1 crashed, 1 refused, 1 timeout, 1 failed.",
        "Run 0: crashed: the run ended its process: SIGSEGV\n",
        "\nRun 2: refused: this point is refused\n3 more remarks in the table.",
        "\n2 runs (first: run 1): root not determined: x < 0\n",
        "No run has root.",
    ):
        assert arguments in outcome.verdict
    assert "last words" in rows(out)[0][4]
    assert "ZeroDivisionError" in rows(out)[4][4]


SQUARES = """
'How large are squares?'
import logging, os, signal
from cosim import SetupError
from workbench import Figure, Findings, Question, option
class Squares(Question):
    at_once = 8
    x: float = option(0.0, "length", "m")
    @classmethod
    def solve_all(cls, context, questions):
        with open("LEDGER", "a") as file:
            file.write(f"{len(questions)}\\n")
        return [question.solve(context) for question in questions]
    def solve(self, context):
        if self.x == 3.0:
            return SetupError("three is refused")
        if self.x == 5.0:
            raise ZeroDivisionError("five")
        if self.x == 7.0:
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.x == 9.0:
            logging.getLogger("cosim").warning("nine is large")
        return Findings({"area": Figure(self.x**2, "m2", 0.0)}, warnings=["four"] * (self.x == 4.0))
"""


def test_cases_that_are_solved_together_give_the_rows_of_each_alone(tmp_path: Path) -> None:
    """One that is refused, fails, warns or ends its process costs the others nothing."""
    tables, ledger = [], tmp_path / "ledger"
    for at_once in (8, 1):
        source = SQUARES.replace("LEDGER", str(ledger)).replace("= 8", f"= {at_once}")
        (tmp_path / "squares.py").write_text(source)
        (tmp_path / "some.toml").write_text(
            "scenario = 'squares.py'\n[grid]\nx = { from = 1.0, to = 16.0, number = 16 }"
        )
        out = tmp_path / f"out{at_once}"
        study.run(study.load(tmp_path / "some.toml"), out=out, jobs=1)
        tables.append((out / "table.csv").read_bytes())
        if at_once > 1:
            assert ledger.read_text().split().count("2") == 8
    assert tables[0].replace(b"squares.py:19", b"") == tables[1].replace(b"squares.py:19", b"")
    found = {float(row["x"]): row for row in table(tmp_path / "out8")}
    assert [row["status"] for row in found.values()].count("ok") == 13
    assert (found[7.0]["message"], found[3.0]["message"]) == (
        "the run ended its process: SIGSEGV", "three is refused"
    )  # fmt: skip
    assert "ZeroDivisionError: five" in found[5.0]["message"]
    assert {x: row["warnings"] for x, row in found.items() if row["warnings"]} == {
        4.0: "four", 9.0: "nine is large"
    }  # fmt: skip


def test_start_values_may_be_names_and_numbers(tmp_path: Path) -> None:
    """Those of an enumeration, in the order of the file."""
    path = tmp_path / "some.toml"
    path.write_text(
        "scenario = 'run_up'\n[fixed]\nstop = 0.01\n[grid]\n'conveyor.rod.finite' = [true, 0]"
    )
    table = scenarios.study(path, out=tmp_path / "out", flavour="native").first_table
    assert table["conveyor.rod.finite"].tolist() == [1, 0]
    assert table["status"].tolist() == ["ok", "ok"]


def test_a_study_without_any_answer_says_so_by_its_exit_code(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "scenario = 'plane.py'\n[fixed]\nmood = 'refuse'\n[grid]\nx = [1.0]"
    assert main(["study", str(write(text)), "--out", str(tmp_path / "out")], NO_PROJECT, "x") == 1
    assert "Run 0: refused: this point is refused" in capsys.readouterr().out


def test_the_table_reports_inputs_figures_errors_and_units(write: Write, tmp_path: Path) -> None:
    out = tmp_path / "out"
    path = write(GRID.replace("from = 0.0", "from = -1.0"))
    assert main(["study", str(path), "--out", str(out)], NO_PROJECT, "x") == 0
    rows = table(out)
    assert list(rows[0]) == [
        "run", "x", "y", "height", "height_error", "answer.y", "answer.y_error", "root", "root_error",
        "high", "high_error", "status", "warnings", "message",
    ]  # fmt: skip
    for number, row in enumerate(rows):
        x, y = -1.0 + number // 2 * 0.5, (10.0, 20.0)[number % 2]
        assert [int(row["run"]), float(row["x"]), float(row["y"])] == [number, x, y]
        assert float(row["height"]) == 3.0 * x + y
        assert float(row["height_error"]) == 1e-3 * abs(x)
        assert (row["root"], row["root_error"], row["message"]) == (
            ("", "", "root not determined: x < 0") if x < 0.0 else (repr(x**0.5), "0.0", "")
        )
    facts = json.loads((out / "study.json").read_text())
    assert facts["units"] == {
        "x": "m", "y": "", "height": "m", "height_error": "m", "answer.y": "m", "answer.y_error": "m",
        "root": "m1/2", "root_error": "m1/2", "high": "1", "high_error": "1",
    }  # fmt: skip
    assert facts["runs"] == {"all": 10, "ok": 10}
    assert facts["identity"]["file"]["grid"]["y"] == [10, 20.0]
    assert pd.read_parquet(out / "table.parquet").equals(
        pd.read_csv(out / "table.csv").assign(warnings="").fillna({"message": ""})
    )
    assert (out / "study.toml").read_text() == path.read_text()
    assert (out / "overview.png").stat().st_size > 10_000
    again = study.run(study.load(path), out=out)
    assert "10 runs, 0 of them now" in again.verdict
    assert again.first_table["height"].tolist() == [float(row["height"]) for row in rows]


GATED = """
scenario = "plane.py"
[fixed]
ledger = "{0}/ledger"
gate = "{0}/gate"
[grid]
x = {{ from = 0.0, to = 11.0, number = 12 }}
"""


def at_work(path: Path, out: Path, *options: object) -> subprocess.Popen[bytes]:
    """A study in a session of its own that has done the runs before the closed gate."""
    os.mkfifo(path.parent / "gate")
    process = subprocess.Popen(
        [sys.executable, "-m", "scenarios", "study", path, "--out", out, *map(str, options)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=restore_ctrl_c,  # noqa: PLW1509
    )
    ledger = path.parent / "ledger"
    until(lambda: process.poll() or (ledger.exists() and ledger.read_text().count("\n") == 8))
    assert process.poll() is None, process.communicate()
    return process


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_an_ended_study_goes_on_with_the_missing_runs(
    number: signal.Signals, write: Write, tmp_path: Path
) -> None:
    path = write(GATED.format(tmp_path))
    out, other, ledger = tmp_path / "out", tmp_path / "other", tmp_path / "ledger"
    process = at_work(path, out, "--jobs", 2)
    with pytest.raises(SetupError, match="another process is using this folder"):
        study.run(study.load(path), out=out)
    os.killpg(process.pid, number)
    errors = process.communicate(timeout=100)[1].decode()
    before = rows(out)
    assert set(range(5)) <= set(before) <= set(range(6))
    assert not (out / "table.csv").exists()
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert errors == (
            f"interrupted; what was computed is kept: {len(before)} rows in {out / OUTCOMES}; "
            "the same command continues\n"
        )
    (tmp_path / "gate").unlink()
    (tmp_path / "gate").touch()
    ledger.unlink()
    study.run(study.load(path, PROJECT), out=out, jobs=1)
    after = rows(out)
    assert list(after) == [*before, *(n for n in range(12) if n not in before)]
    assert {n: after[n] for n in before} == before
    assert ledger.read_text().split() == [f"{n:.1f}" for n in range(12) if n not in before]
    study.run(study.load(path), out=other, jobs=2)
    for name in ("table.csv", "table.parquet"):
        assert (out / name).read_bytes() == (other / name).read_bytes()


def test_another_study_is_not_mixed_into_a_folder(write: Write, tmp_path: Path) -> None:
    out = tmp_path / "out"
    study.run(study.load(write(GRID)), out=out, jobs=1)
    stored = rows(out)

    def refused(text: str, message: str) -> None:
        with pytest.raises(SetupError, match=re.escape(message)):
            study.run(study.load(write(text)), out=out)

    other = f"{out / OUTCOMES} contains the rows of other runs: "
    refused(GRID.replace("= 5", "= 6"), f"{other}file.grid.x.number was 5 and is 6")
    page = tmp_path / "plane.py"
    before = page.read_text()
    write(GRID)
    page.write_text(before.replace("3.0 * self.x", "4.0 * self.x"))
    with pytest.raises(SetupError, match="runs: question has changed; remove it, or choose"):
        study.run(study.load(tmp_path / "some.toml"), out=out)
    page.write_text(before)
    assert rows(out) == stored


def test_more_time_is_for_the_runs_that_had_too_little(write: Write, tmp_path: Path) -> None:
    out, hang = tmp_path / "out", 'scenario = "plane.py"\n{}[grid]\nmood = ["good", "hang"]\n'
    study.run(study.load(write(hang.format("timeout = 2.0\n"))), out=out, jobs=1)
    first = rows(out)
    assert [row["status"] for row in table(out)] == ["ok", "timeout"]
    again = study.run(study.load(write(hang.format("timeout = 3.0\n"))), out=out, jobs=1)
    assert "1 of them now" in again.verdict
    assert rows(out)[0] == first[0]
    assert "no answer after 3 s" in table(out)[1]["message"]
    less = study.run(study.load(write(hang.format("timeout = 1.0\n"))), out=out, jobs=1)
    assert "0 of them now" in less.verdict


def test_a_study_file_may_begin_with_a_byte_order_mark(write: Write) -> None:
    path = write(GRID)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(study.load(path).runs()) == 10


def test_a_tolerance_may_touch_a_bound_and_have_no_end(tmp_path: Path) -> None:
    text = (ROOT / "tests" / "refused" / "cup.toml").read_text()
    for new in ("uniform = '100 %'", "normal = 2.0"):
        (tmp_path / "cup.toml").write_text(text.replace("uniform = '100 %'", new))
        assert len(study.load(tmp_path / "cup.toml", PROJECT).runs()) == 2


def indices_of(sampling: Sampling, x: Any, y: Any) -> list[sensitivity.Index]:
    """The indices of a figure, which it must have."""
    indices = sensitivity.indices(sampling, "abc"[: x.shape[1]], x, "f", y)
    assert not isinstance(indices, str)
    return indices


def test_the_interval_of_a_bent_figure_holds_what_a_line_leaves_over() -> None:
    """The variance of exp(2 u) is all due to u, whatever a line through it explains."""
    sampling = Sampling("lhs", 1024, 7)
    x = sampling.cube(2)
    bent, idle = indices_of(sampling, x, np.exp(2.0 * x[:, 0]))
    line = 3.0 / ((np.exp(4.0) - 1.0) / 4.0 - ((np.exp(2.0) - 1.0) / 2.0) ** 2)
    assert bent.method == "linear"
    assert (bent.value, bent.r2) == pytest.approx((line, line), abs=2e-3)
    assert bent.value < 0.95
    assert bent.value + bent.confidence >= 1.0
    assert 0.0 <= idle.value < 0.01


@pytest.mark.parametrize(("method", "by"), [("saltelli", "saltelli"), ("lhs", "rbd-fast")])
def test_shares_and_totals_of_a_figure_that_is_not_monotonic_are_the_exact_ones(
    method: str, by: str
) -> None:
    exact = {"S1": (0.3139, 0.4424, 0.0), "ST": (0.5576, 0.4424, 0.2437)}
    sampling = Sampling(method, 1024, 7)
    u = np.pi * (2.0 * sampling.cube(3) - 1.0)
    y = np.sin(u[:, 0]) + 7.0 * np.sin(u[:, 1]) ** 2 + 0.1 * u[:, 2] ** 4 * np.sin(u[:, 0])
    indices = indices_of(sampling, u, y)
    assert {index.method for index in indices} == {by}
    assert {index.kind for index in indices} == ({"S1", "ST"} if by == method else {"S1"})
    for index in indices:
        share = exact[index.kind]["abc".index(index.input)]
        assert index.value == pytest.approx(share, abs=0.05) and index.value >= 0.0
    assert indices[2].confidence > 0.01


def test_the_verdict_names_the_input_that_a_figure_depends_on_most(
    write: Write, tmp_path: Path
) -> None:
    text = TOLERANCES.replace("1000", "64").replace("times = 2", 'times = 2\nmood = "good"')
    outcome = study.run(study.load(write(text)), out=tmp_path / "out", jobs=1)
    exact = np.array([9.0 * 0.1**2 / 3.0, 4.0 * 0.1**2, 0.0])
    shares = outcome.tables["sensitivity.csv"].frame
    shares = shares.set_index(["figure", "input"])["value"]["height"]
    assert shares[["x", "y", "z"]].to_numpy() == pytest.approx(exact / exact.sum(), abs=0.1)
    assert re.search(r"^height lies .* m; it depends most on y \(S1 = 0.5", outcome.verdict)
    assert re.search(r"\nroot lies .* m1/2; it depends most on x \(S1 = ", outcome.verdict)
    assert (tmp_path / "out" / "sensitivity.png").stat().st_size > 10_000


def test_without_salib_a_study_keeps_its_rows_and_says_what_to_install(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "SALib", None)
    monkeypatch.setitem(sys.modules, "SALib.analyze", None)
    monkeypatch.setattr(study.file, "find_spec", lambda _: None)
    sampling = Sampling("lhs", 128, 7)
    x = sampling.cube(2)
    text = sensitivity.indices(sampling, "ab", x, "f", np.sin(20.0 * x[:, 0]))
    assert 'RBD-FAST needs the package SALib: pip install "drive-fmus[studies]"' in text
    path = write(
        TOLERANCES.replace('method = "lhs"\nnumber = 1000', 'method = "saltelli"\nnumber = 64')
    )
    with pytest.raises(SetupError, match="'saltelli' needs the package SALib: pip install"):
        study.load(path)


def test_indices_leave_out_what_failed() -> None:
    sampling = Sampling("saltelli", 64, 7)
    x = sampling.cube(2)
    y = x @ [3.0, 1.0]
    y[[0, 5, 6]] = np.nan
    indices = indices_of(sampling, x, y)
    assert {index.runs for index in indices} == {4 * 62}
    assert indices[0].value == pytest.approx(0.9, abs=0.1)
