"""Inputs over time against closed solutions: tables, functions, changes; in every loop alike."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from cosim import (
    Adaptive,
    Series,
    SetupError,
    SimulationError,
    System,
    diagnose,
    run,
    write_container,
    write_osp,
    write_ssp,
)
from cosim.cli.main import main
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack, single_fmu_system

A, B, T = 100.0, 2.0, 0.05
RAMP = Series.of({"t": [0.0, 0.35, 0.35, 1.0], "w": [0.0, 10.0, 20.0, 5.0]})


def motor(fmus: Path, speed: Any, **more: Any) -> System:
    """A motor T M' + M = A - B w at a speed over time, from M = A."""
    return System(
        {"motor": fmus / "native" / "DriveMotor.fmu"},
        start={"motor.T": T, "motor.A": A, "motor.B": B, "motor.tau": A},
        inputs={"motor.w": speed},
        **more,
    )


def torque(t: Any) -> Any:
    """The motor's torque at the speed RAMP: a ramp, a jump, a ramp down, in closed form."""

    def on_line(M: float, w: float, slope: float, s: Any) -> Any:
        """After s [s] from M at the speed w + slope s."""
        steady = A - B * (w + slope * (s - T))
        return steady + (M - (A - B * (w - slope * T))) * np.exp(-s / T)

    up, down = 10.0 / 0.35, -15.0 / 0.65
    middle = on_line(A, 0.0, up, 0.35)
    return np.where(t <= 0.35, on_line(A, 0.0, up, t), on_line(middle, 20.0, down, t - 0.35))


def speed_error(result: Any) -> float:
    """The largest error of the torque [N m]."""
    return float(np.abs(result["motor.tau"] - torque(result["time"])).max())


def test_a_motor_follows_a_ramp_and_a_step_with_order_two(fmus: Path) -> None:
    """A value held from the beginning or the end of each step would be of order one."""
    errors = []
    for n in (100, 200, 400, 800):
        result = run(motor(fmus, RAMP), stop=1.0, step=1 / n, record=["motor.tau"])
        assert result.provenance["loop"] == "compiled"
        errors.append(speed_error(result))
    assert [math.log2(a / b) for a, b in pairwise(errors)] == pytest.approx([2.0] * 3, abs=0.15)
    assert errors[-1] < 1e-3


def test_an_fmu_that_interpolates_follows_a_line_exactly(fmus: Path) -> None:
    """The jump is at a communication point: nothing is left but the accuracy of the FMU."""
    result = run(motor(fmus, RAMP), stop=1.0, step=0.01, input_order=1, record=["motor.tau"])
    assert speed_error(result) < 1e-6


@pytest.mark.parametrize(("substeps", "held"), [(1, False), (3, True)])
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "strang"])
def test_both_loops_follow_with_the_same_bits(
    algorithm: str, substeps: int, held: bool, fmus: Path, request: pytest.FixtureRequest
) -> None:
    rng = np.random.default_rng(1)
    times = np.sort(rng.uniform(0.0, 1.0, 500))
    table = Series.of({"t": [0.0, *times, 1.0], "w": rng.normal(size=502)})
    table = table.held() if held else table
    system = System(
        {name: fmus / "native" / f"{file}.fmu" for name, file in (
            ("motor", "DriveMotor"), ("conveyor", "CrankConveyor"), ("free", "DriveMotor"))},
        ["motor.tau -> conveyor.tau", "conveyor.w -> motor.w"],
        {"conveyor.w": 30.0},
        inputs={"free.w": table},
    )  # fmt: skip
    settings: dict[str, Any] = {"stop": 1.0, "step": 1.3e-3, "algorithm": algorithm}
    settings["substeps"] = {"free": substeps}
    compiled = run(system, **settings)
    request.getfixturevalue("interpreted")
    plain = run(system, **settings)
    assert compiled.provenance["loop"] == "compiled"
    assert plain.provenance["loop"].startswith("Python")
    assert_array_equal(compiled.data, plain.data)


def test_adaptive_steps_end_at_a_jump_and_keep_the_tolerance(fmus: Path) -> None:
    tolerances = (1e-2, 1e-3, 1e-4)
    errors = []
    for tolerance in tolerances:
        result = run(motor(fmus, RAMP), stop=1.0, step=Adaptive(tolerance), record=["motor.tau"])
        assert 0.35 in result["time"]
        errors.append(speed_error(result) / A)
        assert errors[-1] < tolerance
    assert [math.log10(a / b) for a, b in pairwise(errors)] == pytest.approx([1.0, 1.0], abs=0.35)


