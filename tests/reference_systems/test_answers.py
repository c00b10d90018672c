"""The answers of the reference systems are those of two integrators that share no equation, and each number matters."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cosim import System, run
from reference_systems.make import SPACING, exact_answer
from reference_systems.systems import SYSTEMS, build_fmus

#: Error that the answers may have, in ranges: that of a stiff shaft, whose torque is a small difference of large numbers.
LARGEST_ERROR = {"stiff_bond": 1e-6}


@pytest.fixture(scope="module", autouse=True)
def _fmus_are_built() -> None:
    assert not build_fmus()


exact = cache(exact_answer)
"""Each answer once."""


@pytest.mark.parametrize("key", SYSTEMS)
def test_two_integrators_agree_within_the_stated_error(key: str) -> None:
    found = exact(key)
    assert found.agreement <= 1.0
    for name, errors in found.errors.items():
        assert errors.max() <= LARGEST_ERROR.get(key, 1e-8) * np.ptp(found.values[name])


@pytest.mark.parametrize(
    ("key", "wire"),
    [("conveyor_drive_a", 0), ("two_masses", 1), ("controlled_drive", 4), ("stiff_bond", 3), ("quarter_car", 2),
     ("event_within_step", 2), ("input_jump", 1)],
)  # fmt: skip
def test_a_wrong_sign_of_a_bond_is_no_agreement(key: str, wire: int) -> None:
    system = SYSTEMS[key].system()
    source, arrow, target = str(system.wires[wire]).split()
    wires = list(system.wires)
    wires[wire] = f"{source} * -1 {arrow} {target}"
    stop = {"input_jump": 0.12}.get(key, 0.02)
    assert exact_answer(key, replace(system, wires=wires), stop).agreement > 1e3


@pytest.mark.parametrize(
    ("key", "name", "share"),
    [("input_jump", "source.t_1", 1e-9), ("event_within_step", "hammer.z", 1e-9),
     ("event_within_step", "hammer.e", 1e-9)],
)  # fmt: skip
def test_a_wrong_event_time_is_no_agreement(key: str, name: str, share: float) -> None:
    """Off by less than 1 ns."""
    system = SYSTEMS[key].system()
    start = {**system.start, name: system.start[name] * (1.0 + share)}
    assert exact_answer(key, replace(system, start=start), 0.12).agreement > 10.0


def off_by(system: System, key: str, step: float, **settings: object) -> float:
    """The largest difference of a run of our master, in ranges."""
    found = exact(key)
    names = list(found.values)
    result = run(system, stop=SYSTEMS[key].stop, step=step, record=names, **settings)  # type: ignore[arg-type]
    rows = np.rint(result["time"] / SPACING).astype(int)
    return max(
        float(np.abs(result[n] - found.values[n][rows]).max() / np.ptp(found.values[n]))
        for n in names
    )


@pytest.mark.parametrize("key", ["conveyor_drive_b", "two_masses", "quarter_car"])
@pytest.mark.parametrize(
    ("settings", "name"),
    [({"algorithm": "gauss-seidel"}, "held"), ({"algorithm": "strang"}, "held, Strang"),
     ({"algorithm": "gauss-seidel", "input_order": 1}, "order 1"),
     ({"algorithm": "gauss-seidel", "input_order": 2}, "order 2 and more")],
)  # fmt: skip
def test_the_error_falls_with_the_stated_order(
    key: str, settings: dict[str, object], name: str
) -> None:
    reference = SYSTEMS[key]
    coarse, fine = (off_by(reference.system(), key, h, **settings) for h in (5e-4, 2.5e-4))
    assert np.log2(coarse / fine) > reference.orders[name] - 0.1


def test_without_a_compiler_systems_are_made_of_the_fmus_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """And one line says what to install where one is missing."""
    monkeypatch.setattr("reference_systems.systems.find_spec", lambda _: None)
    assert not build_fmus()
    assert "ziglang" not in "".join(capfd.readouterr())
    (error,) = build_fmus(fmus=tmp_path)
    assert 'write pip install "drive-fmus[native]"' in error
    assert capfd.readouterr().err == f"error: {error}\n"
