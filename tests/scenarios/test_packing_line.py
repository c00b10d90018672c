"""The packing line: its answers against independent figures, and its SSP in other hosts."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import simpson

from cosim import System, run
from scenarios.__main__ import PROJECT
from scenarios.conveyor.theory import SETS
from scenarios.packing_line import line as packing
from scenarios.packing_line import packing_line
from tests.conftest import ROOT, ask, fmus_of
from workbench.answer import finish
from workbench.command import main

HOSTS = ROOT / "tests" / "hosts"
COMPARED = [
    "iron_motor.P", "iron.w_cam", "iron.E_friction", "orientator.phi2", "orientator.t_turning",
    "orientator.orientation_time", "conveyor_motor.P", "conveyor.w", "conveyor.x",
]  # fmt: skip


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The scenario as it is, on compiled FMUs: folder, rows, facts, what it printed."""
    folder = tmp_path_factory.mktemp("line")
    command = [sys.executable, "-m", "scenarios", "run", "packing_line", "--flavour", "native"]
    command += ["--out", str(folder)]
    done = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    facts = json.loads((folder / "packing_line.json").read_text())
    return folder, pd.read_csv(folder / "packing_line.csv"), facts, done.stdout


def test_the_orientator_alone_takes_as_long(answer: Any, fmus: Path) -> None:
    """Between its times at the lowest and the highest speed that it sees before it ends."""
    _, rows, facts, said = answer
    found = facts["figures"]["orientation"]["value"]
    assert facts["figures"]["orientation"]["error"] < 1e-5
    release, following = np.flatnonzero(np.diff(rows["iron.top_dwell"]) > 0.5)[-2:] + 1
    t = rows["time"] - rows["time"][release]
    speed = 1.25 * rows["iron.w_cam"][(t >= 0) & (t <= found)]
    times = []
    for w in (speed.min(), speed.max()):
        start = {"orientator.w": float(w), "orientator.release": True}
        alone = System({"orientator": fmus / "GravityOrientator.fmu"}, start=start)
        record = ["orientator.orientation_time"]
        times.append(run(alone, stop=0.5, step=0.01, record=record).data[-1, 1])
    assert times[0] < found < times[1] < 1.01 * times[0]
    cycle = facts["figures"]["cycle"]["value"]
    line = {x: facts["parameters"][f"iron_motor.{x}"]["value"] for x in "AB"}
    whole = rows[release : following + 1]
    pull = simpson(whole["iron_motor.tau"], x=whole["time"]) / np.ptp(whole["time"])
    assert 2 * math.pi / cycle == pytest.approx((line["A"] - pull) / line["B"] / 36, rel=5e-4)
    spare = facts["figures"]["spare"]
    assert spare["value"] == pytest.approx(cycle - found, rel=1e-12)
    assert re.search(rf"{spare['value']:.3f}\d* ± \S+ s to spare", said)
    assert [facts["figures"][x]["value"] for x in ("released", "oriented")] == [3, 3]


def test_the_supply_gives_what_both_drives_store_and_lose(answer: Any) -> None:
    """Over the whole cycles; the losses are those that the mechanisms themselves account for."""
    _, rows, facts, _ = answer
    releases = np.flatnonzero(np.diff(rows["iron.top_dwell"]) > 0.5) + 1
    rows = rows.iloc[releases[0] : releases[-1] + 1]
    t = rows["time"].to_numpy()
    ends = rows.iloc[[0, -1]]

    def gain(*names: str) -> float:
        return float(np.diff(ends[list(names)].sum(axis=1))[0])

    stored = gain("iron.E_kin", "iron.E_pot", "conveyor.E_kin", "conveyor.E_pot")
    lost = gain("iron.E_friction") + float(simpson(rows["conveyor.P_loss"], x=t))
    given = float(simpson(rows["P_supply"], x=t))
    assert given == pytest.approx(stored + lost, rel=1e-4)
    supply = facts["figures"]["mean_supply"]["value"]
    assert supply == pytest.approx(given / (t[-1] - t[0]), rel=2e-3)
    friction = gain("iron.E_friction") / (t[-1] - t[0])
    assert facts["figures"]["mean_iron"]["value"] == pytest.approx(friction, rel=1e-3)


