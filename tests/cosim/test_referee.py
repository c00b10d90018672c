"""The referee's verdicts agree with independent integrations, and it names the mistakes that are put in."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest

from components.crank_conveyor import model as crank_conveyor
from components.DC_motor import model as DC_motor
from components.drive_motor import model as drive_motor
from components.unbalance_exciter import model as unbalance_exciter
from cosim import SetupError, System, oracle, referee, run, write_ssp
from cosim.accuracy.limit import Reason, limit
from cosim.accuracy.referee import solution
from cosim.accuracy.referee.conversions import units_of
from cosim.accuracy.referee.signals import Verdict
from cosim.accuracy.referee.table import read_foreign
from cosim.accuracy.referee.variants import variants
from cosim.fmu.reference_rows import ReferenceRows
from cosim.system import Port, connect
from tests.cosim.conftest import CommandOutput
from tests.oracle import Part, monolithic, part

DRIVE_START = {
    "conveyor.phi": 0.3,
    "conveyor.w": 38.0,
    "motor.tau": 12.0,
    "motor.A": 7000.0,
    "motor.T": 0.05,
}
CHAIN_WIRES = (
    "controller.tau * 2.5 => motor.v",
    "gear.w_a -> motor.w",
    "gear.w_a -> controller.w",
    "motor.tau -> gear.tau_a",
    "shaft.tau_a -> gear.tau_b",
    "gear.w_b -> shaft.w_a",
    "load.w -> shaft.w_b",
    "shaft.tau_b -> load.tau",
)
CHAIN_START = {
    "controller.T_i": 0.2, "controller.w_ref": 100.0, "gear.i": 5.0, "gear.w_a": 0.0, "shaft.b": 0.002,
    "shaft.twist": 0.0, "load.crank.r": 0.004, "load.w": 0.0,
}  # fmt: skip


def drive(native: Path, **changes: Any) -> System:
    """The motor and the conveyor, all of whose important values are set."""
    parts = {"motor": native / "DriveMotor.fmu", "conveyor": native / "CrankConveyor.fmu"}
    wires = ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"]
    return replace(System(parts, wires, DRIVE_START), **changes)


def chain(native: Path, **changes: Any) -> System:
    """Controller, motor, gearbox, elastic shaft and a load, with a factor on a wire."""
    names = {
        "controller": "SpeedController", "motor": "DCMotor", "gear": "Gearbox", "shaft": "ShaftLink",
        "load": "SlottedLink",
    }  # fmt: skip
    parts = {name: native / f"{fmu}.fmu" for name, fmu in names.items()}
    return replace(System(parts, CHAIN_WIRES, CHAIN_START), **changes)


def orientator(native: Path, **changes: Any) -> System:
    """A hybrid machine: a product falls, tips and slides, one event after the other."""
    return replace(System({"orientator": native / "GravityOrientator.fmu"}), **changes)


def exact(system: System, stop: float, output_step: float = 1e-3) -> pd.DataFrame:
    """What a master without any error writes."""
    return oracle(system, stop=stop, output_step=output_step, tolerance=1e-11).frame


def swap(frame: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """The table with two columns crossed."""
    return frame.rename(columns={first: second, second: first})


def delayed(frame: pd.DataFrame, name: str, rows: int) -> pd.DataFrame:
    """The table with a column that is some rows late."""
    values = frame[name].to_numpy()
    return frame.assign(**{name: np.concatenate([np.full(rows, values[0]), values[:-rows]])})


def without(system: System, name: str) -> System:
    """The system without a start value."""
    return replace(system, start={k: v for k, v in system.start.items() if k != name})


def rewired(system: System, old: str, new: str) -> System:
    """The system with another wire in place of one."""
    assert old in system.wires
    return replace(system, wires=[new if wire == old else wire for wire in system.wires])


@dataclass(frozen=True)
class Mistake:
    """A mistake of a stranger: the system that he meant, what he got, and the words that name the mistake."""

    system: Callable[[Path], System]
    result: Callable[[System], pd.DataFrame]
    kind: str
    text: str


def coupled(
    algorithm: str, step: float, stop: float = 0.5, **settings: Any
) -> Callable[[System], Any]:
    """A master that couples like this."""
    return lambda s: (
        run(
            s, stop=stop, step=step, output_step=max(step, 1e-3), algorithm=algorithm, **settings
        ).frame
    )


CHANGED = {"changes": ["0.1 controller.w_ref = 140"]}
MISTAKES = {
    "Jacobi": Mistake(drive, coupled("jacobi", 1e-3), "held inputs", "0.001 s"),
    "Gauss-Seidel": Mistake(
        drive, coupled("gauss-seidel", 2e-3, order=["conveyor", "motor"]), "step too long", "conveyor, motor"
    ),
    "Strang with long steps": Mistake(drive, coupled("strang", 5e-3), "step too long", "0.005 s"),
    "speed in rpm": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"conveyor.w": lambda f: f["conveyor.w"] * 30 / math.pi}),
        "unit", "rpm",
    ),
    "torque by a wrong conversion": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"motor.tau": lambda f: f["motor.tau"] * 180 / math.pi}),
        "scale", "motor.tau is 57.2958 times the reference: deg for rad?",
    ),
    "wire by a wrong conversion": Mistake(
        chain, lambda s: exact(rewired(s, "motor.tau -> gear.tau_a", "motor.tau * 9.80665 -> gear.tau_a"), 0.1),
        "lost factor", "brings 9.80665 times its source: N for kgf?",
    ),
    "opposite sign": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"motor.tau": lambda f: -f["motor.tau"]}), "sign", "motor.tau",
    ),
    "crossed columns": Mistake(
        drive, lambda s: swap(exact(s, 0.3), "motor.tau", "conveyor.tau_load"), "columns crossed",
        "conveyor.tau_load",
    ),
    "late column": Mistake(
        drive, lambda s: delayed(exact(s, 0.3), "conveyor.v", 4), "delay", "4 rows"
    ),
    "lost parameter": Mistake(
        drive, lambda s: exact(without(s, "motor.T"), 0.3), "lost start value", "motor.T"
    ),
    "lost parameter set": Mistake(
        drive, lambda s: exact(replace(s, start={}), 0.3), "lost start value", "all start values"
    ),
    "lost factor": Mistake(
        chain, lambda s: exact(rewired(s, CHAIN_WIRES[0], "controller.tau => motor.v"), 0.3), "lost factor",
        "2.5",
    ),
    "wires crossed": Mistake(
        chain,
        lambda s: exact(
            rewired(rewired(s, "motor.tau -> gear.tau_a", "shaft.tau_a -> gear.tau_a"),
                    "shaft.tau_a -> gear.tau_b", "motor.tau -> gear.tau_b"), 0.2),
        "wires crossed", "gear.tau_a",
    ),
    "lost wire": Mistake(
        chain,
        lambda s: exact(replace(s, wires=[w for w in s.wires if not w.startswith("shaft.tau_a")]), 0.1),
        "lost wire", "shaft.tau_a",
    ),
    "missed change": Mistake(
        lambda native: chain(native, **CHANGED), lambda s: exact(replace(s, changes=()), 0.3), "lost input",
        "controller.w_ref",
    ),
    "open inputs at 0": Mistake(
        lambda native: drive(native, wires=["motor.tau -> conveyor.tau"]),
        lambda s: exact(replace(s, start={**s.start, "motor.w": 0.0}), 0.2), "lost input", "motor.w",
    ),
    "constant offset": Mistake(
        drive, lambda s: exact(s, 0.3).assign(**{"conveyor.phi": lambda f: f["conveyor.phi"] - 0.3}), "offset",
        "-0.3",
    ),
    "lost parameter and Jacobi": Mistake(
        drive, lambda s: coupled("jacobi", 1e-3)(without(s, "motor.T")), "lost start value", "motor.T"
    ),
}  # fmt: skip


#: those whose causes take long to tell apart, or whose kind another one has
SLOW = {
    "Strang with long steps", "wire by a wrong conversion", "lost parameter set", "lost factor", "missed change",
    "lost parameter and Jacobi",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[pytest.mark.slow] if x in SLOW else []) for x in MISTAKES]
)
def test_a_mistake_is_named(native: Path, name: str) -> None:
    mistake = MISTAKES[name]
    system = mistake.system(native)
    report = referee(system, mistake.result(system))
    assert report.verdict is Verdict.DIFFERS
    assert report.causes, report.text()
    cause = report.causes[0]
    assert cause.kind == mistake.kind and mistake.text in cause.text, report.text()
    assert cause.reduction >= 10.0


def independent(stop: float, rows: int) -> pd.DataFrame:
    """The drive as one system of differential equations, written without any FMU."""
    t = np.linspace(0.0, stop, rows)
    phi, w, tau, *_ = monolithic(DRIVE_START, stop, t).y
    return pd.DataFrame({"time": t, "conveyor.phi": phi, "conveyor.w": w, "motor.tau": tau})


@pytest.mark.parametrize("rows", [61, 997])
def test_an_independent_solution_agrees(native: Path, rows: int) -> None:
    """Its rows need not be where those of any master are."""
    report = referee(drive(native), independent(0.3, rows))
    assert report.verdict is Verdict.AGREES, report.text()
    assert report.causes == () and report.exit_status == 0
    for signal in report.signals:
        assert signal.deviation <= signal.error + 1e-7 * signal.scale


@pytest.mark.parametrize(
    ("algorithm", "step"), [("jacobi", 5e-4), ("gauss-seidel", 2e-3), ("strang", 1e-3)]
)
def test_deviations_are_those_from_an_independent_solution(
    native: Path, algorithm: str, step: float
) -> None:
    """The difference that is reported is that from the independent solution."""
    result = run(drive(native), stop=0.3, step=step, algorithm=algorithm)
    report = referee(drive(native), result)
    phi, w, tau, *_ = monolithic(DRIVE_START, 0.3, result["time"]).y
    for name, exact_values in (("conveyor.phi", phi), ("conveyor.w", w), ("motor.tau", tau)):
        signal = report[name]
        true = np.abs(result[name] - exact_values)
        assert signal.deviation == pytest.approx(true.max(), rel=1e-3, abs=signal.error)
        wrong = true.max() > 0.01 * np.ptp(exact_values)
        assert (signal.verdict is Verdict.DIFFERS) == wrong
        end = signal.figures[0]
        assert abs(end.reference - exact_values[-1]) <= end.error + 1e-9 * abs(exact_values[-1])


CORRECT: dict[str, tuple[Callable[[Path], System], float]] = {
    "drive": (drive, 0.2), "chain": (chain, 0.1), "orientator": (orientator, 0.3),
}  # fmt: skip


@pytest.mark.parametrize(("digits", "step"), [(6, 5e-4), (9, 1e-2), (6, 2.5e-3)])
@pytest.mark.parametrize("name", CORRECT)
def test_a_correct_result_is_not_blamed(native: Path, name: str, digits: int, step: float) -> None:
    """Whatever its step between rows, and with as few digits as masters print."""
    make, stop = CORRECT[name]
    system = make(native)
    frame = exact(system, stop, step)
    printed = frame.map(lambda value: float(f"{value:.{digits}g}"))
    report = referee(system, printed)
    assert report.verdict is Verdict.AGREES, report.text()
    assert report.causes == ()


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 12))]
)
@pytest.mark.parametrize("amount", [0.03, pytest.param(0.3, marks=pytest.mark.slow)])
def test_noise_has_no_cause(native: Path, amount: float, seed: int) -> None:
    """A column that is noisy or distorted differs, and no cause is invented."""
    frame = independent(0.1, 101)
    draw = np.random.default_rng(seed)
    name = ["conveyor.phi", "conveyor.w", "motor.tau"][seed % 3]
    extent = np.ptp(frame[name])
    shape = draw.normal(size=101) if seed % 2 else np.sin(draw.uniform(20, 60) * frame["time"])
    frame[name] = frame[name] + 2.0 * amount * extent * shape
    report = referee(drive(native), frame)
    assert report.verdict is Verdict.DIFFERS
    assert report.causes == (), report.text()
    assert "cause not found" in report.sentence()


#: What masters write: first line, heading of the times, headings of the columns, separator.
HEADINGS: dict[str, tuple[str, str, Callable[[str, str], str], str]] = {
    "OMSimulator": ('"sep=,"\n', "time", lambda name, _: f"model.root.{name}", ","),
    "Ecos": ("", "iterations,time", lambda name, _: f"{name.replace('.', '::', 1)}[REAL]", ","),
    "MasterSim": ("", "time [s]", lambda name, unit: f"{name} [{unit}]", "\t"),
    "Simulink": ("", "time", lambda name, _: name.replace(".", "_"), ","),
    "bare": ("", "time", lambda name, _: name.partition(".")[2], ","),
    "libcosim": ("", "time", lambda name, _: f"{name.partition('.')[2]} [7 real output]", ","),
}


def rows_of_a_master(fmu: Path, stop: float) -> pd.DataFrame:
    """What a master writes that runs a single FMU at the steps of its default experiment."""
    return run(System({"unit": fmu}), stop=stop, step=1e-3).frame


def test_a_default_experiment_is_judged_by_the_results_that_the_fmu_carries(native: Path) -> None:
    fmu = native / "GravityOrientator.fmu"
    system = System({"unit": fmu})
    frame = rows_of_a_master(fmu, 0.3)
    report = referee(system, frame)
    assert report.verdict is Verdict.AGREES, report.text()
    assert "GravityOrientator.fmu carries" in report.method
    assert len(report.signals) == 37
    for signal in report.signals:
        assert signal.deviation == 0.0, signal.name
        assert 0.0 <= signal.error <= 1e-8 * signal.scale, signal.name
    wrong = referee(system, delayed(frame, "unit.phi2", 5))
    assert wrong.verdict is Verdict.DIFFERS
    assert wrong.causes[0].kind == "delay" and "5 rows" in wrong.causes[0].text


@pytest.mark.parametrize("name", ["DriveMotor", "CrankConveyor", "GravityOrientator", "Gearbox"])
def test_carried_results_are_within_their_errors_of_an_integration(native: Path, name: str) -> None:
    """Of the model-exchange side, which SciPy integrates with events, where the error it states is added."""
    fmu = native / f"{name}.fmu"
    rows = ReferenceRows.of_fmu(fmu)
    assert rows is not None
    time = rows.values.t
    step = time[1] - time[0]
    system = System({"unit": fmu})
    truth = oracle(system, stop=time[-1], output_step=step, tolerance=1e-12)
    last = np.append(np.diff(truth["time"]) > 0.0, True)
    k = np.searchsorted(truth["time"][last], time - 1e-9)
    for variable in rows.values.names[1:]:
        values = rows.values[variable]
        doubt = truth.provenance["errors"][f"unit.{variable}"]
        error = np.abs(values - truth[f"unit.{variable}"][last][k])
        rounding = 1e-13 * np.abs(values).max()
        assert (error <= rows.errors[variable] + doubt + rounding).all(), (
            variable,
            error.max(),
            doubt,
        )


def test_carried_results_only_count_for_the_experiment_they_are_of(native: Path) -> None:
    """Another start value, another time, rows between theirs: each needs a solution of its own."""
    fmu = native / "DriveMotor.fmu"
    frame = rows_of_a_master(fmu, 0.5)
    changed = System({"unit": fmu}, start={"unit.w": 41.0})
    assert "model exchange" in referee(changed, run(changed, stop=0.1, step=1e-3)).method
    system = System({"unit": fmu})
    assert "model exchange" in referee(system, frame, start=0.1).method
    between = run(system, stop=0.1, step=7e-4).frame
    report = referee(system, between)
    assert "model exchange" in report.method and report.verdict is Verdict.AGREES
    assert "carries" in referee(system, frame).method


@pytest.mark.parametrize("damage", ["no errors", "other columns", "no numbers", "no manifest"])
def test_damaged_reference_rows_are_passed_over(native: Path, tmp_path: Path, damage: str) -> None:
    """The FMU is integrated instead."""
    fmu = tmp_path / "DriveMotor.fmu"
    with ZipFile(native / "DriveMotor.fmu") as source, ZipFile(fmu, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith("_ref_error.csv"):
                content = {
                    "other columns": content.replace(b"tau_static", b"torque"),
                    "no numbers": content.replace(b"0.001", b"early"),
                }.get(damage, content)
                if damage == "no errors":
                    continue
            if damage != "no manifest" or not name.endswith("fmi-ls-manifest.xml"):
                target.writestr(name, content)
    assert ReferenceRows.of_fmu(fmu) is None
    report = referee(System({"unit": fmu}), rows_of_a_master(fmu, 0.2))
    assert report.verdict is Verdict.AGREES and "model exchange" in report.method


@pytest.mark.parametrize("master", HEADINGS)
def test_columns_are_recognised_by_the_names_that_masters_write(
    native: Path, tmp_path: Path, master: str
) -> None:
    first, time, heading, separator = HEADINGS[master]
    frame = independent(0.1, 101)
    names = {"conveyor.phi": "rad", "conveyor.w": "rad/s", "motor.tau": "N.m"}
    header = separator.join([time, *(heading(name, unit) for name, unit in names.items())])
    if master == "Ecos":
        frame.insert(0, "iterations", range(101))
    path = tmp_path / "result.csv"
    rows = frame.to_csv(index=False, header=False, sep=separator)
    path.write_text(f"{first}{header}\n{rows}")
    report = referee(drive(native), path)
    assert {signal.name for signal in report.signals} == {*names}
    assert report.verdict is Verdict.AGREES


def test_units_of_headings_are_converted(native: Path) -> None:
    frame = independent(0.1, 101)
    frame["conveyor.w"] *= 30.0 / math.pi
    frame = frame.rename(columns={"conveyor.w": "conveyor.w [rpm]"})
    assert referee(drive(native), frame).verdict is Verdict.AGREES
    frame = frame.rename(columns={"conveyor.w [rpm]": "n"})
    report = referee(drive(native), frame, columns={"conveyor.w": "n:rpm"})
    assert report["conveyor.w"].verdict is Verdict.AGREES


def test_a_temperature_in_the_other_unit_is_off_by_273_15(
    native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = connect(drive(native))
    start = "the wire from motor.tau to conveyor.tau brings its source"
    for unit, other, offset in (("K", "degC", -273.15), ("degC", "K", 273.15)):
        monkeypatch.setattr(Port, "unit", unit)
        assert (other, 1.0, offset) in units_of(network.port("motor.tau"), network)
        shifts = {v.text: v.system.wires[0].offset for v in variants(network) if "degC" in v.text}
        said = f"{start} {{:+.6g}}: degC for K, or K for degC?"
        assert {said.format(x): x for x in (273.15, -273.15)}.items() <= shifts.items()


def test_runs_whose_error_cannot_be_stated_bound_nothing(
    native: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unstated(*runs: Any, **more: Any) -> Any:
        return replace(limit(*runs, **more), reason=np.full(runs[0].shape[1:], Reason.GROWING))

    monkeypatch.setattr(solution, "limit", unstated)
    request = solution.Request(["motor.tau"], np.linspace(0.0, 0.1, 11), 0.0, 1e-6, timeout=1e-9)
    got = solution._refine(connect(drive(native)), request, "it is not asked")
    assert np.isinf(got.errors["motor.tau"]).all()


EXCITER_START = {
    "motor.v": 24.0, "motor.i": 3.0, "exciter.rotor.J": 0.004, "exciter.mount.d": 30.0, "exciter.w": 30.0,
    "exciter.x": 0.004,
}  # fmt: skip


def exciter(native: Path, **changes: Any) -> System:
    """A motor turns an unbalance on a mount with little damping."""
    parts = {"motor": native / "DCMotor.fmu", "exciter": native / "UnbalanceExciter.fmu"}
    wires = ["motor.tau -> exciter.tau", "exciter.w -> motor.w"]
    return replace(System(parts, wires, EXCITER_START), **changes)


class Alone(NamedTuple):
    """A system, and what it is as one differential equation without any FMU: a motor, and the machine that it turns."""

    system: Callable[[Path], System]
    motor: Part
    machine: Part

    def columns(self) -> list[str]:
        """The states, the motor's first."""
        parts = zip(self.system(Path()).parts, (self.motor, self.machine))
        return [f"{name}.{state}" for name, part in parts for state in part.x._fields]

    def rates(self, x: Any, seen: Any) -> Any:
        """The rates of the states x, where the motor hears the speed of other ones."""
        motor, machine = self.motor, self.machine
        state = motor.x._make(x[:1])
        u = motor.u._replace(w=seen[1 + machine.x._fields.index("w")])
        tau = {**state._asdict(), **motor.model.outputs(motor.p, 0.0, state, u)._asdict()}["tau"]
        own = motor.model.derivatives(motor.p, 0.0, state, u)
        others = machine.model.derivatives(
            machine.p, 0.0, machine.x._make(x[1:]), machine.u._make([tau])
        )
        return np.array([*own, *others])


