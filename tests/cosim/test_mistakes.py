"""Mistakes of a Python program, and of the shell, are refused before the first run with what to write."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from cosim import Adaptive, Series, SetupError, System, Wire, run
from cosim.names import only

WIRES = ["m.tau -> c.tau", "c.w -> m.w"]
SYSTEMS: dict[str, tuple[dict[str, Any], str]] = {
    "wires as tuples": ({"wires": [("m.tau", "c.tau")]}, "('m.tau', 'c.tau') in wires must be a text: write 'm.tau -> c.tau'"),
    "a wire of three": ({"wires": [("m.tau", "c.tau", 2.0)]}, "in wires must be a text"),
    "a text as wires": ({"wires": "m.tau -> c.tau"}, "wires must be a sequence of texts: write ['m.tau -> c.tau']"),
    "a text as changes": ({"changes": "at 1 s m.w = 2"}, "changes must be a sequence of texts: write ['at 1 s m.w = 2']"),
    "a change as a tuple": ({"changes": [(1.0, "m.w", 2.0)]}, "in changes must be a text"),
    "a text as bonds": ({"bonds": "m.tau * c.w"}, "bonds must be a sequence of texts: write ['m.tau * c.w']"),
    "start as a list": ({"start": ["m.T=0.05"]}, "start must be values by name: write {'motor.T': 0.05}"),
    "start as a text": ({"start": {"m.T": "50 N"}}, "m.T [s] cannot be given in N: N cannot be converted to s"),
    "inputs as a list": ({"inputs": [1.0]}, "inputs must be values by name"),
    "a number as an input": ({"inputs": {"m.w": 3.0}}, "input m.w = 3.0 must be a Series or a function of time; to hold it, give it as a start value"),
    "a file as an input": ({"inputs": {"m.w": "w.csv"}}, "input m.w = 'w.csv' must be a Series or a function of time"),
    "the wrong way round": ({"wires": ["c.tau -> m.tau"]}, "c.tau [N.m] has causality input, not output; write m.tau -> c.tau"),
    "a name": ({"wires": ["m.tua -> c.tau"]}, "m has no variable 'tua', only w, tau,"),
    "no wires": ({"wires": None}, "wires must be a sequence of texts, as a list"),
    "a start of a number": ({"start": {3: 1.0}}, "3 is not a name: write 'part.variable'"),
    "a near name": ({"start": {"m.Tau": 1.0}}, "; did you mean tau?"),
    "a wire twice": ({"wires": [*WIRES, WIRES[0]]}, "c.tau [N.m] is driven twice"),
    "an output twice": ({"wires": [*WIRES, "m.tau * 2 +> c.tau"]}, "c.tau adds one output twice"),
    "another unit": ({"wires": ["m.tau -> m.w"]}, "m.tau [N.m] cannot drive m.w [rad/s]"),
    "half an arrow": ({"wires": ["m.tau > c.tau"]}, "must read 'part.output [* factor] [+ offset] -> part."),
    "an input as a source": ({"wires": ["m.w -> c.tau"]}, "m.w [rad/s] has causality input, not output"),
    "an output as a target": ({"wires": ["m.tau -> c.phi"]}, "c.phi [rad] has causality output, not input"),
    "what its check refuses": ({"wires": WIRES, "start": {"m.T": 0.0}}, "m: GetReal returned Fatal: T = 0.0 s must be > 0"),
    "below its bound": ({"start": {"c.trough.m": -1.0}}, "c.trough.m [kg] = -1.0 must be at least"),
    "above its bound": ({"start": {"m.characteristic": 5}}, "m.characteristic = 5 must be at most 1"),
    "an output at the start": ({"start": {"m.P": 1.0}}, "m.P [W] has causality output and cannot be given a start value"),
    "two together": ({"wires": WIRES, "start": {"c.rod.finite": True, "c.crank.r": 0.5}},
        "c: GetReal returned Fatal: crank.r = 0.5 m must be below rod.l = 0.4 m"),
    "a part": ({"wires": ["mm.tau -> c.tau"]}, "there is no part 'mm', only m, c; did you mean m?"),
}  # fmt: skip


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_of_the_wrong_kinds_is_told_what_to_write(name: str, fmus: Path) -> None:
    how, message = SYSTEMS[name]
    parts = {"m": fmus / "DriveMotor.fmu", "c": fmus / "CrankConveyor.fmu"}
    with pytest.raises(SetupError, match=re.escape(message).replace("w,\\ tau,", ".*")) as caught:
        run(System(parts, **how), stop=0.1, step=0.01)
    assert "\n" not in str(caught.value)


def test_parts_are_files_by_name(fmus: Path) -> None:
    file = fmus / "DriveMotor.fmu"
    for parts in ([file], file, str(file), (str(file),)):
        with pytest.raises(
            SetupError, match=r"parts must be FMU files by name: write \{'DriveMotor': "
        ):
            run(System(parts), stop=0.1, step=0.01)  # type: ignore[arg-type]
    for wrong in ({"m": None}, {"m": 3}, {1: file}):
        with pytest.raises(SetupError, match="must be the path of an FMU"):
            run(System(wrong), stop=0.1, step=0.01)  # type: ignore[arg-type]
    run(System({"m": str(file)}), stop=0.1, step=0.01)  # type: ignore[dict-item]


SETTINGS: dict[str, tuple[dict[str, Any], str]] = {
    "stop": ({"stop": "2s"}, "stop = '2s' must be a number of seconds: write stop=2.0"),
    "step": ({"step": "1ms"}, "step = '1ms' must be a number of seconds: write step=0.001"),
    "text": ({"stop": "soon"}, "stop = 'soon' must be a number"),
    "nothing": ({"stop": None}, "stop = None must be a number"),
    "rows": ({"output_step": "10ms"}, "output_step = '10ms' must be a number of seconds: write output_step=0.01"),
    "tolerance": ({"tolerance": "1e-6"}, "tolerance = '1e-6' must be a number"),
    "a long step": ({"step": 2.0, "stop": 0.5}, "step = 2.0 s must be at most the time from start to stop, 0.5 s"),
    "record": ({"record": "m.tau,m.P"}, "record must be a sequence of names: write ['m.tau', 'm.P']"),
    "order": ({"order": "m"}, "order must be a sequence of names: write ['m']"),
    "substeps": ({"substeps": {"m": 2.5}}, "substeps of m = 2.5 must be a whole number"),
    "substeps of another": ({"substeps": {"n": 2}}, "substeps: there is no part 'n', only m, c"),
    "input order": ({"input_order": 1.5}, "input_order = 1.5 must be a whole number"),
    "record of nothing": ({"record": [None]}, "None is not a name: write 'part.variable'"),
    "no tolerance": ({"step": Adaptive(0.0)}, "tolerance = 0.0 must be above 0"),
    "no first step": ({"step": Adaptive(1.0, first=0.0)}, "first = 0.0 must be above 0"),
    "control": ({"step": Adaptive(1.0, control="guess")}, "control 'guess' must be doubling or energy"),
    "absolute tolerance": ({"step": Adaptive(1.0, absolute={"m.P": 1.0})}, "absolute tolerance of m.P"),
    "endless rows": ({"output_step": math.inf}, "output_step = inf s must be a finite number"),
    "no step": ({"step": 0.0}, "step = 0.0 s must be above 0"),
    "no number": ({"step": math.nan}, "step = nan s must be a finite number"),
    "backwards": ({"stop": -1.0}, "stop = -1.0 s must be after start = 0.0 s"),
    "algorithm": ({"algorithm": "Strang"}, "algorithm 'Strang' must be one of jacobi, gauss-seidel, strang, iterated; did you mean strang?"),
}  # fmt: skip


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_of_the_wrong_kind_are_told_what_to_write(name: str, fmus: Path) -> None:
    how, message = SETTINGS[name]
    system = System({"m": fmus / "DriveMotor.fmu", "c": fmus / "CrankConveyor.fmu"}, WIRES)
    with pytest.raises(SetupError, match=re.escape(message)):
        run(system, **({"stop": 0.1, "step": 0.01} | how))


@pytest.mark.parametrize("value", ["1.5", None, [1.0, 2.0], complex(1.0, 2.0)])
def test_an_input_that_gives_no_number_is_named(value: object, fmus: Path) -> None:
    system = System({"m": fmus / "DriveMotor.fmu"}, inputs={"m.w": lambda _: value})  # type: ignore[dict-item, return-value]
    message = re.escape(
        f"input m.w: its function gives {value!r} at t = 0.0 s; it must give a number"
    )
    with pytest.raises(SetupError, match=message):
        run(system, stop=0.1, step=0.01)
    with pytest.raises(SetupError, match=r"input m\.w: its function gives 'late'"):
        late = System(system.parts, inputs={"m.w": lambda t: 1.0 if t < 0.05 else "late"})  # type: ignore[dict-item, return-value]
        run(late, stop=0.1, step=0.01)


def test_what_is_right_stays_right(fmus: Path) -> None:
    """Whole numbers, numbers of NumPy, a table, a Wire, tuples in place of lists."""
    np = pytest.importorskip("numpy")
    parts = {"m": fmus / "DriveMotor.fmu", "c": fmus / "CrankConveyor.fmu"}
    system = System(parts, (Wire("m.tau", "c.tau"), WIRES[1]), {"m.T": np.float64(0.05)})
    result = run(
        system,
        stop=np.float64(1) / 10,
        step=np.float32(0.0078125),
        substeps={"m": np.int64(2)},
        record=("m.tau",),
    )
    assert len(result["time"]) == 14
    for inputs in (
        {"m.w": np.float32},
        {"m.w": lambda t: 1},
        {"m.w": Series.of({"t": [0, 1], "w": [0, 1]})},
    ):
        run(System({"m": parts["m"]}, inputs=inputs), stop=1, step=1, tolerance=None)


@pytest.mark.parametrize(("right", "wrong"), [("robot", "mobot"), ("gear", "gaer"), (".T", ".K")])
def test_of_very_many_names_the_nearest_is_found(right: str, wrong: str) -> None:
    """Whether its beginning, its middle or its end is wrong."""
    names = [f"robot.joint[{i}].gear.bearing{j}.T" for i in range(100) for j in range(200)]
    near = names[7 * 200 + 9]
    text = only(near.replace(right, wrong), names)
    assert text.startswith(f"only {near}, ")
    assert text.endswith(f"and 19988 more; did you mean {near}?")
