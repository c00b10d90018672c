"""One FMU that holds a system: its numbers in fmpy against those of our master."""

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from numpy.testing import assert_array_equal

from cosim import SetupError, System, run, write_container

WIRES = ["line.motor.tau -> conveyor.tau", "conveyor.w -> line.motor.w"]
START = {
    "line.motor.T": 0.05,
    "line.motor.tau": 3.0,
    "line.motor.characteristic": 1,
    "conveyor.rod.finite": True,
    "conveyor.w": 30.0,
}


def pair(fmus: Path, **start: Any) -> System:
    """The pair, its motor in a subsystem."""
    parts = {"line.motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    return System(parts, WIRES, START | {k.replace("__", "."): v for k, v in start.items()})


def simulate(path: Path, **start: Any) -> Any:
    """The container in fmpy."""
    values = {name.replace("__", "."): value for name, value in start.items()}
    settings = {"stop_time": 0.1, "step_size": 1e-3, "output_interval": 1e-3}
    return fmpy.simulate_fmu(str(path), **settings, start_values=values)


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("order", [["line.motor", "conveyor"], ["conveyor", "line.motor"]])
def test_container_equals_master(
    fmus: Path, tmp_path: Path, algorithm: str, order: list[str]
) -> None:
    """All outputs after the first step; outputs with direct feedthrough may differ at t = 0."""
    path = tmp_path / "drive.fmu"
    write_container(pair(fmus), path, step=1e-3, algorithm=algorithm, order=order)
    assert validate_fmu(str(path)) == []
    assert [file.name for file in tmp_path.iterdir()] == ["drive.fmu"]
    result = run(pair(fmus), stop=0.1, step=1e-3, algorithm=algorithm, order=order)
    rows = simulate(path)
    for name in result.names[1:]:
        assert_array_equal(rows[name][1:], result[name][1:], err_msg=name)
    for name in ("line.motor.tau", "conveyor.w", "conveyor.phi"):
        assert rows[name][0] == result[name][0]
    assert np.ptp(result["conveyor.w"]) > 1.0


def test_a_warning_of_the_tool_appears_once(
    fmus: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Although our own check and the tool go through the loop, one after the other; again for another file."""
    for name in ("first", "second"):
        write_container(pair(fmus), tmp_path / f"{name}.fmu", step=1e-3)
        assert [text.partition(" ")[0] for text in caplog.messages] == ["Loop"]
        caplog.clear()


def test_parameters_and_open_inputs_can_be_set_from_outside(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "drive.fmu"
    write_container(pair(fmus), Path("drive.fmu"), step=1e-3)
    changed = {"conveyor__trough__m": 150.0, "line__motor__characteristic": 0}
    result = run(pair(fmus, **changed), stop=0.1, step=1e-3, algorithm="jacobi")
    assert_array_equal(simulate(path, **changed)["conveyor.w"], result["conveyor.w"])

    conveyor = System({"conveyor": fmus / "CrankConveyor.fmu"}, start={"conveyor.tau": 12.0})
    write_container(conveyor, path, step=1e-3)
    for start in ({}, {"conveyor__tau": -3.0}):
        system = System(conveyor.parts, start={"conveyor.tau": start.get("conveyor__tau", 12.0)})
        result = run(system, stop=0.1, step=1e-3, algorithm="jacobi")
        assert_array_equal(simulate(path, **start)["conveyor.a"], result["conveyor.a"])


def test_types_and_two_parts_of_the_same_fmu(fmus: Path, echo: Path, tmp_path: Path) -> None:
    path = tmp_path / "types.fmu"
    parts = {"a": echo, "b": echo}
    start = {"a.i": 3, "a.b": True, "a.s": "B", "a.u": 0.25, "b.r": 0.5, "b.s": "C"}
    write_container(System(parts, ["a.y -> b.u"], start), path, step=1e-3)
    rows = simulate(path)
    assert rows["a.y"][-1] == 1e4 * ord("B") + 1030.25
    assert rows["b.y"][-1] == rows["a.y"][-1] + 1e4 * ord("C") + 0.5


def test_container_refuses_what_it_cannot_do(fmus: Path, echo: Path, tmp_path: Path) -> None:
    springs = dict.fromkeys(("a", "b"), fmus / "LinearSystem.fmu")
    open_inputs = {f"{name}.u[{i}]": 0.0 for name in springs for i in range(1, 5)}
    ring = ["a.z[1] -> b.u[1]", "b.y[1] -> a.u[1]"]
    shifted = System(pair(fmus).parts, [f"{WIRES[0][:14]} + 1 -> conveyor.tau", WIRES[1]])
    step: dict[str, Any] = {"step": 1e-3}
    cases = [
        (shifted, step, "a container cannot scale, shift or convert units"),
        (System({"e": echo}, [], {"e.u": 0.0, "e.s": "a b"}), step, "Start value"),
        (
            System(springs, ring, open_inputs),
            step,
            "a.z[1] [1] has direct feedthrough from a.u[1] [1]",
        ),
        (pair(fmus), step | {"algorithm": "strang"}, "'strang' must be one of jacobi, gauss-"),
        (pair(fmus), step | {"order": ["conveyor"]}, "must name each of line.motor, conveyor"),
        (pair(fmus), {"step": 0.0}, "step = 0.0 s must be above 0"),
    ]
    for system, settings, message in cases:
        with pytest.raises(SetupError) as caught:
            write_container(system, tmp_path / "bad.fmu", **settings)
        assert message in str(caught.value)
        assert list(tmp_path.iterdir()) == []
    good = System(springs, ring, open_inputs)
    write_container(good, tmp_path / "good.fmu", step=1e-3, order=["b", "a"])
    result = run(good, stop=0.1, step=1e-3, algorithm="jacobi")
    for name in ("a.z[1]", "b.y[1]"):
        assert_array_equal(simulate(tmp_path / "good.fmu")[name], result[name])
