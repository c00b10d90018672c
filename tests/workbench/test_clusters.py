"""Studies on Dask clusters whose workers die, crash, vanish, lack FMUs or have other code."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import dask
import pytest
from distributed import Client, LocalCluster

import cosim.journal
from cosim import SetupError, SimulationError
from cosim.journal import OUTCOMES, OutcomeJournal
from scenarios.project import PROJECT
from tests.conftest import ROOT, ask, until
from workbench import study
from workbench.cli import main
from workbench.runs.runner import Runner

PLANE = """
scenario = "plane.py"
[fixed]
ledger = "{0}/ledger"
gate = "{0}/gate"
[sampling]
method = "lhs"
number = 64
seed = 1
[tolerances]
x = {{ from = 4.0, to = 7.0 }}
y = {{ nominal = 0.0, normal = 0.1 }}
"""
CUP = """
scenario = "orientator_cycle"
[sampling]
method = "sobol"
number = 4
seed = 1
[tolerances]
speed = { from = "10rpm", to = "70rpm" }
"orientator.chute.mu" = { nominal = 0.35, normal = "10 %" }
"""
FIXED_STARTS = """
'What does the motor give in the end?'
import os
import cosim, workbench
from workbench import Figure, Findings, Question, Table
class EndTorque(Question):
    parts = {{"motor": "{0}"}}


    def solve(self, context):
        cases = [(context.fmus, [], {{"motor.w": w}}) for w in (10.0, 20.0, 30.0)]
        found = list(context.each(end, cases, "motor"))
        here = {{os.getpid(), __file__, context.fmus["motor"]}}
        for tau, there in found:
            assert there == here if not context.runner.scheduler else not there & here
        units = {{"tau": "N.m"}}
        return Findings({{}}, tables={{"mine.csv": Table.of_rows([[tau] for tau, _ in found], units)}})
def end(case):
    result = cosim.run(cosim.System(*case), stop=0.01, step=1e-3, record=["motor.tau"])
    return result["motor.tau"][-1], {{os.getpid(), __file__, case[0]["motor"]}}
"""
LONG = 300.0
PATIENT = {"distributed.deploy.lost-worker-timeout": "600 s"}
QUIET: dict[str, Any] = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers with nannies, one thread each, on this machine."""
    with (
        dask.config.set(PATIENT),
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **QUIET) as local_cluster,
    ):
        yield local_cluster