@pytest.mark.parametrize("input_order", [0, 1])
def test_a_function_of_time_is_of_order_two(input_order: int, fmus: Path) -> None:
    """M of w = sin(omega t), from the complex amplitude and what dies out."""
    omega = 20.0

    def exact(t: Any) -> Any:
        amplitude = -B / (1.0 + 1j * omega * T)
        swing = (amplitude * np.exp(1j * omega * t)).imag
        return A + swing - amplitude.imag * np.exp(-t / T)

    system = motor(fmus, lambda t: math.sin(omega * t))
    errors = []
    for h in (0.02, 0.01, 0.005):
        result = run(system, stop=1.0, step=h, input_order=input_order, record=["motor.tau"])
        errors.append(np.abs(result["motor.tau"] - exact(result["time"])).max())
    orders = [math.log2(a / b) for a, b in pairwise(errors)]
    assert min(orders) > (1.9 if input_order == 0 else 2.9)
    assert "lambda" in result.provenance["inputs"]["motor.w"]["function"]


def test_units_are_converted(fmus: Path) -> None:
    """Display units of the input, and units of other variables."""
    rpm = Series.of({"t": RAMP.t, "n [rpm]": 30.0 / math.pi * RAMP["w"]})
    plain, turned = (run(motor(fmus, table), stop=1.0, step=0.01) for table in (RAMP, rpm))
    assert turned["motor.tau"] == pytest.approx(plain["motor.tau"], rel=1e-12)
    for unit, message in (
        ("N.m", "cannot follow a table in N.m"),
        ("knots", "no FMU here defines"),
    ):
        with pytest.raises(SetupError, match=message):
            table = Series.of({"t": [0.0, 1.0], f"w [{unit}]": [0.0, 1.0]})
            run(motor(fmus, table), stop=1.0, step=0.01)


def echo(tmp_path: Path, **more: Any) -> System:
    """x' = -x + u from x = 1, which shows what it hears, and whose rate is tunable."""
    capabilities = more.pop("capabilities", {})
    return replace(single_fmu_system(pack(tmp_path / "A.fmu", **capabilities)), **more)


@pytest.mark.parametrize("step", [0.1, 0.07, Adaptive(1e-3, first=0.1)])
def test_a_parameter_changes_at_its_time(
    step: float | Adaptive, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """x' = a x with a = -1, from 0.5 s -3: also where no step would have ended there."""
    system = echo(tmp_path, changes=["at 0.5 s A.a = -3"])
    for loop in ("compiled", "Python"):
        if loop == "Python":
            request.getfixturevalue("interpreted")
        result = run(system, stop=1.0, step=step, record=["A.y"])
        assert result["A.y"][-1] == pytest.approx(math.exp(-0.5 - 1.5), rel=1e-12)
        if not isinstance(step, Adaptive):
            assert result.provenance["loop"].startswith(loop)
    assert result.provenance["changes"] == ["at 0.5 s A.a = -3"]


def test_changes_survive_a_step_that_is_taken_again(tmp_path: Path) -> None:
    """Half of the steps are discarded: the run comes back over changes that were made."""
    limits, changes = {"longest_step": 0.06}, ["at 0.2 s A.a = -3", "at 0.55 s A.a = -2"]
    system = echo(tmp_path, capabilities=limits, changes=changes)
    result = run(system, stop=1.0, step=0.1, record=["A.y"])
    assert result.provenance["discarded"]
    assert result["A.y"][-1] == pytest.approx(math.exp(-0.2 - 1.05 - 0.9), rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("integer", [0, 7, -2]),
        ("boolean", [False, True, False]),
        ("enumeration", [1, "high", "low"]),
        ("string", ["", "a b", "c"]),
    ],
)
@pytest.mark.parametrize("step", [0.1, Adaptive(1e-2, first=0.05)])
@pytest.mark.parametrize("file", [False, True])
def test_discrete_inputs_are_held_to_their_next_row(
    kind: str, values: list[Any], step: float | Adaptive, file: bool, tmp_path: Path
) -> None:
    table = Series.of({"t": [0.0, 0.3, 0.6], "v": values}).held()
    if file:
        rows = [f"{t},{str(v).lower()}" for t, v in zip(table.t, values)]
        (tmp_path / "a.csv").write_text("\n".join(["t,v", *rows]))
        table = Series.read(tmp_path / "a.csv", "v").held()
    system = echo(tmp_path, inputs={f"A.{kind}_in": table})
    out = "A.spelled" if kind == "string" else f"A.{kind}_out"
    result = run(system, stop=1.0, step=step, record=[out])
    distinct = list(dict.fromkeys(result[out]))
    wanted = {"integer": [0, 7, -2], "boolean": [0, 1], "enumeration": [1, 5], "string": [0]}
    assert distinct == wanted[kind]
    times = result["time"][1:][np.diff(result[out]) != 0]
    if kind != "string" and step == 0.1:
        assert times == pytest.approx([0.4, 0.7])


