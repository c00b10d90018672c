"""The master against ideal algorithms, an independent solver, and misuse."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cosim import SetupError, System, Wire, linearize, oracle, run
from cosim.describe import info
from cosim.engine.energy import find_bonds
from cosim.metrics import harmonics
from cosim.system import connect
from scenarios.conveyor.first_order import SETS
from tests.conftest import ROOT, described, rewritten
from tests.cosim.foreign import idle, pack

NU = 40.0
WIRES = ("motor.tau -> conveyor.tau", "conveyor.w -> motor.w")
RECORD = ("motor.tau", "motor.P", "conveyor.phi", "conveyor.w", "conveyor.P_loss")
REST = {"motor.tau": 0.0, "conveyor.w": 0.0}
HELD_TAU2 = 104.9679504


def pair(fmus: Path, start: dict[str, Any] | None = None, wires: Any = WIRES) -> System:
    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": fmus / "CrankConveyor.fmu"}
    return System(parts, wires, SETS["A"].start(NU) if start is None else start)


def halves(fmus: Path) -> System:
    """Two motors on the conveyor, together the one of `pair`."""
    start = {"motor.A": 3000.0, "motor.B": 74.925, "motor.tau": 3.0}
    start |= {"other.A": 5000.0, "other.B": 124.875, "other.tau": 5.0}
    wires = ["motor.tau -> conveyor.tau", "other.tau +> conveyor.tau"]
    wires += ["conveyor.w -> motor.w", "conveyor.w -> other.w"]
    parts = pair(fmus).parts
    return System(parts | {"other": parts["motor"]}, wires, start)


@cache
def ripple(fmus: Path, algorithm: str, n: int, revolutions: int = 24, **start: int) -> Any:
    """The amplitude of order 2 of the torque at resonance."""
    h = 2 * math.pi / NU / n
    held = {name.replace("_", ".", 1): value for name, value in start.items()}
    system = pair(fmus / "native", SETS["A"].start(NU) | held)
    result = run(system, stop=revolutions * n * h, step=h, algorithm=algorithm, record=RECORD)
    tau, _, phi, *_ = result.data.T[1:]
    settled = phi >= phi[-1] - 16 * math.pi
    return abs(harmonics(phi[settled], tau[settled])[1])


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("settings", [{}, {"input_order": 2}], ids=["held", "moving"])
def test_wires_into_the_same_input_add_up(
    settings: Any, compiled: bool, fmus: Path, request: pytest.FixtureRequest
) -> None:
    """Two linear motors are one with both their parameters; bonds of a summed torque are no bonds."""
    native = fmus / "native"
    result = run(pair(native, {}), stop=0.2, step=1e-3, algorithm="jacobi", **settings)
    if not compiled:
        request.getfixturevalue("interpreted")
    two = run(halves(native), stop=0.2, step=1e-3, algorithm="jacobi", **settings)
    assert two["conveyor.w"] == pytest.approx(result["conveyor.w"], rel=1e-13)
    assert np.ptp(two["other.tau"]) > 1.0
    assert result.energy
    assert not two.energy


def test_sums_of_wires_reach_oracle_linear_system_and_description(fmus: Path) -> None:
    """The modes of the drive with one motor, and how fast the two motors' difference fades."""
    single, split = pair(fmus / "native", {}), halves(fmus / "native")
    exact = [oracle(system, stop=0.02)["conveyor.w"][-1] for system in (single, split)]
    assert exact[1] == pytest.approx(exact[0], rel=1e-10)
    modes = [np.sort_complex(np.linalg.eigvals(linearize(system).A)) for system in (single, split)]
    assert modes[1] == pytest.approx(np.sort_complex([*modes[0], -1 / 0.0625]), abs=1e-9)
    assert "  other.tau [N.m] +> conveyor.tau [N.m]" in info(connect(split))


def test_a_sum_ends_no_bond(fmus: Path) -> None:
    """The power at its end is not that of one wire, even where one alone has a way back."""
    without_return = replace(halves(fmus / "native"), wires=halves(fmus / "native").wires[:3])
    assert not find_bonds(connect(without_return))
    with pytest.raises(SetupError, match=r"ends at conveyor\.tau, which is a sum of wires"):
        find_bonds(connect(replace(without_return, bonds=["motor.tau * conveyor.w"])))


