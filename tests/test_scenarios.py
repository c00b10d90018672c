"""The scenarios as a user runs them: figures, files, verdicts and refusals."""

from __future__ import annotations

import csv
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, hear_ctrl_c

from scenarios import fmus as scenario_fmus
from scenarios.__main__ import main
from scenarios.theory import SETS, longest_step

COLUMNS = (
    "nu,w2,w2_phase,tau2,tau2_phase,w2_theory,w2_phase_theory,tau2_theory,tau2_phase_theory,lag,"
    "w_mean,f_rod_peak"
)
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


def scenario(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "scenarios", *map(str, arguments)]
    return subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True)


def table(path: Path) -> dict[float, dict[str, float]]:
    with path.open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    return {row["nu"]: row for row in rows}


def turn(a: float, b: float) -> float:
    """Distance of two angles in degrees."""
    return abs((a - b + 180) % 360 - 180)


@pytest.fixture(
    scope="module",
    params=["A native", "B native", pytest.param("A python", marks=pytest.mark.slow)],
)
def sweep(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The resonance scenario with its defaults: name, folder, what it printed."""
    folder = tmp_path_factory.mktemp("resonance")
    name, flavour = request.param.split()
    done = scenario("run", "resonance", "--set", name, "--out", folder, "--flavour", flavour)
    assert done.returncode == 0, done.stderr
    assert json.loads((folder / "resonance.json").read_text())["flavour"] == flavour
    return name, folder, done.stdout


def test_ripple_follows_first_order_theory_at_every_speed(sweep: Any) -> None:
    name, folder, _ = sweep
    rows = table(folder / "resonance.csv")
    assert (folder / "resonance.csv").read_text().splitlines()[0] == COLUMNS
    assert len(rows) == EXPECTED[name]["count"]
    for row in rows.values():
        assert row["w2"] == pytest.approx(row["w2_theory"], rel=4e-3)
        assert row["tau2"] == pytest.approx(row["tau2_theory"], rel=3e-3)
        assert turn(row["w2_phase"], row["w2_phase_theory"]) < 0.2
        assert turn(row["tau2_phase"], row["tau2_phase_theory"]) < 0.2


def test_reference_points_are_met(sweep: Any) -> None:
    name, folder, _ = sweep
    rows = table(folder / "resonance.csv")
    for nu, want in EXPECTED[name].items():
        if isinstance(nu, float):
            row = rows[nu]
            got = [row[k] for k in ("w2", "tau2", "w_mean", "f_rod_peak")]
            assert got == pytest.approx([want[0], want[2], want[4], want[5]], rel=5e-4)
            assert turn(row["w2_phase"], want[1]) < 0.02
            assert turn(row["tau2_phase"], want[3]) < 0.02


def test_resonance_and_peaks_lie_where_theory_puts_them(sweep: Any) -> None:
    name, folder, said = sweep
    facts = json.loads((folder / "resonance.json").read_text())
    assert facts["nu_res"] == pytest.approx(EXPECTED[name]["nu_res"], rel=1e-12)
    assert facts["nu_90"] == pytest.approx(EXPECTED[name]["nu_res"], rel=5e-4)
    for peak in ("nu_peak_tau", "nu_peak_w"):
        assert facts[peak] == pytest.approx(EXPECTED[name][peak], rel=3e-3)
    assert abs(facts["nu_90"] - facts["nu_res"]) > facts["coupling_error"]["nu_90"]
    for order in facts["coupling_order"].values():
        assert order == pytest.approx(2.0, abs=0.2)
    assert max(facts["peak_error"].values()) < 1e-3 * facts["peak"]["nu_peak_tau"]
    assert (facts["algorithm"], facts["steps_per_rev"]) == ("strang", 512)
    assert {"parameters", "parts", "versions", "wall_time"} <= facts.keys()
    assert (folder / "resonance.png").stat().st_size > 20_000
    assert f"Formula (22) puts the resonance at {EXPECTED[name]['nu_res']:.3f} rad/s" in said
    assert "lags the load ripple by 90 degrees: found at" in said
    assert "These speeds differ because" in said


def test_tables_are_identical_in_parallel_and_with_native_fmus(tmp_path: Path) -> None:
    options = ("--speeds", "38:42:5", "--steps-per-rev", "48")
    ways = {"one": ("--jobs", 1), "two": ("--jobs", 2), "native": ("--flavour", "native")}
    for name, way in ways.items():
        done = scenario("run", "resonance", *options, *way, "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
    one, two, native = (tmp_path / name / "resonance.csv" for name in ways)
    assert one.read_bytes() == two.read_bytes() == native.read_bytes()
    assert len(table(one)) == 5


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


REFUSED = [
    (["run", "resonanz"], "invalid choice: 'resonanz'"),
    (["sweep"], "invalid choice: 'sweep'"),
    (["run", "resonance", "--sped", "3"], "unrecognized arguments: --sped 3"),
    (["run", "resonance", "--set", "C"], "--set: invalid choice: 'C'"),
    (["run", "resonance", "--algorithm", "euler"], "--algorithm: invalid choice: 'euler'"),
    (["run", "resonance", "--steps-per-rev", "12"], "12 steps per revolution must be more than 16"),
    (
        ["run", "resonance", "--algorithm", "jacobi", "--steps-per-rev", "61", "--speeds", "40"],
        "61 steps per revolution are unstable with jacobi at 40 rad/s: its limit there is 61.24",
    ),
    (["run", "resonance", "--speeds", "30;40"], "speeds '30;40' must read from:to:number or a,b,c"),
    (["run", "resonance", "--speeds", "0,40"], "speed = 0.0 rad/s must be a finite number above 0"),
    (["run", "resonance", "--speeds", "30:40:0"], "speeds '30:40:0' name no number"),
    (["run", "resonance", "--jobs", "0"], "jobs = 0 must be at least 1"),
    (["run", "resonance", "--jobs", "two"], "--jobs: invalid int value: 'two'"),
    (["run", "run_up", "--step", "0"], "step = 0.0 s must be above 0"),
    (["run", "run_up", "--speed", "nan"], "speed = nan rad/s must be a finite number above 0"),
    (
        ["run", "iron_cycle", "--start", "iron.cam.R_b=0.05"],
        "cam triangle cannot close: cam.R_b = 0.05",
    ),
    (["run", "iron_cycle", "--start", "iron.cam.R"], "'iron.cam.R' must read NAME=VALUE"),
    (["run", "iron_start", "--motor-T", "0"], "T = 0.0 s must be > 0"),
    (["run", "iron_orders", "--speeds", "-1"], "speed = -1.0 rad/s must be a finite"),
    (["run", "orientation_time", "--frictions", "a"], "frictions 'a' must read"),
    (["run", "orientator_cycle", "--speed", "inf"], "speed = inf rpm must be a finite number"),
    (["run", "run_up", "--stop", "-1"], "stop = -1.0 s must be after start = 0.0 s"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=lambda x: str(x)[:40])
def test_bad_input_gets_one_line_and_code_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(scenario_fmus.CHOICE, "python")
    out = ["--out", str(tmp_path / "out")] if len(arguments) > 2 else []
    assert main([*arguments, *out]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_command_ends_with_its_exit_code() -> None:
    done = scenario("run", "resonanz")
    assert (done.returncode, done.stdout) == (2, "")
    assert "invalid choice: 'resonanz'" in done.stderr


def test_ctrl_c_keeps_the_speeds_that_are_done(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "scenarios", "run", "resonance", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*command, "--jobs", "2", "--steps-per-rev", "128"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=hear_ctrl_c,  # noqa: PLW1509
    )
    partial = tmp_path / "resonance.partial.csv"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if partial.exists() and len(partial.read_text().splitlines()) > 3:
            break
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors.decode()
    assert f"of 31 speeds in {partial}" in errors.decode()
    assert "Traceback" not in errors.decode()
    assert not (tmp_path / "resonance.csv").exists()
    assert 3 <= len(table(partial)) < 31


def test_run_up_passes_the_resonance_with_both_motors(tmp_path: Path) -> None:
    done = scenario("run", "run_up", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads((tmp_path / "run_up.json").read_text())
    assert 0.0 < facts["passing"]["linear"] < facts["passing"]["kloss"] < 0.5
    for motor, low, high in (("linear", 59.0, 61.0), ("kloss", 64.0, 65.4)):
        with (tmp_path / f"{motor}.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert float(rows[0]["conveyor.w"]) == 0.0
        late = [float(row["conveyor.w"]) for row in rows[len(rows) * 4 // 5 :]]
        assert low < sum(late) / len(late) < high
    assert (tmp_path / "run_up.png").stat().st_size > 20_000


def test_list_names_every_scenario_and_its_question() -> None:
    lines = scenario("list").stdout.splitlines()
    assert [line.split()[0] for line in lines] == [
        "resonance",
        "resonance_map",
        "run_up",
        "iron_cycle",
        "iron_start",
        "iron_orders",
        "orientation_time",
        "orientator_cycle",
        "packing_line",
    ]
    assert all(line.endswith("?") for line in lines)


def test_iron_cycle_tells_torque_forces_and_limits(tmp_path: Path) -> None:
    done = scenario("run", "iron_cycle", "--animate", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "cycle.csv").open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    torque = [row["tau_cam"] for row in rows]
    assert (min(torque), max(torque)) == pytest.approx((-7.409358425, 6.627300006), rel=1e-5)
    assert max(row["lift"] for row in rows) == pytest.approx(0.062385664995, rel=1e-7)
    assert min(row["N"] for row in rows) == pytest.approx(175.4239707, rel=1e-4)
    at_10 = rows[40]
    assert at_10["phi"] == pytest.approx(math.radians(10.0), rel=1e-9)
    assert at_10["tau_cam"] == pytest.approx(0.43224335899, rel=1e-6)
    assert at_10["N"] == pytest.approx(249.00775848, rel=1e-6)
    assert rows[-1]["E_friction"] == pytest.approx(0.748782419985, rel=1e-7)
    limits = json.loads((tmp_path / "cycle.json").read_text())["limits"]
    for force, limit in (("N", 7.89776), ("T_span", 8.54097), ("T_iron", 9.11191)):
        assert limits[force][0] == pytest.approx(limit, rel=1e-4)
    assert "Faster: the follower lifts off at 7.897" in done.stdout
    assert (tmp_path / "cycle.gif").stat().st_size > 100_000
    assert (tmp_path / "cycle.png").stat().st_size > 20_000


def test_iron_cycle_with_the_spring_above(tmp_path: Path) -> None:
    done = scenario("run", "iron_cycle", "--start", "iron.spring.side=-1", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    limits = json.loads((tmp_path / "cycle.json").read_text())["limits"]
    assert limits["N"][0] == pytest.approx(5.15434, rel=1e-4)


def test_iron_start_keeps_the_energy_ledger(tmp_path: Path) -> None:
    done = scenario("run", "iron_start", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "start.csv").open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    reference = {
        0.1: (-0.65810204326, 4.36088738387, 3.889255535, 0.0),
        1.0: (3.31017967564, 4.57811231216, 8.558056480, 0.475497139),
        3.0: (12.21472872729, 4.43855728039, 5.583556326, 1.497564840),
    }
    for t, (phi, w, work, friction) in reference.items():
        row = min(rows, key=lambda row: abs(row["time"] - t))
        assert row["iron.phi"] == pytest.approx(phi, abs=1e-3)
        assert row["iron.w_cam"] == pytest.approx(w, abs=2e-3)
        assert row["E_in"] == pytest.approx(work, abs=3e-3)
        assert row["E_friction"] == pytest.approx(friction, abs=1e-3)
        assert row["E_in"] == pytest.approx(
            row["E_stored"] + row["E_friction"] + row["E_missing"], abs=1e-12
        )
    assert max(abs(row["E_missing"]) for row in rows) < 2e-3
    assert "(42.39 cycles/min)" in done.stdout


def test_iron_orders_tell_when_a_resonance_matters(tmp_path: Path) -> None:
    options = ("--speeds", "5", "--jobs", 1, "--flavour", "native")
    done = scenario("run", "iron_orders", *options, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "orders.csv").open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    wanted = {
        (0.012, 5.0): (2.970, 1.124, 1.836, 1.311, 0.756, 0.787, 0.375, 0.315),
        (0.08, 5.0): (3.032, 1.179, 2.266, 1.908, 1.487, 1.916, 0.829, 0.404),
    }
    for (T, nu), amplitudes in wanted.items():
        got = [row["torque"] for row in rows if (row["T"], row["nu"]) == (T, nu)][:8]
        assert got == pytest.approx(amplitudes, abs=3e-3)
    facts = json.loads((tmp_path / "orders.json").read_text())
    assert list(facts["w_n"].values()) == pytest.approx([81.31, 31.490, 19.916], rel=1e-4)
    assert facts["follower_lifts"] == pytest.approx(7.89776, rel=1e-4)
    words = [line for line in done.stdout.splitlines() if "practical importance" in line]
    assert ["of no practical" in line for line in words] == [True, False, False]


def test_orientation_time_finds_the_limits(tmp_path: Path) -> None:
    done = scenario(
        "run", "orientation_time", "--speeds", "0,20,40,60,80,102", "--out", tmp_path, "--jobs", 1
    )
    assert done.returncode == 0, done.stderr
    with (tmp_path / "orientation_time.csv").open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    time = {(row["mu"], row["n"]): row["orientation_time"] for row in rows}
    for case, want in {
        (0.2, 0.0): 0.2387752354,
        (0.35, 20.0): 0.2441613488,
        (0.5, 40.0): 0.2777869131,
        (0.5, 60.0): 0.3991961493,
    }.items():
        assert time[case] == pytest.approx(want, abs=1e-7)
    limits = json.loads((tmp_path / "orientation_time.json").read_text())["limits_rpm"]
    for mu, n in (("0.2", 100.23145), ("0.35", 77.75026), ("0.5", 62.12296)):
        assert limits[mu]["works"] <= n <= limits[mu]["jams"]
    assert "mu = 0.5: works up to 62.12 +- 0.01 rpm" in done.stdout
    assert (tmp_path / "orientation_time.png").stat().st_size > 20_000


def test_orientator_cycle_shows_one_product(tmp_path: Path) -> None:
    done = scenario("run", "orientator_cycle", "--animate", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Oriented after 0.26381 s; falling 98.33 ms, joint 72.01 ms" in done.stdout
    jammed = scenario(
        "run", "orientator_cycle", "--speed", 62.5, "--friction", 0.5, "--out", tmp_path / "jam"
    )
    assert "Jammed: rotation stopped after release" in jammed.stdout
    assert (tmp_path / "cycle.gif").stat().st_size > 50_000
    assert (tmp_path / "cycle.csv").read_text().startswith("time,orientator.stage,")
