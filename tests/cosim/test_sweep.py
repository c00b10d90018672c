"""Sweeps: tables of figures from the command line and from Python, whatever happens on the way."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from cosim import How, Interrupted, SetupError, System, certify, combinations, run, sample, sweep
from cosim.dense import Curves
from cosim.journal import open_journal
from cosim.metrics import Largest, Mean, Smallest
from tests.conftest import ROOT, restore_ctrl_c
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack, single_fmu_system

SHAFT = "motor.flange -- conveyor.flange"
TORQUE, SPEED = "largest:motor.tau", "mean:conveyor.w@0.05..0.1"


def parts(fmus: Path) -> list[str]:
    """Motor and conveyor on the command line."""
    native = fmus / "native"
    return [
        f"motor={native}/DriveMotor.fmu",
        f"conveyor={native}/CrankConveyor.fmu",
        "--wire",
        SHAFT,
    ]


def drive(fmus: Path) -> System:
    """The same in Python."""
    native = fmus / "native"
    return System(
        {"motor": native / "DriveMotor.fmu", "conveyor": native / "CrankConveyor.fmu"}, [SHAFT]
    )


def test_a_sweep_is_a_table_of_figures(
    fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """All combinations, values in units; each figure is that of a run by itself."""
    out = tmp_path / "table.csv"
    vary = ["--vary", "motor.T=40ms:60ms:3", "--vary", "motor.A=7000,8000"]
    figures = ["--figure", TORQUE, "--figure", SPEED]
    options = ["--stop", "0.1", "--step", "1e-3", "--out", out, "--plot", tmp_path / "p.png"]
    text = command_output("sweep", *parts(fmus), *vary, *figures, *options)
    assert text.startswith("6 runs, 0 failed\n") and (tmp_path / "p.png").stat().st_size
    table = pd.read_csv(out)
    columns = ["run", "motor.T", "motor.A", TORQUE, SPEED, "unbounded", "warnings", "reason"]
    assert list(table) == columns
    assert table["motor.T"].tolist() == [0.04, 0.04, 0.05, 0.05, 0.06, 0.06]
    assert json.loads(out.with_suffix(".json").read_text())["units"][TORQUE] == "N.m"
    for k in (0, 3, 5):
        start = {"motor.T": table["motor.T"][k], "motor.A": table["motor.A"][k]}
        single = run(System(**vars(drive(fmus)) | {"start": start}), stop=0.1, step=1e-3)
        assert table[TORQUE][k] == Largest("motor.tau")(single.solution("motor.tau"))
        mean = Mean("conveyor.w", begin=0.05, end=0.1)
        assert_allclose(table[SPEED][k], mean(single.solution("conveyor.w")), rtol=1e-12)
    assert not list(tmp_path.glob("*partial*"))


def test_cases_come_from_a_file_or_are_drawn(
    fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """A file has units in its head or its cells; a sample fills its bounds."""
    table, out = tmp_path / "cases.csv", tmp_path / "table.parquet"
    table.write_text("motor.T [ms],motor.A\n40,7000\n50,8 kN.m\n")
    shared = ["--figure", TORQUE, "--stop", "0.02", "--step", "1e-3"]
    command_output("sweep", *parts(fmus), "--table", table, *shared, "--out", out)
    assert pd.read_parquet(out)["motor.T"].tolist() == [0.04, 0.05]
    table.write_text("T [ms],A\n40,7000\n")  # of one part alone
    motor = [
        "sweep",
        fmus / "DriveMotor.fmu",
        "--table",
        table,
        "--figure",
        "largest:tau",
        *shared[2:],
    ]
    assert command_output(*motor).startswith("1 run, 0 failed")
    within = ["--sample", "8", "--within", "motor.T=40ms..60ms", "--within", "motor.A=7000..8000"]
    command_output("sweep", *parts(fmus), *within, *shared, "--out", tmp_path / "a.csv")
    values = pd.read_csv(tmp_path / "a.csv")["motor.T"].to_numpy()
    assert_array_equal(np.sort(np.floor((values - 0.04) / 0.02 * 8)), np.arange(8))
    text = command_output("sweep", *parts(fmus), "--vary", "motor.T=0.04,0.05", "--vary", "motor.A=7000,8000", "--together", *shared)  # fmt: skip
    assert text.startswith("2 runs")


def test_each_figure_may_have_its_error(fmus: Path) -> None:
    """That of `certify`; a figure without one says why."""
    cases = combinations({"motor.A": [7000.0, 8000.0]})
    figures = {"torque": Largest("motor.tau")}
    settings: dict[str, Any] = {"stop": 0.1, "step": 1e-3}
    table = sweep(drive(fmus), cases, figures, certified=True, **settings)
    assert list(table) == ["motor.A", "torque", "torque error", "warnings", "reason"]
    for k, a in enumerate(cases["motor.A"]):
        system = System(**vars(drive(fmus)) | {"start": {"motor.A": a}})
        answer = certify(system, figures, **settings).figures["torque"]
        assert (table["torque"][k], table["torque error"][k]) == (answer.value, answer.error)


def test_runs_that_fail_are_rows_with_their_reason(tmp_path: Path) -> None:
    """One that crashes or hangs costs one row."""
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    ends = ("error_at", "crash_at", "hang_at")
    cases = {
        f"A.{name}": [0.35 if k == n else 1e300 for k in (0, 1, 2, None)]
        for n, name in enumerate(ends)
    }
    how = How(2, isolated=True, timeout=8.0)
    table = sweep(system, cases, {"y": Mean("A.y")}, how=how, stop=1.0, step=0.1)
    assert table["y"].isna().tolist() == [True, True, True, False]
    for said, reason in zip(
        ("error at t = 0.35", "SIGSEGV", "not respond for 8 s"), table["reason"]
    ):
        assert said in reason


def test_a_process_that_dies_between_runs_costs_none_of_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """An instance that crashes when it is freed takes its process with it, once its run is over."""
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    settings: dict[str, Any] = {"stop": 1.0, "step": 0.1}
    cases: dict[str, Any] = {"A.error_at": [1e300, 0.35, 1e300, 1e300, 1e300]}
    whole = sweep(system, cases, {"y": Mean("A.y")}, how=How(isolated=True), **settings)
    assert not caplog.records
    for jobs in (1, 2):
        crashing = cases | {"A.crash_at_end": [False, True, True, False, True]}
        how = How(jobs, isolated=True)
        table = sweep(system, crashing, {"y": Mean("A.y")}, how=how, **settings)
        assert_array_equal(table["y"], whole["y"])
        assert table["reason"].tolist() == whole["reason"].tolist()
        assert {record.getMessage() for record in caplog.records} == {
            "a process that ran the parts was killed by signal SIGSEGV (an FMU crashed) when it closed them; no run is lost"
        }


class Short(Smallest):
    """Smallest values, in a process that has open files for one run."""

    def __call__(self, *curves: Curves) -> NDArray[np.float64]:
        """The values, once; raises OSError where more runs have been measured in this process."""
        MEASURED.append(len(curves[0]))
        if sum(MEASURED) > 1:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return super().__call__(*curves)


MEASURED: list[int] = []


def test_a_process_that_is_short_of_something_leaves_its_runs_to_the_next(tmp_path: Path) -> None:
    """What earlier runs have left of open files is no fault of a later one; alone it has all of them."""
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    figures = {"y": Short("A.y")}
    cases = {"A.x0": np.arange(1.0, 3.0)}
    table = sweep(system, cases, figures, how=How(isolated=True), stop=1.0, step=0.1)
    whole = sweep(system, cases, {"y": Smallest("A.y")}, stop=1.0, step=0.1)
    assert_array_equal(table["y"], whole["y"])
    assert table["reason"].tolist() == [""] * 2


def test_a_sweep_that_is_interrupted_before_its_first_row_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.prepared.Prepared.blocks", lambda *_: iter(()))
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    for certified in (False, True):
        with pytest.raises(Interrupted, match=r"^0 of 2 runs$") as caught:
            sweep(
                system,
                {"A.x0": [1, 2]},
                {"y": Mean("A.y")},
                certified=certified,
                stop=1.0,
                step=0.1,
            )
        assert len(caught.value.result) == 0 and "y" in caught.value.result


#: A sweep that gets a signal as soon as three of its blocks are in the journal.
ENDED = """
import os, sys
from cosim import journal, prepared
from cosim.__main__ import main
number, blocks, add = int(sys.argv.pop(1)), [], journal.Journal.add
prepared.MOST_IN_CHUNK = 20
def add_and_end(*arguments):
    add(*arguments)
    blocks.append(arguments)
    if len(blocks) == 3:
        os.kill(os.getpid(), number)