def percent(value: float, reference: float) -> float:
    return 100 * (value / reference - 1)


def figures_of_the_page() -> Iterator[Any]:
    """Rows of the table in docs/coupling.md: algorithm, input_holds, error in percent by steps."""
    lines = (ROOT / "docs" / "coupling.md").read_text().splitlines()
    (top,) = [n for n, line in enumerate(lines) if line.startswith("| algorithm, `input_hold`")]
    steps = [int(cell) for cell in lines[top].split("|")[3:-1]]
    for line in takewhile(lambda line: line.startswith("|"), lines[top + 2 :]):
        name, _, *cells = (cell.strip() for cell in line.split("|")[1:-1])
        algorithm, motor, conveyor = re.fullmatch(r"(\S+).*, (\d) / (\d)", name).groups()
        errors = {n: cell.split()[0] for n, cell in zip(steps, cells) if cell[-1:] == "%"}
        for n, texts in errors.items():
            long = [pytest.mark.slow] if algorithm == "iterated" and n > 256 else []
            held = {"motor_input_hold": int(motor), "conveyor_input_hold": int(conveyor)}
            yield pytest.param(algorithm.lower(), held, n, texts, id=f"{name}, {n}", marks=long)


@pytest.mark.parametrize(("algorithm", "held", "n", "text"), list(figures_of_the_page()))
def test_every_error_that_the_page_on_coupling_states(
    fmus: Path, algorithm: str, held: dict[str, int], n: int, text: str
) -> None:
    error = float(text)
    torque = ripple(fmus, algorithm, n, 48 if error > 1 else 24, **held)
    last = 10.0 ** -len(text.partition(".")[2])
    assert percent(torque, HELD_TAU2) == pytest.approx(error, abs=0.51 * last)


def test_rows_are_labelled_with_the_time_of_their_values(fmus: Path) -> None:
    """A conveyor alone at constant torque: phi(t) of every row is the solution at its time."""
    system = System(
        {"conveyor": fmus / "CrankConveyor.fmu"}, start={"conveyor.tau": 8.0, "conveyor.w": 40.0}
    )
    result = run(
        system, stop=0.1, step=7e-3, output_step=14e-3, record=["conveyor.phi", "conveyor.x"]
    )
    assert result["time"] == pytest.approx([0, 0.014, 0.028, 0.042, 0.056, 0.07, 0.084, 0.098, 0.1])
    fine = run(system, stop=0.1, step=1e-3, record=["conveyor.phi"])
    assert result["conveyor.phi"] == pytest.approx(
        CubicSpline(fine["time"], fine["conveyor.phi"])(result["time"]), abs=1e-7
    )
    assert result["time"][-1] == 0.1
    assert result.units == {"time": "s", "conveyor.phi": "rad", "conveyor.x": "m"}


def test_wires_scale_and_shift(fmus: Path) -> None:
    """tau_static = A - B w tells what the motor hears."""
    wires = ["motor.tau -> conveyor.tau", "conveyor.w * 0.5 - 1.5e0 -> motor.w"]
    result = run(pair(fmus, {"conveyor.w": 33.0}, wires), stop=0.01, step=1e-3)
    received = (8000.0 - result["motor.tau_static"][0]) / 199.8
    assert received == pytest.approx(0.5 * 33.0 - 1.5, rel=1e-12)


@pytest.mark.parametrize(
    ("wire", "text"),
    [
        (Wire("motor.tau", "conveyor.tau"), "motor.tau -> conveyor.tau"),
        (Wire(("motor", "tau"), ("conveyor", "tau"), 0.5, -1.5), "motor.tau * 0.5 - 1.5 -> conveyor.tau"),
        (Wire("motor.tau", "conveyor.tau", offset=2.0, converts=False), "motor.tau + 2.0 => conveyor.tau"),
    ],
)  # fmt: skip
def test_a_wire_is_a_value_or_a_text(fmus: Path, wire: Wire, text: str) -> None:
    assert str(wire) == text
    systems = (pair(fmus, wires=[form, WIRES[1]]) for form in (wire, text))
    results = [run(system, stop=0.01, step=1e-3) for system in systems]
    assert np.array_equal(results[0].data, results[1].data)
    assert results[0].provenance["wires"] == [text, WIRES[1]]