def alone(system: Callable[[Path], System], *models: Any) -> Alone:
    """The system by these models, at its start values."""
    at = system(Path())
    parts = []
    for name, model in zip(at.parts, models):
        values = {k.partition(".")[2]: v for k, v in at.start.items() if k.startswith(f"{name}.")}
        parts.append(part(model, **values))
    return Alone(system, *parts)


ALONE = {
    "drive": alone(drive, drive_motor, crank_conveyor),
    "exciter": alone(exciter, DC_motor, unbalance_exciter),
}


def stepped(name: str, method: str, h: float, stop: float, late: int = 1) -> pd.DataFrame:
    """A system stepped as a whole, where one part sees the other some steps late."""
    alone = ALONE[name]
    x, rates = np.array([*alone.motor.x, *alone.machine.x]), alone.rates
    past = [x]
    for _ in range(round(stop / h)):
        seen = past[max(0, len(past) - 1 - late)]
        next_seen = past[max(0, len(past) - late)]
        if method == "explicit":
            x = x + h * rates(x, x)
        elif method == "implicit":
            y = x
            for _ in range(60):
                y = x + h * rates(y, y)
            x = y
        else:
            k1 = rates(x, seen)
            k2 = rates(x + 0.5 * h * k1, 0.5 * (seen + next_seen))
            k3 = rates(x + 0.5 * h * k2, 0.5 * (seen + next_seen))
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(x + h * k3, next_seen))
        past.append(x)
    frame = pd.DataFrame(np.array(past), columns=alone.columns())
    frame.insert(0, "time", h * np.arange(len(frame)))
    return frame


