"""Rows are neither lost nor mixed, whatever ends a run."""

from __future__ import annotations

import errno
import json
import locale
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cosim import Interrupted, SetupError, SimulationError, isolated, run, run_isolated
from cosim.cli.commands import run as run_command
from cosim.cli.main import main
from cosim.engine import process_guard, system_instance
from cosim.table_file import facts_path
from tests.conftest import ROOT, restore_ctrl_c, until
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack, single_fmu_system

COMMAND = [sys.executable, "-m", "cosim", "run"]


def start(*arguments: str | Path, **more: Any) -> subprocess.Popen[str]:
    """The program, hearing signals although the tests may not."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)], cwd=ROOT, text=True, preexec_fn=restore_ctrl_c,  # noqa: PLW1509
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, **more,
    )  # fmt: skip


def long(tmp_path: Path, *options: str | Path, **start_values: Any) -> list[str | Path]:
    """The arguments of a run that takes minutes."""
    fmu = pack(tmp_path / "A.fmu", **start_values)
    return [fmu, "--stop", "2000", "--step", "1e-4", *options]


@pytest.mark.parametrize("first", ["r.parquet", pytest.param("r.csv", marks=pytest.mark.slow)])
def test_a_name_belongs_to_a_single_run_in_every_format(
    first: str, tmp_path: Path, command_output: CommandOutput
) -> None:
    """Both may write r.partial.csv; the second is refused, the first keeps its rows, a third may run."""
    arguments = long(tmp_path, "--out", tmp_path / first)
    process = start(*arguments, env=os.environ | {"TMPDIR": str(tmp_path)})
    until((tmp_path / "r.partial.csv").exists)
    again = ["run", tmp_path / "A.fmu", "--stop", 1, "--step", 0.1, "--out", tmp_path / "r.csv"]
    assert "another run is writing" in command_output(*again, code=2)
    until(lambda: sum(rows.stat().st_size for rows in tmp_path.rglob("*.partial.csv")) > 1000)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130, errors
    partial = tmp_path / f"r.partial{Path(first).suffix}"
    read = pd.read_parquet if partial.suffix == ".parquet" else pd.read_csv
    assert len(read(partial)) > 1
    partial.unlink()
    facts_path(partial).unlink()
    command_output(*again)
    assert not list(tmp_path.glob("r.partial.[cp]*"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_that_ask_to_stop_keep_the_rows(number: signal.Signals, tmp_path: Path) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    environment = os.environ | {"TMPDIR": str(scratch)}
    out = tmp_path / "r.csv"
    process = start(*long(tmp_path, "--out", out), env=environment)
    until(lambda: out.with_name("r.partial.csv").exists())
    process.send_signal(number)
    _, message = process.communicate(timeout=600)
    assert process.returncode == 130
    assert "interrupted; what was computed is kept" in message and "Traceback" not in message
    assert json.loads((tmp_path / "r.partial.json").read_text())["status"] == "interrupted"
    assert list(scratch.iterdir()) == []


def test_a_child_does_not_outlive_its_parent(tmp_path: Path) -> None:
    """Not even one whose FMU never returns."""
    process = start(*long(tmp_path, "--out", tmp_path / "r.csv", hang_at=0.01))
    until((tmp_path / "r.partial.csv").exists)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert children
    process.kill()
    process.communicate(timeout=600)
    until(lambda: not any(Path(f"/proc/{child}/exe").exists() for child in children))


@pytest.mark.parametrize("options", [["--out", "r.parquet"], ["--out", "r.csv", "--part", "A"]])
def test_a_failed_run_keeps_its_rows_whatever_the_format(
    options: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    fmu = pack(tmp_path / "A.fmu", error_at=0.55)
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(fmu), "--stop", "1", "--step", "0.1", *options]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: A: doStep(t = ") and error.count("\n") == 1
    partial = Path(options[1]).with_stem("r.partial")
    rows = pd.read_parquet(partial) if partial.suffix == ".parquet" else pd.read_csv(partial)
    assert list(rows["time"]) == pytest.approx([0.1 * n for n in range(6)])
    assert json.loads(facts_path(partial).read_text())["status"] == "failed"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "r.txt"], "r.txt must end in .csv or .parquet"),
        (["--out", "folder"], "folder is a folder"),
        (["--out", "r.csv", "--part", "B"], "there is no part 'B', only A"),
        (["--plot", "q.xyz"], "q.xyz must end in one of"),
    ],
)
def test_files_that_could_not_be_written_are_refused_before_the_run(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command_output: CommandOutput,
) -> None:
    (tmp_path / "folder").mkdir()
    fmu = pack(tmp_path / "A.fmu", crash_at=0.0)
    monkeypatch.chdir(tmp_path)
    assert message in command_output("run", fmu, "--stop", "1", "--step", "0.1", *options, code=2)


def test_csv_must_be_a_csv_file(tmp_path: Path) -> None:
    system = single_fmu_system(pack(tmp_path / "A.fmu"))
    with pytest.raises(SetupError, match=r"must be a file that ends in \.csv"):
        run(system, stop=1.0, step=0.1, csv=tmp_path / "a.parquet")
    assert len(run(system, stop=1.0, step=0.1, csv=str(tmp_path / "a.csv")).data) == 11


def test_a_full_disk_ends_a_run_with_complete_rows(tmp_path: Path) -> None:
    """A limit on the size of files stands for it."""

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))

    arguments = long(tmp_path, "--out", tmp_path / "r.csv")
    done = subprocess.run(
        [*COMMAND, *map(str, arguments)], check=False, cwd=ROOT, preexec_fn=limited,
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "r.partial.csv cannot be written: File too large; stopped at" in done.stderr
    assert "Traceback" not in done.stderr
    content = (tmp_path / "r.partial.csv").read_text()
    assert content.endswith("\n") and len({line.count(",") for line in content.splitlines()}) == 1
    assert json.loads((tmp_path / "r.partial.json").read_text())["status"] == "failed"


def test_a_folder_that_goes_ends_a_run(tmp_path: Path) -> None:
    folder = tmp_path / "out"

    def go(_: float) -> None:
        rmtree(folder, ignore_errors=True)
        time.sleep(0.02)

    with pytest.raises(SimulationError, match=r"cannot be written: No such file or directory"):
        part = single_fmu_system(pack(tmp_path / "A.fmu"))
        run(part, stop=2000.0, step=1e-3, csv=folder / "r.csv", progress=go)


def test_an_fmu_that_changes_the_folder_does_not_move_the_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run(
        single_fmu_system(pack(tmp_path / "A.fmu")), stop=1.0, step=0.1, csv="a.csv",
        progress=lambda _: os.chdir("/"),
    )  # fmt: skip
    assert (tmp_path / "a.csv").exists()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder to be in, and a master that looks after every step."""
    monkeypatch.setattr(process_guard, "BETWEEN", 0.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("when", [0.0, 0.35])
def test_what_an_fmu_changes_in_its_process_is_brought_back(
    when: float, watched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose numbers stay the same, and which hears Ctrl-C all the same."""
    locale_name = locale.setlocale(locale.LC_ALL)
    before = locale.setlocale(locale.LC_ALL, "C.UTF-8")  # another one than the FMU sets

    def interrupt(share: float) -> None:
        assert Path.cwd() == watched or share < 0.4
        if share > 0.55:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(system_instance, "lay_out", lambda *_: None)
    meddler, other = (pack(watched / f"{k}.fmu", meddle_at=t) for k, t in ((1, when), (2, 9.0)))
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Interrupted) as caught:
            run(
                single_fmu_system(meddler),
                stop=1.0,
                step=0.1,
                record=["part_1.y"],
                progress=interrupt,
            )
    finally:
        signal.signal(signal.SIGINT, handler)
    assert locale.setlocale(locale.LC_ALL) == before
    locale.setlocale(locale.LC_ALL, locale_name)
    warning = "an FMU has changed {} of the whole process; it was restored"
    assert caught.value.result.warnings == [
        warning.format(what) for what in ("the working directory", "the locale")
    ]
    result = run(single_fmu_system(other), stop=1.0, step=0.1, record=["part_2.y"])
    assert result.warnings == []
    assert np.array_equal(result.data[:7], caught.value.result.data)


@pytest.mark.parametrize(
    ("flaw", "ends", "starts"),
    [
        ("round_at", "has changed the rounding .* stopped at", "the rounding of floating-point numbers"),
        pytest.param(
            "flush_at", r"subnormal .*\(FTZ, DAZ\) of the whole process", "subnormal",
            marks=pytest.mark.skipif(
                platform.machine() not in ("x86_64", "AMD64"), reason="the FMU sets bits of SSE"
            ),
        ),
    ],
)  # fmt: skip
def test_numbers_that_are_computed_otherwise_end_a_run(
    flaw: str, ends: str, starts: str, watched: Path
) -> None:
    """In an FMU's steps; what it does while it starts is brought back before the first one."""
    settings: dict[str, Any] = {"stop": 1.0, "step": 0.1}
    with pytest.raises(SimulationError, match=ends) as caught:
        failing = single_fmu_system(pack(watched / "A.fmu", **{flaw: 0.35}))
        run(failing, csv="a.csv", **settings)
    assert sys.float_info.min * float("0.5") > 0.0, "it was restored"
    assert (watched / "a.partial.csv").read_text().count("\n") == len(caught.value.result.data) + 1
    started = run(single_fmu_system(pack(watched / "B.fmu", **{flaw: 0.0})), **settings)
    assert starts in started.warnings[0]
    result = run(single_fmu_system(pack(watched / "C.fmu")), **settings)
    assert np.array_equal(result["C.y"], started["B.y"])


def test_a_run_without_standard_output_ends_well_and_writes_only_its_rows(tmp_path: Path) -> None:
    pack(tmp_path / "A.fmu")
    command = f'"{sys.executable}" -m cosim run A.fmu --stop 1 --step 0.1 --out r.csv >&- 2>errors'
    done = subprocess.run(
        ["sh", "-c", command], cwd=tmp_path, check=False, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    assert (done.returncode, (tmp_path / "errors").read_text()) == (0, "")
    assert len(pd.read_csv(tmp_path / "r.csv")) == 11


def test_a_current_folder_that_was_removed_is_named_as_the_cause(tmp_path: Path) -> None:
    pack(tmp_path / "A.fmu")
    command = (
        f'mkdir gone && cd gone && rmdir ../gone && "{sys.executable}" -m cosim run ../A.fmu '
        f"--stop 1 --step 0.1 --out r.csv"
    )
    done = subprocess.run(
        ["sh", "-c", command], cwd=tmp_path, check=False, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode != 0
    assert done.stderr == "error: the current folder has been removed: change to another one\n"


def test_a_name_that_only_its_partial_file_makes_too_long_is_refused_at_once(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    pack(tmp_path / "A.fmu")
    out = tmp_path / f"{'a' * 243}.csv"
    errors = command_output(
        "run", tmp_path / "A.fmu", "--stop", "1", "--step", "0.1", "--out", out, code=2
    )
    assert errors.strip().endswith(".partial.json cannot be written: File name too long")
    assert [*tmp_path.iterdir()] == [tmp_path / "A.fmu"]


def test_an_fmu_that_hangs_is_ended_on_request(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "A.fmu", hang_at=0.55)
    with pytest.raises(
        SimulationError, match=r"A did not respond for 2 s and was ended after t = 0"
    ):
        run_isolated(
            single_fmu_system(fmu), stop=1.0, step=0.1, csv=tmp_path / "r.csv", timeout=2.0
        )
    assert json.loads((tmp_path / "r.partial.json").read_text())["status"] == "failed"


def test_an_fmu_that_is_never_freed_does_not_hold_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolated, "GRACE", 0.5)
    fmu = pack(tmp_path / "A.fmu", hang_at_end=True)
    with pytest.raises(SimulationError, match=r"was ended when it closed them after t = 1.0 s"):
        run_isolated(single_fmu_system(fmu), stop=1.0, step=0.1, csv=tmp_path / "r.csv")
    assert len(pd.read_csv(tmp_path / "r.csv")) == 11
    assert json.loads((tmp_path / "r.json").read_text())["status"] == "complete"


@pytest.mark.parametrize("options", [["q.parquet"], ["q.csv", "--part", "A"]])
def test_rows_for_which_the_disk_is_full_at_the_end_are_saved_elsewhere(
    options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """And what is half written does not stand there under the name of the whole."""

    def full(frame: pd.DataFrame, path: Path, **_: Any) -> None:
        if path.parent == tmp_path / "full":
            path.write_text("half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        path.write_text(written(frame, index=False))

    written = pd.DataFrame.to_csv
    for name in ("to_csv", "to_parquet"):
        monkeypatch.setattr(pd.DataFrame, name, full)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(run_command, "scratch", lambda: tmp_path)
    arguments = ["--stop", "1", "--step", "0.1", "--out", str(tmp_path / "full" / options[0])]
    assert main(["run", str(pack(tmp_path / "A.fmu")), *arguments, *options[1:]]) == 1
    messages = capsys.readouterr().err.splitlines()
    assert len(messages) == 1
    assert "cannot be written: No space left on device; the rows are in " in messages[0]
    assert len(pd.read_csv(messages[0].partition("; the rows are in ")[2])) == 11
    assert [*(tmp_path / "full").iterdir()] == []
