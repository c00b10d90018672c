"""A run that explodes says so, with the signal and the time; one that does not is left in peace."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from cosim import Series
from cosim.result import growth_start
from tests.cosim.conftest import CommandOutput
from tests.cosim.foreign import pack

T = np.linspace(0.0, 10.0, 1001)
CALM = {
    "rest": 0.0 * T, "ramp": T, "power": T**4, "impact": np.where(T > 7.0, 1e3, 0.0), "decay": np.exp(-9.0 * T),
    "wave": np.sin(20.0 * T), "charge": 1.0 - np.exp(-T), "from noise": 1e-12 + np.where(T > 5.0, 1e3, 0.0),
    "doubles": np.exp(T * math.log(2.0) / 10.0), "limit cycle": np.minimum(1e-9 * np.exp(9.0 * T), 1.0),
}  # fmt: skip
WILD = {
    "exponential": (np.exp(5.0 * T), 0.0), "oscillation": (np.exp(5.0 * T) * np.sin(40.0 * T), 0.0),
    "later": (np.maximum(1.0, np.exp(20.0 * (T - 3.0))), 3.0), "lost": (np.where(T > 9.5, np.inf, np.exp(60.0 * T)), 0.0),
}  # fmt: skip


def test_only_what_grows_without_bound_does() -> None:
    starts = growth_start(T, np.array(list(CALM.values())))
    assert np.isnan(starts).all(), dict(zip(CALM, starts))
    starts = growth_start(T, np.array([x for x, _ in WILD.values()]))
    assert (np.abs(starts - [since for _, since in WILD.values()]) <= 1.01).all(), starts


def test_a_run_and_a_sweep_say_so(
    tmp_path: Path,
    command_output: CommandOutput,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """x' = a x + b u with a = 3 per second, from 1: e^60 at the end."""
    from cosim.cli.main import main

    monkeypatch.chdir(tmp_path)
    fmu = pack(Path("A.fmu"))
    times = ["--stop", "20", "--step", "0.1"]
    assert (
        main(["run", str(fmu), *times, "--set", "A.a=3", "--set", "A.u=1", "--out", "r.csv"]) == 0
    )
    assert "A.z grows without bound from" in capsys.readouterr().err
    asked = ["--vary", "A.a=-1,3", "--set", "A.u=1", "--figure", "last:A.z", "--jobs", "1"]
    command_output("sweep", fmu, *times, *asked, "--out", "s.csv")
    table = Series.read("s.csv")
    assert [isinstance(text, str) for text in table["unbounded"]] == [False, True]
    assert table["unbounded"][1].startswith("A.z from")
    assert main(["run", str(fmu), *times, "--set", "A.a=-1", "--set", "A.u=1"]) == 0
    assert "without bound" not in capsys.readouterr().err
