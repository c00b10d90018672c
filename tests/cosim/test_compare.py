"""A result beside a reference: what the band lets through, what it finds, and what is refused."""

from __future__ import annotations

import json
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cosim import Result, SetupError, System, compare, run
from cosim.analysis.compare import ToleranceBand
from cosim.series import TIME, Column
from examples import measured_drive as drive
from tests.cosim.conftest import CommandOutput

T = np.linspace(0.0, 10.0, 1001)


def saw(t: Any) -> Any:
    """A zigzag of slope 1 from -1 to 1, whose corners are rows of T."""
    return np.abs((np.asarray(t) + 3.0) % 4.0 - 2.0) - 1.0


def frame(t: Any = T, **columns: Any) -> pd.DataFrame:
    return pd.DataFrame({"time": t, **columns})


def test_a_curve_that_is_delayed_by_less_than_the_band_passes_and_by_more_fails() -> None:
    """What is beyond the tolerance in time counts as distance: slope times what is left."""
    reference = frame(x=saw(T))
    for delay in (-0.049, 0.049):
        assert compare(frame(x=saw(T - delay)), reference, time=0.05, value=1e-9).passed
    for delay in (-0.06, 0.06):
        deviation = compare(frame(x=saw(T - delay)), reference, time=0.05, value=1e-9)["x"]
        assert not deviation.passed
        assert deviation.deviation == pytest.approx(0.01, abs=1e-9)
        assert deviation.outside.mean() > 0.9  # everywhere but at the corners
    assert not compare(frame(x=saw(T - 0.02)), reference, time=0.0, value=1e-3).passed
    assert compare(frame(x=saw(T - 0.02)), reference).passed  # 0.2 % of 10 s


def test_a_single_wrong_row_is_located_with_its_size_and_time() -> None:
    x = saw(T)
    x[437] += 0.3
    result = compare(frame(x=x, y=saw(T)), frame(x=saw(T), y=saw(T)), time=0.015, value=0.01)
    deviation = result["x"]
    assert (deviation.time, int(deviation.outside.sum())) == (T[437], 1)
    assert deviation.deviation == pytest.approx(
        0.3 - 0.015
    )  # the curve comes 0.015 closer within 15 ms
    assert deviation.allowed == pytest.approx(0.01 * 2.0)
    assert not result.passed and result["y"].passed and result["y"].deviation == 0.0
    assert result.text().endswith("outside: x")
    assert "0.285 at 4.37 s" in result.text() and "1 of 1001 rows outside" in result.text()


def test_the_band_is_that_of_a_rectangle_led_along_the_curve() -> None:
    """Beside a dense search, on uneven rows with a jump, also where no row is in reach."""
    random = np.random.default_rng(3)
    t = np.sort(np.append(random.uniform(0.0, 10.0, 40), [5.0, 5.0]))
    y = random.normal(size=len(t))
    band = ToleranceBand(t, y, 0.0 * t, 0.11, 0.0)
    at = random.uniform(t[0] + 0.11, t[-1] - 0.11, 200)
    low, high = band.around(at)
    first, last = (int(k) for k in np.flatnonzero(t == 5.0))
    for k, now in enumerate(at):
        near = np.clip(np.linspace(now - 0.11, now + 0.11, 4001), t[0], t[-1])
        values = np.where(
            near < 5.0,
            np.interp(near, t[: first + 1], y[: first + 1]),
            np.interp(near, t[last:], y[last:]),
        )
        if abs(now - 5.0) <= 0.11:
            values = np.append(values, y[[first, last]])
        assert low[k] == pytest.approx(values.min(), abs=5e-3 * np.ptp(y))
        assert high[k] == pytest.approx(values.max(), abs=5e-3 * np.ptp(y))
        assert low[k] <= values.min() and values.max() <= high[k]