def written(folder: Path, text: str) -> Path:
    """A study file beside the plane, whose gate is closed."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", folder)
    (folder / "some.toml").write_text(text)
    os.mkfifo(folder / "gate")
    return folder / "some.toml"


def open_gate(folder: Path) -> None:
    """Let the runs at the gate go on, and all that come."""
    (folder / "free").touch()
    waiting = os.open(folder / "gate", os.O_RDWR)
    (folder / "free").replace(folder / "gate")
    os.close(waiting)


def pass_gate(folder: Path) -> None:
    """Let those go on that wait at the gate now."""
    os.close(os.open(folder / "gate", os.O_RDWR))


def at_gate(folder: Path, count: int) -> None:
    """Wait until so many runs have come to the gate."""
    ledger = folder / "ledger"
    until(
        lambda: (
            ledger.exists() and sum(float(x) >= 6.0 for x in ledger.read_text().split()) >= count
        )
    )


def kill_worker(cluster: Any, which: int) -> None:
    """Kill a worker as the kernel does when memory is short."""
    worker_pids = [nanny.process.pid for nanny in cluster.workers.values() if nanny.process.pid]
    os.kill(worker_pids[which % len(worker_pids)], signal.SIGKILL)


def rows(out: Path) -> set[int]:
    """The rows in a journal."""
    file = cosim.journal.Journal()
    file.read((out / OUTCOMES).read_bytes().partition(b"\n")[2])
    return set(file.rows)


@pytest.mark.slow
def test_killed_workers_and_a_killed_client_change_no_byte(cluster: Any, tmp_path: Path) -> None:
    path, out = written(tmp_path, PLANE.format(tmp_path)), tmp_path / "out"
    address = cluster.scheduler_address
    command = ["study", path, "--out", out, "--scheduler", address]
    client = subprocess.Popen([sys.executable, "-m", "scenarios", *command], cwd=ROOT)
    at_gate(tmp_path, 2)
    client.kill()
    client.wait()
    partial = rows(out)
    assert len(partial) < 64
    for which in range(2):
        kill_worker(cluster, which)

    def lose_another() -> None:
        at_gate(tmp_path, 4)
        kill_worker(cluster, 0)
        at_gate(tmp_path, 5)
        open_gate(tmp_path)

    with ThreadPoolExecutor() as threads:
        loser = threads.submit(lose_another)
        outcome = study.run(study.load(path, PROJECT), out=out, scheduler=address)
        loser.result()
    assert f"64 runs, {64 - len(partial)} of them now" in outcome.verdict
    assert set(outcome.first_table["status"]) == {"ok"}
    study.run(study.load(path, PROJECT), out=tmp_path / "serial", jobs=1)
    for name in ("table.csv", "table.parquet", "sensitivity.csv"):
        assert (out / name).read_bytes() == (tmp_path / "serial" / name).read_bytes()


@pytest.mark.slow
def test_a_run_that_ends_its_process_costs_no_worker(cluster: Any, tmp_path: Path) -> None:
    before = [nanny.process.pid for nanny in cluster.workers.values()]
    text = (
        "scenario = 'plane.py'\ntimeout = 2.0\n[grid]\nmood = ['segfault', 'leave', 'hang', 'good']"
    )
    plan = study.load(written(tmp_path, text), PROJECT)
    outcome = study.run(plan, out=tmp_path / "out", scheduler=cluster.scheduler_address)
    assert outcome.first_table["status"].tolist() == ["crashed", "crashed", "timeout", "ok"]
    assert [nanny.process.pid for nanny in cluster.workers.values()] == before


def test_a_cluster_that_is_not_present_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workbench.runs.cluster.CONNECT", 1.0)
    plan = study.load(written(tmp_path, PLANE.format(tmp_path)))
    with pytest.raises(SetupError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        study.run(plan, out=tmp_path / "out", scheduler="tcp://127.0.0.1:9")


@pytest.fixture(autouse=True)
def collected() -> Iterator[None]:
    """What Dask leaves behind logs its traceback when it is collected, and CPython before 3.11.8 fails
    if that happens while it parses.
    """
    yield
    gc.collect()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[tuple[str, Path, Callable[[], None]]]:
    """A scheduler, the folder of its only worker, with our code and no FMUs, and what kills that."""
    home = tmp_path / "elsewhere"
    for package in ("cosim", "scenarios", "workbench"):
        leave = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, home / package, ignore=leave)
    with LocalCluster(n_workers=0, **QUIET) as remote_cluster:
        command = [sys.executable, "-m", "dask", "worker", remote_cluster.scheduler_address]
        command += ["--nthreads", "1", "--no-dashboard", "--local-directory", tmp_path / "scratch"]
        silent = subprocess.DEVNULL
        worker = subprocess.Popen(
            command,
            cwd=home,
            env=os.environ | {"PYTHONPATH": ""},
            stdout=silent,
            stderr=silent,
            start_new_session=True,
        )

        def vanish() -> None:
            if worker.poll() is None:
                os.killpg(worker.pid, signal.SIGKILL)
            worker.wait(LONG)

        yield remote_cluster.scheduler_address, home, vanish
        vanish()


LACKING = "No module named 'workbench'"


def test_fmus_travel_to_workers_and_other_code_is_refused(
    elsewhere: tuple[str, Path, Callable[[], None]], tmp_path: Path
) -> None:
    address, home, _ = elsewhere
    path = written(tmp_path, CUP)
    result = study.run(study.load(path, PROJECT), out=tmp_path / "there", scheduler=address)
    local = study.run(study.load(path, PROJECT), out=tmp_path / "here", jobs=1)
    assert set(result.first_table["status"]) == {"ok"}
    tables = [tmp_path / folder / "table.csv" for folder in ("there", "here")]
    assert tables[0].read_bytes() == tables[1].read_bytes()
    for _, row in local.first_table.iterrows():
        start = {"orientator.chute.mu": row["orientator.chute.mu"]}
        figures = ask("orientator_cycle", speed=row["speed"], start=start).figures
        assert row["orientation_time"] == pytest.approx(
            figures["orientation_time"].value, rel=1e-15, nan_ok=True
        )
    assert local.first_table["orientation_time"].nunique() == 4
    assert not (home / "fmus").exists()

    def refused(message: str) -> None:
        with Client(address) as client:
            client.restart()
        with pytest.raises(SetupError, match=f"worker.* {message}"):
            study.run(study.load(path, PROJECT), out=tmp_path / "again", scheduler=address)

    with (home / "cosim" / "engine" / "links.py").open("a") as file:
        file.write("CHANGED = True\n")
    refused(r"differs: code.\"cosim/engine/links.py\" has changed")
    (home / "workbench" / "__init__.py").write_text(f"raise ModuleNotFoundError({LACKING!r})")
    refused("cannot do runs: .*No module named 'workbench'.*; start it in the project's folder")


def test_a_study_whose_workers_are_gone_for_good_ends_with_its_rows(
    elsewhere: tuple[str, Path, Callable[[], None]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("workbench.runs.cluster.GRACE", 2.0)
    address, _, vanish = elsewhere
    path, out = written(tmp_path, PLANE.format(tmp_path)), tmp_path / "out"
    stored, add = [], OutcomeJournal.__setitem__
    monkeypatch.setattr(OutcomeJournal, "__setitem__", lambda *row: stored.append(add(*row)))

    def vanish_with_a_row() -> None:
        until(lambda: stored or pass_gate(tmp_path))
        vanish()

    with ThreadPoolExecutor() as threads:
        vanished = threads.submit(vanish_with_a_row)
        with pytest.raises(
            SimulationError, match=f"{address} has had no workers for 2 s; what was"
        ):
            study.run(study.load(path, PROJECT), out=out, scheduler=address)
        vanished.result()
    requests = len((tmp_path / "ledger").read_text().split())
    assert 0 < len(stored) == len(rows(out)) <= requests < 64


@pytest.mark.slow
def test_a_sweep_on_a_cluster_gives_the_local_result(
    elsewhere: tuple[str, Path, Callable[[], None]], tmp_path: Path
) -> None:
    """A question of the project, and one of one's own, on workers that have neither file nor FMU."""
    address, home, _ = elsewhere
    mine = tmp_path / "mine.py"
    mine.write_text(FIXED_STARTS.format(ROOT / "fmus" / "native" / "DriveMotor.fmu"))
    for question, arguments in (
        ("orientation_time", "--speeds 40rpm,80rpm --frictions 0.35 --flavour native"),
        (str(mine), ""),
    ):
        for out, more in (("there", ["--scheduler", address]), ("here", ["--jobs", "1"])):
            command = ["run", question, *arguments.split(), "--out", str(tmp_path / out), *more]
            assert main(command, PROJECT, "x") == 0
        tables = [next((tmp_path / out).glob("*.csv")) for out in ("there", "here")]
        assert tables[0].read_bytes() == tables[1].read_bytes() != b""
        for out in ("there", "here"):
            shutil.rmtree(tmp_path / out)
    assert not (home / "fmus").exists()


def test_a_scheduler_with_tls_needs_certificates_and_the_message_says_where() -> None:
    runner = Runner(scheduler="tls://127.0.0.1:1")
    with pytest.raises(
        SetupError, match=r"'tls://127.0.0.1:1' needs the certificates .*CLIENT__KEY"
    ):
        list(runner.outcomes(abs, {0: -1.0}, "numbers"))
