"""Machines are found from records that an independent integrator made."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.identify import KINDS, trial
from cosim import Experiment, Series, SetupError, System, advise, identify, measured
from cosim.identification.intervals import correlated_groups
from cosim.identification.linearisation import covariance, linearise
from cosim.identification.noise import estimate_noise
from cosim.identification.parameters import free_parameters, independent_prior
from cosim.identification.problem import Evaluator, prepare
from cosim.identification.record import measured_columns
from cosim.identification.residual import spectrum
from cosim.system import connect
from examples.measured_conveyor import angle_speed_torque

WIRES = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
MACHINE = {
    "motor.A": 7200.0, "motor.B": 199.8, "motor.T": 0.0625, "conveyor.rotor.J": 0.49,
    "conveyor.trough.m": 200.0, "conveyor.trough.d": 4000.0, "conveyor.spring.c": 720e3,
    "conveyor.phi": 0.3, "conveyor.w": 36.0, "motor.tau": 60.0,
}  # fmt: skip
FREE = ["motor.B", "motor.T", "conveyor.rotor.J", "motor.A", "conveyor.phi", "conveyor.w"]
PRIOR = {"conveyor.trough.d": (4000.0, 200.0)}


def resonance(p: Mapping[str, float], _: object = None) -> float:
    """Where motor and load swing against each other, from the mean machine [rad/s]."""
    half = p.get("conveyor.crank.r", 0.01) ** 2 / 2
    slope = p["motor.B"] + p["conveyor.trough.d"] * half
    inertia = p["conveyor.rotor.J"] + p.get("conveyor.trough.m", 200.0) * half
    return float((slope / (inertia * p["motor.T"])) ** 0.5 / 2)


def system(fmus: Path, **changes: float) -> System:
    """The machine as one would guess it."""
    parts = {"motor": fmus / "native/DriveMotor.fmu", "conveyor": fmus / "native/CrankConveyor.fmu"}
    guess = MACHINE | {"motor.B": 170.0, "motor.T": 0.075, "conveyor.rotor.J": 0.55}
    return System(parts, WIRES, guess | {"motor.A": 6100.0, "conveyor.phi": 0.0} | changes)


@pytest.fixture(scope="module")
def record() -> dict[str, Any]:
    """One second of the machine at 1 kHz, without noise."""
    t = np.arange(1001) * 1e-3
    phi, w, tau = angle_speed_torque({"conveyor.crank.r": 0.01} | MACHINE, t)
    return {"t": t, "phi": phi, "w": w, "tau": tau}


def noisy(x: Any, sigma: float, seed: int = 1) -> Any:
    return x + sigma * np.random.default_rng(seed).standard_normal(len(x))


def test_the_resonance_is_identified_though_its_parts_are_not(
    fmus: Path, record: dict[str, Any]
) -> None:
    table = Series.of({"t": record["t"], "n [rpm]": noisy(record["w"], 0.1) * 30 / np.pi})
    fit = identify(
        system(fmus), {"conveyor.w": table}, free=FREE, prior=PRIOR,
        derived={"resonance": resonance}, first=["conveyor.phi", "motor.A"],
    )  # fmt: skip
    assert not fit.misfit
    interval, truth = fit.derived["resonance"], resonance(MACHINE)
    assert interval.low < truth < interval.high
    assert interval.error < 0.01 * truth
    for name, value in fit.values.items():
        error = value.value - MACHINE[name]
        if name == "conveyor.phi":
            error -= round(error / np.pi) * np.pi  # the machine is the same half a turn later
        assert abs(error) < 2.5 * value.error, name
    assert any({"motor.B", "motor.A"} <= set(group) for group in fit.correlated_groups)


def test_an_error_of_a_record_is_a_line_with_file_row_and_column(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"

    def refused(text: str, message: str, columns: dict[str, str], time: str = "t") -> None:
        path.write_text(text)
        with pytest.raises(SetupError, match=re.escape(message)):
            measured(path, columns, time=time)

    w = {"conveyor.w": "n:rpm"}
    refused(
        "t,n\n0,1\n2,1\n1,1\n",
        "log.csv, row 4: time 1.0 s after 2.0 s must rise",
        w,
    )
    refused("t,n\n0,1\n1,nan\n", "log.csv, row 3, column n: 'nan' is not a finite number", w)
    refused("t,n\n0,1\n1,x\n", "log.csv, row 3, column n: 'x' is not a number", w)
    refused("t,n\n0,1\n", "log.csv has no column 'time', only t, n", w, "time")
    refused("t,n\n0,1\n", "column n: it is mapped twice, to conveyor.w and motor.w",
            w | {"motor.w": "n"})  # fmt: skip


def test_a_derivative_is_taken_from_the_side_that_the_fmus_accept(
    fmus: Path, record: dict[str, Any]
) -> None:
    """A mass that the record cannot tell runs to its bound, where the FMU refuses it."""
    guess = system(fmus, **{**MACHINE, "conveyor.trough.m": 1e-9})
    table = Series.of({"t": record["t"][:200], "w": noisy(record["w"][:200], 0.1)})
    network = connect(guess)
    columns = measured_columns(network, {"conveyor.w": table}, {"conveyor.w": 0.1})
    prior = independent_prior({})
    parameters = free_parameters(network, columns, ["conveyor.trough.m", "motor.B"], prior)
    problem = prepare(network, columns, parameters, prior)
    jacobian = linearise(Evaluator(problem), problem.guess).jacobian
    assert np.isfinite(jacobian).all() and np.abs(jacobian[:, 1]).max() > 0.0


def test_noise_is_estimated_from_the_rows_and_from_their_grid() -> None:
    t = np.arange(2000) * 1e-3
    signal = 40.0 + 3.0 * np.sin(80.0 * t) + t**2
    white = estimate_noise(t, noisy(signal, 0.05), "it")
    assert white.sigma == pytest.approx(0.05, rel=0.08)
    assert "grid" not in white.source
    coarse = estimate_noise(t, np.round(signal / 0.5) * 0.5, "it")
    assert coarse.sigma >= 0.5 / np.sqrt(12.0)
    spiked = noisy(signal, 0.05)
    spiked[::100] += 5.0
    assert estimate_noise(t, spiked, "it").sigma == pytest.approx(0.05, rel=0.15)
    with pytest.raises(
        SetupError, match="too far apart to separate noise from signal; give the noise"
    ):
        estimate_noise(t, 3.0 * np.sin(1500.0 * t), "it")


def test_the_spectrum_of_white_noise_is_1_over_even_and_uneven_rows() -> None:
    rng = np.random.default_rng(3)
    even = np.arange(1000) * 1e-3
    uneven = np.delete(even, rng.choice(1000, 200, replace=False))
    for t in (even, uneven):
        frequencies, power = spectrum(t, rng.standard_normal(len(t)))
        assert power.mean() == pytest.approx(1.0, abs=0.15)
        assert frequencies[-1] < 0.5 / np.median(np.diff(t))
        line = np.sin(2 * np.pi * 50.0 * t)
        frequencies, power = spectrum(t, line)
        assert frequencies[np.argmax(power)] == pytest.approx(50.0, abs=1.0)
        assert power.max() == pytest.approx(len(t) / 4, rel=0.1)


def test_the_covariance_is_that_of_linear_least_squares_and_knows_no_bounds() -> None:
    rng = np.random.default_rng(4)
    J = rng.standard_normal((50, 3)) * [1.0, 1e3, 1e-6]
    assert covariance(J) == pytest.approx(np.linalg.inv(J.T @ J), rel=1e-9)
    J[:, 2] = 0.0
    assert covariance(J)[2, 2] > 1e12
    assert correlated_groups(
        ["a", "b", "c"], np.array([[1, -0.97, 0], [-0.97, 1, 0.2], [0, 0.2, 1]])
    ) == [["a", "b"]]


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"free": ["motor.X"]}, "motor has no variable 'X', only"),
    ({"free": ["conveyor.x"]}, "conveyor.x [m] cannot be free: it must be a Real start value"),
    ({"free": {"motor.T": (0.1, 0.1)}}, "motor.T cannot move from 0.1 to 0.1 s"),
    ({"free": {"motor.T": (0.1, 0.2)}}, "motor.T = 0.075 s must be between 0.1 and 0.2 s"),
    ({"free": []}, "no value is free"),
    ({"free": ["gain(motor.tau)"]}, "motor.tau is not a measured column, only conveyor.w"),
    ({"free": ["motor.w"]}, "motor.w [rad/s] cannot be free"),
    ({"begin": 1.0}, "begin = 1.0 s must not be after the first row, at 0.0 s"),
    ({"first": ["motor.T"]}, "first: motor.T is not free, only motor.B"),
    ({"prior": {"motor.B": (200.0, -1.0)}}, "the deviation must be above 0"),
    ({"noise": {"conveyor.w": 0.0}}, "noise of conveyor.w = 0.0 must be above 0"),
    ({"values": [40.0] * 60}, "it is 40.0 in all rows and carries no information"),
    ({"unit": "N.m"}, "conveyor.w [rad/s] cannot be compared with a column in N.m"),
    ({"times": [0.0] * 60}, "its times must rise"),
    ({"times": [0.0], "values": [1.0]}, "there must be two rows at least"),
    ({"times": [0.0, 0.1, 0.2], "values": [1.0, 2.0, 1.0], "noise": {"conveyor.w": 1.0},
      "free": ["motor.B", "motor.T", "motor.A"]}, "has 3 rows, fewer than are needed for 3 free"),
    ({"column": "conveyor.rod.l"}, "conveyor.rod.l [m] is not a Real output"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), WRONG, ids=[message for _, message in WRONG])
def test_what_cannot_be_identified_is_refused_in_a_line(
    changes: dict[str, Any], message: str, fmus: Path
) -> None:
    arguments = {"free": ["motor.B"]} | changes
    values = noisy(np.linspace(40.0, 41.0, 60), 0.1).tolist()
    times = arguments.pop("times", (np.arange(60) * 1e-3).tolist())
    heading = f"w [{arguments.pop('unit')}]" if "unit" in arguments else "w"
    table = Series.of({"t": times, heading: arguments.pop("values", values)})
    with pytest.raises(SetupError, match=re.escape(message)) as raised:
        identify(system(fmus), {arguments.pop("column", "conveyor.w"): table}, **arguments)
    assert "\n" not in str(raised.value)


def test_a_sensor_with_a_delay_and_a_gain_is_identified_with_outliers_and_gaps(
    fmus: Path, record: dict[str, Any]
) -> None:
    """The torque comes 3 ms late and 4 % too large, on times of its own; some rows are wrong."""
    t, torque_times = record["t"], record["t"][20:-20:2]
    tau = 1.04 * np.interp(torque_times - 3e-3, t, record["tau"])
    tau = noisy(tau, 1.0, 2)
    tau[5::97] += 60.0
    w = noisy(record["w"], 0.05)
    w[300:340] = np.nan
    start = {**MACHINE, "motor.B": 190.0, "motor.A": 6900.0}
    fit = identify(
        system(fmus, **start), {
            "conveyor.w": Series.of({"t": t, "w": w}),
            "motor.tau": Series.of({"t": torque_times, "tau": tau}),
        },
        free=["motor.B", "motor.A", "gain(motor.tau)"], prior={"delay(motor.tau)": (0.0, 2e-3)},
        noise={"conveyor.w": 0.05, "motor.tau": 1.0}, outliers=0.02, starts=2,
    )  # fmt: skip
    assert not fit.misfit
    for name, truth in (("gain(motor.tau)", 1.04), ("delay(motor.tau)", 3e-3), ("motor.B", 199.8)):
        assert abs(fit.values[name].value - truth) < 1.5 * fit.values[name].error, name
    assert "motor.tau: 5 of 481 rows are outliers and are left out." in fit.notes


def test_a_planned_record_narrows_the_interval_as_predicted(
    fmus: Path, record: dict[str, Any]
) -> None:
    """A run-up, foretold from a record of steady running, then made and identified."""
    table = Series.of({"t": record["t"], "w": noisy(record["w"], 0.1)})
    settings: dict[str, Any] = {"free": FREE, "noise": {"conveyor.w": 0.1}, "starts": 2}
    settings |= {"derived": {"resonance": resonance}}
    guess = {"conveyor.phi": 0.3, "motor.A": 7100.0, "motor.B": 197.0}
    fit = identify(system(fmus, **guess), {"conveyor.w": table}, prior=PRIOR, **settings)
    rest = {"conveyor.phi": 0.3, "conveyor.w": 0.0, "motor.tau": 0.0}
    steady = {name: float(fit.result[name][-1]) for name in rest}
    experiments = {
        name: Experiment(start, {"conveyor.w": 0.1}, 1.0)
        for name, start in {"steady": steady, "run-up": rest}.items()
    }
    best, second = advise(fit, experiments, resonance)
    assert (best.name, second.name) == ("run-up", "steady")
    assert best.error < 0.5 * second.error < 0.5 * fit.derived["resonance"].error
    _, w, _ = angle_speed_torque({"conveyor.crank.r": 0.01} | MACHINE | rest, record["t"])
    following = identify(
        system(fmus, **{**fit.start_values, **rest}),
        {"conveyor.w": Series.of({"t": record["t"], "w": noisy(w, 0.1, 5)})},
        prior=fit.prior(),
        **settings,
    )
    interval = following.derived["resonance"]
    assert interval.error == pytest.approx(best.error, rel=0.2)
    assert abs(interval.value - resonance(MACHINE)) < 1.5 * interval.error


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_the_truth_of_random_machines(kind: str) -> None:
    figures = [trial(kind, seed).figures["resonance"] for seed in (1, 2, 3)]
    ratios = [ratio for figure in figures if (ratio := figure.error_ratio()) is not None]
    assert len(ratios) >= 2
    assert sum(ratio <= 1.0 for ratio in ratios) >= len(ratios) - 1
    assert max(ratios) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("error", ["drift", "saturation"])
def test_what_the_model_lacks_is_named_where_it_moves_the_resonance(error: str) -> None:
    for seed in (1000, 1001):
        lacking = trial("droop", seed, lacking=error)
        ratio = lacking.figures["resonance"].error_ratio()
        assert ratio is not None
        assert lacking.words or ratio < 1.0