def test_ripple_of_the_supply_is_that_of_its_drives(answer: Any) -> None:
    """Orders 2 of the crank by theory; far apart, mean squares add."""
    folder, _, facts, said = answer
    lines = pd.read_csv(folder / "packing_line_orders.csv").to_dict("records")
    ripple = {(x["drive"], x["order"]): x for x in lines}
    crank = ripple["conveyor", 2]
    assert crank["frequency"] == pytest.approx(2 * 60.0 / (2 * math.pi), rel=1e-3)
    assert crank["supply"] == pytest.approx(crank["own"], rel=1e-2)
    theory, nu = SETS["B"], 60.0
    ripple_2 = theory.load_slope * nu * theory.speed_ripple(nu) + nu * theory.torque_ripple(nu)
    assert crank["own"] == pytest.approx(abs(ripple_2), rel=1e-2)
    rms = {
        name: facts["figures"][f"rms_{name}"]["value"] for name in ("iron", "conveyor", "supply")
    }
    assert rms["supply"] == pytest.approx(math.hypot(rms["iron"], rms["conveyor"]), rel=2e-3)
    assert facts["figures"]["main_conveyor"]["value"] == pytest.approx(crank["own"], rel=1e-12)
    assert "most of it in order 2 of the crank" in said
    assert "The ripples sit apart in frequency" in said


def test_figures_carry_coupling_errors_and_the_files_are_there(answer: Any) -> None:
    folder, rows, facts, _ = answer
    for name, figure in facts["figures"].items():
        assert figure["error"] is not None
        assert figure["error"] <= 1e-3 * abs(figure["value"]) or name == "correlation"
    assert facts["algorithm"] == "strang"
    assert facts["options"]["gear"]["value"] == 1.25
    assert set(facts["parts"]) == {
        "iron_motor", "iron", "orientator", "conveyor_motor", "conveyor"
    }  # fmt: skip
    assert_allclose(rows["P_supply"], rows["iron_motor.P"] + rows["conveyor_motor.P"], rtol=1e-12)


