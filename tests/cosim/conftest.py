"""What tests of the master share: its command line, and runs without the compiled loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from cosim.cli.main import main
from cosim.engine import driver

CommandOutput = Callable[..., str]


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

    monkeypatch.setattr(driver, "Loop", missing)