def test_names_of_wires_may_hold_anything(tmp_path: Path) -> None:
    """A blank, * and + are letters to FMI; in a text they are signs."""
    odd = described(('name="y"', 'name="y * 2 + der(x), -> z"'), ('name="u"', 'name=" u + 1"'))
    fmu = rewritten(pack(tmp_path / "plain.fmu"), tmp_path / "odd.fmu", odd)
    start = idle("ab", "a.u", "b.u")
    wire = Wire(("a", "y * 2 + der(x), -> z"), ("b", " u + 1"))
    settings: dict[str, Any] = {"stop": 1.0, "step": 0.1, "record": ["b.z"]}
    got = run(System({"a": fmu, "b": fmu}, [wire], start | {"a. u + 1": 2.0}), **settings)
    plain = System(
        dict.fromkeys("ab", tmp_path / "plain.fmu"), ["a.y -> b.u"], start | {"a.u": 2.0}
    )
    assert np.array_equal(got.data, run(plain, **settings).data)
    for other, message in (
        (Wire(("c", "y"), ("b", " u + 1")), "c.y: there is no part 'c', only a, b"),
        (Wire(("a", "y"), ("b", " u + 1")), "a has no variable 'y', only "),
        (Wire(wire.source, wire.target, math.inf), "factor and offset must be finite numbers"),
    ):
        with pytest.raises(SetupError) as caught:
            run(System({"a": fmu, "b": fmu}, [other], start), **settings)
        assert message in str(caught.value)


def test_wires_convert_units(fmus: Path, tmp_path: Path) -> None:
    """A conveyor that tells its speed in rpm drives the motor as one that tells it in rad/s."""
    unit = f'<Unit name="rpm"><BaseUnit rad="1" s="-1" factor="{math.pi / 30!r}"/></Unit>'
    edit = described(
        ("</UnitDefinitions>", f"{unit}</UnitDefinitions>"),
        (r'(?s)(<ScalarVariable name="w".*?)unit="rad/s" displayUnit="rpm"', r'\1unit="rpm"'),
    )
    rpm = rewritten(fmus / "CrankConveyor.fmu", tmp_path / "Rpm.fmu", edit)
    parts = {"motor": fmus / "DriveMotor.fmu", "conveyor": rpm}
    result = run(System(parts, WIRES, {"conveyor.w": 30.0}), stop=1e-3, step=1e-3)
    assert result.units["conveyor.w"] == "rpm"
    assert result["motor.tau_static"][0] == pytest.approx(8000.0 - 199.8 * math.pi, rel=1e-12)
    (bond,) = result.energy.values()
    assert bond["given"] == pytest.approx(bond["taken"], rel=0.1)
    assert bond["given"] > 0.1
    assert bond["residual"] == bond["given"] - bond["taken"] != 0.0


def test_an_open_input_keeps_the_start_of_its_fmu_and_is_reported(fmus: Path) -> None:
    changes = {"wires": ["motor.tau -> conveyor.tau"]}
    open_, started = (replace(pair(fmus, start), **changes) for start in ({}, {"motor.w": 40.0}))
    runs = [run(system, stop=0.05, step=1e-3) for system in (open_, started)]
    assert np.array_equal(runs[0].data, runs[1].data)
    assert [r.provenance["open_inputs"] for r in runs] == [{"motor.w": 40.0}, {}]


def test_the_loop_adds_the_offset_of_a_wire(native: Path) -> None:
    """J w' = 3 + 2 of a motor that gives 3 N.m whatever its speed is."""
    start = {"motor.A": 3.0, "motor.B": 0.0, "motor.tau": 3.0, "gear.J": 2.0, "gear.eta": 1.0}
    start |= {"gear.i": 1.0, "gear.w_a": 0.0, "gear.tau_b": 0.0}
    parts = {"motor": native / "DriveMotor.fmu", "gear": native / "Gearbox.fmu"}
    result = run(System(parts, ["motor.tau + 2.0 -> gear.tau_a"], start), stop=1.0, step=0.1)
    assert result["gear.w_a"][-1] == pytest.approx(2.5, rel=1e-9)
