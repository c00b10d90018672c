"""Studies on Dask clusters whose workers die, crash, lack FMUs or have other code."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import pytest
from conftest import ROOT
from distributed import Client, LocalCluster

from cosim import SetupError
from scenarios import fmus, orientator_cycle, study

PLANE = """
scenario = "plane.py"
[fixed]
pause = 0.05
[sampling]
method = "lhs"
number = 60
seed = 1
[tolerances]
x = { from = 1.0, to = 2.0 }
y = { nominal = 0.0, normal = 0.1 }
"""
CUP = """
scenario = "orientator_cycle"
[sampling]
method = "sobol"
number = {number}
seed = 1
[tolerances]
speed = {{ from = 10.0, to = 90.0 }}
"orientator.chute.mu" = {{ nominal = 0.35, normal = "10 %" }}
"""
SAME = ("table.csv", "table.parquet", "sensitivity.csv")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers with nannies, one thread each, on this machine; Dask gives up at the first loss."""
    settings: dict[str, Any] = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **settings) as made,
    ):
        yield made


def written(folder: Path, text: str) -> Path:
    """A study file beside the scenario of the plane."""
    shutil.copy(ROOT / "tests" / "hosts" / "plane.py", folder)
    (folder / "some.toml").write_text(text)
    return folder / "some.toml"


def rows(out: Path) -> int:
    """Rows in a journal."""
    path = out / "journal.jsonl"
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0


def reach(out: Path, count: int, process: subprocess.Popen[bytes] | None = None) -> None:
    """Wait until a journal has so many rows."""
    deadline = time.monotonic() + 300
    while rows(out) < count:
        assert time.monotonic() < deadline
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.02)


def kill_worker(cluster: Any, which: random.Random) -> None:
    """Kill a worker as the kernel does when memory is short."""
    alive = [nanny.process.pid for nanny in cluster.workers.values() if nanny.process.pid]
    os.kill(which.choice(alive), signal.SIGKILL)


def through_losses(cluster: Any, path: Path, out: Path, kills: list[int], client: int) -> None:
    """Do a study, killing a worker at each of these numbers of rows and the client at that one."""
    which = random.Random(1)
    command = [sys.executable, "-m", "scenarios", "study", path, "--out", out]
    command += ["--scheduler", cluster.scheduler_address, "--flavour", fmus.flavour()]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE)
    reach(out, client, process)
    process.kill()
    process.communicate()
    kept = rows(out)
    assert client <= kept < kills[0]

    def killer() -> None:
        for count in kills:
            reach(out, count)
            kill_worker(cluster, which)

    thread = threading.Thread(target=killer)
    thread.start()
    outcome = study.run(study.load(path), out=out, scheduler=cluster.scheduler_address)
    thread.join()
    number = len(outcome.table)
    assert f"{number} runs, {number - kept} of them now" in outcome.verdict
    lines = (out / "journal.jsonl").read_text().splitlines()[1:]
    assert sorted(json.loads(line)["run"] for line in lines) == list(range(number))
    assert set(outcome.table["status"]) == {"ok"}


def test_lost_workers_and_a_killed_client_change_no_byte(cluster: Any, tmp_path: Path) -> None:
    path = written(tmp_path, PLANE)
    through_losses(cluster, path, tmp_path / "out", kills=[30], client=8)
    study.run(study.load(path), out=tmp_path / "serial", jobs=1)
    for name in SAME:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "serial" / name).read_bytes()


def test_a_run_that_ends_its_process_costs_no_worker(cluster: Any, tmp_path: Path) -> None:
    before = [nanny.process.pid for nanny in cluster.workers.values()]
    path = written(
        tmp_path,
        """
        scenario = "plane.py"
        timeout = 2.0
        [grid]
        mood = ["segfault", "leave", "hang", "good"]
        """,
    )
    outcome = study.run(study.load(path), out=tmp_path / "out", scheduler=cluster.scheduler_address)
    assert outcome.table["status"].tolist() == ["crashed", "crashed", "timeout", "ok"]
    assert [nanny.process.pid for nanny in cluster.workers.values()] == before


def test_a_cluster_that_is_not_there_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scenarios.runs.cluster.CONNECT", 1.0)
    plan = study.load(written(tmp_path, PLANE))
    with pytest.raises(SetupError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        study.run(plan, out=tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(SetupError, match="jobs are processes of this machine"):
        study.run(plan, out=tmp_path / "out", scheduler="tcp://127.0.0.1:9", jobs=2)


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """A scheduler and the folder of its only worker: the project's code, and no FMUs."""
    home = tmp_path / "elsewhere"
    for package in ("cosim", "scenarios"):
        shutil.copytree(
            ROOT / package, home / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    settings: dict[str, Any] = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with LocalCluster(n_workers=0, **settings) as made:
        command = [sys.executable, "-m", "dask", "worker", made.scheduler_address]
        command += ["--nthreads", "1", "--no-dashboard", "--local-directory", tmp_path / "scratch"]
        worker = subprocess.Popen(
            command, cwd=home, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            yield made.scheduler_address, home
        finally:
            worker.terminate()
            worker.wait(30)


def test_fmus_travel_to_workers_and_other_code_is_refused(
    elsewhere: tuple[str, Path], tmp_path: Path
) -> None:
    address, home = elsewhere
    path = written(tmp_path, CUP.format(number=4))
    there = study.run(study.load(path), out=tmp_path / "there", scheduler=address)
    here = study.run(study.load(path), out=tmp_path / "here", jobs=1)
    assert set(there.table["status"]) == {"ok"}
    assert (tmp_path / "there" / "table.csv").read_bytes() == (
        tmp_path / "here" / "table.csv"
    ).read_bytes()
    for _, row in here.table.iterrows():
        start = [f"orientator.chute.mu={row['orientator.chute.mu']}"]
        figures = orientator_cycle.answer(speed=row["speed"], start=start).figures
        assert row["orientation_time"] == figures["orientation_time"].value
    assert here.table["orientation_time"].nunique() == 4
    assert not (home / "fmus").exists()
    with (home / "cosim" / "curve.py").open("a") as file:
        file.write("# changed\n")
    with Client(address) as client:
        client.restart()
    with pytest.raises(
        SetupError, match=r"worker tcp.* differs: cosim/curve.py is [0-9a-f]* there"
    ):
        study.run(study.load(path), out=tmp_path / "again", scheduler=address)


@pytest.mark.slow
def test_two_thousand_runs_survive_four_lost_workers_and_a_killed_client(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(fmus.CHOICE, "native")
    path = written(tmp_path, CUP.format(number=2048))
    out, serial = tmp_path / "out", tmp_path / "serial"
    began = time.monotonic()
    through_losses(cluster, path, out, kills=[600, 900, 1200, 1500], client=300)
    middle = time.monotonic()
    study.run(study.load(path), out=serial, jobs=1)
    print(f"cluster {middle - began:.0f} s, serial {time.monotonic() - middle:.0f} s")
    for name in SAME:
        assert (out / name).read_bytes() == (serial / name).read_bytes()