def test_grids_and_units_of_each_are_honoured() -> None:
    """rpm beside rad/s, ms beside s, a column of percent of something."""
    t = np.linspace(-0.5, 9.0, 333)
    ours = Result(
        [TIME, Column("w", "rad/s"), Column("x[1]", "m")], {},
        [T, saw(T), saw(T)].__getitem__,
    )  # fmt: skip
    theirs = pd.DataFrame(
        {"t [ms]": 1e3 * t, "w [rpm]": saw(t) * 30 / pi, "load [%]": saw(t) * 4, "x[1]": saw(t)}
    )
    comparison = compare(ours, theirs, value=0.02)
    assert comparison.passed and (comparison.start, comparison.stop) == (0.0, 9.0)
    assert [c.name for c in comparison.columns] == ["w", "x[1]"]
    assert comparison["w"].unit == "rpm" and comparison["w"].allowed == pytest.approx(
        0.02 * 60 / pi, rel=0.01
    )
    assert not compare(ours, theirs, value=0.02, columns={"w": "w:deg/s"}).passed
    for text, passes in (
        ("load * 250:mm", True), ("load*25:cm", True), ("load / 4:m", True), ("load / 4:", True),
        ("load * 300:mm", False), ("load * 250 + 80:mm", False), ("load * 250 - 8:mm", True),
        ("load * -250:mm", False),
    ):  # fmt: skip
        comparison = compare(ours, theirs, value=0.02, columns={"x[1]": text})
        assert comparison.passed is passes, text
        assert comparison["x[1]"].reference == "load"
        assert "not compared in the result: w" in comparison.text()


def test_times_are_those_of_the_column_that_is_called_so() -> None:
    """As in an input table and in another master's result, wherever it stands."""
    ours = frame(x=saw(T))
    theirs = pd.DataFrame({"x": ours["x"], "time [ms]": 1000.0 * ours["time"]})
    assert compare(ours, theirs).passed


def test_a_column_is_not_mapped_twice() -> None:
    """Its factor could not be two."""
    with pytest.raises(SetupError, match="the reference, column n: it is mapped twice, to v and w"):
        compare(frame(v=T, w=T), frame(n=T), columns={"v": "n", "w": "n * 0.4"})


def test_errors_of_both_and_of_the_sensor_widen_the_band() -> None:
    reference = frame(x=saw(T), x_error=np.where(T < 4.995, 0.1, 0.0))
    ours = frame(x=saw(T) + 0.29, x_error=0.1)
    deviation = compare(ours, reference, time=0.0, value=0.05)["x"]
    assert deviation.t[~deviation.outside].max() < 4.995 < deviation.t[deviation.outside].min()
    assert deviation.allowed == pytest.approx(0.2) and deviation.deviation == pytest.approx(0.29)
    for error, passes in ((0.089, False), (0.091, True), ("91mm", True)):
        named = reference.rename(columns={"x": "x [m]"})
        assert compare(ours, named, time=0.0, value=0.05, errors={"x": error}).passed is passes, (
            error
        )


def test_nothing_is_compared_in_a_gap_and_that_is_stated() -> None:
    outside_gap = (T <= 2.0) | (T >= 3.5)
    reference = frame(T[outside_gap], x=saw(T[outside_gap]))
    assert not compare(frame(x=saw(T)), reference).passed
    comparison = compare(frame(x=saw(T)), reference, gap=0.1)
    assert comparison.passed and len(comparison["x"].t) == outside_gap.sum()
    assert "149 rows are not compared: they lie in gaps of the reference" in comparison.text()


