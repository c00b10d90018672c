"""An FMU is unpacked and loaded once in a process, and nothing of it outlives the process."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from cosim import SetupError, System, run, run_isolated
from cosim.fmu.library import LOADED, MOST_LOADED
from cosim.scratch import scratch
from tests.conftest import ROOT, described, restore_ctrl_c, rewritten, until
from tests.cosim.test_cosim import pair


def drive(folder: Path) -> System:
    """Motor and conveyor."""
    return pair(folder, {"conveyor.w": 40.0})


def test_a_replaced_fmu_is_noticed(fmus: Path, tmp_path: Path) -> None:
    """Also if it comes back: what counts is the file as it stands."""
    native = fmus / "native"
    copy = Path(shutil.copy(native / "DriveMotor.fmu", tmp_path))
    system = System({"motor": copy}, start={"motor.w": 30.0})
    started = run(system, stop=0.01, step=1e-3)
    folder = LOADED[copy].folder
    rewritten(native / "DriveMotor.fmu", copy, described(("<CoSimulation ", "<CoSimulation  ")))
    run(system, stop=0.01, step=1e-3)
    assert LOADED[copy].folder != folder
    assert not folder.exists()
    os.utime(copy, ns=(1, 1))
    again = LOADED[copy].folder
    run(system, stop=0.01, step=1e-3)
    assert not again.exists()
    shutil.copy(native / "DriveMotor.fmu", copy)
    assert np.array_equal(run(system, stop=0.01, step=1e-3).data, started.data)


def test_a_folder_that_was_deleted_is_created_again(fmus: Path) -> None:
    system = drive(fmus / "native")
    first = run(system, stop=0.01, step=1e-3)
    shutil.rmtree(LOADED[system.parts["motor"]].folder)
    assert np.array_equal(run(system, stop=0.01, step=1e-3).data, first.data)


def test_only_some_copies_are_cached(fmus: Path, tmp_path: Path) -> None:
    for k in range(MOST_LOADED + 2):
        copy = Path(shutil.copy(fmus / "native" / "DriveMotor.fmu", tmp_path / f"m{k}.fmu"))
        run(System({"m": copy}, start={"m.w": 1.0}), stop=0.01, step=0.01)
        folder = LOADED[copy].folder if k else (first := LOADED[copy].folder)
    assert len(LOADED) == MOST_LOADED
    assert folder.exists()
    assert not first.exists()


def test_an_fmu_that_lives_only_once_is_loaded_anew_for_every_run(
    fmus: Path, tmp_path: Path
) -> None:

    def loaded() -> set[str]:
        return {*re.findall(f"{scratch()}/[^/]+", Path("/proc/self/maps").read_text())}

    before, libraries = {*scratch().iterdir()}, loaded()
    flags = [f'canBeInstantiatedOnlyOncePerProcess="{word}"' for word in ("false", "true")]
    once = described((flags[0], flags[1]))
    fmu = rewritten(fmus / "native" / "DriveMotor.fmu", tmp_path / "once.fmu", once)
    for _ in range(2):
        run(System({"m": fmu}, start={"m.w": 1.0}), stop=0.01, step=0.01)
        assert fmu not in LOADED
        assert {*scratch().iterdir()} <= before
        assert loaded() <= libraries


def test_threads_share_the_fmus(fmus: Path) -> None:
    """Of both flavours. Loading changes the folder of the process for a moment."""
    folder, failures, rows = Path.cwd(), [], []
    systems = [drive(fmus / "native"), drive(fmus)]
    expected = [run(system, stop=0.01, step=1e-3).data for system in systems]
    for fmu in list(LOADED.values()):
        fmu.forget()

    def work() -> None:
        try:
            for k in range(20):
                row = run(systems[k % 2], stop=0.01, step=1e-3).data
                rows.append((row, expected[k % 2]))
        except Exception as error:  # noqa: BLE001
            failures.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert all(data.tobytes() == reference.tobytes() for data, reference in rows)
    assert Path.cwd() == folder


SCRIPT = """
    import sys
    from pathlib import Path
    from cosim import SetupError, System, run, run_isolated, write_ssp
    
    if __name__ == "__main__":
        motor, conveyor, *strangers = map(Path, sys.argv[1:])
        drive = System(
            {"motor": motor, "conveyor": conveyor},
            ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"],
        )
        run(drive, stop=0.01, step=1e-3)
        for fmu in strangers:
            run(System({"a": fmu}, start={"a.u": 1.0}), stop=0.01, step=0.01)
        run_isolated(drive, stop=0.01, step=1e-3, csv=Path("rows.csv"))
        print("ready", flush=True)
        run(drive, stop=float(sys.stdin.readline()), step=1e-4, csv=Path("last.csv"))
"""


@pytest.mark.parametrize("ending", ["end", "Ctrl-C"])
@pytest.mark.parametrize("flavour", ["python", "native"])
def test_nothing_is_left_behind(
    ending: str, flavour: str, fmus: Path, echo: Path, tmp_path: Path
) -> None:
    """A process with FMUs of ours and of others; each wrapper of Python FMUs ends well."""
    script = tmp_path / "script.py"
    script.write_text(dedent(SCRIPT))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    folder = fmus / "native" if flavour == "native" else fmus
    parts = drive(folder).parts.values()
    environment = {"TMPDIR": str(scratch), "PYTHONPATH": str(ROOT), "MALLOC_CHECK_": "3"}
    process = subprocess.Popen(
        [sys.executable, "-X", "faulthandler", str(script), *map(str, parts), str(echo)],
        cwd=tmp_path, env=os.environ | environment, text=True, preexec_fn=restore_ctrl_c,  # noqa: PLW1509
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == "ready\n", process.communicate()
    assert len([path for path in scratch.glob("cosim_*/*") if path.is_dir()]) == 3
    process.stdin.write("0.01\n" if ending == "end" else "1e6\n")
    process.stdin.flush()
    if ending == "Ctrl-C":
        partial = tmp_path / "last.partial.csv"
        until(lambda: partial.exists() and partial.stat().st_size > 1000)
        process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=600)
    assert process.returncode == (ending == "Ctrl-C"), complaint
    if ending == "Ctrl-C":
        assert "interrupted by the user; stopped at t = " in complaint
        facts = json.loads(partial.with_suffix(".json").read_text())
        rows = [line.split(",") for line in partial.read_text().splitlines()]
        assert {len(row) for row in rows} == {len(rows[0])}
        assert (facts["status"], facts["reached"]) == ("interrupted", float(rows[-1][0]))
    assert list(scratch.iterdir()) == []


def test_an_isolated_run_keeps_nothing(fmus: Path, tmp_path: Path) -> None:
    before = dict(LOADED)
    fmu = Path(shutil.copy(fmus / "native" / "DriveMotor.fmu", tmp_path))
    run_isolated(System({"m": fmu}, start={"m.w": 1.0}), stop=0.1, step=0.1, csv=tmp_path / "r.csv")
    assert before == LOADED


def test_a_system_without_parts_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="a system needs a part"):
        run(System({}), stop=1.0, step=0.1, csv=tmp_path / "run.csv")
    assert list(tmp_path.iterdir()) == []