journal.Journal.add = add_and_end
sys.exit(main())
"""


def test_a_sweep_that_was_killed_goes_on_with_the_same_bytes(fmus: Path, tmp_path: Path) -> None:
    """SIGKILL, and Ctrl-C; what is done is not done again."""
    rows = ",".join(str(x) for x in np.linspace(7000.0, 8000.0, 200))
    words = ["sweep", *parts(fmus), "--vary", f"motor.A={rows}", "--figure", TORQUE, "--jobs", "1"]
    words += ["--stop", "0.1", "--step", "1e-3", "--out"]
    whole, again = tmp_path / "whole.csv", tmp_path / "again.csv"
    command = [sys.executable, "-m", "cosim", *words]
    subprocess.run([*command, whole], check=True, capture_output=True, cwd=ROOT)
    journal, before = tmp_path / "again.partial.journal", 0
    for number in (signal.SIGKILL, signal.SIGINT):
        ended = subprocess.run(
            [sys.executable, "-c", ENDED, str(int(number)), *words, again],
            cwd=ROOT, capture_output=True, preexec_fn=restore_ctrl_c, check=False,
        )  # fmt: skip
        assert not again.exists() and journal.stat().st_size > before
        before = journal.stat().st_size
    assert ended.returncode == 130 and b"the same command goes on" in ended.stderr
    done = subprocess.run([*command, again], check=True, capture_output=True, cwd=ROOT)
    assert done.stdout.startswith(b"200 runs, 0 failed")
    assert again.read_bytes() == whole.read_bytes() and not journal.exists()


def test_a_journal_is_read_as_far_as_it_is_sound(tmp_path: Path) -> None:
    """Cut anywhere, or with any byte changed, it gives rows that were written, or none; it executes nothing."""
    path = tmp_path / "a.journal"
    identity = {"cases": "x"}

    def numbers() -> dict[int, tuple[list[float], str]]:
        with open_journal(path, identity, keep=True) as journal:
            return {k: (row.tolist(), text) for k, (row, text) in journal.rows.items()}

    with open_journal(path, identity, keep=True) as journal:
        journal.add([3, 1], np.array([[1.0, 2.0], [3.0, np.inf]]), ["", "grün"])
        journal.add([7], np.empty((1, 0)), ["no figures"])
    content, written = path.read_bytes(), numbers()
    assert written == {3: ([1.0, 2.0], ""), 1: ([3.0, np.inf], "grün"), 7: ([], "no figures")}
    head = content.index(b"\n") + 1
    for k in range(head, len(content)):
        path.write_bytes(content[:k])
        assert numbers().items() <= written.items()
        path.write_bytes(content[:k] + bytes([content[k] ^ 1]) + content[k + 1 :])
        assert numbers().items() <= written.items()
    path.write_bytes(content)
    other = "contains the rows of other runs: cases was 'x' and is 'y'; remove it"
    with pytest.raises(SetupError, match=other), open_journal(path, {"cases": "y"}):
        pass
    path.write_bytes(b"something else")
    with pytest.raises(SetupError, match="is no journal of runs"), open_journal(path, identity):
        pass
    for k in range(head):
        path.write_bytes(content[:k])  # killed while it began
        assert numbers() == {}


def test_rows_of_a_journal_that_are_none_of_the_sweep_are_done_again(tmp_path: Path) -> None:
    """Their checksums are right: numbers of no case, another count of figures, texts that are none."""
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    cases, path = {"A.x0": np.arange(4.0)}, tmp_path / "a.journal"

    def table(**more: Any) -> pd.DataFrame:
        return sweep(system, cases, {"y": Smallest("A.y")}, stop=1.0, step=0.1, **more)

    whole, identity = table(), table().attrs
    deep = "[" * 100_000
    for number, figures, text in (
        (10**6, [1.0], '["", ""]'), (-1, [1.0], '["", ""]'), (2, [1.0, 2.0], '["", ""]'), (2, [], '["", ""]'),
        (2, [1.0], "x"), (2, [1.0], "5"), (2, [1.0], '["", 5]'), (2, [1.0], '[""]'), (2, [1.0], deep),
    ):  # fmt: skip
        with open_journal(path, identity, keep=True) as journal:
            journal.add([1], np.array([[9.0]]), ['["", ""]'])
            journal.add([number], np.array([figures]), [text])
        again = table(journal=path)
        assert again["y"].tolist() == [whole["y"][0], 9.0, *whole["y"][2:]]
        assert not path.exists()


def test_a_sample_needs_no_more_than_its_seed() -> None:
    bounds = {"a": (0.0, 1.0), "b": (5.0, 6.0)}
    assert_array_equal(sample(bounds, 4)["a"], sample(bounds, 4)["a"])
    assert (sample(bounds, 4, seed=1)["a"] != sample(bounds, 4)["a"]).any()