@pytest.mark.parametrize(
    ("name", "stop", "method", "per_row"),
    [
        ("drive", 0.3, "explicit", 1),
        ("drive", 0.3, "implicit", 4),
        ("exciter", 0.6, "explicit", 4),
        ("exciter", 0.6, "implicit", 1),
    ],
)
def test_eulers_method_over_a_whole_system_is_named(
    native: Path, name: str, stop: float, method: str, per_row: int
) -> None:
    """Its negative damping looks like a lost damper, and is none."""
    frame = stepped(name, method, 2e-3 / per_row, stop)[::per_row]
    report = referee(ALONE[name].system(native), frame)
    assert report.verdict is Verdict.DIFFERS
    cause = report.causes[0]
    title = {"explicit": "Euler's method", "implicit": "the implicit Euler method"}[method]
    assert title in cause.text and f"{2e-3 / per_row:g} s" in cause.text, report.text()
    assert cause.is_certain and "lost" not in report.text()


@pytest.mark.parametrize(
    ("name", "stop"), [("drive", 0.1), pytest.param("exciter", 0.2, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("late", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_an_input_that_is_late_by_a_transport_time_is_named(
    native: Path, name: str, stop: float, late: int
) -> None:
    report = referee(
        ALONE[name].system(native), stepped(name, "continuous", 1e-4, stop, 10 * late)[::10]
    )
    assert report.verdict is Verdict.DIFFERS
    cause = report.causes[0]
    assert cause.kind == "late input", report.text()
    delay = float(re.search(r"([\d.e-]+) s earlier", cause.text)[1])  # type: ignore[index]
    assert delay == pytest.approx(1e-3 * late, rel=0.02)
    assert "lost" not in report.text()


@pytest.mark.parametrize(
    ("name", "stop", "value"), [("drive", 0.1, "motor.T"), ("exciter", 0.2, "exciter.mount.d")]
)
def test_what_a_lost_value_only_imitates_is_not_called_lost(
    native: Path, name: str, stop: float, value: str
) -> None:
    """The other master had another value, close to the FMU's own."""
    system = ALONE[name].system(native)
    given, own = system.start[value], {"motor.T": 0.0625, "exciter.mount.d": 80.0}[value]
    other = replace(system, start={**system.start, value: given + 0.95 * (own - given)})
    report = referee(system, exact(other, stop))
    assert report.verdict is Verdict.DIFFERS
    assert " is lost" not in report.text(), report.text()
    said = rf"a lost start value imitates it: {value}|the start value {value} seems to be"
    assert re.search(said, report.sentence()), report.text()


def test_times_in_ms_are_noticed(native: Path) -> None:
    frame = independent(0.3, 301)
    frame["time"] *= 1000.0
    report = referee(drive(native), frame, stop=0.3)
    assert (report.verdict, report.causes[0].kind) == (Verdict.DIFFERS, "time unit")
    assert all(signal.verdict is Verdict.AGREES for signal in report.signals)
    assert "differs" in report.sentence() and "ms" in report.sentence()
    assert report.exit_status == 1
    suite = ElementTree.fromstring(report.junit())
    assert (suite.attrib["failures"], suite.attrib["tests"]) == ("1", "4")
    slow = exact(without(drive(native), "motor.T"), 0.3)
    slow["time"] *= 1000.0
    report = referee(drive(native), slow, stop=0.3)
    assert "motor.T = 0.05 is lost" in report.sentence() and "ms" in report.sentence()
    assert (
        referee(drive(native), frame.rename(columns={"time": "time [ms]"}), stop=0.3).exit_status
        == 0
    )


def test_parts_without_model_exchange_are_judged_by_finer_runs(fmus: Path) -> None:
    """The Python FMUs offer co-simulation only; the error of the reference is stated nevertheless."""
    system = drive(fmus)
    stop = 0.1
    good, bad = (
        run(system, stop=stop, step=1e-4, output_step=1e-3),
        run(system, stop=stop, step=2e-3, algorithm="jacobi"),
    )
    report = referee(system, good)
    assert report.verdict is Verdict.AGREES and "no model exchange" in report.method
    t = report["motor.tau"].t
    true = monolithic(DRIVE_START, stop, t).y[2]
    signal = report["motor.tau"]
    assert (np.abs(signal.reference - true) <= signal.errors + 1e-9 * signal.scale).all()
    report = referee(system, bad)
    assert (report.verdict, report.causes[0].kind) == (Verdict.DIFFERS, "held inputs")


def test_the_command_judges_files(
    native: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    system = drive(native)
    package, good, bad = tmp_path / "drive.ssp", tmp_path / "good.csv", tmp_path / "bad.csv"
    write_ssp(system, package, stop=0.2)
    independent(0.2, 201).to_csv(good, index=False)
    run(system, stop=0.2, step=1e-3, algorithm="jacobi").write(bad)
    assert "good.csv agrees" in command_output("referee", package, "--result", good)
    reports = [
        tmp_path / f"report{suffix}" for suffix in (".json", ".xml", ".html", ".png", ".txt")
    ]
    outputs = [text for path in reports for text in ("--out", path)]
    text = command_output("referee", package, "--result", bad, *outputs, code=1)
    assert "bad.csv differs" in text and "inputs that are one step old" in text
    content = json.loads(reports[0].read_text())
    assert content["verdict"] == "differs" and content["causes"][0]["kind"] == "held inputs"
    suite = ElementTree.parse(reports[1]).getroot()
    assert int(suite.attrib["failures"]) == sum(
        s["verdict"] == "differs" for s in content["signals"]
    )
    assert content["sentence"].replace("'", "&#x27;") in reports[2].read_text()
    assert reports[3].read_bytes().startswith(b"\x89PNG")
    assert text.strip() == reports[4].read_text().strip()


def test_impossible_requests_are_refused(
    native: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    system = drive(native)
    with pytest.raises(SetupError, match="tolerance"):
        referee(system, independent(0.1, 11), tolerance=1.5)
    for setting in ("step", "timeout"):
        with pytest.raises(SetupError, match=f"{setting} = -1.0 s must be above 0"):
            referee(system, independent(0.1, 11), **{setting: -1.0})
    with pytest.raises(SetupError, match="cannot be judged in kg"):
        referee(system, independent(0.1, 11).rename(columns={"conveyor.w": "conveyor.w [kg]"}))
    result = oracle(system, stop=0.1, output_step=1e-2, tolerance=1e-10)
    report = referee(system, result, tolerance=1e-13)
    assert report.verdict is Verdict.UNDECIDED and report.exit_status == 2
    assert "cannot be told" in report.sentence()


def test_a_modelica_result_is_read(tmp_path: Path) -> None:
    """The transposed binary form: names in columns, constants in one matrix, curves in the other."""
    from scipy.io import savemat

    def letters(texts: list[str]) -> Any:
        width = max(map(len, texts))
        return np.array(["".join(row) for row in zip(*(text.ljust(width) for text in texts))])

    t = np.linspace(0.0, 1.0, 5)
    path = tmp_path / "result.mat"
    content = {
        "Aclass": letters(["Atrajectory", "1.1", "", "binTrans"]),
        "name": letters(["time", "motor.tau", "motor.neg", "motor.J"]),
        "description": letters(["Time in [s]", "torque [N.m]", "minus", "inertia [kg.m2]"]),
        "dataInfo": np.array([[0, 2, 2, 1], [1, 2, -2, 2], [0, 0, 0, 0], [-1, -1, -1, 0]]),
        "data_1": np.array([[0.0, 1.0], [0.5, 0.5]]),
        "data_2": np.stack([t, t**2]),
    }  # fmt: skip
    savemat(path, content, format="4")
    table, _ = read_foreign(path)
    assert table.t.tolist() == t.tolist()
    assert table["motor.neg"].tolist() == (-(t**2)).tolist()
    assert table["motor.J"].tolist() == [0.5] * 5
    assert table.column("motor.tau").unit == "N.m"


def test_a_column_of_zeros_is_in_no_other_unit(native: Path) -> None:
    """It is close to any column that is small, and no cause is made of that."""
    frame = independent(0.1, 101).assign(**{"motor.tau": 0.0})
    report = referee(drive(native), frame)
    assert report["motor.tau"].verdict is Verdict.DIFFERS
    assert report.causes == (), report.text()


@pytest.mark.parametrize(("fill", "rows"), [(math.nan, "all"), (math.inf, "one"), ("none", "one")])
def test_a_column_without_numbers_is_no_column_that_agrees(
    native: Path, tmp_path: Path, fill: float | str, rows: str
) -> None:
    """A variable that a master failed to write must not make a result look right."""
    frame = exact(drive(native), 0.1).astype(object)
    frame.loc[50 if rows == "one" else slice(None), "motor.tau"] = fill
    path = tmp_path / "theirs.csv"
    frame.to_csv(path, index=False)
    report = referee(drive(native), path)
    assert report.verdict is Verdict.DIFFERS
    assert "motor.tau has no finite value at" in report.sentence()
    assert report.causes[0].kind == "no number"
    first = "0.05 s" if rows == "one" else "at 0 s"
    assert first in report.causes[0].text
    assert report["conveyor.w"].verdict is Verdict.AGREES


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("heading.csv", b"time,motor.tau\n", "needs two rows"),
        ("not.mat", b"nothing", "cannot be read"),
        ("untimed.csv", b"motor.tau,conveyor.w\n2,40\n1,41\n", "no column is called time"),
        ("falls.csv", b"time,motor.tau\n0,8\n1,9\n0.5,8\n", "must be finite and not fall"),
        ("unit.csv", b"time,motor.tau [furlong]\n0,8\n1,9\n", "in furlong"),
        ("names.csv", b"time,torque\n0,8\n1,9\n", "--map NAME=COLUMN"),
    ],
)
def test_what_is_no_result_is_refused_in_a_single_line(
    native: Path, tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SetupError, match=message) as refusal:
        referee(drive(native), path)
    assert "\n" not in str(refusal.value)
    assert name in str(refusal.value) or "motor.tau" in str(refusal.value)


def test_a_footer_is_left_out_and_told(native: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    independent(0.3, 301).to_csv(path, index=False)
    path.write_text(f"{path.read_text()}end of the run\n")
    assert "1 row without a time at the end: not judged" in referee(drive(native), path).notes
