"""The order of calls: what FMUs do with wrong ones, and that the master makes none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim import System, run
from cosim.analysis.crosscheck import checks
from cosim.analysis.crosscheck.checks import NOT_OFFERED, PASSED
from cosim.analysis.crosscheck.subject import Subject
from cosim.fmu.calls import CALLS
from cosim.fmu.messages import quiet
from cosim.fmu.session import Session
from tests.cosim.faulty import pack

LENIENT = "takes wrong calls"


def found(path: Path) -> checks.CheckResult:
    with quiet():
        return checks.checked(Subject(path), "call order")


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_wrong_calls_that_are_taken_are_named_with_what_they_change(
    version: str, tmp_path: Path
) -> None:
    verdict = found(pack(tmp_path / "faulty.fmu", LENIENT, version))
    assert verdict.status == NOT_OFFERED and verdict.detail.startswith(
        "4 of "
    )  # which it does not have
    for wrong in (
        "doStep in initialization mode changes the rows after it",
        "set a fixed parameter while stepping changes the rows after it",
    ):
        assert wrong in verdict.detail
    assert "reset" not in verdict.detail  # which is allowed everywhere


@pytest.mark.parametrize("folder", ["native", "fmi3", "."])
def test_fmus_of_the_kit_refuse_what_the_table_forbids(fmus: Path, folder: str) -> None:
    """All of it, but for outputs before initialisation by FMI 2.0, which are start values and change nothing."""
    verdict = found(fmus / folder / "DriveMotor.fmu")
    refused, count = (int(word) for word in verdict.detail.split(" calls")[0].split(" of "))
    assert verdict.status == PASSED
    assert count - refused == (folder != "fmi3"), verdict.detail


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_master_makes_calls_only_where_they_are_allowed(
    version: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a run that steps, starts again after a reset, and ends."""
    calls: list[str] = []
    call = Session.call

    def record(session: Session, method: str, *arguments: Any) -> Any:
        calls.append(method)
        return call(session, method, *arguments)

    monkeypatch.setattr(Session, "call", record)
    run(
        System({"A": pack(tmp_path / "sound.fmu", "", version)}),
        stop=0.1,
        step=0.01,
        algorithm="jacobi",
    )
    state, seen = "I", []
    for name in calls:
        row = CALLS.get(name)
        if row is not None:
            assert state in str(row.allowing_states(version)), f"{name} in {state}"
            state, seen = row.leads_to or state, [*seen, name]
    assert seen[-2:] == ["exitInitializationMode", "terminate"] and state == "T"