@pytest.mark.parametrize(
    ("columns", "settings", "message"),
    [
        ({"y": saw(T)}, {}, "no column in common: the result has x, the reference has y"),
        ({"x": saw(T)}, {"columns": ["z"]}, "the result has no column 'z', only time, x"),
        ({"x": saw(T)}, {"columns": {"x": "z"}}, "the reference has no column 'z', only time, x"),
        ({"x [m]": saw(T), "x [s]": saw(T)}, {}, "the reference has two columns named 'x'"),
        ({"x": np.where(T == 2.0, np.nan, 0.0)}, {}, "row 202, column x: 'nan' is not a finite number"),
        ({"x": np.where(T == 2.0, np.inf, 0.0)}, {}, "row 202, column x: 'inf' is not a finite number"),
        ({"x": ["jam"] * len(T)}, {}, "row 2, column x: 'jam' is not a number"),
        ({"t": T + 20.0}, {}, "from 0 to 10 s and the reference from 20 to 30 s have fewer than two rows to compare"),
        ({"t": 1.0 - T}, {}, "time 0.99 s after 1.0 s must be finite and not fall"),
        ({"x": saw(T)}, {"value": -0.1}, "the tolerance in value = -0.1 must be a finite number"),
        ({"x": saw(T)}, {"time": np.inf}, "the tolerance in time = inf must be a finite number"),
        ({"x": saw(T)}, {"gap": 0.0}, "gap = 0.0 s must be above 0"),
        ({"x": saw(T)}, {"errors": {"y": 1.0}}, "error of y: only x are compared"),
        ({"x [m]": saw(T)}, {"errors": {"x": "3 N"}}, "error of x = '3 N' must be at least 0, in m or"),
        ({"x": saw(T)}, {"columns": {"x": "y:m"}}, "the reference has no column 'y:m', only time, x"),
        ({"x": saw(T)}, {"columns": {"x": "x * 0"}}, "column 'x * 0': the factor must not be 0"),
        ({"x [kg]": saw(T)}, {}, "the result: x [m] cannot be converted to kg"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_refused(
    columns: dict[str, Any], settings: dict[str, Any], message: str
) -> None:
    ours = frame(**{"x [m]" if "x [kg]" in columns else "x": saw(T)})
    reference = frame(columns.pop("t", T), **(columns or {"x": saw(T)}))
    with pytest.raises(SetupError) as refused:
        compare(ours, reference, **settings)
    assert message in str(refused.value)


def test_a_constant_is_compared_by_its_value() -> None:
    ones = frame(x=np.ones_like(T))
    assert compare(frame(x=1.0019 * ones["x"]), ones).passed
    assert not compare(frame(x=1.0021 * ones["x"]), ones).passed


def test_the_command_reports_plots_and_has_an_exit_code(
    tmp_path: Path, command_output: CommandOutput
) -> None:
    ours, theirs, image = tmp_path / "run.csv", tmp_path / "log.csv", tmp_path / "it.png"
    frame(w=saw(T), x=saw(T)).to_csv(ours, index=False)
    ours.with_suffix(".json").write_text(json.dumps({"units": {"w": "rad/s", "x": "m"}}))
    frame(**{"speed [rpm]": saw(T) * 30 / pi, "pos [mm]": 1e3 * saw(T - 0.1)}).to_csv(theirs)
    pd.read_csv(theirs, index_col=0).to_csv(theirs, index=False)
    command = ["compare", str(ours), str(theirs), "--plot", str(image), "--map"]
    assert "every column stays in its band" in command_output(*command, "w=speed")
    assert image.read_bytes().startswith(b"\x89PNG")
    text = command_output(*command, "w=speed", "--map", "x=pos", code=1)
    assert "x = pos    80 mm at" in text and "FAIL" in text
    command_output(*command, "x=pos", "--error", "x=8cm")
    command_output(*command, "x=pos", "--time", "0.11")
    theirs.with_suffix(".json").write_text("[]")  # of somebody else
    assert "run.csv: x [m] cannot be converted to rpm" in command_output(
        *command, "x=speed", code=2
    )


def test_the_measured_drive_is_its_fmus_but_where_its_belt_slips(fmus: Path) -> None:
    """Within the encoder's step and the noise; the slip, which no FMU has, is found where it is."""
    system = System(
        {"motor": fmus / "native/DriveMotor.fmu", "conveyor": fmus / "native/CrankConveyor.fmu"},
        [f"motor.tau * {drive.RATIO} -> conveyor.tau", f"conveyor.w * {drive.RATIO} -> motor.w"],
        drive.TRUTH | {"conveyor.rod.finite": True, "conveyor.w": 0.0, "motor.tau": 0.0},
    )
    result = run(system, stop=drive.STOP, step=1e-3, record=["motor.w", "motor.tau"])
    comparison = compare(
        result, drive.record(), columns={"motor.w": "speed", "motor.tau": "torque * 0.73:N.m"},
        errors={"motor.w": "8rpm", "motor.tau": "2.5N.m"}, gap=0.01,
    )  # fmt: skip
    for column in comparison.columns:
        out = column.t[column.outside]
        assert out.size and out.min() > drive.SLIP_BEGIN and out.max() < drive.SLIP_BEGIN + 0.25, (
            column
        )
    assert comparison["motor.w"].unit == "rpm"
    stale = result.with_columns_from(lambda k: result.load(k) * [1.0, 1.03, 1.0][k])
    stale.provenance = {}
    misfit = compare(
        stale, drive.record(), columns={"motor.w": "speed"}, errors={"motor.w": "8rpm"}
    )
    assert misfit["motor.w"].outside.mean() > 0.5