@pytest.mark.parametrize("capable", [True, False])
def test_inputs_feed_a_loop_of_parts(capable: bool, tmp_path: Path) -> None:
    """a' = -a + b, b' = -b + u with u = t: the exact solution in closed form."""
    fmu = pack(tmp_path / "A.fmu", x0=0.0, canInterpolateInputs=capable)
    table = Series.of({"t": [0.0, 2.0], "u": [0.0, 2.0]})
    system = System({"a": fmu, "b": fmu}, ["b.y -> a.u"], inputs={"b.u": table})
    errors = []
    for n in (20, 40, 80):
        result = run(system, stop=2.0, step=2 / n, algorithm="jacobi", input_order=1)
        t = result["time"]
        exact = t - 2.0 + (t + 2.0) * np.exp(-t)
        errors.append(np.abs(result["a.y"] - exact).max())
    assert [math.log2(a / b) for a, b in pairwise(errors)] == pytest.approx([2.0, 2.0], abs=0.25)


def test_a_diagnosis_leaves_the_inputs_out_of_account(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "A.fmu")
    parts, wires = {"a": fmu, "b": fmu, "c": fmu}, ["a.y * -4 -> b.u", "b.y * 4 -> a.u"]
    without_input = System(parts, wires)
    with_input = System(parts, wires, inputs={"c.u": math.sin})
    first, second = (
        diagnose(s, step=0.01, algorithm="gauss-seidel") for s in (without_input, with_input)
    )
    assert second.frequency == pytest.approx(first.frequency, rel=1e-9)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "output": ({"inputs": {"A.y": RAMP}}, "has causality output and cannot change over time"),
    "fixed": ({"changes": ["at 0.5 s A.b = 2"]}, "is a parameter that is not tunable"),
    "unknown": ({"inputs": {"A.v": RAMP}}, "A has no variable 'v'"),
    "lines": ({"inputs": {"A.integer_in": RAMP}}, "cannot be interpolated and can only follow a table that is held"),
    "function": ({"inputs": {"A.boolean_in": math.sin}}, "cannot follow a function of time"),
    "late": ({"inputs": {"A.u": Series.of({"t": [0.5, 1.0], "u": [0, 1]})}}, "A.u: its table begins at 0.5 s"),
    "short": ({"inputs": {"A.u": Series.of({"t": [0.0, 0.5], "u": [0, 1]})}}, "A.u: its table ends at 0.5 s"),
    "nan": ({"inputs": {"A.u": Series.of({"t": [0, 1], "u": [0, math.nan]})}}, "A.u: the table, row 3, column u: 'nan' is not a finite number"),
    "falling": ({"inputs": {"A.u": Series.of({"t": [0.0, -1.0], "u": [1, 2]})}}, "time -1.0 s after 0.0 s must be finite and not fall"),
    "endless": ({"inputs": {"A.u": Series.of({"t": [0.0, math.inf], "u": [1, 2]})}}, "row 3, column t: 'inf' is not a finite number"),
    "rows": ({"inputs": {"A.u": Series.of({"t": [], "u": []})}}, "A.u: the table has no rows"),
    "columns": ({"inputs": {"A.u": Series.of({"t": [0, 1], "u": [1, 2], "v": [1, 2]})}}, "the table must have one column beside t, not u, v"),
    "item": ({"inputs": {"A.enumeration_in": Series.of({"t": [0.0], "mode": ["fast"]})}}, "must be one of low"),
    "both": ({"inputs": {"A.u": RAMP}, "changes": ["1 A.u=2"]}, "it also follows a table"),
    "text": ({"changes": ["A.u = 2"]}, "must read 'at TIME s part.variable = value'"),
    "value": ({"changes": ["at 0.5 s A.u = two"]}, "A.u = 'two' must be a finite number"),
    "grid": ({"changes": ["at 0.55 s A.a = -3"], "capabilities": {"canHandleVariableCommunicationStepSize": False}},
        "A.a = 0.55 s must be a whole number of steps of 0.1 s"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    arguments, message = REFUSED[case]
    with pytest.raises(SetupError) as caught:
        run(echo(tmp_path, **dict(arguments)), stop=1.0, step=0.1)
    assert message in str(caught.value)


def test_columns_of_several_lengths_are_no_table() -> None:
    with pytest.raises(SetupError, match="as many rows each, not t 2, u 1"):
        Series.of({"t": [0.0, 1.0], "u": [1.0]})


@pytest.mark.parametrize("compiled", [True, False])
def test_a_function_that_gives_no_number_ends_the_run(
    compiled: bool, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if not compiled:
        request.getfixturevalue("interpreted")
    system = echo(tmp_path, inputs={"A.u": lambda t: math.nan if t > 0.51 else 0.0})
    with pytest.raises(SimulationError, match=r"A\.u = nan at t = 0\.5 s must be") as caught:
        run(system, stop=1.0, step=0.1, record=["A.y"])
    assert caught.value.result["time"] == pytest.approx([0.1 * n for n in range(6)])


@pytest.mark.parametrize(
    "write",
    [
        write_ssp,
        lambda s, path: write_osp(s, path, step=0.1, start=0.0, stop=1.0),
        lambda s, path: write_container(s, path, step=0.1),
    ],
)
def test_formats_without_inputs_over_time_refuse_them(
    write: Callable[[System, Path], None], fmus: Path, tmp_path: Path
) -> None:
    with pytest.raises(SetupError, match=r"motor\.w changes over time, which .* cannot express"):
        write(motor(fmus, RAMP), tmp_path / "a.ssp")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("kind", "held"), [("ssp", False), ("osp", True), ("folder", False)])
def test_the_command_line_feeds_a_system_of_any_format(
    held: bool, kind: str, fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    """In the unit of the file's header, on lines or held, and the result says so."""
    file, out, rpm = tmp_path / f"motor.{kind}", tmp_path / "out.csv", 30.0 / math.pi
    still = motor(fmus, RAMP)
    still = replace(still, inputs={}, start={**still.start, "motor.w": 0.0})
    if kind == "osp":
        write_osp(still, file, step=0.01, stop=1.0)
    else:
        write_ssp(still, tmp_path / "motor.ssp", 1.0)
    if kind == "folder":
        with ZipFile(tmp_path / "motor.ssp") as archive:
            archive.extractall(file)
    frame = pd.DataFrame({"t": RAMP.t, "speed [rpm]": rpm * RAMP["w"]})
    frame.to_csv(tmp_path / "w.csv", index=False)
    arguments = ["run", str(file), "--step", "0.01", "--input", str(tmp_path / "w.csv")]
    arguments += ["--held"] if held else []
    command_output(*arguments, "--map", "motor.w=speed", "--out", out)
    expected = run(motor(fmus, RAMP.held() if held else RAMP), stop=1.0, step=0.01)
    written = pd.read_csv(out)["motor.tau"].to_numpy()
    assert written == pytest.approx(expected["motor.tau"], rel=1e-12)
    facts = json.loads(out.with_suffix(".json").read_text())
    followed = facts["inputs"]["motor.w"]
    assert (followed["source"], followed["held"]) == ("w.csv, column speed", held)
    assert "has no column 'torque', only t, speed" in command_output(
        *arguments, "--map", "motor.w=torque", code=2
    )
    assert "has the name of an input: give --map NAME=COLUMN" in command_output(*arguments, code=2)


def test_the_command_line_makes_changes(tmp_path: Path, command_output: CommandOutput) -> None:
    fmu, out = pack(tmp_path / "A.fmu"), tmp_path / "out.csv"
    arguments = ["run", str(fmu), "--stop", "1", "--step", "0.1", "--out", str(out)]
    command_output(*arguments, "--record", "A.y", "--at", "0.5 A.a=-3", "--at", "0.5 A.u=0")
    assert pd.read_csv(out)["A.y"].iloc[-1] == pytest.approx(math.exp(-2.0), rel=1e-12)


SET = (
    '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" '
    'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="2.0" name="set">'
    "<ssv:Parameters>{}</ssv:Parameters>"
    '<ssv:Units><ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="0.001"/></ssc:Unit></ssv:Units>'
    "</ssv:ParameterSet>"
)


def ssv(*rows: str) -> str:
    """A parameter set of 'name Type attributes'."""
    triples = [row.split(" ", 2) for row in rows]
    return SET.format(
        "".join(f'<ssv:Parameter name="{n}"><ssv:{t} {a}/></ssv:Parameter>' for n, t, a in triples)
    )


SPEED = 600.0 * math.pi / 30.0
FILES = {
    "set.ssv": ssv(
        'T Real value="50" unit="ms"',
        'kloss.w_s Float64 value="600" unit="rpm"',
        'DriveMotor.characteristic Enumeration value="kloss"',
        'w Real value="30"',
    ),
    "bare.csv": "name,value,unit\nT,0.05,s\nkloss.w_s,600,rpm\ncharacteristic,kloss,\n\nw,30,\n\n",
    "more.csv": "\ufeffunit,value,note,name\ns,0.05,lag,DriveMotor.T\nrpm,600,,DriveMotor.kloss.w_s\n"
    ",1,,characteristic\n,30,,w\n",
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_gives_a_single_fmu_its_parameters(name: str, fmus: Path, tmp_path: Path) -> None:
    """Units of the file, of the FMU and its display units are converted; --set goes over it."""
    (tmp_path / name).write_text(FILES[name], encoding="utf-8")
    out = tmp_path / "out.csv"
    arguments = ["run", str(fmus / "DriveMotor.fmu"), "--stop", "0.1", "--out", str(out)]
    arguments += ["--parameters", str(tmp_path / name), "--set", "A=7000"]
    assert main(arguments) == 0
    start = {"T": 0.05, "kloss.w_s": SPEED, "characteristic": 1, "w": 30.0, "A": 7000.0}
    named_start = {f"DriveMotor.{key}": value for key, value in start.items()}
    system = System({"DriveMotor": fmus / "DriveMotor.fmu"}, start=named_start)
    expected = run(system, stop=0.1, step=1e-3)["DriveMotor.tau"]
    assert pd.read_csv(out)["DriveMotor.tau"].to_numpy() == pytest.approx(expected, rel=1e-13)
    facts = json.loads(out.with_suffix(".json").read_text())
    assert facts["start_values"] == pytest.approx(named_start, rel=1e-15)


def test_a_file_gives_the_parts_of_a_system_their_parameters(fmus: Path, tmp_path: Path) -> None:
    parts = {"line.motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    wires = ["line.motor.tau -> conveyor.tau", "conveyor.w -> line.motor.w"]
    write_ssp(System(parts, wires, {"line.motor.T": 0.02}), tmp_path / "pair.ssp", 0.1)
    file = tmp_path / "set.csv"
    file.write_text("name,value\nline.motor.T,0.05\nconveyor.rod.finite,true\n")
    out = tmp_path / "out.csv"
    arguments = ["run", str(tmp_path / "pair.ssp"), "--parameters", str(file), "--out", str(out)]
    assert main(arguments) == 0
    facts = json.loads(out.with_suffix(".json").read_text())
    assert facts["start_values"] == {"line.motor.T": 0.05, "conveyor.rod.finite": True}
    assert facts["parts"]["conveyor"]["parameters"]["rod.finite"] == 1


BAD_FILES = {
    "fits nothing": (ssv('X Real value="1"'), "set.ssv, line 1: parameter X fits no variable"),
    "given twice": (ssv('T Real value="1"', 'DriveMotor.T Real value="1"'), "is given twice"),
    "bounds": (ssv('T Real value="-1"'), "DriveMotor.T [s] = -1.0 must be at least"),
    "no set": ("<x/>", "set.ssv, line 1: the element must be ParameterSet, not x"),
    "no column": ("name,amount\nT,1\n", "has no column 'value', only name, amount"),
    "row": ("name,value\nT,1\nX,1\n", "set.csv, row 3: parameter X fits no variable"),
    "row type": (
        "name,value\nT,fast\n",
        "row 2: parameter T: DriveMotor.T [s] = 'fast' must be a finite number",
    ),
    "row unit": (
        "name,value,unit\nT,1,N.m\n",
        "row 2: parameter T: DriveMotor.T [s] cannot be given in N.m: N.m cannot be converted to s",
    ),
    "row item": ("name,value\ncharacteristic,round\n", "'round' must be one of linear, kloss"),
    "short row": (
        "name,value\nT\n",
        "row 2: parameter T: DriveMotor.T [s] = '' must be a finite number",
    ),
    "no text": ("\0\1", "has no column 'name'"),
    "suffix": ("T = 1", "set.txt must be an .ssv or a .csv"),
    "missing": (None, "there is no such file"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_what_is_no_file_of_parameters_is_refused(
    case: str, fmus: Path, tmp_path: Path, command_output: CommandOutput
) -> None:
    text, message = BAD_FILES[case]
    suffix = "csv" if text is None or "," in text or "\0" in text else "ssv"
    file = tmp_path / f"set.{'txt' if case == 'suffix' else suffix}"
    if text is not None:
        file.write_text(text)
    arguments = ["run", str(fmus / "DriveMotor.fmu"), "--stop", "1", "--parameters", str(file)]
    assert message in command_output(*arguments, code=2)
