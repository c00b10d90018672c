"""What tests of the master share: its command line, runs that are made up, and runs without the compiled loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cosim import Result
from cosim.cli.main import main
from cosim.engine import system_instance
from cosim.series import TIME, Column, Kind

CommandOutput = Callable[..., str]


def runs_of(
    rows: Callable[[float], list[Any]], *, order: int = 1, kind: Kind = Kind.CONTINUOUS
) -> Callable[..., Result]:
    """A runner for certify: the columns time and x of each run are those of its step, of this order."""

    def runner(_: Any, *, step: float, **__: Any) -> Result:
        columns = [TIME, Column("x", kind=kind)]
        return Result(columns, {"convergence_order": order}, np.array(rows(step)).__getitem__)

    return runner


@pytest.fixture
def command_output(capsys: pytest.CaptureFixture[str]) -> CommandOutput:
    """What a command says that ends with this code; what is refused, with 2, in one line."""

    def command(*arguments: object, code: int = 0) -> str:
        assert main([str(argument) for argument in arguments]) == code
        captured = capsys.readouterr()
        if code != 2:
            return captured.out
        assert captured.err.startswith("error: ") and captured.err.count("\n") == 1, captured.err[
            :300
        ]
        return captured.err

    return command


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """No compiled loop."""

    def missing(*_: Any) -> None:
        raise OSError("no compiler")

    monkeypatch.setattr(system_instance, "Loop", missing)
