"""The packing line: its answers against independent figures, and its SSP in other hosts."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import simpson

from cosim import System, run
from scenarios.conveyor.first_order import SETS
from scenarios.packing_line.questions import packing_line
from tests.conftest import ROOT, ask, fmus_of
from workbench.answer import Answer

HOSTS = ROOT / "tests" / "hosts"
STEP, STEPS = 1e-3, 1100
COMPARED = [
    "iron_motor.P", "iron.w_cam", "iron.E_friction", "orientator.phi2", "orientator.t_turning",
    "orientator.orientation_time", "conveyor_motor.P", "conveyor.w", "conveyor.x",
]  # fmt: skip


@pytest.fixture(scope="module")
def line() -> Answer:
    """The question as it is, on compiled FMUs."""
    return ask("packing_line")


@pytest.fixture(scope="module")
def cycles(line: Answer) -> list[int]:
    """The rows of the releases."""
    rows = line.tables["packing_line.csv"].frame
    return (np.flatnonzero(np.diff(rows["iron.top_dwell"]) > 0.5) + 1).tolist()


def values(line: Answer) -> dict[str, float]:
    """Those of all figures."""
    return {name: figure.value for name, figure in line.figures.items()}


def test_a_single_orientator_takes_as_long(line: Answer, cycles: list[int], fmus: Path) -> None:
    """Between its times at the lowest and the highest speed that it sees before it ends."""
    rows, f = line.tables["packing_line.csv"].frame, values(line)
    release, following = cycles[-2:]
    t = rows["time"] - rows["time"][release]
    speed = 1.25 * rows["iron.w_cam"][(t >= 0) & (t <= f["orientation"])]
    times = []
    for w in (speed.min(), speed.max()):
        start = {"orientator.w": float(w), "orientator.release": True}
        single = System({"orientator": fmus / "GravityOrientator.fmu"}, start=start)
        record = ["orientator.orientation_time"]
        times.append(run(single, stop=0.5, step=0.01, record=record).data[-1, 1])
    assert times[0] < f["orientation"] < times[1] < 1.01 * times[0]
    A, B = (line.parameters[f"iron_motor.{x}"].value for x in "AB")
    passage = rows[release : following + 1]
    pull = simpson(passage["iron_motor.tau"], x=passage["time"]) / np.ptp(passage["time"])
    assert 2 * math.pi / f["cycle"] == pytest.approx((A - pull) / B / 36, rel=5e-4)
    assert f["spare"] == pytest.approx(f["cycle"] - f["orientation"], rel=1e-12)
    assert (f["released"], f["oriented"], f["missed"]) == (3, 3, 0)


def test_the_supply_gives_what_both_drives_store_and_lose(line: Answer, cycles: list[int]) -> None:
    """Over the whole cycles; the losses are those that the mechanisms themselves account for."""
    f, rows = values(line), line.tables["packing_line.csv"].frame.iloc[cycles[0] : cycles[-1] + 1]
    t, ends = rows["time"].to_numpy(), rows.iloc[[0, -1]]

    def gain(*names: str) -> float:
        return float(np.diff(ends[list(names)].sum(axis=1))[0])

    stored = gain("iron.E_kin", "iron.E_pot", "conveyor.E_kin", "conveyor.E_pot")
    losses = gain("iron.E_friction") + float(simpson(rows["conveyor.P_loss"], x=t))
    supplied = float(simpson(rows["P_supply"], x=t))
    assert supplied == pytest.approx(stored + losses, rel=1e-4)
    assert f["mean_supply"] == pytest.approx(supplied / np.ptp(t), rel=2e-3)
    assert f["work"] == pytest.approx(f["mean_supply"] * f["cycle"], rel=1e-9)
    assert f["mean_iron"] == pytest.approx(gain("iron.E_friction") / np.ptp(t), rel=1e-3)
    assert_allclose(rows["P_supply"], rows["iron_motor.P"] + rows["conveyor_motor.P"], rtol=1e-12)


def test_ripple_of_the_supply_is_that_of_its_drives(line: Answer) -> None:
    """Orders 2 of the crank by theory; far apart, mean squares add."""
    orders = line.tables["packing_line_orders.csv"].frame.set_index(["drive", "order"])
    crank, f, theory, nu = orders.loc["conveyor", 2], values(line), SETS["B"], 60.0
    assert crank["frequency"] == pytest.approx(2 * nu / (2 * math.pi), rel=1e-3)
    ripple_2 = theory.load_slope * nu * theory.speed_ripple(nu) + nu * theory.torque_ripple(nu)
    assert crank["own"] == pytest.approx(abs(ripple_2), rel=1e-2)
    separately = math.hypot(f["rms_iron"], f["rms_conveyor"])
    assert f["rms_supply"] == pytest.approx(separately, rel=2e-3)
    assert f["main_conveyor"] == pytest.approx(crank["own"], rel=1e-12)
    for name, figure in line.figures.items():
        assert figure.error is not None and figure.error <= 1e-3 * abs(figure.value), name


@pytest.mark.parametrize(
    ("gear", "reason", "missed", "end"),
    [(2.2, "catcher stopped", 0, "jammed"), (3.0, "held in chute", 2, "falling")],
)
def test_a_rotor_geared_too_fast_jams_with_its_reason(
    gear: float, reason: str, missed: int, end: str
) -> None:
    """The table of the orientator: catcher stopped from 82, held in the chute from 101 rpm."""
    line = ask("packing_line", gear=gear, step=1e-3)
    f, counted = values(line), {"released": 3, "oriented": 0, "missed": missed, "products": 0}
    assert {x: line.figures[x][:3:2] for x in counted} == {x: (n, 0) for x, n in counted.items()}
    assert f["lost"] == pytest.approx(60 / f["cycle"], rel=1e-12)
    jam = f"the orientator jams: {reason}"
    assert line.figures["orientation"].reason == line.figures["spare"].reason == jam
    (chart,) = line.show().charts
    assert chart.panels[1].rows["orientator"][-1].text == end
    assert chart.title.endswith(f" lost: {reason}")


def test_ripples_that_meet_are_named(line: Answer) -> None:
    """Order 2 of the crank on order 7 of the cam."""
    met = ask("packing_line", speed=3.5 * 4.1869, step=1e-3)
    orders = met.tables["packing_line_orders.csv"].frame.set_index(["drive", "order"])
    both = orders.loc[[("iron", 7), ("conveyor", 2)]]
    assert both["supply"].tolist() == pytest.approx([both["own"].sum()] * 2, rel=1e-12)
    far = line.tables["packing_line_orders.csv"].frame
    assert far["supply"].tolist() == far["own"].tolist()


@pytest.fixture(scope="module")
def ours() -> np.ndarray:
    """What our Jacobi master makes of the system that was written: a release and an orientation."""
    system = packing_line.PackingLine.parse({}).system(fmus_of(packing_line))
    result = run(system, stop=STEPS * STEP, step=STEP, algorithm="jacobi", record=COMPARED)
    assert result["orientator.orientation_time"][-1] > 0.28
    return result.data[:, 1:]


@pytest.fixture(scope="module")
def ssp(line: Answer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The line as other hosts read it."""
    path = tmp_path_factory.mktemp("ssp") / "line.ssp"
    line.files["line.ssp"](path)
    return path


def test_ecos_runs_the_line_with_our_numbers(ssp: Path, ours: np.ndarray, tmp_path: Path) -> None:
    """Its program, without Python, prints six decimals."""
    spec = find_spec("ecospy")
    assert spec and spec.origin
    program = Path(shutil.copy(Path(spec.origin).parent / "binaries" / "ecos", tmp_path))
    program.chmod(0o755)
    call = [program, "simulate", "--path", ssp, "--stepSize", STEP]
    call += ["--stopTime", (STEPS + 0.5) * STEP, "--parameterSet", "start"]
    path = os.pathsep.join((str(HOSTS / "bin"), f"{sys.prefix}/bin", os.environ["PATH"]))
    folders = {"PATH": path, "LD_LIBRARY_PATH": f"{sys.prefix}/lib", "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [*map(str, call)], cwd=tmp_path, env={**os.environ, **folders}, check=False,
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    rows = pd.read_csv(tmp_path / "line.csv", skipinitialspace=True)
    theirs = rows[[f"{name.replace('.', '::', 1)}[REAL]" for name in COMPARED]].to_numpy()
    assert_allclose(theirs, ours, rtol=0.0, atol=6e-7)
