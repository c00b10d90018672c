"""What tests of the master share: its command line, and runs without the compiled loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from cosim.cli.main import main
from cosim.engine import driver

Said = Callable[..., str]


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    """What a command says that ends with this code; what is refused, with 2, in one line."""

    def command(*arguments: object, code: int = 0) -> str:
        assert main([str(argument) for argument in arguments]) == code
        told = capsys.readouterr()
        if code != 2:
            return told.out
        assert told.err.startswith("error: ") and told.err.count("\n") == 1, told.err[:300]
        return told.err

    return command


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """No compiled loop."""

    def missing(*_: Any) -> None:
        raise OSError("no compiler")

    monkeypatch.setattr(driver, "Loop", missing)
