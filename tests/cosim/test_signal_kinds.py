"""What is discrete is held, whatever its type: no value arrives that nobody has set."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import ALGORITHMS, Adaptive, Result, Series, SetupError, System, run

from .drawn import pack2, pack3

#: A switch in a part of FMI 2.0 that nobody is told of, between two communication points [s].
SWITCH = 0.449
STEPS = (0.1, Adaptive(1e-2))


def packed(folder: Path, version: int, **kinds: Any) -> Path:
    pack = {2: pack2, 3: pack3}[version]
    return pack(folder / f"drawn{version}.fmu", **kinds)


def values(result: Result, name: str) -> set[float]:
    """The values of a column, but for the rounding of an iteration."""
    return {round(float(x), 12) for x in result[name]}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("input_order", [0, 1, 2])
@pytest.mark.parametrize(("version", "step"), [*product((2, 3), STEPS)])
def test_a_discrete_output_is_held_into_a_discrete_input(
    algorithm: str, input_order: int, version: int, step: Any, tmp_path: Path
) -> None:
    """A switch from 0 to 1 arrives as 0 and 1, not as 1.167."""
    parts = {"s": packed(tmp_path, 2), "t": packed(tmp_path, version)}
    system = System(parts, ["s.y -> t.d"], {"s.switch_at": SWITCH})
    result = run(system, stop=1.0, step=step, algorithm=algorithm, input_order=input_order)
    assert values(result, "t.e") == {0.0, 1.0}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("input_order", [0, 1, 2])
def test_a_discrete_output_is_held_into_a_continuous_input(
    algorithm: str, input_order: int, tmp_path: Path
) -> None:
    """x' = u with u = 0, then 1: x rises by no shares of a step that are not steps of the algorithm."""
    parts = {"s": packed(tmp_path, 2), "t": packed(tmp_path, 3)}
    system = System(parts, ["s.y -> t.u"], {"s.switch_at": SWITCH, "t.b": 1.0})
    result = run(system, stop=1.0, step=0.1, algorithm=algorithm, input_order=input_order)
    rates = np.diff(result["t.x"]) / 0.1
    shares = (0.0, 0.5, 1.0) if algorithm == "strang" else (0.0, 1.0)
    assert min(shares) == pytest.approx(rates.min()) and max(rates) == pytest.approx(1.0)
    for rate in rates:
        assert min(abs(rate - share) for share in shares) < 1e-9, rates


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("input_order", [0, 1, 2])
@pytest.mark.parametrize("version", [2, 3])
def test_a_continuous_output_is_held_into_a_discrete_input(
    algorithm: str, input_order: int, version: int, tmp_path: Path
) -> None:
    """The discrete input takes what the source has shown at the end of one of its steps, not a mean nor a value to come."""
    parts = {"s": packed(tmp_path, 2), "t": packed(tmp_path, version)}
    start = {"s.x": 1.0, "s.a": -2.0}
    result = run(
        System(parts, ["s.x -> t.d"], start), stop=1.0, step=0.1, algorithm=algorithm,
        input_order=input_order,
    )  # fmt: skip
    shown = np.exp(-2.0 * 0.05 * np.arange(21))
    for x in result["t.e"]:
        assert np.abs(shown - x).min() < 1e-9, x


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("kind", ["change", "table"])
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("step", [0.1, 0.25, *STEPS[1:]])
def test_a_change_inside_a_step_splits_it(
    algorithm: str, kind: str, version: int, step: Any, tmp_path: Path
) -> None:
    """x' = d with d = 1 from 0.55 s on, exactly; rows show 0 and 1 only, and the time of the change."""
    part = packed(tmp_path, version)
    start = {"t.c": 1.0}
    if kind == "change":
        system = System({"t": part}, [], start, changes=["at 0.55 s t.d = 1"])
    else:
        held = Series.of({"t": [0.0, 0.55, 1.0], "d": [0.0, 1.0, 1.0]}).held()
        system = System({"t": part}, [], start, inputs={"t.d": held})
    result = run(system, stop=1.0, step=step, algorithm=algorithm)
    assert values(result, "t.e") == {0.0, 1.0}
    at = np.abs(result["time"] - 0.55) < 1e-12
    assert [float(x) for x in result["t.e"][at]] == [0.0, 1.0]
    assert result["t.x"][-1] == pytest.approx(0.45, abs=1e-12)


@pytest.mark.parametrize("version", [2, 3])
def test_a_discrete_real_follows_no_line(version: int, tmp_path: Path) -> None:
    """A table that is interpolated, and a function, are refused as they are for an Integer."""
    part = packed(tmp_path, version)
    table = Series.of({"t": [0.0, 1.0], "d": [0.0, 1.0]})
    for inner in (table, np.sin):
        with pytest.raises(SetupError, match=r"t\.d"):
            run(System({"t": part}, inputs={"t.d": inner}), stop=1.0, step=0.1)


@pytest.mark.parametrize("version", [2, 3])
def test_a_change_inside_a_step_that_cannot_be_split_is_refused(
    version: int, tmp_path: Path
) -> None:
    """The message says what to write."""
    part = packed(tmp_path, version, varies=False)
    system = System({"t": part}, changes=["at 0.55 s t.d = 1"])
    with pytest.raises(SetupError, match=r"t\.d.*0\.55|0\.55.*t\.d"):
        run(system, stop=1.0, step=0.1)
    assert values(run(system, stop=1.0, step=0.05), "t.e") == {0.0, 1.0}