@pytest.mark.parametrize(
    ("gear", "reason", "missed"), [(2.2, "catcher stopped", 0), (3.0, "held in chute", 2)]
)
def test_a_rotor_geared_too_fast_jams_with_its_reason(
    tmp_path: Path, gear: float, reason: str, missed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table of the orientator: catcher stopped from 82, held in the chute from 101 rpm."""
    line = ask("packing_line", gear=gear, step=1e-3, algorithm="gauss-seidel", stop=3.9)
    finish(line, tmp_path)
    said = capsys.readouterr().out
    facts = json.loads((tmp_path / "packing_line.json").read_text())
    figures = facts["figures"]
    assert (figures["released"]["value"], figures["oriented"]["value"]) == (2, 0)
    assert (
        f"The line does not keep pace: 0 of 2 products are oriented, the orientator jams: {reason}"
        in said
    )
    assert (f"; {missed} of the releases find it under way" in said) == (missed > 0)
    assert figures["orientation"]["error"] is None and reason in figures["orientation"]["reason"]
    assert figures["lost"]["value"] == pytest.approx(60 / figures["cycle"]["value"], rel=1e-12)
    assert figures["products"]["value"] == 0.0


def test_ripples_that_meet_are_told() -> None:
    """Order 2 of the crank on order 7 of the cam."""
    said = ask("packing_line", speed=3.5 * 4.1869, stop=3.9, step=1e-3).verdict
    assert "The ripples meet: order 7 of the cam and order 2 of the crank" in said


@pytest.mark.parametrize(
    ("options", "message", "code"),
    [
        (["--gear", 0], "gear = 0 must be a finite number above 0", 2),
        (["--iron-speed", "nan"], "iron_speed = nan rad/s must be a finite number above 0", 2),
        (["--speed", -1], "speed = -1 rad/s must be a finite number above 0", 2),
        (["--stop", 2], "stop = 2 s must be at least 3.817 s, two cycles after the first", 2),
        (["--step", 0], "step = 0 s must be a finite number above 0 s", 2),
        (["--set", "C"], "set = 'C' must be one of A, B", 2),
        (["--iron-speed", 0.5, "--stop", 33], "the cam stands or turns back", 2),
        (["--iron-speed", 9], "cam follower lifts off", 1),
    ],
    ids=lambda x: str(x)[:30],
)
def test_what_the_line_cannot_do_is_one_line(
    tmp_path: Path,
    options: list[object],
    message: str,
    code: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    call = ["run", "packing_line", "--out", out, "--flavour", "native", *options]
    assert main([*map(str, call)], PROJECT, "python -m scenarios") == code
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert told.count("\n") == 1
    assert message in told
    assert not out.exists()


def ours(step: float, steps: int, record: list[str]) -> np.ndarray:
    """What our Jacobi master makes of the system that was written."""
    system = packing.system(fmus_of(packing_line), 1.25, 4 * math.pi / 3, "B", 60.0)
    settings: dict[str, Any] = {"stop": step * steps, "step": step, "algorithm": "jacobi"}
    result = run(system, **settings, record=record)
    return np.column_stack([result[name] for name in record])


def test_libcosim_runs_the_line_with_our_numbers(answer: Any) -> None:
    """A release and an orientation; the file asks for parameters only, which libcosim sets."""
    ssp, step, steps = answer[0] / "line.ssp", 1e-3, 1100
    parts = dict.fromkeys(answer[2]["parts"])
    task = {
        "parts": parts,
        "wires": [],
        "start": {},
        "record": COMPARED,
        "steps": steps,
        "step": step,
    }
    command = [sys.executable, str(HOSTS / "libcosim_system.py"), json.dumps(task), str(ssp)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    theirs = np.array(json.loads(done.stdout))[:, 1:]
    mine = ours(step, steps, COMPARED)[1:]
    assert mine[-1, COMPARED.index("orientator.orientation_time")] > 0.28
    assert_allclose(theirs, mine, rtol=1e-9, atol=1e-10)


def test_ecos_runs_the_line_with_our_numbers(answer: Any, tmp_path: Path) -> None:
    """Its program, without Python, prints six decimals."""
    step, steps = 1e-3, 1100
    spec = find_spec("ecospy")
    assert spec
    assert spec.origin
    program = Path(shutil.copy(Path(spec.origin).parent / "binaries" / "ecos", tmp_path))
    program.chmod(0o755)
    shutil.copy(answer[0] / "line.ssp", tmp_path)
    call = [program, "simulate", "--path", "line.ssp", "--stepSize", step]
    call += ["--stopTime", (steps + 0.5) * step, "--parameterSet", "start"]
    path = os.pathsep.join((str(HOSTS / "bin"), f"{sys.prefix}/bin", os.environ["PATH"]))
    folders = {"PATH": path, "LD_LIBRARY_PATH": f"{sys.prefix}/lib", "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [*map(str, call)],
        cwd=tmp_path,
        env={**os.environ, **folders},
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with (tmp_path / "line.csv").open(newline="") as file:
        rows = list(csv.DictReader(file, skipinitialspace=True))
    columns = [f"{name.replace('.', '::', 1)}[REAL]" for name in COMPARED]
    theirs = np.array([[float(row[column]) for column in columns] for row in rows])
    mine = ours(step, steps, COMPARED)
    assert mine[-1, COMPARED.index("orientator.orientation_time")] > 0.28
    assert_allclose(theirs, mine, rtol=0.0, atol=6e-7)
